"""Values for LinuxCNC with its own kinematics ``lineardeltakins``: one length, one radius.

Joints 0, 1, 2 are the towers at 90, 210 and 330°, each coordinate the height of its carriage
(lineardeltakins-common.h). Play, scale and screws stay with the joints, as in `linuxcnc`.
"""

from __future__ import annotations

from dataclasses import replace

from app.exports.linuxcnc import joint_files, refuse_what_is_ambiguous
from app.exports.towers import comments, drives_of_towers
from app.report.offsets import Offsets
from calib.arrays import LEG_NAMES
from calib.errors import UsageError
from calib.tripod.pipeline import Stage
from calib.tripod.towers import LEAST_MM, entered, tower_model
from protocols.files import Written

ANGLES_DEG = (90.0, 210.0, 330.0)
EXACT_DEG = 0.01
"""The kinematics have no angles of their own; numbers of a machine file are rounded."""


def joints_and_pins(offsets: Offsets) -> Written:
    """Includes and tables of the joints, and ``calib.hal`` with the two pins.

    Raises UsageError for bars that are held unequal now or a HOME_OFFSET that nobody stated (a
    change of L or R without it would move the tool), and as `joint_files`.
    """
    refuse_what_is_ambiguous(offsets)
    drives = drives_of_towers(offsets, ANGLES_DEG, EXACT_DEG)
    held = offsets.controller
    if held is None:
        raise UsageError(
            "present HOME_OFFSET",
            "none stated",
            "--ini, --home-offset, or home_offset_mm in the machine file",
        )
    of_joints = [LEG_NAMES[drive] for drive in drives]
    if held.axes:  # by drives, else in the order of the joints already
        named = [name.lower() for name in held.axes]
        held = replace(
            held, joints=tuple(held.joints[named.index(name)] for name in of_joints), axes=None
        )
    along = tuple(one for one in offsets.model.effects if one.stage == Stage.ACTUATOR)
    across = tuple(one for one in offsets.model.effects if one.stage != Stage.ACTUATOR)
    found = entered(offsets.model.with_effects(across), each_tower=False)
    if max(found.now.length_mm) - min(found.now.length_mm) > LEAST_MM:
        raise UsageError("lengths of the bars held now", "unequal ones", "one length, pin L")
    joints = tower_model(offsets.model, found.change_mm, along)
    machine = offsets.machine.model_copy(update={"joints": tuple(of_joints)})
    told = replace(offsets, machine=machine, controller=held, model=joints)
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
    return {**joint_files(told, kinematics=False), "calib.hal": hal}
