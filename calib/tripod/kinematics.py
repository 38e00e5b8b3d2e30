"""Exact kinematics of a translational tripod, batched over any leading shape.

Notation of papers/000: ``carriage`` is q = rho + d_rho, the true positions of the three carriages
along their drives; ``tool`` is p, the tool centre point; ``foot`` is where a bar is held by its
carriage. Lengths in mm.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.errors import UnreachablePosture
from calib.observations import FloatArray
from calib.tripod.geometry import Geometry


def inverse(geometry: Geometry, tool_mm: ArrayLike) -> FloatArray:
    """Carriage positions ``(..., 3)`` for tool positions ``(..., 3)``; papers/000 equation (3).

    One square root for each leg, the carriage ahead of the platform as at Zero. Subtract d_rho for
    joint coordinates. Raises UnreachablePosture where a leg is too short.
    """
    tool = np.asarray(tool_mm, dtype=np.float64)
    reach = geometry.reach_mm2(tool)
    if reach.size and not reach.min() >= 0.0:
        raise _unreachable(tool[(~(reach >= 0.0)).any(axis=-1)][0], "tool at")
    along = ((tool[..., None, :] - geometry.anchors) * geometry.directions).sum(axis=-1)
    return np.asarray(along + np.sqrt(reach))


def direct(
    geometry: Geometry, carriage_mm: ArrayLike, length_error_mm: ArrayLike = 0.0
) -> FloatArray:
    """Tool position ``(..., 3)`` for carriage positions ``(..., 3)``; undoes `inverse`.

    ``length_error_mm`` ``(..., 3)`` is added to the nominal lengths. Raises UnreachablePosture
    where the bars cannot meet.
    """
    carriage = np.asarray(carriage_mm, dtype=np.float64)
    lengths = geometry.lengths + np.asarray(length_error_mm, dtype=np.float64)
    feet = geometry.origins + geometry.directions * carriage[..., :, None]
    return trilaterate(feet - geometry.platform, lengths, geometry.side)


def trilaterate(
    foot_mm: NDArray[Any], leg_length_mm: NDArray[Any], side: float, *, refuse: bool = True
) -> NDArray[Any]:
    """Tool position ``(..., 3)`` for feet anywhere in space ``(..., 3 legs, 3)``.

    Intersection of three spheres of radius ``leg_length_mm`` ``(..., 3)`` about the feet, each less
    its joint of the platform. There are two; ``side`` is that of the machine, `Geometry.side`.
    Accepts complex input for derivatives by the complex step. Where the spheres do not meet it
    raises UnreachablePosture, or gives NaN where it is not to ``refuse``.
    """
    origin = foot_mm[..., 0, :]
    to_second = foot_mm[..., 1, :] - origin
    to_third = foot_mm[..., 2, :] - origin
    square = leg_length_mm * leg_length_mm
    along_second = (_dot(to_second, to_second) + square[..., 0] - square[..., 1]) / 2
    along_third = (_dot(to_third, to_third) + square[..., 0] - square[..., 2]) / 2
    normal = np.cross(to_second, to_third)
    normal_square = _dot(normal, normal)
    in_plane = (
        along_second[..., None] * np.cross(to_third, normal)
        + along_third[..., None] * np.cross(normal, to_second)
    ) / normal_square[..., None]
    height_square = square[..., 0] - _dot(in_plane, in_plane)
    if not refuse:
        height_square = np.where(height_square.real >= 0.0, height_square, np.nan)
    elif height_square.size and not height_square.real.min() >= 0.0:
        bad = np.unravel_index(int(np.argmin(height_square.real)), height_square.shape)
        feet = np.broadcast_to(foot_mm, (*height_square.shape, 3, 3))[bad]
        raise _unreachable(feet.real.ravel(), "feet at")
    height = np.sqrt(height_square / normal_square)
    return np.asarray(origin + in_plane + side * normal * height[..., None])


def tool_jacobians(
    geometry: Geometry, tool_mm: ArrayLike, carriage_mm: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Derivatives of the tool position by joint offsets and by leg lengths; papers/000 (5).

    Shapes ``(..., 3)`` in, two arrays ``(..., 3, 3)`` out (row: coordinate, column: parameter),
    without unit (mm per mm).
    """
    tool = np.asarray(tool_mm, dtype=np.float64)
    carriage = np.asarray(carriage_mm, dtype=np.float64)
    return moved_by(geometry, tool, carriage, geometry.lengths)


def moved_by(
    geometry: Geometry,
    tool_mm: NDArray[Any],
    carriage_mm: NDArray[Any],
    length_mm: NDArray[Any],
) -> tuple[NDArray[Any], NDArray[Any]]:
    """`tool_jacobians` for any lengths of the bars ``(..., 3)``; complex numbers pass."""
    feet = geometry.anchors + geometry.directions * carriage_mm[..., :, None]
    bars = tool_mm[..., None, :] - feet
    index = np.arange(3)
    along = np.zeros_like(bars)
    along[..., index, index] = _dot(bars, geometry.directions)
    stretch = np.zeros_like(bars)
    stretch[..., index, index] = length_mm
    return np.linalg.solve(bars, along), np.linalg.solve(bars, stretch)


def _dot(left: NDArray[Any], right: NDArray[Any]) -> NDArray[Any]:
    return np.asarray((left * right).sum(axis=-1))


def _unreachable(position: NDArray[Any], what: str) -> UnreachablePosture:
    shown = ", ".join(f"{float(v):.3f}" for v in position)
    return UnreachablePosture(
        "unreachable posture",
        f"{what} ({shown}) mm",
        "positions for which the three legs can meet",
        "Check the displacement, the leg length and the joint limits of the machine file.",
    )
