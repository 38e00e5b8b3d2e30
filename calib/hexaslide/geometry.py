"""Geometry of a Hexa Slide and the box in which it is measured; papers/001, section 2.

Its legs may also be telescopic, between joints that stand still: then nothing moves on rails.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calib.arrays import FloatArray
from calib.errors import CalibrationError, UnreachablePosture
from calib.hexaslide.arms import Arms, Numbers, Turn, transposed

CHAINS = 6

NOT_UNIT = 1e-9
"""By how much the square of a rail's length may differ from 1."""

LEVEL = 1e-3
"""A rail with a smaller z is not told by its x and y."""

OFF_FRAME_M = 1e-9
"""How far the first two rails may start from where the base frame puts them."""

ROUNDING = 1e-9
"""How far a bound may be passed by writing it down, metres or radians."""

WRITTEN_M = 1e-7
"""Postures are written to a millionth of a degree, sliders to 0.0001 mm: one that a search took to
the end of its travel may pass it by so much.
"""


MOST_ROOM = 0.1
"""Share of a travel."""


@dataclass(frozen=True, eq=False)
class Geometry:
    """Six chains in metres: ``base`` ``(6, 3)`` where the rails start, in the base frame; ``rails``
    ``(6, 3)`` unit vectors; ``platform`` ``(6, 3)`` the spherical joints in the frame of the
    platform; ``links`` ``(6,)`` lengths.

    Without rails, all of them zero, the legs are telescopic: ``base`` are joints that stand still,
    and a slider is by how much its leg is longer than ``links``.

    The base frame starts at the first rail and its X goes through the start of the second. Raises
    CalibrationError for anything else.
    """

    base: Numbers
    rails: Numbers
    platform: Numbers
    links: Numbers

    def __post_init__(self) -> None:
        for name, array in vars(self).items():
            shape = (CHAINS,) if name == "links" else (CHAINS, 3)
            if array.shape != shape or not np.isfinite(array).all():
                raise CalibrationError(
                    name, f"shape {array.shape}", f"finite numbers of shape {shape}: six chains"
                )
        for k, rail in enumerate(() if self.telescopic else self.rails.real, start=1):
            length = float(np.sqrt(rail @ rail))
            if abs(length**2 - 1.0) > NOT_UNIT:
                raise CalibrationError(f"rail {k}", f"length {length:.10g}", "a unit vector")
            if abs(rail[2]) < LEVEL:
                raise CalibrationError(
                    f"rail {k}", f"z = {rail[2]:g}", f"a rail that is not level, |z| ≥ {LEVEL:g}"
                )
        if not self.telescopic and not (self.links.real > 0.0).all():
            raise CalibrationError("links", f"{self.links.real.min():g} m", "positive lengths")
        fixed = np.append(self.base[0], self.base[1, 1:]).real
        if np.abs(fixed).max() > OFF_FRAME_M or not abs(self.base[1, 0]) > OFF_FRAME_M:
            raise CalibrationError(
                "base frame",
                f"{self.part}s that start at {self.base[0].real} and {self.base[1].real}",
                f"the first {self.part} at [0, 0, 0], the second at [x, 0, 0]",
            )

    @cached_property
    def telescopic(self) -> bool:
        """Whether the legs change their lengths between joints that stand still."""
        return not self.rails.real.any()

    @property
    def part(self) -> str:
        """What a drive moves along, for people."""
        return "leg" if self.telescopic else "rail"

    @cached_property
    def inclination(self) -> Numbers:
        """Level components of the rails by their z ``(6, 2)``; zeros without rails."""
        z = np.ones((CHAINS, 1)) if self.telescopic else self.rails[:, 2:]
        return np.asarray(self.rails[:, :2] / z)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return TELESCOPIC_NAMES if self.telescopic else NAMES


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

    @property
    def centre_mm_deg(self) -> list[float]:
        """The centre in millimetres and degrees."""
        return [*(1000.0 * self.centre[:3]).tolist(), *np.degrees(self.centre[3:]).tolist()]

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


