"""Effects of the three drives: errors along the way, how axes lie and how straight they are."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.arrays import LEG_NAMES
from calib.tripod.effects.effect import (
    AROUND,
    AT_MM,
    PAIRS,
    PER_THOUSAND,
    Acting,
    Effect,
    EffectParameter,
    Kind,
    Law,
    OfCarriage,
    OfFoot,
    Placed,
    from_meeting_mm,
    law_named,
    machine_kelvins,
    moved_foot,
    numbers,
    travel_mm,
    wave_mm,
)
from calib.tripod.geometry import Geometry
from calib.tripod.movements import last_movement
from calib.tripod.pipeline import Stage

STANDARD_LEADS_MM = (4.0, 5.0, 10.0, 20.0)
"""Leads that are tried first where the machine file does not name the screw's."""

ISO_LEADS_MM = (4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 16.0, 20.0, 25.0, 32.0, 40.0)
"""Leads of ball screws, ISO 3408-2: one of them goes before another that fits as well."""

LEAD = re.compile(r"(?:sine|cosine)_([0-9]{1,4}(?:\.[0-9]{1,4})?)mm")


@dataclass(frozen=True)
class ActuatorScale(OfCarriage):
    """Travel is wrong in proportion; positive: the carriage travels further than commanded."""

    id = "actuator_scale"
    title = "a carriage travels too far or too short in proportion to its travel"
    parameters = (EffectParameter("scale", "mm/m", 0.1),)
    controller = (
        "joint {place}: multiply SCALE by 1 − ({scale}), or COMP_FILE of export --format linuxcnc"
    )

    def off(self, at: Acting) -> NDArray[Any]:
        """A part of the commanded travel."""
        return PER_THOUSAND * at.values[0] * travel_mm(at.flow, at.leg)


@dataclass(frozen=True)
class ActuatorCyclic(OfCarriage):
    """Travel is wrong with the screw's turn: a sine and a cosine, zero at Zero."""

    lead_mm: float
    id = "actuator_cyclic"
    title = "a screw's error repeats with every turn"
    controller = "joint {place}: COMP_FILE of export --format linuxcnc"

    @property
    def parameters(self) -> tuple[EffectParameter, ...]:
        """Two amplitudes; their names tell the lead."""
        ending = f"{self.lead_mm:g}mm"
        return (
            EffectParameter(f"sine_{ending}", "µm", 5.0, 100.0),
            EffectParameter(f"cosine_{ending}", "µm", 5.0, 100.0),
        )

    def off(self, at: Acting) -> NDArray[Any]:
        """Values a and b: a sin t + b (cos t - 1), t one turn for each lead of travel."""
        return wave_mm(at, self.lead_mm, *at.values)


@dataclass(frozen=True)
class ScrewGrowth(OfCarriage):
    """A screw grows from its fixed bearing, where the coordinate is 0, with the temperature.

    Steel: 11.5 µm/m K. Kelvins count from 20 °C.
    """

    id = "thermal_growth"
    title = "a screw grows with the temperature"
    kind = Kind.ENVIRONMENT
    parameters = (EffectParameter("screw_per_kelvin", "µm/m K", 5.0, least=0.0),)
    controller = "nothing to enter: keep the machine at the temperature of its calibration"

    def off(self, at: Acting) -> NDArray[Any]:
        """Value · coordinate · (temperature - 20 °C)."""
        strain = PER_THOUSAND**2 * at.values[0] * machine_kelvins(at.flow.taken)
        return np.asarray(strain * at.flow.command_mm[:, at.leg])


@dataclass(frozen=True)
class Backlash(OfCarriage):
    """A carriage stays back, at the larger coordinate, when it last moved to smaller ones."""

    id = "backlash"
    title = "a carriage has play: it stays back when it comes from the other side"
    parameters = (EffectParameter("play", "mm", 0.01, least=0.0),)
    controller = "joint {place}: BACKLASH = {play}"

    def off(self, at: Acting) -> NDArray[Any]:
        """The play after a movement to smaller coordinates, else nothing."""
        return at.values[0] * (last_movement(at.flow.geometry, at.flow.taken)[:, at.leg] < 0)


@dataclass(frozen=True)
class AxisSquareness(Law):
    """A pair of axes leans together; positive: their angle is less than 90°.

    Both axes take half of it: leg readings see the sum of the two leans only. Each turns about
    where the axes meet; parallel drives lean towards each other from where the tool is at Zero.
    """

    id = "axis_squareness"
    title = "two actuator axes are not square to each other"
    stage = Stage.FOOT
    where = PAIRS
    parameters = (EffectParameter("lean", "mrad", 0.5),)
    controller = (
        "axes {place}: the kinematics of export --format linuxcnc-kins, or turn one "
        "of them by {lean} away from the other"
    )

    def off(self, at: Acting) -> NDArray[Any]:
        """Each foot ``(..., n, 3, 3)`` of the pair towards the other axis, the more the farther
        from both: by half of the angle.
        """
        half, pair = PER_THOUSAND * at.values[0] / 2, numbers(at.place)
        first_foot, second_foot = (
            moved_foot(
                leg, at.flow.geometry.towards(leg, partner), half * from_meeting_mm(at.flow, leg)
            )
            for leg, partner in (pair, pair[::-1])
        )
        return np.asarray(first_foot + second_foot)


@dataclass(frozen=True)
class AxisOffset(OfFoot):
    """An axis is shifted sideways; ``"xy"``: axis x towards +y.

    Of square drives leg readings see differences only, see `AxisDistance`; a model may hold shifts.
    """

    id = "axis_offset"
    title = "an actuator axis is shifted sideways and misses the point where they meet"
    parameters = (EffectParameter("shift", "mm", 0.1),)
    controller = (
        "axis {axis}: the kinematics of export --format linuxcnc-kins, or shim it by "
        "{shift} against {along}"
    )


