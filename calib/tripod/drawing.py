"""A machine with the indicators of one set-up as lines in space, and the side to see them from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.arrays import FloatArray
from calib.tripod.geometry import UNIT, Geometry, inverse

INDICATOR = 0.35
"""How long an indicator is drawn, of the bar that it touches."""

RAIL_POINTS = 24

PARALLEL, ABOVE_RAD = 0.98, 0.5
"""Cosine of all drives to their middle beyond which they hide one another, seen along it; and from
how far above they are then seen.
"""


@dataclass(frozen=True, eq=False)
class Lines:
    """The machine in a posture, mm from the tool at Zero.

    ``rails`` ``(3, n, 3)`` as far as the carriages go, ``bars`` ``(3, 2, 3)`` from the platform to
    the carriage, ``platform`` ``(3, 2, 3)`` from the tool to each bar, the ``touched`` point
    ``(3,)``; for each indicator ``(k, 2, 3)`` its spindle from there to the body, and as far
    along its axis, ``ahead``.
    """

    rails: FloatArray
    bars: FloatArray
    platform: FloatArray
    touched: FloatArray
    spindles: FloatArray
    ahead: FloatArray

    def seen(self, view: FloatArray) -> Lines:
        """The lines in the plane of a picture, ``(2, 3)``: what stands last is then ``(2,)``."""
        return Lines(*(part @ view.T for part in vars(self).values()))


def set_up_lines(
    geometry: Geometry,
    leg: int,
    axes: Sequence[int],
    sides: Sequence[float],
    station: float,
    displacement_mm: float,
) -> Lines:
    """Indicators along ``axes`` on the bar of a leg, in the posture of a displacement.

    ``sides`` tells for each on which side of the bar it stands: +1.0 where its axis points. It
    stands still while the bar slides past (papers/000, equation (10)). Raises UnreachablePosture.
    """
    tool = geometry.leg_zero_mm[leg] + displacement_mm * geometry.directions[leg]
    origins, along = geometry.origins, geometry.directions
    ends = tool + geometry.platform
    feet = origins + along * inverse(geometry, tool)[:, None]
    travel = np.linspace(geometry.travel_min_mm, geometry.travel_max_mm, RAIL_POINTS)
    carriages = geometry.zero_mm[:, None] + travel
    fraction = geometry.touched(np.array([leg]), np.array([station]), np.array([displacement_mm]))
    touched = ends[leg] + fraction[0] * (feet[leg] - ends[leg])
    measured = INDICATOR * geometry.lengths[leg] * geometry.read_along[leg, list(axes)]
    spindles = np.stack([0.0 * measured, np.asarray(sides)[:, None] * measured], axis=1)
    return Lines(
        rails=origins[:, None] + carriages[..., None] * along[:, None],
        bars=np.stack([ends, feet], axis=1),
        platform=np.stack([np.broadcast_to(tool, (3, 3)), ends], axis=1),
        touched=touched,
        spindles=touched + spindles,
        ahead=touched + np.stack([0.0 * measured, measured], axis=1),
    )


def view(geometry: Geometry) -> FloatArray:
    """Unit vectors ``(2, 3)`` to the right and upwards in a picture of a machine.

    Drives at right angles are seen evenly from the corner between them, so that they and what is
    parallel to them stand 120° apart, all as much foreshortened; against gravity is up. Parallel
    drives are seen aslant, the last one behind.
    """
    towards = geometry.directions.sum(axis=0)
    towards = towards / np.linalg.norm(towards)
    against = -np.array(geometry.gravity)
    if towards @ against < 0.0:
        towards = -towards
    if float(np.abs(geometry.directions @ towards).min()) > PARALLEL:
        behind = geometry.origins[2] - geometry.origins.mean(axis=0)
        behind = behind - (behind @ towards) * towards
        towards = np.tan(ABOVE_RAD) * towards - behind / np.linalg.norm(behind)
        towards = towards / np.linalg.norm(towards)
    for way in (against, geometry.directions[0]):
        upwards = way - (way @ towards) * towards
        if float(np.linalg.norm(upwards)) > UNIT:
            break
    upwards = upwards / np.linalg.norm(upwards)
    return np.stack([np.cross(upwards, towards), upwards])
