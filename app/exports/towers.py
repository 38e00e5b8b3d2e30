"""Values for controllers of upright towers: Klipper, LinuxCNC's lineardeltakins, TwinCAT's P_3Z.

A switch trips at the height of the tool over the middle; the carriage is then higher by
sqrt(length^2 - radius^2). What stands above the values of all such controllers is here, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from app.evaluating.correction import CLEARLY_BETTER
from app.evaluating.printer import FIRMWARE_TOWERS, drives_of_towers
from app.exports.linuxcnc import for_joints, joint_files, known_lines, origin, short_lines
from app.exports.linuxcnc_joints import joint_of_each_drive, joints_of_drives
from app.report.offsets import LEAST_MM, Export, Offsets, bound_of_files, for_controller, with_bound
from app.report.text.correction import FRAME_WORDS, doubt_lines, left_out_lines
from app.report.text.printer import NOT_WORTH_IT
from calib.arrays import LEG_NAMES, FloatArray
from calib.errors import UsageError
from calib.printable import one_line
from calib.tripod.effects.drives import ActuatorScale
from calib.tripod.pipeline import Stage, StageEffect
from calib.tripod.towers import (
    ALL_ALIKE,
    ON_ONE_CIRCLE,
    RAILS,
    EnteredTowers,
    TowerEntries,
    each_alone,
    entered,
    tower_model,
)
from protocols.data_table import csv_text


def endstops_now_mm(offsets: Offsets) -> list[float]:
    """Heights of the tool at which the switches of drives x, y, z trip now, mm.

    Raises UsageError where nobody stated them.
    """
    controller = offsets.controller
    if controller is None:
        raise UsageError(
            "present heights of the switches",
            "none stated",
            "position_endstop_mm in the machine file, or --endstops X,Y,Z: Klipper's "
            "position_endstop; H plus M666 of RepRapFirmware; H less M666 of Marlin; Z less M666 "
            "of Smoothieware",
        )
    joints = [name.lower() for name in controller.axes or "XYZ"]
    home = [controller.joints[joints.index(name)].home_offset_mm for name in LEG_NAMES]
    zero = offsets.machine.geometry().zero_mm.tolist()
    return [at - below for at, below in zip(home, zero, strict=True)]


STEPS = (
    "the travel of each tower is not changed, since the machine file does not state the "
    "present value of the firmware: rotation_distance_mm (Klipper) or steps_per_mm, as import "
    "writes them, or --steps X,Y,Z"
)


def fitted(
    offsets: Offsets, entries: TowerEntries, steps_now: Sequence[float] | None = None
) -> tuple[Offsets, EnteredTowers]:
    """Values of a controller that has these entries, with the bound of what they hold.

    ``steps_now`` is what it holds for the travel of each tower; None: that stays as it is. Raises
    UsageError where it has one length and holds unequal ones now.
    """
    kinematics, result = for_controller(offsets, "kinematics"), offsets.result
    if entries.travels and steps_now is None:
        entries = replace(entries, travels=False)
        if any(effect.id == ActuatorScale.id for effect in kinematics.model.effects):
            offsets = replace(offsets, cautions=(*offsets.cautions, STEPS))
            kinematics = replace(kinematics, cautions=(*kinematics.cautions, STEPS))
    if result is None or offsets.view:
        values = entered(kinematics.model, entries)
    else:
        best = result.corrections.of_towers(entries)
        values, change, frame = best.values, result.printer_change, result.frame
        share = best.off.bound_in(frame) / result.corrections.off_now.bound_in(frame)
        helps = change.helps if change else share < CLEARLY_BETTER
        remarks = [
            kinematics.bound,
            *left_out_lines(best.left_out),
            *doubt_lines(result),
            *([] if helps else [NOT_WORTH_IT]),
        ]
        cautions = (*map(one_line, remarks), *offsets.cautions)
        kinematics = replace(kinematics, model=best.model, cautions=cautions)
    _check_lengths(values)
    return _bounded(kinematics, values), values


def _check_lengths(values: EnteredTowers) -> None:
    if (
        not values.entries.lengths
        and max(values.now.length_mm) - min(values.now.length_mm) > LEAST_MM
    ):
        raise UsageError("lengths of the bars held now", "unequal ones", "one length for all bars")


def _bounded(offsets: Offsets, values: EnteredTowers, along: Sequence[StageEffect] = ()) -> Offsets:
    """The bound with these values, and those of the joints for effects ``along`` the drives.

    That of a model file is gone where they leave a part of it.
    """
    if offsets.result is not None:
        off = offsets.result.corrections.off_with_towers(values, along)
        return with_bound(offsets, bound_of_files(offsets.result, off))
    return with_bound(offsets, offsets.bound if values.after_mm < LEAST_MM else "")


TOUCH = "BEFORE THE FIRST MOVE: home, then touch the plate again"


def comments(
    offsets: Offsets, values: EnteredTowers, instruction: str, controller_words: str
) -> list[str]:
    """What stands above the values: where they go, what they are for, what they leave, cautions.

    First that the plate is to be touched again, and what becomes of the height of the tool there.
    """
    now = values.now
    x, y, z = values.moved_mm.tolist()
    each_radius = values.entries.radii
    radius = f"radius {_three(now.radius_mm if each_radius else now.radius_mm[:1])} mm"
    height_words = "these values keep the present height of the tool in the middle of the plate"
    # a change of the tool's height from which a file states it, with two decimals
    if abs(z) >= 0.005:
        way = "higher" if z > 0.0 else "lower"
        height_words = f"with these values the tool at Zero is about {abs(z):.2f} mm {way} than now"
    lines = [
        f"{TOUCH}; {height_words}",
        origin(offsets),
        instruction,
        f"made for a controller with {radius}, lengths of the bars "
        f"{_three(now.length_mm)} mm, towers at {_three(now.angle_deg)}°{controller_words}; if it "
        "has others, these values are wrong",
        f"tool error over the workspace, {FRAME_WORDS['machine']}, if the model is right: "
        f"{values.before_mm:.4f} mm r.m.s. now, {values.after_mm:.4f} mm with these values",
    ]
    if max(abs(x), abs(y), abs(z)) >= LEAST_MM:
        lines.append(
            f"sent to Zero the tool is then ({x:+z.4f}, {y:+z.4f}, {z:+z.4f}) mm from its "
            "present place there: errors are relative to the new one"
        )
    alone = dict(each_alone(offsets.model, values.entries))
    if exact_entries := [name for name, left_mm in alone.items() if left_mm < LEAST_MM]:
        lines.append(f"wholly in these values: {', '.join(exact_entries)}")
    if short := {name: mm for name, mm in alone.items() if mm >= LEAST_MM}:
        shortfalls = ", ".join(f"{name} leaves {mm:.4f} mm" for name, mm in short.items())
        lines.append(
            f"not wholly: the firmware has no value for all of {', '.join(short)}. Alone "
            f"{shortfalls}, together {values.after_mm:.4f} mm r.m.s. at the tool, "
            f"{FRAME_WORDS['machine']}"
        )
    for name, offset in offsets.parameters.items():
        lines += known_lines(name, offset, lacks_fit=offsets.lacks_fit)
    return [line for text in (*lines, *offsets.cautions) for line in short_lines(text)]


def _three(values: FloatArray) -> str:
    return ", ".join(f"{value:.3f}" for value in values.tolist())


def printer_cfg(offsets: Offsets) -> Export:
    """Klipper: a file to include at the end of ``printer.cfg``.

    Of a key that is there twice the last counts (klippy/kinematics). Raises as `drives_of_towers`,
    `endstops_now_mm` and `fitted`.
    """
    drives, now = drives_of_towers(offsets.machine), endstops_now_mm(offsets)
    turns = offsets.machine.rotation_distance_mm
    offsets, values = fitted(offsets, ON_ONE_CIRCLE, turns)
    stops, towers = values.endstops_mm(now), values.towers
    entered_turns = values.turns_mm(turns) if turns and values.stretch.any() else None
    steppers = [
        f", stepper_{name} (tower {LEG_NAMES[drive]}) position_endstop {now[drive]:.6f} mm"
        + (f", rotation_distance {turns[drive]:.6f} mm" if turns and entered_turns else "")
        for name, drive in zip(FIRMWARE_TOWERS, drives, strict=True)
    ]
    instruction = (
        "put '[include FILE]' with the name of this file at the end of printer.cfg, where it "
        "replaces the lines above and saved values; then home. Later saved calibrations are "
        "refused while it is included"
    )
    comment_lines = comments(offsets, values, instruction, "".join(steppers))
    lines = [f"# {line}" for line in comment_lines]
    lines += ["[printer]", f"delta_radius: {float(towers.radius_mm[0]):.6f}"]
    for name, drive in zip(FIRMWARE_TOWERS, drives, strict=True):
        lines += [
            f"[stepper_{name}]",
            f"position_endstop: {stops[drive]:.6f}",
            f"arm_length: {towers.length_mm[drive]:.6f}",
            f"angle: {towers.angle_deg[drive]:.6f}",
        ]
        if entered_turns:
            lines.append(f"rotation_distance: {entered_turns[drive]:.6f}")
    return Export({"": "\n".join(lines) + "\n"}, offsets.cautions)


P_3Z_PUT = (
    "enter the values in the kinematic group of type P_3Z, whose axes 1, 2, 3 move these rails. "
    "The displacement of the tool is in the places of the rails already, so that it is 0: only "
    "their difference acts. Add each change to the position that homing gives the axis (or to the "
    "offset of its encoder), then home. The axes must count upwards as the height of the joint on "
    "the carriage: with the tool over the middle, axis less z must then be the root of arm length² "
    "- x² - y² of its rail; read one back before you move"
)


def p_3z(offsets: Offsets) -> Export:
    """TwinCAT's kinematics P_3Z (3D-Tripod Type 1): a table of values to enter by hand.

    It has one arm length, x and y of each rail, and the displacement of the tool. Raises UsageError
    where a joint counts downwards, and as `fitted`.
    """
    names = offsets.machine.joints or tuple(LEG_NAMES)
    if any("-" in name for name in names):
        raise UsageError(
            f"joints of machine '{offsets.machine.name}'", ", ".join(names), "joints that count up"
        )
    offsets, values = fitted(offsets, RAILS)
    now, towers = values.now, values.towers
    rows: list[Sequence[str]] = [("parameter", "now", "value", "unit")]

    def add(name: str, present_mm: float, corrected_mm: float) -> None:
        rows.append((name, f"{present_mm:z.6f}", f"{corrected_mm:z.6f}", "mm"))

    add("Arm length", float(now.length_mm[0]), float(towers.length_mm[0]))
    drives = [LEG_NAMES.index(name) for name in names]
    for axis, drive in enumerate(drives, start=1):
        for across, part in zip("XY", (0, 1), strict=True):
            present_mm, corrected_mm = now.feet_mm[drive, part], towers.feet_mm[drive, part]
            add(f"Rail {axis} {across}-position", float(present_mm), float(corrected_mm))
    add("TCP displacement", 0.0, 0.0)
    for axis, drive in enumerate(drives, start=1):
        change = float(values.change_mm[drive])
        rows.append((f"axis {axis} position at homing, change", "", f"{change:+z.6f}", "mm"))
    lines = comments(offsets, values, P_3Z_PUT, "")
    return Export({"": csv_text(rows, lines)}, offsets.cautions)


ANGLES_DEG = (90.0, 210.0, 330.0)
EXACT_DEG = 0.01
"""The kinematics have no angles of their own; numbers of a machine file are rounded."""


def joints_and_pins(offsets: Offsets) -> Export:
    """LinuxCNC with ``lineardeltakins``: includes and tables of the joints, ``calib.hal``.

    Its two pins hold one length and one radius. Joints 0, 1, 2 are the towers at 90, 210 and 330°,
    each coordinate the height of its carriage (lineardeltakins-common.h). Play, scale and screws
    stay with the joints, as in `linuxcnc`.

    Raises UsageError for bars that are held unequal now, heights of joints of another zero, or a
    HOME_OFFSET that nobody stated (a change of L or R without it would move the tool), and as
    `joint_files`.
    """
    drives = drives_of_towers(offsets.machine, ANGLES_DEG, EXACT_DEG)
    meeting_mm = offsets.machine.geometry().meeting_mm.tolist()
    if max(map(abs, meeting_mm)) > LEAST_MM:
        raise UsageError(
            "heights of the joints in the machine file, origin_mm less platform_mm",
            ", ".join(f"{-mm:g}" for mm in meeting_mm) + " mm",
            "0 mm: the coordinates of lineardeltakins are heights of the carriages over Zero",
        )
    controller = offsets.controller
    if controller is None:
        raise UsageError(
            "present HOME_OFFSET",
            "none stated",
            "--ini, --home-offset, or home_offset_mm in the machine file",
        )
    if sorted(controller.axes or "XYZ") != ["X", "Y", "Z"]:
        joint_of_each_drive(joints_of_drives(offsets), "lineardeltakins")
    of_joints = [LEG_NAMES[drive] for drive in drives]
    if controller.axes:  # by drives, else in the order of the joints already
        axes = [name.lower() for name in controller.axes]
        controller = replace(
            controller,
            joints=tuple(controller.joints[axes.index(name)] for name in of_joints),
            axes=None,
        )
    machine = offsets.machine.model_copy(update={"joints": tuple(of_joints)})
    offsets = for_joints(replace(offsets, machine=machine, controller=controller), "kinematics")
    along = tuple(effect for effect in offsets.model.effects if effect.stage == Stage.ACTUATOR)
    across = tuple(effect for effect in offsets.model.effects if effect.stage != Stage.ACTUATOR)
    values = entered(offsets.model.with_effects(across), ALL_ALIKE)
    _check_lengths(values)
    offsets = _bounded(offsets, values, along)
    joint_offsets = replace(offsets, model=tower_model(offsets.model, values.change_mm, along))
    unit = controller.mm_per_unit
    instruction = (
        "name this file as HALFILE after the one that loads lineardeltakins, and put the includes "
        "of the joints under their headings: neither is right without the other. Then home"
    )
    homes = ", ".join(f"{joint.home_offset_mm:.6f}" for joint in controller.joints[:3])
    comment_lines = comments(
        replace(offsets, model=offsets.model.with_effects(across)),
        values,
        instruction,
        f", HOME_OFFSET {homes} mm of joints 0, 1, 2",
    )
    pins = [
        f"setp lineardeltakins.L {float(values.towers.length_mm[0]) / unit:.6f}",
        f"setp lineardeltakins.R {float(values.towers.radius_mm[0]) / unit:.6f}",
    ]
    hal = "\n".join([*(f"# {line}" for line in comment_lines), *pins]) + "\n"
    joints_written = joint_files(joint_offsets, kinematics=False)
    return Export({**joints_written.files, "calib.hal": hal}, joints_written.cautions)
