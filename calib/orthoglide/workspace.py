"""The tool over the workspace: what an error of the parameters does there."""

from __future__ import annotations

import numpy as np

from calib.observations import FloatArray
from calib.orthoglide.geometry import Geometry
from calib.orthoglide.kinematics import inverse, tool_jacobians

POINTS_PER_AXIS = 5


def workspace_points(geometry: Geometry, points_per_axis: int = POINTS_PER_AXIS) -> FloatArray:
    """Tool positions ``(n_points, 3)`` on a grid over the cube of the joint limits, mm."""
    axis = np.linspace(geometry.travel_min_mm, geometry.travel_max_mm, points_per_axis)
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)


def workspace_jacobian(geometry: Geometry, points_per_axis: int = POINTS_PER_AXIS) -> FloatArray:
    """Derivatives of the tool by the base parameters ``(n_points, 3, 6)``; papers/000 (5)."""
    return tool_jacobian_at(geometry, workspace_points(geometry, points_per_axis))


def tool_jacobian_at(geometry: Geometry, tool_mm: FloatArray) -> FloatArray:
    """Derivatives of the tool by the base parameters ``(n_points, 3, 6)`` at these positions."""
    length = geometry.leg_length_mm
    return np.concatenate(tool_jacobians(tool_mm, inverse(tool_mm, length), length), axis=2)
