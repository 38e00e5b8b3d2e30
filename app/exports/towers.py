"""Values for firmware of upright towers: Klipper, RepRapFirmware, LinuxCNC's lineardeltakins.

A switch trips at the height of the tool over the middle; the carriage is then higher by
sqrt(length^2 - radius^2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from app.exports.linuxcnc import (
    for_joints,
    joint_files,
    known_lines,
    origin,
    short_lines,
)
from app.exports.linuxcnc_joints import joints_of_drives, one_joint_a_drive
from app.report.offsets import (
    LEAST_MM,
    Export,
    Offsets,
    bound_of_files,
    for_controller,
    with_bound,
)
from calib.arrays import LEG_NAMES, FloatArray
from calib.errors import UsageError
from calib.tripod.pipeline import Stage, StageEffect
from calib.tripod.towers import Entered, Towers, each_alone, entered, tower_model

USUAL_ANGLES_DEG = (210.0, 330.0, 90.0)
"""Of the first, second and third tower of printers, from x, anticlockwise."""

FURTHEST_DEG = 30.0
"""A tower that stands further from the firmware's place for it is another one."""


def drives_of_towers(
    offsets: Offsets,
    angles_deg: Sequence[float] = USUAL_ANGLES_DEG,
    furthest_deg: float = FURTHEST_DEG,
) -> list[int]:
    """The drive of each tower of the firmware: as the machine file's ``joints`` say, or nearest.

    Raises UsageError where one stands elsewhere or counts downwards, ImpossibleRequest for another
    kind of machine.
    """
    stand = Towers.of(offsets.machine.geometry())
    apart = stand.apart_deg(angles_deg)
    named = offsets.machine.joints or tuple(LEG_NAMES[row.index(min(row))] for row in apart)
    drives = [LEG_NAMES.index(name[-1]) for name in named]
    far = max(row[drive] for row, drive in zip(apart, drives, strict=True))
    if far > furthest_deg or len(set(drives)) < len(drives) or any("-" in name for name in named):
        raise UsageError(
            f"towers of machine '{offsets.machine.name}'",
            f"joints {', '.join(named)}, drives x, y, z at {_three(stand.angle_deg, 2)}°",
            f"joints that count upwards, at {', '.join(f'{at:g}' for at in angles_deg)}° in their "
            f"order within {furthest_deg:g}°",
            "State joints in the machine file, or use another format.",
        )
    return drives


def endstops_now_mm(offsets: Offsets) -> list[float]:
    """Heights of the tool at which the switches of drives x, y, z trip now, mm.

    Raises UsageError where nobody stated them.
    """
    held = offsets.controller
    if held is None:
        raise UsageError(
            "present heights of the switches",
            "none stated",
            "position_endstop_mm in the machine file, or --endstops X,Y,Z: Klipper's "
            "position_endstop; of RepRapFirmware H plus M666",
        )
    joints = [name.lower() for name in held.axes or "XYZ"]
    home = [held.joints[joints.index(name)].home_offset_mm for name in LEG_NAMES]
    zero = offsets.machine.geometry().zero_mm.tolist()
    return [at - below for at, below in zip(home, zero, strict=True)]


def fitted(offsets: Offsets) -> tuple[Offsets, Entered]:
    """Values of firmware that holds each bar and tower, with the bound of what they hold."""
    whole = for_controller(offsets, "kinematics")
    found = entered(whole.model, each_tower=True)
    return _bounded(whole, found), found


def _bounded(offsets: Offsets, found: Entered, along: Sequence[StageEffect] = ()) -> Offsets:
    """The bound with these values, and those of the joints for effects ``along`` the drives.

    That of a model file is gone where they leave a part of it.
    """
    if offsets.solved is not None:
        off = offsets.solved.corrections.off_with_towers(found, along)
        return with_bound(offsets, bound_of_files(offsets.solved, off))
    return with_bound(offsets, offsets.bound if found.after_mm < LEAST_MM else "")


