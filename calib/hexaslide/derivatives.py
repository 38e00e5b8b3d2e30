"""Exact derivatives of what a procedure reads, and how they change when the platform moves.

At a posture every slider satisfies ``|reach - slider · rail| = link``; derivatives by parameters
follow by the theorem of implicit functions, without any differences. Each ``pull`` takes the
derivatives of a number by what its class holds and gives those by the postures.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from functools import partial

import numpy as np

from calib.arrays import FloatArray
from calib.design.refinement import Pull
from calib.errors import CalibrationError
from calib.hexaslide.arms import Arms, Numbers, Turn, cross, transposed
from calib.hexaslide.geometry import (
    ALL_NAMES,
    CHAINS,
    ENCODERS,
    END_NAMES,
    LENGTH_NAME,
    ConstraintLink,
    Geometry,
    Legs,
    legs,
    present,
    words,
)
from calib.hexaslide.procedures import COMPONENTS, Procedure, ProcedureKind

ENDS_TOUCH_M = 1e-9
"""Ends of the constraint link that are nearer have no direction between them."""

ALONG = 1e-6
"""A link at a smaller angle to its rail, radians, turns about it by nothing that could be read."""

ALL, OF_ENDS = len(ALL_NAMES), len(END_NAMES)

STEP = 1e-30
"""Complex step: nothing is subtracted, so it may be as small as numbers go."""

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
        at = legs(geometry, postures)
        unit = at.arms.unit
        tilt = unit[..., :2] - unit[..., 2:] * geometry.inclination
        length = at.lean if geometry.telescopic else geometry.links
        parts = [
            unit @ at.arms.turn.rotation,
            -unit,
            -at.sliders[..., None] * tilt,
            -(length / at.lean)[..., None],
        ]
        own_slopes = np.concatenate(parts, axis=-1)
        return Chains(geometry, at, tilt, own_slopes, at.arms.by_posture)

    @property
    def whole(self) -> Numbers:
        """Sliders by the parameters of all chains ``(p, 6, 54)``: zeros for those of others."""
        full = np.zeros((len(self.own), CHAINS, *self.own.shape[1:]), dtype=self.own.dtype)
        full[:, CHAIN, CHAIN] = self.own
        return full.reshape(len(full), CHAINS, -1)

    def pull(self, by_own: FloatArray, by_slopes: FloatArray | None = None) -> FloatArray:
        """Derivatives by the postures ``(p, 6)``, from those by ``own`` and by ``by_posture``."""
        arms, rails = self.legs.arms, self.geometry.rails
        lean, unit = self.legs.lean[..., None], arms.unit
        turned = by_own[..., :3] @ transposed(arms.turn.rotation)
        level = self.legs.sliders[..., None] * by_own[..., 6:8]
        by_unit = turned - by_own[..., 3:6]
        by_unit[..., :2] -= level
        by_unit[..., 2] += (level * self.geometry.inclination).sum(axis=-1)
        if by_slopes is not None:
            by_unit += arms.pull_unit(by_slopes)
        by_slider = -(by_own[..., 6:8] * self.tilt).sum(axis=-1, keepdims=True)
        telescopic = self.geometry.telescopic
        length = np.zeros((CHAINS, 1)) if telescopic else self.geometry.links[:, None]
        by_lean = by_own[..., 8:] * length / lean**2
        # d(slider) = unit · d, d(lean) = (rail - unit) · d, d(unit) = H d / lean with the
        # symmetric H = 1 - rail unitᵀ - unit railᵀ + unit unitᵀ, without a rail 1 - unit unitᵀ
        on_unit = (unit * by_unit).sum(axis=-1, keepdims=True)
        on_rail = (rails * by_unit).sum(axis=-1, keepdims=True)
        bent = -on_unit if telescopic else on_unit - on_rail
        by_end = (by_unit - rails * on_unit + unit * bent) / lean
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
        """The bar at these postures, of any length. Raises CalibrationError where ends touch."""
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
        """Derivatives by the postures ``(p, 6)``, from ``by_posture`` and ``by_ends``."""
        along = self.arms.unit[:, 0]
        turned = np.einsum("pij,pj->pi", self.arms.turn.rotation, by_ends[:, :3])
        by_unit = self.arms.pull_unit(by_slopes[:, None])[:, 0] + turned - by_ends[:, 3:]
        by_end = (by_unit - along * (along * by_unit).sum(axis=-1, keepdims=True)) / self.length
        return self.arms.pull(by_end[:, None], by_slopes[:, None], cross(turned, along))


@dataclass(frozen=True, eq=False)
class Joints:
    """`ENCODERS` in the universal joints on the carriages, whose first axis is the rail itself:
    ``by_posture`` ``(p, 12, 6)`` and, by their chains' parameters, ``own`` ``(p, 12, 9)``, both
    where the sliders keep their places.
    """

    by_posture: Numbers
    own: Numbers

    @staticmethod
    def at(chains: Chains) -> Joints:
        """Raises CalibrationError where a link lies along its rail."""
        at, rails, length = chains.legs, chains.geometry.rails, chains.geometry.links[:, None]
        out, tangent = _across(at.arms.unit, rails)
        side, cosine = cross(rails, out), at.lean[..., None] / length
        sine = tangent * cosine
        by_end = np.stack([side / (length * sine), (out * cosine - rails * sine) / length], axis=2)
        by_rail = np.stack([-side / tangent, -out], axis=2) - at.sliders[..., None, None] * by_end
        level = by_rail[..., :2] - by_rail[..., 2:] * (rails[:, :2] / rails[:, 2:])[:, None]
        # where turns count from follows the rail
        lead = np.sign(rails[:, 2:]) / (1.0 + np.abs(rails[:, 2:]))
        level[:, :, 0] -= lead * rails[:, 1::-1] * [1.0, -1.0]
        turned = by_end @ at.arms.turn.rotation[:, None]
        own_slopes = np.concatenate(
            [turned, -by_end, level, np.zeros_like(by_end[..., :1])], axis=-1
        )
        count = len(by_end)
        ends = by_end.reshape(count, -1, 3)
        arms = Arms.of(at.arms.turn, ends, np.repeat(at.arms.arm, 2, axis=1))
        return Joints(arms.by_posture, own_slopes.reshape(count, -1, own_slopes.shape[-1]))


def _across(unit: Numbers, rails: Numbers) -> tuple[Numbers, Numbers]:
    """Directions of links across their rails ``(p, 6, 3)``, and tangents of the angles between
    them ``(p, 6, 1)``. Raises CalibrationError where there is no such direction.
    """
    if not rails.real.any():
        raise CalibrationError(
            "encoder of a joint", "telescopic legs", "carriages on rails, about which links turn"
        )
    off = unit - rails
    tangent = np.sqrt((off * off).sum(axis=-1, keepdims=True))
    if not tangent.real.min() > ALONG:
        raise CalibrationError(
            "encoder of a joint", "a link along its rail", "postures with all links off their rails"
        )
    return off / tangent, tangent


def joint_angles(geometry: Geometry, postures: FloatArray) -> FloatArray:
    """What `ENCODERS` with zeros of 0 read at postures ``(p, 12)``, radians. A turn counts about
    the rail from X as the shortest turn from ±Z to the rail takes it along. Raises as `Joints`.
    """
    rails = geometry.rails
    (x, y, z), sign = rails.T, np.sign(rails[:, 2])
    share = x / (1.0 + np.abs(z))
    first = np.stack([1.0 - x * share, -y * share, -sign * x], axis=-1)
    out, tangent = _across(legs(geometry, postures).arms.unit, rails)
    turns = np.arctan2((out * cross(rails, first)).sum(axis=-1), (out * first).sum(axis=-1))
    return np.stack([turns, np.arctan(tangent[..., 0])], axis=-1).reshape(len(postures), -1)


CHAIN = np.arange(CHAINS)


class RowMaker:
    """Rows of a procedure, seen in a basis ``(k, n)`` of its parameters; what is read ``(r,)`` is
    multiplied by ``sizes``.
    """

    def __init__(
        self,
        procedure: Procedure,
        geometry: Geometry,
        link: ConstraintLink | None,
        basis: FloatArray,
        sizes: FloatArray | None = None,
    ) -> None:
        self._sizes = None if sizes is None else sizes[:, None]
        self.procedure = procedure
        self.geometry = geometry
        self.link = link
        # what is fixed or known takes part as zeros: chains stay blocks of nine
        names: tuple[str, ...] = ALL_NAMES
        if procedure.kind is ProcedureKind.CONSTRAINT_LINK:
            names += (*END_NAMES, LENGTH_NAME)
        encoders = [name for name in procedure.measured if name in ENCODERS]
        names += tuple(f"zero_{name}" for name in encoders)
        self._encoders = [ENCODERS.index(name) for name in encoders]
        columns = [
            "length",
            *(name for name in procedure.measured if name in COMPONENTS),
            *encoders,
        ]
        columns = [name for name in columns if name in procedure.read]
        self._order = [columns.index(name) for name in procedure.read if name in columns]
        self._at: tuple[Numbers, Chains] | None = None
        self._basis = np.zeros((len(names), basis.shape[1]))
        self._basis[[names.index(name) for name in procedure.parameters]] = basis

    @property
    def width(self) -> int:
        """How many combinations of the parameters the basis has."""
        return self._basis.shape[1]

    def chains(self, postures: Numbers) -> Chains:
        """The chains at postures ``(p, 6)``, kept for the next call. Raises UnreachablePosture."""
        if self._at is None or self._at[0] is not postures:
            self._at = (postures, Chains.at(self.geometry, postures))
        return self._at[1]

    def __call__(self, postures: Numbers) -> tuple[Numbers, Pull]:
        """Rows ``(p, r, n)`` at postures ``(p, 6)``, and their pull, for real ones.

        Raises UnreachablePosture, and CalibrationError at a singular posture, without a link, or
        with an encoder where its link lies along the rail.
        """
        chains = self.chains(postures)
        if self.procedure.kind is ProcedureKind.POSE_INVERSE:
            rows, pull = self._sliders(chains)
        else:
            rows, pull = self._moved(chains, postures)
        if self._encoders:
            pull = partial(self._stepped, postures)
        sizes = self._sizes
        if sizes is None:
            return rows, pull
        return rows * sizes, lambda weights: pull(weights * sizes)

    def _sliders(self, chains: Chains) -> tuple[Numbers, Pull]:
        def pull(weights: FloatArray) -> FloatArray:
            return chains.pull(self._blocks(weights)[0][:, CHAIN, CHAIN])

        return chains.whole @ self._basis, pull

    def _moved(self, chains: Chains, postures: Numbers) -> tuple[Numbers, Pull]:
        """The sliders keep their places, so the posture moves by ``-inverses own``, ``inverses``
        those of ``by_posture``; what is read moves with it, the link by its own ends, too.
        """
        inverses = _inverse(chains.by_posture, postures)
        places = [COMPONENTS.index(name) for name in self.procedure.measured if name in COMPONENTS]
        bar, parts = None, [inverses[:, places]]
        if self.procedure.kind is ProcedureKind.CONSTRAINT_LINK:
            bar = Bar.at(present(self.link), postures, chains.legs.arms.turn)
            parts.insert(0, bar.by_posture[:, None] @ inverses)
        joints = Joints.at(chains) if self._encoders else None
        if joints is not None:
            parts.append(joints.by_posture[:, self._encoders] @ inverses)
        together = parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)
        moving = -together[..., None] * chains.own[:, None]
        count, rows = together.shape[:2]
        full = moving.reshape(count, rows, ALL)
        if bar is not None or joints is not None:
            columns = np.zeros((count, rows, len(self._basis) - ALL), dtype=inverses.dtype)
            full = np.concatenate([full, columns], axis=-1)
        if bar is not None:
            full[:, 0, ALL : ALL + OF_ENDS], full[:, 0, ALL + OF_ENDS] = bar.by_ends, -1.0
        if joints is not None:
            first = len(self._encoders)
            for number, k in enumerate(self._encoders):
                own_columns = full[:, number - first, :ALL].reshape(count, CHAINS, -1)  # a view
                own_columns[:, k // 2] += joints.own[:, k]
                full[:, number - first, number - first] = 1.0
            full = full[:, self._order]

        def pull(weights: FloatArray) -> FloatArray:
            blocks, blocks_beside = self._blocks(weights)
            by_own = -(together[..., None] * blocks).sum(axis=1)
            by_some = -(blocks * chains.own[:, None]).sum(axis=-1)
            # d(inverse) = -inverse · d(matrix) · inverse
            by_slopes = by_some @ transposed(inverses)
            moved = chains.pull(by_own, -transposed(together) @ by_slopes)
            if bar is None:
                return moved
            return moved + bar.pull(by_slopes[:, 0], blocks_beside[:, 0, :OF_ENDS])

        return full @ self._basis, pull

    def _stepped(self, postures: FloatArray, weights: FloatArray) -> FloatArray:
        """The pull where rows have encoders: by a complex step of each coordinate, exact, too."""
        steps = (postures + 1j * STEP * unit for unit in np.eye(6))
        slopes = [self._moved(Chains.at(self.geometry, slope), slope)[0].imag for slope in steps]
        return np.stack([(weights * slope).sum(axis=(1, 2)) for slope in slopes], axis=-1) / STEP

    def _blocks(self, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Weights by chains ``(p, r, 6, 9)``, and by what link and encoders add."""
        blocks = weights @ self._basis.T
        return blocks[..., :ALL].reshape(*weights.shape[:2], CHAINS, -1), blocks[..., ALL:]


def _inverse(by_posture: Numbers, postures: Numbers) -> Numbers:
    """Raises CalibrationError for a posture at which the platform can move, sliders kept."""
    with suppress(np.linalg.LinAlgError):
        inverses = np.asarray(np.linalg.inv(by_posture))
        # largest entries tell enough in a search, and cost a tenth of the condition numbers
        if np.abs(by_posture).max() * np.abs(inverses).max() < SINGULAR:
            return inverses
    loose = np.nan_to_num(np.linalg.cond(by_posture), nan=np.inf)
    raise CalibrationError(
        f"posture {words(postures[int(loose.argmax())])}",
        "a singular one",
        "postures at which the sliders hold the platform",
        "Choose another box, or check the geometry.",
    )


def jacobian(
    procedure: Procedure, geometry: Geometry, postures: Numbers, link: ConstraintLink | None = None
) -> Numbers:
    """Derivatives ``(p, r, k)`` of what is read by the parameters, metres and radians.

    Raises as `RowMaker`.
    """
    identity = np.eye(len(procedure.parameters))
    return RowMaker(procedure, geometry, link, identity)(postures)[0]
