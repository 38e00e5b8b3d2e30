"""The joints of a LinuxCNC machine: which drive each of them moves, and what its carriage travels.

trivkins lists the axis of each joint behind ``coordinates=``; a gantry names one axis twice there.
Other kinematics have an order of their own, which only the machine file can state.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from app.report.offsets import Offsets
from calib.arrays import LEG_NAMES
from calib.errors import RecordError, UsageError
from calib.tripod.controller import (
    ControllerJoint,
    ControllerJoints,
    JointEntries,
    JointTravel,
    Switch,
    travel_of,
)

NOT_CHECKED = (
    "Not checked without an INI file (--ini): which joint moves which drive, travel, limits, and "
    "home switches. Compare the new HOME_OFFSET with MIN_LIMIT and MAX_LIMIT before the first move."
)

NOT_IN_INI = (
    "Limit switches and stops are not in the INI file. Move slowly to both ends of each joint "
    "after homing."
)


@dataclass(frozen=True)
class DriveJoint:
    """A joint and the drive that it moves, by their numbers; ``way`` -1 where it counts against it.

    ``now`` is what it holds, None where nobody stated it.
    """

    joint: int
    drive: int
    way: int
    now: ControllerJoint | None


def joints_of_drives(offsets: Offsets) -> tuple[DriveJoint, ...]:
    """The joints that move drives, in their order; two of a gantry move one drive.

    As the machine file says, else by the axes that the kinematics name, else in their order. Raises
    RecordError for an INI file that leaves a joint's drive open.
    """
    controller = offsets.controller
    names = _named(controller, offsets.machine.joints)
    return tuple(
        DriveJoint(
            number,
            LEG_NAMES.index(name[-1]),
            -1 if name[0] == "-" else 1,
            controller.joints[number] if controller else None,
        )
        for number, name in enumerate(names)
    )


def _named(
    controller: ControllerJoints | None, of_machine: tuple[str, str, str] | None
) -> tuple[str, ...]:
    """The drive of each joint, ``-x`` where it counts against it. Raises RecordError."""
    if controller is None or not controller.source:
        axes = controller.axes if controller else None
        return of_machine or tuple((axes or "").lower()) or LEG_NAMES
    axes, listed = controller.axes or "", controller.coordinates
    gantry = any(len(set(names)) < len(names) for names in (axes, listed))
    if of_machine and not gantry:
        return of_machine
    count, trivial = len(controller.joints), controller.kinematics == "trivkins"
    if axes and len(axes) > count:
        raise _unclear(controller, f"{count} joints", "a joint for each letter of coordinates=")
    if trivial and axes:
        if set(axes) != {"X", "Y", "Z"}:
            allowed = "coordinates= with the letters X, Y and Z alone, each at least once"
            raise _unclear(controller, f"{count} joints", allowed)
        if of_machine:
            raise _unclear(
                controller,
                f"joints of the machine file {', '.join(of_machine)}",
                "no joints in the machine file: it states three, and this machine has a gantry",
            )
        return tuple(axes.lower())
    usual = count == len(LEG_NAMES) and not (trivial and set(listed or "XYZ") != {"X", "Y", "Z"})
    if sorted(axes or "XYZ") == ["X", "Y", "Z"] and not gantry and (axes or usual):
        return tuple((axes or "XYZ").lower())
    raise _unclear(
        controller,
        f"{count} joints whose drives are not stated",
        "trivkins with coordinates= that lists the axis of each joint, or joints in the machine "
        "file",
    )


def _unclear(controller: ControllerJoints, joints: str, allowed: str) -> RecordError:
    kinematics = " ".join(
        (controller.kinematics, *([f"coordinates={controller.axes}"] if controller.axes else []))
    )
    entries = f"KINEMATICS = {kinematics or 'nothing'}"
    if controller.coordinates:
        entries += f", [TRAJ] COORDINATES = {controller.coordinates}"
    return RecordError(
        f"{controller.source}, [KINS] KINEMATICS",
        f"{entries} with {joints}",
        allowed,
        "An offset in the wrong joint moves the wrong carriage.",
    )


def joint_of_each_drive(joints: tuple[DriveJoint, ...], kinematics: str) -> list[DriveJoint]:
    """The joint of each drive x, y, z. Raises UsageError for a gantry."""
    single = []
    for drive, leg in enumerate(LEG_NAMES):
        joints_of_drive = [joint for joint in joints if joint.drive == drive]
        if len(joints_of_drive) > 1:
            numbers = " and ".join(str(joint.joint) for joint in joints_of_drive)
            raise UsageError(
                f"kinematics {kinematics}",
                f"joints {numbers} on drive {leg}",
                "one joint a drive",
                "Use --format linuxcnc.",
            )
        single += joints_of_drive
    return single


def travel(offsets: Offsets, drive_joint: DriveJoint, entries: JointEntries) -> Iterator[str]:
    """What the carriage of a joint travels, where its switch is: sentences for the include.

    Raises RecordError where the switch comes inside the limits by this change.
    """
    now = drive_joint.now
    if now is None or offsets.controller is None or not offsets.controller.source:
        yield NOT_CHECKED
        return
    course = travel_of(offsets.model, drive_joint.drive, now, entries, drive_joint.way)
    name = f"Joint {drive_joint.joint} ({LEG_NAMES[drive_joint.drive]})"
    missing = [
        f"no {key}"
        for key, limit in (("MIN_LIMIT", now.min_limit_mm), ("MAX_LIMIT", now.max_limit_mm))
        if limit is None
    ]
    if course.now_mm and course.after_mm:
        yield (
            f"{name} travels from {_range(course.now_mm)} mm now, {_range(course.after_mm)} mm "
            "after the change, both in its coordinate after the change."
        )
    else:
        yield f"{name}: travel not checked: the INI file states {', '.join(missing)}."
    yield from _of_switch(offsets.controller, drive_joint, now, course)
    yield NOT_IN_INI


def _range(limits_mm: tuple[float, float]) -> str:
    low, high = limits_mm
    return f"{low:z.3f} to {high:z.3f}"


def _of_switch(
    controller: ControllerJoints, drive_joint: DriveJoint, now: ControllerJoint, course: JointTravel
) -> Iterator[str]:
    switch, name = course.switch, f"Joint {drive_joint.joint} ({LEG_NAMES[drive_joint.drive]})"
    if switch is None:
        why = "absolute encoder" if now.absolute_encoder else "HOME_SEARCH_VEL is 0 or not stated"
        yield f"{name} has no home switch: {why}."
        return
    if now.indexed:
        yield (
            f"{name}: the home switch was not checked: HOME_OFFSET is the place of the index "
            "(HOME_USE_INDEX), and the switch is up to one turn away from it."
        )
        return
    key, beyond = ("MAX_LIMIT", "above") if switch.side > 0 else ("MIN_LIMIT", "below")
    beyond_now_mm, beyond_after_mm = switch.beyond_now_mm, switch.beyond_after_mm
    if beyond_now_mm is None or beyond_after_mm is None:
        yield f"{name}: the home switch was not checked: the INI file states no {key}."
        return
    if switch.newly_inside:
        raise _reached(controller, drive_joint.joint, switch)
    at = f"{name}: after the change the home switch is at {switch.at_mm:z.3f} mm"
    if beyond_now_mm >= 0.0 and beyond_after_mm >= 0.0:
        yield (
            f"{at}, {beyond} {key} by {beyond_now_mm:.3f} mm now, "
            f"by {beyond_after_mm:.3f} mm after the change."
        )
    elif beyond_now_mm < 0.0 and beyond_after_mm < 0.0:
        yield (
            f"{at}. WARNING: it is inside the limits now and after the change: short of {key} "
            f"by {-beyond_now_mm:.3f} mm now, by {-beyond_after_mm:.3f} mm after the change."
        )
    else:
        yield (
            f"{at}. It was short of {key} by {-beyond_now_mm:.3f} mm, inside the limits; after the "
            f"change it is {beyond} {key} by {beyond_after_mm:.3f} mm."
        )
    if course.home_beyond_mm:
        yield (
            f"WARNING: homing ends at HOME = {now.home_mm:g} mm, which is "
            f"{course.home_beyond_mm:.3f} mm beyond the home switch with this HOME_OFFSET. "
            "Change HOME of this joint."
        )


def _reached(controller: ControllerJoints, joint: int, switch: Switch) -> RecordError:
    """The limit by which a switch comes inside, in the unit of the INI file."""
    unit, inside_mm = controller.mm_per_unit, -(switch.beyond_after_mm or 0.0)
    key, word = ("MAX_LIMIT", "at most") if switch.side > 0 else ("MIN_LIMIT", "at least")
    limit_mm = switch.at_mm + switch.side * inside_mm
    return RecordError(
        f"{controller.source}, [JOINT_{joint}] {key}",
        f"{limit_mm / unit:.6f}: with the new HOME_OFFSET the home switch is {inside_mm:.4f} mm "
        "inside the limits, where it was not before",
        f"{word} {switch.at_mm / unit:.6f}, where the switch then is",
        f"Change {key} of this joint in the INI file, and export again.",
    )
