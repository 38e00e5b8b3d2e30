"""Every effect that the program knows by itself."""

from __future__ import annotations

from collections.abc import Iterable

from calib.tripod.effects.actuators import (
    STANDARD_LEADS_MM,
    ActuatorCyclic,
    ActuatorScale,
    Backlash,
    with_machine_lead,
)
from calib.tripod.effects.axes import (
    AxisOffset,
    AxisSquareness,
    Straightness,
    with_directions,
)
from calib.tripod.effects.bars import GravitySag, LegBow, LegLength, LegTaper
from calib.tripod.effects.effect import Effect
from calib.tripod.effects.environment import DriftWithTemperature, DriftWithTime
from calib.tripod.effects.gauges import GaugeGain, GaugeTilt, PlateTilt
from calib.tripod.geometry import Geometry

CATALOGUE: tuple[Effect, ...] = (
    AxisSquareness(),
    AxisOffset(),
    Straightness(),
    ActuatorScale(),
    *(ActuatorCyclic(lead_mm) for lead_mm in STANDARD_LEADS_MM),
    Backlash(),
    LegLength(),
    GravitySag(),
    LegTaper(),
    LegBow(),
    GaugeGain(),
    GaugeTilt(),
    PlateTilt(),
    DriftWithTime(),
    DriftWithTemperature(),
)


def effects_of(effects: Iterable[Effect], geometry: Geometry) -> tuple[Effect, ...]:
    """The laws as they are on this machine: its screws' lead, the directions across its drives."""
    return with_directions(with_machine_lead(effects, geometry), geometry)
