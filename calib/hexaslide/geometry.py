"""Geometry of a Hexa Slide and the box in which it is measured; papers/001, section 2."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.arrays import FloatArray
from calib.errors import CalibrationError, UnreachablePosture

Numbers = NDArray[Any]
"""Real, or complex where derivatives are taken by a complex step."""

CHAINS = 6

NOT_UNIT = 1e-9
"""By how much the square of a rail's length may differ from 1."""

LEVEL = 1e-3
"""A rail with a smaller z is not told by its x and y."""

OFF_FRAME_M = 1e-9
"""How far the first two rails may start from where the base frame puts them."""

ROUNDING = 1e-9
"""How far a bound may be passed by writing it down, metres or radians."""


@dataclass(frozen=True, eq=False)
class Geometry:
    """Six chains in metres: ``base`` ``(6, 3)`` where the rails start, in the base frame; ``rails``
    ``(6, 3)`` unit vectors; ``platform`` ``(6, 3)`` the spherical joints in the frame of the
    platform; ``links`` ``(6,)`` lengths.

    The base frame starts at the first rail and its X goes through the start of the second. Raises
    CalibrationError for anything else.
    """

    base: Numbers
    rails: Numbers
    platform: Numbers
    links: Numbers

    def __post_init__(self) -> None:
        for name, shape in (
            ("base", (CHAINS, 3)),
            ("rails", (CHAINS, 3)),
            ("platform", (CHAINS, 3)),
            ("links", (CHAINS,)),
        ):
            array = getattr(self, name)
            if array.shape != shape or not np.isfinite(array).all():
                raise CalibrationError(
                    name, f"shape {array.shape}", f"finite numbers of shape {shape}: six chains"
                )
        self._check_rails()
        if not (self.links.real > 0.0).all():
            raise CalibrationError("links", f"{self.links.real.min():g} m", "positive lengths")
        fixed = np.append(self.base[0], self.base[1, 1:]).real
        if np.abs(fixed).max() > OFF_FRAME_M or not abs(self.base[1, 0]) > OFF_FRAME_M:
            raise CalibrationError(
                "base frame",
                f"rails that start at {self.base[0].real} and {self.base[1].real}",
                "the first rail at [0, 0, 0], the second at [x, 0, 0]",
            )

    def _check_rails(self) -> None:
        for k, rail in enumerate(self.rails.real, start=1):
            length = float(np.sqrt(rail @ rail))
            if abs(length**2 - 1.0) > NOT_UNIT:
                raise CalibrationError(f"rail {k}", f"length {length:.10g}", "a unit vector")
            if abs(rail[2]) < LEVEL:
                raise CalibrationError(
                    f"rail {k}", f"z = {rail[2]:g}", f"a rail that is not level, |z| ≥ {LEVEL:g}"
                )


@dataclass(frozen=True, eq=False)
class ConstraintLink:
    """A bar of fixed length between platform and base: ends ``(3,)`` in their frames, metres."""

    platform_end: Numbers
    base_end: Numbers
    length_m: float

    def __post_init__(self) -> None:
        if not self.length_m > 0.0:
            raise CalibrationError("constraint link", f"{self.length_m:g} m", "a positive length")


def present(link: ConstraintLink | None) -> ConstraintLink:
    """The link of a machine. Raises CalibrationError where it has none."""
    if link is None:
        raise CalibrationError("constraint link", "none", "one in the machine file")
    return link


@dataclass(frozen=True, eq=False)
class Box:
    """Bounds ``(6,)`` of the coordinates x, y, z in metres and theta, psi, phi in radians."""

    lower: FloatArray
    upper: FloatArray

    def __post_init__(self) -> None:
        if self.lower.shape != (6,) or not (self.lower < self.upper).all():
            raise CalibrationError(
                "box", f"{self.lower} to {self.upper}", "lower < upper, six each"
            )

    @property
    def centre(self) -> FloatArray:
        """The posture ``(6,)`` in the middle."""
        return np.asarray((self.lower + self.upper) / 2.0)

    def random(self, count: int, generator: np.random.Generator) -> FloatArray:
        """Postures ``(count, 6)``, evenly distributed."""
        return generator.uniform(self.lower, self.upper, (count, 6))

    def grid(self) -> FloatArray:
        """Three values of each coordinate: postures ``(729, 6)``."""
        axes = np.linspace(self.lower, self.upper, 3).T
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 6)

    def inside(self, postures: FloatArray) -> FloatArray:
        """The postures ``(p, 6)``, on the bounds where only rounding is outside.

        Raises CalibrationError for one that is farther outside.
        """
        outside = (postures < self.lower - ROUNDING) | (postures > self.upper + ROUNDING)
        if outside.any():
            row, column = (int(part[0]) for part in np.nonzero(outside))
            unit = 1.0 if column < 3 else np.degrees(1.0)
            low, high = unit * self.lower[column], unit * self.upper[column]
            raise CalibrationError(
                f"posture {row + 1}, {COORDINATES[column]}",
                f"{unit * postures[row, column]:g}",
                f"{low:g} to {high:g}, the machine's box",
            )
        return np.asarray(np.clip(postures, self.lower, self.upper))


COORDINATES = ("x_m", "y_m", "z_m", "theta_deg", "psi_deg", "phi_deg")
"""Names of a posture's coordinates where a person reads them."""

