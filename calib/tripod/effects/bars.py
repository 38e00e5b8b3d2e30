"""Effects of the three bars: how they give under weight and what their surface is like."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.tripod.effects.effect import (
    BOTH_WAYS,
    PER_THOUSAND,
    REPEATABLE,
    Acting,
    EffectParameter,
    Kind,
    OfCarriageOrBar,
    OfTouch,
)
from calib.tripod.effects.environment import kelvins
from calib.tripod.geometry import Geometry, trilaterate
from calib.tripod.pipeline import Stage

FLOATS = 0.02
"""Force in a bar, in units of the weight, that friction in its joints holds without moving them."""


SURFACE_ONLY = "nothing to enter: the touched surface, not the machine"


@dataclass(frozen=True)
class LegLength(OfCarriageOrBar):
    """A bar is longer than the machine file says, by more than its tolerance allows."""

    id: str = "leg_length"
    title: str = "a bar is not as long as the machine file says, beyond its tolerance"
    kind: Kind = Kind.MACHINE
    stage: Stage = Stage.TOOL
    parameters: tuple[EffectParameter, ...] = (EffectParameter("length", "mm", 0.1),)
    invariances: tuple[str, ...] = (*REPEATABLE, "does not change with the load")
    controller: str = "bar {place}: the kinematics of export --format linuxcnc-kins"

    def off_mm(self, at: Acting) -> NDArray[Any]:
        """The bar is longer by the value."""
        return np.asarray(at.values[0] * np.ones(len(at.flow.taken)))


@dataclass(frozen=True)
class GravitySag(OfCarriageOrBar):
    """Bars are axial springs that carry the tool; positive: a pressed bar gets shorter."""

    id: str = "gravity_sag"
    title: str = "the bars give under the weight of the tool"
    kind: Kind = Kind.MACHINE
    stage: Stage = Stage.TOOL
    parameters: tuple[EffectParameter, ...] = (EffectParameter("shortening", "mm", 0.02),)
    invariances: tuple[str, ...] = (
        *REPEATABLE,
        "changes with the load and with how the machine stands",
    )
    controller: str = "bar {place}: the kinematics of export --format linuxcnc-kins"

    def off_mm(self, at: Acting) -> NDArray[Any]:
        """The bar changes its length by value · load · pull / weight, at the unloaded machine."""
        pull = pull_of_weight(at.flow.geometry, at.flow.foot_mm, at.stage_input)
        return np.asarray(at.values[0] * at.flow.geometry.load * pull[..., at.leg])


def pull_of_weight(
    geometry: Geometry, foot_mm: NDArray[Any], length_mm: NDArray[Any]
) -> NDArray[Any]:
    """Pull in each bar ``(..., 3)`` in units of the weight; negative: it is pressed.

    Equilibrium of the platform: the unit vectors u_i from foot to platform satisfy
    sum pull_i u_i = g, the unit vector of gravity.
    """
    feet = foot_mm - geometry.platform
    tool = trilaterate(feet, length_mm, geometry.side)
    bars = (tool[..., None, :] - feet) / length_mm[..., None]
    weight = np.asarray(geometry.gravity, dtype=np.float64)[:, None]
    pull = np.linalg.solve(np.swapaxes(bars, -1, -2), weight)
    return np.asarray(pull[..., 0])


@dataclass(frozen=True)
class BarGrowth(OfCarriageOrBar):
    """A bar grows with temperature; kelvins count from 20 °C. 310 mm of aluminium: 7 µm/K."""

    id: str = "thermal_growth"
    title: str = "a bar grows with the temperature"
    kind: Kind = Kind.ENVIRONMENT
    stage: Stage = Stage.TOOL
    parameters: tuple[EffectParameter, ...] = (EffectParameter("bar_per_kelvin", "µm/K", 3.0),)
    invariances: tuple[str, ...] = (BOTH_WAYS, "0 at 20 °C")
    controller: str = "nothing to enter: keep the machine at the temperature of its calibration"

    def off_mm(self, at: Acting) -> NDArray[Any]:
        """The bar is longer by value · (temperature - 20 °C)."""
        return np.asarray(PER_THOUSAND * at.values[0] * kelvins(at.flow.taken))


@dataclass(frozen=True)
class JointClearance(OfCarriageOrBar):
    """The joints of a bar have clearance: it is longer pulled than pressed.

    Between both it floats: the sign of the force is smoothed where the force is small.
    """

    id: str = "joint_clearance"
    title: str = "the joints of a bar have clearance, taken up by pull or push"
    kind: Kind = Kind.MACHINE
    stage: Stage = Stage.TOOL
    parameters: tuple[EffectParameter, ...] = (EffectParameter("clearance", "mm", 0.01, least=0.0),)
    invariances: tuple[str, ...] = (BOTH_WAYS, "reverses where the force in the bar does")
    controller: str = "bar {place}: nothing to enter: take up {clearance} in its joints"

    def off_mm(self, at: Acting) -> NDArray[Any]:
        """The bar is longer by half the value where it is pulled, shorter where it is pressed."""
        pull = pull_of_weight(at.flow.geometry, at.flow.foot_mm, at.stage_input)[..., at.leg]
        sign = pull / np.sqrt(pull**2 + FLOATS**2)
        return np.asarray(at.values[0] / 2 * sign)


@dataclass(frozen=True)
class LegTaper(OfTouch):
    """The touched surface is not parallel to the bar's kinematic line.

    ``"xy"``: leg x where the indicator measures y. Positive: from the tool end to the foot the
    surface goes towards the positive measuring axis.
    """

    id: str = "leg_taper"
    title: str = "the touched surface of a bar is not parallel to the bar's own line"
    kind: Kind = Kind.MACHINE
    stage: Stage = Stage.TOUCH
    parameters: tuple[EffectParameter, ...] = (EffectParameter("taper", "mm/m", 0.3),)
    invariances: tuple[str, ...] = (
        *REPEATABLE,
        "linear in the place on the bar, whatever moved it there",
    )
    controller: str = SURFACE_ONLY

    def off_mm(self, at: Acting) -> NDArray[Any]:
        """In proportion to the distance from the tool end."""
        from_end_mm = at.flow.fraction * at.flow.geometry.lengths[at.flow.taken.leg]
        return np.asarray(PER_THOUSAND * at.values[0] * from_end_mm)


@dataclass(frozen=True)
class LegBow(OfTouch):
    """The touched surface is bowed; positive: its middle stands out to the positive axis."""

    id: str = "leg_bow"
    title: str = "the touched surface of a bar is bowed"
    kind: Kind = Kind.MACHINE
    stage: Stage = Stage.TOUCH
    parameters: tuple[EffectParameter, ...] = (EffectParameter("middle", "mm", 0.05),)
    invariances: tuple[str, ...] = (
        *REPEATABLE,
        "depends on the place on the bar, whatever moved it there",
    )
    controller: str = SURFACE_ONLY

    def off_mm(self, at: Acting) -> NDArray[Any]:
        """A parabola: zero at both ends of the bar, the value in the middle."""
        return np.asarray(4.0 * at.values[0] * at.flow.fraction * (1.0 - at.flow.fraction))
