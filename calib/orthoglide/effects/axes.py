"""Effects of the three actuator axes: how they lie to each other and how straight they are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.observations import Conditions
from calib.orthoglide.effects.kinds import EffectParameter, Kind
from calib.orthoglide.effects.places import (
    DIRECTIONS,
    PAIRS,
    PER_THOUSAND,
    moved_foot,
    numbers,
    travel,
)
from calib.orthoglide.pipeline import Flow, Stage

STRAIGHTNESS_TRAVEL_MM = 100.0
REPEATABLE = ("same for both directions of approach", "constant in time")


@dataclass(frozen=True)
class AxisSquareness:
    """A pair of axes leans together; positive: their angle is less than 90°.

    Both axes take half of it: leg readings see the sum of the two leans only.
    """

    id: str = "axis_squareness"
    title: str = "two actuator axes are not square to each other"
    kind: Kind = Kind.MACHINE
    stage: Stage = Stage.FOOT
    parameters: tuple[EffectParameter, ...] = (EffectParameter("lean", "mrad", 0.5),)
    invariances: tuple[str, ...] = (
        *REPEATABLE,
        "the same change of both readings of the pair",
    )
    controller: str = ""

    def places(self, taken: Conditions) -> tuple[str, ...]:
        """Every pair of axes, whatever was measured."""
        return PAIRS if len(taken) else ()

    def change(
        self, passing: NDArray[Any], flow: Flow, place: str, values: Sequence[Any]
    ) -> NDArray[Any]:
        """Each foot of the pair moves towards the other axis in proportion to its coordinate."""
        first, second = numbers(place)
        half_rad = PER_THOUSAND * values[0] / 2
        feet = moved_foot(passing, first, second, half_rad * flow.carriage_mm[..., first])
        return moved_foot(feet, second, first, half_rad * flow.carriage_mm[..., second])


@dataclass(frozen=True)
class AxisOffset:
    """An axis is shifted sideways; ``"xy"``: axis x towards +y."""

    id: str = "axis_offset"
    title: str = "an actuator axis is shifted sideways and misses the point where they meet"
    kind: Kind = Kind.MACHINE
    stage: Stage = Stage.FOOT
    parameters: tuple[EffectParameter, ...] = (EffectParameter("shift", "mm", 0.1),)
    invariances: tuple[str, ...] = (*REPEATABLE, "follows the angle of the bar, not its travel")
    controller: str = ""

    def places(self, taken: Conditions) -> tuple[str, ...]:
        """Every axis in both directions across it."""
        return DIRECTIONS if len(taken) else ()

    def change(
        self, passing: NDArray[Any], flow: Flow, place: str, values: Sequence[Any]
    ) -> NDArray[Any]:
        """The foot is sideways by a constant."""
        return moved_foot(passing, *numbers(place), values[0] * np.ones(len(flow.taken)))


@dataclass(frozen=True)
class Straightness:
    """A foot leaves its line sideways with the square of travel; ``"xy"``: axis x towards +y."""

    id: str = "straightness"
    title: str = "a guide is not straight: the foot leaves its line sideways"
    kind: Kind = Kind.MACHINE
    stage: Stage = Stage.FOOT
    parameters: tuple[EffectParameter, ...] = (EffectParameter("sideways_at_100mm", "mm", 0.02),)
    invariances: tuple[str, ...] = (*REPEATABLE, "the same for equal travel either way from Zero")
    controller: str = "straightness compensation of the axis, where the controller has one"

    def places(self, taken: Conditions) -> tuple[str, ...]:
        """Every axis in both directions across it."""
        return DIRECTIONS if len(taken) else ()

    def change(
        self, passing: NDArray[Any], flow: Flow, place: str, values: Sequence[Any]
    ) -> NDArray[Any]:
        """The foot is sideways by value (travel / 100 mm)²."""
        leg, towards = numbers(place)
        part = travel(flow, leg) / STRAIGHTNESS_TRAVEL_MM
        return moved_foot(passing, leg, towards, values[0] * part**2)
