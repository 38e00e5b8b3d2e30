"""A calibrated Hexa Slide leads somewhere: its files against a forward model of this file alone."""

from __future__ import annotations

import ctypes
import json
import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import fsolve
from scipy.spatial.transform import Rotation

from app.evaluating.hexaslide_calibration import CalibratedMachine, calibrate_file
from app.exports.hexaslide import calibrated_files
from app.planning.hexaslide import Request, write_simulated
from protocols.files import write_files
from protocols.hexaslide import load_hexaslide
from tests.app.cli import glidecal, refused
from tests.conftest import ROOT

Array = NDArray[np.float64]
WANTED = np.array(
    [[0.0, -0.8, -1.15, 0.0, 0.0, 0.0], [0.2, -1.0, -1.25, 10.0, -8.0, 20.0],
     [-0.25, -0.6, -1.05, -12.0, 9.0, -25.0]]
)  # fmt: skip
HEADER = "x_m,y_m,z_m,theta_deg,psi_deg,phi_deg"
STUBS = """#include <math.h>
typedef struct { struct { double x, y, z; } tran; double a, b, c, u, v, w; } EmcPose;
typedef int KINEMATICS_FORWARD_FLAGS, KINEMATICS_INVERSE_FLAGS, KINEMATICS_TYPE;
#define KINEMATICS_BOTH 0
#define KINS_NOT_SWITCHABLE
#define EXPORT_SYMBOL(name)
"""


@dataclass(frozen=True)
class Plain:
    """Chains of a machine file, metres; angles in degrees as in its tables of postures."""

    start: Array
    rail: Array
    joint: Array
    link: Array

    def sliders(self, posture: Array) -> Array:
        """The carriage is where a ball about the joint meets the rail first."""
        joints = posture[:3] + Rotation.from_euler("YXZ", posture[3:], degrees=True).apply(
            self.joint
        )
        positions = []
        for start, rail, joint, link in zip(self.start, self.rail, joints, self.link, strict=True):
            roots = np.roots(
                [1.0, -2.0 * rail @ (joint - start), (joint - start) @ (joint - start) - link**2]
            )
            positions.append(float(roots.real.min()))
        return np.array(positions)

    def stands(self, sliders: Array, near: Array) -> Array:
        """Where all links have their lengths."""
        carriages = self.start + sliders[:, None] * self.rail

        def off(posture: Array) -> Array:
            turn = Rotation.from_euler("YXZ", posture[3:], degrees=True)
            ends = posture[:3] + turn.apply(self.joint)
            return np.asarray(np.linalg.norm(ends - carriages, axis=1) - self.link)

        return np.asarray(fsolve(off, near, xtol=1e-12))


