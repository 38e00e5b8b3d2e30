"""One carriage moved alone: where its controller is sent, and what indicators then show."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from calib.arrays import LEG_NAMES, conditions
from calib.errors import UnreachablePosture
from calib.tripod.geometry import PARAMETER_NAMES, direct, inverse
from calib.tripod.pipeline import readings_and_derivatives
from protocols.documents import Triple, triple
from protocols.machine import Machine
from protocols.motion import tool_of
from protocols.procedure import ALL_AXES, Step, leg_number

STAND_MM = 5.0
"""So far along the bar a stand may be from the station."""

LEAN = 0.1
"""Of what is touched moving across an indicator, so much it shows: a tip on a round bar, a lean."""

STILL_MM = 0.03
"""Play, a digit and a stand that yields."""


@dataclass(frozen=True)
class Change:
    """How far an indicator goes, mm, on a nominal machine, and how far a raw one may be off it."""

    nominal_mm: float
    within_mm: float

    def is_near(self, change_mm: float) -> bool:
        """Whether a change is this one in size. The sign depends on how the indicator is held."""
        return abs(abs(change_mm) - abs(self.nominal_mm)) <= self.within_mm


def moved_alone(place_mm: Triple, carriage: str, way_mm: float, machine: Machine) -> Triple | None:
    """Where the controller goes if one carriage moves alone, in its coordinates.

    None where the bars do not reach.
    """
    geometry, place = machine.geometry(), np.array(place_mm)
    along = way_mm * np.eye(3)[LEG_NAMES.index(carriage)]
    try:
        joints = (place if machine.mdi == "joint" else inverse(geometry, place)) + along
        tool = direct(geometry, joints)
    except UnreachablePosture:
        return None
    return triple((joints if machine.mdi == "joint" else tool).tolist())


def is_allowed(place_mm: Triple, machine: Machine) -> bool:
    """Whether bars and joint limits allow a place of the controller."""
    geometry = machine.geometry()
    return bool(geometry.stands(tool_of([place_mm], machine.mdi, geometry))[0])


def changes(step: Step, from_mm: Triple, to_mm: Triple, machine: Machine) -> tuple[Change, ...]:
    """What the indicators of a set-up show of a move, if they were set up where it begins.

    Raises UnreachablePosture.
    """
    geometry = machine.geometry()
    tool, goal = tool_of((from_mm, to_mm), machine.mdi, geometry)
    # the same machine, with its Zero where indicators are set up: here
    origins = (geometry.origins - tool).tolist()
    local = replace(geometry, origin_mm=origins, workspace_mm=None, plane_mm=None)
    place_mm, leg = goal - tool, leg_number(step.leg)
    bar_mm = local.leg_length_mm[leg] if step.leg in ALL_AXES else math.inf
    share = STAND_MM / bar_mm
    stations = (step.station, step.station - share, step.station + share)
    axes = [leg_number(axis) for axis in ALL_AXES]
    observations = conditions(
        [leg] * 9,
        axes * 3,
        [0.0] * 9,
        station=np.repeat(stations, 3).tolist(),
        position_mm=place_mm,
    )
    nominal = (0.0,) * len(PARAMETER_NAMES)
    readings, by_parameter = readings_and_derivatives(local, nominal, observations)
    # a raw machine is off by at most so many standard deviations of its parts
    raw_mm = 3.0 * np.linalg.norm(by_parameter[:3] * machine.tolerances_mm(), axis=1)
    moved, below, above = readings.reshape(3, 3)
    aside_mm = np.abs(above - below) / 2.0
    across_mm = np.sqrt(np.maximum((moved**2).sum() - moved**2, 0.0))
    within = raw_mm + aside_mm + LEAN * across_mm + STILL_MM
    rows = [LEG_NAMES.index(axis) for axis in step.axes]
    return tuple(Change(float(moved[row]), float(within[row])) for row in rows)
