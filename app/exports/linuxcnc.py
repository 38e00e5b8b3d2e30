"""Files for LinuxCNC: an include for each joint, its table where it has one, own kinematics.

``HOME_OFFSET`` is the joint coordinate of the home switch, so new = old + e(switch, direction of
latching), e being true - believed place of the carriage (docs/export.md). A table is read in
coordinates that are believed once that is entered, and BACKLASH is not looked at beside one: play
goes into it. The controller refuses comments behind a number; they stand on lines of their own.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from importlib import resources
from textwrap import wrap

from app.report.offsets import Offsets, one_line
from app.report.schema.solution import Offset
from app.report.text.tables import WIDTH, uncertain
from calib.arrays import LEG_NAMES
from calib.errors import ImpossibleRequest, UsageError
from calib.tripod.controller import (
    INTERPOLATION_MM,
    NOTHING_MM,
    ControllerJoint,
    Table,
    carriage_errors_mm,
    kinematics_of,
    not_told,
    table_of,
    tool_error_mm,
)
from calib.tripod.pipeline import Model, Stage
from protocols.files import Written

PLAY_ALONE_MM = 2e-4
"""A table whose columns differ by play alone, within this, is BACKLASH."""

MODULE = "orthoglidekins"
MOVES_THE_TOOL = (Stage.ACTUATOR, Stage.FOOT, Stage.TOOL)
UNITS = {1.0: "mm", 25.4: "inch"}


@dataclass(frozen=True)
class JointEntries:
    """Entries of one joint, mm; ``home_change_mm`` is what HOME_OFFSET grows by."""

    home_change_mm: float
    backlash_mm: float = 0.0
    table: Table | None = None

    def turned(self) -> JointEntries:
        """The same for a joint that counts the other way; play stays as it is."""
        table = self.table.turned() if self.table else None
        return replace(self, home_change_mm=-self.home_change_mm, table=table)


def joint_entries(model: Model, drive: int, held: ControllerJoint, way: int = 1) -> JointEntries:
    """Entries of a drive's joint that now holds this; with ``way`` -1 it counts against the drive.

    Raises ImpossibleRequest for what a joint cannot take.
    """
    if way < 0:
        return _of_drive(model, drive, held.turned()).turned()
    return _of_drive(model, drive, held)


def _of_drive(model: Model, drive: int, held: ControllerJoint) -> JointEntries:
    offset = model.parameters_mm[drive]
    table = table_of(model, drive)
    if table is None:
        return JointEntries(offset)
    if held.compensated:
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
            "It is no play: take the effect out with glidecal model --remove.",
        )
    most = float(max(abs(table.error_up_mm).max(), abs(table.error_down_mm).max()))
    travel_mm = model.geometry.travel_max_mm - model.geometry.travel_min_mm
    if not most < travel_mm:
        raise ImpossibleRequest(
            f"error of joint {LEG_NAMES[drive]} along its drive",
            f"{most:.4g} mm",
            f"less than its travel, {travel_mm:g} mm",
            "Look at the values in the model: glidecal model.",
        )
    # what homing meets at the switch is in the old value; an encoder meets nothing
    change = offset
    if not held.absolute_encoder:
        change = carriage_errors_mm(model, held.home_offset_mm, held.latch_sign or 1)[drive]
    play = float(table.error_down_mm.mean())
    if max(abs(table.error_up_mm).max(), abs(table.error_down_mm - play).max()) < PLAY_ALONE_MM:
        return JointEntries(change, held.backlash_mm + play)
    half = held.backlash_mm / 2.0  # the controller adds it upwards and takes it off downwards
    both = Table(table.joint_mm, table.error_up_mm - half, table.error_down_mm + half)
    return JointEntries(change, table=both)


def table_text(table: Table, mm_per_unit: float = 1.0) -> str:
    """A COMP_FILE of type 1: believed coordinate, what is added to the motor up and down.

    Numbers alone: LinuxCNC takes no heading, and stops at the first line that it cannot read.
    """
    rows = zip(table.joint_mm, table.error_up_mm, table.error_down_mm, strict=True)
    return "".join(
        f"{q / mm_per_unit:.6f} {-up / mm_per_unit:.6f} {-down / mm_per_unit:.6f}\n"
        for q, up, down in rows
    )


def joint_includes(offsets: Offsets) -> Written:
    """``calib_joint<n>.inc`` for each joint, and ``calib_joint<n>.comp`` where it needs a table.

    Raises UsageError where lengths cannot be held, ImpossibleRequest as `joint_entries`.
    """
    if offsets.lengths_mm:
        shown = ", ".join(f"{name} {value:+.4f}" for name, value in offsets.lengths_mm.items())
        raise UsageError(
            "LinuxCNC joint includes",
            f"leg length errors ({shown} mm)",
            "joint offsets alone: HOME_OFFSET cannot hold a length",
            "Export with --subset joint-offsets, or use --format linuxcnc-kins.",
        )
    return joint_files(offsets, kinematics=False)


def with_kinematics(offsets: Offsets) -> Written:
    """`joint_includes`, an own kinematics module and ``calib.hal`` with the values of its pins.

    What moves a carriage along its own drive stays with the joints: nothing is corrected twice.
    """
    unit = offsets.controller.mm_per_unit if offsets.controller else 1.0
    source = resources.files("app.exports").joinpath(f"{MODULE}.comp").read_text(encoding="utf-8")
    said = [line for text in origin(offsets) for line in short_lines(text)]
    hal = "".join(f"# {line}\n" for line in said) + pins(offsets.model, unit, _joints(offsets))
    own = {f"{MODULE}.comp": source, "calib.hal": hal}
    return {**joint_files(offsets, kinematics=True), **own}


def joint_files(offsets: Offsets, *, kinematics: bool) -> Written:
    """Include and table of each joint, for what the model says along the drives.

    With ``kinematics`` the rest of it stands in a file beside them. Raises as `joint_includes`.
    """
    x, y, z = offsets.joint_offsets_mm  # all are stated
    controller, written = offsets.controller, {}
    _refuse_what_is_not_known(offsets)
    joints = _joints(offsets)
    left = list(_left(offsets.model, kinematics=kinematics))
    for drive, offset in enumerate((x, y, z)):
        joint, way = joints[drive]
        held = controller.joints[joint] if controller else None
        entries = (
            joint_entries(offsets.model, drive, held, way) if held else JointEntries(way * offset)
        )
        unit = controller.mm_per_unit if controller else 1.0
        said = [*origin(offsets, joint, drive), *_of_joint(offsets, drive, way, held, entries)]
        said += [*left, *offsets.cautions]
        put = f"put '#INCLUDE calib_joint{joint}.inc' directly under [JOINT_{joint}]"
        lines = [f"# {line}" for text in said for line in short_lines(text)]
        lines.append(f"# {put}; LINEAR_UNITS = {UNITS.get(unit) or f'{1.0 / unit:g}'}")
        if held:
            lines.append(
                f"HOME_OFFSET = {(held.home_offset_mm + entries.home_change_mm) / unit:.6f}"
            )
        if entries.backlash_mm and entries.table is None:
            lines.append(f"BACKLASH = {entries.backlash_mm / unit:.6f}")
        if entries.table is not None:
            name = f"calib_joint{joint}.comp"
            lines += [f"COMP_FILE = {name}", "COMP_FILE_TYPE = 1"]
            written[name] = table_text(entries.table, unit)
        written[f"calib_joint{joint}.inc"] = "\n".join(lines) + "\n"
    return written


def refuse_what_is_ambiguous(offsets: Offsets) -> None:
    """Raises UsageError for a model with effects that stand for others, too."""
    if offsets.ambiguous:
        raise UsageError(
            "export of a model",
            f"{', '.join(offsets.ambiguous)}, one of several effects that would do",
            "effects that the readings tell from others",
            "Measure what glidecal diagnose --next proposes, or give --ambiguous.",
        )


def _refuse_what_is_not_known(offsets: Offsets) -> None:
    refuse_what_is_ambiguous(offsets)
    controller = offsets.controller
    entered = controller.entered if controller else None
    if (
        entered
        and offsets.measured
        and offsets.measured.replace(second=0, microsecond=0) <= entered
    ):
        raise UsageError(
            "--ini",
            f"joints that hold the offsets of a session of {entered:%Y-%m-%d %H:%M}",
            "what they held when these readings were taken",
            "Measure again with what they hold now, or take the includes of that session out.",
        )
    unknown = controller is None or any(one.latch_sign is None for one in controller.joints)
    if unknown and any(one.stage == Stage.ACTUATOR for one in offsets.model.effects):
        raise UsageError(
            "LinuxCNC joint includes",
            "effects along the drives, but not where and how the joints home",
            "--ini with the controller's INI file",
            "Homing meets these effects at the switch, so HOME_OFFSET depends on it.",
        )


def _joints(offsets: Offsets) -> tuple[tuple[int, int], ...]:
    """The joint of each drive, and -1 where it counts against it.

    As the machine file says, else by the axes that the kinematics name, else in their order.
    """
    axes = offsets.controller.axes if offsets.controller else None
    named = offsets.machine.joints or tuple((axes or "").lower()[:3])
    if sorted(name[-1] for name in named) != list(LEG_NAMES):
        named = LEG_NAMES
    drives = [name[-1] for name in named]
    return tuple((n := drives.index(leg), -1 if named[n][0] == "-" else 1) for leg in LEG_NAMES)


def origin(offsets: Offsets, joint: int | None = None, drive: int = 0) -> list[str]:
    """Machine, session, when it was measured, digest, version."""
    of = "" if joint is None else f"joint {joint} ({LEG_NAMES[drive]}) of "
    made = f", {one_line(offsets.made)}" if offsets.made else ""
    return [
        f"glidecal: {of}{one_line(offsets.machine.name)}, from {one_line(offsets.source)}{made}"
    ]


def _of_joint(
    offsets: Offsets, drive: int, way: int, held: ControllerJoint | None, entries: JointEntries
) -> Iterator[str]:
    """How the value comes about, or what to add to one that nobody stated."""
    name = f"d_rho_{LEG_NAMES[drive]}"
    offset = way * offsets.parameters[name].value
    if way < 0:
        yield f"this joint counts against its drive, as the machine file says: {name} is turned"
    if held is None:
        yield (
            f"nobody stated the present HOME_OFFSET: add {offset:+.6f} mm ({name}) to the value "
            "that the controller holds now, and enter the sum"
        )
    else:
        yield f"old HOME_OFFSET {held.home_offset_mm:.6f} mm + {name} {offset:+.6f} mm"
        fitted = way * offsets.model.parameters_mm[drive]
        if abs(fitted - offset) > NOTHING_MM:
            yield f"and {fitted - offset:+.6f} mm that goes with the kinematics in calib.hal"
        more = entries.home_change_mm - fitted
        if abs(more) > NOTHING_MM:
            yield f"and {more:+.6f} mm that homing meets at the switch"
    yield from known_lines(name, offsets.parameters[name], lacks_fit=offsets.lacks_fit)


def _left(model: Model, *, kinematics: bool) -> Iterator[str]:
    """Effects that these files do not hold, and what that leaves at the tool."""
    left = not_told(model, kinematics=kinematics)
    mine = [one for one in model.effects if one.stage in MOVES_THE_TOOL]
    held = dict.fromkeys(one.id for one in mine if one not in left.effects)
    out = dict.fromkeys(one.id for one in left.effects)
    if held:
        yield f"in these files: {', '.join(held)}"
    if out:
        error = f"{tool_error_mm(left):.4f} mm r.m.s. at the tool"
        yield f"not in these files: {', '.join(out)}; that leaves {error}"
    if kinematics and (misfit_mm := kinematics_of(model).misfit_mm) > INTERPOLATION_MM:
        yield f"the kinematics follow the drives within {misfit_mm:.4f} mm only"


def known_lines(name: str, one: Offset, *, lacks_fit: bool) -> list[str]:
    """The figures of the result: the larger one first where it warns of what the model leaves."""
    if one.standard_uncertainty is None or one.expanded_uncertainty is None:
        return []
    known = f"±{uncertain(one.expanded_uncertainty, 4)} mm"
    noise = f"u = {uncertain(one.standard_uncertainty, 4)} mm"
    wider = one.expanded_with_tolerances or 0.0
    parts = (
        [
            f"with the other parts within their tolerances {name} is known to ±"
            f"{uncertain(wider, 4)} mm (95 %)"
        ]
        if wider > one.expanded_uncertainty
        else []
    )
    if lacks_fit and one.expanded_with_lack_of_fit is not None:
        larger = f"±{uncertain(one.expanded_with_lack_of_fit)} mm"
        return [
            f"{name} is known to {larger} (95 %, residual counted as noise); with "
            f"reading noise only {known}, {noise}",
            *parts,
        ]
    return [f"{name} is known to {known} (95 %), {noise}", *parts]


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
    return "\n".join(_pins(model, mm_per_unit, joints)) + "\n"


def _pins(model: Model, mm_per_unit: float, joints: Sequence[tuple[int, int]]) -> Iterator[str]:
    found, geometry = kinematics_of(model), model.geometry
    vectors = {
        "origin": found.origin_mm / mm_per_unit,
        "direction": found.direction,
        "bend": found.bend_per_mm * mm_per_unit,
        "platform": geometry.platform / mm_per_unit,
    }
    figures = {"zero": found.zero_mm, "length": found.length_mm, "sag": found.sag_mm}
    for drive in range(len(LEG_NAMES)):
        for name, rows in vectors.items():
            for axis, value in zip("xyz", rows[drive], strict=True):
                yield _setp(f"{name}-{drive}-{axis}", value)
        for name, values in figures.items():
            yield _setp(f"{name}-{drive}", values[drive] / mm_per_unit)
        for name, number in zip(("joint", "way"), joints[drive], strict=True):
            yield _setp(f"{name}-{drive}", number)
    for axis, value in zip("xyz", geometry.gravity, strict=True):
        yield _setp(f"gravity-{axis}", value)
    yield _setp("side", geometry.side)


def _setp(pin: str, value: float) -> str:
    return f"setp {MODULE}.{pin} {float(value):.12g}"
