"""What the indicators should show in the next step, and whether they tell of a move."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from calib.arrays import TOOL, conditions
from calib.tripod.prediction import DRIFT_MM_S, ZERO_MM, CorrelatedReadings
from protocols.documents import ZERO
from protocols.observations import along_mm, approaches, numbers_of
from protocols.procedure import Step, leg_number
from protocols.session import Reading, Session

MOST_READINGS = 200
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

    Further off than ``limit_mm`` is questioned. ``previous`` is the last reading of the mounting.
    ``play_free`` are mean and standard deviation of a machine without play: a change that only play
    would bring need not come. Nor need any where the machine was ``calibrated``.
    """

    previous: Reading
    mean_mm: float
    deviation_mm: float
    limit_mm: float
    play_free: tuple[float, float]
    calibrated: bool

    def is_beyond(self, value_mm: float) -> bool:
        """Whether this is further off than tolerances and noise allow."""
        return abs(value_mm - self.mean_mm) > self.limit_mm

    def chance_within(self, rest_mm: float) -> float:
        """How probable a reading within so much of the one before is."""
        if self.calibrated:
            return 1.0
        ends = (self.previous.value_mm - rest_mm, self.previous.value_mm + rest_mm)
        mean_mm, deviation_mm = self.play_free
        low, high = ((e - mean_mm) / (deviation_mm * math.sqrt(2.0)) for e in ends)
        return 0.5 * (math.erf(high) - math.erf(low))


class Movement(StrEnum):
    """What readings tell of a move between two steps."""

    CONFIRMED = "seen"  # a change came, or none was asked for
    UNCHANGED = "unchanged"  # a change was to be seen, and none came
    UNKNOWN = "unknown"  # no change was to be seen: the readings prove nothing


def expected(session: Session, step: Step, time_s: float) -> tuple[ExpectedReading, ...]:
    """What each indicator should show in a step at this time; none before the mounting's first.

    Readings that the others contradict tell nothing: one outlier must not make every later one
    questionable. Of two that contradict each other it is the one that was questioned and kept.
    """
    procedure, machine = session.opened.procedure, session.opened.machine
    if procedure is None or session.needs_new_zero(step):
        return ()
    readings = session.readings[-MOST_READINGS:]
    last = {r.mount: r for r in readings}
    mounts = [session.mountings[-1].mounts[axis] for axis in step.axes]
    if not last.keys() >= set(mounts):
        return ()
    limit_mm = procedure.repeat_limit_mm
    correlated = _correlated(session, step, time_s, mounts)
    noise_mm = max(LEAST_NOISE_MM, min(procedure.tolerance_mm, limit_mm / (2.0 * REACH)))
    noises_mm = np.full(len(readings) + len(mounts), noise_mm)
    movement_noises_mm = noises_mm.copy()  # whether it moved: no contradiction widens that
    movement_noises_mm[: len(readings)][[r.reading in session.restored for r in readings]] = (
        limit_mm
    )
    play_free = correlated.predict(movement_noises_mm, worn=False)
    for steps in _contradicted(correlated, readings, limit_mm):
        restored = [g for g in steps if any(r.reading in session.restored for r in g)]
        doubted = {r.reading for g in restored or steps for r in g}
        noises_mm[: len(readings)][[r.reading in doubted for r in readings]] = ZERO_MM
    worn = correlated.predict(noises_mm, worn=True)
    calibrated = session.opened.verifies is not None or any(machine.entered_offsets_mm)
    return tuple(
        ExpectedReading(
            previous=last[mount],
            mean_mm=float(mean),
            deviation_mm=float(deviation),
            limit_mm=max(limit_mm, REACH * float(deviation)),
            play_free=(float(plain), float(spread)),
            calibrated=calibrated,
        )
        for mount, mean, deviation, plain, spread in zip(mounts, *worn, *play_free, strict=True)
    )


@dataclass(frozen=True)
class Contradiction:
    """Readings that do not agree: those of the step just taken, of an earlier step, or either.

    ``latest`` says whether those just taken may be wrong; ``earlier`` are the readings of another
    step where the stand is that may be, none where the latest alone are. With ``repeats`` both
    are of one posture.
    """

    latest: bool
    earlier: tuple[Reading, ...]
    repeats: bool


def contradiction(
    session: Session, last_readings: Sequence[Reading], *, beyond: bool
) -> Contradiction | None:
    """Whether the ``last_readings`` of the session, just taken, disagree with those before.

    ``beyond`` is whether they are further off than was expected of them: only then may they be
    wrong. Of two repeats of a posture either may be; with a third the odd one is known, where all
    else agrees.
    """
    procedure = session.opened.procedure
    if procedure is None:
        return None
    readings = session.readings[-MOST_READINGS:]
    latest = last_readings[0]

    def is_repeat(group: Sequence[Reading]) -> bool:
        return (group[0].posture_mm, group[0].station) == (latest.posture_mm, latest.station)

    ties = _contradicted(_correlated(session), readings, procedure.repeat_limit_mm)
    tie = next((steps for steps in ties if any(latest in group for group in steps)), None)
    single = ties[0] if len(ties) == 1 and len(ties[0]) == 1 else None
    if tie is None and single is not None and is_repeat(single[0]) and _is_here(single[0], latest):
        return Contradiction(False, tuple(single[0]), True)
    if not beyond:
        return None
    candidates = [g for g in tie or () if latest not in g and _is_here(g, latest)]
    candidates.sort(key=is_repeat, reverse=True)  # a repeat before others, else in their order
    candidate = tuple(candidates[0]) if candidates else ()
    return Contradiction(True, candidate, bool(candidate) and is_repeat(candidate))