MOST_DRAWN = 50
"""Times as many postures are drawn at most to find those that are wanted."""


def first_of_draws(draw: Callable[[], FloatArray], count: int) -> FloatArray:
    """The first ``count`` postures of as many draws ``(k, 6)`` as are needed, fewer where
    `MOST_DRAWN` draws have fewer.
    """
    postures = np.zeros((0, 6))
    for _ in range(MOST_DRAWN):
        postures = np.concatenate([postures, draw()])
        if len(postures) >= count:
            break
    return postures[:count]


COORDINATES = ("x_m", "y_m", "z_m", "theta_deg", "psi_deg", "phi_deg")
"""Names of a posture's coordinates where a person reads them."""

PER_CHAIN = ("Bx", "By", "Bz", "Ax", "Ay", "Az", "ax", "ay", "l")
ALL_NAMES = tuple(f"{part}{chain}" for chain in range(1, CHAINS + 1) for part in PER_CHAIN)
FIXED = ("Ax1", "Ay1", "Az1", "Ay2", "Az2")
FREE = tuple(k for k, name in enumerate(ALL_NAMES) if name not in FIXED)
NAMES = tuple(ALL_NAMES[k] for k in FREE)
TELESCOPIC_NAMES = tuple(name for name in NAMES if name[:2] not in {"ax", "ay"})
"""Without rails there are none of their components."""

END_NAMES = ("cx", "cy", "cz", "dx", "dy", "dz")
LENGTH_NAME = "L"

ENCODERS = tuple(f"{way}{chain}" for chain in range(1, CHAINS + 1) for way in ("turn", "swing"))
"""In the universal joint of each carriage: how far the link is turned about its rail, and the angle
between link and rail.
"""

ZERO_NAMES = tuple(f"zero_{name}" for name in ENCODERS)
"""What each of them reads too much, radians."""


def unit_of(name: str) -> str:
    """The unit of a parameter; components of rails are m across in 1 m along."""
    return "m/m" if name[:2] in {"ax", "ay"} else "rad" if name in ZERO_NAMES else "m"


def values(geometry: Geometry) -> Numbers:
    """The 49 parameters of a geometry."""
    parts = [geometry.platform, geometry.base, geometry.rails[:, :2], geometry.links[:, None]]
    return np.concatenate(parts, axis=1).reshape(-1)[list(FREE)]


