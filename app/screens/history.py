"""Sessions beside each other: two that are compared, the history of machines."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import ClassVar

from textual.binding import Binding, BindingType

from app.evaluating.comparison import Comparison
from app.evaluating.history import History
from app.report.charts.results import before_and_after, control_charts
from app.report.text import history as texts
from app.report.text import result as result_texts
from app.screens.paged import PAGE_KEYS, Page, PagedScreen
from app.screens.plot import LegPlots


class CompareScreen(PagedScreen[None]):
    """Two sessions side by side."""

    HELP = result_texts.COMPARISON_HELP
    BINDINGS: ClassVar[list[BindingType]] = [*PAGE_KEYS]
    PAGES = (
        Page("comparison", "Comparison", charts=1, beside=True),
        Page("plot", "Plot", charts=1, text=False),
    )

    def __init__(self, comparison: Comparison) -> None:
        super().__init__()
        self._comparison = comparison

    def begin(self) -> None:
        pair = self._comparison.before, self._comparison.after
        chart = before_and_after(*(session.solution for session in pair))
        self.head("   after ".join(session.names[0] for session in pair))
        self.put("comparison", result_texts.comparison_report(self._comparison), chart)
        self.put("plot", None, chart)


class HistoryScreen(PagedScreen[None]):
    """A page of text, and one of control charts."""

    HELP = texts.HISTORY_HELP
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("plus", "figure(1)", "Next chart", show=False, id="history.next_figure"),
        Binding("minus", "figure(-1)", "Chart before", show=False, id="history.figure_before"),
        *PAGE_KEYS,
    ]
    PAGES = (Page("history", "History"), Page("charts", "Charts", content=LegPlots))

    def __init__(self, history: History) -> None:
        super().__init__()
        self._history = history

    def begin(self) -> None:
        self.head(f"History of {self._history.folder.absolute().name}")
        self.put("history", texts.history_text(self._history, datetime.now(UTC)))
        machines = self._history.machines
        figures = [figure for machine in machines for figure in control_charts(machine)]
        self.query_one(LegPlots).show(figures)

    def action_figure(self, by: int) -> None:
        """Another joint or machine on the page of charts."""
        self.action_show_page("charts")
        self.query_one(LegPlots).turn(by)