PER_CHAIN = ("Bx", "By", "Bz", "Ax", "Ay", "Az", "ax", "ay", "l")
ALL_NAMES = tuple(f"{part}{chain}" for chain in range(1, CHAINS + 1) for part in PER_CHAIN)
FIXED = ("Ax1", "Ay1", "Az1", "Ay2", "Az2")
FREE = tuple(k for k, name in enumerate(ALL_NAMES) if name not in FIXED)
NAMES = tuple(ALL_NAMES[k] for k in FREE)
END_NAMES = ("cx", "cy", "cz", "dx", "dy", "dz")
LENGTH_NAME = "L"


def unit_of(name: str) -> str:
    """The unit of a parameter: components of directions have none."""
    return "1" if name[:2] in {"ax", "ay"} else "m"


def values(geometry: Geometry) -> Numbers:
    """The 49 parameters of a geometry."""
    parts = [geometry.platform, geometry.base, geometry.rails[:, :2], geometry.links[:, None]]
    return np.concatenate(parts, axis=1).reshape(-1)[list(FREE)]


def with_values(geometry: Geometry, parameters: Numbers) -> Geometry:
    """The geometry with these 49 parameters; rails keep the sign of their z."""
    full = np.zeros(len(ALL_NAMES), dtype=parameters.dtype)
    full[list(FREE)] = parameters
    rows = full.reshape(CHAINS, len(PER_CHAIN))
    level = rows[:, 6:8]
    sign = np.sign(geometry.rails[:, 2].real)
    z = sign * np.sqrt(1.0 - (level * level).sum(axis=1))
    rails = np.column_stack([level, z])
    return Geometry(rows[:, 3:6], rails, rows[:, :3], rows[:, 8])


@dataclass(frozen=True, eq=False)
class HexaSlide:
    """A machine with the box of its postures and, for that procedure, the constraint link."""

    geometry: Geometry
    box: Box
    link: ConstraintLink | None = None

    def parameters(self, names: tuple[str, ...]) -> FloatArray:
        """Their values ``(k,)`` in metres; components of rails have no unit."""
        known = self._by_name()
        return np.array([known[name] for name in names])

    def _by_name(self) -> dict[str, float]:
        found = dict(zip(NAMES, values(self.geometry).tolist(), strict=True))
        if self.link is not None:
            ends = np.concatenate([self.link.platform_end, self.link.base_end])
            found |= zip(END_NAMES, ends.tolist(), strict=True)
            found[LENGTH_NAME] = self.link.length_m
        return found

    def with_parameters(self, names: tuple[str, ...], parameters: FloatArray) -> HexaSlide:
        """The same with these ``(k,)``. Raises CalibrationError for what is no machine."""
        found = self._by_name() | dict(zip(names, parameters.tolist(), strict=True))
        with np.errstate(invalid="ignore"):  # a rail longer than 1: refused by the geometry
            geometry = with_values(self.geometry, np.array([found[name] for name in NAMES]))
        link = self.link
        if link is not None:
            ends = np.array([found[name] for name in END_NAMES])
            link = ConstraintLink(ends[:3], ends[3:], found[LENGTH_NAME])
        return HexaSlide(geometry, self.box, link)


def motions(
    geometry: Geometry, link: ConstraintLink | None, names: tuple[str, ...]
) -> tuple[tuple[str, FloatArray], ...]:
    """Frames moved as wholes, as changes of the named parameters, each of unit length.

    The platform's frame may be turned and shifted with all that is fixed to it; where the end of
    the link on it is known, turned about that end. The base, held by its frame, may only be turned
    about X. Which of them a procedure loses, its derivatives tell.
    """
    end, far = np.zeros((2, 3)) if link is None else (link.platform_end, link.base_end)
    still = np.zeros(3)

    def moved(
        platform: Numbers = still,
        c: Numbers = still,
        base: Numbers = still,
        rails: Numbers = still,
        d: Numbers = still,
    ) -> FloatArray:
        """By how much points move, as a change of the parameters."""
        full = np.zeros((CHAINS, len(PER_CHAIN)))
        full[:, :3], full[:, 3:6], full[:, 6:8] = platform, base, rails[..., :2]
        known = dict(zip(ALL_NAMES, full.ravel(), strict=True))
        known |= zip(END_NAMES, (*c, *d), strict=True)
        vector = np.array([known.get(name, 0.0) for name in names])
        return np.asarray(vector / np.linalg.norm(vector))

    def turned(unit: FloatArray, centre: FloatArray) -> FloatArray:
        """The platform's joints and its end of the link about a point."""
        return moved(np.cross(unit, geometry.platform - centre), np.cross(unit, end - centre))

    axes = dict(zip("XYZ", np.eye(3), strict=True))
    found = {f"platform frame turned about its {a}": turned(u, still) for a, u in axes.items()}
    found |= {f"platform frame shifted along its {a}": moved(u, u) for a, u in axes.items()}
    if link is not None and "cx" not in names:
        about = "platform frame turned about the link's end"
        found |= {f"{about}, {a}": turned(u, end) for a, u in axes.items()}
    base, rails, other = (np.cross(axes["X"], one) for one in (geometry.base, geometry.rails, far))
    found["base turned about X"] = moved(base=base, rails=rails, d=other)
    return tuple(found.items())


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
