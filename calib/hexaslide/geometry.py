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
