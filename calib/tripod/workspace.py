"""The tool over the workspace: what an error of the parameters does there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.arrays import Conditions, FloatArray, tool_conditions
from calib.tripod.geometry import Geometry, inverse, tool_jacobians
from calib.tripod.pipeline import Flow, Model, driven, posture

POINTS_PER_AXIS = 5


def workspace_points(geometry: Geometry, points_per_axis: int = POINTS_PER_AXIS) -> FloatArray:
    """Tool positions ``(n_points, 3)`` on a grid over the workspace, mm."""
    axes = workspace_axes(geometry, points_per_axis)
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def workspace_axes(geometry: Geometry, points: int) -> list[FloatArray]:
    """So many coordinates along x, y, z over the workspace, mm."""
    limits = geometry.travel_min_mm, geometry.travel_max_mm
    low, high = geometry.workspace_mm or ((limits[0],) * 3, (limits[1],) * 3)
    return [np.linspace(a, b, points) for a, b in zip(low, high, strict=True)]


CELLS_PER_AXIS = 6


def reachable_points(geometry: Geometry, cells_per_axis: int = CELLS_PER_AXIS) -> FloatArray:
    """Middles ``(n_points, 3)`` of the workspace's cells that keep the joint limits, mm."""
    low, high = np.array(workspace_axes(geometry, 2)).T
    part = (np.arange(cells_per_axis) + 0.5) / cells_per_axis
    axes = [a + (b - a) * part for a, b in zip(low, high, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    reach = geometry.reach_mm2(points).min(axis=1) > 0.0
    travel = inverse(geometry, points[reach]) - geometry.zero_mm
    kept = ((travel >= geometry.travel_min_mm) & (travel <= geometry.travel_max_mm)).all(axis=1)
    return np.asarray(points[reach][kept] if kept.any() else points[reach])


def workspace_jacobian(geometry: Geometry, points_per_axis: int = POINTS_PER_AXIS) -> FloatArray:
    """Derivatives of the tool by the base parameters ``(n_points, 3, 6)``; papers/000 (5)."""
    return tool_jacobian_at(geometry, workspace_points(geometry, points_per_axis))


def tool_jacobian_at(geometry: Geometry, tool_mm: FloatArray) -> FloatArray:
    """Derivatives of the tool by the base parameters ``(n_points, 3, 6)`` at these positions.

    Where the tool's place at Zero is set by hand, of the tool less what it does there.
    """
    jacobian = np.concatenate(tool_jacobians(geometry, tool_mm, inverse(geometry, tool_mm)), axis=2)
    if geometry.set_at_zero:
        at_zero = tool_jacobians(geometry, np.zeros(3), geometry.zero_mm)
        jacobian = jacobian - np.concatenate(at_zero, axis=1)
    return jacobian


def machine_at(model: Model, joint_mm: FloatArray, way: float) -> Flow:
    """The machine as far as the tool for joint coordinates ``(n, 3)``, all reached one ``way``.

    1 is upwards, -1 downwards. Raises UnreachablePosture.
    """
    taken = reached(len(joint_mm), way)
    return posture(model.geometry, model.parameters_mm, taken, joint_mm, model.effects)


def carriages_at(model: Model, joint_mm: FloatArray, way: float) -> FloatArray:
    """True places of the carriages ``(n, 3)``, wherever they are sent."""
    taken = reached(len(joint_mm), way)
    flow = driven(model.geometry, model.parameters_mm, taken, joint_mm, model.effects)
    return np.asarray(flow.carriage_mm)


def reached(count: int, way: float) -> Conditions:
    """Conditions of so many postures of the tool, all carriages having come one way."""
    taken = tool_conditions(np.zeros((count, 3)))
    return replace(taken, movement=np.full((count, 3), way))
