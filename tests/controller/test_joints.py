"""Entries of joints in LinuxCNC: is the carriage where the controller believes it to be?"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from app.exports.linuxcnc_ini import ControllerJoint
from app.exports.linuxcnc_joints import joint_entries, table_text
from app.exports.linuxcnc_kins import kinematics_files
from calib.tripod.effects.actuators import ActuatorCyclic, ActuatorScale, Backlash
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.geometry import Geometry
from calib.tripod.pipeline import Model
from tests.controller.running import SimulatedJoint, need_linuxcnc, run

L = Geometry().leg_length_mm[0]
SWITCH_MM = 345.0
OFFSETS = (0.8, -1.3, 0.45)
LATCH_MM_S = 1.0
WHOLE = {"scale": 0.5, "cyclic": 10.0, "play": 0.06}
PLACES = [(0, 0, 0), (60, 0, 0), (0, 0, 0), (0, 60, 0), (0, 0, 60), (-60, 0, 0), (0, -60, -60)]


def truth(figures: dict[str, float]) -> Model:
    """The machine as glidecal would have found it."""
    effects = []
    for leg in "xyz":
        if "scale" in figures:
            effects.append(EffectInstance(ActuatorScale(), leg, (figures["scale"],)))
        if "cyclic" in figures:
            effects.append(EffectInstance(ActuatorCyclic(5.0), leg, (figures["cyclic"], 0.0)))
        if "play" in figures:
            effects.append(EffectInstance(Backlash(), leg, (figures["play"],)))
    return Model(Geometry(), (*OFFSETS, 0.0, 0.0, 0.0), tuple(effects))


def rig(figures: dict[str, float], offset: float) -> SimulatedJoint:
    """The same as a machine: believed q = motor + L, so the carriage begins at q + offset."""
    return SimulatedJoint(
        {
            "mounting": L + offset,
            "scale": figures.get("scale", 0.0) / 1e3,
            "cyclic": figures.get("cyclic", 0.0) / 1e3,
            "lead": 5.0,
            "play": figures.get("play", 0.0),
            "zero": L + offset,
            "switch_at": SWITCH_MM,
        }
    )


def believed_switch(figures: dict[str, float], offset: float, way: float) -> float:
    """The coordinate at which the uncorrected controller met the switch: its old HOME_OFFSET."""
    q = SWITCH_MM
    for _ in range(50):
        x = q - L
        off = offset + figures.get("scale", 0.0) / 1e3 * x
        off += figures.get("cyclic", 0.0) / 1e3 * np.sin(2 * np.pi * x / 5.0)
        off += figures.get("play", 0.0) * (way < 0)
        q = SWITCH_MM - off
    return float(q)


def worst_um(
    folder: Path,
    figures: dict[str, float],
    *,
    way: float = 1.0,
    sign: float = 1.0,
    told: Model | None = None,
) -> float:
    """Largest departure of a carriage from what the controller believes, µm.

    ``sign`` -1 turns every entry round: the control.
    """
    model, entries, files = told or truth(figures), [], {}
    for k in range(3):
        old = believed_switch(figures, OFFSETS[k], way)
        held = ControllerJoint(old, int(way))
        given = joint_entries(model, k, held)
        entry: dict[str, float | str] = {
            "HOME": L,
            "HOME_OFFSET": old + sign * given.home_change_mm,
            "HOME_SEARCH_VEL": 40.0,
            "HOME_LATCH_VEL": LATCH_MM_S * way,
            "MAX_ACCELERATION": 1000,  # so that it runs past the switch by more than corrections
        }
        if given.backlash_mm:
            entry["BACKLASH"] = sign * given.backlash_mm
        if given.table is not None:
            name = f"calib_joint{k}.comp"
            rows = np.loadtxt(table_text(given.table).splitlines(), ndmin=2)
            rows[:, 1:] *= sign
            files[name] = "".join("{:.6f} {:.6f} {:.6f}\n".format(*row) for row in rows)
            entry |= {"COMP_FILE": name, "COMP_FILE_TYPE": 1}
        entries.append(entry)
    lines = [f"G21 G90 G53 G1 F6000 X{x} Y{y} Z{z}" for x, y, z in PLACES]
    joints = [rig(figures, offset) for offset in OFFSETS]
    hal = kinematics_files(Model())["calib.hal"]
    stops = run(folder, joints, entries, hal, ["home", *lines], files=files)[1:]
    off = np.array([s.carriage for s in stops]) - np.array([s.joint for s in stops])
    print(np.round(off * 1e3, 1), [s.trim for s in stops])
    return float(np.abs(off).max() * 1e3)


@pytest.mark.parametrize("way", [1.0, -1.0], ids=["latched-up", "latched-down"])
@pytest.mark.parametrize(
    "figures",
    [{}, {"play": 0.06}, {"scale": 0.5}, WHOLE],
    ids=["offsets", "play", "scale", "whole"],
)
def test_the_carriage_is_where_it_is_believed(
    figures: dict[str, float], way: float, tmp_path: Path
) -> None:
    need_linuxcnc()
    assert worst_um(tmp_path, figures, way=way) < 3.0


def test_with_the_signs_turned_it_is_worse_than_before(tmp_path: Path) -> None:
    need_linuxcnc()
    before = worst_um(tmp_path / "before", WHOLE, told=Model())
    turned = worst_um(tmp_path / "turned", WHOLE, sign=-1.0)
    assert before > 1000.0
    assert turned > 1.5 * before
