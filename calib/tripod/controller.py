"""What a controller would have to be told: carriage errors, kinematics, and what neither holds.

q is the joint coordinate that the controller believes, e(q) = true - believed place of the
carriage. The stages of the pipeline alone tell what an effect does: those of the actuator go into
entries of a joint, those of foot and tool into the kinematics, the others harm no tool.

LinuxCNC keeps MIN_LIMIT and MAX_LIMIT as coordinates of the joint. Homing gives the switch the
coordinate HOME_OFFSET. A changed HOME_OFFSET therefore moves the limits along the machine, and the
switch stays where it is (`travel_of`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from functools import lru_cache, partial
from typing import TypeGuard

import numpy as np

from calib.arrays import LEG_NAMES, FloatArray, without
from calib.errors import ImpossibleRequest
from calib.tripod.effects.bars import GravitySag, LegLength
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.geometry import Geometry, inverse
from calib.tripod.pipeline import Model, Stage, StageEffect
from calib.tripod.workspace import machine_at, workspace_points

MOST_POINTS = 256
"""Lines of a compensation table that LinuxCNC reads."""

INTERPOLATION_MM = 1e-3
"""By so much the straight lines between points of a table may depart from the error."""

LEFT_BY_TABLE = 0.1
"""Of the largest error: so much they may leave where `MOST_POINTS` do not follow it more closely. A
table that takes out nine tenths of a short screw's wave is better than none."""

NOTHING_MM = 1e-6
"""A smaller error of a carriage or foot is none."""

PLAY_ALONE_MM = 2e-4
"""A table whose columns differ by play alone, within this, is an entry for backlash."""

JUDGED_POINTS = 4001
"""Places between the joint limits where a table is compared with what it stands for."""

PASSES = 20
"""Of q_old = q_new - e(q_old): each leaves a hundredth of the step before it, or less."""

SETTLED_MM = 1e-9
"""A pass that changes less is the last."""


@dataclass(frozen=True)
class ControllerJoint:
    """What the controller holds for one joint, in mm.

    ``latch_sign`` is the sign of the movement onto the home switch, 0 where homing moves nothing,
    None where nobody said; with an absolute encoder there is no switch. ``compensated``: a
    COMP_FILE is read already. Limits are None where they are not stated; ``home_mm`` is where
    homing ends. ``search_sign`` is the sign of the search for the switch, 0 where there is none,
    None where nobody said; with ``indexed`` the offset is the place of an encoder's index.
    """

    home_offset_mm: float
    latch_sign: int | None = None
    absolute_encoder: bool = False
    backlash_mm: float = 0.0
    compensated: bool = False
    min_limit_mm: float | None = None
    max_limit_mm: float | None = None
    home_mm: float = 0.0
    search_sign: int | None = None
    indexed: bool = False

    def turned(self) -> ControllerJoint:
        """What homing meets, as the joint's drive counts, where it counts the other way."""
        latch = None if self.latch_sign is None else -self.latch_sign
        return replace(self, home_offset_mm=-self.home_offset_mm, latch_sign=latch)


@dataclass(frozen=True)
class ControllerJoints:
    """Joints, the controller's unit, and the axis of each joint (``"XYZ"``) where that is told.

    ``entered`` is when the last record began whose offsets the joints hold, as far as the
    controller's files tell. ``source`` names the file that all this was read from, empty where a
    person stated it; ``kinematics`` is its module, ``coordinates`` the axes that it lists.
    """

    joints: tuple[ControllerJoint, ...]
    mm_per_unit: float = 1.0
    axes: str | None = None
    entered: datetime | None = None
    source: str = ""
    kinematics: str = ""
    coordinates: str = ""

    @classmethod
    def homed_at(
        cls, home_offset_mm: Sequence[float], joints: Sequence[str] | None = None
    ) -> ControllerJoints:
        """One of which nothing else is known: by the drives x, y, z that its ``joints`` move."""
        drives = [name[-1] for name in joints or LEG_NAMES]
        homed = (ControllerJoint(home_offset_mm[LEG_NAMES.index(name)]) for name in drives)
        return cls(tuple(homed), axes="".join(drives).upper())


