"""Effects of time and temperature; the place is the measuring axis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.arrays import LEG_NAMES, Conditions, FloatArray
from calib.tripod.effects.effect import PER_THOUSAND, EffectParameter, Kind, at_mount, mounts
from calib.tripod.pipeline import Flow, Stage

SECONDS_PER_HOUR = 3600.0
REFERENCE_C = 20.0


@dataclass(frozen=True)
class _Drift:
    """Readings along an axis wander in proportion to something, whatever the posture."""

    id: str = "thermal_drift"
    title: str = ""
    kind: Kind = Kind.ENVIRONMENT
    stage: Stage = Stage.READING
    parameters: tuple[EffectParameter, ...] = ()
    invariances: tuple[str, ...] = ("same for every posture", "same for both directions")
    controller: str = "nothing to enter: let the machine and the stand come to rest in temperature"

    def places(self, taken: Conditions) -> tuple[str, ...]:
        """Every measuring axis."""
        return tuple(name for k, name in enumerate(LEG_NAMES) if k in taken.axis)

    def change(
        self, stage_input: NDArray[Any], flow: Flow, place: str, values: Sequence[Any]
    ) -> NDArray[Any]:
        """The reading grows by value for each unit of what it wanders with."""
        by_mm = PER_THOUSAND * values[0] * _known_only(self._grown_with(flow.taken), flow.taken)
        return np.asarray(stage_input + by_mm * self._at(flow, place))

    def _at(self, flow: Flow, place: str) -> NDArray[Any]:
        """1 for the readings that wander ``(n,)``."""
        return np.asarray(flow.taken.axis == LEG_NAMES.index(place))

    def _grown_with(self, taken: Conditions) -> FloatArray:
        raise NotImplementedError


@dataclass(frozen=True)
class DriftWithTime(_Drift):
    """Readings wander steadily with time; hours count from the start of the session."""

    title: str = "readings drift steadily with time"
    parameters: tuple[EffectParameter, ...] = (EffectParameter("rate", "µm/h", 10.0),)

    def _grown_with(self, taken: Conditions) -> FloatArray:
        return np.asarray(taken.time_s / SECONDS_PER_HOUR)


@dataclass(frozen=True)
class DriftWithTemperature(_Drift):
    """Readings wander with the temperature of the machine; kelvins count from 20 °C."""

    title: str = "readings drift with the temperature"
    parameters: tuple[EffectParameter, ...] = (EffectParameter("per_kelvin", "µm/K", 5.0),)

    def _grown_with(self, taken: Conditions) -> FloatArray:
        return np.asarray(taken.temperature_c - REFERENCE_C)


@dataclass(frozen=True)
class DriftOfStand(_Drift):
    """One stand wanders steadily; the place is its leg and measuring axis."""

    id: str = "stand_drift"
    title: str = "the stand of an indicator wanders steadily with time"
    parameters: tuple[EffectParameter, ...] = (EffectParameter("rate", "µm/h", 10.0),)
    controller: str = "nothing to enter: clamp the stand at {place}, let it come to rest"

    def places(self, taken: Conditions) -> tuple[str, ...]:
        """Every leg and measuring axis that was measured."""
        return mounts(taken)

    def _at(self, flow: Flow, place: str) -> NDArray[Any]:
        return at_mount(flow, place)

    def _grown_with(self, taken: Conditions) -> FloatArray:
        return np.asarray(taken.time_s / SECONDS_PER_HOUR)


def kelvins(taken: Conditions) -> FloatArray:
    """Temperature of each reading above 20 °C ``(n,)``; 0 where not all readings have one.

    At Zero, where an indicator is mounted, it is 0.
    """
    mounted = taken.mount >= 0
    known = np.isfinite(taken.temperature_c[mounted]).all()
    return np.where(mounted & known, np.nan_to_num(taken.temperature_c - REFERENCE_C), 0.0)


def _known_only(figure: FloatArray, taken: Conditions) -> FloatArray:
    """The figure; 0 for a whole mounting where one reading has none, so that nothing jumps."""
    unknown = np.isin(taken.mount, taken.mount[np.isnan(figure)])
    return np.where(unknown, 0.0, figure)
