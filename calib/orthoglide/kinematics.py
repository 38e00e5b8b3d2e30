"""Exact kinematics, batched over any leading shape.

Notation of papers/000: ``carriage`` is q = rho + d_rho, the true position of the three carriages
along their axes; ``tool`` is p, the tool centre point; ``leg_length`` is L_i. Lengths in mm.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.errors import UnreachablePosture
from calib.observations import FloatArray

BLOCK_POSTURES = 2048
"""Postures handled at once by `direct`: ten work arrays of this length stay in the L2 cache."""


def direct(carriage_mm: ArrayLike, leg_length_mm: ArrayLike) -> FloatArray:
    """Tool position ``(..., 3)`` from carriage positions ``(..., 3)``; closed form.

    With ``e_i = q_i^2 - L_i^2`` equation (4) of papers/000 reads ``p_i = (e_i + T) / (2 q_i)``,
    ``T = |p|^2``, and the quadratic for T is ``a T^2 + 2 b T + c = 0`` with ``a = sum 1/q_i^2``,
    ``b = sum e_i/q_i^2 - 2``, ``c = sum e_i^2/q_i^2``. The assembled machine is the minus root (the
    paper prints the plus root, see docs/theory.md); b < 0 there, hence the form without cancelling.

    Raises UnreachablePosture where the discriminant is negative.
    """
    carriage = np.asarray(carriage_mm, dtype=np.float64)
    lengths = np.broadcast_to(np.asarray(leg_length_mm, dtype=np.float64), carriage.shape)
    flat = carriage.reshape(-1, 3)
    tool = np.empty_like(flat)
    one_machine = all(stride == 0 for stride in lengths.strides[:-1])
    squares = (lengths.reshape(-1, 3)[:1] if one_machine else lengths.reshape(-1, 3)) ** 2
    work = np.empty((10, min(BLOCK_POSTURES, max(len(flat), 1))))
    for start in range(0, len(flat), BLOCK_POSTURES):
        rows = slice(start, start + BLOCK_POSTURES)
        square = squares if one_machine else squares[rows]
        _direct_block(flat[rows], square, tool[rows], work)
    return tool.reshape(carriage.shape)


def _direct_block(
    carriage: FloatArray, square: FloatArray, tool: FloatArray, work: FloatArray
) -> None:
    """One block of `direct` without temporaries; ``square`` is L_i^2, ``(1 or n, 3)``."""
    n = len(carriage)
    inverse, excess = work[0:3, :n], work[3:6, :n]
    a, b, c, spare = (work[k, :n] for k in range(6, 10))
    a.fill(0.0)
    b.fill(-2.0)
    c.fill(0.0)
    for i in range(3):
        u, e = inverse[i], excess[i]
        np.multiply(carriage[:, i], carriage[:, i], out=e)
        np.subtract(e, square[:, i], out=e)
        np.divide(1.0, carriage[:, i], out=u)
        np.multiply(u, u, out=spare)
        np.add(a, spare, out=a)
        np.multiply(spare, e, out=spare)
        np.add(b, spare, out=b)
        np.multiply(spare, e, out=spare)
        np.add(c, spare, out=c)
    np.multiply(b, b, out=spare)
    np.multiply(a, c, out=a)
    np.subtract(spare, a, out=spare)
    if not spare.min() >= 0.0:
        raise _unreachable(carriage[~(spare >= 0.0)][0])
    np.sqrt(spare, out=spare)
    np.subtract(spare, b, out=spare)
    np.divide(c, spare, out=c)
    for i in range(3):
        u, e = inverse[i], excess[i]
        np.add(e, c, out=e)
        np.multiply(e, u, out=e)
        np.multiply(e, 0.5, out=tool[:, i])


def inverse(tool_mm: ArrayLike, leg_length_mm: ArrayLike) -> FloatArray:
    """Carriage positions ``(..., 3)`` for tool positions ``(..., 3)``; papers/000 equation (3).

    All configuration signs are +1, the assembled machine. Subtract d_rho for joint coordinates.
    Raises UnreachablePosture where a leg is too short.
    """
    tool = np.asarray(tool_mm, dtype=np.float64)
    lengths = np.asarray(leg_length_mm, dtype=np.float64)
    square = tool * tool
    reach = lengths**2 - (square.sum(axis=-1, keepdims=True) - square)
    if reach.size and not reach.min() >= 0.0:
        raise _unreachable(tool[(~(reach >= 0.0)).any(axis=-1)][0], "tool at")
    return np.asarray(tool + np.sqrt(reach))


def trilaterate(foot_mm: NDArray[Any], leg_length_mm: NDArray[Any]) -> NDArray[Any]:
    """Tool position ``(..., 3)`` for feet anywhere in space ``(..., 3 legs, 3)``.

    Intersection of three spheres of radius ``leg_length_mm`` ``(..., 3)``, on the side of the
    origin (the assembled machine). Where the feet lie on their axes this equals `direct`; feet
    that left their axes need the general form. Accepts complex input for derivatives by the
    complex step. Raises UnreachablePosture where the spheres do not meet.
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
    if height_square.size and not height_square.real.min() >= 0.0:
        bad = np.unravel_index(int(np.argmin(height_square.real)), height_square.shape)
        feet = np.broadcast_to(foot_mm, (*height_square.shape, 3, 3))[bad]
        raise _unreachable(np.diagonal(feet).real)
    height = np.sqrt(height_square / normal_square)
    return np.asarray(origin + in_plane - normal * height[..., None])


def tool_jacobians(
    tool_mm: ArrayLike, carriage_mm: ArrayLike, leg_length_mm: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Derivatives of the tool position by joint offsets and by leg lengths; papers/000 (5).

    Shapes ``(..., 3)`` in, two arrays ``(..., 3, 3)`` out (row: coordinate, column: parameter),
    without unit (mm per mm).
    """
    tool = np.asarray(tool_mm, dtype=np.float64)
    carriage = np.asarray(carriage_mm, dtype=np.float64)
    lengths = np.broadcast_to(np.asarray(leg_length_mm, dtype=np.float64), tool.shape)
    bars = np.broadcast_to(tool[..., None, :], (*tool.shape, 3)).copy()
    index = np.arange(3)
    bars[..., index, index] -= carriage
    along = np.zeros_like(bars)
    along[..., index, index] = tool - carriage
    stretch = np.zeros_like(bars)
    stretch[..., index, index] = lengths
    by_offset: FloatArray = np.linalg.solve(bars, along).astype(np.float64, copy=False)
    return by_offset, np.linalg.solve(bars, stretch).astype(np.float64, copy=False)


def _dot(left: NDArray[Any], right: NDArray[Any]) -> NDArray[Any]:
    return np.asarray((left * right).sum(axis=-1))


def _unreachable(position: NDArray[Any], what: str = "carriages at") -> UnreachablePosture:
    shown = ", ".join(f"{float(v):.3f}" for v in position)
    return UnreachablePosture(
        "unreachable posture",
        f"{what} ({shown}) mm",
        "positions for which the three legs can meet",
        "Check the displacement, the leg length and the joint limits of the machine file.",
    )
