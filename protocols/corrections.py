"""Readings as a diagnosis took them, for a new record: the way back from arrays to records."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from calib.arrays import LEG_NAMES, TOUCHED_NAMES, FloatArray, Observations
from calib.diagnosis.results import CleanedReadings
from protocols.observations import to_observations
from protocols.session import Reading, Session

SAME_MM = 1e-9
AS_READ = "as_read"
"""Beside a corrected reading: what the record that it is from says in its place."""


def corrected_readings(session: Session, cleaned: CleanedReadings) -> Iterator[Reading]:
    """The readings that differ from the session's, each with what that says of it.

    A stand that moved gives a new mounting from there on.
    """
    before, after = to_observations([session]).take(cleaned.rows), cleaned.observed
    readings = [session.readings[row] for row in cleaned.rows.tolist()]
    values = _values_mm(before, cleaned)
    mounts = _mount_names(readings, after)
    for k, reading in enumerate(readings):
        tool = TOUCHED_NAMES[after.leg[k]] == "tool"
        mount = mounts[int(after.mount[k])]
        now: dict[str, Any] = {
            "value_mm": float(values[k]),
            "leg": TOUCHED_NAMES[after.leg[k]],
            "axis": LEG_NAMES[after.axis[k]],
            "displacement_mm": float(after.displacement_mm[k]),
            "position_mm": tuple(map(float, after.position_mm[k])) if tool else None,
            "station": float(after.station[k]),
            "mount": f"{mount}, moved {cleaned.slips[k]}" if cleaned.slips[k] else mount,
        }
        was = {name: value for name in now if (value := getattr(reading, name)) != now[name]}
        if was:
            if was.keys() & {"leg", "displacement_mm", "position_mm"}:
                now |= {"step": None, "lift_mm": None}
            said = ", ".join(f"{name} {value}" for name, value in was.items())
            now["extra"] = {**reading.extra, AS_READ: said}
            yield reading.model_copy(update=now)


def _values_mm(before: Observations, cleaned: CleanedReadings) -> FloatArray:
    """Corrected values ``(n,)``; as read where only the zero moved, for that is a new mounting."""
    values = cleaned.observed.value_mm.copy()
    change = values - before.value_mm
    for mount in np.unique(before.mount[cleaned.slips > 0]):
        for slip in range(1, int(cleaned.slips.max()) + 1):
            rows = (before.mount == mount) & (cleaned.slips == slip)
            if rows.any() and np.ptp(change[rows]) < SAME_MM:
                values[rows] = before.value_mm[rows]
    return np.where(np.abs(values - before.value_mm) < SAME_MM, before.value_mm, values)


def _mount_names(readings: Sequence[Reading], after: Observations) -> list[str]:
    """The name that most readings of each mounting have: one of another may have come to it."""
    found = []
    for mount in range(after.mount_count):
        rows = np.flatnonzero(after.mount == mount).tolist()
        found.append(Counter(readings[row].mount for row in rows).most_common(1)[0][0])
    return found
