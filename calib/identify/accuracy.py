"""How well the tool stands over the workspace, before and after, and how sure that is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from calib.arrays import FloatArray
from calib.tripod.geometry import Geometry
from calib.tripod.workspace import PlaneMap, plane_map, tool_jacobian_at, workspace_jacobian

Decision = Literal["pass", "fail", "undecided"]


@dataclass(frozen=True)
class ToolError:
    """R.m.s. distance of the tool from where it should be, over the workspace, and its uncertainty.

    ``standard_uncertainty_mm`` is that of ``rms_mm``; ``worst_mm`` is the largest r.m.s. distance
    at any place.
    """

    rms_mm: float
    standard_uncertainty_mm: float
    worst_mm: float


def tool_error(geometry: Geometry, error_mm: FloatArray, covariance_mm2: FloatArray) -> ToolError:
    """Expected tool error for parameters off by ``error_mm`` ``(6,)`` with this covariance.

    First order: the tool moves by ``J (error + noise)``; the mean square over places is
    ``mean |J error|^2 + mean trace(J C J^T)``. Its own variance is that of a quadratic form of
    normal errors, ``2 trace(M C M C) + 4 e^T M C M e`` with ``M = mean J^T J``.
    """
    jacobian = workspace_jacobian(geometry)
    places = _mean_squares(jacobian, error_mm, covariance_mm2)
    metric = np.einsum("pij,pik->jk", jacobian, jacobian) / len(jacobian)
    mean = float(places.mean())
    moved = metric @ covariance_mm2
    variance = 2.0 * float(np.trace(moved @ moved))
    variance += 4.0 * float(error_mm @ moved @ metric @ error_mm)
    rms = math.sqrt(mean)
    return ToolError(
        rms_mm=rms,
        standard_uncertainty_mm=math.sqrt(variance) / (2.0 * rms) if rms else 0.0,
        worst_mm=math.sqrt(float(places.max())),
    )


def _mean_squares(
    jacobian: FloatArray, error_mm: FloatArray, covariance_mm2: FloatArray
) -> FloatArray:
    """Expected square of the distance at each place ``(n_points,)``, mm²."""
    moved = ((jacobian @ error_mm) ** 2).sum(axis=1)
    spread = np.einsum("pij,jk,pik->p", jacobian, covariance_mm2, jacobian)
    return np.asarray(moved + spread)


def tool_map(
    geometry: Geometry,
    error_mm: FloatArray,
    covariance_mm2: FloatArray,
    plane: tuple[int, int] = (0, 1),
    points: int = 17,
) -> PlaneMap:
    """Where in a plane the tool stands worse: r.m.s. distance at each place that it reaches."""

    def off_mm(tool_mm: FloatArray) -> FloatArray:
        jacobian = tool_jacobian_at(geometry, tool_mm)
        return np.sqrt(_mean_squares(jacobian, error_mm, covariance_mm2))

    return plane_map(geometry, plane, points, off_mm)


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
    growth_mm = tool_error(geometry, error_mm, np.zeros((6, 6))).rms_mm
    left_mm = max(0.0, tolerance_mm - bound_mm)
    return left_mm / growth_mm if growth_mm else math.inf
