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


def effects_of(effects: Iterable[Effect], geometry: Geometry) -> tuple[Effect, ...]:
    """The laws as they are on this machine: its screws' lead, the directions across its drives."""
    return with_directions(with_machine_lead(effects, geometry), geometry)
