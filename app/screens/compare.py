"""Before and after: the differences as a table and as a plot."""

from __future__ import annotations

from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, VerticalScroll
from textual.events import Resize
from textual.screen import Screen
from textual.widgets import Footer, Static

from app.evaluating.comparison import Comparison
from app.report.charts.charts import before_and_after
from app.report.text.result import COMPARISON_HELP, comparison_report, copied_text
from app.screens.fast_keys import Title
from app.screens.interface import Interface
from app.screens.plot import ChartPlot

WIDE = 110
"""Columns from which text and plot stand side by side."""


class CompareScreen(Screen[None]):
    """Two sessions side by side."""

    app: Interface
    HELP = COMPARISON_HELP
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("g", "plot", "Plot", id="compare.plot"),
        Binding("y", "copy", "Copy", id="compare.copy"),
        Binding("escape", "app.pop_screen", "Back", id="compare.back"),
        Binding("f10", "app.quit", "Quit", id="compare.quit"),
    ]

    def __init__(self, comparison: Comparison) -> None:
        super().__init__()
        self._comparison = comparison
        self._text = comparison_report(comparison)

    def compose(self) -> ComposeResult:
        yield Title()
        before, after = self._comparison.before.solution, self._comparison.after.solution
        with Horizontal(id="compare"):
            with VerticalScroll(id="compare-words"):
                yield Static(self._text, id="compare-text", markup=False)
            yield ChartPlot(before_and_after(before, after), plot_id="compare-chart")
        yield Footer()

    def on_mount(self) -> None:
        self.query_one("#compare-words").focus()

    def on_resize(self, event: Resize) -> None:
        self.set_class(event.size.width >= WIDE, "wide")

    def action_plot(self) -> None:
        """The plot instead of the text, where there is no room for both."""
        self.toggle_class("plotted")

    def action_copy(self) -> None:
        """The text into the clipboard of the terminal."""
        self.app.copy_to_clipboard(self._text)
        self.app.notify(copied_text(self._text), markup=False)
