"""Charts and line drawings in the terminal."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from textual.app import RenderResult
from textual.color import Color
from textual.geometry import Size
from textual_plotext import PlotextPlot

from app.report.charts.charts import (
    Chart,
    Drawing,
    Series,
    StrokeStyle,
    even_limits,
    label_cells,
    spread,
    thinned,
    tick_labels,
    ticks_within,
    turned,
    turned_limits,
)

MARKERS = ("x", "o", "+", "*")
"""Told apart by shape, not by colour alone."""

COLOURS = ("text-primary", "text-accent", "text-error", "text-secondary")
"""Variables of the theme that are legible on its surface, in every theme."""

TERMINAL = "default"
"""The colour of the terminal in the words of plotext."""

FRAME = 2
FRAME_COLUMNS = FRAME + 6
FRAME_ROWS = FRAME + 3
"""What frame, numbers, title and legend take away from the points."""

NOTHING = "nothing measured yet"

LINES = {StrokeStyle.THIN: "braille", StrokeStyle.THICK: "hd", StrokeStyle.BEADED: "•"}
DOTS = {StrokeStyle.DOTTED: "·", StrokeStyle.MARKED: ":"}
STROKE_COLOURS = {
    StrokeStyle.DOTTED: "foreground",
    StrokeStyle.MARKED: "text-secondary",
    StrokeStyle.THIN: "text-primary",
    StrokeStyle.THICK: "text-accent",
    StrokeStyle.BEADED: "text-warning",
}

LABEL_CELLS = 7
"""Of a number below the drawing."""

LABELLED_ROWS = 3
"""So many rows for one number beside the drawing."""


class ChartPlot(PlotextPlot):
    """Draws a chart, or strokes and marks; nothing is drawn again that did not change."""

    def __init__(self, chart: Chart | None = None, plot_id: str | None = None) -> None:
        super().__init__(id=plot_id)
        self._chart = chart
        self._drawn: tuple[Chart | None, Size] | None = None
        self._picture: RenderResult = ""

    def on_mount(self) -> None:
        self.app.theme_changed_signal.subscribe(self, lambda _: self._take_colours())
        self._take_colours()

    def _take_colours(self) -> None:
        self.theme = "clear" if self._colour("foreground") == TERMINAL else "auto"
        self._drawn = None
        self.refresh()

    def show(self, chart: Chart) -> None:
        """Draw this chart unless it is shown already."""
        if chart != self._chart:
            self._chart = chart
            self.refresh()

    def follow(self, chart: Chart) -> None:
        """Show a chart whose values move: the scale of before stays, and only grows."""
        self.show(chart if self._chart is None else chart.as_tall_as(self._chart))

    def render(self) -> RenderResult:
        """The picture of before where chart, size and theme are those of before."""
        if self._chart is None:
            return ""
        wanted = (self._chart, self.size)
        if wanted != self._drawn:
            self._draw(self._chart)
            self._picture, self._drawn = super().render(), wanted
        return self._picture

    def _draw(self, chart: Chart) -> None:
        plot = self.plt
        plot.clear_figure()
        if isinstance(chart, Drawing):
            self._draw_strokes(chart)
            return
        if not chart.series:
            plot.title(f"{chart.heading}: {NOTHING}")
            return
        plot.title(chart.heading)
        plot.xlabel(self._legend(chart))
        if self._on_its_side(chart):
            self._scale_on_side(chart)
            self._points(turned(chart, self._rows).series)
            return
        self._scale_upright(chart)
        columns = self._columns
        self._points(chart.series if chart.x_names else [thinned(s, columns) for s in chart.series])

    @property
    def _columns(self) -> int:
        return self.size.width - FRAME_COLUMNS

    def _columns_beside(self, labels: Sequence[str]) -> int:
        return self.size.width - max(map(len, labels)) - FRAME

    @property
    def _rows(self) -> int:
        return self.size.height - FRAME_ROWS

    def _on_its_side(self, chart: Chart) -> bool:
        """Names that do not fit beside each other stand below each other, given the rows."""
        narrow = self._columns < len(chart.x_names) * chart.x_label_cells
        return narrow and self._rows >= len(chart.x_names)

    def _legend(self, chart: Chart) -> str:
        marked = zip(MARKERS, chart.series, strict=False)
        legend = "   ".join(f"{marker} {series.name}" for marker, series in marked)
        whole = f"{chart.x_words}   {legend}" if chart.x_words else legend
        return whole if len(whole) <= self.size.width else legend

    def _scale_upright(self, chart: Chart) -> None:
        plot, ticks = self.plt, chart.y_ticks()
        plot.ylim(*even_limits(ticks, self._rows))
        labelled = spread(ticks, self._rows, 2)
        labels = tick_labels(labelled)
        plot.yticks(list(labelled), labels)
        lower, upper = chart.x_limits(self._columns_beside(labels))
        plot.xlim(lower, upper)
        places = spread(chart.x_ticks(), self._columns, chart.x_label_cells)
        plot.xticks(list(places), chart.x_labels(places))
        plot.plot([lower, upper], [0.0, 0.0], marker="─", color=self._colour("foreground"))
        for mark in chart.marks:
            plot.plot(
                [mark, mark], [ticks[0], ticks[-1]], marker="│", color=self._colour("foreground")
            )

    def _scale_on_side(self, chart: Chart) -> None:
        plot, ticks = self.plt, chart.y_ticks()
        plot.xlim(*even_limits(ticks, self._columns_beside(chart.x_names)))
        labelled = spread(ticks, self._columns, label_cells(tick_labels(ticks)))
        plot.xticks(list(labelled), tick_labels(labelled))
        lower, upper = turned_limits(len(chart.x_names), self._rows)
        plot.ylim(lower, upper)
        plot.yticks(list(chart.x_ticks()), list(reversed(chart.x_names)))
        plot.plot([0.0, 0.0], [lower, upper], marker="│", color=self._colour("foreground"))

    def _points(self, several: Iterable[Series]) -> None:
        for series, marker, name in zip(several, MARKERS, COLOURS, strict=False):
            colour = self._colour(name)
            self.plt.scatter(list(series.x), list(series.y), marker=marker, color=colour)

    def _draw_strokes(self, chart: Drawing) -> None:
        self.plt.title(chart.heading)
        self.plt.xlabel(self._legend(chart))
        self._scale_drawing(chart)
        for stroke in chart.strokes:
            x, y = ([point[k] for point in stroke.points] for k in (0, 1))
            colour = self._colour(STROKE_COLOURS[stroke.style])
            if stroke.style in LINES:
                self.plt.plot(x, y, marker=LINES[stroke.style], color=colour)
            else:
                self.plt.scatter(x, y, marker=DOTS[stroke.style], color=colour)
        self._points(chart.series)
        words, ground = self._colour("foreground"), self._colour("surface")
        for label in chart.labels:
            self.plt.text(label.words, *label.at, color=words, background=ground)

    def _scale_drawing(self, chart: Drawing) -> None:
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

    def _colour(self, variable: str) -> tuple[int, int, int] | str:
        """Its own colour where the terminal chooses colours itself: then shape alone tells."""
        colour = Color.parse(self.app.theme_variables[variable])
        return colour.rgb if colour.ansi is None else TERMINAL
