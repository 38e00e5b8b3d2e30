"""Exact derivatives of what a procedure reads, and how they change when the platform moves.

At a posture every slider satisfies ``|reach - slider · rail| = link``; derivatives by parameters
follow by the theorem of implicit functions, without any differences. Each ``pull`` takes the
derivatives of a number by what its class holds and gives those by the postures.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from calib.arrays import FloatArray
from calib.design.refinement import Pull
from calib.errors import CalibrationError
from calib.hexaslide.geometry import (
    ALL_NAMES,
    CHAINS,
    END_NAMES,
    FREE,
    Arms,
    ConstraintLink,
    Geometry,
    Legs,
    Numbers,
    Turn,
    cross,
    legs,
    present,
    transposed,
    words,
)
from calib.hexaslide.procedures import COMPONENTS, Kind, Procedure

ENDS_TOUCH_M = 1e-9
"""Ends of the constraint link that are nearer have no direction between them."""

SINGULAR = 1e10
"""Condition number from which on the sliders do not hold the platform, metres and radians."""


@dataclass(frozen=True, eq=False)
class Chains:
    """All chains: ``own`` ``(p, 6, 9)``, sliders by their chains' parameters, ``by_posture``
    ``(p, 6, 6)`` by the postures.
    """

    geometry: Geometry
    legs: Legs
    tilt: Numbers
    own: Numbers
    by_posture: Numbers

    @staticmethod
    def at(geometry: Geometry, postures: Numbers) -> Chains:
        """Raises UnreachablePosture."""
        at, rails = legs(geometry, postures), geometry.rails
        unit = at.arms.unit
        tilt = unit[..., :2] - unit[..., 2:] * (rails[:, :2] / rails[:, 2:])
        parts = [
            unit @ at.arms.turn.rotation,
            -unit,
            -at.sliders[..., None] * tilt,
            -(geometry.links / at.lean)[..., None],
        ]
        own = np.concatenate(parts, axis=-1)
        return Chains(geometry, at, tilt, own, at.arms.by_posture)

    @property
    def whole(self) -> Numbers:
        """Sliders by the parameters of all chains ``(p, 6, 54)``: zeros for those of others."""
        full = np.zeros((len(self.own), CHAINS, *self.own.shape[1:]), dtype=self.own.dtype)
        full[:, CHAIN, CHAIN] = self.own
        return full.reshape(len(full), CHAINS, -1)

    def pull(self, by_own: FloatArray, by_slopes: FloatArray | None = None) -> FloatArray:
        """By the postures ``(p, 6)``, of derivatives by ``own`` and by ``by_posture``."""
        arms, rails = self.legs.arms, self.geometry.rails
        lean, unit = self.legs.lean[..., None], arms.unit
        turned = by_own[..., :3] @ transposed(arms.turn.rotation)
        level = self.legs.sliders[..., None] * by_own[..., 6:8]
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
        return arms.pull(by_end, by_slopes, cross(turned, unit).sum(axis=1))


@dataclass(frozen=True, eq=False)
class Bar:
    """A constraint link: ``by_posture`` ``(p, 6)`` and ``by_ends`` ``(p, 6)``, its length by the
    postures and by its ends on platform and base.
    """

    arms: Arms
    length: Numbers
    by_posture: Numbers
    by_ends: Numbers

    @staticmethod
    def at(link: ConstraintLink, postures: Numbers, turn: Turn) -> Bar:
        """Of any length. Raises CalibrationError where the ends touch."""
        arm = turn.rotation @ link.platform_end
        apart = postures[:, :3] + arm - link.base_end
        length = np.sqrt((apart * apart).sum(axis=-1, keepdims=True))
        if not length.real.min() > ENDS_TOUCH_M:
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
        return self.arms.pull(by_end[:, None], by_slopes[:, None], cross(turned, along))


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

    def __call__(self, postures: Numbers) -> tuple[Numbers, Pull]:
        """Rows ``(p, r, n)`` at postures ``(p, 6)``, and their pull, for real ones.

        Raises UnreachablePosture, and CalibrationError at a singular posture or without a link.
        """
        chains = Chains.at(self.geometry, postures)
        if self.procedure.kind is Kind.POSE_INVERSE:
            return self._sliders(chains)
        held = _inverse(chains.by_posture, postures)
        if self.procedure.kind is not Kind.CONSTRAINT_LINK:
            return self._components(chains, held)
        bar = Bar.at(present(self.link), postures, chains.legs.arms.turn)
        return self._length(chains, held, bar)

    def _sliders(self, chains: Chains) -> tuple[Numbers, Pull]:
        def pull(weights: FloatArray) -> FloatArray:
            return chains.pull(self._blocks(weights)[0][:, CHAIN, CHAIN])

        return chains.whole @ self._basis, pull

    def _components(self, chains: Chains, held: Numbers) -> tuple[Numbers, Pull]:
        """The posture keeps the sliders: ``-held own``, ``held`` the inverse of ``by_posture``."""
        some = held[:, [COMPONENTS.index(name) for name in self.procedure.measured]]
        full = -some[..., None] * chains.own[:, None]

        def pull(weights: FloatArray) -> FloatArray:
            blocks = self._blocks(weights)[0]
            by_own = -(some[..., None] * blocks).sum(axis=1)
            by_some = -(blocks * chains.own[:, None]).sum(axis=-1)
            # d(inverse) = -inverse · d(matrix) · inverse
            return chains.pull(by_own, -transposed(some) @ by_some @ transposed(held))

        return full.reshape(*full.shape[:2], -1) @ self._basis, pull

    def _length(self, chains: Chains, held: Numbers, bar: Bar) -> tuple[Numbers, Pull]:
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


def _inverse(by_posture: Numbers, postures: Numbers) -> Numbers:
    """Raises CalibrationError for a posture at which the platform can move, sliders kept."""
    with suppress(np.linalg.LinAlgError):
        held = np.asarray(np.linalg.inv(by_posture))
        # largest entries tell enough in a search, and cost a tenth of the condition numbers
        if np.abs(by_posture).max() * np.abs(held).max() < SINGULAR:
            return held
    loose = np.nan_to_num(np.linalg.cond(by_posture), nan=np.inf)
    raise CalibrationError(
        f"posture {words(postures[int(loose.argmax())])}",
        "a singular one",
        "postures at which the sliders hold the platform",
        "Choose another box, or check the joints and rails of the geometry.",
    )


def jacobian(
    procedure: Procedure, geometry: Geometry, postures: Numbers, link: ConstraintLink | None = None
) -> Numbers:
    """Derivatives ``(p, r, k)`` of what is read by the parameters, metres and radians.

    Raises as `RowMaker`.
    """
    every = np.eye(len(procedure.parameters))
    return RowMaker(procedure, geometry, link, every)(postures)[0]