@dataclass(frozen=True, eq=False)
class Table:
    """Compensation of one joint: believed coordinates ``(n,)`` rising, e upwards and downwards."""

    joint_mm: FloatArray
    error_up_mm: FloatArray
    error_down_mm: FloatArray

    def left_mm(self, joint_mm: FloatArray, errors_mm: Sequence[FloatArray]) -> list[FloatArray]:
        """What it leaves of errors up and down at these coordinates ``(m,)`` each."""
        pairs = zip(errors_mm, (self.error_up_mm, self.error_down_mm), strict=True)
        return [error - np.interp(joint_mm, self.joint_mm, at) for error, at in pairs]

    def absorbed_mm(self, believed_mm: float, way: int) -> float:
        """What homing absorbs at a switch where ``believed_mm`` would be right without the table.

        Beyond its ends the controller holds the table's end, whatever acts there.
        """
        error_mm = self.error_up_mm if way > 0 else self.error_down_mm

        settled_mm = _settled(
            lambda former_mm: np.interp(believed_mm + former_mm, self.joint_mm, error_mm),
            np.zeros(1),
        )
        return float(settled_mm[0])

    def turned(self) -> Table:
        """The table for a coordinate that counts the other way."""
        return Table(-self.joint_mm[::-1], -self.error_down_mm[::-1], -self.error_up_mm[::-1])


@dataclass(frozen=True)
class JointEntries:
    """Entries of one joint, mm; ``home_change_mm`` is what the place of its switch grows by."""

    home_change_mm: float
    backlash_mm: float = 0.0
    table: Table | None = None

    def turned(self) -> JointEntries:
        """The entries of a joint that counts the other way; play stays as it is."""
        table = self.table.turned() if self.table else None
        return replace(self, home_change_mm=-self.home_change_mm, table=table)


FAR_SWITCH = 0.25
"""Of the travel: a switch so far beyond it is not where readings tell what acts along a drive."""


@dataclass(frozen=True, eq=False)
class Kinematics:
    """Feet as polynomials of true carriage coordinates: origin + direction c + bend (c - zero)².

    Arrays ``(3 drives, 3)``; ``length_mm``, ``sag_mm`` (shortening under the weight) and
    ``zero_mm`` ``(3,)``. ``misfit_mm`` is the largest departure from the model's feet.
    """

    origin_mm: FloatArray
    direction: FloatArray
    bend_per_mm: FloatArray
    zero_mm: FloatArray
    length_mm: FloatArray
    sag_mm: FloatArray
    misfit_mm: float


def carriage_error_mm(model: Model, joint_mm: FloatArray, way: float) -> FloatArray:
    """e(q) of each joint ``(n, 3)`` at believed coordinates ``(n, 3)``, reached upwards (1) or not.

    ``way`` -1 is downwards. Includes d_rho.
    """
    return np.asarray(machine_at(model, joint_mm, way).carriage_mm - joint_mm)


@lru_cache(maxsize=12)
def table_of(model: Model, joint: int) -> Table | None:
    """The fewest evenly spaced points that follow what the effects add to d_rho within 1 µm.

    Where `MOST_POINTS` do not, these, if they leave less than `LEFT_BY_TABLE`. Coordinates are
    those that the controller believes once d_rho is entered. None where no effect moves this
    carriage. Raises ImpossibleRequest where a table leaves more.
    """
    fine = _judged_mm(model.geometry)[:, joint]
    errors = [error[:, joint] for error in _added_mm(model)]
    thing, allowed = f"compensation table of joint {LEG_NAMES[joint]}", "one that changes less"
    largest_mm = float(np.abs(errors).max())
    if not np.isfinite(largest_mm):
        raise ImpossibleRequest(thing, "an error without end over the travel", allowed)
    if largest_mm < NOTHING_MM:
        return None
    for count in range(2, MOST_POINTS + 1):
        points = np.linspace(fine[0], fine[-1], count)
        table = Table(points, *(np.interp(points, fine, error) for error in errors))
        left_mm = max(np.abs(residuals_mm).max() for residuals_mm in table.left_mm(fine, errors))
        if left_mm < INTERPOLATION_MM:
            return table
    if left_mm < LEFT_BY_TABLE * largest_mm:
        return table
    left_words = f"leave {1e3 * left_mm:.3g} of {1e3 * largest_mm:.3g} µm"
    raise ImpossibleRequest(
        thing, f"an error of which {MOST_POINTS} points {left_words}", f"{allowed} over the travel"
    )


