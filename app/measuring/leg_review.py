"""The readings of a leg, or of the tool, minus the Zero of their own cycle, while measuring."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from calib.noise.reading import visits
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
    visited = [step.position_mm for step in session.steps()]
    visited += [reading.position_mm for reading in session.all_readings]
    return list(dict.fromkeys([ZERO, *(place for place in visited if place is not None)]))


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
            found: dict[float, list[float]] = {}
            for r in members:
                if r.station == ends[0]:
                    near_mm[r.displacement_mm] = r.value_mm
                elif r.station == ends[-1] and r.displacement_mm in near_mm:
                    slope_mm = r.value_mm - near_mm[r.displacement_mm]
                    found.setdefault(r.displacement_mm, []).append(slope_mm)
            zeros = found.get(0.0, [])
            back_mm = zeros[-1] - zeros[0] if len(zeros) > 1 else None
            kept = [r.displacement_mm for r in members if r.reading in session.restored]
            first = {level: of_it[0] for level, of_it in found.items()}
            if first:
                rows.append(LegRow(axis, cycle, first, back_mm, frozenset(kept)))
    return rows


def _row(
    axis: str, cycle: int, members: list[Reading], level: Callable[[Reading], float]
) -> LegRow | None:
    start = next((k for k, r in enumerate(members) if r.cycle == cycle and level(r) == 0.0), None)
    if start is None:
        return None
    zero = members[start].value_mm
    levels = {level(r) for r in members if r.cycle == cycle} - {0.0}
    differences: dict[float, float] = {}
    for r in members[start + 1 :]:
        if level(r) != 0.0:
            differences[level(r)] = r.value_mm - zero
        elif r.cycle != cycle or len(differences) == len(levels):
            return LegRow(axis, cycle, differences, r.value_mm - zero)
    return LegRow(axis, cycle, differences, None) if differences or start == 0 else None


@dataclass(frozen=True)
class AxisReview:
    """One axis of a leg: standard deviation of a reading (mm) and what is known beside it.

    ``standard_deviation_mm`` is None without repeats; ``stated_mm`` is the indicator's stated
    repeatability with its rounding, None where nothing is stated. ``worst_return_mm`` is the
    largest difference between two Zeros of one cycle.
    """

    axis: str
    standard_deviation_mm: float | None
    degrees_of_freedom: int
    stated_mm: float | None
    worst_return_mm: float | None


@dataclass(frozen=True)
class LegReview:
    """A leg just measured and the differences that exist so far, in mm."""

    leg: str
    station: float
    axes: tuple[AxisReview, ...]
    differences_mm: tuple[tuple[str, float], ...]


def review_leg(session: Session, step: Step) -> LegReview:
    """Review the leg and station of a step. Raises NotIdentifiable without any reading."""
    visited = visits(to_observations([session]))
    measured = differences(session.opened.machine.geometry(), visited)
    return LegReview(
        leg=step.leg,
        station=step.station,
        axes=tuple(_review_axis(session, step, axis) for axis in step.axes),
        differences_mm=tuple(
            (measured.names[k], float(measured.value_mm[k])) for k in measured.published_rows
        ),
    )


def _review_axis(session: Session, step: Step, axis: str) -> AxisReview:
    here = [r.set_up == (step.leg, axis, step.place[1]) for r in session.readings]
    repeats = Repeats.of(visits(to_observations([session]).take(here)))
    returns = [
        row.back_at_zero_mm
        for row in leg_rows(session, step)
        if row.axis == axis and row.back_at_zero_mm is not None
    ]
    return AxisReview(
        axis=axis,
        standard_deviation_mm=repeats.standard_deviation_mm,
        degrees_of_freedom=round(float(repeats.degrees_of_freedom.sum())),
        stated_mm=indicator_figures([session]).stated_mm,
        worst_return_mm=max(returns, key=abs) if returns else None,
    )
