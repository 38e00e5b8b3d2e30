"""Effects of the three bars: how they give under weight and what their surface is like."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.arrays import LEG_NAMES, Conditions
from calib.tripod.effects.effect import (
    PER_THOUSAND,
    EffectParameter,
    Kind,
    at_mount,
    moved_touch,
    on_legs,
    unit,
)
from calib.tripod.effects.environment import kelvins
from calib.tripod.geometry import Geometry, trilaterate
from calib.tripod.pipeline import Flow, Stage

FLOATS = 0.02
"""Force in a bar, in units of the weight, that friction in its joints holds without moving them."""


@dataclass(frozen=True)
class LegLength:
    """A bar is longer than the machine file says, by more than its tolerance allows."""

    id: str = "leg_length"
    title: str = "a bar is not as long as the machine file says, beyond its tolerance"
    kind: Kind = Kind.MACHINE
    stage: Stage = Stage.TOOL
    parameters: tuple[EffectParameter, ...] = (EffectParameter("length", "mm", 0.1),)
    invariances: tuple[str, ...] = (
        "same for both directions of approach",
        "constant in time",
        "does not change with the load",
    )
    controller: str = "bar {place}: the kinematics of export --format linuxcnc-kins"

    def places(self, taken: Conditions) -> tuple[str, ...]:
        """Every bar."""
        return LEG_NAMES if len(taken) else ()

    def change(
        self,
        stage_input: NDArray[Any],
        flow: Flow,  # noqa: ARG002 (every effect is given it)
        place: str,
        values: Sequence[Any],
    ) -> NDArray[Any]:
        """The bar is longer by the value."""
        return np.asarray(stage_input + values[0] * unit(LEG_NAMES.index(place)))


@dataclass(frozen=True)
class GravitySag:
    """Bars are axial springs that carry the tool; positive: a pressed bar gets shorter."""

    id: str = "gravity_sag"
    title: str = "the bars give under the weight of the tool"
    kind: Kind = Kind.MACHINE
    stage: Stage = Stage.TOOL
    parameters: tuple[EffectParameter, ...] = (EffectParameter("shortening", "mm", 0.02),)
    invariances: tuple[str, ...] = (
        "same for both directions of approach",
        "constant in time",
        "changes with the load and with how the machine stands",
    )
    controller: str = "bar {place}: the kinematics of export --format linuxcnc-kins"

    def places(self, taken: Conditions) -> tuple[str, ...]:
        """Every bar."""
        return LEG_NAMES if len(taken) else ()

    def change(
        self, stage_input: NDArray[Any], flow: Flow, place: str, values: Sequence[Any]
    ) -> NDArray[Any]:
        """The bar changes its length by value · load · pull / weight, at the unloaded machine."""
        leg = LEG_NAMES.index(place)
        pull = pull_of_weight(flow.geometry, flow.foot_mm, stage_input)
        shortening = values[0] * flow.geometry.load
        return np.asarray(stage_input + shortening * pull[..., leg, None] * unit(leg))


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
class BarGrowth:
    """A bar grows with temperature; kelvins count from 20 °C. 310 mm of aluminium: 7 µm/K."""

    id: str = "thermal_growth"
    title: str = "a bar grows with the temperature"
    kind: Kind = Kind.ENVIRONMENT
    stage: Stage = Stage.TOOL
    parameters: tuple[EffectParameter, ...] = (EffectParameter("bar_per_kelvin", "µm/K", 3.0),)
    invariances: tuple[str, ...] = ("same for both directions of approach", "0 at 20 °C")
    controller: str = "nothing to enter: keep the machine at the temperature of its calibration"

    def places(self, taken: Conditions) -> tuple[str, ...]:
        """Every bar."""
        return LEG_NAMES if len(taken) else ()

    def change(
        self, stage_input: NDArray[Any], flow: Flow, place: str, values: Sequence[Any]
    ) -> NDArray[Any]:
        """The bar is longer by value · (temperature - 20 °C)."""
        grown = PER_THOUSAND * values[0] * kelvins(flow.taken)
        return np.asarray(stage_input + grown[:, None] * unit(LEG_NAMES.index(place)))


@dataclass(frozen=True)
class JointClearance:
    """The joints of a bar have clearance: it is longer pulled than pressed.

    Between both it floats: the sign of the force is smoothed where the force is small.
    """

    id: str = "joint_clearance"
    title: str = "the joints of a bar have clearance, taken up by pull or push"
    kind: Kind = Kind.MACHINE
    stage: Stage = Stage.TOOL
    parameters: tuple[EffectParameter, ...] = (EffectParameter("clearance", "mm", 0.01, least=0.0),)
    invariances: tuple[str, ...] = (
        "same for both directions of approach",
        "reverses where the force in the bar does",
    )
    controller: str = "bar {place}: nothing to enter: take up {clearance} in its joints"

    def places(self, taken: Conditions) -> tuple[str, ...]:
        """Every bar."""
        return LEG_NAMES if len(taken) else ()

    def change(
        self, stage_input: NDArray[Any], flow: Flow, place: str, values: Sequence[Any]
    ) -> NDArray[Any]:
        """The bar is longer by half the value where it is pulled, shorter where it is pressed."""
        leg = LEG_NAMES.index(place)
        pull = pull_of_weight(flow.geometry, flow.foot_mm, stage_input)[..., leg]
        sign = pull / np.sqrt(pull**2 + FLOATS**2)
        return np.asarray(stage_input + (values[0] / 2 * sign)[..., None] * unit(leg))


@dataclass(frozen=True)
class _Surface:
    """The touched surface of a bar lies off the bar's own line, depending on the place on it."""

    id: str = ""
    title: str = ""
    kind: Kind = Kind.MACHINE
    stage: Stage = Stage.TOUCH
    parameters: tuple[EffectParameter, ...] = ()
    invariances: tuple[str, ...] = ()
    controller: str = "nothing to enter: the touched surface, not the machine"

    def places(self, taken: Conditions) -> tuple[str, ...]:
        """Every leg and measuring axis that was measured."""
        return on_legs(taken)

    def change(
        self, stage_input: NDArray[Any], flow: Flow, place: str, values: Sequence[Any]
    ) -> NDArray[Any]:
        """The touched point is off by the value times the shape along the bar."""
        off_mm = values[0] * self._shape(flow) * at_mount(flow, place)
        return moved_touch(stage_input, flow, off_mm)

    def _shape(self, flow: Flow) -> NDArray[Any]:
        raise NotImplementedError


