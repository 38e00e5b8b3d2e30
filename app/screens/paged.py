"""Screens of pages that keys turn: results, diagnoses, comparisons, history."""

from __future__ import annotations

from functools import partial

from textual.binding import Binding, BindingType
from textual.containers import VerticalScroll
from textual.screen import Screen
from textual.timer import Timer
from textual.widgets import Footer, Static, TabbedContent, Tabs

from app.screens.interface import Interface


def page_keys(
    screen: str, back: str = "app.go_back", words: str = "Back", *, arrows: bool = True
) -> list[BindingType]:
    """The keys that every paged screen has, by ids that begin with its name.

    Last in a screen's own, as the footer shows them. Without ``arrows`` left and right are free.
    """
    following, before = ("tab,right", "shift+tab,left") if arrows else ("tab", "shift+tab")
    return [
        Binding(following, "turn_to(1)", "Next page", show=False, id=f"{screen}.next_page"),
        Binding(before, "turn_to(-1)", "Page before", show=False, id=f"{screen}.previous_page"),
        Binding("y", "copy", "Copy", show=False, id=f"{screen}.copy"),
        Binding("escape", back, words, id=f"{screen}.back"),
        Binding("f10", "app.quit", "Quit", id=f"{screen}.quit"),
    ]


SHOWN_S = 15.0
"""So long a message stays below a page."""


class PagedScreen(Screen[None]):
    """One `TabbedContent` inside; its keys end with `page_keys`.

    What happened last is a line below the page, which lies over nothing.
    """

    app: Interface
    _fading: Timer | None = None

    def on_mount(self) -> None:
        self.query_one(Tabs).can_focus = False  # the keys of this screen turn the pages
        self.mount(Static("", id="message", markup=False), before=self.query_one(Footer))

    def say(self, text: str) -> None:
        """What happened last, for a while."""
        if self._fading is not None:
            self._fading.stop()
        self._show_message(text)
        self._fading = self.set_timer(SHOWN_S, partial(self._show_message, ""))

    def _show_message(self, text: str) -> None:
        for message in self.query("#message").results(Static):
            message.update(text)
            message.display = bool(text)

    def on_tabbed_content_tab_activated(self, event: TabbedContent.TabActivated) -> None:
        """Up and down scroll the text of the page that is shown."""
        scrolls = event.pane.query(VerticalScroll)
        self.set_focus(scrolls.first() if scrolls else None)

    def action_copy(self) -> None:
        """The texts of the page, or its pictures as characters, to the terminal's clipboard."""
        page = self.query_one(TabbedContent).active_pane
        if page is None:
            return
        texts = [str(one.content) for one in page.query(Static) if one.content]
        if not texts:
            charts = (one for one in page.query("ChartPlot") if one.region.area)
            texts = [str(chart.render()).rstrip() for chart in charts]
        self.app.copy("\n\n".join(texts))

    def action_page(self, name: str) -> None:
        self.query_one(TabbedContent).active = name

    def action_turn_to(self, direction: int) -> None:
        tabs = self.query_one(Tabs)
        if direction > 0:
            tabs.action_next_tab()
        else:
            tabs.action_previous_tab()
