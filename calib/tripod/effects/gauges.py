"""Effects of indicators, stands and plates.

``"xy"`` measures y on leg x, ``"tz"`` the tool along z.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.arrays import LEG_NAMES, Conditions, FloatArray
from calib.tripod.effects.effect import (
    AT_TOOL,
    PER_THOUSAND,
    Acting,
    EffectParameter,
    Kind,
    OfReading,
    OfTouch,
    at_mount,
    hours,
    kelvins,
    mounts,
    numbers,
    on_legs,
)
from calib.tripod.pipeline import Flow

PERCENT = 1e-2


@dataclass(frozen=True)
class GaugeGain(OfReading):
    """Every reading is scaled, whatever caused it; positive: the indicator shows too much."""

    id = "gauge_gain"
    title = "an indicator shows too much or too little in proportion"
    parameters = (EffectParameter("gain", "%", 0.5, 20.0),)
    controller = "nothing to enter: check the indicator at {place}, it is {gain} off"

    def change(
        self, stage_input: NDArray[Any], flow: Flow, place: str, values: Sequence[Any]
    ) -> NDArray[Any]:
        """The reading is multiplied by 1 + value."""
        return np.asarray(stage_input * (1.0 + PERCENT * values[0] * at_mount(flow, place)))


@dataclass(frozen=True)
class GaugeTilt(OfTouch):
    """An indicator on a leg is askew; positive: the third axis' positive way reads positive.

    In proportion to what the other indicator of the leg shows, until the stand is set up anew.
    """

    id = "gauge_tilt"
    title = "an indicator is tilted and also reads motion across its axis"
    kind = Kind.INDICATOR
    parameters = (EffectParameter("tilt", "mrad", 10.0, 150.0),)
    controller = "nothing to enter: mount the indicator at {place} again, tilted by {tilt}"

    def off(self, at: Acting) -> NDArray[Any]:
        """The touched point along a plunger that is turned by the value towards the third axis."""
        leg, axis = numbers(at.place)
        across = at.flow.geometry.read_along[leg]
        along_indicator = (at.stage_input * across[axis]).sum(axis=-1)
        third = (at.stage_input * across[3 - leg - axis]).sum(axis=-1)
        tilt_rad = PER_THOUSAND * at.values[0]
        return np.asarray(np.sin(tilt_rad) * third + (np.cos(tilt_rad) - 1.0) * along_indicator)


@dataclass(frozen=True)
class PlateTilt(OfTouch):
    """What the tool is read against is not square to its coordinate, two ways.

    Positive: the positive direction of the first (second) of the other two coordinates reads
    positive: a plate that falls that way. Another one after the plate was set up anew.
    """

    id = "gauge_tilt"
    title = "the plate, or the indicator at the tool, is tilted"
    kind = Kind.INDICATOR
    parameters = (
        EffectParameter("tilt_first", "mrad", 10.0, 150.0),
        EffectParameter("tilt_second", "mrad", 10.0, 150.0),
    )
    controller = "nothing to enter: level the plate, or mount the indicator again"

    def places(self, conditions: Conditions) -> tuple[str, ...]:
        """The tool along every coordinate that was measured."""
        return tuple(place for place in mounts(conditions) if place in AT_TOOL)

    def off(self, at: Acting) -> NDArray[Any]:
        """The way across the coordinate is read in proportion."""
        first, second = (k for k in range(3) if k != numbers(at.place)[1])
        way = at.values[0] * at.stage_input[..., first] + at.values[1] * at.stage_input[..., second]
        return PER_THOUSAND * way


@dataclass(frozen=True)
class TipOnRoundBar(OfTouch):
    """A plain tip on a round bar: where the bar moves across, the surface under the tip recedes.

    The reading falls by z²/2R with z the way along the third axis from where the indicator was set
    up and R the bar's radius. Beside the crest by e it also falls by e z/R: that is `gauge_tilt`.
    Positive: the tip touches the side that faces the positive axis.
    """

    id = "tip_on_round_bar"
    title = "the tip slides over the crest of a round bar"
    kind = Kind.INDICATOR
    parameters = (EffectParameter("curvature", "1/m", 10.0, 500.0),)
    controller = "nothing to enter: use a flat tip at {place}, or one wider than the motion across"

    def off(self, at: Acting) -> NDArray[Any]:
        """The touched point goes back by value z² / 2."""
        leg, axis = numbers(at.place)
        third = at.flow.geometry.read_along[leg, 3 - leg - axis]
        z_mm = at.flow.moved_along(at.stage_input, np.broadcast_to(third, (len(at.flow.taken), 3)))
        return -PER_THOUSAND * at.values[0] * z_mm**2 / 2.0


@dataclass(frozen=True)
class GaugeHysteresis(OfReading):
    """An indicator lags; positive: readings are lower after a movement to larger coordinates."""

    id = "gauge_hysteresis"
    title = "an indicator lags behind where its plunger reverses"
    parameters = (EffectParameter("lag", "µm", 3.0, 20.0),)
    controller = "nothing to enter: check the indicator at {place}, it lags by {lag}"

    def places(self, conditions: Conditions) -> tuple[str, ...]:
        """Every leg and measuring axis that was measured."""
        return on_legs(conditions)

    def off(self, at: Acting) -> NDArray[Any]:
        """Half of the value either way, by the carriage's last movement; 0 where nobody saw it."""
        return -PER_THOUSAND * at.values[0] * at.flow.taken.approach / 2.0


@dataclass(frozen=True)
class DriftOfStand(OfReading):
    """One stand wanders steadily, whatever the posture; hours count from the session's start."""

    id = "stand_drift"
    title = "the stand of an indicator drifts steadily with time"
    kind = Kind.ENVIRONMENT
    parameters = (EffectParameter("rate", "µm/h", 10.0),)
    controller = "nothing to enter: clamp the stand at {place}, let it come to rest"

    def off(self, at: Acting) -> NDArray[Any]:
        """The value for each unit of what it wanders with.

        Where one reading of a mounting has none, by nothing in all of it: so nothing jumps.
        """
        conditions = at.flow.taken
        figure = self.wanders_with(conditions)
        unknown = np.isin(conditions.mount, conditions.mount[np.isnan(figure)])
        return PER_THOUSAND * at.values[0] * np.where(unknown, 0.0, figure)

    def wanders_with(self, conditions: Conditions) -> FloatArray:
        """Hours ``(n,)``."""
        return hours(conditions)


@dataclass(frozen=True)
class DriftWithTime(DriftOfStand):
    """All readings along an axis wander steadily with time; the place is the measuring axis."""

    id = "thermal_drift"
    title = "readings drift steadily with time"
    controller = "nothing to enter: wait until the temperatures of machine and stand are steady"

    def places(self, conditions: Conditions) -> tuple[str, ...]:
        """Every measuring axis."""
        return tuple(name for k, name in enumerate(LEG_NAMES) if k in conditions.axis)

    def moved(self, at: Acting, off_mm: NDArray[Any]) -> NDArray[Any]:
        """Readings ``(..., n)``."""
        return np.asarray(off_mm * (at.flow.taken.axis == LEG_NAMES.index(at.place)))


@dataclass(frozen=True)
class DriftWithTemperature(DriftWithTime):
    """All readings along an axis wander with the temperature; kelvins count from 20 °C."""

    title = "readings drift with the temperature"
    parameters = (EffectParameter("per_kelvin", "µm/K", 5.0),)

    def wanders_with(self, conditions: Conditions) -> FloatArray:
        """Kelvins ``(n,)``."""
        return kelvins(conditions)
