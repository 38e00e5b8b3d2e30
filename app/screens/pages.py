"""Screens with pages that keys turn."""

from __future__ import annotations

from textual.screen import Screen
from textual.widgets import Tabs


class PagedScreen(Screen[None]):
    """One `Tabs` inside; bind keys to ``turn_to(1)`` and ``turn_to(-1)``."""

    def action_turn_to(self, direction: int) -> None:
        """The next page, or the one before."""
        tabs = self.query_one(Tabs)
        if direction > 0:
            tabs.action_next_tab()
        else:
            tabs.action_previous_tab()
