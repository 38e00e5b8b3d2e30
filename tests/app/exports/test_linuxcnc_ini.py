"""INI files read as LinuxCNC reads them: its own reader is the judge where it is installed."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from app.exports.linuxcnc_ini import Entries, read_controller
from calib.errors import GlidecalError
from tests.app.cli import glidecal, refused
from tests.conftest import LONG, ROOT

INIVAR, START = shutil.which("inivar"), shutil.which("linuxcnc")
SAMPLES = Path("/usr/share/doc/linuxcnc/examples/sample-configs")
ASKED = [
    ("TRAJ", "LINEAR_UNITS"),
    ("KINS", "KINEMATICS"),
    *((f"JOINT_{n}", key) for n in range(3) for key in ("HOME_OFFSET", "HOME_LATCH_VEL")),
]
INI = """[TRAJ]
LINEAR_UNITS = mm
[KINS]
KINEMATICS = trivkins
JOINTS = 3
[JOINT_0]
HOME_OFFSET = 375
HOME_LATCH_VEL = -1
[JOINT_1]
[JOINT_2]
HOME_OFFSET = 360.5
HOME_ABSOLUTE_ENCODER = 2
COMP_FILE = z.comp
"""


def written(folder: Path, text: str, **includes: str) -> Path:
    for name, content in {"a": text, **includes}.items():
        (folder / f"{name}.ini").write_text(content)
    return folder / "a.ini"


def test_joints_of_a_plain_file(tmp_path: Path) -> None:
    controller = read_controller(written(tmp_path, INI))
    assert [joint.home_offset_mm for joint in controller.joints] == [375.0, 0.0, 360.5]
    assert [joint.latch_sign for joint in controller.joints] == [-1, 0, 0]
    assert [joint.absolute_encoder for joint in controller.joints] == [False, False, True]
    assert [joint.compensated for joint in controller.joints] == [False, False, True]
    assert controller.axes is None


@pytest.mark.parametrize(
    ("old", "new", "expected_mm"),
    [
        ("[TRAJ]\nLINEAR_UNITS = mm", "[TRAJ] # t\nLINEAR_UNITS = inch", 375 * 25.4),
        ("LINEAR_UNITS = mm", "LINEAR_UNITS = 1.0", 375.0),
        ("LINEAR_UNITS = mm", "LINEAR_UNITS = 0.03937007874015748", 375 * 25.4),
        ("HOME_OFFSET = 375", "HOME_OFFSET = 375\nHOME_OFFSET = 1", 375.0),
        ("[JOINT_0]\nHOME_OFFSET = 375", "[JOINT_0]\n[JOINT_0]\nHOME_OFFSET = 375", 0.0),
        ("[JOINT_0]\n", "[JOINT_0]\n#INCLUDE b.ini\n", 360.0),
        ("[JOINT_0]\n", "[JOINT_0]\n#INCLUDE b.ini # new\n", 360.0),
        ("[JOINT_0]\n", "[JOINT_0]\n#INCLUDE 'b.ini'\n", 360.0),
        ("[JOINT_0]\n", "[JOINT_0]\n#INCLUDE c.ini\n", 375.0),  # its own include is a comment
        ("[JOINT_0]\n", "[JOINT_0]\n #INCLUDE b.ini\n", 375.0),
        ("HOME_OFFSET = 375", "HOME_OFFSET = 37\\\n5", 375.0),
        ("[JOINT_0]\n", "[JOINT_0]\n#INCLUDE gone.ini\n", 375.0),
    ],
)
def test_quirks_that_change_a_number(
    old: str, new: str, expected_mm: float, tmp_path: Path
) -> None:
    path = written(tmp_path, INI.replace(old, new), b="HOME_OFFSET = 360\n", c="#INCLUDE b.ini\n")
    assert read_controller(path).joints[0].home_offset_mm == pytest.approx(expected_mm)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("LINEAR_UNITS = mm\n", "", "LINEAR_UNITS: found nothing"),
        ("LINEAR_UNITS = mm", "LINEAR_UNITS = cubit", "LINEAR_UNITS: found 'cubit'"),
        ("HOME_OFFSET = 375", "HOME_OFFSET = 375 # old", "found '375 # old'"),
        ("HOME_OFFSET = 375", "HOME_OFFSET = 37,5", "found '37,5'"),
        ("HOME_OFFSET = 375", "HOME_OFFSET = 1e9", "found 1e+09 mm"),
        ("[JOINT_1]\n", "", "no section [JOINT_1]"),
        ("JOINTS = 3", "JOINTS = 2", "JOINTS: found 2"),
        ("[JOINT_0]\n", "[JOINT_0]\n#INCLUDE 'gone.ini\n", "the name of a file"),
    ],
)
def test_what_the_controller_would_not_start_with(
    old: str, new: str, message: str, tmp_path: Path
) -> None:
    with pytest.raises(GlidecalError, match=message.replace("[", r"\[").replace("+", r"\+")):
        read_controller(written(tmp_path, INI.replace(old, new)))


def inivar(path: Path, section: str, key: str) -> str | None:
    """What LinuxCNC's own reader says; None for nothing."""
    assert INIVAR is not None
    process = subprocess.run(
        [INIVAR, "-ini", path, "-sec", section, "-var", key],
        check=False,
        capture_output=True,
        text=True,
    )
    return process.stdout.rstrip("\n") or None if process.returncode == 0 else None


