"""A platform of telescopic legs, by its machine file alone: every verb of sessions of postures."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from protocols.hexaslide import load_hexaslide
from protocols.hexaslide_session import read_postures
from tests.app.cli import glidecal, refused
from tests.conftest import LONG, ROOT
from tests.controller.running import SimulatedJoint, need_linuxcnc, run

POINTS = ("start_mm", "joint_mm")
MIXED = "of six chains have a rail; all of them, or none"
FILE = ROOT / "protocols" / "machines" / "gough-stewart.toml"


def test_no_code_names_it() -> None:
    rooms = ("app", "calib", "protocols", "drivers", "glidecal")
    files = [path for room in rooms for path in (ROOT / room).rglob("*.py")]
    assert len(files) > 200
    naming = [path for path in files if re.search("gough|stewart", path.read_text("utf-8"), re.I)]
    assert naming == []


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A session in postures that were looked for, and the machine file that it gives."""
    folder = tmp_path_factory.mktemp("measured")
    postures, session, entered = folder / "p.csv", folder / "before.jsonl", folder / "m.toml"
    search = ("--procedure", "position", "--count", "18", "--starts", "1", "-o", postures)
    assert glidecal("postures", FILE, *search).status == 0
    arguments = ("run", "--machine", FILE, "--protocol", "position", "--posture-file", postures)
    assert glidecal(*arguments, "--simulated", "--seed", "3", "-o", session).status == 0
    assert glidecal("export", session, "--format", "model", "-o", entered).status == 0
    return session, entered


@LONG
def test_the_machine_is_found_and_verified(measured: tuple[Path, Path], tmp_path: Path) -> None:
    before, entered = measured
    assert glidecal("validate", before).status == 0
    result = json.loads(glidecal("solve", before, "--held-out", "0", "--json").out)
    assert (result["rank"], result["parameter_count"], result["lost_count"]) == (34, 37, 3)
    assert not [name for name in result["parameters"] if name.startswith("a")]
    diagnosis = json.loads(glidecal("diagnose", before, "--json").out)
    assert (diagnosis["verdict"], diagnosis["named"]) == ("agrees", [])
    after = tmp_path / "after.jsonl"
    postures = before.with_name("p.csv")
    again = ("run", "--machine", entered, "--protocol", "position", "--posture-file", postures)
    run_again = glidecal(*again, "--simulated", "--seed", "4", "--behind", before, "-o", after)
    assert run_again.status == 0, run_again.err
    verified = glidecal("verify", before, after, "--tolerance", "0.1", "--json")
    assert verified.status == 0, verified.out
    document = json.loads(verified.out)
    assert document["decision"] == "pass"
    off_mm = [document[f"platform_{when}"]["now_rms_mm"] for when in ("before", "after")]
    assert off_mm[1] < 0.02 * off_mm[0]
    report = glidecal("report", before, "--after", after, "-o", "-", "--tolerance", "0.1")
    assert report.status == 0, report.err
    text = " ".join(re.sub(r"<[^>]+>", " ", report.out).split())
    assert "PASS, measured again: the platform" in text
    assert "rails, as far" not in text
    chain = load_hexaslide(entered).chain[3]
    assert f"4 link_mm +590.0000 {chain.link_mm:+.4f}" in text


def test_the_exported_machine_is_where_its_readings_say(measured: tuple[Path, Path]) -> None:
    """The places that were measured, from the drives by the definition of the machine, in scipy."""
    session, entered = measured
    machine, chains = load_hexaslide(entered), load_hexaslide(entered).chain
    assert machine.before_calibration == "gough-stewart"
    base, joint = (np.array([getattr(chain, key) for chain in chains]) for key in POINTS)
    zero = np.array([chain.link_mm for chain in chains])
    recorded, _ = read_postures(session)
    for reading in recorded.readings:
        posture = np.array(recorded.opened.procedure.postures[reading.posture - 1])
        posture[3:] = np.radians(posture[3:])
        for _ in range(8):

            def lengths(at: np.ndarray) -> np.ndarray:
                turned = Rotation.from_euler("YXZ", at[3:]).apply(joint)
                return np.asarray(np.linalg.norm(at[:3] + turned - base, axis=1) - zero)

            steps = np.diag([1e-3, 1e-3, 1e-3, 1e-6, 1e-6, 1e-6])
            columns = [
                (lengths(posture + s) - lengths(posture - s)) / (2.0 * s.sum()) for s in steps
            ]
            off = lengths(posture) - reading.sliders_mm
            posture = posture - np.linalg.solve(np.stack(columns, axis=1), off)
        # four standard deviations of a measured coordinate, with which they are fitted
        assert posture[:3] == pytest.approx(reading.values, abs=0.04)


