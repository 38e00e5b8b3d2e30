"""The readings of one leg as differences to the Zero of their own cycle, while measuring."""

from __future__ import annotations

from dataclasses import dataclass, replace

from app.evaluating.solution import indicator_figures
from calib.noise.reading import visits
from calib.noise.repeats import Repeats
from calib.tripod.differences import differences
from protocols.events import Reading
from protocols.observations import to_observations
from protocols.procedure import Step
from protocols.session import Session


@dataclass(frozen=True)
class LegRow:
    """One axis in one cycle: displacement → reading minus Zero, and the return to Zero, in mm.

    ``kept_mm`` are the displacements where a reading counts that was questioned or superseded.
    """

    axis: str
    cycle: int
    minus_zero_mm: dict[float, float]
    back_at_zero_mm: float | None
    kept_mm: frozenset[float] = frozenset()


def leg_rows(session: Session, step: Step) -> list[LegRow]:
    """Rows for the leg and station of a step; each mounting has zeros of its own.

    None for the tool, whose positions have no one displacement.
    """
    rows: list[LegRow] = []
    if step.leg == "tool":
        return rows
    for axis in step.axes:
        place = (step.leg, axis, step.station)
        here = [r for r in session.readings if (r.leg, r.axis, r.station) == place]
        for mount in dict.fromkeys(r.mount for r in here):
            members = [r for r in here if r.mount == mount]
            for cycle in sorted({r.cycle for r in members}):
                row = _row(axis, cycle, members)
                if row is not None:
                    again = [r for r in members if r.reading in session.restored]
                    at_mm = frozenset(r.displacement_mm for r in again if r.cycle == cycle)
                    rows.append(replace(row, kept_mm=at_mm))
    return rows


def _row(axis: str, cycle: int, members: list[Reading]) -> LegRow | None:
    start = next(
        (k for k, r in enumerate(members) if r.cycle == cycle and r.displacement_mm == 0.0), None
    )
    if start is None:
        return None
    zero = members[start].value_mm
    differences: dict[float, float] = {}
    for r in members[start + 1 :]:
        if r.displacement_mm != 0.0:
            differences[r.displacement_mm] = r.value_mm - zero
        elif r.cycle != cycle or len(differences) == _levels(members, cycle):
            return LegRow(axis, cycle, differences, r.value_mm - zero)
    return LegRow(axis, cycle, differences, None) if differences or start == 0 else None


def _levels(members: list[Reading], cycle: int) -> int:
    return len({r.displacement_mm for r in members if r.cycle == cycle} - {0.0})


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
    here = [(r.leg, r.axis, r.station) == (step.leg, axis, step.station) for r in session.readings]
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
