"""Unit vectors of links and a constraint bar, and what they do to a number when the platform moves.

Each class takes the derivatives of a number by what it holds and gives those by the postures. Turns
are rotation vectors ``ω``: a turn moves ``R b`` by ``ω × R b``, and each of theta, psi, phi turns
the axes of those after it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calib.errors import CalibrationError
from calib.hexaslide.geometry import ALL_NAMES, CHAINS, END_NAMES, FREE, ConstraintLink, Geometry
from calib.hexaslide.kinematics import legs
from calib.hexaslide.procedures import COMPONENTS, Kind, Procedure
from calib.observations import FloatArray

SECOND, THIRD = np.array([1, 2, 0]), np.array([2, 0, 1])


@dataclass(frozen=True, eq=False)
class Turn:
    """Rotations ``(p, 3, 3)`` and the axes ``(p, 3, 3)``, rows, of theta, psi, phi."""

    rotation: FloatArray
    axes: FloatArray

    @staticmethod
    def at(angles: FloatArray) -> Turn:
        """Of angles ``(p, 3)``; papers/001, equation (2)."""
        (a, b, c), (sa, sb, sc) = np.cos(angles).T, np.sin(angles).T
        first = np.zeros((len(angles), 3, 3))  # Ry(theta) Rx(psi)
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
        """By the angles ``(p, 3)``: ``moment`` ``(p, 3)`` by a turn of all, ``bent`` ``(p, 3, 3)``
        by the axes themselves, which the angles before them turn.
        """
        moments = np.repeat(moment[:, None], 3, axis=1)
        if bent is not None:
            own = _cross(self.axes, bent)
            moments[:, 0] += own[:, 1] + own[:, 2]
            moments[:, 1] += own[:, 2]
        return np.asarray((self.axes * moments).sum(axis=-1))


@dataclass(frozen=True, eq=False)
class Arms:
    """Unit vectors ``(p, m, 3)`` at the ends of arms ``(p, m, 3)`` from the platform's origin."""

    turn: Turn
    unit: FloatArray
    arm: FloatArray
    lever: FloatArray

    @staticmethod
    def of(turn: Turn, unit: FloatArray, arm: FloatArray) -> Arms:
        """With levers ``arm × unit``."""
        return Arms(turn, unit, arm, _cross(arm, unit))

    @property
    def by_posture(self) -> FloatArray:
        """How far the postures move the ends along the unit vectors ``(p, m, 6)``."""
        return np.concatenate([self.unit, self.lever @ _t(self.turn.axes)], axis=-1)

    def pull_unit(self, by_posture: FloatArray) -> FloatArray:
        """By the unit vectors, of derivatives ``(p, m, 6)`` by `by_posture`."""
        about = by_posture[..., 3:] @ self.turn.axes
        return np.asarray(by_posture[..., :3] + _cross(about, self.arm))

    def pull(
        self, by_end: FloatArray, by_posture: FloatArray | None, spin: FloatArray
    ) -> FloatArray:
        """By the postures ``(p, 6)``: derivatives ``(p, m, 3)`` by the ends of the arms, by
        `by_posture` through arms and axes, and moments ``spin`` ``(p, 3)`` of what else turns.
        """
        force, bent = by_end, None
        if by_posture is not None:
            about = by_posture[..., 3:] @ self.turn.axes
            force = by_end + _cross(self.unit, about)
            bent = _t(by_posture[..., 3:]) @ self.lever
        moment = _cross(self.arm, force).sum(axis=1) + spin
        return np.concatenate([by_end.sum(axis=1), self.turn.pull(moment, bent)], axis=-1)


