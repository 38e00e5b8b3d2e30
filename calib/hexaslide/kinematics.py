"""Inverse and forward kinematics of a Hexa Slide, many postures at once; papers/001, section 2.

Everything here passes complex numbers, so that derivatives can be taken by a complex step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.errors import UnreachablePosture
from calib.hexaslide.geometry import Box, Geometry, Numbers
from calib.observations import FloatArray

MOST_STEPS = 60
SMALL_STEP = 1e-9
"""Newton doubles the digits: after a smaller step two more leave rounding only."""

STAGES = (0.25, 0.5, 0.75)
STEPS_OF_STAGE = 3

FAR = 1e3
"""A step to coordinates larger than this, metres or radians, will not come back."""

NEXT_STEP = "Choose a posture inside the workspace, or check the geometry."


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
        """By the angles ``(p, 3)``: ``moment`` ``(p, 3)`` by a turn of all, ``bent`` ``(p, 3, 3)``
        by the axes themselves, which the angles before them turn.
        """
        moments = np.repeat(moment[:, None], 3, axis=1)
        if bent is not None:
            own = cross(self.axes, bent)
            moments[:, 0] += own[:, 1] + own[:, 2]
            moments[:, 1] += own[:, 2]
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
        """With levers ``arm × unit``."""
        return Arms(turn, unit, arm, cross(arm, unit))

    @property
    def by_posture(self) -> Numbers:
        """How far the postures move the ends along the unit vectors ``(p, m, 6)``."""
        return np.concatenate([self.unit, self.lever @ transposed(self.turn.axes)], axis=-1)

    def pull_unit(self, by_posture: FloatArray) -> FloatArray:
        """By the unit vectors, of derivatives ``(p, m, 6)`` by `by_posture`."""
        about = by_posture[..., 3:] @ self.turn.axes
        return np.asarray(by_posture[..., :3] + cross(about, self.arm))

    def pull(
        self, by_end: FloatArray, by_posture: FloatArray | None, spin: FloatArray
    ) -> FloatArray:
        """By the postures ``(p, 6)``: derivatives ``(p, m, 3)`` by the ends of the arms, by
        `by_posture` through arms and axes, and moments ``spin`` ``(p, 3)`` of what else turns.
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
    """Of matrices ``(..., n, m)``."""
    return np.swapaxes(matrices, -1, -2)


@dataclass(frozen=True, eq=False)
class Legs:
    """Links at postures: ``sliders`` ``(p, 6)``; ``lean`` ``(p, 6)``, the components of the links
    along their rails, positive on the branch of the machine; ``arms`` with vectors along the links
    from slider to platform, each 1 along its rail.
    """

    arms: Arms
    sliders: Numbers
    lean: Numbers


def rotation(angles: Numbers) -> Numbers:
    """``R`` ``(p, 3, 3)`` of ``(p, 3)``, as in `Turn`."""
    return Turn.at(angles).rotation


def legs(geometry: Geometry, postures: Numbers) -> Legs:
    """Sliders and links at postures ``(p, 6)``; papers/001, equation (3).

    Raises UnreachablePosture where a link is too short to meet its rail.
    """
    turn = Turn.at(postures[:, 3:])
    arm = geometry.platform @ transposed(turn.rotation)
    reach = postures[:, None, :3] + arm - geometry.base
    along = (reach * geometry.rails).sum(axis=-1)
    square = geometry.links**2 - (reach * reach).sum(axis=-1) + along * along
    short = ~(square.real > 0.0)
    if short.any():
        at, chain = (int(part[0]) for part in np.nonzero(short))
        raise UnreachablePosture(
            f"posture {words(postures[at])}",
            f"link {chain + 1} of {geometry.links[chain].real:g} m does not reach its rail",
            "postures whose joints are nearer to the rails than the links are long",
            NEXT_STEP,
        )
    lean = np.sqrt(square)
    sliders = along - lean
    unit = (reach - sliders[..., None] * geometry.rails) / lean[..., None]
    return Legs(Arms.of(turn, unit, arm), sliders, lean)


