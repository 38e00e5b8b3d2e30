"""Where a carriage can be before and after its joint's entries change: limits and home switch.

LinuxCNC keeps MIN_LIMIT and MAX_LIMIT as coordinates of the joint. Homing gives the switch the
coordinate HOME_OFFSET. A changed HOME_OFFSET therefore moves the limits along the machine, and the
switch stays where it is. Everything here is in the coordinate that the joint has after the change:
a limit q was at q + e(q) until then, e being true - believed place of the carriage.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.tripod.controller import NOTHING_MM, ControllerJoint, JointEntries, carriage_error_mm
from calib.tripod.pipeline import Model


@dataclass(frozen=True)
class Switch:
    """A home switch, mm: its coordinate after the change, and the limit that it stands nearest to.

    That is the upper one where ``side`` is 1, the lower one where it is -1.
    ``beyond_now`` and ``beyond_after`` are how far it stands outside that limit, negative where
    inside; None where the limit towards which it is searched for is not stated.
    """

    at_mm: float
    side: int
    beyond_now_mm: float | None
    beyond_after_mm: float | None

    @property
    def newly_inside(self) -> bool:
        """Whether the joint reaches it within its limits after the change and did not before."""
        beyond_now_mm, beyond_after_mm = self.beyond_now_mm, self.beyond_after_mm
        if beyond_now_mm is None or beyond_after_mm is None:
            return False
        return beyond_after_mm < -NOTHING_MM and beyond_now_mm >= -NOTHING_MM


@dataclass(frozen=True)
class JointTravel:
    """Limits of a joint now and after the change, mm; None where one of them is not stated.

    ``home_beyond_mm`` is how far homing ends beyond the switch after the change where it did not
    before, else 0.
    """

    now_mm: tuple[float, float] | None
    after_mm: tuple[float, float] | None
    switch: Switch | None
    home_beyond_mm: float = 0.0


def travel_of(
    model: Model, drive: int, joint: ControllerJoint, entries: JointEntries, way: int = 1
) -> JointTravel:
    """The travel of a drive's joint with these entries; with ``way`` -1 it counts against it."""

    def moved_mm(limit_mm: float, sense: int) -> float:
        """Where a limit was until now; it is reached upwards (1) or downwards."""
        at = np.full((1, 3), way * limit_mm)
        return limit_mm + way * float(carriage_error_mm(model, at, way * sense)[0, drive])

    limits_now = limits_after = None
    if joint.min_limit_mm is not None and joint.max_limit_mm is not None:
        limits_after = (joint.min_limit_mm, joint.max_limit_mm)
        limits_now = (moved_mm(limits_after[0], -1), moved_mm(limits_after[1], 1))
    search = joint.search_sign or 0
    if not search or joint.absolute_encoder:
        return JointTravel(limits_now, limits_after, None)
    at_mm = joint.home_offset_mm + entries.home_change_mm
    onto_mm = search * (joint.home_mm - at_mm)
    was_onto = search * (joint.home_mm - joint.home_offset_mm) > NOTHING_MM
    beyond_mm = onto_mm if onto_mm > NOTHING_MM and not was_onto else 0.0
    return JointTravel(limits_now, limits_after, _switch(joint, at_mm, search), beyond_mm)


def _switch(joint: ControllerJoint, at_mm: float, search: int) -> Switch:
    limits = {-1: joint.min_limit_mm, 1: joint.max_limit_mm}
    if limits[search] is None:
        return Switch(at_mm, search, None, None)
    sides = [(side, limit) for side, limit in limits.items() if limit is not None]
    side, limit = min(sides, key=lambda place: abs(at_mm - place[1]))
    return Switch(at_mm, side, side * (joint.home_offset_mm - limit), side * (at_mm - limit))
