"""LinuxCNC, headless, behind a simulated machine, in namespaces of its own."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import pytest

HERE = Path(__file__).parent
MODULES = Path("/usr/lib/linuxcnc/modules")
NEEDED = ("linuxcnc", "halcompile", "unshare", "gcc")
TIME_OUT_S = 600

INI = """[EMC]
VERSION = 1.1
[DISPLAY]
DISPLAY = ./pendant.py
[TASK]
TASK = milltask
CYCLE_TIME = 0.001
[RS274NGC]
PARAMETER_FILE = sim.var
[EMCMOT]
EMCMOT = motmod
SERVO_PERIOD = 1000000
[EMCIO]
EMCIO = io
CYCLE_TIME = 0.1
TOOL_TABLE = sim.tbl
[HAL]
HALFILE = core.hal
HALFILE = calib.hal
[TRAJ]
COORDINATES = X Y Z
LINEAR_UNITS = mm
ANGULAR_UNITS = degree
MAX_LINEAR_VELOCITY = 1000
[KINS]
KINEMATICS = orthoglidekins
JOINTS = 3
"""
AXIS = """[AXIS_{name}]
MAX_VELOCITY = 1000
MAX_ACCELERATION = 40000
"""
JOINT = {
    "TYPE": "LINEAR",
    "MAX_VELOCITY": 1000,
    "MAX_ACCELERATION": 40000,
    "FERROR": 50,
    "MIN_FERROR": 50,
    "MIN_LIMIT": 0,
    "MAX_LIMIT": 1000,
    "HOME_SEQUENCE": 0,
}
CORE = """loadrt [KINS]KINEMATICS
loadrt [EMCMOT]EMCMOT servo_period_nsec=[EMCMOT]SERVO_PERIOD num_joints=[KINS]JOINTS
loadrt rigjoint count=3
addf motion-command-handler servo-thread
addf motion-controller servo-thread
net estop iocontrol.0.user-enable-out iocontrol.0.emc-enable-in
net tp iocontrol.0.tool-prepare iocontrol.0.tool-prepared
net tc iocontrol.0.tool-change iocontrol.0.tool-changed
"""
WIRED = """addf rigjoint.{k} servo-thread
net cmd{k} joint.{k}.motor-pos-cmd rigjoint.{k}.motor
net fb{k} rigjoint.{k}.motor-fb joint.{k}.motor-pos-fb
net sw{k} rigjoint.{k}.home-sw joint.{k}.home-sw-in
"""
START = """set -e
mount --bind "$1/modules" {modules}
mount --bind "$1/config" /mnt
mount --bind "$1/tmp" /tmp
ip link set lo up 2>/dev/null || true
cd /mnt
exec timeout {limit} linuxcnc -r machine.ini
"""


@dataclass(frozen=True)
class SimulatedJoint:
    """What is off about a carriage, in the parameters of ``rigjoint.comp``."""

    figures: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Stop:
    """Where everything was after one step, mm."""

    tool: tuple[float, ...]
    joint: tuple[float, ...]
    motor: tuple[float, ...]
    carriage: tuple[float, ...]
    trim: tuple[float, ...]


def need_linuxcnc() -> None:
    """Skip where LinuxCNC cannot be started."""
    missing = [name for name in NEEDED if shutil.which(name) is None]
    if missing:
        pytest.skip(f"needs {', '.join(missing)} (Debian: linuxcnc-uspace, linuxcnc-uspace-dev)")
    if os.geteuid() != 0:
        pytest.skip("starts LinuxCNC in namespaces of its own, which needs root")
    if subprocess.run(["unshare", "-m", "true"], check=False, capture_output=True).returncode:
        pytest.skip("this machine gives no namespaces")


@cache
def compiled() -> Path:
    """The folder of LinuxCNC's modules and ours, made once a process."""
    build = Path(mkdtemp(prefix="glidecal-modules-"))
    modules = build / "modules"
    shutil.copytree(MODULES, modules)
    exports = resources.files("app.exports")
    texts = {
        path.name.removesuffix(".comp"): path.read_text(encoding="utf-8")
        for path in exports.iterdir()
        if path.name.endswith("kins.comp")
    }
    for name, text in {
        **texts,
        "rigjoint": (HERE / "rigjoint.comp").read_text(encoding="utf-8"),
    }.items():
        (build / f"{name}.comp").write_text(text)
        process = subprocess.run(
            ["halcompile", "--compile", f"{name}.comp"],
            cwd=build,
            check=False,
            capture_output=True,
            text=True,
        )
        assert process.returncode == 0, process.stderr
        assert "warning" not in process.stderr, process.stderr
        shutil.copy(build / f"{name}.so", modules)
    return modules


