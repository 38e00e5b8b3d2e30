"""Charts as characters, by plotext: for a screen in its colours, and as plain text."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from app.report.charts.charts import (
    CUT,
    Chart,
    Drawing,
    Series,
    StrokeStyle,
    even_limits,
    grouped,
    label_cells,
    spread,
    thinned,
    tick_labels,
    ticks_within,
    turned,
    turned_limits,
)
from app.report.charts.legs import LegFigure
from app.report.text.tables import WIDTH

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

BLANK = "\u2800"
"""Of Braille without dots: plotext takes blanks for no word."""

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

LEG_ROWS = 12
"""Of the readings of a leg, and as many of what is left: both fit a terminal."""

Colour = tuple[int, int, int] | str


def chart_text(chart: Chart, rows: int, columns: int = WIDTH) -> str:
    """A chart in so many rows and columns of plain text, without blank edges at the right."""
    import plotext  # only where text is drawn

    Canvas(plotext, columns, rows, lambda _: TERMINAL).draw(chart)
    plotext.limit_size(False, False)  # as wide in a narrow terminal and in a file
    plotext.plot_size(columns, rows)
    plotext.theme("clear")
    text: str = plotext.uncolorize(plotext.build())
    return "\n".join(line.rstrip() for line in text.rstrip("\n").splitlines())


def legs_text(legs: Sequence[LegFigure], rows: int = LEG_ROWS) -> str:
    """Pictures of legs below each other, each part in so many rows."""
    return "\n\n".join("\n".join(chart_text(chart, rows) for chart in leg.charts) for leg in legs)


@dataclass(frozen=True)
class Canvas:
    """A figure of plotext with so many cells, and the colours for variables of a theme."""

    plot: Any
    width: int
    height: int
    colour: Callable[[str], Colour]

    def draw(self, chart: Chart) -> None:
        """Draw the chart in the place of what was there."""
        plot = self.plot
        plot.clear_figure()
        if isinstance(chart, Drawing):
            self._draw_in_space(chart)
            return
        if not chart.series:
            room = self.width - FRAME - len(f": {NOTHING}")
            plot.title(f"{chart.heading_within(room)}: {NOTHING}")
            return
        chart = self._named(chart)
        if self._on_its_side(chart):
            self._scale_on_side(chart)
            self._points(turned(chart, self._rows).series)
            return
        self._scale_upright(chart)
        self._strokes(chart)
        columns = self._columns
        self._points(chart.series if chart.x_names else [thinned(s, columns) for s in chart.series])

    @property
    def _columns(self) -> int:
        return self.width - FRAME_COLUMNS

    def _columns_beside(self, labels: Sequence[str]) -> int:
        return self.width - max(map(len, labels)) - FRAME

    @property
    def _rows(self) -> int:
        return self.height - FRAME_ROWS

    def _narrow(self, chart: Chart) -> bool:
        return bool(chart.x_names) and len(chart.x_names) * chart.x_label_cells > self._columns

    def _on_its_side(self, chart: Chart) -> bool:
        """Names that do not fit beside each other stand below each other, given the rows."""
        return self._narrow(chart) and self._rows >= len(chart.x_names)

    def _named(self, chart: Chart) -> Chart:
        """The chart with names of groups where those of places fit in neither way."""
        if not chart.x_groups or not self._narrow(chart) or self._on_its_side(chart):
            return chart
        of_groups = grouped(chart)
        return chart if self._narrow(of_groups) else of_groups

    def _say(self, chart: Chart, notes: Sequence[str] = ()) -> None:
        """Title and legend; plotext leaves out what it cannot centre between the numbers.

        With a word above the drawing, here a blank one, a title begins at the edge.
        """
        room = self.width - max(map(len, notes), default=0)
        self.plot.xlabel(self._legend(chart, room))
        if len(chart.heading) > room:
            self.plot.xlabel(BLANK, xside="upper")
        self.plot.title(chart.heading_within(self.width))

    def _legend(self, chart: Chart, room: int) -> str:
        marked = zip(marks_of(chart.series, MARKERS), chart.series, strict=True)
        legend = "   ".join(f"{marker} {series.name}" for marker, series in marked if series.name)
        legend_line = f"{chart.x_words}   {legend}" if chart.x_words else legend
        line = legend_line if len(legend_line) <= room else legend
        return line if len(line) <= room else line[: room - len(CUT)] + CUT

    def _scale_upright(self, chart: Chart) -> None:
        plot, ticks = self.plot, chart.y_ticks()
        plot.ylim(*even_limits(ticks, self._rows))
        labelled = spread(ticks, self._rows, 2)
        labels = tick_labels(labelled)
        self._say(chart, labels)
        plot.yticks(list(labelled), labels)
        lower, upper = chart.x_limits(self._columns_beside(labels))
        plot.xlim(lower, upper)
        places = spread(chart.x_ticks(), self._columns, chart.x_label_cells)
        plot.xticks(list(places), chart.x_labels(places))
        plot.plot([lower, upper], [0.0, 0.0], marker="─", color=self.colour("foreground"))
        for mark in chart.marks:
            plot.plot(
                [mark, mark], [ticks[0], ticks[-1]], marker="│", color=self.colour("foreground")
            )

    def _scale_on_side(self, chart: Chart) -> None:
        plot, ticks = self.plot, chart.y_ticks()
        self._say(chart, chart.x_names)
        plot.xlim(*even_limits(ticks, self._columns_beside(chart.x_names)))
        labelled = spread(ticks, self._columns, label_cells(tick_labels(ticks)))
        plot.xticks(list(labelled), tick_labels(labelled))
        lower, upper = turned_limits(len(chart.x_names), self._rows)
        plot.ylim(lower, upper)
        plot.yticks(list(chart.x_ticks()), list(reversed(chart.x_names)))
        plot.plot([0.0, 0.0], [lower, upper], marker="│", color=self.colour("foreground"))

    def _points(self, several: Iterable[Series]) -> None:
        series = list(several)
        marks = marks_of(series, MARKERS)
        for points, marker, name in zip(series, marks, COLOURS, strict=False):
            colour = self.colour(name)
            self.plot.scatter(list(points.x), list(points.y), marker=marker, color=colour)

    def _strokes(self, chart: Chart) -> None:
        for stroke in chart.strokes:
            x, y = ([point[k] for point in stroke.points] for k in (0, 1))
            colour = self.colour(STROKE_COLOURS[stroke.style])
            if stroke.style in LINES:
                self.plot.plot(x, y, marker=LINES[stroke.style], color=colour)
            else:
                self.plot.scatter(x, y, marker=DOTS[stroke.style], color=colour)

    def _draw_in_space(self, chart: Drawing) -> None:
        self._scale_drawing(chart)
        self._strokes(chart)
        self._points(chart.series)
        text_colour, ground = self.colour("foreground"), self.colour("surface")
        for label in chart.labels:
            self.plot.text(label.words, *label.at, color=text_colour, background=ground)

    def _scale_drawing(self, chart: Drawing) -> None:
        plot, columns = self.plot, self._columns
        across, upwards = chart.limits(columns, self._rows)
        plot.xlim(*across)
        plot.ylim(*upwards)
        if not chart.scaled:
            self._say(chart)
            plot.frame(False)
            plot.xticks([])
            plot.yticks([])
            return
        ticks = ticks_within(across, max(2, columns // LABEL_CELLS))
        plot.xticks(list(ticks), tick_labels(ticks) if ticks else [])
        ticks = ticks_within(upwards, max(2, self._rows // LABELLED_ROWS))
        labels = tick_labels(ticks) if ticks else []
        self._say(chart, labels)
        plot.yticks(list(ticks), labels)


def marks_of(several: Sequence[Series], usual: Sequence[str]) -> list[str]:
    """The mark of each series: its own, or the next one of the usual."""
    return [series.mark or usual[k % len(usual)] for k, series in enumerate(several)]