def left_by_tables_mm(model: Model) -> float:
    """What straight lines between the points of all joints' tables leave, r.m.s.

    Raises ImpossibleRequest as `table_of`.
    """
    squares = []
    for joint, fine in enumerate(_judged_mm(model.geometry).T):
        if table := table_of(model, joint):
            errors = [error[:, joint] for error in _added_mm(model)]
            squares.append((np.array(table.left_mm(fine, errors)) ** 2).mean())
    return float(np.sqrt(sum(squares)))


def joint_entries(model: Model, drive: int, joint: ControllerJoint, way: int = 1) -> JointEntries:
    """Entries of a drive's joint that now holds this; with ``way`` -1 it counts against the drive.

    Raises ImpossibleRequest for what a joint cannot take.
    """
    if way < 0:
        return joint_entries(model, drive, joint.turned()).turned()
    offset = model.parameters_mm[drive]
    table = table_of(model, drive)
    if table is None:
        return JointEntries(offset)
    if joint.compensated:
        raise ImpossibleRequest(
            f"compensation table of joint {LEG_NAMES[drive]}",
            "another one in the INI file, with which the machine was measured",
            "a joint without COMP_FILE",
            "Take the old table out of the INI file, measure again, and export then.",
        )
    least = float((table.error_down_mm - table.error_up_mm).min())
    if least < -NOTHING_MM:
        raise ImpossibleRequest(
            f"play of joint {LEG_NAMES[drive]}",
            f"{least:+.4f} mm",
            "play that is not negative",
            "It is not play: remove the effect with glidecal model --remove.",
        )
    largest = float(max(abs(table.error_up_mm).max(), abs(table.error_down_mm).max()))
    travel_mm = model.geometry.travel_max_mm - model.geometry.travel_min_mm
    if not largest < travel_mm:
        raise ImpossibleRequest(
            f"error of joint {LEG_NAMES[drive]} along its drive",
            f"{largest:.4g} mm",
            f"less than its travel, {travel_mm:g} mm",
            "Look at the values in the model: glidecal model.",
        )
    change = offset
    if not joint.absolute_encoder:  # an encoder meets nothing
        change += table.absorbed_mm(joint.home_offset_mm + offset, joint.latch_sign or 1)
    play = float(table.error_down_mm.mean())
    if max(abs(table.error_up_mm).max(), abs(table.error_down_mm - play).max()) < PLAY_ALONE_MM:
        return JointEntries(change, joint.backlash_mm + play)
    if not joint.absolute_encoder:
        _refuse_far_switch(model, drive, joint)
    half = joint.backlash_mm / 2.0  # the controller adds it upwards and takes it off downwards
    with_play = Table(table.joint_mm, table.error_up_mm - half, table.error_down_mm + half)
    return JointEntries(change, table=with_play)


def _refuse_far_switch(model: Model, drive: int, joint: ControllerJoint) -> None:
    """What acts along a drive was measured over its travel: it is no law for a place far away."""
    geometry, zero_mm = model.geometry, float(model.geometry.zero_mm[drive])
    low, high = zero_mm + geometry.travel_min_mm, zero_mm + geometry.travel_max_mm
    beyond_mm = FAR_SWITCH * (high - low)
    if not low - beyond_mm <= joint.home_offset_mm <= high + beyond_mm:
        raise ImpossibleRequest(
            f"HOME_OFFSET of the joint of drive {LEG_NAMES[drive]}, the place of its switch",
            f"{joint.home_offset_mm:g} mm",
            f"at most {beyond_mm:g} mm beyond the travel in the machine file, which is "
            f"{low:g} to {high:g} mm in coordinates of this joint",
            "Effects along the drives are known there alone. Does the joint count from another "
            "zero than the machine file? --format csv has the joint offsets alone.",
        )


