"""What the plots show, apart from any screen: series and scales."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from app.evaluating.history import MachineHistory
from app.evaluating.solution import SessionSolution
from app.measuring.leg_review import leg_rows
from calib.arrays import LEG_NAMES
from calib.diagnosis.results import SEEN, Cell
from calib.identify.solution import Solution
from protocols.procedure import Step
from protocols.session import Session

MOST_TICKS = 6
LEAST_SPAN_MM = 0.004
"""A scale is not stretched over less: below stands the resolution of the indicators."""

ASIDE = 0.12
"""Two series over the same names stand so far to the left and right of each name."""


@dataclass(frozen=True)
class Series:
    """Points of one kind; ``names`` of the chart label ``x`` where it is not a length.

    ``u`` are standard uncertainties of ``y``, none where nobody shows them.
    """

    name: str
    x: tuple[float, ...]
    y: tuple[float, ...]
    u: tuple[float, ...] = ()


@dataclass(frozen=True)
class Chart:
    """One plot: series over one horizontal axis with the words beside it.

    With ``x_names`` the places 1, 2, … of ``x`` carry names in the place of numbers. ``marks`` are
    places of ``x`` with a line from top to bottom. The scale covers ``room``, too.
    """

    title: str
    x_words: str
    y_words: str
    series: tuple[Series, ...]
    x_names: tuple[str, ...] = ()
    marks: tuple[float, ...] = ()
    room: tuple[float, ...] = ()

    @property
    def heading(self) -> str:
        """The title with the unit of the values."""
        return f"{self.title}, {self.y_words}"

    def x_ticks(self) -> tuple[float, ...]:
        """Round numbers, or the places of the names."""
        if self.x_names:
            return tuple(float(k) for k in range(1, len(self.x_names) + 1))
        return round_ticks(x for series in self.series for x in series.x)

    def x_limits(self, columns: int) -> tuple[float, float]:
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
        return round_ticks((*(y for series in self.series for y in series.y), *self.room))

    def as_tall_as(self, before: Chart) -> Chart:
        """With a scale that reaches at least as far as that of another chart."""
        ticks = before.y_ticks()
        return replace(self, room=(*self.room, ticks[0], ticks[-1]))


def readings_by_posture(session: Session, step: Step) -> Chart:
    """Readings of a leg minus the Zero of their cycle over the displacement, one series an axis.

    Those of the tool over the number of the position.
    """
    series = []
    for axis in step.axes:
        rows = [row for row in leg_rows(session, step) if row.axis == axis]
        points = [point for row in rows for point in row.minus_zero_mm.items()]
        series.append(_series(f"along {axis.upper()}", points))
    what = "far end minus near end" if step.over_plane else "readings minus Zero"
    title = f"{step.touched[:1].upper()}{step.touched[1:]}: {what}"
    x_words = "number of the position" if step.leg == "tool" else "displacement, mm"
    return Chart(title, x_words, "mm", tuple(s for s in series if s.x))


def measured_and_predicted(solution: Solution) -> Chart:
    """The differences as measured, and what the model leaves of them."""
    found, rows = solution.differences, list(solution.differences.published_rows)
    names = [found.names[k] for k in rows]
    u_mm = solution.difference_uncertainty_mm[rows].tolist()
    measured, residual = found.value_mm[rows].tolist(), solution.left_mm[rows].tolist()
    return _differences(names, ("measured", measured, u_mm), ("residual", residual, u_mm))


def predictions_with(without: Solution, now: Solution) -> Chart:
    """The differences as measured, and as predicted without an effect and with it."""
    found, rows = now.differences, list(now.differences.published_rows)
    values = (found.value_mm, without.predicted_mm, now.predicted_mm)
    names = [found.names[k] for k in rows]
    series = zip(("measured", "without", "with it"), values, strict=True)
    return _differences(names, *((name, one[rows].tolist(), ()) for name, one in series))


def residuals_with(without: Solution, now: Solution) -> Chart:
    """What is left of the differences without an effect and with it, µm.

    The scale has room for as much with the other sign: that is left at twice the size that fits.
    """
    found, rows = now.differences, list(now.differences.published_rows)
    names = [found.names[k] for k in rows]
    left = [(1000.0 * one.left_mm[rows]).tolist() for one in (without, now)]
    chart = _differences(names, ("without", left[0], ()), ("with it", left[1], ()))
    room = tuple(-um for um in left[0])
    return replace(chart, title="Left of the differences", y_words="µm", room=room)


def before_and_after(before: Solution, after: Solution) -> Chart:
    """The differences before and after the offsets were entered."""
    found, again = before.differences, after.differences
    later = {name: k for k, name in enumerate(again.names)}
    rows = [k for k in found.published_rows if found.names[k] in later]
    names = [found.names[k] for k in rows]
    partners = [later[name] for name in names]
    earlier = found.value_mm[rows], before.difference_uncertainty_mm[rows]
    others = again.value_mm[partners], after.difference_uncertainty_mm[partners]
    first, second = ([one.tolist() for one in pair] for pair in (earlier, others))
    return _differences(names, ("before", *first), ("after", *second))


def _differences(
    names: Sequence[str], *shown: tuple[str, Sequence[float], Sequence[float]]
) -> Chart:
    """Two or three series over the same names, beside each other so that none hides another.

    Each with its values and their standard uncertainties, none where nobody shows them.
    """
    series = []
    for k, (name, values, u) in enumerate(shown):
        aside = (2 * k + 1 - len(shown)) * ASIDE
        x = tuple(place + aside for place in range(1, len(names) + 1))
        series.append(Series(name, x, tuple(values), tuple(u)))
    return Chart("Differences", "", "mm", tuple(series), tuple(names))


def thinned(series: Series, columns: int) -> Series:
    """At most two points in each of so many columns: its lowest and its highest."""
    if not series.x:
        return series
    first = min(series.x)
    columns = max(1, columns)
    width = (max(series.x) - first) / columns or 1.0
    by_column: dict[int, list[tuple[float, float]]] = {}
    for point in zip(series.x, series.y, strict=True):
        column = min(int((point[0] - first) / width), columns - 1)
        by_column.setdefault(column, []).append(point)
    extremes: list[tuple[float, float]] = []
    for points in by_column.values():
        ends = (min(points, key=lambda p: p[1]), max(points, key=lambda p: p[1]))
        extremes += dict.fromkeys(ends)
    return _series(series.name, extremes)


def turned(chart: Chart, rows: int) -> Chart:
    """Names from top to bottom on so many rows, values from left to right, for narrow places.

    Series stand on rows of their own below each other where there are enough.
    """
    last, each = len(chart.x_names) + 1, rows // len(chart.x_names)
    on_side = []
    for number, series in enumerate(chart.series):
        below = min(number, each - 1) / each
        on_side.append(
            replace(series, x=series.y, y=tuple(last - round(x) - below for x in series.x))
        )
    return replace(chart, series=tuple(on_side))


def turned_limits(names: int, rows: int) -> tuple[float, float]:
    """Lower and upper end of the axis on which every name falls on the middle of a row."""
    each = rows // names
    free = rows - 1 - (names - 1) * each
    lower = 1.0 - math.ceil(free / 2) / each
    return lower, lower + (rows - 1) / each


def round_ticks(values: Iterable[float]) -> tuple[float, ...]:
    """At most eight round numbers that hold all values and zero between them."""
    shown = [0.0, *values]
    lower, upper = min(shown), max(shown)
    span = upper - lower
    if span < LEAST_SPAN_MM:
        room = (LEAST_SPAN_MM - span) / 2
        lower, upper, span = lower - room, upper + room, LEAST_SPAN_MM
    decade = 10.0 ** math.floor(math.log10(span / MOST_TICKS))
    step = next(f * decade for f in (1.0, 2.0, 5.0, 10.0) if span / (f * decade) <= MOST_TICKS)
    first, last = math.floor(lower / step), math.ceil(upper / step)
    return tuple(k * step for k in range(first, last + 1))


def even_limits(ticks: Sequence[float], cells: int) -> tuple[float, float]:
    """Ends of an axis of so many cells on which every tick falls on the middle of a cell.

    Where there are fewer cells than ticks: the first and the last tick.
    """
    steps = len(ticks) - 1
    each = (cells - 1) // steps
    if each < 1:
        return ticks[0], ticks[-1]
    cell = (ticks[-1] - ticks[0]) / steps / each
    lower = ticks[0] - (cells - 1 - steps * each) // 2 * cell
    return lower, lower + (cells - 1) * cell


def spread(ticks: Sequence[float], room: int, each: int) -> tuple[float, ...]:
    """Those of round ticks that get a label: each takes so many cells of the room; zero is kept."""
    every = max(1, math.ceil((len(ticks) - 1) * each / max(1, room - 1)))
    zero = ticks.index(0.0) if 0.0 in ticks else 0
    return tuple(tick for k, tick in enumerate(ticks) if (k - zero) % every == 0)


def tick_labels(ticks: Sequence[float]) -> list[str]:
    """Round numbers without needless decimals, all with as many."""
    decimals = max(len(f"{tick:.6f}".rstrip("0").partition(".")[2]) for tick in ticks)
    return [f"{tick + 0.0:.{decimals}f}" for tick in ticks]


def label_cells(labels: Sequence[str]) -> int:
    """Cells a number below a plot takes; the last one may be moved inwards by half its length."""
    longest = max(map(len, labels))
    return longest + longest // 2 + 2


def _series(name: str, points: Sequence[tuple[float, float]]) -> Series:
    return Series(name, tuple(x for x, _ in points), tuple(y for _, y in points))


HALF = 0.36
"""The displacements of one mounting stand so far to the left and right of its name."""

EDGE = 0.45
"""Where the noise of a mounting is marked, clear of its displacements."""

BESIDE = 0.03

NOISE = "noise"
"""The series that bounds what is noise."""


def residuals_before_and_after(cells: Sequence[Cell]) -> Chart:
    """Mean residuals in µm of each mounting, its displacements from left to right, and the noise.

    The noise is drawn at two standard deviations of a mean, on both sides of zero.
    """
    stations = {cell.station for cell in cells}
    set_ups = sorted({_set_up(cell) for cell in cells})
    places = {set_up: float(k) for k, set_up in enumerate(set_ups, start=1)}
    names = tuple(_name(*set_up, stations=len(stations)) for set_up in set_ups)
    adopted = any(cell.after_mm is not None for cell in cells)
    aside = BESIDE if adopted else 0.0
    series = [_noise(cells, places), _residuals("before", cells, places, -aside)]
    if adopted:
        series.append(_residuals("after adopting", cells, places, aside, after=True))
    of_tool = any(cell.position_mm for cell in cells)
    words = f"{'positions' if of_tool else 'displacement'} from left to right"
    return Chart("Mean residual", words, "µm", tuple(series), names)


def _name(leg: str, axis: str, station: float, *, stations: int) -> str:
    """A mounting in a few letters; the station, in percent, only where there are several."""
    if stations > 1:
        return f"{leg}{axis}{100.0 * station:.0f}"
    return f"{leg.upper()} along {axis.upper()}"


def _set_up(cell: Cell) -> tuple[str, str, float]:
    return cell.leg, cell.axis, cell.station


def _residuals(
    name: str,
    cells: Sequence[Cell],
    places: dict[tuple[str, str, float], float],
    aside: float,
    *,
    after: bool = False,
) -> Series:
    reach = max(abs(cell.displacement_mm) for cell in cells) or 1.0
    positions = sorted({cell.position_mm for cell in cells if cell.position_mm})
    middle = (len(positions) - 1) / 2.0
    x, y = [], []
    for cell in cells:
        value_mm = cell.after_mm if after else cell.before_mm
        part = cell.displacement_mm / reach
        if cell.position_mm and middle:
            part = (positions.index(cell.position_mm) - middle) / middle
        if value_mm is not None:
            x.append(places[_set_up(cell)] + HALF * part + aside)
            y.append(1000.0 * value_mm)
    return Series(name, tuple(x), tuple(y))


def _noise(cells: Sequence[Cell], places: dict[tuple[str, str, float], float]) -> Series:
    x: list[float] = []
    y: list[float] = []
    for set_up, place in places.items():
        floor = SEEN * 1000.0 * max(cell.noise_mm for cell in cells if _set_up(cell) == set_up)
        for side in (-EDGE, EDGE):
            x += [place + side, place + side]
            y += [-floor, floor]
    return Series(NOISE, tuple(x), tuple(y))


def residuals_over_time(solved: SessionSolution) -> Chart:
    """What the model leaves of each reading over the time of its session: drift shows here."""
    several = len(solved.sessions) > 1
    points: dict[str, list[tuple[float, float]]] = {}
    for session, reading, residual_mm in solved.residuals:
        if reading.time_s is not None:
            name = f"{reading.leg} along {reading.axis}"
            if several:
                name = f"session {1 + solved.names.index(session)}"
            points.setdefault(name, []).append((reading.time_s / 60.0, 1000.0 * residual_mm))
    series = tuple(_series(name, found) for name, found in points.items())
    return Chart("Residuals", "minutes", "residual, µm", series)


def offsets_over_time(found: MachineHistory) -> Chart:
    """Change of each joint offset since the first session; lines where something was changed."""
    series = tuple(
        Series(f"joint {name}", found.days, tuple(1000.0 * mm for mm in one.change.tolist()))
        for name, one in zip(LEG_NAMES, found.joints, strict=True)
    )
    days = zip(found.days, found.points, strict=True)
    marks = tuple(day for day, point in days if point.event)
    return Chart("Change of the offsets", "days", "µm", series, marks=marks)
