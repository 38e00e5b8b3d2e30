"""Every effect that the program knows by itself."""

from __future__ import annotations

from calib.orthoglide.effects.actuators import (
    STANDARD_LEADS_MM,
    ActuatorCyclic,
    ActuatorScale,
    Backlash,
)
from calib.orthoglide.effects.axes import AxisOffset, AxisSquareness, Straightness
from calib.orthoglide.effects.bars import GravitySag, LegBow, LegTaper
from calib.orthoglide.effects.environment import DriftWithTemperature, DriftWithTime
from calib.orthoglide.effects.gauges import GaugeGain, GaugeTilt
from calib.orthoglide.effects.law import Law

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
    DriftWithTime(),
    DriftWithTemperature(),
)
