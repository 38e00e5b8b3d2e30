"""Charts and maps as SVG, the same bytes for the same numbers."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from io import StringIO
from itertools import groupby
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from app.report.charts.charts import NOISE, Chart, Series
from calib.tripod.workspace import PlaneMap

STYLE: dict[Any, Any] = {
    "svg.hashsalt": "glidecal",  # names inside the file by its contents, not by chance
    "svg.fonttype": "path",  # looks alike where the fonts are others
    "text.parse_math": False,
    "font.size": 8.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "0.9",
}
COLOURS = ("#1b6ca8", "#c8501e", "#3a7d44", "#7a4fa0", "#8a6d1d", "#555555")
MARKERS = "osD^vP"
"""A series is told by its marker where a printer has no colours."""

WIDTH_IN, HEIGHT_IN = 6.6, 2.6
BAR = 0.22

DARKEST = 1.8
"""The colours end so far above the largest error: digits stay readable on all of them."""

WHOLE_UM = 20.0
"""From this size on tenths of a micrometre are not worth a digit."""


def svg_of(chart: Chart) -> str:
    """A chart of series; bars where the places have names and a series one value at each."""
    with _figure(WIDTH_IN, HEIGHT_IN) as ((axes,), out):
        shown = [series for series in chart.series if series.name != NOISE]
        for series in chart.series:
            if series.name == NOISE:
                _band(axes, series)
        barred = all(len(series.x) <= len(chart.x_names) for series in shown)
        for number, series in enumerate(shown):
            colour = COLOURS[number % len(COLOURS)]
            if barred:
                axes.bar(series.x, series.y, BAR, label=series.name, color=colour)
            else:
                marker = MARKERS[number % len(MARKERS)]
                axes.plot(series.x, series.y, marker, ms=3, label=series.name, color=colour)
        axes.axhline(0.0, color="0.4", lw=0.6)
        axes.set(xlabel=chart.x_words, ylabel=chart.y_words)
        if chart.x_names:
            axes.set_xticks(chart.x_ticks(), chart.x_names)
            axes.grid(visible=False, axis="x")
        axes.legend(frameon=False, ncols=3, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    return out.getvalue()


def _band(axes: Axes, series: Series) -> None:
    """Noise: a grey field at each place, as wide as its points."""
    points = sorted(zip(series.x, series.y, strict=True))
    for _, some in groupby(points, key=lambda point: round(point[0])):
        x, y = zip(*some, strict=True)
        axes.fill_between((min(x), max(x)), min(y), max(y), color="0.88", lw=0)


def maps_svg(maps: Sequence[PlaneMap]) -> str:
    """Planes of the workspace beside each other, the error of the tool in µm as colour and digits.

    All have one scale, from 0. A dash stands where the tool does not reach.
    """
    told = [v for one in maps for row in one.value.tolist() for v in row if math.isfinite(v)]
    most_um = 1000.0 * max(told)
    decimals = 0 if most_um >= WHOLE_UM else 1
    with _figure(WIDTH_IN, WIDTH_IN / len(maps), len(maps)) as (every, out):
        for axes, one in zip(every, maps, strict=True):
            grid = [[1000.0 * value for value in row] for row in one.value.tolist()]
            axes.pcolormesh(
                one.coordinate_mm, one.up_mm, grid, cmap="YlOrRd", vmin=0.0, vmax=DARKEST * most_um
            )
            for up_mm, row in zip(one.up_mm.tolist(), grid, strict=True):
                for across_mm, value in zip(one.coordinate_mm.tolist(), row, strict=True):
                    shown = f"{value:.{decimals}f}" if math.isfinite(value) else "–"
                    axes.text(across_mm, up_mm, shown, ha="center", va="center", size=6)
            axes.grid(visible=False)
            axes.set(xlabel=f"{one.across}, mm", ylabel=f"{one.up}, mm", aspect="equal")
    return out.getvalue()


@contextmanager
def _figure(
    width_in: float, height_in: float, columns: int = 1
) -> Iterator[tuple[list[Axes], StringIO]]:
    """Axes to draw on, beside each other; the SVG is there once they are done."""
    out = StringIO()
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(width_in, height_in), layout="constrained")
        yield [figure.add_subplot(1, columns, 1 + k) for k in range(columns)], out
        figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None})
