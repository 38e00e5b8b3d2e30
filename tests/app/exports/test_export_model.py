"""What LinuxCNC is given of a model with effects; that it is right, tests/controller tries."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from app.evaluating.solution import solve_files
from calib.tripod.geometry import PARAMETER_NAMES
from tests.app.cli import glidecal, refused
from tests.conftest import LONG

INI = "[TRAJ]\nLINEAR_UNITS = mm\n" + "".join(
    f"[JOINT_{n}]\nHOME_OFFSET = {300 + n}\nHOME_LATCH_VEL = -1\n" for n in range(3)
)
D_RHO = {"d_rho_x": 0.5, "d_rho_y": -0.25, "d_rho_z": 0.0}


def effect(name: str, where: str, verdict: str = "explained", **values: float) -> dict[str, object]:
    units = {"play": "mm", "scale": "mm/m", "shift": "mm", "gain": "%"}
    return {
        "id": name,
        "where": where,
        "parameters": {key: {"value": v, "unit": units[key]} for key, v in values.items()},
        "provenance": {"sessions": ["a.jsonl"], "verdict": verdict},
    }


def exported(
    folder: Path, *effects: dict[str, object], ini: str = INI, kind: str = "linuxcnc"
) -> dict[str, str]:
    arguments = asked_of(folder, *effects, ini=ini, kind=kind)
    run = glidecal(*arguments)
    assert run.status == 0, run.err
    return {path.name: path.read_text() for path in (folder / "out").iterdir()}


def asked_of(
    folder: Path, *effects: dict[str, object], ini: str = INI, kind: str = "linuxcnc"
) -> tuple[str | Path, ...]:
    document = {"schema": "glidecal.model/1", "parameters_mm": D_RHO, "effects": effects}
    (folder / "m.json").write_text(json.dumps(document))
    (folder / "m.ini").write_text(ini)
    files = ("--ini", folder / "m.ini", "-o", folder / "out")
    return ("export", folder / "m.json", "--format", kind, *files)


def entry(text: str, key: str) -> str | None:
    lines = [line for line in text.splitlines() if line.startswith(f"{key} = ")]
    return lines[0].partition(" = ")[2] if lines else None


def test_no_error_is_made_up_at_a_switch_far_from_the_travel(tmp_path: Path) -> None:
    """Of 209 mm of polynomial beyond the travel came 0.4 mm of HOME_OFFSET, without a word."""
    far = INI.replace("HOME_OFFSET = 301", "HOME_OFFSET = 1.5")
    arguments = asked_of(tmp_path, effect("actuator_scale", "y", scale=2.0), ini=far)
    words = refused(2, *arguments)
    assert "HOME_OFFSET of the joint of drive y" in words
    assert "1.5 mm" in words
    assert "210.25 to 370.25 mm" in words
    only_play = exported(tmp_path, effect("backlash", "y", play=0.06), ini=far)
    assert entry(only_play["calib_joint1.inc"], "HOME_OFFSET") == "1.310000"
    encoder = far.replace("HOME_LATCH_VEL = -1", "HOME_ABSOLUTE_ENCODER = 1")
    (tmp_path / "new").mkdir()
    document = exported(tmp_path / "new", effect("actuator_scale", "y", scale=2.0), ini=encoder)
    assert entry(document["calib_joint1.inc"], "HOME_OFFSET") == "1.250000"


def test_play_is_backlash_and_latched_downwards_in_home_offset(tmp_path: Path) -> None:
    files = exported(tmp_path, effect("backlash", "y", play=0.06))
    assert entry(files["calib_joint1.inc"], "BACKLASH") == "0.060000"
    assert float(entry(files["calib_joint1.inc"], "HOME_OFFSET") or 0) == pytest.approx(
        301 - 0.25 + 0.06
    )
    assert entry(files["calib_joint0.inc"], "BACKLASH") is None
    assert entry(files["calib_joint0.inc"], "HOME_OFFSET") == "300.500000"
    assert "and +0.060000 mm that homing meets at the switch" in files["calib_joint1.inc"]


def test_play_is_added_to_what_the_joint_takes_already(tmp_path: Path) -> None:
    ini = INI.replace("HOME_OFFSET = 301\n", "HOME_OFFSET = 301\nBACKLASH = 0.02\n")
    files = exported(tmp_path, effect("backlash", "y", play=0.06), ini=ini)
    assert entry(files["calib_joint1.inc"], "BACKLASH") == "0.080000"


def test_scale_is_a_table_with_numbers_alone(tmp_path: Path) -> None:
    files = exported(tmp_path, effect("actuator_scale", "x", scale=0.5))
    assert entry(files["calib_joint0.inc"], "COMP_FILE") == "calib_joint0.comp"
    rows = [[float(v) for v in line.split()] for line in files["calib_joint0.comp"].splitlines()]
    assert len(rows) == 2
    for q, up, down in rows:  # believed once 0.5 mm is entered: 0.5 mm of the way is the offset
        assert up == down == pytest.approx(-0.5e-3 * (q - 0.5 - 310.25), abs=1e-4)


def test_a_table_in_inches(tmp_path: Path) -> None:
    ini = INI.replace("= mm", "= inch").replace("HOME_OFFSET = 30", "HOME_OFFSET = 11.8")
    files = exported(tmp_path, effect("actuator_scale", "x", scale=0.5), ini=ini)
    first, second = (line.split() for line in files["calib_joint0.comp"].splitlines())
    assert (float(second[0]) - float(first[0])) * 25.4 == pytest.approx(160.0, abs=1e-3)


def test_options_of_sessions_are_refused_beside_a_model(tmp_path: Path) -> None:
    """Before: ignored."""
    *command, _, _, _, _ = asked_of(tmp_path)
    for option in (
        ("--subset", "both"),
        ("--method", "linear"),
        ("--frame", "machine"),
        ("--model", tmp_path / "m.json"),
    ):
        message = refused(2, *command, *option, "-o", tmp_path / "out")
        assert "m.json. Allowed: sessions: an export of a model has its own values" in message
    assert not (tmp_path / "out").exists()


def test_what_is_not_in_the_files_is_said_with_what_it_leaves(tmp_path: Path) -> None:
    shift, gain = effect("axis_offset", "xy", shift=0.2), effect("gauge_gain", "xy", gain=1.0)
    text = " ".join(exported(tmp_path, shift, gain)["calib_joint0.inc"].replace("# ", "").split())
    assert (
        "not in these files: axis_offset; joint offsets take over a part, the rest leaves 0.0"
        in text
    )
    assert "gauge_gain" not in text, "it moves no tool"


def test_own_kinematics_hold_the_axes(tmp_path: Path) -> None:
    files = exported(tmp_path, effect("axis_offset", "xy", shift=0.2), kind="linuxcnc-kins")
    assert "setp orthoglidekins.origin-0-y 0.2\n" in files["calib.hal"]
    assert "setp orthoglidekins.length-2 310.25\n" in files["calib.hal"]
    assert "setp orthoglidekins.side -1\n" in files["calib.hal"]
    assert files["orthoglidekins.comp"].startswith("// SPDX-License-Identifier: GPL-2.0-or-later")
    assert "in these files: axis_offset" in files["calib_joint0.inc"]


def test_an_ambiguous_effect_is_exported_with_its_sentence(tmp_path: Path) -> None:
    files = exported(tmp_path, effect("backlash", "y", "ambiguous", play=0.06))
    words = files["calib_joint0.inc"].replace("\n# ", " ")
    assert "backlash (y), one of several effects that explain the readings" in words


@LONG
def test_an_ambiguous_effect_is_said_to_be_one_wherever_the_model_is_used(
    samples: Path, tmp_path: Path
) -> None:
    asked_of(tmp_path, effect("backlash", "y", "ambiguous", play=0.06))
    model, session = tmp_path / "m.json", samples / "simulated_sweep.jsonl"
    text = glidecal("model", model).out
    assert "WARNING: The model contains backlash (y)" in text
    for verb in ("solve", "diagnose"):
        run = glidecal(verb, session, "--model", model)
        assert run.status == 0
        message = " ".join(f"{run.out} {run.err}".split())
        assert "one of several effects that explain the readings" in message


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"play": -0.06}, "play that is not negative"),
        ({"play": 500.0}, "less than its travel, 160 mm"),
        ({"ini": INI.replace("HOME_OFFSET = 301", "COMP_FILE = y.comp")}, "another one in the INI"),
    ],
)
def test_what_a_joint_cannot_take(tmp_path: Path, change: dict[str, object], message: str) -> None:
    play, ini = float(str(change.get("play", 0.06))), str(change.get("ini", INI))
    assert message in refused(2, *asked_of(tmp_path, effect("backlash", "y", play=play), ini=ini))
    assert not (tmp_path / "out").exists()


def test_effects_along_a_drive_need_the_place_of_the_switch(tmp_path: Path) -> None:
    arguments = asked_of(tmp_path, effect("backlash", "y", play=0.06))
    without = [*arguments[:4], "-o", tmp_path / "out"]
    for homing in ((), ("--home-offset", "300,301,302")):
        assert "where and how the joints home" in refused(2, *without, *homing)


@LONG
def test_adopting_states_fitted_offsets_and_none_that_nobody_fitted(tmp_path: Path) -> None:
    """Two sessions with different offsets entered have no common ones: an export is refused."""
    hidden = ("--effect", "backlash:x", "--size", "0.05", "--protocol", "two-station")
    for name, entered in (("a", "[0.0, 0.0, 0.0]"), ("b", "[0.3, 0.0, 0.0]")):
        machine = tmp_path / f"{name}.toml"
        machine.write_text(f'schema = "glidecal.machine/1"\nentered_offsets_mm = {entered}\n')
        session = tmp_path / f"{name}.jsonl"
        run = glidecal("simulate", *hidden, "--machine", machine, "-o", session)
        assert run.status == 0, run.err
    model_of_one, model_of_both = tmp_path / "one.json", tmp_path / "both.json"
    sessions = (tmp_path / "a.jsonl", tmp_path / "b.jsonl")
    assert glidecal("diagnose", sessions[0], "--adopt", model_of_one).status == 0
    assert glidecal("diagnose", *sessions, "--adopt", model_of_both).status == 0
    result = solve_files([sessions[0]], model=model_of_one)
    stated = json.loads(model_of_one.read_text())["parameters_mm"]
    expected = dict(zip(PARAMETER_NAMES, result.corrections.posterior.mean.tolist(), strict=False))
    assert stated == pytest.approx(expected, abs=1e-4)  # about a mean, not about the file
    assert [size.name for size in result.solution.sizes] == ["backlash x: play"]
    assert json.loads(model_of_both.read_text())["parameters_mm"] == {}
    (tmp_path / "m.ini").write_text(INI)
    export = ("export", model_of_both, "--format", "linuxcnc", "--ini", tmp_path / "m.ini")
    assert "an offset that is not stated is not 0" in refused(3, *export, "-o", tmp_path / "o")


@pytest.mark.parametrize("day", [(), ("--measured-on", "2008-05-12")])
def test_offsets_of_an_imported_table_are_not_entered_twice(
    day: tuple[str, ...], samples: Path, tmp_path: Path
) -> None:
    """Its record is what an include can name to the minute; nobody knows when in the day it was."""
    table, ini = samples / "tables" / "experiment_2_twelve.csv", tmp_path / "m.ini"
    session, out = tmp_path / "s.jsonl", tmp_path / "out"
    assert glidecal("import", table, *day, "-o", session).status == 0
    ini.write_text(
        "[TRAJ]\nLINEAR_UNITS = mm\n"
        + "".join(
            f"[JOINT_{n}]\n#INCLUDE out/calib_joint{n}.inc\nHOME_OFFSET = 300\n" for n in range(3)
        )
    )
    arguments = ("export", session, "--format", "linuxcnc", "--method", "linear", "--ini", ini)
    run = glidecal(*arguments, "-o", out)
    assert run.status == 0, run.err
    assert "joints with the offsets of a session of" in refused(
        2, *arguments, "-o", tmp_path / "new"
    )


def test_a_model_file_says_when_its_session_began(samples: Path, tmp_path: Path) -> None:
    model, out = tmp_path / "m.json", tmp_path / "o.csv"
    session = samples / "simulated_zero-max-min.jsonl"
    adopting = ("diagnose", session, "--adopt", model, "--candidate", "gravity_sag:y")
    run = glidecal(*adopting)
    assert run.status == 0, run.err
    assert glidecal("export", model, "--format", "csv", "-o", out).status == 0
    assert re.search(r"measured 20\d\d-\d\d-\d\d \d\d:\d\d \+0000, digest", out.read_text())


def test_what_the_joints_hold_already_is_not_entered_twice(samples: Path, tmp_path: Path) -> None:
    """The include of an export stands in the INI file: that export once more would add to it."""
    session, out = samples / "simulated_sweep.jsonl", tmp_path
    ini = tmp_path / "m.ini"
    joints = "".join(
        f"[JOINT_{n}]\n#INCLUDE calib_joint{n}.inc\nHOME_OFFSET = 300\n" for n in range(3)
    )
    ini.write_text(f"[TRAJ]\nLINEAR_UNITS = mm\n{joints}")
    arguments = ("export", session, "--format", "linuxcnc", "--ini", ini, "-o", out)
    assert glidecal(*arguments).status == 0
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    assert "joints with the offsets of a session of" in refused(2, *arguments)
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before
    later = tmp_path / "later.jsonl"
    assert glidecal("simulate", "--seed", "3", "-o", later).status == 0
    assert glidecal(*("export", later, *arguments[2:]), "--force").status == 0
    assert "joints with the offsets" in refused(2, *arguments)