def plain(chains: list[dict[str, list[float]]]) -> Plain:
    return Plain(
        *(
            unit * np.array([chain[key] for chain in chains])
            for key, unit in (
                ("start_mm", 1e-3),
                ("rail", 1.0),
                ("joint_mm", 1e-3),
                ("link_mm", 1e-3),
            )
        )
    )


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Whole postures without noise: every parameter is found."""
    folder = tmp_path_factory.mktemp("calibrated")
    table = folder / "wanted.csv"
    np.savetxt(table, WANTED, fmt="%.17g", delimiter=",", header=HEADER, comments="")
    request = Request("pose-inverse", postures=16, seed=1)
    write_simulated(request, folder / "m.json", folder / "t.json", noise_mm=0.0)
    result = calibrate_file(folder / "m.json", None, 0.0)
    write_files(folder / "out", calibrated_files(result, table))
    return folder


def true_and_nominal(folder: Path) -> tuple[Plain, Plain]:
    return tuple(
        plain(json.loads((folder / name).read_text("utf-8"))["machine"]["chain"])
        for name in ("t.json", "m.json")
    )  # type: ignore[return-value]


def rows(path: Path) -> Array:
    return np.loadtxt(path, delimiter=",", skiprows=1)


def test_commands_bring_the_true_machine_where_it_is_wanted(files: Path) -> None:
    """A controller keeps its nominal geometry; the sliders are those of the table beside."""
    true, nominal = true_and_nominal(files)
    commands, sliders = (rows(files / "out" / f"{name}.csv") for name in ("postures", "sliders"))
    for posture, command, target in zip(WANTED, commands, sliders, strict=True):
        moved = nominal.sliders(command)
        assert moved == pytest.approx(target, abs=1e-10)
        assert np.abs(true.stands(moved, posture) - posture).max() < 1e-8
        before = np.abs(true.stands(nominal.sliders(posture), posture) - posture)[:3].max()
        other_way = nominal.sliders(2.0 * posture - command)
        assert np.abs(true.stands(other_way, posture) - posture)[:3].max() > 1.5 * before > 2e-4


def test_the_machine_file_is_read_again_as_the_true_machine(files: Path) -> None:
    true, _ = true_and_nominal(files)
    machine = load_hexaslide(files / "out" / "machine.toml")
    assert machine.name == "hexaslide-h60, calibrated"
    assert machine.box == load_hexaslide().box
    assert [chain.travel_mm for chain in machine.chain] == [(0.0, 1050.0)] * 6
    geometry = plain([chain.model_dump() for chain in machine.chain])
    for name in ("start", "rail", "joint", "link"):
        assert np.abs(getattr(geometry, name) - getattr(true, name)).max() < 1e-10


@pytest.mark.parametrize("machine", ["hexaslide-h60.toml", "gough-stewart.toml"])
def test_ros_2_gets_the_same_machine(machine: str, tmp_path: Path) -> None:
    """As a parser of YAML reads the file, its values are those of the machine file, in metres."""
    yaml = pytest.importorskip("yaml")
    request = Request("position", ROOT / "protocols" / "machines" / machine, postures=40, seed=4)
    write_simulated(request, tmp_path / "m.json", None)
    for name, path in (("ros2", "k.yaml"), ("model", "m.toml")):
        run = glidecal("export", tmp_path / "m.json", "--format", name, "-o", tmp_path / path)
        assert run.status == 0, run.err
    text = (tmp_path / "k.yaml").read_text("utf-8")
    kinematics = yaml.safe_load(text)["/**"]["ros__parameters"]["calibrated_kinematics"]
    calibrated = load_hexaslide(tmp_path / "m.toml")
    assert kinematics["machine"] == calibrated.name
    assert kinematics["not_identifiable"] == [f"platform frame turned about its {a}" for a in "XYZ"]
    assert 1e-6 < kinematics["platform_error_bound"] < 1e-4
    for number, chain in enumerate(calibrated.chain, start=1):
        values = kinematics[f"chain{number}"]
        assert 1000.0 * np.array(values["start"]) == pytest.approx(chain.start_mm, abs=1e-8)
        assert 1000.0 * np.array(values["joint"]) == pytest.approx(chain.joint_mm, abs=1e-8)
        assert 1000.0 * values["link"] == pytest.approx(chain.link_mm, abs=1e-8)
        assert values.get("rail") == (chain.rail and pytest.approx(chain.rail, abs=1e-11))
    assert "-0.000000000000" not in text


class Module:
    """``hexaslidekins.comp`` compiled as it is, its pins set by ``calib.hal``."""

    def __init__(self, folder: Path, files: Path) -> None:
        source = (files / "hexaslidekins.comp").read_text("utf-8")
        pins = re.findall(r"^pin in float ([\w#-]+)\[6\]", source, re.MULTILINE)
        names = {pin: pin.replace("-#", "").replace("-", "_") for pin in pins}
        fields = "".join(f"double {name}_[6];" for name in names.values())
        macros = "".join(f"#define {n}(i) (__comp_inst->{n}_[i])\n" for n in names.values())
        state = f"struct __comp_state {{{fields}}} pins, *__comp_first_inst = &pins;\n"
        code = re.sub(r"#include <\w+\.h>", "", source.split(";;", 1)[1])
        (folder / "kins.c").write_text(STUBS + state + macros + code)
        library = folder / "kins.so"
        subprocess.run(
            ["gcc", "-Wall", "-O1", "-shared", "-fPIC", "-o", library, folder / "kins.c", "-lm"],
            check=True,
        )
        self.code = ctypes.CDLL(str(library))
        values = (ctypes.c_double * (6 * len(pins))).in_dll(self.code, "pins")
        settings = re.findall(
            r"^setp hexaslidekins\.(\S+) (\S+)$", (files / "calib.hal").read_text(), re.M
        )
        assert len(settings) == 6 * len(pins)
        for pin, value in settings:
            number = re.search(r"\d", pin)
            assert number is not None
            values[6 * pins.index(pin.replace(number[0], "#")) + int(number[0])] = float(value)

    def inverse(self, posture: Array) -> Array:
        """Joints in mm of x, y, z in mm, a, b, c in degrees."""
        joints = (ctypes.c_double * 6)()
        assert self.code.kinematicsInverse((ctypes.c_double * 9)(*posture), joints, None, None) == 0
        return np.array(joints)

    def forward(self, joints: Array) -> tuple[int, Array]:
        position = (ctypes.c_double * 9)()
        answer = self.code.kinematicsForward((ctypes.c_double * 6)(*joints), position, None, None)
        return answer, np.array(position)[:6]


@pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc")
def test_the_kinematics_module_is_the_true_machine(files: Path, tmp_path: Path) -> None:
    true, _ = true_and_nominal(files)
    module = Module(tmp_path, files / "out")
    generator = np.random.default_rng(3)
    box = load_hexaslide().whole().box
    for posture in box.random(40, generator):
        degrees = np.append(posture[:3], np.degrees(posture[3:]))
        theta, psi, phi = degrees[3:]
        pose = np.array([*(1000.0 * posture[:3]), psi, theta, phi])
        joints = module.inverse(pose)
        assert joints == pytest.approx(1000.0 * true.sliders(degrees), abs=1e-7)
        answer, back = module.forward(joints)
        assert answer == 0
        assert back == pytest.approx(pose, abs=1e-8)
    assert module.forward(np.full(6, 1e5))[0] == -1
    assert module.forward(joints)[0] == 0, "and finds back"


def test_solve_writes_them_and_says_why_not_for_genhexkins(files: Path, tmp_path: Path) -> None:
    out, table = tmp_path / "out", files / "wanted.csv"
    verb = ("solve", files / "m.json", "--corrected", out)
    run = glidecal(*verb, "--posture-file", table)
    assert run.status == 0, run.err
    assert "genhexkins: its struts change their length between fixed ends" in run.err
    assert sorted(path.name for path in out.iterdir()) == [
        "calib.hal", "hexaslidekins.comp", "machine.toml", "postures.csv", "sliders.csv",
    ]  # fmt: skip
    assert (out / "machine.toml").read_text("utf-8").startswith("# Calibrated from m.json")
    assert "are there already" in refused(2, *verb)
    only = refused(2, "solve", files / "m.json", "--posture-file", table)
    assert "--posture-file: found no --corrected" in only
    far = tmp_path / "far.csv"
    far.write_text(f"{HEADER}\n0,-0.8,-1.4,0,0,0\n", encoding="utf-8")
    message = refused(3, *verb, "--force", "--posture-file", far)
    assert "posture 1, z_m: found -1.4. Allowed: -1.3 to -1" in message
    tripod_session = ROOT / "sample_sessions" / "experiment_1_six.jsonl"
    refusal = refused(2, "solve", tripod_session, "--corrected", tmp_path / "no")
    assert "--corrected" in refusal


def test_what_is_not_identifiable_stands_above_the_machine(tmp_path: Path) -> None:
    path = tmp_path / "m.json"
    write_simulated(Request("position", postures=30, seed=1), path, None)
    result: CalibratedMachine = calibrate_file(path, None, 0.0)
    text = calibrated_files(result, None)["machine.toml"]
    assert "# NOT IDENTIFIABLE, left as the machine file has it: platform frame turned" in text
