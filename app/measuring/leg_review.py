"""The readings of a leg, or of the tool, minus the Zero of their own cycle, while measuring."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from statistics import median

from calib.noise.reading import visit_means
from calib.noise.repeats import Repeats
from calib.tripod.differences import differences
from protocols.documents import ZERO, Triple
from protocols.observations import indicator_figures, to_observations
from protocols.procedure import Step
from protocols.session import Reading, Session


@dataclass(frozen=True)
class LegRow:
    """One axis in one cycle: displacement → reading minus Zero, and the return to Zero, in mm.

    Over a plane it is the far end of the leg minus the near one, in every posture. For the tool
    numbers of its `positions` are in the place of displacements. ``kept_mm`` are those where a
    reading counts that was questioned or superseded.
    """

    axis: str
    cycle: int
    minus_zero_mm: dict[float, float]
    back_at_zero_mm: float | None
    kept_mm: frozenset[float] = frozenset()


def positions(session: Session) -> list[Triple]:
    """Positions of the tool in the order of the procedure, or of the table; Zero is number 0."""
    visits = [step.position_mm for step in session.steps()]
    visits += [reading.position_mm for reading in session.all_readings]
    return list(dict.fromkeys([ZERO, *(place for place in visits if place is not None)]))


def leg_rows(session: Session, step: Step) -> list[LegRow]:
    """Rows for the leg and station of a step; each mounting has zeros of its own."""
    if step.over_plane:
        return _plane_rows(session, step)
    rows: list[LegRow] = []
    numbers = {place: float(k) for k, place in enumerate(positions(session))}

    def level(r: Reading) -> float:
        return r.displacement_mm if r.position_mm is None else numbers[r.position_mm]

    for axis in step.axes:
        here = _read_there(session, step, axis)
        for mount in dict.fromkeys(r.mount for r in here):
            members = [r for r in here if r.mount == mount]
            for cycle in sorted({r.cycle for r in members}):
                row = _row(axis, cycle, members, level)
                if row is not None:
                    again = [r for r in members if r.reading in session.restored]
                    at_mm = frozenset(level(r) for r in again if r.cycle == cycle)
                    rows.append(replace(row, kept_mm=at_mm))
    return rows


def _read_there(session: Session, step: Step, axis: str) -> list[Reading]:
    """Readings that count where the stand is for a step, along an axis."""
    place = (step.leg, axis, step.place[1])
    return [r for r in session.readings if r.set_up == place]


def _plane_rows(session: Session, step: Step) -> list[LegRow]:
    """Over a plane: displacement → reading farthest from the tool minus the nearest, Zero too."""
    rows = []
    stations = {s.station for s in session.steps() if s.place == step.place}
    for axis in step.axes:
        here = _read_there(session, step, axis)
        ends = sorted(stations or {r.station for r in here})
        for mount, cycle in dict.fromkeys((r.mount, r.cycle) for r in here):
            members = [r for r in here if (r.mount, r.cycle) == (mount, cycle)]
            near_mm: dict[float, float] = {}
            heights: dict[float, list[float]] = {}
            for r in members:
                if r.station == ends[0]:
                    near_mm[r.displacement_mm] = r.value_mm
                elif r.station == ends[-1] and r.displacement_mm in near_mm:
                    slope_mm = r.value_mm - near_mm[r.displacement_mm]
                    heights.setdefault(r.displacement_mm, []).append(slope_mm)
            zeros = heights.get(0.0, [])
            back_mm = zeros[-1] - zeros[0] if len(zeros) > 1 else None
            restored = [r.displacement_mm for r in members if r.reading in session.restored]
            first = {level: of_it[0] for level, of_it in heights.items()}
            if first:
                rows.append(LegRow(axis, cycle, first, back_mm, frozenset(restored)))
    return rows


def _row(
    axis: str, cycle: int, members: list[Reading], level: Callable[[Reading], float]
) -> LegRow | None:
    start = next((k for k, r in enumerate(members) if r.cycle == cycle and level(r) == 0.0), None)
    if start is None:
        return None
    zero = members[start].value_mm
    levels = {level(r) for r in members if r.cycle == cycle} - {0.0}
    differences = {level(r): r.value_mm - zero for r in members if r.cycle == cycle and level(r)}
    numbers: set[float] = set()
    for r in members[start + 1 :]:
        if level(r) != 0.0:
            numbers.add(level(r))
        elif r.cycle != cycle or numbers >= levels:
            return LegRow(axis, cycle, differences, r.value_mm - zero)
    return LegRow(axis, cycle, differences, None) if differences or start == 0 else None


class Usual(StrEnum):
    """What tells how much readings scatter usually."""

    STATED = "stated"
    OTHERS = "other legs"
    AT_REST = "at rest"


@dataclass(frozen=True)
class AxisReview:
    """One axis of a leg: standard deviation of a reading (mm) and what is known beside it.

    ``standard_deviation_mm`` is None without repeats. ``usual_mm`` is the scatter to hold against
    it and ``usual`` where that is from: stated repeatability with its rounding, the other legs, or
    an indicator at rest. ``worst_return_mm`` is the largest difference between two Zeros of one
    cycle. ``furthest`` is the reading that is furthest from the median of its repeats, by
    ``furthest_mm``; None without repeats.
    """

    axis: str
    standard_deviation_mm: float | None
    degrees_of_freedom: int
    usual_mm: float
    usual: Usual
    worst_return_mm: float | None
    furthest: Reading | None = None
    furthest_mm: float = 0.0

    @property
    def excess(self) -> float:
        """How many times as much as usual it scatters; 0 without repeats."""
        return (self.standard_deviation_mm or 0.0) / self.usual_mm


@dataclass(frozen=True)
class LegReview:
    """A leg just measured and the differences that exist so far, in mm."""

    leg: str
    axes: tuple[AxisReview, ...]
    differences_mm: tuple[tuple[str, float], ...]


def review_leg(session: Session, step: Step, rests_mm: Sequence[float] = ()) -> LegReview:
    """Review the leg and station of a step.

    ``rests_mm`` is for each axis how far readings of its indicator differ while nothing moves.
    Raises NotIdentifiable without any reading.
    """
    visits = visit_means(to_observations([session]))
    measured = differences(session.opened.machine.geometry(), visits)
    rests = [*rests_mm, *[0.0] * len(step.axes)]
    return LegReview(
        leg=step.leg,
        axes=tuple(
            _review_axis(session, step, axis, rest_mm)
            for axis, rest_mm in zip(step.axes, rests, strict=False)
        ),
        differences_mm=tuple(
            (measured.names[k], float(measured.value_mm[k])) for k in measured.published_rows
        ),
    )


def _review_axis(session: Session, step: Step, axis: str, rest_mm: float) -> AxisReview:
    place = (step.leg, axis, step.place[1])
    repeats = _repeats(session, place)
    returns = [
        row.back_at_zero_mm
        for row in leg_rows(session, step)
        if row.axis == axis and row.back_at_zero_mm is not None
    ]
    furthest, furthest_mm = _furthest(session, place)
    usual, usual_mm = _usual(session, place, rest_mm, repeats.standard_deviation_mm or 0.0)
    return AxisReview(
        axis=axis,
        standard_deviation_mm=repeats.standard_deviation_mm,
        degrees_of_freedom=round(float(repeats.degrees_of_freedom.sum())),
        usual_mm=usual_mm,
        usual=usual,
        worst_return_mm=max(returns, key=abs) if returns else None,
        furthest=furthest,
        furthest_mm=furthest_mm,
    )


SetUp = tuple[str, str, float]
"""Leg, axis and station."""


def _repeats(session: Session, place: SetUp) -> Repeats:
    here = [r.set_up == place for r in session.readings]
    return Repeats.of(visit_means(to_observations([session]).take(here)))


def _usual(
    session: Session, place: SetUp, rest_mm: float, scatter_mm: float
) -> tuple[Usual, float]:
    """What tells most of the scatter: of what is known the one beside which it is largest.

    Other legs tell by their median, with two of them or more; an indicator at rest where neither
    they nor its maker tell anything, and at least as much as readings may differ that are stable.
    """
    stated_mm = indicator_figures([session]).stated_mm
    other_scatters = [
        repeats.standard_deviation_mm
        for set_up_beside in dict.fromkeys(r.set_up for r in session.readings)
        if set_up_beside != place
        and (repeats := _repeats(session, set_up_beside)).standard_deviation_mm
    ]
    scatter_by_source = {Usual.STATED: stated_mm} if stated_mm else {}
    if len(other_scatters) > 1:
        scatter_by_source[Usual.OTHERS] = max(median(mm for mm in other_scatters if mm), rest_mm)
    if not scatter_by_source:
        procedure = session.opened.procedure
        # as far as readings differ that are stable, where no procedure says it
        tolerance_mm = procedure.tolerance_mm if procedure else 0.004
        scatter_by_source[Usual.AT_REST] = max(rest_mm, tolerance_mm)
    usual = max(scatter_by_source, key=lambda source: scatter_mm / scatter_by_source[source])
    return usual, scatter_by_source[usual]


def _furthest(session: Session, place: SetUp) -> tuple[Reading | None, float]:
    """The reading furthest from the median of its repeats on its mounting, and by how much."""
    groups: dict[tuple[object, ...], list[Reading]] = {}
    for r in session.readings:
        if r.set_up == place:
            groups.setdefault((r.mount, r.posture_mm, r.station), []).append(r)
    apart = [
        (r.value_mm - median(reading_beside.value_mm for reading_beside in group), r)
        for group in groups.values()
        for r in group
        if len(group) > 2  # of two nobody knows which
    ]
    if not apart:
        return None, 0.0
    furthest_mm, reading = max(apart, key=lambda pair: abs(pair[0]))
    return reading, furthest_mm
