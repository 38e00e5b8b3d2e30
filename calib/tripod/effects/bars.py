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
    numbers,
    on_legs,
    unit,
)
from calib.tripod.geometry import Geometry
from calib.tripod.kinematics import trilaterate
from calib.tripod.pipeline import Flow, Stage


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
class LegTaper:
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
        "same for both directions of approach",
        "constant in time",
        "linear in the place on the bar, whatever moved it there",
    )
    controller: str = "nothing to enter: the touched surface, not the machine"

    def places(self, taken: Conditions) -> tuple[str, ...]:
        """Every leg and measuring axis that was measured."""
        return on_legs(taken)

    def change(
        self, stage_input: NDArray[Any], flow: Flow, place: str, values: Sequence[Any]
    ) -> NDArray[Any]:
        """The surface departs by value · distance from the tool end."""
        along_mm = flow.fraction * flow.geometry.leg_length_mm[numbers(place)[0]]
        off_mm = PER_THOUSAND * values[0] * along_mm * at_mount(flow, place)
        return moved_touch(stage_input, flow, off_mm)


@dataclass(frozen=True)
class LegBow:
    """The touched surface is bowed; positive: its middle stands out to the positive axis."""

    id: str = "leg_bow"
    title: str = "the touched surface of a bar is bowed"
    kind: Kind = Kind.MACHINE
    stage: Stage = Stage.TOUCH
    parameters: tuple[EffectParameter, ...] = (EffectParameter("middle", "mm", 0.05),)
    invariances: tuple[str, ...] = (
        "same for both directions of approach",
        "constant in time",
        "depends on the place on the bar, whatever moved it there",
    )
    controller: str = "nothing to enter: the touched surface, not the machine"

    def places(self, taken: Conditions) -> tuple[str, ...]:
        """Every leg and measuring axis that was measured."""
        return on_legs(taken)

    def change(
        self, stage_input: NDArray[Any], flow: Flow, place: str, values: Sequence[Any]
    ) -> NDArray[Any]:
        """A parabola along the bar: zero at both ends, the value in the middle."""
        part = 4.0 * flow.fraction * (1.0 - flow.fraction)
        off_mm = values[0] * part * at_mount(flow, place)
        return moved_touch(stage_input, flow, off_mm)
