"""Every effect that the program knows by itself."""

from __future__ import annotations

from collections.abc import Iterable

from calib.tripod.effects.actuators import (
    STANDARD_LEADS_MM,
    ActuatorCyclic,
    ActuatorScale,
    Backlash,
    ScrewGrowth,
    with_machine_lead,
)
from calib.tripod.effects.axes import (
    AxisDistance,
    AxisOffset,
    AxisSquareness,
    Straightness,
    StraightnessOfThirdOrder,
    with_directions,
)
from calib.tripod.effects.bars import (
    BarGrowth,
    GravitySag,
    JointClearance,
    LegBow,
    LegLength,
    LegTaper,
)
from calib.tripod.effects.effect import Effect
from calib.tripod.effects.environment import DriftOfStand, DriftWithTemperature, DriftWithTime
from calib.tripod.effects.gauges import (
    GaugeGain,
    GaugeHysteresis,
    GaugeTilt,
    PlateTilt,
    TipOnRoundBar,
)
from calib.tripod.geometry import Geometry

CATALOGUE: tuple[Effect, ...] = (
    AxisSquareness(),
    AxisOffset(),
    AxisDistance(),
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

"""Those that the diagnosis looks for."""

BESIDE_CATALOGUE: tuple[Effect, ...] = (
    StraightnessOfThirdOrder(),
    ScrewGrowth(),
    BarGrowth(),
    JointClearance(),
    TipOnRoundBar(),
    GaugeHysteresis(),
    DriftOfStand(),
)
"""Those that models may hold and simulations follow; the diagnosis does not look for them."""


ISO_230 = {
    "axis_squareness": "E_A0Z of yz, E_B0Z of xz, E_C0Y of xy",
    "straightness": "E_YX of xy, E_ZX of xz, E_XY of yx …",
    "straightness_cubic": "E_YX of xy, E_ZX of xz, E_XY of yx …",
    "actuator_scale": "E_XX of x, its linear part",
    "actuator_cyclic": "E_XX of x, its periodic part",
    "backlash": "B of x (reversal value, ISO 230-2)",
    "thermal_drift": "ETVE (ISO 230-3)",
    "thermal_growth": "E_XX(T) of x (ISO 230-3)",
}
"""Symbols of ISO 230-1 for errors of linear axes; bars, indicators and clearances have none."""


def effects_of(effects: Iterable[Effect], geometry: Geometry) -> tuple[Effect, ...]:
    """The laws as they are on this machine: its screws' lead, the directions across its drives."""
    return with_directions(with_machine_lead(effects, geometry), geometry)