@dataclass(frozen=True, eq=False)
class Chains:
    """All chains: ``own`` ``(p, 6, 9)``, sliders by their chains' parameters, ``by_posture``
    ``(p, 6, 6)`` by the postures.
    """

    geometry: Geometry
    arms: Arms
    sliders: FloatArray
    lean: FloatArray
    tilt: FloatArray
    own: FloatArray
    by_posture: FloatArray

    @staticmethod
    def at(geometry: Geometry, postures: FloatArray, turn: Turn) -> Chains:
        """Raises UnreachablePosture."""
        arm = geometry.platform @ _t(turn.rotation)
        reach = postures[:, None, :3] + arm - geometry.base
        rails = geometry.rails
        along = (reach * rails).sum(axis=-1)
        square = geometry.links**2 - (reach * reach).sum(axis=-1) + along * along
        if not square.min() > 0.0:
            legs(geometry, postures)  # says which link
        lean = np.sqrt(square)
        sliders = along - lean
        unit = (reach - sliders[..., None] * rails) / lean[..., None]
        tilt = unit[..., :2] - unit[..., 2:] * (rails[:, :2] / rails[:, 2:])
        parts = [
            unit @ turn.rotation,
            -unit,
            -sliders[..., None] * tilt,
            -(geometry.links / lean)[..., None],
        ]
        arms = Arms.of(turn, unit, arm)
        own = np.concatenate(parts, axis=-1)
        return Chains(geometry, arms, sliders, lean, tilt, own, arms.by_posture)

    def pull(self, by_own: FloatArray, by_slopes: FloatArray | None = None) -> FloatArray:
        """By the postures ``(p, 6)``, of derivatives by ``own`` and by ``by_posture``."""
        arms, rails = self.arms, self.geometry.rails
        lean, unit = self.lean[..., None], arms.unit
        turned = by_own[..., :3] @ _t(arms.turn.rotation)
        level = self.sliders[..., None] * by_own[..., 6:8]
        by_unit = turned - by_own[..., 3:6]
        by_unit[..., :2] -= level
        by_unit[..., 2] += (level * (rails[:, :2] / rails[:, 2:])).sum(axis=-1)
        if by_slopes is not None:
            by_unit += arms.pull_unit(by_slopes)
        by_slider = -(by_own[..., 6:8] * self.tilt).sum(axis=-1, keepdims=True)
        by_lean = by_own[..., 8:] * self.geometry.links[:, None] / lean**2
        # d(slider) = unit · d, d(lean) = (rail - unit) · d, d(unit) = H d / lean with the
        # symmetric H = 1 - rail unitᵀ - unit railᵀ + unit unitᵀ
        on_unit = (unit * by_unit).sum(axis=-1, keepdims=True)
        on_rail = (rails * by_unit).sum(axis=-1, keepdims=True)
        by_end = (by_unit - rails * on_unit + unit * (on_unit - on_rail)) / lean
        by_end += unit * (by_slider - by_lean) + rails * by_lean
        return arms.pull(by_end, by_slopes, _cross(turned, unit).sum(axis=1))


@dataclass(frozen=True, eq=False)
class Bar:
    """A constraint link: ``by_posture`` ``(p, 6)`` and ``by_ends`` ``(p, 6)``, its length by the
    postures and by its ends on platform and base.
    """

    arms: Arms
    length: FloatArray
    by_posture: FloatArray
    by_ends: FloatArray

    @staticmethod
    def at(link: ConstraintLink, postures: FloatArray, turn: Turn) -> Bar:
        """Of any length. Raises CalibrationError where the ends touch."""
        arm = turn.rotation @ link.platform_end
        apart = postures[:, :3] + arm - link.base_end
        length = np.sqrt((apart * apart).sum(axis=-1, keepdims=True))
        if not length.min() > 0.0:
            raise CalibrationError(
                "constraint link", "a posture where its ends touch", "postures that keep them apart"
            )
        along = apart / length
        arms = Arms.of(turn, along[:, None], arm[:, None])
        by_ends = np.concatenate([(along[:, None] @ turn.rotation)[:, 0], -along], axis=-1)
        return Bar(arms, length, arms.by_posture[:, 0], by_ends)

    def pull(self, by_slopes: FloatArray, by_ends: FloatArray) -> FloatArray:
        """By the postures ``(p, 6)``, of derivatives by ``by_posture`` and by ``by_ends``."""
        along = self.arms.unit[:, 0]
        turned = np.einsum("pij,pj->pi", self.arms.turn.rotation, by_ends[:, :3])
        by_unit = self.arms.pull_unit(by_slopes[:, None])[:, 0] + turned - by_ends[:, 3:]
        by_end = (by_unit - along * (along * by_unit).sum(axis=-1, keepdims=True)) / self.length
        return self.arms.pull(by_end[:, None], by_slopes[:, None], _cross(turned, along))


def _cross(first: FloatArray, second: FloatArray) -> FloatArray:
    """``first × second``; a third of the time that numpy's own needs for so few."""
    return np.asarray(
        first[..., SECOND] * second[..., THIRD] - first[..., THIRD] * second[..., SECOND]
    )


def _t(matrices: FloatArray) -> FloatArray:
    return np.swapaxes(matrices, -1, -2)


Pull = Callable[[FloatArray], FloatArray]
"""From a number's derivatives by rows ``(p, r, n)`` to those by the postures ``(p, 6)``."""