def test_postures_leave_the_calibrated_machine_room(measured: tuple[Path, Path]) -> None:
    """With a slider at an end of its travel the calibrated machine was refused its postures."""
    session, _ = measured
    readings = read_postures(session)[0].readings
    sliders_mm = np.array([reading.sliders_mm for reading in readings])
    assert 5.1 < sliders_mm.min() < sliders_mm.max() < 614.9


def test_no_machine_verifies_another_one(measured: tuple[Path, Path], tmp_path: Path) -> None:
    hexaslide, page = tmp_path / "h.jsonl", tmp_path / "r.html"
    run = ("run", "--machine", "hexaslide", "--simulated", "--protocol", "position", "-o")
    assert glidecal(*run, hexaslide).status == 0
    for verb in ("verify", "compare"):
        assert "different machines" in refused(5, verb, measured[0], hexaslide)
    with_after = ("report", measured[0], "--after", hexaslide, "-o", page)
    assert "different machines" in refused(5, *with_after)


def test_the_exported_file_tells_whose_angles_are_meant(
    measured: tuple[Path, Path], tmp_path: Path
) -> None:
    """LinuxCNC turns otherwise than postures of the program: at 10°, -8°, 12° by more than 1°."""
    folder = tmp_path / "kins"
    assert glidecal("export", measured[0], "--format", "linuxcnc-kins", "-o", folder).status == 0
    text = (folder / "calib.hal").read_text("utf-8").replace("\n# ", " ")
    assert "Rz(C) Ry(B) Rx(A)" in text
    assert "Ry(theta) Rx(psi) Rz(phi)" in text
    theta, psi, phi = 10.0, -8.0, 12.0
    theirs = Rotation.from_euler("xyz", [psi, theta, phi], degrees=True)
    ours = Rotation.from_euler("YXZ", [theta, psi, phi], degrees=True)
    assert np.degrees((theirs.inv() * ours).magnitude()) > 1.0


def _without_a_rail(text: str) -> str:
    return re.sub(r"\nrail = [^\n]*", "", text, count=1)


def _second_leg_elsewhere(text: str) -> str:
    return text.replace("249.494, 0.0, 0.0", "249.494, 5.0, 0.0")


def _half(text: str) -> str:
    return text.replace("joint_mm = [260.101", "rail = [0.0, 0.0, 1.0]\njoint_mm = [260.101")


def _short(text: str) -> str:
    return text.replace("travel_mm = [0.0, 620.0]", "travel_mm = [0.0, 200.0]")


@pytest.mark.parametrize(
    ("source", "change", "words"),
    [
        (
            "hexaslide-h60.toml",
            _without_a_rail,
            f"5 {MIXED}",
        ),
        ("gough-stewart.toml", _half, f"1 {MIXED}"),
        ("gough-stewart.toml", _second_leg_elsewhere, "the second at"),
    ],
)
def test_a_machine_of_both_kinds_is_refused(
    source: str, change: Callable[[str], str], words: str, tmp_path: Path
) -> None:
    text = (FILE.parent / source).read_text("utf-8")
    assert change(text) != text
    (machine_path := tmp_path / "own.toml").write_text(change(text), encoding="utf-8")
    assert words in refused(3, "identifiability", machine_path, "--procedure", "position")


