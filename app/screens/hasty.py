"""Screens and lists that bear keys coming faster than Textual handles them (8.2.8).

A pasted text, a bouncing foot switch and a cat on the keyboard are such keys.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from textual.await_complete import AwaitComplete
from textual.command import CommandPalette
from textual.screen import ModalScreen, Screen, ScreenResultType
from textual.widgets import OptionList
from textual.worker import Worker

PAGES = ("page_up", "page_down")


def once(screen: Screen[Any], dismiss: Callable[[], AwaitComplete]) -> AwaitComplete:
    """Dismiss a screen only while it is on top: Textual pops whatever is there instead."""
    return dismiss() if screen.is_active else AwaitComplete()


class Leaving(Screen[ScreenResultType]):
    """A screen with a result that goes once."""

    def dismiss(self, result: ScreenResultType | None = None) -> AwaitComplete:
        return once(self, partial(super().dismiss, result))


class Dialog(ModalScreen[ScreenResultType]):
    """A dialog that goes once."""

    def dismiss(self, result: ScreenResultType | None = None) -> AwaitComplete:
        return once(self, partial(super().dismiss, result))


class Choices(OptionList):
    """A list that ignores Page keys until it has been laid out: Textual raises KeyError."""

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        return action not in PAGES or bool(self.scrollable_content_region)


class Palette(CommandPalette):
    """The command palette, which hands Page keys on to such a list.

    Without an id: Textual gives its own one, and a palette that is still going clashes with it.
    """

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        if action != "command_list" or not set(PAGES).intersection(parameters):
            return True
        return all(bool(found.scrollable_content_region) for found in self.query(OptionList))

    def dismiss(self, result: None = None) -> AwaitComplete:
        return once(self, partial(super().dismiss, result))

    def run_worker(  # its arguments are Textual's
        self,
        *arguments: Any,  # noqa: ANN401
        **options: Any,  # noqa: ANN401
    ) -> Worker[Any]:
        """A search; a key that comes while the palette goes starts one that finds no list."""
        return super().run_worker(*arguments, **(options | {"exit_on_error": False}))