def expanded(path: Path) -> Path:
    """The file with its includes, by the shell function of LinuxCNC's start script."""
    assert START is not None
    script = 'GREP=grep; eval "$(sed -n "/^function handle_includes/,/^}/p" "$1")"; '
    process = subprocess.run(
        ["bash", "-c", f'{script} handle_includes "$2"', "x", START, path],
        check=True,
        capture_output=True,
        text=True,
    )
    return Path(process.stdout.strip().splitlines()[-1])


@LONG
@pytest.mark.skipif(not (INIVAR and SAMPLES.is_dir()), reason="needs LinuxCNC and its samples")
@pytest.mark.parametrize("part", range(3))
def test_every_sample_of_the_controller_reads_alike(tmp_path: Path, part: int) -> None:
    """Of its sample files, in a copy: 0 entries differ, and machines of three joints are taken."""
    copy = tmp_path / "samples"
    shutil.copytree(SAMPLES, copy, symlinks=True)
    different, count, refused = [], 0, []
    for path in sorted(copy.rglob("*.ini"))[part::3]:
        try:
            entries = Entries(path)
        except GlidecalError as problem:
            refused.append(f"{path.name}: {problem}")
            continue
        ini = expanded(path)
        for section, key in ASKED:
            ours, theirs = entries.find(section, key) or None, inivar(ini, section, key)
            if ours != theirs:
                different.append(f"{path}: [{section}] {key}: {ours!r}, {theirs!r}")
        try:
            read_controller(path)
            count += 1
        except GlidecalError as problem:
            refused.append(f"{path.name}: {problem}")
    assert not different, different
    assert count > 80
    reasons = ("JOINTS: found 2", "no section [JOINT", "LINEAR_UNITS: found nothing")
    assert not [words for words in refused if not any(r in words for r in reasons)], refused


LINE = st.sampled_from(
    [
        "[JOINT_0]",
        "[JOINT_0] # x",
        " [JOINT_0]x",
        "[JOINT_1]",
        "[",
        "# HOME_OFFSET = 1",
        "; HOME_OFFSET = 2",
        "HOME_OFFSET = 3",
        "\tHOME_OFFSET=4 ",
        "HOME_OFFSET",
        "HOME_OFFSET =",
        "HOME_OFFSETS = 5",
        "HOME_OFFSET x = 6",
        "HOME_OFFSET = 7 \\",
        "HOME_OFFSET : = 8",
        "home_offset = 9",
        "",
        "  ",
        "a = b = HOME_OFFSET = 10",
        "\\",
    ]
)


@pytest.mark.skipif(not INIVAR, reason="needs LinuxCNC")
@settings(
    max_examples=150,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(lines=st.lists(LINE, max_size=8))
def test_any_order_of_lines_reads_as_the_controller_reads_it(
    lines: list[str], tmp_path: Path
) -> None:
    path = written(tmp_path, "\n".join(lines) + "\n")
    assert (Entries(path).find("JOINT_0", "HOME_OFFSET") or None) == inivar(
        path, "JOINT_0", "HOME_OFFSET"
    )


def test_joints_of_the_machine_file_come_before_those_of_the_kinematics(tmp_path: Path) -> None:
    """Joint 0 moves z, joint 1 moves x and counts against it; home_offset_mm is by drive."""
    machine, session, out = (tmp_path / name for name in ("m.toml", "s.jsonl", "out"))
    machine.write_text(
        'schema = "glidecal.machine/1"\njoints = ["z", "-x", "y"]\nhome_offset_mm = [1, 2, 3.0]'
    )
    assert glidecal("simulate", "--machine", machine, "--seed", "2", "-o", session).status == 0
    correction = json.loads(glidecal("solve", session, "--json").out)["correction"]
    d_rho = {name: entry["value"] for name, entry in correction["values"].items()}
    run = glidecal("export", session, "--format", "linuxcnc", "-o", out)
    assert run.status == 0, run.err
    new = [3.0 + d_rho["d_rho_z"], 1.0 - d_rho["d_rho_x"], 2.0 + d_rho["d_rho_y"]]
    for n, value in enumerate(new):
        text = (out / f"calib_joint{n}.inc").read_text()
        assert f"HOME_OFFSET = {value:.6f}\n" in text
        assert ("runs against its drive" in " ".join(text.split())) == (n == 1)
    machine.write_text('schema = "glidecal.machine/1"\njoints = ["z", "-z", "y"]\n')
    message = refused(
        3, "simulate", "--machine", machine, "--seed", "2", "-o", tmp_path / "t.jsonl"
    )
    assert "each drive once" in message


def test_an_error_that_no_table_follows_is_refused_as_the_page_says(tmp_path: Path) -> None:
    """A screw of 1 mm with 90 µm along the travel of an orthoglide."""
    sizes = {"sine_1mm": {"value": 90.0, "unit": "µm"}, "cosine_1mm": {"value": 0.0, "unit": "µm"}}
    document = {
        "schema": "glidecal.model/1",
        "parameters_mm": dict.fromkeys(("d_rho_x", "d_rho_y", "d_rho_z"), 0.0),
        "effects": [{"id": "actuator_cyclic", "where": "x", "parameters": sizes}],
    }
    (tmp_path / "screw.json").write_text(json.dumps(document), encoding="utf-8")
    ini = written(tmp_path, INI.replace("COMP_FILE = z.comp\n", ""))
    options = ("--format", "linuxcnc", "--ini", ini, "-o", tmp_path / "out")
    assert "256 points leave" in refused(2, "export", tmp_path / "screw.json", *options)
    page = " ".join((ROOT / "docs" / "export.md").read_text(encoding="utf-8").split())
    (exit_2,) = re.findall(r"Also exit 2: ([^.]*)\.", page)
    assert "an error of which 256 points of a table leave a tenth" in exit_2
