"""What the carriages do after an export: travel, home switches, joints of a gantry."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from tests.app.cli import glidecal, refused

D_RHO = {"d_rho_x": 0.5, "d_rho_y": -0.25, "d_rho_z": 0.1}


def joint(number: int, **entries: object) -> str:
    return f"[JOINT_{number}]\n" + "".join(f"{key} = {v}\n" for key, v in entries.items())


def ini_of(*joints: dict[str, object], kins: str = "", unit: str = "mm", traj: str = "") -> str:
    kinematics = f"KINEMATICS = {kins}\n" if kins else ""
    head = f"[TRAJ]\nLINEAR_UNITS = {unit}\n{traj}[KINS]\n{kinematics}JOINTS = {len(joints)}\n"
    return head + "".join(joint(n, **entries) for n, entries in enumerate(joints))


PLAIN: dict[str, object] = {
    "MIN_LIMIT": 200,
    "MAX_LIMIT": 400,
    "HOME_OFFSET": 410,
    "HOME": 390,
    "HOME_SEARCH_VEL": 20,
    "HOME_LATCH_VEL": 5,
}
"""A switch 10 mm above the limit, reached on the way up."""


def arguments_of(
    folder: Path, ini: str | None, *effects: object, kind: str = "linuxcnc"
) -> list[str]:
    model = {"schema": "glidecal.model/1", "parameters_mm": D_RHO, "effects": effects}
    (folder / "m.json").write_text(json.dumps(model))
    arguments = ["export", str(folder / "m.json"), "--format", kind, "-o", str(folder / "out")]
    if ini is None:
        return arguments
    (folder / "m.ini").write_text(ini)
    return [*arguments, "--ini", str(folder / "m.ini")]


def exported(folder: Path, ini: str | None, *effects: object) -> tuple[dict[int, str], str]:
    """The text of each include without its line breaks, and standard error."""
    run = glidecal(*arguments_of(folder, ini, *effects))
    assert run.status == 0, run.err
    files = {
        int(path.stem[-1]): " ".join(path.read_text().replace("\n# ", " ").split())
        for path in (folder / "out").glob("*.inc")
    }
    return files, " ".join(run.err.split())


def home_offset(text: str) -> float:
    entry = re.search(r"HOME_OFFSET = (\S+)", text)
    assert entry
    return float(entry[1])


def test_each_file_says_what_its_carriage_travels_now_and_after(tmp_path: Path) -> None:
    """A carriage is d_rho further than the controller believes, so that its limits are, too."""
    files, err = exported(tmp_path, ini_of(PLAIN, PLAIN, PLAIN))
    for number, (now, excess) in enumerate(
        (("200.500 to 400.500", 10.5), ("199.750 to 399.750", 9.75), ("200.100 to 400.100", 10.1))
    ):
        travel = f"{now} mm now, 200.000 to 400.000 mm after the change"
        switch = f"above MAX_LIMIT by 10.000 mm now, by {excess:.3f} mm after the change"
        for text in (files[number], err):
            assert travel in text
            assert switch in text
    assert "199.750" not in files[0], "a file speaks of its own joint"


@pytest.mark.parametrize(
    ("entries", "limit", "allowed"),
    [
        ({"HOME_OFFSET": 400.2}, "MAX_LIMIT", "at most 399.950000"),
        ({"HOME_OFFSET": 400}, "MAX_LIMIT", "at most 399.750000"),
        (
            {"HOME_OFFSET": 199.9, "HOME_SEARCH_VEL": -20, "MIN_LIMIT": 200},
            None,
            "",
        ),
    ],
)
def test_a_switch_that_comes_inside_the_limits_is_refused(
    tmp_path: Path, entries: dict[str, object], limit: str | None, allowed: str
) -> None:
    """Joint y goes down by 0.25 mm: onto a switch above it, away from one below."""
    arguments = arguments_of(tmp_path, ini_of(PLAIN, PLAIN | entries, PLAIN))
    if limit is None:
        assert glidecal(*arguments).status == 0
        return
    words = refused(3, *arguments)
    assert f"[JOINT_1] {limit}: found 400.000000" in words
    assert "inside the limits" in words
    assert allowed in words
    assert not (tmp_path / "out").exists()


def test_a_switch_below_comes_inside_with_a_positive_offset(tmp_path: Path) -> None:
    below = PLAIN | {"HOME_OFFSET": 199.9, "HOME_SEARCH_VEL": -20, "HOME": 210}
    words = refused(3, *arguments_of(tmp_path, ini_of(below, PLAIN, PLAIN)))
    assert "[JOINT_0] MIN_LIMIT: found 200.000000" in words
    assert "at least 200.400000" in words


def test_the_limit_that_is_proposed_is_taken(tmp_path: Path) -> None:
    entries = PLAIN | {"HOME_OFFSET": 400.2, "MAX_LIMIT": 399.95}
    files, _ = exported(tmp_path, ini_of(PLAIN, entries, PLAIN))
    assert home_offset(files[1]) == pytest.approx(399.95)


def test_limits_in_inches_are_told_in_inches_for_the_file(tmp_path: Path) -> None:
    inch: dict[str, object] = {key: float(str(value)) / 25.4 for key, value in PLAIN.items()}
    close = inch | {"HOME_OFFSET": 400.2 / 25.4}
    words = refused(3, *arguments_of(tmp_path, ini_of(inch, close, inch, unit="inch")))
    assert f"at most {399.95 / 25.4:.6f}" in words
    files, _ = exported(tmp_path, ini_of(inch, inch, inch, unit="inch"))
    assert "199.750 to 399.750 mm now" in files[1]


def test_a_switch_that_stood_inside_already_is_told(tmp_path: Path) -> None:
    inside = PLAIN | {"HOME_OFFSET": 375, "HOME": 300}
    files, err = exported(tmp_path, ini_of(PLAIN, inside, PLAIN))
    for text in (files[1], err):
        assert "inside the limits now and after the change" in text
        assert "by 25.000 mm now, by 25.250 mm after the change" in text


def test_homing_that_ends_beyond_the_switch_is_told(tmp_path: Path) -> None:
    """HOME at the switch itself: with a lower HOME_OFFSET the last move runs onto it."""
    at_it = PLAIN | {"HOME": 410}
    files, _ = exported(tmp_path, ini_of(at_it, at_it, PLAIN))
    assert "WARNING: homing ends at HOME = 410" in files[1]
    assert "0.250 mm beyond the home switch" in files[1]
    assert "WARNING: homing ends" not in files[0]


@pytest.mark.parametrize(
    ("without", "words"),
    [
        ({"MAX_LIMIT"}, "not checked: the INI file states no MAX_LIMIT"),
        ({"MIN_LIMIT", "MAX_LIMIT"}, "not checked: the INI file states no MIN_LIMIT, no MAX_LIMIT"),
        ({"HOME_SEARCH_VEL"}, "no home switch: HOME_SEARCH_VEL is 0 or not stated"),
    ],
)
def test_what_the_ini_file_does_not_state_is_not_checked(
    tmp_path: Path, without: set[str], words: str
) -> None:
    close = {key: v for key, v in (PLAIN | {"HOME_OFFSET": 400.2}).items() if key not in without}
    files, err = exported(tmp_path, ini_of(PLAIN, close, PLAIN))
    assert words in files[1]
    assert words in err


def test_an_encoder_has_no_switch_and_an_index_is_not_the_switch(tmp_path: Path) -> None:
    close = PLAIN | {"HOME_OFFSET": 400.2}
    ini = ini_of(PLAIN, close | {"HOME_ABSOLUTE_ENCODER": 1}, close | {"HOME_USE_INDEX": "YES"})
    files, _ = exported(tmp_path, ini)
    assert "no home switch: absolute encoder" in files[1]
    assert "the home switch was not checked: HOME_OFFSET is the place of the index" in files[2]


def test_without_an_ini_file_nothing_is_checked(tmp_path: Path) -> None:
    files, err = exported(tmp_path, None)
    words = "Not checked without an INI file (--ini): which joint moves which drive, travel, limits"
    assert all(words in text for text in (*files.values(), err))


def test_effects_along_a_drive_move_its_limits(tmp_path: Path) -> None:
    """1 mm/m from Zero at 310.25 mm: what the carriage is off is not the same at both limits."""
    scale = {
        "id": "actuator_scale",
        "where": "y",
        "parameters": {"scale": {"value": 1.0, "unit": "mm/m"}},
    }
    files, _ = exported(tmp_path, ini_of(PLAIN, PLAIN, PLAIN), scale)
    low, high = 200 - 0.25 + (200 - 310.25) / 1000, 400 - 0.25 + (400 - 310.25) / 1000
    assert f"{low:.3f} to {high:.3f} mm now, 200.000 to 400.000 mm after" in files[1]


# which joint moves which drive


def numbered(count: int) -> list[dict[str, object]]:
    return [{"HOME_OFFSET": number} for number in range(count)]


@pytest.mark.parametrize(
    ("kins", "legs"),
    [
        ("trivkins coordinates=XYYZ kinstype=BOTH", "xyyz"),
        ("trivkins coordinates=xxyz", "xxyz"),
        ("trivkins coordinates=ZYXX", "zyxx"),
        ("trivkins coordinates=XYZ", "xyz"),
        ("trivkins", "xyz"),
        ("", "xyz"),
        ("orthoglidekins", "xyz"),
    ],
)
def test_every_joint_of_a_drive_gets_its_offset(tmp_path: Path, kins: str, legs: str) -> None:
    files, _ = exported(tmp_path, ini_of(*numbered(len(legs)), kins=kins))
    assert sorted(files) == list(range(len(legs)))
    for number, leg in enumerate(legs):
        assert f"joint {number} ({leg}) of" in files[number]
        assert home_offset(files[number]) == pytest.approx(number + D_RHO[f"d_rho_{leg}"])


@pytest.mark.parametrize(
    ("kins", "count", "traj", "part"),
    [
        ("trivkins coordinates=XYZA", 4, "", "letters X, Y and Z"),
        ("trivkins coordinates=XZ", 3, "", "letters X, Y and Z"),
        ("trivkins coordinates=XYYZ", 3, "", "3 joints"),
        ("trivkins", 4, "COORDINATES = X Y Y Z\n", "coordinates="),
        ("trivkins", 4, "", "coordinates="),
        ("trivkins", 3, "COORDINATES = X Y A\n", "coordinates="),
        ("", 4, "COORDINATES = XYYZ\n", "coordinates="),
        ("gantrykins", 4, "", "coordinates="),
        ("xyzac-trt-kins coordinates=XYZAC", 5, "", "coordinates="),
    ],
)
@pytest.mark.parametrize("kind", ["linuxcnc", "linuxcnc-kins"])
def test_joints_of_unclear_drives_are_refused_by_name(
    tmp_path: Path, kins: str, count: int, traj: str, part: str, kind: str
) -> None:
    arguments = arguments_of(tmp_path, ini_of(*numbered(count), kins=kins, traj=traj), kind=kind)
    words = refused(3, *arguments)
    assert part in words
    assert (kins or "COORDINATES") in words
    assert not (tmp_path / "out").exists()


def test_own_kinematics_take_one_joint_a_drive(tmp_path: Path) -> None:
    ini = ini_of(*numbered(4), kins="trivkins coordinates=XYYZ")
    words = refused(2, *arguments_of(tmp_path, ini, kind="linuxcnc-kins"))
    assert "joints 1 and 2 on drive y" in words


def test_joints_of_the_machine_file_are_three(tmp_path: Path) -> None:
    """It says which drive each of three joints moves; of a fourth it says nothing."""
    arguments_of(tmp_path, None)
    model = json.loads((tmp_path / "m.json").read_text())
    model["machine"] = {"schema": "glidecal.machine/1", "joints": ["y", "x", "z"]}
    for kins, status in (("trivkins coordinates=XYYZ", 3), ("orthoglidekins", 0)):
        arguments = arguments_of(tmp_path, ini_of(*numbered(4), kins=kins))
        (tmp_path / "m.json").write_text(json.dumps(model))
        run = glidecal(*arguments)
        assert run.status == status, run.err
    assert "joint 0 (y) of" in (tmp_path / "out" / "calib_joint0.inc").read_text()
