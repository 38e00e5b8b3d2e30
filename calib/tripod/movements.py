"""How each carriage came to where it is: from the way of the tool, or from repeats of a posture."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from calib.arrays import TOOL, Conditions, FloatArray, Observations, numbered, rows_of
from calib.noise.repeats import Repeats
from calib.tripod.geometry import Geometry, dot, inverse

STILL_MM = 1e-6
"""A carriage that is to move by less stands still: no controller resolves it."""

TURNED_MM = 0.01
"""A carriage that came back by less has not taken up its play: it stands as it came before."""

DEPARTS = 4.0
"""Standard deviations beyond which a first reading was not reached as its repeats were."""


def carriage_movement(geometry: Geometry, from_mm: FloatArray, to_mm: FloatArray) -> FloatArray:
    """Sign ``(n, 3)`` of each carriage's movement between tool positions ``(n, 3)``.

    Less than `STILL_MM` is none. Raises UnreachablePosture.
    """
    shift = inverse(geometry, to_mm) - inverse(geometry, from_mm)
    return np.asarray(np.where(np.abs(shift) < STILL_MM, 0.0, np.sign(shift)))


def last_movement(geometry: Geometry, conditions: Conditions) -> FloatArray:
    """Sign of the last movement of each carriage ``(n, 3)``; 0 where it is not known.

    Readings of the tool tell it themselves. Along the drive of a touched leg its carriage follows
    the displacement s. The others are commanded, on an Orthoglide, ``sqrt(L^2 - s^2)``: they went
    down where the tool went away from Zero at last, up where it came nearer, and so up on arriving
    at Zero. Across drives that are not square they also go along with the tool, and turn back a
    little before Zero or behind it; by less than `TURNED_MM` that does not count.
    """
    way = geometry.directions[np.where(conditions.leg == TOOL, 0, conditions.leg)]
    tool = geometry.leg_zero_mm[conditions.leg] + conditions.displacement_mm[:, None] * way
    ray = tool[:, None] - geometry.anchors
    along, slope = dot(ray, geometry.directions), way @ geometry.directions.T
    covered = np.sqrt(geometry.lengths**2 - (dot(ray, ray) - along**2))
    inward = dot(ray, way[:, None]) - along * slope
    speed = slope - inward / covered
    bent = (1.0 - slope**2) / covered + inward**2 / covered**3  # minus the derivative of the speed
    turning = speed**2 < 2.0 * TURNED_MM * bent  # there a carriage is as far up as it goes
    approach = conditions.approach[:, None]
    movement = np.where(turning, np.abs(approach), np.sign(speed) * approach)
    is_stated = (conditions.leg == TOOL) | conditions.movement.any(axis=1)
    return np.where(is_stated[:, None], conditions.movement, movement)


def departures_mm(observations: Observations, least: float = DEPARTS) -> dict[int, float]:
    """First readings of mountings that depart from their repeats of every known side.

    By the row, mm from the nearest side. Nobody saw how they were reached. ``least`` is in standard
    deviations of the difference.
    """
    repeats = Repeats.of(observations)
    scatter = repeats.standard_deviation_mm
    with_approach, departures = observations.approach_known, {}
    if scatter is None:
        return {}
    for row in np.flatnonzero(~with_approach).tolist():
        alike = np.flatnonzero(with_approach & (observations.posture == observations.posture[row]))
        if not len(alike):
            continue
        sides = [alike[rows] for rows in rows_of(numbered(repeats.cell[alike]))]
        off_mm = [
            float(observations.value_mm[row] - observations.value_mm[side].mean()) for side in sides
        ]
        least_mm = [least * scatter * math.sqrt(1.0 + 1.0 / len(side)) for side in sides]
        if all(abs(off) > far for off, far in zip(off_mm, least_mm, strict=True)):
            departures[row] = min(off_mm, key=abs)
    return departures


def with_first_movements(geometry: Geometry, observations: Observations) -> Observations:
    """The visits, with movements where nobody saw how a posture was reached: its repeats tell.

    The first reading of a mounting that departs from those that were reached from a known side was
    reached from the other one. One that agrees stays as it is: so far as it shows, nothing has
    play.
    """
    movement, last = observations.movement.copy(), last_movement(geometry, observations)
    for row in departures_mm(observations):
        alike = observations.approach_known & (observations.posture == observations.posture[row])
        ways = last[alike]  # a carriage that came from both sides tells nothing
        movement[row] = np.where((ways == ways[0]).all(axis=0), -ways[0], 0.0)
    return replace(observations, movement=movement)
