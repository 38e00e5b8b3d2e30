"""A line drawing in the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import BindingType
from textual.containers import Vertical
from textual.widgets import Static

from app.report.charts.charts import Chart, Drawing, Look, tick_labels, ticks_within
from app.report.charts.tripod import drawn_set_up
from app.report.text.session import set_up_text
from app.screens.fast_keys import Dialog
from app.screens.plot import COLOURS, MARKERS, ChartPlot
from protocols.machine import Instrument
from protocols.procedure import Step
from protocols.session import Session

LINES = {Look.THIN: "braille", Look.THICK: "hd", Look.BEADED: "•"}
DOTS = {Look.DOTTED: "·", Look.MARKED: ":"}
STROKE_COLOURS = {
    Look.DOTTED: "foreground",
    Look.MARKED: "text-secondary",
    Look.THIN: "text-primary",
    Look.THICK: "text-accent",
    Look.BEADED: "text-warning",
}

LABEL_CELLS = 7
"""Of a number below the drawing."""

LABELLED_ROWS = 3
"""So many rows for one number beside the drawing."""


class SetUpScreen(Dialog[None]):
    """Where the indicators of a step stand: words and picture, as large as the terminal."""

    HELP = "Thick: the bar that is touched, x: where. Dots: each spindle, up to its body."
    BINDINGS: ClassVar[list[BindingType]] = [
        ("escape", "dismiss(None)", "Back"),
        ("w", "dismiss(None)", "Back"),
        ("enter", "dismiss(None)", "Back"),
        ("space", "dismiss(None)", "Back"),
    ]

    def __init__(
        self, session: Session, step: Step, instruments: Sequence[Instrument | None]
    ) -> None:
        super().__init__()
        self._words = set_up_text(session, step, instruments)
        self._drawing = drawn_set_up(session, step, instruments)

    def compose(self) -> ComposeResult:
        with Vertical(classes="wide-dialog"):
            yield Static(self._words, markup=False)
            yield DrawingPlot(self._drawing)
            yield Static("Escape, Space or W goes back.", markup=False)


class DrawingPlot(ChartPlot):
    """Draws strokes and marks; anything else as a chart."""

    def _draw(self, chart: Chart) -> None:
        if not isinstance(chart, Drawing):
            super()._draw(chart)
            return
        self.plt.clear_figure()
        self.plt.title(chart.heading)
        self.plt.xlabel(self._legend(chart))
        self._scale(chart)
        for stroke in chart.strokes:
            x, y = ([point[k] for point in stroke.points] for k in (0, 1))
            colour = self._colour(STROKE_COLOURS[stroke.look])
            if stroke.look in LINES:
                self.plt.plot(x, y, marker=LINES[stroke.look], color=colour)
            else:
                self.plt.scatter(x, y, marker=DOTS[stroke.look], color=colour)
        self._marks(chart)

    def _scale(self, chart: Drawing) -> None:
        plot, columns = self.plt, self._columns
        across, upwards = chart.limits(columns, self._rows)
        plot.xlim(*across)
        plot.ylim(*upwards)
        if not chart.scaled:
            plot.frame(False)
            plot.xticks([])
            plot.yticks([])
            return
        ticks = ticks_within(across, max(2, columns // LABEL_CELLS))
        plot.xticks(list(ticks), tick_labels(ticks) if ticks else [])
        ticks = ticks_within(upwards, max(2, self._rows // LABELLED_ROWS))
        plot.yticks(list(ticks), tick_labels(ticks) if ticks else [])

    def _marks(self, chart: Drawing) -> None:
        for series, marker, name in zip(chart.series, MARKERS, COLOURS, strict=False):
            colour = self._colour(name)
            self.plt.scatter(list(series.x), list(series.y), marker=marker, color=colour)
        words, ground = self._colour("foreground"), self._colour("surface")
        for label in chart.labels:
            self.plt.text(label.words, *label.at, color=words, background=ground)
