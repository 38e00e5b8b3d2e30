"""The readings of one leg as differences to the Zero of their own cycle, while measuring."""

from __future__ import annotations

from dataclasses import dataclass

from protocols.events import Reading
from protocols.procedure import Step
from protocols.session import Session


@dataclass(frozen=True)
class LegRow:
    """One axis in one cycle: displacement → reading minus Zero, and the return to Zero, in mm."""

    axis: str
    cycle: int
    minus_zero_mm: dict[float, float]
    back_at_zero_mm: float | None


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
                    rows.append(row)
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
