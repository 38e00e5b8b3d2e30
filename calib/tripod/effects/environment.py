"""Effects of time and temperature; the place is the measuring axis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.observations import LEG_NAMES, Conditions, FloatArray
from calib.tripod.effects.effect import PER_THOUSAND, EffectParameter, Kind
from calib.tripod.pipeline import Flow, Stage

SECONDS_PER_HOUR = 3600.0
REFERENCE_C = 20.0


@dataclass(frozen=True)
class DriftWithTime:
    """Readings wander steadily with time."""

    id: str = "thermal_drift"
    title: str = "readings wander steadily with time"
    kind: Kind = Kind.ENVIRONMENT
    stage: Stage = Stage.READING
    parameters: tuple[EffectParameter, ...] = (EffectParameter("rate", "µm/h", 10.0),)
    invariances: tuple[str, ...] = ("same for every posture", "same for both directions")
    controller: str = "nothing to enter: let the machine and the stand come to rest in temperature"

    def places(self, taken: Conditions) -> tuple[str, ...]:
        """Every measuring axis."""
        return _measured_axes(taken)

    def change(
        self, stage_input: NDArray[Any], flow: Flow, place: str, values: Sequence[Any]
    ) -> NDArray[Any]:
        """The reading grows by value for each hour since the start of the session."""
        hours = _known_only(flow.taken.time_s, flow.taken) / SECONDS_PER_HOUR
        return _wandered(stage_input, flow, place, PER_THOUSAND * values[0] * hours)


@dataclass(frozen=True)
class DriftWithTemperature:
    """Readings wander with the temperature of the machine."""

    id: str = "thermal_drift"
    title: str = "readings wander with the temperature"
    kind: Kind = Kind.ENVIRONMENT
    stage: Stage = Stage.READING
    parameters: tuple[EffectParameter, ...] = (EffectParameter("per_kelvin", "µm/K", 5.0),)
    invariances: tuple[str, ...] = ("same for every posture", "same for both directions")
    controller: str = "nothing to enter: let the machine and the stand come to rest in temperature"

    def places(self, taken: Conditions) -> tuple[str, ...]:
        """Every measuring axis."""
        return _measured_axes(taken)

    def change(
        self, stage_input: NDArray[Any], flow: Flow, place: str, values: Sequence[Any]
    ) -> NDArray[Any]:
        """The reading grows by value for each kelvin above 20 °C."""
        above = _known_only(flow.taken.temperature_c - REFERENCE_C, flow.taken)
        return _wandered(stage_input, flow, place, PER_THOUSAND * values[0] * above)


def _wandered(
    stage_input: NDArray[Any], flow: Flow, place: str, by_mm: NDArray[Any]
) -> NDArray[Any]:
    measured = flow.taken.axis == LEG_NAMES.index(place)
    return np.asarray(stage_input + by_mm * measured)


def _measured_axes(taken: Conditions) -> tuple[str, ...]:
    return tuple(name for k, name in enumerate(LEG_NAMES) if k in taken.axis)


def _known_only(figure: FloatArray, taken: Conditions) -> FloatArray:
    """The figure; 0 for a whole mounting where one reading has none, so that nothing jumps."""
    unknown = np.isin(taken.mount, taken.mount[np.isnan(figure)])
    return np.where(unknown, 0.0, figure)