def with_values(geometry: Geometry, parameters: Numbers) -> Geometry:
    """The geometry with these 49 parameters; rails keep the sign of their z, none stay none."""
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
    """A machine with the box of its postures and, for that procedure, the constraint link.

    ``zeros_rad`` ``(12,)`` are those of `ENCODERS`; ``travel_m`` ``(2, 6)`` the least and the most
    of each slider between the ends of its rail, infinite where nobody said.
    """

    geometry: Geometry
    box: Box
    link: ConstraintLink | None = None
    zeros_rad: FloatArray = field(default_factory=lambda: np.zeros(len(ENCODERS)))
    travel_m: FloatArray = field(
        default_factory=lambda: np.outer([-np.inf, np.inf], np.ones(CHAINS))
    )

    def parameters(self, names: tuple[str, ...]) -> FloatArray:
        """Values ``(k,)`` of these parameters, metres and radians; components of rails have no
        unit.
        """
        by_name = self._by_name()
        return np.array([by_name[name] for name in names])

    def _by_name(self) -> dict[str, float]:
        by_name = dict(zip(NAMES, values(self.geometry).tolist(), strict=True))
        by_name |= zip(ZERO_NAMES, self.zeros_rad.tolist(), strict=True)
        if self.link is not None:
            ends = np.concatenate([self.link.platform_end, self.link.base_end])
            by_name |= zip(END_NAMES, ends.tolist(), strict=True)
            by_name[LENGTH_NAME] = self.link.length_m
        return by_name

    def with_parameters(self, names: tuple[str, ...], parameters: FloatArray) -> HexaSlide:
        """A machine with these ``(k,)``. Raises CalibrationError for what is no machine."""
        by_name = self._by_name() | dict(zip(names, parameters.tolist(), strict=True))
        with np.errstate(invalid="ignore"):  # a rail longer than 1: refused by the geometry
            geometry = with_values(self.geometry, np.array([by_name[name] for name in NAMES]))
        link = self.link
        if link is not None:
            ends = np.array([by_name[name] for name in END_NAMES])
            link = ConstraintLink(ends[:3], ends[3:], by_name[LENGTH_NAME])
        zeros = np.array([by_name[name] for name in ZERO_NAMES])
        return replace(self, geometry=geometry, link=link, zeros_rad=zeros)

    def with_room(self, room_m: float) -> HexaSlide:
        """The ends of its travel so far inside, by `MOST_ROOM` of it at most."""
        least, greatest = self.travel_m
        room = np.minimum(room_m, MOST_ROOM * (greatest - least))
        return replace(self, travel_m=np.array([least + room, greatest - room]))

    def within(self, sliders: FloatArray, beyond_m: float = ROUNDING) -> NDArray[np.bool_]:
        """Which sliders ``(p, 6)`` are between the ends of their rails, or no farther beyond."""
        least, greatest = self.travel_m
        return np.asarray((least - beyond_m <= sliders) & (sliders <= greatest + beyond_m))

    def random(self, count: int, generator: np.random.Generator) -> FloatArray:
        """Postures ``(count, 6)``, evenly in the part of the box that the rails reach.

        Raises CalibrationError where that is too little.
        """

        def draw() -> FloatArray:
            candidates = self.box.random(count, generator)
            return candidates[self.within(inverse(self.geometry, candidates)).all(axis=1)]

        postures = first_of_draws(draw, count)
        if len(postures) < count:
            sliders = inverse(self.geometry, self.box.grid())
            chain = int((~self.within(sliders)).sum(axis=0).argmax())
            low, high = sliders[:, chain].min(), sliders[:, chain].max()
            part = self.geometry.part
            raise CalibrationError(
                "travel of the sliders",
                f"{part}s that reach {len(postures)} of {MOST_DRAWN * count} random postures of "
                f"the box; all of it takes {1000.0 * low:.0f} to {1000.0 * high:.0f} mm of chain "
                f"{chain + 1}",
                f"{part}s that reach a good part of the box",
                "Correct travel_mm or [box] in the machine file.",
            )
        return postures

    def inside(self, postures: FloatArray) -> FloatArray:
        """Which postures are in the box, as of `Box.inside`, and within reach of the sliders."""
        postures = self.box.inside(postures)
        self.sliders_at(postures)
        return postures

    def sliders_at(self, postures: FloatArray, suffix: str = "") -> FloatArray:
        """Positions of the sliders ``(p, 6)`` in postures ``(p, 6)``, ``suffix`` for an error.

        Raises UnreachablePosture, and CalibrationError for one beyond the ends of its rail.
        """
        sliders = np.asarray(inverse(self.geometry, postures))
        beyond = np.argwhere(~self.within(sliders, WRITTEN_M))
        if len(beyond):
            row, chain = beyond[0].tolist()
            least, greatest = self.travel_m[:, chain]
            raise CalibrationError(
                f"posture {row + 1}{suffix}, slider {chain + 1}",
                f"{1000.0 * sliders[row, chain]:.3f} mm",
                f"{1000.0 * least:g} to {1000.0 * greatest:g} mm, its travel_mm",
            )
        return sliders


MOTIONS = (
    *(f"platform frame turned about its {axis}" for axis in "XYZ"),
    *(f"platform frame shifted along its {axis}" for axis in "XYZ"),
    "base turned about X",
)
"""Of frames as wholes, on every machine."""

