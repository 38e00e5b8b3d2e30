"""Geometry of a Hexa Slide and the box in which it is measured; papers/001, section 2."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.errors import CalibrationError
from calib.observations import FloatArray

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