def run(
    folder: Path,
    joints: Sequence[SimulatedJoint],
    entries: Sequence[Mapping[str, float | str]],
    calib_hal: str,
    steps: Sequence[str],
    *,
    files: Mapping[str, str] | None = None,
    includes: Sequence[str] | None = None,
    kinematics: str = "orthoglidekins",
    axes: str = "XYZ",
) -> list[Stop]:
    """Start, do what is told (``"home"`` or a line of G-code), stop.

    ``entries`` are those of each [JOINT_n], below the ``includes``; ``files`` lie beside the INI.
    There are as many joints as ``axes``.
    """
    config = folder / "config"
    for place in (config, folder / "tmp"):
        place.mkdir(parents=True, exist_ok=True)
        place.chmod(0o777)
    ini = INI.replace("X Y Z", " ".join(axes)).replace("JOINTS = 3", f"JOINTS = {len(axes)}")
    ini = ini.replace("orthoglidekins", kinematics)
    ini += "".join(AXIS.format(name=name) for name in axes)
    hal = CORE.replace("count=3", f"count={len(axes)}")
    for k, (joint, entry) in enumerate(zip(joints, entries, strict=True)):
        ini += f"[JOINT_{k}]\n{includes[k] if includes else ''}"
        ini += "".join(f"{key} = {value}\n" for key, value in {**JOINT, **entry}.items())
        hal += WIRED.format(k=k)
        hal += "".join(
            f"setp rigjoint.{k}.{n.replace('_', '-')} {v:.9f}\n" for n, v in joint.figures.items()
        )
    texts = {"machine.ini": ini, "core.hal": hal, "calib.hal": calib_hal, "sim.tbl": ""}
    for name, text in {**texts, **(files or {}), "told.json": json.dumps(list(steps))}.items():
        (config / name).write_text(text)
    pendant = config / "pendant.py"
    pendant.write_text((HERE / "pendant.py").read_text())
    pendant.chmod(0o755)
    answer = _started(folder)
    assert not answer["errors"], answer["errors"]
    return [Stop(**{name: tuple(v) for name, v in stop.items()}) for stop in answer["stops"]]


def _started(folder: Path) -> dict[str, Any]:
    if not (folder / "modules").exists():
        (folder / "modules").symlink_to(compiled())
    start = START.format(modules=MODULES, limit=TIME_OUT_S)
    fifo = "/tmp/fifo"  # in the mount namespace: the folder's own
    (folder / "tmp" / "fifo").mkdir(exist_ok=True)
    (folder / "tmp" / "fifo").chmod(0o777)
    environment = {k: v for k, v in os.environ.items() if k != "DISPLAY"}
    environment |= {"RTAPI_UID": "65534", "RTAPI_FIFO_PATH": f"{fifo}/rtapi", "HOME": "/tmp"}
    environment["PATH"] = "/usr/sbin:/usr/bin:/sbin:/bin"  # LinuxCNC's own Python
    ended = subprocess.run(
        ["unshare", "-i", "-m", "-n", "-p", "-f", "--mount-proc", "bash", "-c", start, "x", folder],
        env=environment,
        check=False,
        capture_output=True,
        text=True,
        timeout=TIME_OUT_S + 30,
    )
    path = folder / "config" / "answer.json"
    assert path.exists(), ended.stdout[-3000:] + ended.stderr[-3000:]
    answer: dict[str, Any] = json.loads(path.read_text())
    return answer
