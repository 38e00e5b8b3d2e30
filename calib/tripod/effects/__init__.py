"""What a machine may have beyond offsets and lengths: every law of the program.

May import what `calib.tripod` may, its geometry and pipeline first of all.
"""

from __future__ import annotations

from calib.tripod.effects import bars, drives, gauges
from calib.tripod.effects.effect import Effect

CATALOGUE: tuple[Effect, ...] = (
    drives.AxisSquareness(),
    drives.AxisOffset(),
    drives.AxisDistance(),
    drives.Straightness(),
    drives.ActuatorScale(),
    *(drives.ActuatorCyclic(lead_mm) for lead_mm in drives.STANDARD_LEADS_MM),
    drives.Backlash(),
    bars.LegLength(),
    bars.GravitySag(),
    bars.LegTaper(),
    bars.LegBow(),
    gauges.GaugeGain(),
    gauges.GaugeTilt(),
    gauges.PlateTilt(),
    gauges.TiltOfTouchedPlate(),
    gauges.DriftWithTime(),
    gauges.DriftWithTemperature(),
)
"""Those that the diagnosis looks for."""

BESIDE_CATALOGUE: tuple[Effect, ...] = (
    drives.StraightnessOfThirdOrder(),
    drives.ScrewGrowth(),
    bars.BarGrowth(),
    bars.JointClearance(),
    gauges.TipOnRoundBar(),
    gauges.GaugeHysteresis(),
    gauges.DriftOfStand(),
    *gauges.SHAPES,
    gauges.ROUND,
    gauges.PlatformTilt(),
)
"""Those that machines have less often: the diagnosis gives them less weight beforehand."""
