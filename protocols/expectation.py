"""What the indicators should show in the next step, and whether they tell of a move."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from calib.arrays import TOOL, conditions
from calib.tripod.prediction import DRIFT_MM_S, predict
from protocols.documents import ZERO
from protocols.observations import along_mm, approaches
from protocols.procedure import Step, leg_number
from protocols.session import Reading, Session

MOST = 200
"""So many of the latest readings tell what to expect: the last four legs of the longest procedure
that comes with the program."""

REACH = 2.8
"""A reading further from its prediction than so many standard deviations is questioned."""

LEAST_NOISE_MM = 1e-4
"""Less is arithmetic."""

HIDDEN = 0.2
"""A change is to be seen where it stays within the band of rest less often than this."""


@dataclass(frozen=True)
class ExpectedReading:
    """What one indicator should show in a step: mean and standard deviation, mm.

    Further off than ``limit_mm`` is questioned. ``before`` is the last reading of the mounting.
    ``sure`` are mean and standard deviation of a machine without play: a change that only play
    would bring need not come. Nor need any where the machine was ``calibrated``.
    """

    before: Reading
    mean_mm: float
    deviation_mm: float
    limit_mm: float
    sure: tuple[float, float]
    calibrated: bool

    def is_beyond(self, value_mm: float) -> bool:
        """Whether this is further off than tolerances and noise allow."""
        return abs(value_mm - self.mean_mm) > self.limit_mm

    def chance_within(self, rest_mm: float) -> float:
        """How probable a reading within so much of the one before is."""
        if self.calibrated:
            return 1.0
        ends = (self.before.value_mm - rest_mm, self.before.value_mm + rest_mm)
        mean_mm, deviation_mm = self.sure
        low, high = ((e - mean_mm) / (deviation_mm * math.sqrt(2.0)) for e in ends)
        return 0.5 * (math.erf(high) - math.erf(low))


class Movement(StrEnum):
    """What readings tell of a move between two steps."""

    SEEN = "seen"  # a change came, or none was asked for
    UNCHANGED = "unchanged"  # a change was to be seen, and none came
    UNKNOWN = "unknown"  # no change was to be seen: the readings prove nothing


def expected(session: Session, step: Step, time_s: float) -> tuple[ExpectedReading, ...]:
    """What each indicator should show in a step at this time; none before the mounting's first.

    A reading that was kept though it was questioned weighs little: one outlier must not make every
    later one questionable.
    """
    procedure, machine = session.opened.procedure, session.opened.machine
    if procedure is None or session.needs_new_zero(step):
        return ()
    readings = session.readings[-MOST:]
    last = {r.mount: r for r in readings}
    number = {mount: k for k, mount in enumerate(last)}
    mounts = [session.mountings[-1].mounts[axis] for axis in step.axes]
    if not last.keys() >= set(mounts):
        return ()
    observations = conditions(
        [leg_number(r.leg) for r in readings] + [leg_number(step.leg)] * len(mounts),
        [leg_number(r.axis) for r in readings] + [leg_number(axis) for axis in step.axes],
        [r.displacement_mm for r in readings] + [step.displacement_mm] * len(mounts),
        station=[r.station for r in readings] + [step.station] * len(mounts),
        mount=[number[name] for name in (*(r.mount for r in readings), *mounts)],
        position_mm=[r.position_mm or ZERO for r in readings]
        + [step.position_mm or ZERO] * len(mounts),
    )
    places: list[Reading | Step] = [*readings, *(step for _ in mounts)]
    along = [along_mm(place, machine) for place in places]
    times_s = [r.time_s or 0.0 for r in readings] + [time_s] * len(mounts)
    sides = approaches(session)[-MOST:]
    side = dict(zip((r.mount for r in readings), sides, strict=True))
    for mount in mounts:  # what does not move stays as it came
        way_mm = step.displacement_mm - last[mount].displacement_mm
        sides.append(math.copysign(1.0, way_mm) if way_mm else side[mount])
    limit_mm = procedure.repeat_limit_mm
    noise_mm = max(LEAST_NOISE_MM, min(procedure.tolerance_mm, limit_mm / (2.0 * REACH)))
    noises_mm = [limit_mm if r.reading in session.restored else noise_mm for r in readings]
    worn, sure = predict(
        machine.geometry(),
        machine.tolerances_mm(),
        replace(
            observations,
            time_s=np.array(times_s),
            along_mm=np.array(along),
            approach=np.where(observations.leg == TOOL, 0.0, sides),
        ),
        np.array([r.value_mm for r in readings]),
        np.array(noises_mm + [noise_mm] * len(mounts)),
        machine.plane_tilt_mrad,
    )
    calibrated = session.opened.verifies is not None or any(machine.entered_offsets_mm)
    return tuple(
        ExpectedReading(
            before=last[mount],
            mean_mm=float(mean),
            deviation_mm=float(deviation),
            limit_mm=max(limit_mm, REACH * float(deviation)),
            sure=(float(plain), float(spread)),
            calibrated=calibrated,
        )
        for mount, mean, deviation, plain, spread in zip(mounts, *worn, *sure, strict=True)
    )


def movement(
    step: Step,
    due: Sequence[ExpectedReading],
    values_mm: Sequence[float],
    rests_mm: Sequence[float],
    time_s: float,
) -> Movement:
    """Whether readings of a step tell that the machine moved there.

    ``rests_mm`` is how far each indicator's readings differ while nothing moves; drift comes to it.
    """
    if not due:
        return Movement.UNKNOWN
    earlier = due[0].before
    if (earlier.posture_mm, earlier.station) == (step.posture_mm, step.station):
        return Movement.SEEN
    drift_mm = DRIFT_MM_S * max(0.0, time_s - (due[0].before.time_s or 0.0))
    bands = [rest_mm + drift_mm for rest_mm in rests_mm]
    hidden = math.prod(
        reading.chance_within(band) for reading, band in zip(due, bands, strict=True)
    )
    changes = (abs(v - reading.before.value_mm) for v, reading in zip(values_mm, due, strict=True))
    if any(change > band for change, band in zip(changes, bands, strict=True)):
        return Movement.SEEN if hidden < 0.5 else Movement.UNKNOWN
    return Movement.UNCHANGED if hidden < HIDDEN else Movement.UNKNOWN
