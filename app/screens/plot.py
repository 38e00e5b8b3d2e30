"""A chart drawn in the terminal."""

from __future__ import annotations

from textual_plotext import PlotextPlot

from app.plots import Chart

MARKERS = ("x", "o", "+", "*")
"""Told apart by shape, not by colour alone."""


class ChartPlot(PlotextPlot):
    """Draws a chart; nothing is drawn again that did not change."""

    def __init__(self, chart: Chart | None = None, plot_id: str | None = None) -> None:
        super().__init__(id=plot_id)
        self._chart: Chart | None = None
        self._first = chart

    def on_mount(self) -> None:
        if self._first is not None:
            self.show(self._first)

    def show(self, chart: Chart) -> None:
        """Draw this chart unless it is shown already."""
        if chart == self._chart:
            return
        self._chart = chart
        plot = self.plt
        plot.clear_figure()
        plot.title(chart.title)
        plot.xlabel(chart.x_words)
        plot.ylabel(chart.y_words)
        for series, marker in zip(chart.series, MARKERS, strict=False):
            plot.scatter(list(series.x), list(series.y), label=series.name, marker=marker)
        if chart.x_names:
            plot.xticks(list(range(1, len(chart.x_names) + 1)), list(chart.x_names))
        if chart.series:
            plot.hline(0.0)
        self.refresh()
