"""Figures of the report and of notebooks, by matplotlib: the same bytes for the same data."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from io import StringIO
from itertools import groupby
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.markers import MarkerStyle
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from matplotlib.quiver import Quiver
from matplotlib.transforms import Affine2D

from app.evaluating.solution import BudgetShare
from app.report.charts.charts import NOISE, Chart, Drawing, Series, StrokeStyle, thinned
from app.report.charts.legs import DOWN, FIRST, OTHER, UP, LegFigure
from calib.arrays import FloatArray
from calib.diagnosis.results import SEEN
from calib.diagnosis.vectors import VectorMap
from calib.tripod.workspace import PlaneMap

STYLE: dict[Any, Any] = {
    "svg.hashsalt": "glidecal",  # names inside the file by its contents, not by chance
    "svg.fonttype": "none",  # letters stay letters: half the work for the PDF
    "font.sans-serif": ["DejaVu Sans", "Verdana"],  # each text names them all
    "text.parse_math": False,
    "font.size": 8.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "xtick.major.size": 0.0,  # the grid tells the places
    "ytick.major.size": 0.0,
    "grid.color": "0.9",
}
COLOURS = ("#1b6ca8", "#c8501e", "#3a7d44", "#7a4fa0", "#8a6d1d", "#555555")
MARKERS = "8sD^vP"
"""A series is told by its marker where a printer has no colours; an octagon so small is a disc to
the eye and takes a third of its bytes.
"""

WIDTH_IN, HEIGHT_IN = 6.9, 2.5  # A4 less the margins of report.html is 7.0 wide
BAR = 0.22

Point = tuple[float, float]

LEGS_IN = 3.6
"""Height of a row of legs with what is left of their readings."""

SMALL_IN, FEW_COLUMNS, MANY_COLUMNS = 0.52, 3, 4
"""Height of a row of the sheet of all legs; pictures beside each other up to six, and above."""

LEFT_IN, RIGHT_IN, BOTTOM_IN, TOP_IN = 0.76, 0.06, 0.44, 0.26
BESIDE_IN, BELOW_IN = 0.62, 0.4
"""Room between axes, for the words at them."""
ROW_IN = 0.19
"""A row of a legend, or of horizontal bars."""

IN_A_ROW, MARKED_IN = 6, 0.27
"""Most names of series in a row of a legend, and room beside the letters of each."""

MOST_LETTERS, LETTER_IN = 100, 0.055
"""Of names beside each other below a chart; more of them stand upright, each letter so high."""

STEPS_OF_COLOUR = 12
"""Of more, matplotlib makes a scale of pixels."""

SCALE_IN = 0.7
"""Room at the right for a scale of colours."""

PALEST = 1.2
"""Colours of arrows end so far above the longest: the palest would not be seen on paper."""

DARKEST = 1.8
"""The colours end so far above the largest error: digits stay readable on all of them."""

WHOLE_UM = 20.0
"""From this size on tenths of a micrometre are not worth a digit."""


def svg_of(chart: Chart) -> str:
    """A chart of points; a grey field is noise."""
    visible = [series for series in chart.series if series.name != NOISE]
    columns = _columns([series.name for series in visible])
    more_in = ROW_IN * ((len(visible) - 1) // columns)
    with _figure(WIDTH_IN, HEIGHT_IN + more_in, top_in=TOP_IN + more_in) as ((axes,), out):
        for series in chart.series:
            if series.name == NOISE:
                _band(axes, series)
        for stroke in chart.strokes:
            axes.plot(*zip(*stroke.points, strict=True), **CURVES[stroke.style])
        points: list[Line2D] = []
        for number, series in enumerate(visible):
            marker, colour = MARKERS[number % len(MARKERS)], COLOURS[number % len(COLOURS)]
            points += axes.plot(series.x, series.y, marker, ms=3, label=series.name, color=colour)
        axes.axhline(0.0, color="0.4", lw=0.6)
        axes.set(xlabel=chart.x_words, ylabel=chart.y_words)
        _name_places(axes, chart)
        _legend(axes, columns)
        _merge_points(axes, points)
    return out.getvalue()


def legs_svg(figures: Sequence[LegFigure]) -> str:
    """Up to three legs or axes beside each other, what is left of the readings below each."""
    columns, top_in = max(2, len(figures)), TOP_IN + 1.2 * ROW_IN
    with _figure(WIDTH_IN, LEGS_IN, columns, rows=2, top_in=top_in) as (all_axes, out):
        for column, axes in enumerate(all_axes[:columns]):
            below = all_axes[columns + column]
            if column < len(figures):
                draw_leg(figures[column], axes, below)
                _merge_legs(axes, below)
            else:
                axes.set_axis_off()
                below.set_axis_off()
        all_axes[0].figure.legend(
            *all_axes[0].get_legend_handles_labels(),
            frameon=False,
            ncols=IN_A_ROW,
            loc="upper left",
            borderaxespad=0.0,
            handletextpad=0.1,
            columnspacing=1.2,
        )
    return out.getvalue()


def leg_sheet_svg(figures: Sequence[LegFigure]) -> str:
    """All legs and axes small on one sheet, what is left of the readings below each.

    Scales stand at the edges of the sheet alone: all pictures have the same.
    """
    most_columns = FEW_COLUMNS if len(figures) <= 2 * FEW_COLUMNS else MANY_COLUMNS
    columns = min(len(figures), most_columns)
    rows = 2 * math.ceil(len(figures) / columns)
    room = {"left_in": 0.5, "top_in": 0.14, "bottom_in": 0.3, "beside_in": 0.12, "below_in": 0.16}
    height_in = room["top_in"] + room["bottom_in"] + rows * SMALL_IN
    with _figure(WIDTH_IN, height_in, columns, rows, **room) as (all_axes, out):
        for number in range(rows // 2 * columns):
            row, column = divmod(number, columns)
            above, below = (all_axes[(2 * row + k) * columns + column] for k in (0, 1))
            if number >= len(figures):
                above.set_axis_off()
                below.set_axis_off()
                continue
            leg = figures[number]
            draw_leg(leg, above, below)
            above.set_title(leg.short_title, loc="left", size=6.0, pad=2.0)
            below.set_title("", loc="left")
            lowest = number + columns >= len(figures)
            _merge_legs(above, below)
            for axes in (above, below):
                if not (lowest and axes is below):
                    axes.set_xticks([])  # most of the time of a small picture goes into its ticks
                axes.tick_params(labelsize=6.0, labelleft=column == 0, pad=1.0)
                axes.set_ylabel(axes.get_ylabel() if column == 0 else "", size=6.0)
                axes.set_xlabel(axes.get_xlabel() if lowest else "", size=6.0)
    return out.getvalue()


def draw_leg(leg: LegFigure, above: Axes, below: Axes) -> None:
    """Readings and what is left of them on any two axes of matplotlib, of one height.

    Their scales are those of the other pictures of the session.
    """
    for axes, chart in zip((above, below), leg.charts, strict=True):
        for stroke in chart.strokes:
            if len(stroke.points) <= MOST_POINTS:
                axes.plot(*zip(*stroke.points, strict=True), **CURVES[stroke.style])
        for part in chart.series:
            series = part if len(part.x) <= MOST_POINTS else thinned(part, MOST_POINTS // 2)
            axes.plot(series.x, series.y, **POINTS[series.mark], label=series.name or None)
        axes.axhline(0.0, color="0.4", lw=0.6)
        for place in chart.marks:
            axes.axvline(place, color="0.4", lw=0.6)
        ticks = chart.y_ticks()
        axes.set_ylim(ticks[0], ticks[-1])
        axes.set_title(chart.title, loc="left", size=7.5)
        axes.set(xlabel=chart.x_words, ylabel=chart.y_words)
        axes.locator_params(axis="x", integer=True)  # no half numbers of positions


def _merge_legs(*pair: Axes) -> None:
    """One path for the points of each series of a leg."""
    for axes in pair:
        _merge_points(axes, [line for line in axes.lines if line.get_marker() in POINTS])


def _merge_points(axes: Axes, lines: Sequence[Line2D]) -> None:
    """Put one path in the place of all points of a series, each where it has been."""
    axes.set(xlim=axes.get_xlim(), ylim=axes.get_ylim())  # places in inches hold with these only
    inches = axes.figure.dpi_scale_trans
    for line in lines:
        marker, size_in = MarkerStyle(line.get_marker()), line.get_markersize() / 72.0
        shape = marker.get_path().transformed(marker.get_transform() + Affine2D().scale(size_in))
        places = (axes.transData - inches).transform(line.get_xydata())
        path = Path.make_compound_path(
            *(shape.transformed(Affine2D().translate(*at)) for at in places)
        )
        axes.add_patch(
            PathPatch(
                path,
                fc=line.get_markerfacecolor(),
                ec=line.get_color(),
                lw=line.get_markeredgewidth(),
                joinstyle="round",
                transform=inches,
            )
        )
        line.set_data([], [])


def bars_svg(chart: Chart) -> str:
    """Two series in mm as bars beside each other, and below the second by itself in µm.

    Whiskers reach two standard uncertainties up and down.
    """
    second, longest = chart.series[1], max(map(len, chart.x_names))
    crowded = longest * len(chart.x_names) > MOST_LETTERS
    more_in = LETTER_IN * longest if crowded else 0.0
    size_in = WIDTH_IN, 1.6 * HEIGHT_IN + more_in
    with _figure(*size_in, rows=2, bottom_in=BOTTOM_IN + more_in) as ((together, alone), out):
        for series, colour in zip(chart.series, COLOURS, strict=False):
            _bars(together, series, colour)
        in_um = replace(
            second, y=tuple(1000.0 * mm for mm in second.y), u=tuple(1000.0 * mm for mm in second.u)
        )
        _bars(alone, in_um, COLOURS[1])
        together.set(ylabel=f"{chart.title}, mm")
        alone.set(ylabel=f"{second.name}, µm")
        for axes in (together, alone):
            axes.axhline(0.0, color="0.4", lw=0.6)
            _name_places(axes, chart)
        if crowded:
            together.tick_params(labelbottom=False)
            alone.tick_params(axis="x", rotation=90)
        _legend(together)
    return out.getvalue()


def _bars(axes: Axes, series: Series, colour: str) -> None:
    half, cap = 0.5 * BAR, 0.2 * BAR
    places = list(zip(series.x, series.y, strict=True))
    axes.fill(
        *_as_one(_rectangle(x - half, x + half, 0.0, y) for x, y in places),
        label=series.name,
        color=colour,
        lw=0,
    )
    whiskers = [(x, y - SEEN * u, y + SEEN * u) for (x, y), u in zip(places, series.u, strict=True)]
    lines = [((x, low), (x, high)) for x, low, high in whiskers]
    lines += [((x - cap, y), (x + cap, y)) for x, *ends in whiskers for y in ends]
    axes.plot(*_as_one(lines), color="0.1", lw=0.8)


def _rectangle(first: float, last: float, low: float, high: float) -> tuple[Point, ...]:
    return (first, low), (last, low), (last, high), (first, high)


def _as_one(shapes: Iterable[Sequence[Point]]) -> tuple[list[float], list[float]]:
    """One path with gaps. A path, or a point, by itself costs the PDF a millisecond."""
    points = [point for shape in shapes for point in (*shape, (math.nan, math.nan))]
    return [x for x, _ in points], [y for _, y in points]


def _name_places(axes: Axes, chart: Chart) -> None:
    if chart.x_names:
        axes.set_xticks(chart.x_ticks(), chart.x_names)
        axes.set_xlim(0.4, len(chart.x_names) + 0.6)
        axes.grid(visible=False, axis="x")
    elif chart.x_room:
        axes.update_datalim([(x, 0.0) for x in chart.x_room])
        axes.autoscale_view(scaley=False)


def _columns(names: Sequence[str]) -> int:
    """Names for which a row of a legend has room."""
    each_in = MARKED_IN + LETTER_IN * max(map(len, names), default=0)
    return max(1, min(IN_A_ROW, int((WIDTH_IN - LEFT_IN - RIGHT_IN) / each_in)))


def _legend(axes: Axes, columns: int = IN_A_ROW) -> None:
    axes.legend(
        frameon=False,
        ncols=columns,
        handlelength=1.0,
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        borderaxespad=0.1,
        handletextpad=0.3,
        columnspacing=1.2,
    )


def _band(axes: Axes, series: Series) -> None:
    """Noise: a grey field at each place, as wide as its points."""
    points, fields = sorted(zip(series.x, series.y, strict=True)), []
    for _, column_points in groupby(points, key=lambda point: round(point[0])):
        x, y = zip(*column_points, strict=True)
        fields.append(_rectangle(min(x), max(x), min(y), max(y)))
    axes.fill(*_as_one(fields), color="0.88", lw=0)


def evidence_svg(left_um: Sequence[tuple[str, float, bool]], gap_um: float) -> str:
    """What each candidate, named or not, leaves of the gap, best first; the line is the gap."""
    height_in = BOTTOM_IN + TOP_IN + ROW_IN * len(left_um)
    with _figure(WIDTH_IN, height_in, left_in=1.9) as ((axes,), out):
        for is_named in (True, False):
            places = [k for k, (_, _, is_effect) in enumerate(left_um) if is_effect == is_named]
            if places:
                label = "named" if is_named else "not named"
                widths = [left_um[k][1] for k in places]
                axes.barh(places, widths, 0.6, label=label, color=COLOURS[1 if is_named else 0])
        axes.axvline(gap_um, color="0.1", lw=1.0, ls="--", label="gap without any of them")
        axes.set_yticks(range(len(left_um)), [name for name, _, _ in left_um])
        axes.grid(visible=False, axis="y")
        axes.set(xlabel="gap that is left, µm r.m.s.")
        axes.set_xlim(0.0)
        axes.invert_yaxis()
        _legend(axes)
    return out.getvalue()


def maps_svg(maps: Sequence[PlaneMap]) -> str:
    """Planes of the workspace beside each other, the error of the tool in µm as colour and digits.

    All have one scale, from 0. A dash stands where the tool does not reach.
    """
    values = [v for plane in maps for row in plane.value.tolist() for v in row if math.isfinite(v)]
    most_um = 1000.0 * max(values)
    decimals = 0 if most_um >= WHOLE_UM else 1
    height_in = WIDTH_IN / len(maps)
    with _figure(WIDTH_IN, height_in, len(maps), top_in=0.06) as (all_axes, out):
        for axes, plane in zip(all_axes, maps, strict=True):
            grid = [[1000.0 * value for value in row] for row in plane.value.tolist()]
            axes.pcolormesh(
                plane.coordinate_mm,
                plane.up_mm,
                grid,
                cmap="YlOrRd",
                vmin=0.0,
                vmax=DARKEST * most_um,
            )
            cells = [
                [f"{um:.{decimals}f}" if math.isfinite(um) else "–" for um in row] for row in grid
            ]
            _write_cells(axes, plane.coordinate_mm.tolist(), plane.up_mm.tolist(), cells)
            axes.grid(visible=False)
            axes.set(xlabel=f"{plane.across}, mm", ylabel=f"{plane.up}, mm", aspect="equal")
    return out.getvalue()


def _write_cells(
    axes: Axes, across: Sequence[float], up: Sequence[float], cells: Sequence[Sequence[str]]
) -> None:
    """Small words in the middle of each cell, by rows."""
    for y, row in zip(up, cells, strict=True):
        for x, cell in zip(across, row, strict=True):
            axes.text(x, y, cell, ha="center", va="center", size=6)


def correlations_svg(names: Sequence[str], correlation: FloatArray) -> str:
    """Correlation coefficients ``(k, k)`` of named parameters, as colour and digits."""
    coefficients, places = correlation.tolist(), [k + 0.5 for k in range(len(names))]
    cells = [[f"{value:+z.2f}" for value in row] for row in coefficients]
    for k, row in enumerate(cells):
        row[k] = "1"
    height_in = BOTTOM_IN + ROW_IN * len(names)
    with _figure(WIDTH_IN, height_in, left_in=1.2, top_in=0.06) as ((axes,), out):
        axes.pcolormesh(coefficients, cmap="RdBu_r", vmin=-DARKEST, vmax=DARKEST)
        _write_cells(axes, places, places, cells)
        axes.set_xticks(places, names, size=6)
        axes.set_yticks(places, names)
        axes.invert_yaxis()
        axes.grid(visible=False)
    return out.getvalue()


MOST_POINTS = 400
"""Of more in a series of a leg the lowest and the highest of each place are drawn, and no way."""

CURVES: dict[StrokeStyle, dict[str, Any]] = {
    StrokeStyle.THIN: {"lw": 1.0, "color": "0.3"},
    StrokeStyle.DOTTED: {"lw": 0.4, "color": "0.75"},
}
"""The fit, and the way through the readings in time."""

POINTS: dict[str, dict[str, Any]] = {
    mark: {"ls": "none", "marker": mark, "ms": 3.5, "mew": 0.8, "color": colour, "mfc": fill}
    for mark, colour, fill in (
        (UP, COLOURS[0], COLOURS[0]),
        (DOWN, COLOURS[1], "white"),
        (FIRST, "0.1", "none"),
        (OTHER, COLOURS[2], COLOURS[2]),
    )
}
"""Told by shape, and by filled and hollow, where there are no colours."""


def pareto_svg(shares: Sequence[BudgetShare]) -> str:
    """Sources of uncertainty, the largest first, in µm; a line is their share so far."""
    height_in = BOTTOM_IN + TOP_IN + ROW_IN * (2 + len(shares))
    with _figure(WIDTH_IN, height_in, left_in=1.9, top_in=TOP_IN + ROW_IN) as ((axes,), out):
        rows = range(len(shares))
        axes.barh(rows, [1000.0 * share.expanded_mm for share in shares], 0.6, color=COLOURS[0])
        axes.set_yticks(rows, [share.source for share in shares])
        axes.invert_yaxis()
        axes.grid(visible=False, axis="y")
        axes.set(xlabel="± (95 %), µm, r.m.s. of the parameters")
        axes.set_xlim(0.0, 1150.0 * shares[0].expanded_mm)
        share_axes = axes.twiny()
        together = [100.0 * share.cumulative for share in shares]
        share_axes.plot(together, rows, "o-", color=COLOURS[1], ms=3, lw=1.0)
        for row, percent in zip(rows, together, strict=True):
            label = f"{percent:.0f} %"
            ground = {"facecolor": "white", "edgecolor": "none", "pad": 0.6}
            place = (percent, row), (6, -3)
            share_axes.annotate(label, *place, textcoords="offset points", bbox=ground)
        share_axes.grid(visible=False)
        share_axes.set(xlim=(0.0, 115.0), xlabel="share of the square of U together, %")
    return out.getvalue()


def vectors_svg(maps: Sequence[tuple[str, Sequence[VectorMap]]]) -> str:
    """Planes of the workspace, a row of them for each state: errors of the tool as arrows.

    Length and colour have one scale; the colour is the length of the whole error, also of the part
    that points out of the plane.
    """
    lengths = [
        mm for _, row in maps for plane in row for row_mm in plane.length.tolist() for mm in row_mm
    ]
    most_um = 1000.0 * max(mm for mm in lengths if math.isfinite(mm))
    columns = max(len(row) for _, row in maps)
    height_in = 0.95 * WIDTH_IN / columns * len(maps)
    with _figure(WIDTH_IN, height_in, columns, len(maps), right_in=SCALE_IN) as (all_axes, out):
        arrows: list[Quiver] = []
        for number, axes in enumerate(all_axes):
            label, row = maps[number // columns]
            plane = row[number % columns]
            across, up = plane.along_across, plane.along_up
            quiver = axes.quiver(
                across.coordinate_mm,
                across.up_mm,
                1000.0 * across.value,
                1000.0 * up.value,
                1000.0 * plane.length,
                cmap=mpl.colormaps["plasma"].resampled(STEPS_OF_COLOUR),
                clim=(0.0, PALEST * most_um),
                angles="xy",
                pivot="mid",
                width=0.012,
                scale_units="width",
                scale=4.0 * most_um,
            )
            arrows.append(quiver)
            axes.set(xlabel=f"{across.across}, mm", ylabel=f"{across.up}, mm", aspect="equal")
            axes.margins(0.15)
            if number % columns == 0:
                axes.set_title(label, loc="left", size=7.5)
        scale_axes = all_axes[0].figure.add_axes((1.0 - 0.8 * SCALE_IN / WIDTH_IN, 0.2, 0.012, 0.6))
        all_axes[0].figure.colorbar(arrows[0], cax=scale_axes, label="µm")
    return out.getvalue()


STROKES: dict[StrokeStyle, dict[str, Any]] = {
    StrokeStyle.DOTTED: {"lw": 0.7, "ls": ":", "color": "0.4"},
    StrokeStyle.THIN: {"lw": 0.7, "color": "0.3"},
    StrokeStyle.THICK: {"lw": 2.2, "color": "0.1"},
    StrokeStyle.MARKED: {"lw": 0.7, "color": "0.1", "marker": "o", "ms": 2},
    StrokeStyle.BEADED: {"lw": 1.6, "color": COLOURS[1], "marker": "o", "ms": 2},
}


def drawings_svg(drawings: Sequence[Drawing]) -> str:
    """Pictures without scales beside each other."""
    columns = max(3, len(drawings))
    height_in = WIDTH_IN / columns
    with _figure(WIDTH_IN, height_in, columns, bottom_in=0.02, left_in=0.02) as (all_axes, out):
        for axes, drawing in zip(all_axes, drawings, strict=False):
            for stroke in drawing.strokes:
                axes.plot(*zip(*stroke.points, strict=True), **STROKES[stroke.style])
            for label in drawing.labels:
                ground = {"facecolor": "white", "edgecolor": "none", "pad": 0.6}
                axes.text(*label.at, label.words, ha="center", va="center", size=7, bbox=ground)
            axes.set_aspect("equal")
            axes.set_title(drawing.title, size=7)
        for axes in all_axes:
            axes.set_axis_off()
    return out.getvalue()


@contextmanager
def _figure(
    width_in: float,
    height_in: float,
    columns: int = 1,
    rows: int = 1,
    *,
    left_in: float = LEFT_IN,
    bottom_in: float = BOTTOM_IN,
    top_in: float = TOP_IN,
    right_in: float = RIGHT_IN,
    beside_in: float = BESIDE_IN,
    below_in: float = BELOW_IN,
) -> Iterator[tuple[list[Axes], StringIO]]:
    """Axes to draw on, beside or below each other; the SVG is there once they are done."""
    out = StringIO()
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(width_in, height_in))
        # a layout worked out by matplotlib would draw everything twice
        figure.subplots_adjust(
            left=left_in / width_in,
            right=1.0 - right_in / width_in,
            bottom=bottom_in / height_in,
            top=1.0 - top_in / height_in,
            wspace=_room(beside_in, columns, width_in - left_in - right_in),
            hspace=_room(below_in, rows, height_in - bottom_in - top_in),
        )
        yield [figure.add_subplot(rows, columns, 1 + k) for k in range(rows * columns)], out
        figure.savefig(
            out, format="svg", metadata=dict.fromkeys(("Date", "Creator", "Type", "Format"))
        )


def _room(each_in: float, count: int, whole_in: float) -> float:
    """Room between so many axes as matplotlib counts it: in widths of one."""
    return each_in * count / (whole_in - each_in * (count - 1))
