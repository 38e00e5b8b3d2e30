"""Measure in LinuxCNC, find, export, home again, measure: what is the tool off by?

Indicators of 2 µm that show steps of 1 µm; readings and tool by the geometry of `machine.py`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.app.cli import glidecal
from tests.controller.loop import OFFSETS, Loop
from tests.controller.machine import Machine


def test_offsets(tmp_path: Path) -> None:
    loop = Loop(Machine(OFFSETS), tmp_path)
    assert loop.before_mm > 1.0
    assert loop.after_mm("after", loop.session, "--format", "linuxcnc") < 0.003


def test_play_and_screw_error_that_diagnose_names(tmp_path: Path) -> None:
    machine = Machine(OFFSETS, joint={"play": 0.06, "cyclic": 0.01})
    loop = Loop(machine, tmp_path)
    model = tmp_path / "found.json"
    loop.do("diagnose", loop.session, "--adopt", model)
    assert loop.after_mm("offsets", loop.session, "--format", "linuxcnc") > 0.03
    assert loop.after_mm("found", model, "--format", "linuxcnc") < 0.006


def test_a_scale_of_one_drive_beside_them(tmp_path: Path) -> None:
    """That of all drives alike is a larger machine: readings of legs hardly show it."""
    machine = Machine(OFFSETS, joint={"play": 0.06, "cyclic": 0.01}, one={2: {"scale": 5e-4}})
    loop = Loop(machine, tmp_path)
    model = tmp_path / "found.json"
    loop.do("diagnose", loop.session, "--adopt", model)
    assert loop.after_mm("offsets", loop.session, "--format", "linuxcnc") > 0.03
    asked = ("--format", "linuxcnc", "--ambiguous")  # a law without a name would do as well
    assert loop.after_mm("found", model, *asked) < 0.006


def test_lengths_and_axes_through_own_kinematics(tmp_path: Path) -> None:
    lean, shift = np.zeros((3, 3)), np.zeros((3, 3))
    lean[0, 1] = lean[1, 0] = 1e-3  # x and y lean together by 2 mrad
    shift[0, 2], shift[2, 1] = 0.2, -0.2
    machine = Machine(OFFSETS, (0.3, -0.2, 0.1), lean=lean, shift_mm=shift)
    loop = Loop(machine, tmp_path, zero_set=True)
    model = tmp_path / "found.json"
    loop.do("diagnose", loop.session, "--adopt", model)
    asked = (loop.session, "--model", model, "--subset", "both", "--format", "linuxcnc-kins")
    assert loop.after_mm("found", *asked) < 0.010
    assert loop.after_mm("turned", *asked, sign=-1.0) > loop.before_mm


@pytest.mark.parametrize("axes", ["xyz", "zxy"])
def test_joints_follow_the_axes_of_the_kinematics(axes: str, samples: Path, tmp_path: Path) -> None:
    """Joint n is the axis that [KINS] names n-th; nothing is started."""
    ini = tmp_path / "a.ini"
    ini.write_text(
        f"[TRAJ]\nLINEAR_UNITS = inch\n[KINS]\nKINEMATICS = trivkins coordinates={axes}\n"
        + "".join(f"[JOINT_{n}]\nHOME_OFFSET = {n + 1}\n" for n in range(3))
    )
    session = samples / "experiment_2_twelve.jsonl"
    offsets = ("--format", "linuxcnc", "--method", "linear", "--ini", ini, "-o", tmp_path / "o")
    assert glidecal("export", session, *offsets).status == 0
    d_rho = dict(zip("xyz", (-0.485579, 0.498965, -1.671230), strict=True))
    for n, axis in enumerate(axes):
        text = (tmp_path / "o" / f"calib_joint{n}.inc").read_text()
        assert f"joint {n} ({axis})" in text
        assert f"HOME_OFFSET = {n + 1 + d_rho[axis] / 25.4:.6f}" in text
