"""Sessions beside each other: two that are compared, the history of machines."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from typing import ClassVar

from textual import work
from textual.binding import Binding, BindingType
from textual.widgets import OptionList

from app.evaluating.comparison import Comparison
from app.evaluating.history import History
from app.report.charts.history import history_figures
from app.report.charts.results import before_and_after
from app.report.text import history as texts
from app.report.text import result as result_texts
from app.report.text.help import help_of
from app.screens.paged import Page, PagedScreen
from app.screens.pages import apart
from app.screens.plot import LegPlots


class CompareScreen(PagedScreen[None]):
    """Two sessions side by side."""

    HELP = help_of("comparison")
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

    HELP = help_of("history")
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("plus", "figure('charts', 1)", "Next chart", show=False, id="history.next_figure"),
        Binding(
            "minus", "figure('charts', -1)", "Chart before", show=False, id="history.figure_before"
        ),
    ]
    PAGES = (Page("history", "History"), Page("charts", "Charts", content=LegPlots))

    def __init__(self, history: History, more: Callable[[], History] | None = None) -> None:
        """``more`` works out some of the sessions that are still waiting."""
        super().__init__()
        self._history, self._more = history, more
        self._shown: History | None = None
        if history.waiting or len(history.all_machines) > 1:
            machines = Page("machines", "Machines", rows=tuple(texts.machine_rows(history)))
            self.pages = (machines, *self.PAGES)

    @work
    async def begin(self) -> None:
        self._show_all()
        with self.app.complaining():
            while self._history.waiting and self._more:
                self._history = await apart(self, self._more)
                self._show_all()

    def _show_all(self) -> None:
        """The machine that is shown stays, with sessions that were worked out meanwhile."""
        history = self._history
        self.head(texts.heading_text(history))
        for listed in self.query(OptionList):
            self.put("machines", texts.files_text(history, goes_on=self._more is not None))
            rows, marked = texts.machine_rows(history), listed.highlighted or 0
            if rows != [str(option.prompt) for option in listed.options]:
                listed.set_options(rows)
                listed.highlighted = marked if marked < len(rows) else None
            history = history.of_shown(self._shown)
        self._show(history)

    def _show(self, history: History) -> None:
        if history == self._shown:
            return
        self._shown = history
        self.put("history", texts.history_text(history, datetime.now(UTC)))
        self.query_one(LegPlots).show(history_figures(history))

    def on_option_list_option_selected(self, event: OptionList.OptionSelected) -> None:
        self._show(self._history.of_number(event.option_index))
        self.action_show_page("history")
