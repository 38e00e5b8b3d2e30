"""What a machine may have beyond offsets and lengths: every law of the program.

May import what `calib.tripod` may, its geometry and pipeline first of all.
"""

from __future__ import annotations

from calib.tripod.effects.bars import (
    BarGrowth,
    GravitySag,
    JointClearance,
    LegBow,
    LegLength,
    LegTaper,
)
from calib.tripod.effects.drives import (
    STANDARD_LEADS_MM,
    ActuatorCyclic,
    ActuatorScale,
    AxisDistance,
    AxisOffset,
    AxisSquareness,
    Backlash,
    ScrewGrowth,
    Straightness,
    StraightnessOfThirdOrder,
)
from calib.tripod.effects.effect import Effect
from calib.tripod.effects.gauges import (
    ROUND,
    SHAPES,
    DriftOfStand,
    DriftWithTemperature,
    DriftWithTime,
    GaugeGain,
    GaugeHysteresis,
    GaugeTilt,
    PlateTilt,
    PlatformTilt,
    TiltOfTouchedPlate,
    TipOnRoundBar,
)

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
    TiltOfTouchedPlate(),
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
    *SHAPES,
    ROUND,
    PlatformTilt(),
)
"""Those that machines have less often: the diagnosis gives them less weight beforehand."""