def test_what_such_legs_do_not_have_is_refused(tmp_path: Path) -> None:
    encoders = ("--measured", "x,turn1")
    assert "turn1 of telescopic legs" in refused(2, "identifiability", FILE, *encoders)
    (machine_path := tmp_path / "own.toml").write_text(
        _short(FILE.read_text("utf-8")), encoding="utf-8"
    )
    (far := tmp_path / "far.csv").write_text(
        "x_m,y_m,z_m,theta_deg,psi_deg,phi_deg\n0.1,0.5,0.9,0,0,0\n", encoding="utf-8"
    )
    arguments = ("run", "--machine", machine_path, "--protocol", "position", "--posture-file", far)
    assert "its travel_mm" in refused(3, *arguments, "--simulated", "-o", tmp_path / "s.jsonl")
    with_template = ("import", "--machine", FILE, "--protocol", "position", "--template")
    assert "the machine's box" in refused(3, *with_template, tmp_path / "t.csv")


def test_what_is_seen_too_weakly_is_not_to_be_entered(tmp_path: Path) -> None:
    """With the rigid link the bound is larger than the error: the result says to keep the file."""
    linked = ("--procedure", "constraint-link", "--postures", "60", "--seed", "1")
    out = ("-o", tmp_path / "m.json")
    assert glidecal("simulate", "--machine", FILE, *linked, *out).status == 0
    result = json.loads(glidecal("solve", tmp_path / "m.json", "--json").out)
    platform = result["platform"]
    assert platform["bound_rms_mm"] > platform["now_rms_mm"]
    text = " ".join(glidecal("solve", tmp_path / "m.json").out.split())
    assert "Keep the file, or measure more or better postures" in text


@LONG
def test_linuxcnc_holds_it(measured: tuple[Path, Path], tmp_path: Path) -> None:
    """``genhexkins`` with the exported pins sends the joints where the definition puts them."""
    need_linuxcnc()
    session, entered = measured
    folder = tmp_path / "kins"
    assert glidecal("export", session, "--format", "linuxcnc-kins", "-o", folder).status == 0
    assert sorted(path.name for path in folder.iterdir()) == ["calib.hal", "machine.toml"]
    chains = load_hexaslide(entered).chain
    base, joint = (np.array([getattr(chain, key) for chain in chains]) for key in POINTS)

    def lengths(place: list[float]) -> np.ndarray:
        """Whole legs; LinuxCNC turns by A about X, then B about Y, then C about Z, all fixed."""
        turned = Rotation.from_euler("xyz", place[3:], degrees=True).apply(joint)
        return np.asarray(np.linalg.norm(np.array(place[:3]) + turned - base, axis=1))

    first = lengths([125.0, 587.0, 800.0, 0.0, 0.0, 0.0])
    joints = [SimulatedJoint({"mounting": place}) for place in first]
    entries = [
        {"HOME": place, "HOME_OFFSET": place, "MIN_LIMIT": 100, "MAX_LIMIT": 2000}
        for place in first.tolist()
    ]
    places = [[100.0, 600.0, 760.0, 5.0, -8.0, 10.0], [160.0, 550.0, 850.0, -7.0, 6.0, -12.0]]
    words = "G21 G90 G53 G1 F30000 X{:.4f} Y{:.4f} Z{:.4f} A{:.4f} B{:.4f} C{:.4f}"
    lines = [words.format(*place) for place in places]
    hal = (folder / "calib.hal").read_text("utf-8")
    stops = run(
        tmp_path / "run",
        joints,
        entries,
        hal,
        ["home", *lines],
        kinematics="genhexkins",
        axes="XYZABC",
    )[1:]
    for stop, place in zip(stops, places, strict=True):
        assert stop.joint == pytest.approx(lengths(place), abs=1e-3)


def test_a_length_in_other_units_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    """Before: a fault of the program in the middle of a simulation."""
    machine, target = tmp_path / "m.toml", tmp_path / "s.jsonl"
    machine.write_text(FILE.read_text("utf-8").replace("link_mm = 590.0", "link_mm = 590000.0"))
    arguments = ("simulate", "--machine", machine, "--procedure", "constraint-link")
    words = refused(2, *arguments, "--postures", "5", "-o", target)
    assert "slider or reading of a posture: found -58" in words
    assert "Allowed: a number from -100 to 100 m or rad." in words
    assert not target.exists()