def comments(
    offsets: Offsets, found: Entered, put: str, holds: str, *, each_tower: bool = True
) -> list[str]:
    """What stands above the values: where they go, what they are for, what they leave, cautions.

    First that the height of the tool changes: at Zero each carriage is as far below its switch as
    its endstop says, and the tool goes with the mean of the three.
    """
    now = found.now
    lower_mm = sum(found.endstops_mm((0.0, 0.0, 0.0))) / len(LEG_NAMES)
    said = [
        "BEFORE THE FIRST MOVE: touch the plate again. With these values the tool at Zero stands "
        f"about {abs(lower_mm):.2f} mm {'lower' if lower_mm > 0.0 else 'higher'} than now",
        *origin(offsets),
        put,
        f"made for a controller that now holds radius {now.radius_mm:.3f} mm, lengths of the bars "
        f"{_three(now.length_mm)} mm, towers at {_three(now.angle_deg)}°, {holds}; if it "
        "holds others, these values are wrong",
        f"tool error over the workspace, if the model is right: {found.before_mm:.4f} mm r.m.s. "
        f"now, {found.after_mm:.4f} mm with these values",
    ]
    x, y, z = found.at_zero_mm.tolist()
    if max(abs(x), abs(y), abs(z)) >= LEAST_MM:
        said.append(
            f"the tool sent to Zero then stands at ({x:+.4f}, {y:+.4f}, {z:+.4f}) mm: errors count "
            "from there"
        )
    alone = dict(each_alone(offsets.model, each_tower=each_tower))
    if held := [name for name, left_mm in alone.items() if left_mm < LEAST_MM]:
        said.append(f"wholly in these values: {', '.join(held)}")
    if short := {name: mm for name, mm in alone.items() if mm >= LEAST_MM}:
        shown = ", ".join(f"{name} leaves {mm:.4f} mm" for name, mm in short.items())
        said.append(
            f"not wholly: the firmware has no value for all of {', '.join(short)}. By itself "
            f"{shown}, together {found.after_mm:.4f} mm r.m.s. at the tool"
        )
    for name, one in offsets.parameters.items():
        said += known_lines(name, one, lacks_fit=offsets.lacks_fit)
    return [line for text in (*said, *offsets.cautions) for line in short_lines(text)]


def _three(values: FloatArray, decimals: int = 3) -> str:
    return ", ".join(f"{value:.{decimals}f}" for value in values.tolist())


STEPPERS = "abc"


def printer_cfg(offsets: Offsets) -> Export:
    """Klipper: a file to include at the end of ``printer.cfg``.

    Of a key that is there twice the last counts (klippy/kinematics). Raises as `drives_of_towers`,
    `endstops_now_mm` and `fitted`.
    """
    drives, now = drives_of_towers(offsets), endstops_now_mm(offsets)
    offsets, found = fitted(offsets)
    stops = found.endstops_mm(now)
    steppers = [
        f"stepper_{name} (tower {LEG_NAMES[drive]}) position_endstop {now[drive]:.6f} mm"
        for name, drive in zip(STEPPERS, drives, strict=True)
    ]
    put = (
        "put '[include FILE]' with the name of this file at the end of printer.cfg, where it wins "
        "over what stands above and over saved values; then home. Later saved calibrations are "
        "refused while it is included"
    )
    lines = [f"# {line}" for line in comments(offsets, found, put, ", ".join(steppers))]
    lines += ["[printer]", f"delta_radius: {found.towers.radius_mm:.6f}"]
    for name, drive in zip(STEPPERS, drives, strict=True):
        lines += [
            f"[stepper_{name}]",
            f"position_endstop: {stops[drive]:.6f}",
            f"arm_length: {found.towers.length_mm[drive]:.6f}",
            f"angle: {found.towers.angle_deg[drive]:.6f}",
        ]
    return Export({"": "\n".join(lines) + "\n"}, offsets.cautions)


TOWERS = "XYZ"


