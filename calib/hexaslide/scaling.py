"""The same derivatives in other units of length and angle, and their condition number there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.hexaslide.parameters import unit_of
from calib.hexaslide.procedures import Procedure
from calib.observations import FloatArray

ANGLES = ("theta", "psi", "phi")


@dataclass(frozen=True)
class Units:
    """A unit of length in metres and one of angle in radians."""

    words: str
    length_m: float
    angle_rad: float


METRES = Units("m, rad", 1.0, 1.0)
MILLIMETRES = Units("mm, rad", 1e-3, 1.0)
DEGREES = Units("m, °", 1.0, np.pi / 180.0)
ALL_UNITS = (METRES, MILLIMETRES, DEGREES)


def in_units(procedure: Procedure, rows: FloatArray, units: Units) -> FloatArray:
    """Derivatives ``(n, k)`` in metres and radians, of whole postures, as they are in ``units``."""
    read = [units.angle_rad if name in ANGLES else units.length_m for name in procedure.read]
    each = np.resize(read, len(rows))
    lengths = [unit_of(name) == "m" for name in procedure.parameters]
    own = np.where(lengths, units.length_m, 1.0)
    return np.asarray(rows * own / each[:, None])
