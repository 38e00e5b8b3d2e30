"""Every effect that the program knows by itself."""

from __future__ import annotations

from collections.abc import Iterable

from calib.orthoglide.effects.actuators import (
    STANDARD_LEADS_MM,
    ActuatorCyclic,
    ActuatorScale,
    Backlash,
    with_machine_lead,
)
from calib.orthoglide.effects.axes import (
    AxisOffset,
    AxisSquareness,
    Straightness,
    with_directions,
)
from calib.orthoglide.effects.bars import GravitySag, LegBow, LegTaper
from calib.orthoglide.effects.environment import DriftWithTemperature, DriftWithTime
from calib.orthoglide.effects.gauges import GaugeGain, GaugeTilt, PlateTilt
from calib.orthoglide.effects.law import Law
from calib.orthoglide.geometry import Geometry

CATALOGUE: tuple[Law, ...] = (
    AxisSquareness(),
    AxisOffset(),
    Straightness(),
    ActuatorScale(),
    *(ActuatorCyclic(lead_mm) for lead_mm in STANDARD_LEADS_MM),
    Backlash(),
    GravitySag(),
    LegTaper(),
    LegBow(),
    GaugeGain(),
    GaugeTilt(),
    PlateTilt(),
    DriftWithTime(),
    DriftWithTemperature(),
)


def laws_of(laws: Iterable[Law], geometry: Geometry) -> tuple[Law, ...]:
    """The laws as they are on this machine: its screws' lead, the directions across its drives."""
    return with_directions(with_machine_lead(laws, geometry), geometry)
