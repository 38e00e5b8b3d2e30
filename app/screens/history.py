"""The history of the machines of a folder: text, and offsets over time."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import BindingType
from textual.containers import VerticalScroll
from textual.widgets import Footer, Static, TabbedContent, TabPane

from app.evaluating.history import History
from app.report.charts.results import offsets_over_time
from app.report.text.history import HISTORY_HELP, history_text
from app.screens.paged import PagedScreen, page_keys
from app.screens.pages import signalled
from app.screens.plot import ChartPlot


class HistoryScreen(PagedScreen):
    """A page of text, then a plot for each machine."""

    HELP = HISTORY_HELP
    BINDINGS: ClassVar[list[BindingType]] = page_keys("history")

    def __init__(self, found: History) -> None:
        super().__init__()
        self._found = found

    def compose(self) -> ComposeResult:
        with TabbedContent():
            with TabPane("History"), VerticalScroll():
                text = history_text(self._found, datetime.now(UTC))
                yield Static(signalled(text), id="history", markup=False)
            for number, machine in enumerate(self._found.machines, start=1):
                with TabPane(f"Plot {number}"):
                    yield Static(machine.machine, markup=False)
                    yield ChartPlot(offsets_over_time(machine))
        yield Footer()
