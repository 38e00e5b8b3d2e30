"""Effects of the indicators; ``"xy"`` measures y on leg x, ``"tz"`` the tool along z."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.arrays import Conditions
from calib.tripod.effects.effect import (
    AT_TOOL,
    BOTH_WAYS,
    PER_THOUSAND,
    REPEATABLE,
    Acting,
    EffectParameter,
    Kind,
    OfTouch,
    at_mount,
    mounts,
    numbers,
    on_legs,
)
from calib.tripod.pipeline import Flow, Stage, moved_along

PERCENT = 1e-2


@dataclass(frozen=True)
class GaugeGain:
    """Every reading is scaled; positive: the indicator shows too much."""

    id: str = "gauge_gain"
    title: str = "an indicator shows too much or too little in proportion"
    kind: Kind = Kind.INDICATOR
    stage: Stage = Stage.READING
    parameters: tuple[EffectParameter, ...] = (EffectParameter("gain", "%", 0.5, 20.0),)
    invariances: tuple[str, ...] = (*REPEATABLE, "in proportion to the reading, whatever caused it")
    controller: str = "nothing to enter: check the indicator at {place}, it is {gain} off"

    def places(self, taken: Conditions) -> tuple[str, ...]:
        """Every leg and measuring axis that was measured."""
        return mounts(taken)

    def change(
        self, stage_input: NDArray[Any], flow: Flow, place: str, values: Sequence[Any]
    ) -> NDArray[Any]:
        """The reading is multiplied by 1 + value."""
        return np.asarray(stage_input * (1.0 + PERCENT * values[0] * at_mount(flow, place)))


@dataclass(frozen=True)
class GaugeTilt(OfTouch):
    """An indicator on a leg is askew; positive: the third axis' positive way reads positive."""

    id: str = "gauge_tilt"
    title: str = "an indicator is mounted askew and takes up motion across its axis"
    kind: Kind = Kind.INDICATOR
    stage: Stage = Stage.TOUCH
    parameters: tuple[EffectParameter, ...] = (EffectParameter("tilt", "mrad", 10.0, 150.0),)
    invariances: tuple[str, ...] = (
        BOTH_WAYS,
        "in proportion to what the other indicator of the leg shows",
        "another one after the stand was set up anew",
    )
    controller: str = "nothing to enter: seat the indicator at {place} anew, askew by {tilt}"

    def off_mm(self, at: Acting) -> NDArray[Any]:
        """The touched point along a plunger that is turned by the value towards the third axis."""
        leg, axis = numbers(at.place)
        drives = at.flow.geometry.directions
        own = (at.stage_input * drives[axis]).sum(axis=-1)
        third = (at.stage_input * drives[3 - leg - axis]).sum(axis=-1)
        tilt_rad = PER_THOUSAND * at.values[0]
        return np.asarray(np.sin(tilt_rad) * third + (np.cos(tilt_rad) - 1.0) * own)


@dataclass(frozen=True)
class PlateTilt(OfTouch):
    """What the tool is read against is not square to its coordinate, two ways.

    Positive: the positive direction of the first (second) of the other two coordinates reads
    positive: a plate that falls that way.
    """

    id: str = "gauge_tilt"
    title: str = "the plate, or the indicator at the tool, is askew"
    kind: Kind = Kind.INDICATOR
    stage: Stage = Stage.TOUCH
    parameters: tuple[EffectParameter, ...] = (
        EffectParameter("tilt_first", "mrad", 10.0, 150.0),
        EffectParameter("tilt_second", "mrad", 10.0, 150.0),
    )
    invariances: tuple[str, ...] = (
        BOTH_WAYS,
        "in proportion to the way across the indicator",
        "another one after the plate was set up anew",
    )
    controller: str = "nothing to enter: level the plate, or seat the indicator anew"

    def places(self, taken: Conditions) -> tuple[str, ...]:
        """The tool along every coordinate that was measured."""
        return tuple(place for place in mounts(taken) if place in AT_TOOL)

    def off_mm(self, at: Acting) -> NDArray[Any]:
        """The way across the coordinate is read in proportion."""
        first, second = (k for k in range(3) if k != numbers(at.place)[1])
        way = at.values[0] * at.stage_input[..., first] + at.values[1] * at.stage_input[..., second]
        return np.asarray(PER_THOUSAND * way)


@dataclass(frozen=True)
class TipOnRoundBar(OfTouch):
    """A plain tip on a round bar: where the bar moves across, the surface under the tip recedes.

    The reading falls by z²/2R with z the way along the third axis from where the indicator was set
    up and R the bar's radius. Beside the crest by e it also falls by e z/R: that is `gauge_tilt`.
    Positive: the tip touches the side that faces the positive axis.
    """

    id: str = "tip_on_round_bar"
    title: str = "the tip slides over the crest of a round bar"
    kind: Kind = Kind.INDICATOR
    stage: Stage = Stage.TOUCH
    parameters: tuple[EffectParameter, ...] = (EffectParameter("curvature", "1/m", 10.0, 500.0),)
    invariances: tuple[str, ...] = (
        BOTH_WAYS,
        "with the square of what the other indicator of the leg shows",
    )
    controller: str = (
        "nothing to enter: use a flat tip at {place}, or one wider than the way across"
    )

    def off_mm(self, at: Acting) -> NDArray[Any]:
        """The touched point goes back by value z² / 2."""
        leg, axis = numbers(at.place)
        third = np.broadcast_to(
            at.flow.geometry.directions[3 - leg - axis], (len(at.flow.taken), 3)
        )
        z_mm = moved_along(at.flow, at.stage_input, third)
        return np.asarray(-PER_THOUSAND * at.values[0] * z_mm**2 / 2.0)


@dataclass(frozen=True)
class GaugeHysteresis:
    """An indicator lags; positive: readings are lower after a movement to larger coordinates."""

    id: str = "gauge_hysteresis"
    title: str = "an indicator lags behind where its plunger turns round"
    kind: Kind = Kind.INDICATOR
    stage: Stage = Stage.READING
    parameters: tuple[EffectParameter, ...] = (EffectParameter("lag", "µm", 3.0, 20.0),)
    invariances: tuple[str, ...] = (
        "depends on the direction of approach only",
        "another indicator at the same place shows another one",
    )
    controller: str = "nothing to enter: check the indicator at {place}, it lags by {lag}"

    def places(self, taken: Conditions) -> tuple[str, ...]:
        """Every leg and measuring axis that was measured."""
        return on_legs(taken)

    def change(
        self, stage_input: NDArray[Any], flow: Flow, place: str, values: Sequence[Any]
    ) -> NDArray[Any]:
        """Half of the value either way, by the carriage's last movement; 0 where nobody saw it."""
        lag_mm = PER_THOUSAND * values[0] * flow.taken.approach / 2.0
        return np.asarray(stage_input - lag_mm * at_mount(flow, place))
