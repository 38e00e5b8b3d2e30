"""Charts and line drawings in the terminal."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from itertools import cycle

from textual.app import ComposeResult, RenderResult
from textual.color import Color
from textual.containers import Horizontal, Vertical
from textual.geometry import Size
from textual_plotext import PlotextPlot

from app.report.charts.characters import TERMINAL, Canvas, Colour
from app.report.charts.charts import Chart
from app.report.charts.legs import LegFigure


class ChartPlot(PlotextPlot):
    """Draws a chart, or strokes and marks; nothing is drawn again that did not change."""

    def __init__(self, chart: Chart | None = None, plot_id: str | None = None) -> None:
        super().__init__(id=plot_id)
        self.chart = chart
        self._drawn: tuple[Chart | None, Size] | None = None
        self._picture: RenderResult = ""

    def on_mount(self) -> None:
        self.app.theme_changed_signal.subscribe(self, lambda _: self._take_colours())
        self._take_colours()

    def _take_colours(self) -> None:
        self.theme = "clear" if self._colour("foreground") == TERMINAL else "auto"
        self._drawn = None
        self.refresh()

    def _register_theme(self, app_theme_name: str) -> None:
        """Give the library the colours of the present theme.

        It keeps what a name had first, for good: those of the theme before where a plot comes
        between a change of the theme and that of the style sheet.
        """
        self.app.get_css_variables()
        super()._register_theme(self.app.theme)

    def show(self, chart: Chart) -> None:
        if chart != self.chart:
            self.chart = chart
            self.refresh()

    def follow(self, chart: Chart) -> None:
        """Show a chart whose values move: the scale of before stays, and only grows."""
        self.show(chart if self.chart is None else chart.as_tall_as(self.chart))

    def render(self) -> RenderResult:
        """The picture of before where chart, size and theme are those of before."""
        if self.chart is None:
            return ""
        key = (self.chart, self.size)
        if key != self._drawn:
            Canvas(self.plt, *self.size, self._colour).draw(self.chart)
            self._picture, self._drawn = super().render(), key
        return self._picture

    def _colour(self, variable: str) -> Colour:
        """A series' own colour where the terminal chooses colours: then shape alone tells."""
        colour = Color.parse(self.app.theme_variables[variable])
        return colour.rgb if colour.ansi is None else TERMINAL


class LegPlots(Horizontal):
    """Pictures of legs, one after the other; where there is room, the next one stands beside."""

    def __init__(self) -> None:
        super().__init__()
        self._legs = deque[LegFigure]()

    def compose(self) -> ComposeResult:
        for name in ("one", "beside"):
            yield Vertical(ChartPlot(), ChartPlot(), classes=name)

    def show(self, legs: Sequence[LegFigure]) -> None:
        self._legs.clear()
        for number, leg in enumerate(legs, 1):
            readings = replace(leg.readings, title=f"{leg.title} ({number} of {len(legs)})")
            self._legs.append(replace(leg, readings=readings))
        self.turn(0)

    def turn(self, by: int) -> None:
        self._legs.rotate(-by)
        for place, leg in zip(self.query(Vertical), cycle(self._legs), strict=False):
            for plot, chart in zip(place.query(ChartPlot), leg.charts, strict=True):
                plot.show(chart)
