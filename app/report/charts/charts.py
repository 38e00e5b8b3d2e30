"""What a plot is, apart from any screen: series, strokes, scales and their labels."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum

from calib.arrays import FloatArray

Point = tuple[float, float]
Limits = tuple[float, float]

MOST_TICKS = 6
LEAST_SPAN_MM = 0.004
"""A scale is not stretched over less: below stands the resolution of the indicators."""

NOISE = "noise"
"""The series that bounds what is noise."""

CELL_HEIGHT = 2.0
"""A cell of a terminal is about twice as high as it is wide."""

CUT, LEAST_NAME = "…", 2
"""What a title ends with that does not fit, and the fewest letters of a name that are left."""

MARGIN = 0.04
"""Room around what is drawn, as a share of it."""


class StrokeStyle(StrEnum):
    """How a stroke is drawn, told apart without colour."""

    DOTTED = "dotted"
    THIN = "thin"
    THICK = "thick"
    MARKED = "marked"
    BEADED = "beaded"


@dataclass(frozen=True)
class Stroke:
    """A line through points."""

    style: StrokeStyle
    points: tuple[Point, ...]


@dataclass(frozen=True)
class Series:
    """Points of one kind; ``names`` of the chart label ``x`` where it is not a length.

    ``u`` are standard uncertainties of ``y``, none where nobody shows them. ``mark`` is the
    character of a point, as matplotlib knows it, too; empty: the next one of those in use.
    """

    name: str
    x: tuple[float, ...]
    y: tuple[float, ...]
    u: tuple[float, ...] = ()
    mark: str = field(default="", kw_only=True)


@dataclass(frozen=True)
class Chart:
    """One plot: series over one horizontal axis with the words beside it, over ``strokes``.

    With ``x_names`` the places 1, 2, … of ``x`` carry names in the place of numbers, each its group
    and what it is within it; ``x_groups`` are the groups. ``marks`` are
    places of ``x`` with a line from top to bottom. The scales cover ``room`` and ``x_room``, too.
    """

    title: str
    x_words: str
    y_words: str
    series: tuple[Series, ...]
    x_names: tuple[str, ...] = ()
    x_groups: tuple[str, ...] = field(default=(), kw_only=True)
    marks: tuple[float, ...] = ()
    room: tuple[float, ...] = ()
    strokes: tuple[Stroke, ...] = ()
    x_room: tuple[float, ...] = field(default=(), kw_only=True)

    @property
    def heading(self) -> str:
        """The title with the unit of the values."""
        return f"{self.title}, {self.y_words}"

    def heading_within(self, cells: int) -> str:
        """The heading in so many cells: what is first in the title is cut, never the unit."""
        excess = len(self.heading) - cells + len(CUT)
        if excess <= len(CUT):
            return self.heading
        first, comma, rest_of_title = self.title.partition(", ")
        if len(first) - excess >= LEAST_NAME and comma:
            return f"{first[:-excess]}{CUT}, {rest_of_title}, {self.y_words}"
        return f"{self.title[:-excess]}{CUT}, {self.y_words}"

    def x_ticks(self) -> tuple[float, ...]:
        """Round numbers, or the places of the names."""
        if self.x_names:
            return tuple(float(k) for k in range(1, len(self.x_names) + 1))
        return round_ticks((*(x for x, _ in self.points()), *self.x_room))

    def points(self) -> Iterator[Point]:
        """Everything that is drawn, of series and strokes."""
        for series in self.series:
            yield from zip(series.x, series.y, strict=True)
        for stroke in self.strokes:
            yield from stroke.points

    def x_limits(self, columns: int) -> Limits:
        """Ends of the horizontal axis; named places have room on both sides."""
        ticks = self.x_ticks()
        return (0.5, ticks[-1] + 0.5) if self.x_names else even_limits(ticks, columns)

    def x_labels(self, places: Sequence[float]) -> list[str]:
        """Names or numbers at places of the horizontal axis."""
        if self.x_names:
            return [self.x_names[round(place) - 1] for place in places]
        return tick_labels(places)

    @property
    def x_label_cells(self) -> int:
        """How many cells a label of the horizontal axis takes, with what keeps it apart."""
        if self.x_names:
            return max(map(len, self.x_names)) + 2
        return label_cells(tick_labels(self.x_ticks()))

    def y_ticks(self) -> tuple[float, ...]:
        """Round numbers around all values and zero."""
        return round_ticks((*(y for _, y in self.points()), *self.room))

    def as_tall_as(self, other_chart: Chart) -> Chart:
        """The chart with a scale that reaches at least as far as that of another."""
        ticks = other_chart.y_ticks()
        return replace(self, room=(*self.room, ticks[0], ticks[-1]))


@dataclass(frozen=True)
class Caption:
    """Letters at a place."""

    words: str
    at: Point


@dataclass(frozen=True)
class Drawing(Chart):
    """What stands in space; ``even`` keeps lengths alike in both directions.

    Without being ``scaled`` it is a picture: no frame, no numbers.
    """

    labels: tuple[Caption, ...] = ()
    even: bool = False
    scaled: bool = True

    def limits(self, columns: int, rows: int) -> tuple[Limits, Limits]:
        """Ends of both axes in a place of so many cells; none is taken for one."""
        columns, rows = max(1, columns), max(1, rows)
        points = list(self.points())
        horizontal = _ends([x for x, _ in points])
        vertical = _ends([y for _, y in points])
        if not self.even:
            return horizontal, vertical
        cell = max(
            (horizontal[1] - horizontal[0]) / columns,
            (vertical[1] - vertical[0]) / (CELL_HEIGHT * rows),
        )
        return _around(horizontal, cell * columns), _around(vertical, cell * CELL_HEIGHT * rows)


def _ends(values: Sequence[float]) -> Limits:
    lower, upper = min(values), max(values)
    room = MARGIN * (upper - lower)
    return lower - room, upper + room


def _around(ends: Limits, span: float) -> Limits:
    middle = (ends[0] + ends[1]) / 2.0
    return middle - span / 2.0, middle + span / 2.0


def points_of(places: FloatArray) -> tuple[Point, ...]:
    """Places ``(n, 2)`` as points."""
    return tuple((x, y) for x, y in places.tolist())


def series_of(name: str, points: Sequence[Point], mark: str = "") -> Series:
    """Points as a series."""
    return Series(name, tuple(x for x, _ in points), tuple(y for _, y in points), mark=mark)


def thinned(series: Series, columns: int) -> Series:
    """The series with at most two points a column: its lowest and its highest."""
    if not series.x:
        return series
    first = min(series.x)
    columns = max(1, columns)
    width = (max(series.x) - first) / columns or 1.0
    by_column: dict[int, list[Point]] = {}
    for point in zip(series.x, series.y, strict=True):
        column = min(int((point[0] - first) / width), columns - 1)
        by_column.setdefault(column, []).append(point)
    extremes: list[Point] = []
    for points in by_column.values():
        ends = (min(points, key=lambda p: p[1]), max(points, key=lambda p: p[1]))
        extremes += dict.fromkeys(ends)
    return series_of(series.name, extremes, series.mark)


def turned(chart: Chart, rows: int) -> Chart:
    """Names from top to bottom on so many rows, values from left to right, for narrow places.

    Series stand on rows of their own below each other where there are enough.
    """
    last, rows_each = len(chart.x_names) + 1, rows // len(chart.x_names)
    on_side = []
    for number, series in enumerate(chart.series):
        below = min(number, rows_each - 1) / rows_each
        on_side.append(
            replace(series, x=series.y, y=tuple(last - round(x) - below for x in series.x))
        )
    return replace(chart, series=tuple(on_side))


WITHIN = 0.7
"""So much of the place of a group its members take."""


def grouped(chart: Chart) -> Chart:
    """The groups of the names, their members beside each other, for narrow and low places."""
    groups = list(dict.fromkeys(chart.x_groups))
    places: list[float] = []
    members: list[str] = []
    for name, group in zip(chart.x_names, chart.x_groups, strict=True):
        number, count = chart.x_groups[: len(places)].count(group), chart.x_groups.count(group)
        places.append(groups.index(group) + 1.0 + WITHIN * ((number + 0.5) / count - 0.5))
        members.append(name.removeprefix(group).strip(" ,"))
    share = WITHIN * len(groups) / len(places)
    series = tuple(
        replace(curve, x=tuple(places[round(x) - 1] + share * (x - round(x)) for x in curve.x))
        for curve in chart.series
    )
    label = f"each: {', '.join(dict.fromkeys(members))}"
    return replace(chart, series=series, x_names=tuple(groups), x_groups=(), x_words=label)


def turned_limits(names: int, rows: int) -> Limits:
    """Lower and upper end of the axis on which every name falls on the middle of a row."""
    rows_each = rows // names
    free = rows - 1 - (names - 1) * rows_each
    lower = 1.0 - math.ceil(free / 2) / rows_each
    return lower, lower + (rows - 1) / rows_each


def round_ticks(values: Iterable[float]) -> tuple[float, ...]:
    """Round numbers, eight at most, that enclose all values and zero."""
    tick_values = [0.0, *values]
    lower, upper = min(tick_values), max(tick_values)
    span = upper - lower
    if span < LEAST_SPAN_MM:
        room = (LEAST_SPAN_MM - span) / 2
        lower, upper, span = lower - room, upper + room, LEAST_SPAN_MM
    decade = 10.0 ** math.floor(math.log10(span / MOST_TICKS))
    step = next(f * decade for f in (1.0, 2.0, 5.0, 10.0) if span / (f * decade) <= MOST_TICKS)
    first, last = math.floor(lower / step), math.ceil(upper / step)
    return tuple(k * step for k in range(first, last + 1))


def even_limits(ticks: Sequence[float], cells: int) -> Limits:
    """Ends of an axis of so many cells on which every tick falls on the middle of a cell.

    Where there are fewer cells than ticks: the first and the last tick.
    """
    steps = len(ticks) - 1
    cells_each = (cells - 1) // steps
    if cells_each < 1:
        return ticks[0], ticks[-1]
    cell = (ticks[-1] - ticks[0]) / steps / cells_each
    lower = ticks[0] - (cells - 1 - steps * cells_each) // 2 * cell
    return lower, lower + (cells - 1) * cell


def spread(ticks: Sequence[float], room: int, label_width: int) -> tuple[float, ...]:
    """The ticks that get a label: each takes so many cells of the room; zero is kept."""
    step = max(1, math.ceil((len(ticks) - 1) * label_width / max(1, room - 1)))
    zero = ticks.index(0.0) if 0.0 in ticks else 0
    return tuple(tick for k, tick in enumerate(ticks) if (k - zero) % step == 0)


def tick_labels(ticks: Sequence[float]) -> list[str]:
    """Round numbers without needless decimals, all with as many."""
    decimals = max(len(f"{tick:.6f}".rstrip("0").partition(".")[2]) for tick in ticks)
    return [f"{tick:z.{decimals}f}" for tick in ticks]


def label_cells(labels: Sequence[str]) -> int:
    """Cells a number below a plot takes; the last one may be moved inwards by half its length."""
    longest = max(map(len, labels))
    return longest + longest // 2 + 2


def ticks_within(limits: Limits, most_count: int) -> tuple[float, ...]:
    """Round numbers between two ends, at most so many."""
    span = limits[1] - limits[0]
    decade = 10.0 ** math.floor(math.log10(span / max(1, most_count)))
    for step in (factor * decade for factor in (1.0, 2.0, 5.0, 10.0, 20.0, 50.0)):
        first, last = math.ceil(limits[0] / step), math.floor(limits[1] / step)
        if last - first < most_count:
            return tuple(k * step for k in range(first, last + 1))
    return ()
