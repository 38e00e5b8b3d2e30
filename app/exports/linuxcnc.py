"""Files for LinuxCNC: an include for each joint, its table where it has one, own kinematics.

``HOME_OFFSET`` is the joint coordinate of the home switch, so new = old + d_rho + what the table or
BACKLASH holds there in the direction of latching (docs/export.md). A table is read in
coordinates that are believed once that is entered, and BACKLASH is not looked at beside one: play
goes into it. The controller refuses comments behind a number; they stand on lines of their own.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from importlib import resources
from textwrap import wrap

from app.exports.linuxcnc_joints import DriveJoint, joint_of_each_drive, joints_of_drives, travel
from app.report.offsets import Export, Offsets, for_controller, moves_the_tool
from app.report.schema.solution import Offset
from app.report.text.tables import WIDTH, uncertain
from calib.arrays import LEG_NAMES
from calib.errors import UsageError
from calib.posterior.correction import Holds
from calib.printable import one_line
from calib.tripod.controller import (
    INTERPOLATION_MM,
    NOTHING_MM,
    JointEntries,
    Table,
    joint_entries,
    kinematics_of,
    not_told,
)
from calib.tripod.pipeline import Model, Stage

MODULE = "orthoglidekins"
UNITS = {1.0: "mm", 25.4: "inch"}


def table_text(table: Table, mm_per_unit: float = 1.0) -> str:
    """A COMP_FILE of type 1: believed coordinate, what is added to the motor up and down.

    Numbers alone: LinuxCNC takes no heading, and stops at the first line that it cannot read.
    """
    rows = zip(table.joint_mm, table.error_up_mm, table.error_down_mm, strict=True)
    return "".join(
        f"{q / mm_per_unit:z.6f} {-up / mm_per_unit:z.6f} {-down / mm_per_unit:z.6f}\n"
        for q, up, down in rows
    )


def joint_includes(offsets: Offsets) -> Export:
    """``calib_joint<n>.inc`` for each joint, and ``calib_joint<n>.comp`` where it needs a table.

    Raises UsageError where lengths cannot be held, ImpossibleRequest as `joint_entries`.
    """
    if offsets.result and offsets.lengths_mm:  # of a view; what a model has, offsets take over
        lengths_words = ", ".join(
            f"{name} {value:+z.4f}" for name, value in offsets.lengths_mm.items()
        )
        raise UsageError(
            "LinuxCNC joint includes",
            f"leg length errors ({lengths_words} mm)",
            "joint offsets alone: HOME_OFFSET cannot hold a length",
            "Export the session without --subset, or use --format linuxcnc-kins.",
        )
    return joint_files(for_joints(offsets, "tables"), kinematics=False)


NOT_HOMED = "no INI file (--ini) states how the joints home, and homing meets it at the switch"
COMPENSATED = "the INI file has another table for this joint, with which the machine was measured"


def for_joints(offsets: Offsets, holds: Holds) -> Offsets:
    """What these joints can hold, beside kinematics where ``holds`` says so.

    Play and tables need what homing meets at the switch; a joint that reads another table takes
    neither.
    """
    controller = offsets.controller
    absent: dict[str, str] = {}
    if controller is None or any(joint.latch_sign is None for joint in controller.joints):
        absent = dict.fromkeys(("play", "table"), NOT_HOMED)
    else:
        for drive_joint in joints_of_drives(offsets):
            if drive_joint.now is not None and drive_joint.now.compensated:
                leg = LEG_NAMES[drive_joint.drive]
                absent |= dict.fromkeys((f"play of {leg}", f"table of {leg}"), COMPENSATED)
    left_out = not_told(offsets.model, kinematics=holds == "kinematics").effects
    return for_controller(offsets, holds, left_out, absent)


def with_kinematics(offsets: Offsets) -> Export:
    """`joint_includes`, an own kinematics module and ``calib.hal`` with the values of its pins.

    What moves a carriage along its own drive stays with the joints: nothing is corrected twice.
    """
    unit = offsets.controller.mm_per_unit if offsets.controller else 1.0
    source = resources.files("app.exports").joinpath(f"{MODULE}.comp").read_text(encoding="utf-8")
    offsets = for_joints(offsets, "kinematics")
    by_joint = joint_of_each_drive(joints_of_drives(offsets), MODULE)
    hal = "".join(f"# {line}\n" for line in short_lines(origin(offsets)))
    hal += pins(
        offsets.model, unit, [(drive_joint.joint, drive_joint.way) for drive_joint in by_joint]
    )
    module_files = {f"{MODULE}.comp": source, "calib.hal": hal}
    joints = joint_files(offsets, kinematics=True)
    return Export({**joints.files, **module_files}, joints.cautions)


def joint_files(offsets: Offsets, *, kinematics: bool) -> Export:
    """Include and table of each joint, for what the model says along the drives.

    With ``kinematics`` the rest of it stands in a file beside them. Raises as `joint_includes`.
    """
    controller, files = offsets.controller, {}
    _refuse_what_is_not_known(offsets)
    within = list(_within(offsets.model, kinematics=kinematics))
    travels: list[str] = []
    for drive_joint, entries in entries_of(offsets):
        joint, drive, joint_now = drive_joint.joint, drive_joint.drive, drive_joint.now
        unit = controller.mm_per_unit if controller else 1.0
        comment_lines = [origin(offsets, joint, drive), *_of_joint(offsets, drive_joint, entries)]
        moving = list(travel(offsets, drive_joint, entries))
        travels += moving
        comment_lines += [*moving, *within, *offsets.cautions]
        instruction = f"put '#INCLUDE calib_joint{joint}.inc' directly under [JOINT_{joint}]"
        lines = [f"# {line}" for text in comment_lines for line in short_lines(text)]
        lines.append(f"# {instruction}; LINEAR_UNITS = {UNITS.get(unit) or f'{1.0 / unit:g}'}")
        if joint_now:
            lines.append(
                f"HOME_OFFSET = {(joint_now.home_offset_mm + entries.home_change_mm) / unit:z.6f}"
            )
        if entries.backlash_mm and entries.table is None:
            lines.append(f"BACKLASH = {entries.backlash_mm / unit:z.6f}")
        if entries.table is not None:
            name = f"calib_joint{joint}.comp"
            lines += [f"COMP_FILE = {name}", "COMP_FILE_TYPE = 1"]
            files[name] = table_text(entries.table, unit)
        files[f"calib_joint{joint}.inc"] = "\n".join(lines) + "\n"
    return Export(files, (*dict.fromkeys(travels), *offsets.cautions))


def entries_of(offsets: Offsets) -> list[tuple[DriveJoint, JointEntries]]:
    """What each joint that moves a drive is to hold; the change alone where nobody stated the old.

    Raises as `joints_of_drives` and `joint_entries`.
    """
    offset_mm = offsets.joint_offsets_mm  # all are stated
    return [
        (
            drive_joint,
            joint_entries(offsets.model, drive_joint.drive, drive_joint.now, drive_joint.way)
            if drive_joint.now
            else JointEntries(drive_joint.way * offset_mm[drive_joint.drive]),
        )
        for drive_joint in joints_of_drives(offsets)
    ]


def _refuse_what_is_not_known(offsets: Offsets) -> None:
    controller = offsets.controller
    entered = controller.entered if controller else None
    if (
        entered
        and offsets.recorded
        and offsets.recorded.replace(second=0, microsecond=0) <= entered
    ):
        raise UsageError(
            "--ini",
            f"joints with the offsets of a session of {entered:%Y-%m-%d %H:%M}",
            "their values when these readings were taken",
            "Measure again with their present values, or remove the includes of that session.",
        )
    unknown = controller is None or any(joint.latch_sign is None for joint in controller.joints)
    if unknown and any(joint.stage == Stage.ACTUATOR for joint in offsets.model.effects):
        raise UsageError(
            "LinuxCNC joint includes",
            "effects along the drives, but not where and how the joints home",
            "--ini with the controller's INI file",
            "Homing meets these effects at the switch, so HOME_OFFSET depends on it.",
        )


def origin(offsets: Offsets, joint: int | None = None, drive: int = 0) -> str:
    """Machine, session, when it was measured, digest, version."""
    of = "" if joint is None else f"joint {joint} ({LEG_NAMES[drive]}) of "
    date_words = f", {one_line(offsets.made)}" if offsets.made else ""
    machine, source = one_line(offsets.machine.name), one_line(offsets.source)
    return f"glidecal: {of}{machine}, from {source}{date_words}"


def _of_joint(offsets: Offsets, drive_joint: DriveJoint, entries: JointEntries) -> Iterator[str]:
    """How the value comes about, or what to add to one that nobody stated."""
    drive, way, joint_now = drive_joint.drive, drive_joint.way, drive_joint.now
    name = f"d_rho_{LEG_NAMES[drive]}"
    offset = way * offsets.parameters[name].value
    if way < 0:
        yield f"this joint runs against its drive (machine file): the sign of {name} is reversed"
    if joint_now is None:
        yield (
            f"the present HOME_OFFSET is not stated: add {offset:+z.6f} mm ({name}) to the "
            f"present value of the controller, and enter the sum"
        )
    else:
        yield f"old HOME_OFFSET {joint_now.home_offset_mm:z.6f} mm + {name} {offset:+z.6f} mm"
        fitted = way * offsets.model.parameters_mm[drive]
        if abs(fitted - offset) > NOTHING_MM:
            yield f"and {fitted - offset:+z.6f} mm that goes with the kinematics in calib.hal"
        added_mm = entries.home_change_mm - fitted
        if abs(added_mm) > NOTHING_MM:
            yield f"and {added_mm:+z.6f} mm that homing meets at the switch"
    yield from known_lines(name, offsets.parameters[name], lacks_fit=offsets.lacks_fit)


def _within(model: Model, *, kinematics: bool) -> Iterator[str]:
    """Effects that these files hold."""
    beyond_files = not_told(model, kinematics=kinematics)
    names = dict.fromkeys(
        effect.id for effect in moves_the_tool(model) if effect not in beyond_files.effects
    )
    if names:
        yield f"in these files: {', '.join(names)}"
    if kinematics and (misfit_mm := kinematics_of(model).misfit_mm) > INTERPOLATION_MM:
        yield f"the kinematics follow the drives within {misfit_mm:.4f} mm only"


def known_lines(name: str, offset: Offset, *, lacks_fit: bool) -> list[str]:
    """The figures of the result: the larger one first where it warns of what the model leaves."""
    if offset.standard_uncertainty is None or offset.expanded_uncertainty is None:
        return []
    uncertainty_words = f"±{uncertain(offset.expanded_uncertainty, 4)} mm"
    noise = f"u = {uncertain(offset.standard_uncertainty, 4)} mm"
    wider = offset.expanded_with_tolerances or 0.0
    parts = (
        [
            f"with the other parts within their tolerances {name} is known to ±"
            f"{uncertain(wider, 4)} mm (95 %)"
        ]
        if wider > offset.expanded_uncertainty
        else []
    )
    if lacks_fit and offset.expanded_with_lack_of_fit is not None:
        larger = f"±{uncertain(offset.expanded_with_lack_of_fit)} mm"
        return [
            f"{name} is known to {larger} (95 %, residual taken as noise); with "
            f"reading noise only {uncertainty_words}, {noise}",
            *parts,
        ]
    return [f"{name} is known to {uncertainty_words} (95 %), {noise}", *parts]


def short_lines(text: str) -> list[str]:
    """The text in short lines: controllers refuse long ones."""
    return wrap(one_line(text), WIDTH, break_on_hyphens=False)


def pins(
    model: Model,
    mm_per_unit: float = 1.0,
    joints: Sequence[tuple[int, int]] = ((0, 1), (1, 1), (2, 1)),
) -> str:
    """``calib.hal``: ``setp`` lines for the kinematics of a model, in the machine's unit.

    ``joints`` are the joint of each drive and whether it counts with (1) or against (-1) it.
    """
    slopes, geometry = kinematics_of(model), model.geometry
    vectors = {
        "origin": slopes.origin_mm / mm_per_unit,
        "direction": slopes.direction,
        "bend": slopes.bend_per_mm * mm_per_unit,
        "platform": geometry.platform / mm_per_unit,
    }
    figures = {"zero": slopes.zero_mm, "length": slopes.length_mm, "sag": slopes.sag_mm}
    values: dict[str, float] = {}
    for drive, (joint, way) in enumerate(joints):
        for name, rows in vectors.items():
            parts = zip("xyz", rows[drive], strict=True)
            values |= {f"{name}-{drive}-{axis}": part for axis, part in parts}
        values |= {f"{name}-{drive}": mm[drive] / mm_per_unit for name, mm in figures.items()}
        values |= {f"joint-{drive}": joint, f"way-{drive}": way}
    down = zip("xyz", geometry.gravity, strict=True)
    values |= {**{f"gravity-{axis}": part for axis, part in down}, "side": geometry.side}
    return "".join(f"setp {MODULE}.{pin} {float(value):.12g}\n" for pin, value in values.items())
