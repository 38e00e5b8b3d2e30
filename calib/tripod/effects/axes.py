"""Effects of the three actuator axes: how they lie to each other and how straight they are."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.arrays import LEG_NAMES, Conditions
from calib.tripod.effects.effect import (
    AROUND,
    DIRECTIONS,
    PAIRS,
    PER_THOUSAND,
    REPEATABLE,
    Effect,
    EffectParameter,
    Kind,
    moved_foot,
    numbers,
    travel,
)
from calib.tripod.geometry import Geometry
from calib.tripod.pipeline import Flow, Stage

STRAIGHTNESS_TRAVEL_MM = 100.0


@dataclass(frozen=True)
class AxisSquareness:
    """A pair of axes leans together; positive: their angle is less than 90°.

    Both axes take half of it: leg readings see the sum of the two leans only. Parallel drives lean
    towards each other with their coordinate.
    """

    id: str = "axis_squareness"
    title: str = "two actuator axes are not square to each other"
    kind: Kind = Kind.MACHINE
    stage: Stage = Stage.FOOT
    parameters: tuple[EffectParameter, ...] = (EffectParameter("lean", "mrad", 0.5),)
    invariances: tuple[str, ...] = (*REPEATABLE, "the same change of both readings of the pair")
    controller: str = (
        "axes {place}: the kinematics of export --format linuxcnc-kins, or turn one "
        "of them by {lean} away from the other"
    )

    def places(self, taken: Conditions) -> tuple[str, ...]:
        """Every pair of axes, whatever was measured."""
        return PAIRS if len(taken) else ()

    def change(
        self, stage_input: NDArray[Any], flow: Flow, place: str, values: Sequence[Any]
    ) -> NDArray[Any]:
        """Each foot of the pair moves towards the other axis in proportion to its coordinate."""
        first, second = numbers(place)
        half_rad = PER_THOUSAND * values[0] / 2
        towards = flow.geometry.towards
        carriage = flow.carriage_mm
        feet = moved_foot(
            stage_input, first, towards(first, second), half_rad * carriage[..., first]
        )
        return moved_foot(feet, second, towards(second, first), half_rad * carriage[..., second])


@dataclass(frozen=True)
class AxisOffset:
    """An axis is shifted sideways; ``"xy"``: axis x towards +y.

    Of square drives leg readings see differences only, see `AxisDistance`; a model may hold shifts.
    """

    id: str = "axis_offset"
    title: str = "an actuator axis is shifted sideways and misses the point where they meet"
    kind: Kind = Kind.MACHINE
    stage: Stage = Stage.FOOT
    parameters: tuple[EffectParameter, ...] = (EffectParameter("shift", "mm", 0.1),)
    invariances: tuple[str, ...] = (*REPEATABLE, "follows the angle of the bar, not its travel")
    controller: str = (
        "axis {axis}: the kinematics of export --format linuxcnc-kins, or shim it by "
        "{shift} against {along}"
    )
    directions: tuple[str, ...] = DIRECTIONS

    def places(self, taken: Conditions) -> tuple[str, ...]:
        """Every axis in both directions across it."""
        return self.directions if len(taken) else ()

    def change(
        self, stage_input: NDArray[Any], flow: Flow, place: str, values: Sequence[Any]
    ) -> NDArray[Any]:
        """The foot is sideways by a constant."""
        shift = values[0] * np.ones(len(flow.taken))
        return moved_foot(stage_input, _drive(place), flow.geometry.across[place], shift)


@dataclass(frozen=True)
class AxisDistance:
    """Two square axes miss each other; ``"xy"``: along z, axis x lies further that way than axis y.

    Of the six shifts of three square axes leg readings see these three distances between
    neighbours: all axes shifted by one vector, the rest, are the same machine with other joint
    offsets. Each axis of the pair takes half of it.
    """

    id: str = "axis_offset"
    title: str = "two actuator axes miss each other"
    kind: Kind = Kind.MACHINE
    stage: Stage = Stage.FOOT
    parameters: tuple[EffectParameter, ...] = (EffectParameter("distance", "mm", 0.1),)
    invariances: tuple[str, ...] = (*REPEATABLE, "follows the angle of the bar, not its travel")
    controller: str = (
        "axes {place}: the kinematics of export --format linuxcnc-kins, or shim axis {axis} "
        "against {third} by {distance}"
    )

    def places(self, taken: Conditions) -> tuple[str, ...]:
        """Every pair of axes, each counted from one to the next."""
        return AROUND if len(taken) else ()

    def change(
        self, stage_input: NDArray[Any], flow: Flow, place: str, values: Sequence[Any]
    ) -> NDArray[Any]:
        """Both feet of the pair are apart by a constant, along the third axis."""
        first, second = numbers(place)
        third = flow.geometry.directions[3 - first - second]
        half = values[0] / 2 * np.ones(len(flow.taken))
        feet = moved_foot(stage_input, first, third, half)
        return moved_foot(feet, second, third, -half)


@dataclass(frozen=True)
class Straightness:
    """A foot leaves its line sideways with the square of travel; ``"xy"``: axis x towards +y."""

    id: str = "straightness"
    title: str = "a guide is not straight: the foot leaves its line sideways"
    kind: Kind = Kind.MACHINE
    stage: Stage = Stage.FOOT
    parameters: tuple[EffectParameter, ...] = (EffectParameter("sideways_at_100mm", "mm", 0.02),)
    invariances: tuple[str, ...] = (*REPEATABLE, "the same for equal travel either way from Zero")
    controller: str = "axis {axis}: the kinematics of export --format linuxcnc-kins"
    directions: tuple[str, ...] = DIRECTIONS
    power: int = 2

    def places(self, taken: Conditions) -> tuple[str, ...]:
        """Every axis in both directions across it."""
        return self.directions if len(taken) else ()

    def change(
        self, stage_input: NDArray[Any], flow: Flow, place: str, values: Sequence[Any]
    ) -> NDArray[Any]:
        """The foot is sideways by value (travel / 100 mm) to the power."""
        leg = _drive(place)
        part = travel(flow, leg) / STRAIGHTNESS_TRAVEL_MM
        return moved_foot(
            stage_input, leg, flow.geometry.across[place], values[0] * part**self.power
        )


@dataclass(frozen=True)
class StraightnessOfThirdOrder(Straightness):
    """A guide bent like an S; ``"xy"``: axis x towards +y at positive travel."""

    id: str = "straightness_cubic"
    title: str = "a guide is bent like an S: the foot leaves its line sideways"
    parameters: tuple[EffectParameter, ...] = (EffectParameter("s_shape_at_100mm", "mm", 0.02),)
    invariances: tuple[str, ...] = (*REPEATABLE, "opposite for equal travel either way from Zero")
    power: int = 3


def _drive(place: str) -> int:
    return LEG_NAMES.index(place[0])


def with_directions(effects: Iterable[Effect], geometry: Geometry) -> tuple[Effect, ...]:
    """The laws; those that act sideways in the directions across this machine's drives.

    Axes that are square to each other miss each other; others are shifted.
    """
    names = tuple(geometry.across)
    sideways = (AxisOffset, Straightness)
    not_here = AxisOffset if geometry.orthogonal else AxisDistance
    return tuple(
        replace(effect, directions=names) if isinstance(effect, sideways) else effect
        for effect in effects
        if not isinstance(effect, not_here)
    )
