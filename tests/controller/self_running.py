"""A session that runs by itself through a real LinuxCNC, in a network of its own.

`commanded` starts LinuxCNC behind its text server and this module as a program beside it: that
plays the operator, who switches on and homes, and the indicators, which follow what the controller
reads back at that moment.
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from tempfile import mkdtemp

from app.exports.linuxcnc import pins
from app.measuring.moving import measure_by_itself, ways_of
from calib.tripod.pipeline import Model
from drivers.motion.controller import Triple
from drivers.motion.twins import SimulatedAxes, Trouble
from protocols.machine import Machine, MotionLimits
from protocols.procedure import load_procedure
from tests.app.measuring.moving_machine import moving_session, taken, with_faults, wrong
from tests.conftest import ROOT
from tests.controller import running
from tests.controller.machine import L
from tests.controller.machine import Machine as Machines

PORT, TOLD_PORT = 5007, 5999
NOMINAL = Machines()
PATIENCE_S = 30.0
HERE = {"HOME": L, "HOME_OFFSET": L, "HOME_SEARCH_VEL": 0.0, "HOME_LATCH_VEL": 0.0}
"""The switch is here, now."""

OUTER = """set -e
ip link set lo up
unshare -i -m -p -f --mount-proc --kill-child bash -c "$1" x "$2" >"$2/log" 2>&1 </dev/null &
controller=$!
shift 2
set +e
"$@"
status=$?
kill -9 $controller
wait $controller 2>/dev/null
exit $status
"""


def commanded(folder: Path, *words: str, timeout_s: float = 110.0) -> dict[str, object]:
    """What this module tells, run as a program with these words beside LinuxCNC."""
    running.need_linuxcnc()
    config = folder / "config"
    for place in (config, folder / "tmp", folder / "tmp" / "fifo"):
        place.mkdir(parents=True, exist_ok=True)
        place.chmod(0o777)
    ini = running.INI.replace("./pendant.py", "linuxcncrsh")
    ini += "".join(running.AXIS.format(name=name) for name in "XYZ")
    hal = running.CORE + "".join(running.WIRED.format(k=k) for k in range(3))
    hal += "loadusr -W ./teller.py\n"
    for k in range(3):
        entries = {**running.JOINT, **HERE}
        ini += f"[JOINT_{k}]\n" + "".join(f"{key} = {value}\n" for key, value in entries.items())
    texts = {"machine.ini": ini, "core.hal": hal, "calib.hal": pins(Model()), "sim.tbl": ""}
    for name, text in texts.items():
        (config / name).write_text(text)
    teller = config / "teller.py"
    teller.write_text((running.HERE / "teller.py").read_text())
    teller.chmod(0o755)
    (folder / "modules").symlink_to(running.compiled())
    own = {k: v for k, v in os.environ.items() if k != "DISPLAY"}
    at_controller = ("RTAPI_UID=65534", "RTAPI_FIFO_PATH=/tmp/fifo/rtapi", "HOME=/tmp")
    start = running.START.format(modules=running.MODULES, limit=running.TIME_OUT_S * 8)
    clean = " ".join(("env", *at_controller, "PATH=/usr/sbin:/usr/bin:/sbin:/bin"))
    start = start.replace("exec timeout", f"exec {clean} timeout")
    told = [sys.executable, "-m", "tests.controller.self_running", str(folder), *words]
    ended = subprocess.run(
        [
            "unshare",
            "-n",
            "-p",
            "-f",
            "--kill-child",
            "bash",
            "-c",
            OUTER,
            "x",
            start,
            str(folder),
            *told,
        ],
        cwd=ROOT,
        env=own,
        check=False,
        capture_output=True,
        text=True,
        timeout=timeout_s,
    )
    assert ended.returncode == 0, ended.stdout[-3000:] + ended.stderr[-3000:]
    found: dict[str, object] = json.loads(ended.stdout.splitlines()[-1])
    return found


class Client:
    """Lines to the text server and back."""

    def __init__(self) -> None:
        end = time.monotonic() + PATIENCE_S
        while True:
            try:
                self._socket = socket.create_connection(("127.0.0.1", PORT), timeout=PATIENCE_S)
                break
            except OSError:
                if time.monotonic() > end:
                    raise
                time.sleep(0.1)
        self._file = self._socket.makefile("rw", newline="\n")
        self.tell("hello EMC operator 1")
        self.tell("set echo off")
        self.tell("set verbose on", "SET VERBOSE ACK")

    def tell(self, words: str, answer: str = "") -> str:
        """The next line that begins so; without one nothing is waited for."""
        self._file.write(words + "\n")
        self._file.flush()
        while answer:
            line = self._file.readline().strip()
            if line.startswith(answer):
                return line
        return ""

    def close(self) -> None:
        self._file.close()
        self._socket.close()


class FollowedAxes(SimulatedAxes):
    """Where the real controller's joints are, as `teller.py` tells all the time."""

    def __init__(self) -> None:
        super().__init__()
        self._told = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._told.bind(("127.0.0.1", TOLD_PORT))
        self._told.settimeout(PATIENCE_S)
        self._ends = False
        self._joints = (L, L, L)
        self._changed = time.monotonic()
        self._thread = threading.Thread(target=self._follow, daemon=True)
        self._thread.start()

    def _follow(self) -> None:
        while not self._ends:
            x, y, z = map(float, self._told.recv(200).split())
            if (x, y, z) != self._joints:
                self._changed = time.monotonic()
            self._joints = x, y, z

    @property
    def at_mm(self) -> Triple:
        x, y, z = NOMINAL.tool(self._joints).tolist()
        return x, y, z

    @property
    def moving(self) -> bool:
        return time.monotonic() - self._changed < 0.05

    def close(self) -> None:
        self._ends = True
        self._thread.join()
        self._told.close()


