"""The machine moves itself through a real LinuxCNC: right readings or none."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from calib.tripod.simulation import hidden_machine
from drivers.motion.supervision import STALL_S
from protocols.machine import load_machine
from protocols.record import read_record
from tests.app.measuring.moving_machine import taken
from tests.conftest import LONG, ROOT
from tests.controller.running import need_linuxcnc
from tests.controller.self_running import MEDDLERS, MODES_LEFT, commanded
from tests.drivers.motion.twins import MotionTrouble

pytestmark = LONG

STOP_S = 0.5


@pytest.mark.parametrize(
    "kinds",
    [
        (MotionTrouble.NAK, MotionTrouble.ESTOP, MotionTrouble.HANG_UP),
        (MotionTrouble.FOLLOWING, MotionTrouble.DIED),
    ],
    ids=["told", "lost"],
)
def test_whatever_befalls_the_controller_no_reading_is_wrong_and_it_goes_on(
    kinds: tuple[MotionTrouble, ...], tmp_path: Path
) -> None:
    report = commanded(tmp_path, "disturbed", "28", str(len(kinds)), *kinds)
    assert report["wrong"] == []
    assert report["met"] == len(kinds)


def test_a_killed_or_suspended_program_leaves_it_at_rest(tmp_path: Path) -> None:
    report = commanded(tmp_path, "ended")
    assert set(report) == {"SIGKILL", "SIGSTOP"}
    for name in report:
        ended = part(report, name)
        assert not ended["moving"]
        within_s = STOP_S + number(ended["held_up_s"])
        assert number(ended["went_s"]) < within_s
        assert number(ended["went_mm"]) < 20.0 * within_s


def part(report: dict[str, object], name: str) -> dict[str, object]:
    section = report[name]
    assert isinstance(section, dict)
    return section


def number(value: object) -> float:
    assert isinstance(value, float)
    return value


@pytest.fixture(scope="module")
def meddled(tmp_path_factory: pytest.TempPathFactory) -> dict[str, object]:
    """One LinuxCNC for all that others do beside the program."""
    return commanded(tmp_path_factory.mktemp("meddled"), "meddled")


def soon_s(name: str, report: dict[str, object]) -> float:
    """A hold tells nothing of itself: it is seen by a move that makes no way."""
    return STOP_S + number(report["held_up_s"]) + (STALL_S if name == "hold" else 0.0)


@pytest.mark.parametrize("name", MEDDLERS)
def test_what_others_do_at_rest_is_noticed(name: str, meddled: dict[str, object]) -> None:
    report = part(meddled, f"{name} at rest")
    assert report["state"] in ("held", "fault"), report
    assert number(report["seen_s"]) < soon_s(name, report), report


@pytest.mark.parametrize("name", [name for name in MEDDLERS if name != "move"])
def test_what_others_do_on_the_way_stops_it(name: str, meddled: dict[str, object]) -> None:
    report = part(meddled, f"{name} on the way")
    assert report["state"] in ("held", "fault"), report
    assert number(report["seen_s"]) < soon_s(name, report), report
    within_s = STOP_S + number(report["held_up_s"])
    assert number(report["went_s"]) < within_s, report
    assert not report["moving"]
    assert 3.0 < number(report["at_mm"]) < 3.0 + 30.0 * within_s
    if name != "unhome":  # which is homed where it stands
        assert report["after_mm"] == pytest.approx(report["at_mm"], abs=0.01)


@pytest.mark.parametrize("words", MODES_LEFT)
def test_modes_that_others_left_change_neither_feed_nor_way(
    words: str, meddled: dict[str, object]
) -> None:
    report = part(meddled, words)
    assert number(report["took_s"]) > 0.95  # 10 mm at 10 mm/s
    assert number(report["at_mm"]) == pytest.approx(10.0, abs=0.001)


def test_an_inch_machine_goes_as_far_and_as_fast_as_it_is_sent(tmp_path: Path) -> None:
    report = commanded(tmp_path, "inch", in_inches=True)
    within = part(report, "within")
    assert within["went"] == pytest.approx([10.0 / 25.4, -4.0 / 25.4, 0.0], abs=1e-6)
    assert within["read_mm"] == pytest.approx([10.0, -4.0, 0.0], abs=1e-3)
    assert number(within["took_s"]) > 1.0
    beyond = part(report, "beyond")
    assert "[JOINT_0] from -508 to 508 mm" in str(beyond["problem"])
    assert beyond["went"] == [0.0, 0.0, 0.0]


def test_a_session_is_killed_and_continued_to_its_end(tmp_path: Path) -> None:
    report = commanded(tmp_path, "continued", "1", "1", "9000")
    assert report["wrong"] == []
    assert report["readings"] == 2 * 6
    assert report["end"] == "closed"


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


@dataclass(frozen=True)
class Demonstrated:
    """What the demonstration measured before and after it homed again, and said in the end."""

    first: Path
    verified: Path
    said: str


@pytest.fixture(scope="module")
def demonstrated(tmp_path_factory: pytest.TempPathFactory) -> Demonstrated:
    """LinuxCNC starts and homes twice, which alone takes eight seconds."""
    need_linuxcnc()
    folder = tmp_path_factory.mktemp("demo")
    (folder / "once.toml").write_text(ONCE)
    hidden = any(Path(place).is_relative_to("/tmp") for place in (ROOT, sys.prefix))
    there = str(folder) if hidden else "/tmp"
    words = ["demo", "--controller", "linuxcnc", "--headless", "--seed", "5", "--protocol"]
    words += [f"{there}/once.toml", "--folder", f"{there}/demo"]
    apart = ["unshare", "-i", "-m", "-n", "-p", "-f", "--mount-proc", "--kill-child"]
    begun = ["bash", "-c", APART, "x", str(folder), "shared" if hidden else "own"]
    ended = subprocess.run(
        [*apart, *begun, sys.executable, "-m", "glidecal", *words],
        cwd=ROOT,
        check=False,
        capture_output=True,
        text=True,
        timeout=600.0,
    )
    assert ended.returncode == 0, ended.stderr
    first, verified = sorted((folder / "demo").glob("*.jsonl"), key=lambda path: len(path.name))
    return Demonstrated(first, verified, ended.stdout)


def test_the_demonstration_moves_the_machine(demonstrated: Demonstrated) -> None:
    for path in (demonstrated.first, demonstrated.verified):
        assert read_record(path).end == "closed"
        assert {reading.moved.driver for reading in taken(path) if reading.moved} == {"linuxcnc"}


def test_the_demonstration_exports_the_hidden_offsets(demonstrated: Demonstrated) -> None:
    truth = hidden_machine(load_machine(None).geometry(), 5).parameters_mm
    for k in range(3):
        include = (demonstrated.first.with_suffix("") / f"calib_joint{k}.inc").read_text()
        new = float(re.findall(r"^HOME_OFFSET = (.*)$", include, re.M)[0])
        assert new == pytest.approx(380.25 + truth[k], abs=0.1)  # lengths are taken for offsets


def test_the_demonstration_homes_again_with_what_it_exported(demonstrated: Demonstrated) -> None:
    zero = [
        reading.moved for reading in taken(demonstrated.verified) if reading.displacement_mm == 0.0
    ]
    assert max(abs(moved.read_back_mm[0] - 310.25) for moved in zero if moved) < 0.001
    before, after = map(float, re.findall(r"from ([\d.]+) to ([\d.]+) mm", demonstrated.said)[0])
    assert before > 0.05
    assert after < 0.01
