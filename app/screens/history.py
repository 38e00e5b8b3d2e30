"""Sessions beside each other: two that are compared, the history of machines."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import ClassVar

from textual.binding import Binding, BindingType
from textual.widgets import OptionList

from app.evaluating.comparison import Comparison
from app.evaluating.history import History
from app.report.charts.posture_history import platform_figure
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
    """A list of machines where there are several, a text of one of them, and its charts."""

    HELP = texts.HISTORY_HELP
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("plus", "figure(1)", "Next chart", show=False, id="history.next_figure"),
        Binding("minus", "figure(-1)", "Chart before", show=False, id="history.figure_before"),
        *PAGE_KEYS,
    ]
    PAGES = (Page("history", "History"), Page("charts", "Charts", content=LegPlots))

    def __init__(self, history: History) -> None:
        super().__init__()
        self._history, rows = history, tuple(texts.machine_rows(history))
        self._several = len(rows) > 1
        if self._several:
            self.pages = (Page("machines", "Machines", rows=rows), *self.PAGES)

    def begin(self) -> None:
        self.head(f"History of {self._history.folder.absolute().name}")
        if self._several:
            self.put("machines", texts.files_text(self._history))
            self._show(self._history.of_number(0))
        else:
            self._show(self._history)

    def _show(self, history: History) -> None:
        self.put("history", texts.history_text(history, datetime.now(UTC)))
        figures = [figure for machine in history.machines for figure in control_charts(machine)]
        figures += map(platform_figure, history.of_postures)
        self.query_one(LegPlots).show(figures)

    def on_option_list_option_selected(self, event: OptionList.OptionSelected) -> None:
        self._show(self._history.of_number(event.option_index))
        self.action_show_page("history")

    def action_figure(self, by: int) -> None:
        self.action_show_page("charts")
        self.query_one(LegPlots).turn(by)