@dataclass(frozen=True)
class AxisDistance(Law):
    """Two square axes miss each other; ``"xy"``: along z, axis x lies further that way than axis y.

    Of the six shifts of three square axes leg readings see these three distances between
    neighbours: all axes shifted by one vector, the rest, are the same machine with other joint
    offsets. Each axis of the pair takes half of it.
    """

    id = "axis_offset"
    title = "two actuator axes miss each other"
    stage = Stage.FOOT
    where = AROUND
    parameters = (EffectParameter("distance", "mm", 0.1),)
    controller = (
        "axes {place}: the kinematics of export --format linuxcnc-kins, or shim axis {axis} "
        "against {third} by {distance}"
    )

    def off(self, at: Acting) -> NDArray[Any]:
        """Both feet ``(..., n, 3, 3)`` of the pair apart along the third axis, half of it each."""
        half, (first, second) = np.asarray(at.values[0] / 2), numbers(at.place)
        third = np.cross(*at.flow.geometry.directions[[first, second]])
        third = third / np.linalg.norm(third)
        return np.asarray(moved_foot(first, third, half) - moved_foot(second, third, half))


@dataclass(frozen=True)
class Straightness(OfFoot):
    """A foot leaves its line sideways with the square of travel; ``"xy"``: axis x towards +y."""

    id = "straightness"
    title = "a guide is not straight: the foot leaves its line sideways"
    parameters = (EffectParameter("sideways_at_100mm", "mm", 0.02),)
    controller = "axis {axis}: the kinematics of export --format linuxcnc-kins"
    power = 2

    def off(self, at: Acting) -> NDArray[Any]:
        """Value (travel / 100 mm) to the power."""
        part = travel_mm(at.flow, at.leg) / AT_MM
        return np.asarray(at.values[0] * part**self.power)


@dataclass(frozen=True)
class StraightnessOfThirdOrder(Straightness):
    """A guide bent like an S; ``"xy"``: axis x towards +y at positive travel."""

    id = "straightness_cubic"
    title = "a guide is bent like an S: the foot leaves its line sideways"
    parameters = (EffectParameter("s_shape_at_100mm", "mm", 0.02),)
    power = 3


@dataclass(frozen=True)
class StraightnessOfFourthOrder(Straightness):
    """A guide bent like a W; ``"xy"``: axis x towards +y at both ends of its travel."""

    id = "straightness_fourth"
    title = "a guide is bent like a W: the foot leaves its line sideways"
    parameters = (EffectParameter("w_shape_at_100mm", "mm", 0.02),)
    power = 4


@dataclass(frozen=True)
class AxisLean(OfFoot):
    """One axis leans; ``"xy"``: axis x towards +y, about where it is nearest to the tool at Zero.

    Leg readings see the sum of both leans of a pair only (`AxisSquareness`); the difference turns
    the machine's frame.
    """

    id = "axis_lean"
    title = "an actuator axis leans"
    parameters = (EffectParameter("axis_lean", "mrad", 0.5),)
    controller = "axis {axis}: the kinematics of export --format linuxcnc-kins"

    def off(self, at: Acting) -> NDArray[Any]:
        """Value · distance along the drive."""
        return PER_THOUSAND * at.values[0] * from_meeting_mm(at.flow, at.leg)


def geometry_tolerances(
    geometry: Geometry, across_mm: float, lean_mrad: float, scale_mm_m: float
) -> dict[Placed, float]:
    """Parameters of the drives' lines, laws at places, with the standard deviation of each.

    Of each drive where its line lies across itself, how it leans, and what its travel is off by; 0:
    a part that is as stated. Where legs are read these see differences of two drives. Parallel
    drives are round each other as they are about the last: no reading shows a turn of all, and
    firmware of printers measures it from there, too.
    """
    of_two = math.sqrt(2.0)
    across = tuple(geometry.across)
    laws: tuple[tuple[Effect, tuple[str, ...], float], ...] = (
        (AxisDistance(), AROUND, of_two * across_mm),
        (AxisSquareness(), PAIRS, of_two * lean_mrad),
    )
    if not geometry.common_zero:
        laws = (
            (AxisOffset(across), across[:-1] if geometry.parallel else across, across_mm),
            (AxisLean(across), across, lean_mrad),
        )
    laws = (*laws, (ActuatorScale(), LEG_NAMES, scale_mm_m))
    return {(law, place): size for law, places, size in laws if size for place in places}


def cyclic_of(names: Iterable[str]) -> ActuatorCyclic | None:
    """The law of any lead whose parameters have these names; None where there is none."""
    return law_named(ActuatorCyclic, LEAD, names)


def effects_of(effects: Iterable[Effect], geometry: Geometry) -> tuple[Effect, ...]:
    """The laws as they are on this machine: its screws' lead, the directions across its drives.

    Where the lead is known, cyclic errors have that lead only, and stand last. Axes whose
    bars lie along them miss each other; others are shifted.
    """
    not_here = AxisOffset if geometry.common_zero else AxisDistance
    here = [effect for effect in effects if not isinstance(effect, not_here)]
    other_effects = [effect for effect in here if not isinstance(effect, ActuatorCyclic)]
    if geometry.screw_lead_mm is not None and len(other_effects) < len(here):
        here = [*other_effects, ActuatorCyclic(geometry.screw_lead_mm)]
    across = tuple(geometry.across)
    return tuple(
        replace(effect, where=across) if isinstance(effect, OfFoot) else effect for effect in here
    )