class Running:
    """The real controller in the place of a twin, switched on and homed by its operator."""

    def __init__(self) -> None:
        operator = Client()
        time.sleep(0.5)  # its status comes after its socket
        for words in ("enable EMCTOO", "estop off", "machine on", *(f"home {k}" for k in range(3))):
            operator.tell(f"set {words}", "SET")
        time.sleep(0.5)
        self.moves: list[str] = []
        self._others = [operator]
        self.told = f"linuxcnc:127.0.0.1:{PORT}"
        self._followed = FollowedAxes()
        self.axes: SimulatedAxes = self._followed

    def befall(self, trouble: Trouble) -> None:
        assert trouble is Trouble.NAK
        second = Client()
        second.tell("set enable EMCTOO", "SET ENABLE ACK")
        self._others.append(second)

    def mend(self) -> None:
        """The others go away; control stays with nobody until the next move takes it."""

    def close(self) -> None:
        self._followed.close()
        for other in self._others:
            other.close()


def session(folder: Path, name: str, feed: float, window_s: float) -> dict[str, object]:
    """One session without disturbance: what is wrong with it and how long it took."""
    machine = Machine(motion=MotionLimits(feed_mm_min=feed), fastest_feed_mm_min=60_000.0)
    procedure = load_procedure(name, machine.geometry()).model_copy(update={"window_s": window_s})
    ways = ways_of(procedure, machine, ("xyz", "xyz"))
    path = folder / "a.jsonl"
    with moving_session(path, machine, procedure, lambda _: Running(), window_s) as (g, bench, _):
        began = time.monotonic()
        measure_by_itself(g, bench.set_up, lambda _: None)
        took_s = time.monotonic() - began
        left = wrong(taken(path), bench)
    pure_s = ways.moving_s + ways.resting_s
    return {
        "steps": len(ways.steps),
        "readings": len(taken(path)),
        "wrong": left,
        "seconds": took_s,
        "pure_s": pure_s,
        "ratio": took_s / pure_s,
    }


def disturbed(folder: Path, seed: int, draws: int) -> dict[str, object]:
    """One session in which another client takes control, indicators are lost, keys stop it."""
    left, stops_s, met = with_faults(
        folder / "a.jsonl",
        seed,
        draws,
        make=lambda _: Running(),
        troubles=(Trouble.NAK, "indicator", "stop"),
    )
    return {"wrong": left, "longest_stop": max(stops_s), "met": met}


def killed(folder: Path) -> dict[str, object]:
    """The program is killed on the way: how far the machine still went."""
    real = Running()
    dying = subprocess.Popen([sys.executable, "-c", DIES, real.told])
    while real.axes.at_mm[0] < 2.0:
        time.sleep(0.01)
    dying.kill()
    began, at_mm = time.monotonic(), real.axes.at_mm[0]
    dying.wait()
    while real.axes.moving and time.monotonic() - began < PATIENCE_S:
        time.sleep(0.005)
    stopped_s, there_mm = time.monotonic() - began, real.axes.at_mm[0]
    real.close()
    return {"at_mm": at_mm, "there_mm": there_mm, "stopped_s": stopped_s}


DIES = """
import sys, time
from drivers.motion import controller_of
from drivers.motion.controller import Limits
from drivers.motion.line import MotionLine
line = MotionLine(controller_of(sys.argv[1], Limits((-100.0,) * 3, (60.0,) * 3, 120.0, 6000.0)))
line.start()
line.go([(50.0, 0.0, 0.0)], 300.0)
time.sleep(60.0)
"""


def main() -> None:
    folder, what, *rest = sys.argv[1:]
    if what == "session":
        name, feed, window = rest
        told = session(Path(folder), name, float(feed), float(window))
    elif what == "disturbed":
        told = disturbed(Path(folder), int(rest[0]), int(rest[1]))
    else:
        told = killed(Path(folder))
    print(json.dumps(told))


def figures() -> None:
    """Those of docs/benchmarks.md: two stations at 50 mm/s, with the procedure's own rest."""
    for words in (("session", "two-station", "3000", "1.0"), ("disturbed", "1", "8"), ("killed",)):
        print(words, commanded(Path(mkdtemp()), *words, timeout_s=1000.0), flush=True)


if __name__ == "__main__":
    if len(sys.argv) > 1:
        main()
    else:
        figures()
