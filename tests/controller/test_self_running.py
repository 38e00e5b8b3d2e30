"""The machine moves itself through a real LinuxCNC: right readings or none."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from calib.tripod.simulation import hidden_machine
from drivers.motion.twins import Trouble
from protocols.machine import load_machine
from protocols.record import read_record
from protocols.session import Moved
from tests.app.measuring.moving_machine import taken
from tests.conftest import ROOT
from tests.controller.running import need_linuxcnc
from tests.controller.self_running import commanded


def test_whatever_befalls_the_controller_no_reading_is_wrong_and_it_goes_on(tmp_path: Path) -> None:
    kinds = (Trouble.NAK, Trouble.ESTOP, Trouble.FOLLOWING, Trouble.HANG_UP, Trouble.DIED)
    told = commanded(tmp_path, "disturbed", "28", "5", *kinds)
    assert told["wrong"] == []
    assert told["met"] == 5


def test_a_killed_program_leaves_it_at_rest(tmp_path: Path) -> None:
    told = commanded(tmp_path, "killed")
    assert 2.0 <= float(str(told["there_mm"])) < 49.0  # of ten seconds


def test_a_session_is_killed_and_continued_to_its_end(tmp_path: Path) -> None:
    told = commanded(tmp_path, "continued", "1", "1", "9000")
    assert told["wrong"] == []
    assert told["readings"] == 2 * 6
    assert told["end"] == "closed"


APART = """set -e
ip link set lo up
chmod 777 "$1"
if [ "$2" = own ]; then mount --bind "$1" /tmp; fi
fifo=$(mktemp -d /tmp/rtapi-XXXXXX)
trap 'rm -rf "$fifo"' EXIT
chmod 777 "$fifo"
export RTAPI_UID=65534 RTAPI_FIFO_PATH="$fifo/rtapi"
shift 2
"$@"
"""
"""LinuxCNC's lock stands in /tmp: one of its own, unless the program itself is there. Its realtime
part runs as nobody, who must reach the fifo."""

ONCE = """schema = "glidecal.procedure/1"
name = "once"
title = "Once"
cycles = 1
window_s = 0.1
levels = ["zero", "max"]
"""


def test_the_demonstration_homes_again_with_what_it_exported(tmp_path: Path) -> None:
    """LinuxCNC starts and homes twice, which alone takes eight seconds."""
    need_linuxcnc()
    (tmp_path / "once.toml").write_text(ONCE)
    hidden = any(Path(place).is_relative_to("/tmp") for place in (ROOT, sys.prefix))
    there = str(tmp_path) if hidden else "/tmp"
    words = ["demo", "--controller", "linuxcnc", "--headless", "--seed", "5", "--protocol"]
    words += [f"{there}/once.toml", "--folder", f"{there}/demo"]
    apart = ["unshare", "-i", "-m", "-n", "-p", "-f", "--mount-proc", "--kill-child"]
    begun = ["bash", "-c", APART, "x", str(tmp_path), "shared" if hidden else "own"]
    ended = subprocess.run(
        [*apart, *begun, sys.executable, "-m", "glidecal", *words],
        cwd=ROOT,
        check=False,
        capture_output=True,
        text=True,
        timeout=120.0,
    )
    assert ended.returncode == 0, ended.stderr
    first, verified = sorted((tmp_path / "demo").glob("*.jsonl"), key=lambda path: len(path.name))
    for path in (first, verified):
        assert read_record(path).end == "closed"
        assert {one.moved.driver for one in taken(path) if one.moved} == {"linuxcnc"}
    truth = hidden_machine(load_machine(None).geometry(), 5).parameters_mm
    for k in range(3):
        include = (first.with_suffix("") / f"calib_joint{k}.inc").read_text()
        new = float(re.findall(r"^HOME_OFFSET = (.*)$", include, re.M)[0])
        assert new == pytest.approx(380.25 + truth[k], abs=0.1)  # lengths are taken for offsets
    off = [abs(moved.read_back_mm[0] - 310.25) for moved in _at_zero(verified)]
    assert max(off) < 0.001
    before, after = map(float, re.findall(r"from ([\d.]+) to ([\d.]+) mm", ended.stdout)[0])
    assert before > 0.05
    assert after < 0.01


def _at_zero(path: Path) -> list[Moved]:
    return [one.moved for one in taken(path) if one.displacement_mm == 0.0 and one.moved]