def _is_here(step: Sequence[Reading], latest: Reading) -> bool:
    """Whether a step was read where the stand is."""
    return any(r.set_up == latest.set_up for r in step)


def since_last_repeat(session: Session) -> tuple[Reading, ...]:
    """What was read where the stand is since it was last seen where it had been.

    It is seen by a reading that repeats one from before; without any that is the first step. So
    much may be wrong where the stand has moved, and nobody knows when.
    """
    procedure = session.opened.procedure
    mounts = set(session.mountings[-1].mounts.values()) if session.mountings else set()
    mounted = [r for r in session.readings if r.mount in mounts]
    steps = [[r for r in mounted if r.step == n] for n in dict.fromkeys(r.step for r in mounted)]
    limit_mm = procedure.repeat_limit_mm if procedure else 0.0
    last_place = 0
    for k, latest in enumerate(steps):
        if any(_repeats(latest, earlier, limit_mm) for earlier in steps[: min(last_place + 1, k)]):
            last_place = k
    return tuple(r for step in steps[last_place + 1 :] for r in step)


def _repeats(latest: Sequence[Reading], earlier: Sequence[Reading], limit_mm: float) -> bool:
    """Whether two steps of one mounting show the same, but for a drift."""
    if (latest[0].posture_mm, latest[0].station) != (earlier[0].posture_mm, earlier[0].station):
        return False
    drift_mm = DRIFT_MM_S * ((latest[0].time_s or 0.0) - (earlier[0].time_s or 0.0))
    pairs = zip(latest, earlier, strict=False)
    return all(abs(a.value_mm - b.value_mm) <= limit_mm + drift_mm for a, b in pairs)


def _contradicted(
    correlated: CorrelatedReadings, readings: Sequence[Reading], limit_mm: float
) -> list[list[list[Reading]]]:
    """Steps, as their readings, that the others contradict: `CorrelatedReadings.contradicted`."""
    group = numbers_of([(r.step or 0, 0 if r.step else r.reading) for r in readings])
    noise_mm = max(LEAST_NOISE_MM, limit_mm / (math.sqrt(2.0) * REACH))  # of each of two repeats
    return [
        [[r for r, g in zip(readings, group, strict=True) if g == k] for k in steps]
        for steps in correlated.contradicted(group, noise_mm, limit_mm, REACH)
    ]


def _correlated(
    session: Session, step: Step | None = None, time_s: float = 0.0, mounts: Sequence[str] = ()
) -> CorrelatedReadings:
    """The latest readings that count, with those of a step at this time on these ``mounts``."""
    machine = session.opened.machine
    readings = session.readings[-MOST_READINGS:]
    places_due = [(step, axis) for axis in step.axes] if step else []
    places: list[tuple[Reading | Step, str]] = [*((r, r.axis) for r in readings), *places_due]
    observations = conditions(
        [leg_number(place.leg) for place, _ in places],
        [leg_number(axis) for _, axis in places],
        [place.displacement_mm for place, _ in places],
        station=[place.station for place, _ in places],
        mount=numbers_of([*(r.mount for r in readings), *mounts]).tolist(),
        position_mm=[place.position_mm or ZERO for place, _ in places],
    )
    sides = approaches(session)[-MOST_READINGS:]
    last = {r.mount: (r, side) for r, side in zip(readings, sides, strict=True)}
    for mount in mounts:  # what does not move stays as it came
        previous, side = last[mount]
        way_mm = step.displacement_mm - previous.displacement_mm if step else 0.0
        sides.append(math.copysign(1.0, way_mm) if way_mm else side)
    return CorrelatedReadings.of(
        machine.geometry(),
        machine.tolerances_mm(),
        replace(
            observations,
            time_s=np.array([r.time_s or 0.0 for r in readings] + [time_s] * len(mounts)),
            along_mm=np.array([along_mm(place, machine) for place, _ in places]),
            approach=np.where(observations.leg == TOOL, 0.0, sides),
        ),
        np.array([r.value_mm for r in readings]),
        machine.plane_tilt_mrad,
    )


def movement(
    step: Step,
    expectations: Sequence[ExpectedReading],
    values_mm: Sequence[float],
    rests_mm: Sequence[float],
    time_s: float,
) -> Movement:
    """Whether readings of a step tell that the machine moved there.

    ``rests_mm`` is how far each indicator's readings differ while nothing moves; drift comes to it.
    """
    if not expectations:
        return Movement.UNKNOWN
    earlier = expectations[0].previous
    if (earlier.posture_mm, earlier.station) == (step.posture_mm, step.station):
        return Movement.CONFIRMED
    drift_mm = DRIFT_MM_S * max(0.0, time_s - (earlier.time_s or 0.0))
    bands = [rest_mm + drift_mm for rest_mm in rests_mm]
    hidden = math.prod(
        reading.chance_within(band) for reading, band in zip(expectations, bands, strict=True)
    )
    changes = (
        abs(v - reading.previous.value_mm)
        for v, reading in zip(values_mm, expectations, strict=True)
    )
    if any(change > band for change, band in zip(changes, bands, strict=True)):
        return Movement.CONFIRMED if hidden < 0.5 else Movement.UNKNOWN
    return Movement.UNCHANGED if hidden < HIDDEN else Movement.UNKNOWN
