"""Measure in LinuxCNC, find, export, home again, measure: what is the tool off by?

Indicators of 2 µm that show steps of 1 µm; readings and tool by the geometry of `machine.py`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.app.cli import glidecal
from tests.conftest import LONG
from tests.controller.loop import OFFSETS, Loop
from tests.controller.machine import Machine

pytestmark = LONG

WORN = {"play": 0.06, "cyclic": 0.01}


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Loop:
    return Loop(Machine(OFFSETS), tmp_path_factory.mktemp("plain"))


@pytest.fixture(scope="module")
def worn(tmp_path_factory: pytest.TempPathFactory) -> Loop:
    return diagnosed(Machine(OFFSETS, joint=WORN), tmp_path_factory.mktemp("worn"))


@pytest.fixture(scope="module")
def scaled(tmp_path_factory: pytest.TempPathFactory) -> Loop:
    machine = Machine(OFFSETS, joint=WORN, one={2: {"scale": 5e-4}})
    return diagnosed(machine, tmp_path_factory.mktemp("scaled"))


@pytest.fixture(scope="module")
def crooked(tmp_path_factory: pytest.TempPathFactory) -> Loop:
    lean, shift = np.zeros((3, 3)), np.zeros((3, 3))
    lean[0, 1] = lean[1, 0] = 1e-3  # x and y lean together by 2 mrad
    shift[0, 2], shift[2, 1] = 0.2, -0.2
    machine = Machine(OFFSETS, (0.3, -0.2, 0.1), lean=lean, shift_mm=shift)
    return diagnosed(machine, tmp_path_factory.mktemp("crooked"), zero_set=True)


def diagnosed(machine: Machine, folder: Path, *, zero_set: bool = False) -> Loop:
    """Measured once for all its tests, with 15 seconds of moves, and what was found adopted."""
    loop = Loop(machine, folder, zero_set=zero_set)
    loop.do("diagnose", loop.session, "--adopt", loop.model)
    return loop


def test_offsets(plain: Loop) -> None:
    assert plain.before_mm > 1.0
    assert plain.after_mm("after", plain.session, "--format", "linuxcnc") < 0.003


ALONE = ("--format", "linuxcnc", "--subset", "joint-offsets")


def test_offsets_alone_do_not_mend_play_and_screw_error(worn: Loop) -> None:
    assert worn.after_mm("offsets", worn.session, *ALONE) > 0.03


def test_play_and_screw_error_that_diagnose_names(worn: Loop) -> None:
    assert worn.after_mm("found", worn.model, "--format", "linuxcnc") < 0.006


def test_play_and_screw_error_without_a_name(worn: Loop) -> None:
    """Nothing is adopted: the correction of the session has tables for the joints."""
    assert worn.after_mm("session", worn.session, "--format", "linuxcnc") < 0.006


def test_offsets_alone_do_not_mend_a_scale_of_one_drive(scaled: Loop) -> None:
    assert scaled.after_mm("offsets", scaled.session, *ALONE) > 0.03


def test_a_scale_of_one_drive_beside_them(scaled: Loop) -> None:
    """That of all drives alike is a larger machine: readings of legs hardly show it."""
    assert scaled.after_mm("found", scaled.model, "--format", "linuxcnc") < 0.006


@pytest.mark.parametrize("sign", [1.0, -1.0], ids=["entered", "turned"])
def test_lengths_and_axes_through_own_kinematics(sign: float, crooked: Loop) -> None:
    options = (crooked.session, "--model", crooked.model, "--subset", "both")
    name = "entered" if sign > 0 else "turned"
    after_mm = crooked.after_mm(name, *options, "--format", "linuxcnc-kins", sign=sign)
    if sign > 0:
        assert after_mm < 0.010
    else:
        assert after_mm > crooked.before_mm


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