@dataclass(frozen=True)
class LegTaper(_Surface):
    """The touched surface is not parallel to the bar's kinematic line.

    ``"xy"``: leg x where the indicator measures y. Positive: from the tool end to the foot the
    surface goes towards the positive measuring axis.
    """

    id: str = "leg_taper"
    title: str = "the touched surface of a bar is not parallel to the bar's own line"
    parameters: tuple[EffectParameter, ...] = (EffectParameter("taper", "mm/m", 0.3),)
    invariances: tuple[str, ...] = (
        "same for both directions of approach",
        "constant in time",
        "linear in the place on the bar, whatever moved it there",
    )

    def _shape(self, flow: Flow) -> NDArray[Any]:
        """In proportion to the distance from the tool end."""
        return np.asarray(PER_THOUSAND * flow.fraction * flow.geometry.lengths[flow.taken.leg])


@dataclass(frozen=True)
class LegBow(_Surface):
    """The touched surface is bowed; positive: its middle stands out to the positive axis."""

    id: str = "leg_bow"
    title: str = "the touched surface of a bar is bowed"
    parameters: tuple[EffectParameter, ...] = (EffectParameter("middle", "mm", 0.05),)
    invariances: tuple[str, ...] = (
        "same for both directions of approach",
        "constant in time",
        "depends on the place on the bar, whatever moved it there",
    )

    def _shape(self, flow: Flow) -> NDArray[Any]:
        """A parabola: zero at both ends of the bar, 1 in the middle."""
        return np.asarray(4.0 * flow.fraction * (1.0 - flow.fraction))
