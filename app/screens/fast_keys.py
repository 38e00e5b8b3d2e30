"""Actions, screens and a palette that bear keys coming faster than Textual handles them (8.2.8).

A pasted text, a bouncing foot switch and a cat on the keyboard are such keys. Taken out for a
trial, each part failed `tests/screens/test_fast_keys.py` with GLIDECAL_FUZZ=2000, so many random
keys a seed; only the look at a list in `ready` was not missed.
"""

from __future__ import annotations

from typing import Any

from textual.await_complete import AwaitComplete
from textual.command import CommandPalette
from textual.dom import DOMNode
from textual.screen import Screen, ScreenResultType
from textual.widget import Widget
from textual.widgets import OptionList
from textual.worker import Worker

PAGES = ("page_up", "page_down")


def ready(node: DOMNode | None) -> bool:
    """Whether a key may act on this part: its screen is whole and on top.

    Textual acts on a screen that is gone or half made, whose parts are missing, and turns the pages
    of a list that was not laid out: NoMatches, KeyError.
    """
    if not isinstance(node, Widget):
        return True
    if isinstance(node, OptionList) and not node.scrollable_content_region:
        return False
    return node.is_attached and node.screen.is_active and node.screen.is_mounted


class LeftOnce(Screen[ScreenResultType]):
    """A screen with a result that goes once: Textual pops whatever is on top instead."""

    def dismiss(self, result: ScreenResultType | None = None) -> AwaitComplete:
        return super().dismiss(result) if self.is_active else AwaitComplete()


class Palette(CommandPalette, LeftOnce[None]):
    """The command palette, which hands keys on to a list only while it has one.

    Page keys need one that is laid out.

    Without an id: Textual gives its own one, and a palette that is still going clashes with it.
    """

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        if action not in ("command_list", "cursor_down"):
            return True
        lists, paging = self.query(OptionList), set(PAGES).intersection(parameters)
        return bool(lists) and all(
            option_list.scrollable_content_region or not paging for option_list in lists
        )

    def run_worker(  # its arguments are Textual's
        self,
        *arguments: Any,  # noqa: ANN401 (Textual's)
        **options: Any,  # noqa: ANN401 (Textual's)
    ) -> Worker[Any]:
        """A search; a key that comes while the palette goes starts one that finds no list."""
        return super().run_worker(*arguments, **(options | {"exit_on_error": False}))
