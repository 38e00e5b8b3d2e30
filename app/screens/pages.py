"""Screens with pages that keys turn."""

from __future__ import annotations

from textual.containers import VerticalScroll
from textual.screen import Screen
from textual.widgets import TabbedContent, Tabs


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
