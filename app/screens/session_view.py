"""A session on the screen: where it stands, what to do, what the indicators show."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from textual.app import ComposeResult
from textual.containers import Horizontal, Vertical
from textual.widgets import Static

from app.measuring.gauges import Live
from app.measuring.leg_review import leg_rows
from app.report.charts.charts import readings_by_posture
from app.report.text.session import leg_table_text, step_text
from app.screens.line_cache import CachedLines
from app.screens.plot import ChartPlot
from app.screens.widgets import GaugeDisplay, Line, StepList
from protocols.procedure import Step
from protocols.session import Session

CHART_S = 0.06
"""The chart is half of a step's picture; it comes later, so that readings need not wait for it."""


class Row(Horizontal, CachedLines):
    """Side by side."""


class SessionView(Vertical, CachedLines):
    """The same picture whether a session is measured or replayed."""

    def __init__(self, gauge_count: int) -> None:
        super().__init__()
        self._displays = tuple(
            GaugeDisplay(f"indicator {number + 1}", f"gauge{number}")
            for number in range(gauge_count)
        )

    def compose(self) -> ComposeResult:
        yield Line("", id="progress", markup=False)
        with Row(id="upper"):
            yield Static("", id="step", markup=False)
            yield StepList()
        with Row(id="gauges"):
            yield from self._displays
        yield Line("", id="said", markup=False)
        with Row(id="lower"):
            yield Static("", id="table", markup=False)
            yield ChartPlot(plot_id="chart")

    def show_progress(self, text: str) -> None:
        """The line at the top."""
        self.query_one("#progress", Static).update(text, layout=False)

    def show_step(self, session: Session, steps: Sequence[Step], step: Step | None) -> None:
        """The present step, the list around it, the leg so far."""
        geometry = session.opened.machine.geometry()
        self.query_one(StepList).show(steps, step, session, geometry)
        if step is None:
            return
        self.query_one("#step", Static).update(step_text(step, session), layout=False)
        table = leg_table_text(leg_rows(session, step), geometry)
        self.query_one("#table", Static).update(table, layout=False)
        self.set_timer(CHART_S, partial(self._show_chart, session, step))
        for display, axis in zip(self._displays, step.axes, strict=False):
            display.border_title = f"along {axis.upper()}, mm"

    def _show_chart(self, session: Session, step: Step) -> None:
        self.query_one(ChartPlot).show(readings_by_posture(session, step))

    def show_live(self, states: Sequence[Live]) -> None:
        """What the indicators tell now."""
        for display, live in zip(self._displays, states, strict=True):
            display.show(live)

    def say(self, text: str) -> None:
        """What happened last, in one line; only a longer text moves what stands below it."""
        said = self.query_one("#said", Static)
        room = said.content_size.width
        grows = max(len(text), len(str(said.content))) > room or "\n" in text
        said.update(text, layout=grows)

    def toggle_plot(self) -> None:
        """Show the plot in the place of the table, or the table again (narrow terminals)."""
        self.toggle_class("plotted")
