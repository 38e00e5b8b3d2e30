"""Entries of joints in LinuxCNC: how far is a carriage from where the controller believes it?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from app.exports.linuxcnc import pins, table_text
from calib.tripod.controller import ControllerJoint, joint_entries
from calib.tripod.effects.drives import ActuatorCyclic, ActuatorScale, Backlash
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.geometry import Geometry
from calib.tripod.pipeline import Model
from tests.controller.machine import L, Machine, old_home_offset_mm
from tests.controller.running import SimulatedJoint, run

OFFSETS = (0.8, -1.3, 0.45)
PLAY = {"play": 0.06}
SCALE = {"scale": 5e-4}
WHOLE = {"scale": 5e-4, "cyclic": 0.01, "play": 0.06}
PLACES = [(0, 0, 0), (60, 0, 0), (0, 0, 0), (0, 60, 0), (0, 0, 60), (-60, 0, 0), (0, -60, -60)]
HERE = {"HOME": L, "HOME_SEARCH_VEL": 0.0, "HOME_LATCH_VEL": 0.0}
"""The switch is here, now: homed where it stands."""


def found(machine: Machine) -> Model:
    """The machine as glidecal would have found it."""
    effects = []
    for leg in "xyz":
        figures = machine.joint
        if "scale" in figures:
            scale = figures["scale"] * 1e3
            effects.append(EffectInstance(ActuatorScale(), leg, (scale,)))
        if "cyclic" in figures:
            sine = figures["cyclic"] * 1e3
            effects.append(EffectInstance(ActuatorCyclic(5.0), leg, (sine, 0.0)))
        if "play" in figures:
            effects.append(EffectInstance(Backlash(), leg, (figures["play"],)))
    return Model(Geometry(), (*machine.offset_mm, 0.0, 0.0, 0.0), tuple(effects))


def worst_um(
    folder: Path,
    machine: Machine,
    model: Model,
    controller_joints: Sequence[ControllerJoint],
    home: Mapping[str, float | str],
    *,
    sign: float = 1.0,
    way: int = 1,
) -> float:
    """Largest departure of a carriage from what the controller believes, µm.

    ``sign`` -1 turns every entry round: the control. With ``way`` -1 joints count against drives.
    """
    entries, files = [], {}
    for k in range(3):
        correction = joint_entries(model, k, controller_joints[k], way)
        entry = {
            **home,
            "HOME_OFFSET": controller_joints[k].home_offset_mm + sign * correction.home_change_mm,
        }
        if correction.backlash_mm:
            entry["BACKLASH"] = sign * correction.backlash_mm
        if correction.table is not None:
            name = f"calib_joint{k}.comp"
            rows = np.loadtxt(table_text(correction.table).splitlines(), ndmin=2)
            rows[:, 1:] *= sign
            files[name] = "".join("{:.6f} {:.6f} {:.6f}\n".format(*row) for row in rows)
            entry |= {"COMP_FILE": name, "COMP_FILE_TYPE": 1}
        entries.append(entry)
    lines = [f"G21 G90 G53 G1 F30000 X{x} Y{y} Z{z}" for x, y, z in PLACES]
    hal = pins(Model(), joints=[(k, way) for k in range(3)])
    joints = [SimulatedJoint({**joint.figures, "way": way}) for joint in machine.joints()]
    stops = run(folder, joints, entries, hal, ["home", *lines], files=files)[1:]
    off = np.array([s.carriage for s in stops]) - way * np.array([s.joint for s in stops])
    return float(np.abs(off).max() * 1e3)


def on_switch(machine: Machine, way: float) -> list[ControllerJoint]:
    return [ControllerJoint(old_home_offset_mm(machine, k, way), int(way)) for k in range(3)]