OF_TRACKER = (
    MOTIONS[-1],
    *(f"base turned about {axis}" for axis in "YZ"),
    *(f"base shifted along {axis}" for axis in "XYZ"),
)
"""Of the frame in which places are measured: nobody sets up a tracker exactly on the first rail."""

LAID_OVER = (*MOTIONS, *OF_TRACKER[1:])
"""What may be laid over a machine at its platform, in the order of `frame_motions`."""


def motions(machine: HexaSlide, names: tuple[str, ...]) -> tuple[tuple[str, FloatArray], ...]:
    """Frames moved as wholes, as changes of the named parameters, each of unit length.

    The platform's frame may be turned and shifted with all that is fixed to it; where the end of
    the link on it is known, turned about that end. The base, held by its frame, may only be turned
    about X. Which of them a procedure loses, its derivatives tell.
    """
    geometry, link = machine.geometry, machine.link
    end, far = np.zeros((2, 3)) if link is None else (link.platform_end, link.base_end)
    still, unturned = np.zeros(3), np.zeros(CHAINS)

    def moved(
        platform: Numbers = still,
        c: Numbers = still,
        base: Numbers = still,
        rails: Numbers = still,
        d: Numbers = still,
        zeros: Numbers = unturned,
    ) -> FloatArray:
        """By how much points move, as a change of the parameters."""
        full = np.zeros((CHAINS, len(PER_CHAIN)))
        full[:, :3], full[:, 3:6], full[:, 6:8] = platform, base, rails[..., :2]
        by_name = dict(zip(ALL_NAMES, full.ravel(), strict=True))
        by_name |= zip(END_NAMES, (*c, *d), strict=True)
        by_name |= zip(ZERO_NAMES[::2], zeros, strict=True)
        vector = np.array([by_name.get(name, 0.0) for name in names])
        return np.asarray(vector / np.linalg.norm(vector))

    def turned(unit: FloatArray, centre: FloatArray) -> FloatArray:
        """The platform's joints and its end of the link about a point."""
        return moved(np.cross(unit, geometry.platform - centre), np.cross(unit, end - centre))

    axes = np.eye(3)
    motions_of_base = [
        *(turned(unit, still) for unit in axes),
        *(moved(unit, unit) for unit in axes),
    ]
    named_motions = list(zip(MOTIONS[:-1], motions_of_base, strict=True))
    if link is not None and "cx" not in names:
        about = "platform frame turned about the link's end"
        named_motions += [
            (f"{about}, {a}", turned(u, end)) for a, u in zip("XYZ", axes, strict=True)
        ]
    base, rails, ends = (np.cross(axes[0], point) for point in (geometry.base, geometry.rails, far))
    lag = _lag(geometry.rails, rails)
    named_motions.append((MOTIONS[-1], moved(base=base, rails=rails, d=ends, zeros=lag)))
    return tuple(named_motions)


def _lag(rails: Numbers, moved: Numbers) -> Numbers:
    """By how much less the links turn about their rails ``(6,)`` than these about X, in which they
    move by ``(6, 3)``; see `calib.hexaslide.derivatives.Joints`.
    """
    lead = np.sign(rails[:, 2]) / (1.0 + np.abs(rails[:, 2]))
    turned = lead * (rails[:, 1] * moved[:, 0] - rails[:, 0] * moved[:, 1])
    return np.asarray(turned - rails[:, 0])


SHORTEST_M = 1e-6
"""A shorter telescopic leg has no direction."""

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
    """Links at postures: ``sliders`` ``(p, 6)``; ``lean`` ``(p, 6)``, the components of the links
    along their rails, positive on the branch of the machine, of telescopic legs their lengths;
    ``arms`` with vectors along the links from slider to platform, each 1 along its rail, or of
    length 1.
    """

    arms: Arms
    sliders: Numbers
    lean: Numbers


def rotation(angles: Numbers) -> Numbers:
    """``R`` ``(p, 3, 3)`` of ``(p, 3)``, as in `Turn`."""
    return Turn.at(angles).rotation


