"""Names of places, and how a law reaches them in the arrays that pass.

A place is a leg (``"x"``), a pair of axes or a leg with a direction across it (``"xy"``). Changes
are sums with arrays of zeros and ones, so leading axes and complex numbers need no care.
"""

from __future__ import annotations

from itertools import permutations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.observations import LEG_NAMES, Conditions, FloatArray
from calib.orthoglide.pipeline import Flow

PAIRS = ("xy", "yz", "xz")
DIRECTIONS = tuple(first + second for first, second in permutations(LEG_NAMES, 2))
MIRROR = (("xy", "yx", "zx"), ("xz", "yz", "zy"))
"""Two values, each the mirror image of itself when two axes are exchanged."""
TURNING = (("xy", "yz", "zx"), ("xz", "yx", "zy"))
"""Two values that go round with the axes: towards the next axis, towards the one before."""

PER_THOUSAND = 1e-3
"""mm in a µm, rad in a mrad, mm per mm in a mm/m."""


def mounts(taken: Conditions) -> tuple[str, ...]:
    """Leg and measuring axis of every kind of mounting there is."""
    found = set(zip(taken.leg.tolist(), taken.axis.tolist(), strict=True))
    return tuple(place for place in DIRECTIONS if numbers(place) in found)


def numbers(place: str) -> tuple[int, int]:
    """0, 1, 2 for both letters of a place."""
    return LEG_NAMES.index(place[0]), LEG_NAMES.index(place[1])


def unit(axis: int) -> FloatArray:
    """Unit vector ``(3,)``."""
    return np.asarray(np.eye(3)[axis])


def travel(flow: Flow, leg: int) -> FloatArray:
    """Commanded travel of a carriage from Zero ``(n,)``, mm."""
    return np.asarray(flow.command_mm[:, leg] - flow.geometry.leg_length_mm)


def at_mount(flow: Flow, place: str) -> FloatArray:
    """1 for the readings of this leg and measuring axis, 0 for others ``(n,)``."""
    leg, axis = numbers(place)
    return np.asarray((flow.taken.leg == leg) & (flow.taken.axis == axis), dtype=np.float64)


def moved_carriage(passing: NDArray[Any], leg: int, along_mm: NDArray[Any]) -> NDArray[Any]:
    """Carriages ``(..., n, 3)`` with one moved along its axis by ``(..., n)``."""
    return np.asarray(passing + along_mm[..., None] * unit(leg))


def moved_foot(
    passing: NDArray[Any], leg: int, towards: int, sideways_mm: NDArray[Any]
) -> NDArray[Any]:
    """Feet ``(..., n, 3, 3)`` with one moved across its axis by ``(..., n)``."""
    where = np.outer(unit(leg), unit(towards))
    return np.asarray(passing + sideways_mm[..., None, None] * where)


def moved_touch(passing: NDArray[Any], axis: int, by_mm: NDArray[Any]) -> NDArray[Any]:
    """Touched points ``(..., n, 3)`` moved along a measuring axis by ``(..., n)``."""
    return np.asarray(passing + by_mm[..., None] * unit(axis))
