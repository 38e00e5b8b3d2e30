"""Whether a tool is within its tolerance, and for how long."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

from calib.tripod.geometry import Geometry
from calib.tripod.workspace import workspace_jacobian

Decision = Literal["pass", "fail", "undecided"]


def decide(least_mm: float, bound_mm: float, tolerance_mm: float) -> Decision:
    """Pass where the 95 % bound is within the tolerance, fail where the least error exceeds it.

    ``least_mm`` is what is expected less its expanded uncertainty: the guard band of ISO 14253-1.
    """
    if bound_mm <= tolerance_mm:
        return "pass"
    return "fail" if least_mm > tolerance_mm else "undecided"


def days_in_tolerance(
    geometry: Geometry, drift_mm: Sequence[float], bound_mm: float, tolerance_mm: float
) -> float:
    """How many days what the tool is off by at most stays in tolerance; 0 where it is not now.

    ``drift_mm`` are joints x, y, z per day; the bound grows by no more than their r.m.s. error at
    the tool. Infinite without drift.
    """
    error_mm = np.concatenate([np.asarray(drift_mm, dtype=np.float64), np.zeros(3)])
    growth_mm = math.sqrt(((workspace_jacobian(geometry) @ error_mm) ** 2).sum(axis=1).mean())
    left_mm = max(0.0, tolerance_mm - bound_mm)
    return left_mm / growth_mm if growth_mm else math.inf
