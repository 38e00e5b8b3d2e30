"""What readings see of the six parameters, and what these do to the tool."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.arrays import FloatArray, Observations, conditions, without_zeros
from calib.design.identifiability import Sensitivity
from calib.tripod.geometry import PARAMETER_NAMES, TOLERANCE_MM, Geometry
from calib.tripod.pipeline import derivatives
from calib.tripod.workspace import workspace_jacobian


def tool_metric(geometry: Geometry) -> FloatArray:
    """Mean square movement of the tool over the workspace ``(6, 6)``, mm² per mm²."""
    jacobian = workspace_jacobian(geometry)
    return np.asarray(np.einsum("pij,pik->jk", jacobian, jacobian) / len(jacobian))


WAY_POINTS = 17
"""Of the way that an indicator follows between the ends of its displacements."""


def excursion_mm(
    geometry: Geometry,
    tolerance_mm: FloatArray,
    read: tuple[int, int],
    station: float,
    levels_mm: Sequence[float],
) -> float:
    """How far a spindle moves in one set-up, from Zero over all levels and the way between them.

    ``read`` are the leg and the axis. Two standard deviations of the largest difference, where
    base parameters are off by ``tolerance_mm`` ``(6,)``; nominally readings never change.
    """
    leg, axis = read
    way = np.append(np.linspace(min(levels_mm), max(levels_mm), WAY_POINTS), 0.0)
    count = len(way)
    taken = conditions([leg] * count, [axis] * count, way.tolist(), station=station)
    moved = derivatives(geometry, np.zeros(len(PARAMETER_NAMES)), taken) * tolerance_mm
    return 2.0 * float(np.linalg.norm(moved[:, None] - moved, axis=-1).max())


def excursion_over_plane_mm(
    geometry: Geometry,
    tolerance_mm: FloatArray,
    read: tuple[int, int],
    places: Sequence[tuple[float, float]],
    tilt_mrad: float,
) -> float:
    """The same of a stand that slides on a plane, between displacements (mm) with their stations.

    ``tilt_mrad`` is the most that the plane leans.
    """
    leg, axis = read
    at_mm, station = (np.array(column) for column in zip(*places, strict=True))
    count, along = len(places), at_mm + station * geometry.covered_mm[leg]
    taken = conditions([leg] * count, [axis] * count, at_mm.tolist(), station=station.tolist())
    taken = replace(taken, along_mm=along)
    moved = derivatives(geometry, np.zeros(len(PARAMETER_NAMES)), taken) * tolerance_mm
    moved = np.hstack([moved, 1e-3 * tilt_mrad / 2.0 * along[:, None]])
    return 2.0 * float(np.linalg.norm(moved[:, None] - moved, axis=-1).max())


def sensitivity_of_readings(
    geometry: Geometry,
    observed: Observations,
    weight: FloatArray,
    design: FloatArray,
    free: tuple[int, ...],
    *,
    noise_known: bool,
) -> Sensitivity:
    """Readings with a free zero for each mounting; ``design`` ``(n_readings, k)``.

    ``weight`` ``(n_readings,)`` in 1/mm² holds the noise, or none where it is not known.
    """
    jacobian = np.sqrt(weight)[:, None] * without_zeros(observed, weight, design)
    tool = workspace_jacobian(geometry)[:, :, list(free)]
    return Sensitivity(
        names=tuple(PARAMETER_NAMES[k] for k in free),
        jacobian=jacobian,
        tolerance=np.full(len(free), TOLERANCE_MM),
        cost=tool.reshape(-1, len(free)),
        points=len(tool),
        noise_known=noise_known,
    )
