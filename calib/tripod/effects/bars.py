"""Effects of the three bars: how they give under weight and what their surface is like."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.tripod.effects.effect import (
    PER_THOUSAND,
    Acting,
    EffectParameter,
    Kind,
    OfBar,
    OfTouch,
    machine_kelvins,
)
from calib.tripod.geometry import Geometry, trilaterate

FLOATS = 0.02
"""Force in a bar, in units of the weight, that friction in its joints holds without moving them."""

SURFACE_ONLY = "nothing to enter: the touched surface, not the machine"


@dataclass(frozen=True)
class LegLength(OfBar):
    """A bar is longer than the machine file says, by more than its tolerance allows."""

    id = "leg_length"
    title = "a bar is not as long as the machine file says, beyond its tolerance"
    parameters = (EffectParameter("length", "mm", 0.1),)
    controller = "bar {place}: the kinematics of export --format linuxcnc-kins"


@dataclass(frozen=True)
class GravitySag(OfBar):
    """Bars are axial springs that carry the tool; positive: a pressed bar gets shorter."""

    id = "gravity_sag"
    title = "the bars give under the weight of the tool"
    parameters = (EffectParameter("shortening", "mm", 0.02, least=0.0),)
    controller = "bar {place}: the kinematics of export --format linuxcnc-kins"

    def off(self, at: Acting) -> NDArray[Any]:
        """Value · load · pull / weight, at the unloaded machine."""
        # what the sag itself turns the bars by changes it by its square only
        pull = pull_of_weight(at.flow.geometry, at.flow.foot_mm, at.stage_input)[..., at.leg]
        return at.values[0] * at.flow.geometry.load * pull


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
    # a column for each posture: numpy 1 takes a single one for vectors
    weight = np.broadcast_to(np.asarray(geometry.gravity)[:, None], (*bars.shape[:-1], 1))
    pull = np.linalg.solve(np.swapaxes(bars, -1, -2), weight)
    return np.asarray(pull[..., 0])


@dataclass(frozen=True)
class BarGrowth(OfBar):
    """A bar grows with temperature; kelvins count from 20 °C. 310 mm of aluminium: 7 µm/K."""

    id = "thermal_growth"
    title = "a bar grows with the temperature"
    kind = Kind.ENVIRONMENT
    parameters = (EffectParameter("bar_per_kelvin", "µm/K", 3.0, least=0.0),)
    controller = "nothing to enter: keep the machine at the temperature of its calibration"

    def off(self, at: Acting) -> NDArray[Any]:
        """Value · (temperature - 20 °C)."""
        return PER_THOUSAND * at.values[0] * machine_kelvins(at.flow.taken)


@dataclass(frozen=True)
class JointClearance(OfBar):
    """The joints of a bar have clearance: it is longer pulled than pressed.

    Between both it floats: the sign of the force is smoothed where the force is small.
    """

    id = "joint_clearance"
    title = "the joints of a bar have clearance, taken up by pull or push"
    parameters = (EffectParameter("clearance", "mm", 0.01, least=0.0),)
    controller = "bar {place}: nothing to enter: take up {clearance} in its joints"

    def off(self, at: Acting) -> NDArray[Any]:
        """Half the value longer where it is pulled, shorter where it is pressed."""
        pull = pull_of_weight(at.flow.geometry, at.flow.foot_mm, at.stage_input)[..., at.leg]
        sign = pull / np.sqrt(pull**2 + FLOATS**2)
        return at.values[0] / 2 * sign


@dataclass(frozen=True)
class LegTaper(OfTouch):
    """The touched surface is not parallel to the bar's kinematic line.

    ``"xy"``: leg x where the indicator measures y. Positive: from the tool end to the foot the
    surface goes towards the positive measuring axis.
    """

    id = "leg_taper"
    title = "the touched surface of a bar is not parallel to the bar's axis"
    parameters = (EffectParameter("taper", "mm/m", 0.3),)
    controller = SURFACE_ONLY

    def off(self, at: Acting) -> NDArray[Any]:
        """The value in proportion to the distance from the tool end, whatever moved the touched
        place.
        """
        from_end_mm = at.flow.fraction * at.flow.geometry.lengths[at.flow.taken.leg]
        return PER_THOUSAND * at.values[0] * from_end_mm


@dataclass(frozen=True)
class LegBow(OfTouch):
    """The touched surface is bowed; positive: its middle stands out to the positive axis."""

    id = "leg_bow"
    title = "the touched surface of a bar is bowed"
    parameters = (EffectParameter("middle", "mm", 0.05),)
    controller = SURFACE_ONLY

    def off(self, at: Acting) -> NDArray[Any]:
        """A parabola: zero at both ends of the bar, the value in the middle."""
        return 4.0 * at.values[0] * at.flow.fraction * (1.0 - at.flow.fraction)