def config_g(offsets: Offsets) -> Export:
    """RepRapFirmware: lines M665 and M666 for ``config.g``. Raises as `printer_cfg`.

    A switch trips at H + M666. X, Y, Z of M665 turn the towers at 210, 330 and 90° anticlockwise,
    in degrees (LinearDeltaKinematics.cpp). H is the mean, so that the corrections of M666 add up to
    nothing, as automatic calibration leaves them.
    """
    drives, now = drives_of_towers(offsets), endstops_now_mm(offsets)
    offsets, found = fitted(offsets)
    stops, towers = [found.endstops_mm(now)[drive] for drive in drives], found.towers
    height = sum(stops) / len(stops)
    held = [
        f"H + M666 of {name} (tower {LEG_NAMES[drive]}) {now[drive]:.6f} mm"
        for name, drive in zip(TOWERS, drives, strict=True)
    ]
    put = (
        "put these lines into config.g in the place of M665 and M666 there, each with the B that "
        "it has (radius of the bed; tilt, which must be A0 B0 now); take them out of "
        "config-override.g; then home. Saved by M500 they lose digits after the third"
    )
    turned = [
        f"{name}{(towers.angle_deg[drive] - usual + 180.0) % 360.0 - 180.0:z.6f}"
        for name, drive, usual in zip(TOWERS, drives, USUAL_ANGLES_DEG, strict=True)
    ]
    lengths = ":".join(f"{towers.length_mm[drive]:.6f}" for drive in drives)
    raised = [f"{name}{stop - height:z.6f}" for name, stop in zip(TOWERS, stops, strict=True)]
    lines = [f"; {line}" for line in comments(offsets, found, put, ", ".join(held))]
    lines.append(f"M665 L{lengths} R{towers.radius_mm:.6f} H{height:.6f} {' '.join(turned)}")
    lines.append(f"M666 {' '.join(raised)}")
    return Export({"": "\n".join(lines) + "\n"}, offsets.cautions)


ANGLES_DEG = (90.0, 210.0, 330.0)
EXACT_DEG = 0.01
"""The kinematics have no angles of their own; numbers of a machine file are rounded."""


def joints_and_pins(offsets: Offsets) -> Export:
    """LinuxCNC with ``lineardeltakins``: includes and tables of the joints, ``calib.hal``.

    Its two pins hold one length and one radius. Joints 0, 1, 2 are the towers at 90, 210 and 330°,
    each coordinate the height of its carriage (lineardeltakins-common.h). Play, scale and screws
    stay with the joints, as in `linuxcnc`.

    Raises UsageError for bars that are held unequal now or a HOME_OFFSET that nobody stated (a
    change of L or R without it would move the tool), and as `joint_files`.
    """
    drives = drives_of_towers(offsets, ANGLES_DEG, EXACT_DEG)
    held = offsets.controller
    if held is None:
        raise UsageError(
            "present HOME_OFFSET",
            "none stated",
            "--ini, --home-offset, or home_offset_mm in the machine file",
        )
    if sorted(held.axes or "XYZ") != ["X", "Y", "Z"]:
        one_joint_a_drive(joints_of_drives(offsets), "lineardeltakins")
    of_joints = [LEG_NAMES[drive] for drive in drives]
    if held.axes:  # by drives, else in the order of the joints already
        named = [name.lower() for name in held.axes]
        held = replace(
            held, joints=tuple(held.joints[named.index(name)] for name in of_joints), axes=None
        )
    machine = offsets.machine.model_copy(update={"joints": tuple(of_joints)})
    offsets = for_joints(replace(offsets, machine=machine, controller=held), "kinematics")
    along = tuple(one for one in offsets.model.effects if one.stage == Stage.ACTUATOR)
    across = tuple(one for one in offsets.model.effects if one.stage != Stage.ACTUATOR)
    found = entered(offsets.model.with_effects(across), each_tower=False)
    if max(found.now.length_mm) - min(found.now.length_mm) > LEAST_MM:
        raise UsageError("lengths of the bars held now", "unequal ones", "one length, pin L")
    offsets = _bounded(offsets, found, along)
    told = replace(offsets, model=tower_model(offsets.model, found.change_mm, along))
    unit = held.mm_per_unit
    put = (
        "name this file as HALFILE after the one that loads lineardeltakins, and put the includes "
        "of the joints under their headings: neither is right without the other. Then home"
    )
    homes = ", ".join(f"{joint.home_offset_mm:.6f}" for joint in held.joints[:3])
    said = comments(
        replace(offsets, model=offsets.model.with_effects(across)),
        found,
        put,
        f"HOME_OFFSET {homes} mm of joints 0, 1, 2",
        each_tower=False,
    )
    pins = [
        f"setp lineardeltakins.L {float(found.towers.length_mm[0]) / unit:.6f}",
        f"setp lineardeltakins.R {found.towers.radius_mm / unit:.6f}",
    ]
    hal = "\n".join([*(f"# {line}" for line in said), *pins]) + "\n"
    joints_written = joint_files(told, kinematics=False)
    return Export({**joints_written.files, "calib.hal": hal}, joints_written.cautions)