def legs(geometry: Geometry, postures: Numbers) -> Legs:
    """Sliders and links at postures ``(p, 6)``; papers/001, equation (3).

    Raises UnreachablePosture where a link is too short to meet its rail, or a leg has no length.
    """
    turn = Turn.at(postures[:, 3:])
    arm = geometry.platform @ transposed(turn.rotation)
    reach = postures[:, None, :3] + arm - geometry.base
    if geometry.telescopic:
        length = np.sqrt((reach * reach).sum(axis=-1))
        if not length.real.min(initial=np.inf) > SHORTEST_M:
            at = int(length.real.min(axis=1).argmin())
            raise UnreachablePosture(
                f"posture {words(postures[at])}",
                "a leg without length",
                "postures whose joints are apart",
                NEXT_STEP,
            )
        return Legs(Arms.of(turn, reach / length[..., None], arm), length - geometry.links, length)
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
    extra = 2
    for _ in range(MOST_STEPS):
        step = _newton_step(geometry, sliders, postures, sliders)
        postures = postures + step
        size = np.abs(step).max(axis=1, initial=0.0)
        if not (size < FAR).all():
            break
        if (size < SMALL_STEP).all():
            extra -= 1
        if extra < 0:
            return postures
    raise _no_posture(sliders[int(np.nan_to_num(size, nan=np.inf).argmax())], "none")


def _newton_step(
    geometry: Geometry, sliders: Numbers, postures: Numbers, sliders_wanted: Numbers
) -> Numbers:
    """A step towards sliders on the way to those that are wanted.

    Raises UnreachablePosture where the platform is not held or earlier steps led away.
    """
    turn = Turn.at(postures[:, 3:])
    arm = geometry.platform @ transposed(turn.rotation)
    link = postures[:, None, :3] + arm - geometry.base - sliders[..., None] * geometry.rails
    length = geometry.links + sliders if geometry.telescopic else geometry.links
    miss = ((link * link).sum(axis=-1) - length**2) / 2.0
    far = ~(np.abs(postures).max(axis=1, initial=0.0) < FAR)
    if far.any():
        raise _no_posture(sliders_wanted[int(far.argmax())], "none")
    try:
        return np.linalg.solve(Arms.of(turn, link, arm).by_posture, -miss[..., None])[..., 0]
    except np.linalg.LinAlgError as problem:
        raise _no_posture(sliders_wanted[0], "a singular posture on the way") from problem


def _on_branch(geometry: Geometry, sliders: Numbers, postures: Numbers, near: Numbers) -> Numbers:
    """The postures, where a way from those that are ``near`` need not pass a singular one."""
    at = legs(geometry, postures)
    off = np.abs(at.sliders - sliders).max(axis=1, initial=0.0) > SMALL_STEP
    side = np.sign(np.linalg.det(at.arms.by_posture.real))
    off |= side != np.sign(np.linalg.det(legs(geometry, near).arms.by_posture.real))
    if off.any():
        raise _no_posture(sliders[int(off.argmax())], "one on another branch of the machine")
    return postures


def _no_posture(sliders: Numbers, reason: str) -> UnreachablePosture:
    places = ", ".join(f"{place:g}" for place in sliders.real)
    return UnreachablePosture(
        f"posture of the sliders ({places}) m", reason, "sliders of a reachable posture", NEXT_STEP
    )


def in_degrees(postures: FloatArray) -> tuple[dict[str, float], ...]:
    """Postures ``(p, 6)`` by the names of their coordinates, metres and degrees."""
    rows = np.hstack([postures[:, :3], np.degrees(postures[:, 3:])])
    return tuple(dict(zip(COORDINATES, row, strict=True)) for row in rows.tolist())


def words(posture: Numbers) -> str:
    """A posture ``(6,)`` for a message, in metres and degrees."""
    x, y, z = posture.real[:3]
    theta, psi, phi = np.degrees(posture.real[3:])
    return f"({x:g}, {y:g}, {z:g}) m, ({theta:g}, {psi:g}, {phi:g})°"
