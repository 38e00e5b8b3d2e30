"""A turned platform and what its arms do when it moves; knows no rails."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.arrays import FloatArray

Numbers = NDArray[Any]
"""Real, or complex where derivatives are taken by a complex step."""

SECOND, THIRD = np.array([1, 2, 0]), np.array([2, 0, 1])


@dataclass(frozen=True, eq=False)
class Turn:
    """Rotations ``(p, 3, 3)`` and the axes ``(p, 3, 3)``, rows, of theta, psi, phi.

    Turns are rotation vectors ``ω``: a turn moves ``R b`` by ``ω × R b``, and each of theta, psi,
    phi turns the axes of those after it.
    """

    rotation: Numbers
    axes: Numbers

    @staticmethod
    def at(angles: Numbers) -> Turn:
        """``R = Ry(theta) Rx(psi) Rz(phi)`` of angles ``(p, 3)``; papers/001, equation (2)."""
        (a, b, c), (sa, sb, sc) = np.cos(angles).T, np.sin(angles).T
        first = np.zeros((len(angles), 3, 3), dtype=angles.dtype)  # Ry(theta) Rx(psi)
        first[:, 0] = np.stack([a, sa * sb, sa * b], axis=-1)
        first[:, 1, 1], first[:, 1, 2] = b, -sb
        first[:, 2] = np.stack([-sa, a * sb, a * b], axis=-1)
        rotation = first.copy()
        rotation[..., 0] = first[..., 0] * c[:, None] + first[..., 1] * sc[:, None]
        rotation[..., 1] = first[..., 1] * c[:, None] - first[..., 0] * sc[:, None]
        axes = np.zeros_like(first)
        axes[:, 0, 1] = 1.0
        axes[:, 1], axes[:, 2] = first[..., 0], first[..., 2]
        return Turn(rotation, axes)

    def pull(self, moment: FloatArray, bent: FloatArray | None) -> FloatArray:
        """Derivatives by the angles ``(p, 3)``: ``moment`` ``(p, 3)`` by a turn of all, ``bent``
        ``(p, 3, 3)`` by the axes themselves, which the angles before them turn.
        """
        moments = np.repeat(moment[:, None], 3, axis=1)
        if bent is not None:
            own_moment = cross(self.axes, bent)
            moments[:, 0] += own_moment[:, 1] + own_moment[:, 2]
            moments[:, 1] += own_moment[:, 2]
        return np.asarray((self.axes * moments).sum(axis=-1))


@dataclass(frozen=True, eq=False)
class Arms:
    """Vectors ``unit`` ``(p, m, 3)`` at the ends of arms ``(p, m, 3)`` from the platform's origin.

    `pull` and `pull_unit` take the derivatives of a number by what the class holds and give those
    by the postures; there the vectors have unit length.
    """

    turn: Turn
    unit: Numbers
    arm: Numbers
    lever: Numbers

    @staticmethod
    def of(turn: Turn, unit: Numbers, arm: Numbers) -> Arms:
        """Arms with levers ``arm × unit``."""
        return Arms(turn, unit, arm, cross(arm, unit))

    @property
    def by_posture(self) -> Numbers:
        """How far the postures move the ends along the unit vectors ``(p, m, 6)``."""
        return np.concatenate([self.unit, self.lever @ transposed(self.turn.axes)], axis=-1)

    def pull_unit(self, by_posture: FloatArray) -> FloatArray:
        """Pull derivatives ``(p, m, 6)`` by `by_posture` back to the unit vectors."""
        about = by_posture[..., 3:] @ self.turn.axes
        return np.asarray(by_posture[..., :3] + cross(about, self.arm))

    def pull(
        self, by_end: FloatArray, by_posture: FloatArray | None, spin: FloatArray
    ) -> FloatArray:
        """Derivatives by the postures ``(p, 6)``: from those ``(p, m, 3)`` by the ends of the arms,
        by `by_posture` through arms and axes, and from moments ``spin`` ``(p, 3)`` of what else
        turns.
        """
        force, bent = by_end, None
        if by_posture is not None:
            about = by_posture[..., 3:] @ self.turn.axes
            force = by_end + cross(self.unit, about)
            bent = transposed(by_posture[..., 3:]) @ self.lever
        moment = cross(self.arm, force).sum(axis=1) + spin
        return np.concatenate([by_end.sum(axis=1), self.turn.pull(moment, bent)], axis=-1)


def cross(first: Numbers, second: Numbers) -> Numbers:
    """``first × second``; a third of the time that numpy's own needs for so few."""
    return np.asarray(
        first[..., SECOND] * second[..., THIRD] - first[..., THIRD] * second[..., SECOND]
    )


def transposed(matrices: Numbers) -> Numbers:
    """The transposes of matrices ``(..., n, m)``."""
    return np.swapaxes(matrices, -1, -2)
