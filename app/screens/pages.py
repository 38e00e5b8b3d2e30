"""What screens share: work apart from them, words that stand out, widgets that rest."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, ParamSpec, Self, TypeVar

from textual.app import ComposeResult
from textual.color import Color
from textual.content import Content
from textual.geometry import Region
from textual.screen import Screen
from textual.strip import Strip
from textual.timer import Timer
from textual.widget import Widget
from textual.widgets import Footer, Static

from app.report.charts.colours import legible_on
from app.report.text.signals import signals_in
from app.screens.keys import bindings_of

Given = ParamSpec("Given")
Found = TypeVar("Found")

COLOURS_OF_WORDS = tuple(
    f"text-{name}" for name in ("success", "warning", "error", "primary", "secondary", "accent")
)


def signalled(text: str) -> Content:
    """The text with its signal words in their colours."""
    content = Content(text)
    for signal, start, end in signals_in(text):
        content = content.stylize(f"bold $text-{signal}", start, end)
    return content


def is_left(screen: Screen[Any]) -> bool:
    """Whether nobody comes back to a screen; Textual says so when parts of it are gone already."""
    return not screen.app.is_running or screen not in screen.app.screen_stack


async def apart(
    screen: Screen[Any],
    job: Callable[Given, Found],
    *arguments: Given.args,
    **options: Given.kwargs,
) -> Found:
    """What a job gives that is done in a thread while the screen goes on.

    For workers of the screen: where it was left meanwhile they end here, as if cancelled.
    """
    try:
        return await asyncio.to_thread(job, *arguments, **options)
    finally:
        if is_left(screen):
            raise asyncio.CancelledError


class Message(Static):
    """What happened last, for a while: a line that lies over nothing."""

    _fading: Timer | None = None

    def __init__(self) -> None:
        super().__init__("", id="message", markup=False)

    def tell(self, text: str, *, wrong: bool = False) -> None:
        """Show a message in the place of the last one; nothing hides the line."""
        self.set_class(wrong, "wrong")
        if self._fading is not None:
            self._fading.stop()
        self.update(text)
        self.display = bool(text)
        # so long a message stays above the keys
        self._fading = self.set_timer(15.0, partial(self.tell, "")) if text else None


class Resting(Widget):
    """Keeps its rows as drawn until it is told to draw again.

    For every picture Textual asks each widget that reaches into it for all of its rows, and looks
    each of them up: on the measuring screen 150 rows that did not change beside 5 that did. It
    stands last among the bases: Textual follows the first for its style sheets.
    """

    _rows: tuple[Region, list[Strip]] | None = None

    def render_lines(self, crop: Region) -> list[Strip]:
        """The rows of before where nothing changed."""
        if self._rows is None or self._rows[0] != crop:
            self._rows = crop, super().render_lines(crop)
        return self._rows[1]

    def refresh(
        self, *regions: Region, repaint: bool = True, layout: bool = False, recompose: bool = False
    ) -> Self:
        self._rows = None
        return super().refresh(*regions, repaint=repaint, layout=layout, recompose=recompose)

    def notify_style_update(self) -> None:
        self._rows = None
        super().notify_style_update()


class KeyLine(Footer, Resting):
    """The keys in the order of the bindings, which is that of their importance.

    Textual moves one of other settings behind all others.
    """

    def __init__(self) -> None:
        super().__init__(compact=True, show_command_palette=False)

    def compose(self) -> ComposeResult:
        places = (*bindings_of(type(self.screen)), *bindings_of(type(self.app)))
        keys = {key: getattr(key, "action", "") for key in super().compose()}
        order = [*(binding.action for _, binding in places), *keys.values()]
        yield from sorted(keys, key=lambda key: order.index(keys[key]))


def last_lines() -> ComposeResult:
    """What happened last, and the keys: the end of every screen."""
    yield Message()
    yield KeyLine()


def legible(variables: Mapping[str, str]) -> dict[str, str]:
    """Colours of words and points, nearer to that of text where a theme has them too pale."""
    text, *grounds = (Color.parse(variables[v]) for v in ("foreground", "background", "surface"))
    colours = {}
    for name in COLOURS_OF_WORDS:
        shade = Color.parse(variables[name])
        if shade.ansi is None:  # else the terminal chooses
            nearer = legible_on([ground.rgb for ground in grounds], shade.rgb, text.rgb)
            colours[name] = Color(*nearer).hex
    return colours
