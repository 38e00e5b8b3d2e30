"""Inverse and forward kinematics of a Hexa Slide, many postures at once; papers/001, section 2.

Everything here passes complex numbers, so that derivatives can be taken by a complex step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.errors import UnreachablePosture
from calib.hexaslide.geometry import Box, Geometry, Numbers

MOST_STEPS = 60
SMALL_STEP = 1e-9
"""Newton doubles the digits: after a smaller step two more leave rounding only."""

STAGES = (0.25, 0.5, 0.75)
STEPS_OF_STAGE = 3

FAR = 1e3
"""A step to coordinates larger than this, metres or radians, will not come back."""

NEXT_STEP = "Choose a posture inside the workspace, or check the geometry."


@dataclass(frozen=True, eq=False)
class Legs:
    """Links at postures: ``sliders`` ``(p, 6)``; ``links`` ``(p, 6, 3)`` from slider to platform;
    ``lean`` ``(p, 6)``, their component along the rail, positive on the branch of the machine.
    """

    sliders: Numbers
    links: Numbers
    lean: Numbers


def rotation(angles: Numbers) -> Numbers:
    """``R = Ry(theta) Rx(psi) Rz(phi)`` ``(p, 3, 3)`` of ``(p, 3)``; papers/001, equation (2)."""
    return rotation_and_slopes(angles)[0]


def rotation_and_slopes(angles: Numbers) -> tuple[Numbers, Numbers]:
    """``R`` ``(p, 3, 3)`` and its derivatives by the angles ``(p, 3, 3, 3)``, angle first."""
    turns = [_turn(axis, angles[:, k]) for k, axis in enumerate((1, 0, 2))]
    (y, dy), (x, dx), (z, dz) = turns
    slopes = np.stack([dy @ x @ z, y @ dx @ z, y @ x @ dz], axis=1)
    return y @ x @ z, slopes


def _turn(axis: int, angle: Numbers) -> tuple[Numbers, Numbers]:
    """Rotation about an axis of the frame, and its derivative, both ``(p, 3, 3)``."""
    first, second = (axis + 1) % 3, (axis + 2) % 3
    cosine, sine = np.cos(angle), np.sin(angle)
    turned = np.zeros((len(angle), 3, 3), dtype=angle.dtype)
    turned[:, axis, axis] = 1.0
    turned[:, first, first] = turned[:, second, second] = cosine
    turned[:, second, first], turned[:, first, second] = sine, -sine
    slope = np.zeros_like(turned)
    slope[:, first, first] = slope[:, second, second] = -sine
    slope[:, second, first], slope[:, first, second] = cosine, -cosine
    return turned, slope


def joints(geometry: Geometry, postures: Numbers) -> Numbers:
    """Platform joints seen from where their rails start ``(p, 6, 3)``."""
    turned = np.einsum("pij,kj->pki", rotation(postures[:, 3:]), geometry.platform)
    return np.asarray(postures[:, None, :3] + turned - geometry.base)


def legs(geometry: Geometry, postures: Numbers) -> Legs:
    """Sliders and links at postures ``(p, 6)``; papers/001, equation (3).

    Raises UnreachablePosture where a link is too short to meet its rail.
    """
    reach = joints(geometry, postures)
    along = (reach * geometry.rails).sum(axis=-1)
    square = geometry.links**2 - (reach * reach).sum(axis=-1) + along**2
    short = square.real <= 0.0
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
    return Legs(sliders, reach - sliders[..., None] * geometry.rails, lean)


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
    left = 2
    for _ in range(MOST_STEPS):
        step = _newton_step(geometry, sliders, postures, sliders)
        postures = postures + step
        size = np.abs(step).max(axis=1, initial=0.0)
        if not (size < FAR).all():
            break
        if (size < SMALL_STEP).all():
            left -= 1
        if left < 0:
            return postures
    raise _no_posture(sliders[int(np.nan_to_num(size, nan=np.inf).argmax())], "none")


def _newton_step(
    geometry: Geometry, sliders: Numbers, postures: Numbers, wanted: Numbers
) -> Numbers:
    """A step towards sliders on the way to those that are wanted.

    Raises UnreachablePosture where the platform is not held or earlier steps led away.
    """
    link = joints(geometry, postures) - sliders[..., None] * geometry.rails
    miss = ((link * link).sum(axis=-1) - geometry.links**2) / 2.0
    far = ~(np.abs(postures).max(axis=1, initial=0.0) < FAR)
    if far.any():
        raise _no_posture(wanted[int(far.argmax())], "none")
    try:
        return np.linalg.solve(pulls(geometry, postures, link), -miss[..., None])[..., 0]
    except np.linalg.LinAlgError as problem:
        raise _no_posture(wanted[0], "a singular posture on the way") from problem


def pulls(geometry: Geometry, postures: Numbers, link: Numbers) -> Numbers:
    """``link · d(joint)/d(posture)`` ``(p, 6, 6)`` for links ``(p, 6, 3)``."""
    slopes = rotation_and_slopes(postures[:, 3:])[1]
    turned = np.einsum("pki,paij,kj->pka", link, slopes, geometry.platform, optimize=True)
    return np.concatenate([link, turned], axis=-1)


def _on_branch(geometry: Geometry, sliders: Numbers, postures: Numbers, near: Numbers) -> Numbers:
    """The postures, where a way from those that are ``near`` need not pass a singular one."""
    at = legs(geometry, postures)
    off = np.abs(at.sliders - sliders).max(axis=1, initial=0.0) > SMALL_STEP
    side = np.sign(np.linalg.det(pulls(geometry, postures, at.links).real))
    own = np.sign(np.linalg.det(pulls(geometry, near, legs(geometry, near).links).real))
    off |= side != own
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