def kinematics_of(model: Model) -> Kinematics:
    """Drives and bars of the model for an own kinematics module, joints already corrected."""
    geometry = model.geometry
    travel = np.linspace(geometry.travel_min_mm, geometry.travel_max_mm, 33)
    flow = machine_at(model, geometry.zero_mm + travel[:, None] * np.ones(3), 1.0)
    slopes, misfit = np.empty((3, 3, 3)), 0.0
    for k, zero in enumerate(geometry.zero_mm):
        place = flow.carriage_mm[:, k] - zero
        powers = np.stack([np.ones_like(place), place, place**2], axis=1)
        slopes[k] = np.linalg.lstsq(powers, flow.foot_mm[:, k], rcond=None)[0]
        misfit = max(misfit, float(np.abs(powers @ slopes[k] - flow.foot_mm[:, k]).max()))
    direction = np.where(np.abs(slopes[:, 1]) < 1e-15, 0.0, slopes[:, 1])
    return Kinematics(
        origin_mm=slopes[:, 0] - direction * geometry.zero_mm[:, None],
        direction=direction,
        bend_per_mm=np.where(np.abs(slopes[:, 2]) < 1e-15, 0.0, slopes[:, 2]),
        zero_mm=geometry.zero_mm,
        length_mm=geometry.lengths + np.array(model.parameters_mm[3:]) + _sum_mm(model, LegLength),
        sag_mm=geometry.load * _sum_mm(model, GravitySag),
        misfit_mm=misfit,
    )


def not_told(model: Model, *, kinematics: bool) -> Model:
    """What the controller does not know with these entries of joints, and with own kinematics.

    Joints take d_rho and what acts along the drives, kinematics the rest of the drives, the weight
    on the bars and d_L.
    """

    def left(effect: StageEffect) -> bool:
        if effect.stage == Stage.TOOL:
            return not (kinematics and _of_bar(effect, GravitySag, LegLength))
        return effect.stage == Stage.FOOT and not kinematics

    lengths = np.zeros(3) if kinematics else model.parameters_mm[3:]
    unknown = model.with_parameters(np.concatenate([np.zeros(3), lengths]))
    return unknown.with_effects(tuple(filter(left, model.effects)))


def tool_error_mm(
    model: Model, commanded: Callable[[FloatArray], FloatArray] | None = None
) -> float:
    """R.m.s. error of the tool over the workspace, the worse way round. Raises UnreachablePosture.

    Less what it is at Zero, where that is set by hand. ``commanded`` gives joint coordinates
    ``(n, 3)`` for tool positions ``(n, 3)``; None: the nominal inverse kinematics.
    """
    commanded = commanded or (lambda tool_mm: inverse(model.geometry, tool_mm))
    points = workspace_points(model.geometry)
    joints, zero = commanded(points), commanded(np.zeros((1, 3)))
    worst = 0.0
    for way in (1.0, -1.0):
        off = machine_at(model, joints, way).tool_mm - points
        if model.geometry.set_at_zero:
            off = off - machine_at(model, zero, way).tool_mm
        worst = max(worst, float(np.sqrt((off**2).sum(axis=-1).mean())))
    return worst


def tool_error_free_of_mm(
    model: Model, free: int, commanded: Callable[[FloatArray], FloatArray] | None = None
) -> float:
    """R.m.s. error of the tool over the workspace, both ways round, less the best rigid motion.

    ``free`` is how many shifts and small turns of the machine a frame takes up: none, the shifts
    (3), or all (6). ``commanded`` as in `tool_error_mm`. Raises UnreachablePosture.
    """
    commanded = commanded or (lambda tool_mm: inverse(model.geometry, tool_mm))
    points = workspace_points(model.geometry)
    ways = [machine_at(model, commanded(points), way).tool_mm - points for way in (1.0, -1.0)]
    off = np.concatenate(ways)
    shifts = np.broadcast_to(np.eye(3)[:, None], (3, *off.shape))
    turns = np.cross(np.eye(3)[:, None], np.tile(points, (2, 1)))
    rigid = np.concatenate([shifts, turns]).reshape(6, -1).T[:, :free]
    remainder = without(np.linalg.qr(rigid)[0], off.ravel())
    return float(np.sqrt(3.0 * np.mean(remainder**2)))


