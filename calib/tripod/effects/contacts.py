"""Effects of contacts: the plate that the tool or a probe beside it meets, and how a probe hangs.

The place is ``"tz"`` for contacts along z, or the leg whose two bars tilt the platform.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from calib.arrays import LEG_NAMES, Conditions, FloatArray
from calib.tripod.effects.effect import (
    AT_MM,
    PER_THOUSAND,
    Acting,
    EffectParameter,
    Kind,
    Law,
    Placed,
    numbers,
)
from calib.tripod.effects.gauges import PlateTilt
from calib.tripod.geometry import Geometry
from calib.tripod.pipeline import Flow, Stage, commanded_tool, measuring_directions


@dataclass(frozen=True)
class TiltOfTouchedPlate(PlateTilt):
    """A plate that falls one way, as the tool meets it in contacts: nothing of an indicator."""

    id = "plate_tilt"
    title = "the plate that the tool touches is tilted"
    kind = Kind.MACHINE
    controller = "nothing to enter: level the plate"

    def places(self, conditions: Conditions) -> tuple[str, ...]:
        """The tool along every coordinate that it met a plate along."""
        return tuple(
            f"t{LEG_NAMES[axis]}" for axis in np.unique(conditions.axis[conditions.contact])
        )

    def moved(self, at: Acting, off_mm: NDArray[Any]) -> NDArray[Any]:
        """Touched points ``(..., n, 3)``."""
        conditions = at.flow.taken
        in_contact = conditions.contact & (conditions.axis == numbers(at.place)[1])
        along = measuring_directions(at.flow.geometry, conditions)
        return np.asarray((off_mm * in_contact)[..., None] * along)


Shape = Literal["first", "second", "twist", "round"]


@dataclass(frozen=True)
class BowOfTouchedPlate(TiltOfTouchedPlate):
    """The plate is no plane but bowed about its middle; positive: it falls from there outwards.

    Along the first (second) of the other two coordinates, along their diagonal, x = y, while it
    rises along x = -y, or every way alike: a dome, and a dish where it is negative.
    """

    shape: Shape = "first"
    id = "plate_bow"
    title = "the plate that the tool touches is not flat"
    controller = "nothing to enter: lay a flat plate, or probe one"

    @property
    def parameters(self) -> tuple[EffectParameter, ...]:  # type: ignore[override]
        """How much lower it is 100 mm from the middle."""
        return (EffectParameter(f"bow_{self.shape}_at_100mm", "mm", 0.05, 5.0),)

    def off(self, at: Acting) -> NDArray[Any]:
        """The value times the square of the way from Zero / 100 mm."""
        first, second = (k for k in range(3) if k != numbers(at.place)[1])
        x, y = (at.stage_input[..., k] / AT_MM for k in (first, second))
        first_square, second_square = x * x, y * y
        squares = {
            "first": first_square,
            "second": second_square,
            "twist": 2.0 * x * y,
            "round": first_square + second_square,
        }
        return np.asarray(at.values[0] * squares[self.shape])


SHAPES: tuple[BowOfTouchedPlate, ...] = (
    BowOfTouchedPlate("first"),
    BowOfTouchedPlate("second"),
    BowOfTouchedPlate("twist"),
)
"""They add up to any bow."""

ROUND = BowOfTouchedPlate("round")
"""The commonest one, a name of its own: as two bows it would be two causes."""


@dataclass(frozen=True)
class PlatformTilt(Law):
    """The two bars of a leg are unequal: the platform tilts, and a probe beside the tool with it.

    Otherwise in every posture. The tool itself, where the bars meet, stays. Positive: the bar on
    the anticlockwise side of the tower is longer; in parts of the distance between both.
    """

    id = "platform_tilt"
    title = "the platform tilts as it moves, and the probe beside the tool with it"
    stage = Stage.TOUCH
    parameters = (EffectParameter("unequal", "mrad", 1.0, 50.0),)
    controller = (
        "nothing to enter: make both bars of {place} equal, they differ by {unequal} of the "
        "distance between them; or probe with the nozzle"
    )

    def places(self, conditions: Conditions) -> tuple[str, ...]:
        """Every leg, where a probe beside the tool met a plate."""
        return LEG_NAMES if conditions.beside_mm.any() else ()

    def change(
        self, stage_input: NDArray[Any], flow: Flow, place: str, values: Sequence[Any]
    ) -> NDArray[Any]:
        """The probe's tip is turned about the tool."""
        turns = _turns(flow.geometry, flow.taken)[:, LEG_NAMES.index(place)]
        way = np.cross(turns, flow.taken.beside_mm)
        return np.asarray(stage_input + PER_THOUSAND * values[0] * way)


def _turns(geometry: Geometry, conditions: Conditions) -> FloatArray:
    """How each leg turns the platform ``(n, 3 legs, 3)``, rad for a part of one.

    Both bars of a leg run along ``b``; their ends on the platform are apart along ``t``, across the
    bar and the drive at Zero. A turn w makes one longer than the other by ``w (t x b)`` of their
    distance. All 0 on machines whose bars lie along their drives at Zero.
    """
    turns = np.zeros((len(conditions), 3, 3))
    if geometry.common_zero:
        return turns
    apart = np.cross(geometry.bars(np.zeros(3)), geometry.directions)
    apart /= np.linalg.norm(apart, axis=1)[:, None]
    off_centre = conditions.beside_mm.any(axis=1)
    longer = np.cross(apart, geometry.bars(commanded_tool(geometry, conditions)[off_centre]))
    turns[off_centre] = np.swapaxes(np.linalg.inv(longer), -1, -2)
    return turns


def contact_tolerances(bow_mm: float, unequal_mrad: float) -> dict[Placed, float]:
    """Laws of a plate that is met along z and of the platform, with the size that is usual of each.

    A bow of any direction is as likely: its twist is the smaller by a root of two. 0: none.
    """
    first, second, twist = SHAPES
    tolerances: dict[Placed, float] = {
        (first, "tz"): bow_mm,
        (second, "tz"): bow_mm,
        (twist, "tz"): bow_mm / math.sqrt(2.0),
        **{(PlatformTilt(), leg): unequal_mrad for leg in LEG_NAMES},
    }
    return {law: size for law, size in tolerances.items() if size}