ALL = len(ALL_NAMES)
OF_LINK = len(END_NAMES) + 1
CHAIN = np.arange(CHAINS)


class RowMaker:
    """Rows of a procedure, seen in a basis ``(k, n)`` of its parameters."""

    def __init__(
        self,
        procedure: Procedure,
        geometry: Geometry,
        link: ConstraintLink | None,
        basis: FloatArray,
    ) -> None:
        self.procedure = procedure
        self.geometry = geometry
        self.link = link
        linked = procedure.kind is Kind.CONSTRAINT_LINK
        # what is fixed or known takes part as zeros: chains stay blocks of nine
        unknown = [*FREE, *(ALL + k for k in procedure.link_columns)] if linked else FREE
        self._basis = np.zeros((ALL + OF_LINK * linked, basis.shape[1]))
        self._basis[list(unknown)] = basis

    @property
    def width(self) -> int:
        """How many combinations of the parameters the basis has."""
        return self._basis.shape[1]

    def __call__(self, postures: FloatArray) -> tuple[FloatArray, Pull]:
        """Rows ``(p, r, n)`` at postures ``(p, 6)``, and their pull.

        Raises UnreachablePosture, and CalibrationError at a singular posture or without a link.
        """
        turn = Turn.at(postures[:, 3:])
        chains = Chains.at(self.geometry, postures, turn)
        if self.procedure.kind is Kind.POSE_INVERSE:
            return self._sliders(chains)
        try:
            held = np.asarray(np.linalg.inv(chains.by_posture), dtype=np.float64)
        except np.linalg.LinAlgError as problem:
            raise CalibrationError(
                "postures", "a singular one", "postures at which the sliders hold the platform"
            ) from problem
        if self.procedure.kind is not Kind.CONSTRAINT_LINK:
            return self._components(chains, held)
        if self.link is None:
            raise CalibrationError("constraint link", "none", "one in the machine file")
        return self._length(chains, held, Bar.at(self.link, postures, turn))

    def _sliders(self, chains: Chains) -> tuple[FloatArray, Pull]:
        full = np.zeros((len(chains.own), CHAINS, CHAINS, chains.own.shape[-1]))
        full[:, CHAIN, CHAIN] = chains.own

        def pull(weights: FloatArray) -> FloatArray:
            return chains.pull(self._blocks(weights)[0][:, CHAIN, CHAIN])

        return full.reshape(len(full), CHAINS, -1) @ self._basis, pull

    def _components(self, chains: Chains, held: FloatArray) -> tuple[FloatArray, Pull]:
        """The posture keeps the sliders: ``-held own``, ``held`` the inverse of ``by_posture``."""
        some = held[:, [COMPONENTS.index(name) for name in self.procedure.measured]]
        full = -some[..., None] * chains.own[:, None]

        def pull(weights: FloatArray) -> FloatArray:
            blocks = self._blocks(weights)[0]
            by_own = -(some[..., None] * blocks).sum(axis=1)
            by_some = -(blocks * chains.own[:, None]).sum(axis=-1)
            # d(inverse) = -inverse · d(matrix) · inverse
            return chains.pull(by_own, -_t(some) @ by_some @ _t(held))

        return full.reshape(*full.shape[:2], -1) @ self._basis, pull

    def _length(self, chains: Chains, held: FloatArray, bar: Bar) -> tuple[FloatArray, Pull]:
        """How the sliders' unknowns change the bar's length, then its own ends and length."""
        shares = np.einsum("px,pxk->pk", bar.by_posture, held)
        moving = (-shares[..., None] * chains.own).reshape(len(held), -1)
        full = np.concatenate([moving, bar.by_ends, -np.ones((len(held), 1))], axis=-1)

        def pull(weights: FloatArray) -> FloatArray:
            blocks, ends = (part[:, 0] for part in self._blocks(weights))
            by_shares = -(blocks * chains.own).sum(axis=-1)
            by_bar = np.einsum("pxk,pk->px", held, by_shares)
            by_slopes = -shares[..., None] * by_bar[:, None]
            moved = chains.pull(-shares[..., None] * blocks, by_slopes)
            return moved + bar.pull(by_bar, ends[:, : len(END_NAMES)])

        return full[:, None] @ self._basis, pull

    def _blocks(self, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Weights by chains ``(p, r, 6, 9)`` and by what a constraint link adds."""
        whole = weights @ self._basis.T
        return whole[..., :ALL].reshape(*weights.shape[:2], CHAINS, -1), whole[..., ALL:]