def commanded_with(
    geometry: Geometry, parameters_mm: Sequence[float]
) -> Callable[[FloatArray], FloatArray]:
    """Joint coordinates ``(n, 3)`` for tool positions ``(n, 3)`` once d_rho and d_L are entered.

    ``parameters_mm`` ``(6,)``. The square root of `inverse` with the lengths corrected, less d_rho.
    """
    offset_mm, error_mm = np.split(np.asarray(parameters_mm, dtype=np.float64), 2)
    lengths = geometry.lengths

    def commanded(tool_mm: FloatArray) -> FloatArray:
        across = lengths**2 - geometry.reach_mm2(tool_mm)
        ahead = np.sqrt((lengths + error_mm) ** 2 - across) - np.sqrt(lengths**2 - across)
        return np.asarray(inverse(geometry, tool_mm) + ahead - offset_mm)

    return commanded


def _judged_mm(geometry: Geometry) -> FloatArray:
    """Coordinates ``(JUDGED_POINTS, 3)`` of each joint over its travel."""
    travel = np.linspace(geometry.travel_min_mm, geometry.travel_max_mm, JUDGED_POINTS)
    return np.asarray(geometry.zero_mm + travel[:, None])


@lru_cache(maxsize=4)
@np.errstate(over="ignore", invalid="ignore")  # a law that runs away: no table follows it
def _added_mm(model: Model) -> tuple[FloatArray, FloatArray]:
    """What effects add to d_rho ``(JUDGED_POINTS, 3)``, reached upwards and downwards.

    Where the corrected controller believes the places of `_judged_mm`.
    """
    position_mm, offset = _judged_mm(model.geometry), np.array(model.parameters_mm[:3])

    def added_mm(former_mm: FloatArray, way: float) -> FloatArray:
        believed_mm = position_mm - offset - former_mm
        return np.asarray(carriage_error_mm(model, believed_mm, way) - offset)

    nothing_mm = np.zeros_like(position_mm)
    up, down = (_settled(partial(added_mm, way=way), nothing_mm) for way in (1.0, -1.0))
    return up, down


def _settled(step: Callable[[FloatArray], FloatArray], value_mm: FloatArray) -> FloatArray:
    """The value that a step leaves as it is, from a first one."""
    for _ in range(PASSES):
        former_mm, value_mm = value_mm, step(value_mm)
        if np.abs(value_mm - former_mm).max() < SETTLED_MM:
            break
    return value_mm


def _sum_mm(model: Model, kind: type) -> FloatArray:
    """The values of an effect of each bar ``(3,)``."""
    total_mm = np.zeros(3)
    for effect in model.effects:
        if _of_bar(effect, kind):
            total_mm[LEG_NAMES.index(effect.place)] += float(np.real(effect.values[0]))
    return total_mm


def _of_bar(effect: StageEffect, *kinds: type) -> TypeGuard[EffectInstance]:
    return isinstance(effect, EffectInstance) and isinstance(effect.effect, kinds)


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
    """The travel of a drive's joint with these entries; with ``way`` -1 it counts against it.

    In the coordinate that the joint has after the change: a limit q was at q + e(q) until then.
    """

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
    switch = Switch(at_mm, search, None, None)
    limits = {-1: joint.min_limit_mm, 1: joint.max_limit_mm}
    if limits[search] is not None:
        sides = [(side, limit) for side, limit in limits.items() if limit is not None]
        side, limit = min(sides, key=lambda place: abs(at_mm - place[1]))
        switch = Switch(at_mm, side, side * (joint.home_offset_mm - limit), side * (at_mm - limit))
    return JointTravel(limits_now, limits_after, switch, beyond_mm)