def inverse(geometry: Geometry, postures: Numbers) -> Numbers:
    """Slider positions ``(p, 6)`` in metres of postures ``(p, 6)``."""
    return legs(geometry, postures).sliders


def forward(geometry: Geometry, sliders: Numbers, box: Box) -> Numbers:
    """Postures ``(p, 6)`` of sliders ``(p, 6)`` on the branch that holds the centre of the box.

    Newton's method on the squares of the link lengths, which have values everywhere, following the
    sliders from the centre in a few stages so that it stays on the branch. Raises
    UnreachablePosture where the links do not meet or the platform is not held.
    """
    start = np.tile(box.centre, (len(sliders), 1)).astype(sliders.dtype)
    postures, middle = start, inverse(geometry, box.centre[None])
    for share in STAGES:
        on_way = middle + share * (sliders - middle)
        for _ in range(STEPS_OF_STAGE):
            postures = postures + _newton_step(geometry, on_way, postures, sliders)
    return _on_branch(geometry, sliders, _converged(geometry, sliders, postures), start[:1])


def forward_near(geometry: Geometry, sliders: Numbers, postures: Numbers) -> Numbers:
    """Postures ``(p, 6)`` of sliders ``(p, 6)`` next to given ones. Raises UnreachablePosture."""
    return _on_branch(geometry, sliders, _converged(geometry, sliders, postures), postures)


def _converged(geometry: Geometry, sliders: Numbers, postures: Numbers) -> Numbers:
    more = 2
    for _ in range(MOST_STEPS):
        step = _newton_step(geometry, sliders, postures, sliders)
        postures = postures + step
        size = np.abs(step).max(axis=1, initial=0.0)
        if not (size < FAR).all():
            break
        if (size < SMALL_STEP).all():
            more -= 1
        if more < 0:
            return postures
    raise _no_posture(sliders[int(np.nan_to_num(size, nan=np.inf).argmax())], "none")


def _newton_step(
    geometry: Geometry, sliders: Numbers, postures: Numbers, wanted: Numbers
) -> Numbers:
    """A step towards sliders on the way to those that are wanted.

    Raises UnreachablePosture where the platform is not held or earlier steps led away.
    """
    turn = Turn.at(postures[:, 3:])
    arm = geometry.platform @ transposed(turn.rotation)
    link = postures[:, None, :3] + arm - geometry.base - sliders[..., None] * geometry.rails
    miss = ((link * link).sum(axis=-1) - geometry.links**2) / 2.0
    far = ~(np.abs(postures).max(axis=1, initial=0.0) < FAR)
    if far.any():
        raise _no_posture(wanted[int(far.argmax())], "none")
    try:
        return np.linalg.solve(Arms.of(turn, link, arm).by_posture, -miss[..., None])[..., 0]
    except np.linalg.LinAlgError as problem:
        raise _no_posture(wanted[0], "a singular posture on the way") from problem


def _on_branch(geometry: Geometry, sliders: Numbers, postures: Numbers, near: Numbers) -> Numbers:
    """The postures, where a way from those that are ``near`` need not pass a singular one."""
    at = legs(geometry, postures)
    off = np.abs(at.sliders - sliders).max(axis=1, initial=0.0) > SMALL_STEP
    side = np.sign(np.linalg.det(at.arms.by_posture.real))
    off |= side != np.sign(np.linalg.det(legs(geometry, near).arms.by_posture.real))
    if off.any():
        raise _no_posture(sliders[int(off.argmax())], "one on another branch of the machine")
    return postures


def _no_posture(sliders: Numbers, found: str) -> UnreachablePosture:
    places = ", ".join(f"{place:g}" for place in sliders.real)
    return UnreachablePosture(
        f"posture of the sliders ({places}) m", found, "sliders of a reachable posture", NEXT_STEP
    )


def words(posture: Numbers) -> str:
    """A posture ``(6,)`` for a message, in metres and degrees."""
    x, y, z = posture.real[:3]
    theta, psi, phi = np.degrees(posture.real[3:])
    return f"({x:g}, {y:g}, {z:g}) m, ({theta:g}, {psi:g}, {phi:g})°"
