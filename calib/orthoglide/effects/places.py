"""Names of places, and how a law reaches them in the arrays that pass.

A place is a leg (``"x"``), a pair of axes, a leg with a direction across it (``"xy"``, or ``"xr"``
and ``"xt"`` where drives are not orthogonal: `Geometry.across`) or the tool with a measuring axis
(``"tz"``). Changes are sums with arrays of zeros and ones, so leading axes and complex numbers need
no care.
"""

from __future__ import annotations

from itertools import permutations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.observations import LEG_NAMES, TOOL, Conditions, FloatArray
from calib.orthoglide.pipeline import Flow, measuring_directions

PAIRS = ("xy", "yz", "xz")
DIRECTIONS = tuple(first + second for first, second in permutations(LEG_NAMES, 2))
AT_TOOL = ("tx", "ty", "tz")

PER_THOUSAND = 1e-3
"""mm in a µm, rad in a mrad, mm per mm in a mm/m."""


def mounts(taken: Conditions) -> tuple[str, ...]:
    """Leg and measuring axis of every kind of mounting there is."""
    found = set(zip(taken.leg.tolist(), taken.axis.tolist(), strict=True))
    return tuple(place for place in DIRECTIONS + AT_TOOL if numbers(place) in found)


def on_legs(taken: Conditions) -> tuple[str, ...]:
    """Those of `mounts` that touch a leg."""
    return tuple(place for place in mounts(taken) if place not in AT_TOOL)


def numbers(place: str) -> tuple[int, int]:
    """0, 1, 2 for both letters of a place; `TOOL` for the tool."""
    leg = TOOL if place in AT_TOOL else LEG_NAMES.index(place[0])
    return leg, LEG_NAMES.index(place[1])


def unit(axis: int) -> FloatArray:
    """Unit vector ``(3,)``."""
    return np.asarray(np.eye(3)[axis])


def travel(flow: Flow, leg: int) -> FloatArray:
    """Commanded travel of a carriage from Zero ``(n,)``, mm."""
    return np.asarray(flow.command_mm[:, leg] - flow.geometry.zero_mm[leg])


def at_mount(flow: Flow, place: str) -> FloatArray:
    """1 for the readings of this leg and measuring axis, 0 for others ``(n,)``."""
    leg, axis = numbers(place)
    return np.asarray((flow.taken.leg == leg) & (flow.taken.axis == axis), dtype=np.float64)


def moved_carriage(passing: NDArray[Any], leg: int, along_mm: NDArray[Any]) -> NDArray[Any]:
    """Carriages ``(..., n, 3)`` with one moved along its axis by ``(..., n)``."""
    return np.asarray(passing + along_mm[..., None] * unit(leg))


def moved_foot(
    passing: NDArray[Any], leg: int, towards: FloatArray, sideways_mm: NDArray[Any]
) -> NDArray[Any]:
    """Feet ``(..., n, 3, 3)`` with one moved by ``(..., n)`` along a unit vector ``(3,)``."""
    where = np.outer(unit(leg), towards)
    return np.asarray(passing + sideways_mm[..., None, None] * where)


def moved_touch(passing: NDArray[Any], flow: Flow, by_mm: NDArray[Any]) -> NDArray[Any]:
    """Touched points ``(..., n, 3)`` moved along their measuring axes by ``(..., n)``."""
    along = measuring_directions(flow.geometry, flow.taken)
    return np.asarray(passing + by_mm[..., None] * along)
