"""A line drawing in the terminal."""

from __future__ import annotations

from app.report.charts.charts import Chart, tick_labels
from app.report.charts.drawings import Drawing, Look, ticks_within
from app.screens.plot import COLOURS, MARKERS, ChartPlot

LINES = {Look.THIN: "braille", Look.THICK: "hd"}
DOTS = {Look.DOTTED: "·", Look.MARKED: ":"}
STROKE_COLOURS = {
    Look.DOTTED: "foreground",
    Look.MARKED: "text-secondary",
    Look.THIN: "text-primary",
    Look.THICK: "text-accent",
}

LABEL_CELLS = 7
"""Of a number below the drawing."""

LABELLED_ROWS = 3
"""So many rows for one number beside the drawing."""


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
