"""Screens with pages that keys turn."""

from __future__ import annotations

import re

from textual.containers import VerticalScroll
from textual.content import Content
from textual.screen import Screen
from textual.widgets import TabbedContent, Tabs

SIGNALS = {
    "Next:": "bold $text-accent",
    "WARNING:": "bold $text-warning",
    "AGREES.": "bold $text-success",
    "EXPLAINED.": "bold $text-success",
    "UNEXPLAINED.": "bold $text-error",
}
"""Words at the beginning of a line that stand out; a colour never stands for a word."""


def signalled(text: str) -> Content:
    """The text with its signal words in their colours."""
    found = Content(text)
    for word in re.finditer(rf"^({'|'.join(map(re.escape, SIGNALS))})", text, re.MULTILINE):
        found = found.stylize(SIGNALS[word[0]], *word.span())
    return found


class PagedScreen(Screen[None]):
    """One `TabbedContent` inside; bind keys to ``turn_to(1)`` and ``turn_to(-1)``."""

    def on_mount(self) -> None:
        self.query_one(Tabs).can_focus = False  # the keys of this screen turn the pages

    def on_tabbed_content_tab_activated(self, event: TabbedContent.TabActivated) -> None:
        """Up and down scroll the text of the page that is shown."""
        scrolls = event.pane.query(VerticalScroll)
        self.set_focus(scrolls.first() if scrolls else None)

    def action_turn_to(self, direction: int) -> None:
        tabs = self.query_one(Tabs)
        if direction > 0:
            tabs.action_next_tab()
        else:
            tabs.action_previous_tab()
