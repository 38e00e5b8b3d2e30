"""Where a controller is sent for a step and by which way; what its answer means for a reading."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from calib.arrays import LEG_NAMES, FloatArray, conditions
from calib.errors import RecordError
from calib.tripod.geometry import Geometry, direct, inverse
from calib.tripod.movements import carriage_movement
from calib.tripod.pipeline import commanded_tool
from protocols.documents import Triple, triple
from protocols.machine import Machine, MotionLimits
from protocols.procedure import (
    ALL_AXES,
    BOTH,
    Procedure,
    Step,
    guided_procedure_names,
    leg_number,
    position_words,
)
from protocols.session import Moved

SELF_MOVING = "two-station"
"""The procedure of a machine that moves itself: two stations, both directions, more levels."""


def procedure_of(machine: Machine, *, moving: bool) -> str:
    """The procedure where none is named; where a controller moves, one that is too long by hand.

    Not where the machine file names its own, or limits of the machine forbid it.
    """
    by_hand = machine.procedure is not None or not moving
    if by_hand or SELF_MOVING not in guided_procedure_names(machine.geometry()):
        return machine.usual_procedure
    return SELF_MOVING


def commanded_mm(step: Step, machine: Machine) -> Triple:
    """What the controller is told for a step, in the coordinates that it takes.

    Raises UnreachablePosture.
    """
    return _in_coordinates(tool_mm(step, machine.geometry()), machine)


def joints_mm(step: Step, geometry: Geometry) -> dict[str, float]:
    """Joint coordinates of x, y and z that the controller commands for a step."""
    joints = inverse(geometry, tool_mm(step, geometry))
    return dict(zip(LEG_NAMES, joints.tolist(), strict=True))


def zero_mm(machine: Machine) -> Triple:
    """Zero in the coordinates that the controller takes."""
    return _in_coordinates(np.zeros(3), machine)


def _in_coordinates(tool: FloatArray, machine: Machine) -> Triple:
    """A tool position ``(3,)`` from Zero in the coordinates that the controller takes."""
    target = inverse(machine.geometry(), tool) if machine.mdi == "joint" else tool
    return triple(float(mm) + 0.0 for mm in target)  # no -0.0


def tool_mm(step: Step, geometry: Geometry) -> FloatArray:
    """Tool position ``(3,)`` from Zero that is commanded for a step."""
    leg, axis = leg_number(step.leg), leg_number(step.axes[0])
    at = conditions([leg], [axis], [step.displacement_mm], position_mm=step.position_mm)
    return np.asarray(commanded_tool(geometry, at)[0])


def way_mm(
    step: Step, previous: Step | None, procedure: Procedure, machine: Machine
) -> list[Triple]:
    """Places for the controller, the last one that of the step.

    From ``previous``, where the machine stands in the same set-up, straight; a tool that lifts off
    does so at both ends. Without, by way of the posture that the procedure comes from, or else
    from below: so far before the place, along the leg or in the plane of a plate, as the machine
    file says (``preroll_mm``). Raises RecordError for a place that the machine does not reach.
    """
    geometry = machine.geometry()
    goal = tool_mm(step, geometry)
    lift = np.zeros(3)
    if procedure.plate is not None:
        lift[leg_number(step.axes[0])] = procedure.plate.lift_mm
    places: list[FloatArray] = []
    if lift.any():
        places = [] if previous is None else [tool_mm(previous, geometry) + lift]
        places.append(goal + lift)
    elif previous is None:
        places = [goal - (machine.motion or MotionLimits()).preroll_mm * _along(step, geometry)]
    places.append(goal)
    outside = next((at for at in places if not geometry.stands(at[None])[0]), None)
    if outside is not None:
        raise RecordError(
            f"way to step {step.number}",
            position_words(triple(round(float(mm), 3) for mm in outside)),
            "a position that the bars reach within the joint limits",
            "Change preroll_mm under [motion] in the machine file, or the procedure.",
        )
    return [_in_coordinates(at, machine) for at in places]


def came_from(step: Step, steps: Sequence[Step]) -> Step | None:
    """The step whose posture a procedure leaves for this one; None at the beginning of a set-up."""
    for earlier in reversed(steps[: step.number - 1]):
        if earlier.place != step.place:
            return None
        if earlier.posture_mm != step.posture_mm:
            return earlier
    return None


def _along(step: Step, geometry: Geometry) -> FloatArray:
    """Direction ``(3,)`` of a pre-roll: along the leg, or across what a plate is read along."""
    if step.leg != "tool":
        return np.asarray(geometry.directions[leg_number(step.leg)])
    across = next(axis for axis in ALL_AXES if axis not in step.axes)
    return np.asarray(np.eye(3)[LEG_NAMES.index(across)])


def tool_at(target: Triple, machine: Machine) -> Triple:
    """Where the tool of a machine without errors is, from Zero, when its controller is there."""
    return triple(tool_of(target, machine.mdi, machine.geometry()).tolist())


def moves_mm(ways: Iterable[Sequence[Triple]]) -> list[float]:
    """How long each single move of these ways is, one after the other."""
    places = [place for way in ways for place in way]
    return [float(np.linalg.norm(np.subtract(a, b))) for a, b in pairwise(places)]


def all_ways(
    procedure: Procedure, machine: Machine, axes: Sequence[str]
) -> list[tuple[Step, list[Triple]]]:
    """Every step of a whole session, with its way from the one before. Raises as `way_mm`."""
    ways: list[tuple[Step, list[Triple]]] = []
    previous: Step | None = None
    for step in procedure.steps(machine.geometry(), axes):
        start = previous if previous is not None and previous.place == step.place else None
        ways.append((step, way_mm(step, start, procedure, machine)))
        previous = step
    return ways


def seconds_per_step(machine: Machine, procedure: Procedure, axes: Sequence[str] = BOTH) -> float:
    """How long one step takes on average: its way at the feed, and the rest that is looked at.

    By hand, where the machine file has no [motion], what the procedure states.
    """
    if machine.motion is None:
        return procedure.seconds_per_step
    ways = [way for _, way in all_ways(procedure, machine, axes)]
    moving_s = sum(moves_mm(ways)) / machine.motion.feed_mm_min * 60.0
    return moving_s / len(ways) + procedure.window_s


def timed(procedure: Procedure, machine: Machine, axes: Sequence[str] = BOTH) -> Procedure:
    """The procedure with the time that its steps take on a machine that moves itself."""
    motion = machine.motion or MotionLimits()
    moving = machine.model_copy(update={"motion": motion})
    step_s = round(seconds_per_step(moving, procedure, axes), 3)
    return procedure.model_copy(update={"seconds_per_step": step_s})


def box_mm(machine: Machine) -> tuple[Triple, Triple]:
    """Lowest and highest place that the controller may be sent to, in its coordinates.

    That of the machine file; else from the limits of its joints. Raises RecordError where the tool
    of a machine whose drives are not square is to be told places and the file states no box.
    """
    limits, geometry = machine.motion or MotionLimits(), machine.geometry()
    if limits.low_mm is not None and limits.high_mm is not None:
        return limits.low_mm, limits.high_mm
    if machine.mdi == "tool" and not geometry.orthogonal:
        raise RecordError(
            f"machine '{machine.name}', motion",
            "no low_mm and high_mm",
            "the box that its tool may be sent to, under [motion] in the machine file",
        )
    zero = geometry.zero_mm if machine.mdi == "joint" else np.zeros(3)
    low, high = zero + geometry.travel_min_mm, zero + geometry.travel_max_mm
    return triple(low), triple(high)


def departure_mm(moved: Moved, geometry: Geometry) -> FloatArray:
    """How far the tool was read back ``(3,)`` from where it was sent."""
    ends = (moved.commanded_mm, moved.read_back_mm)
    commanded, actual = tool_of(ends, moved.coordinates, geometry)
    return np.asarray(actual - commanded)


def movement_signs(moved: Moved, geometry: Geometry) -> FloatArray:
    """Sign ``(3,)`` of each carriage's last movement, as commanded."""
    ends = tool_of((moved.from_mm, moved.commanded_mm), moved.coordinates, geometry)
    return np.asarray(carriage_movement(geometry, ends[:1], ends[1:])[0])


def approach_sign(moved: Moved, leg: str, geometry: Geometry) -> float:
    """Sign of the last movement of the tool along a leg, as commanded."""
    from_mm, to_mm = tool_of((moved.from_mm, moved.commanded_mm), moved.coordinates, geometry)
    way = float((to_mm - from_mm) @ geometry.directions[leg_number(leg)])
    return float(np.sign(way)) if abs(way) > STILL_MM else 0.0


STILL_MM = 1e-6
"""Less is rounding of the numbers in a record."""


def tool_of(
    place_mm: ArrayLike, coordinates: Literal["tool", "joint"], geometry: Geometry
) -> FloatArray:
    """Tool position ``(…, 3)`` from Zero, with the controller at a place in these coordinates."""
    place = np.asarray(place_mm, dtype=np.float64)
    return np.asarray(direct(geometry, place)) if coordinates == "joint" else place
