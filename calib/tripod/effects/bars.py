"""Effects of the three bars: how they give under weight and what their surface is like."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.observations import LEG_NAMES, Conditions
from calib.tripod.effects.effect import (
    PER_THOUSAND,
    EffectParameter,
    Kind,
    at_mount,
    moved_touch,
    on_legs,
    unit,
)
from calib.tripod.geometry import Geometry
from calib.tripod.kinematics import trilaterate
from calib.tripod.pipeline import Flow, Stage


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
