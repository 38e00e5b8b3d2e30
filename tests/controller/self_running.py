"""A session that runs by itself through a real LinuxCNC, in a network of its own.

`commanded` starts LinuxCNC behind its text server and this module as a program beside it: that
plays the operator, who switches on and homes, and the indicators, which follow what the controller
reads back at that moment.
"""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import socketserver
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from tempfile import mkdtemp

from app.exports.linuxcnc import pins
from app.measuring.moving import ways_of
from app.measuring.unattended import measure_all
from calib.tripod.pipeline import Model
from drivers.motion import controller_of
from drivers.motion.controller import ControllerFault, Limits, MotionFault, Triple
from drivers.motion.line import MotionLine
from drivers.motion.states import State
from protocols.machine import Machine, MotionLimits
from protocols.procedure import load_procedure
from tests.app.measuring.moving_machine import (
    killed_and_continued,
    moving_session,
    taken,
    with_faults,
    wrong,
)
from tests.conftest import ROOT
from tests.controller import running
from tests.controller.machine import L
from tests.controller.machine import Machine as Machines
from tests.drivers.motion.bench import BUSY, Face, Ticker, comes_true
from tests.drivers.motion.twins import FailingAxes, MotionTrouble

PORT, TOLD_PORT = 5007, 5999
NOMINAL = Machines()
PATIENCE_S = 30.0
HERE = {"HOME": L, "HOME_OFFSET": L, "HOME_SEARCH_VEL": 0.0, "HOME_LATCH_VEL": 0.0}
"""The switch is here, now."""
BORNE = {"FERROR": 1.0, "MIN_FERROR": 0.1}
"""Following errors, mm; the simulated joint has none unless it is stuck."""

OUTER = """set -e
ip link set lo up
start=$1 folder=$2
again() {
    while true; do
        rm -rf "$folder"/tmp/*
        mkdir -m 777 "$folder/tmp/fifo"
        unshare -i -m -p -f --mount-proc --kill-child bash -c "$start" x "$folder" </dev/null &
        echo $! >"$folder/pid"
        wait $! || true
    done
}
again >"$folder/log" 2>&1 &
shift 2
"$@"
"""
"""The controller begins again when it is killed; all ends with the program, the first one here."""

BEFORE_OTHERS = ["nice", "-n", "-10"]
"""LinuxCNC has a computer of its own: where others are busy, it and its program run before them."""


INCH = {"MIN_LIMIT": -20, "MAX_LIMIT": 20, "HOME": 0.0, "HOME_OFFSET": 0.0}


def commanded(
    folder: Path, *words: str, timeout_s: float = 600.0, in_inches: bool = False
) -> dict[str, object]:
    """What this module tells, run as a program with these words beside LinuxCNC.

    With ``in_inches`` it is a machine whose joints are X, Y and Z.
    """
    running.need_linuxcnc()
    config = folder / "config"
    for place in (config, folder / "tmp"):
        place.mkdir(parents=True, exist_ok=True)
        place.chmod(0o777)
    ini = running.INI.replace("./pendant.py", "linuxcncrsh")
    ini += "".join(running.AXIS.format(name=name) for name in "XYZ")
    chain = "net estop iocontrol.0.user-enable-out iocontrol.0.emc-enable-in\n"
    assert chain in running.CORE
    hal = running.CORE.replace(chain, "") + "".join(running.WIRED.format(k=k) for k in range(3))
    hal += "loadusr -W ./teller.py\nnet estop teller.chain iocontrol.0.emc-enable-in\n"
    for k in range(3):
        entries = {**running.JOINT, **HERE, **BORNE, **(INCH if in_inches else {})}
        ini += f"[JOINT_{k}]\n" + "".join(f"{key} = {value}\n" for key, value in entries.items())
    kinematics = pins(Model())
    if in_inches:
        ini = ini.replace("LINEAR_UNITS = mm", "LINEAR_UNITS = inch")
        ini = ini.replace("orthoglidekins", "trivkins coordinates=XYZ")
        limits = "MIN_LIMIT = -20\nMAX_LIMIT = 20\n"
        ini = re.sub(r"(\[AXIS_.\]\n)", rf"\1{limits}", ini)
        kinematics = ""
    texts = {"machine.ini": ini, "core.hal": hal, "calib.hal": kinematics, "sim.tbl": ""}
    for name, text in texts.items():
        (config / name).write_text(text)
    teller = config / "teller.py"
    teller.write_text((running.HERE / "teller.py").read_text())
    teller.chmod(0o755)
    (folder / "modules").symlink_to(running.compiled())
    environment = {k: v for k, v in os.environ.items() if k != "DISPLAY"}
    at_controller = ("RTAPI_UID=65534", "RTAPI_FIFO_PATH=/tmp/fifo/rtapi", "HOME=/tmp")
    start = running.START.format(modules=running.MODULES, limit=running.TIME_OUT_S * 8)
    clean = " ".join(("env", *at_controller, "PATH=/usr/sbin:/usr/bin:/sbin:/bin"))
    start = start.replace("exec timeout", f"exec {clean} timeout")
    command = [sys.executable, "-m", "tests.controller.self_running", str(folder), *words]
    ended = subprocess.run(
        [
            *BEFORE_OTHERS,
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
            *command,
        ],
        cwd=ROOT,
        env=environment,
        check=False,
        capture_output=True,
        text=True,
        timeout=timeout_s,
    )
    assert ended.returncode == 0, ended.stdout[-3000:] + ended.stderr[-3000:]
    result: dict[str, object] = json.loads(ended.stdout.splitlines()[-1])
    return result


def reached() -> socket.socket:
    """A connection to the text server, as soon as it listens."""
    end = time.monotonic() + PATIENCE_S
    while True:
        try:
            return socket.create_connection(("127.0.0.1", PORT), timeout=PATIENCE_S)
        except OSError:
            if time.monotonic() > end:
                raise
            time.sleep(0.1)


class Client:
    """Another program at the text server, which takes control."""

    def __init__(self) -> None:
        self._socket = reached()
        with self._socket.makefile("rw", newline="\n") as lines:
            lines.write("hello EMC other 1\nset echo off\nset verbose on\nset enable EMCTOO\n")
            lines.flush()
            while lines.readline().strip() != "SET ENABLE ACK":
                pass

    def close(self) -> None:
        self._socket.close()


class Cable(socketserver.ThreadingTCPServer):
    """Between the program and the text server, to be cut."""

    daemon_threads = True

    def __init__(self) -> None:
        self._ends: list[socket.socket] = []
        cable = self

        class Handler(socketserver.BaseRequestHandler):
            def handle(self) -> None:
                cable.carry(self.request)

        super().__init__(("127.0.0.1", 0), Handler)
        self._thread = threading.Thread(target=self.serve_forever, args=(0.05,), daemon=True)
        self._thread.start()

    def carry(self, near: socket.socket) -> None:
        with suppress(OSError), socket.create_connection(("127.0.0.1", PORT)) as far:
            self._ends = [near, far]
            for end in self._ends:
                end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            back = threading.Thread(target=self._one_way, args=(far, near), daemon=True)
            back.start()
            self._one_way(near, far)
            back.join()

    @staticmethod
    def _one_way(from_: socket.socket, to: socket.socket) -> None:
        with suppress(OSError):
            while content := from_.recv(4096):
                to.sendall(content)
        for end in (from_, to):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def cut(self) -> None:
        for end in self._ends:
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        self.cut()
        self.shutdown()
        self.server_close()
        self._thread.join()


class FollowedAxes(FailingAxes):
    """Where the real controller's joints are, as `teller.py` tells all the time."""

    def __init__(self) -> None:
        super().__init__()
        self._told = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._told.bind(("127.0.0.1", TOLD_PORT))
        self._told.settimeout(PATIENCE_S)
        self._ends = self.ready = False
        self._joints = (L, L, L)
        self._changed = time.monotonic()
        self._thread = threading.Thread(target=self._follow, daemon=True)
        self._thread.start()
        while not hasattr(self, "_teller"):
            time.sleep(0.01)

    def _follow(self) -> None:
        while not self._ends:
            words, self._teller = self._told.recvfrom(200)
            *joints, homed, ready = map(float, words.split())
            x, y, z = joints
            self.ready = bool(ready)
            if homed and (x, y, z) != self._joints:
                self._joints, self._changed = (x, y, z), time.monotonic()

    def tell(self, wish: str) -> None:
        """What is done at the machine by hand."""
        self._told.sendto(wish.encode(), self._teller)

    def switch_on(self) -> None:
        """As its operator: on, and homed if it is not."""
        self.ready, end = False, time.monotonic() + PATIENCE_S
        again = 0.0
        while not self.ready:
            now = time.monotonic()
            assert now < end, "LinuxCNC does not get ready"
            if now > again:
                self.tell("on")
                again = now + 2.0
            time.sleep(0.02)

    @property
    def at_mm(self) -> Triple:
        x, y, z = NOMINAL.tool(self._joints).tolist()
        return x, y, z

    @property
    def joints(self) -> Triple:
        """Places of the joints, in the controller's unit."""
        return self._joints

    @property
    def changed_s(self) -> float:
        """When a joint was last seen to move."""
        return self._changed

    @property
    def moving(self) -> bool:
        return time.monotonic() - self._changed < 0.05

    def close(self) -> None:
        self._ends = True
        self._thread.join()
        self._told.close()


class Running:
    """The real controller in the place of a twin, switched on and homed by its operator."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        reached().close()
        self.followed = FollowedAxes()
        self.followed.switch_on()
        self._cable = Cable()
        self.endpoint = f"linuxcnc:127.0.0.1:{self._cable.server_address[1]}"
        self.axes: FailingAxes = self.followed
        self.moves: list[str] = []
        self.late_s = 0.0
        self._others: list[Client] = []
        self._befell: MotionTrouble | None = None

    def befall(self, trouble: MotionTrouble) -> None:
        self._befell = trouble
        match trouble:
            case MotionTrouble.NAK:
                self._others.append(Client())
            case MotionTrouble.HANG_UP:
                self._cable.cut()
            case MotionTrouble.ESTOP:
                self.followed.tell("estop")
            case MotionTrouble.FOLLOWING:
                self.followed.tell("stuck")
            case _:
                assert trouble is MotionTrouble.DIED
                os.kill(int((self._folder / "pid").read_text()), signal.SIGKILL)

    def mend(self) -> None:
        """What its operator does; control stays with nobody until the next move takes it.

        A fault may show itself later than it was caused: a machine that is off is switched on.
        """
        befell, self._befell = self._befell, None
        if befell is MotionTrouble.DIED:
            reached().close()
        off = befell in (MotionTrouble.ESTOP, MotionTrouble.FOLLOWING, MotionTrouble.DIED)
        if off or not self.followed.ready:
            self.followed.switch_on()

    def close(self) -> None:
        self.followed.close()
        self._cable.close()
        for client in self._others:
            client.close()


def session(folder: Path, name: str, feed: float, window_s: float) -> dict[str, object]:
    """One session without disturbance: what is wrong with it and how long it took."""
    machine = Machine(motion=MotionLimits(feed_mm_min=feed), fastest_feed_mm_min=60_000.0)
    procedure = load_procedure(name, machine.geometry()).model_copy(update={"window_s": window_s})
    ways = ways_of(procedure, machine, ("xyz", "xyz"))
    path = folder / "a.jsonl"
    real = moving_session(path, machine, procedure, lambda _: Running(folder), window_s)
    with real as (g, bench, _):
        began = time.monotonic()
        measure_all(g, bench.agree, lambda _: None)
        took_s = time.monotonic() - began
        faults = wrong(taken(path), bench)
    pure_s = ways.duration_s
    return {
        "steps": len(ways.steps),
        "readings": len(taken(path)),
        "wrong": faults,
        "seconds": took_s,
        "pure_s": pure_s,
        "ratio": took_s / pure_s,
    }


KINDS = (
    MotionTrouble.NAK,
    MotionTrouble.ESTOP,
    MotionTrouble.FOLLOWING,
    MotionTrouble.HANG_UP,
    MotionTrouble.DIED,
    "indicator",
    "stop",
)


def disturbed(folder: Path, seed: int, draws: int, kinds: Sequence[str] = ()) -> dict[str, object]:
    """One session with faults at random moments: these kinds, or all in turn."""
    faults, stops_s, count = with_faults(
        folder / "a.jsonl",
        seed,
        draws,
        make=lambda _: Running(folder),
        troubles=kinds or KINDS,
    )
    stops = {kind: max(s for s, name in stops_s if name == kind) for _, kind in stops_s}
    return {"wrong": faults, "stops_s": stops, "met": count}


def ended(folder: Path) -> dict[str, object]:
    """The program is killed, then suspended, on the way: how long and far the machine went on."""
    report: dict[str, object] = {}
    real, ticker = Running(folder), Ticker()
    for end in (signal.SIGKILL, signal.SIGSTOP):
        at_mm = real.axes.at_mm[0]
        program = subprocess.Popen([sys.executable, "-c", DIES, real.endpoint, f"{at_mm + 60.0}"])
        while real.axes.at_mm[0] < at_mm + 5.0:
            time.sleep(0.002)
        began_s, from_mm = time.monotonic(), real.axes.at_mm[0]
        program.send_signal(end)
        time.sleep(2.0)
        went_mm, went_s = real.axes.at_mm[0] - from_mm, real.followed.changed_s - began_s
        report[end.name] = {
            "went_s": went_s,
            "went_mm": went_mm,
            "moving": real.axes.moving,
            "held_up_s": ticker.held_up(began_s, began_s + went_s),
        }
        program.kill()
        program.wait()
    ticker.close()
    real.close()
    return report


DIES = """
import sys, time
from drivers.motion import controller_of
from drivers.motion.controller import Limits
from drivers.motion.line import MotionLine
limits = Limits((-100.0,) * 3, (160.0,) * 3, 120.0, 6000.0, coordinates="tool")
line = MotionLine(controller_of(sys.argv[1], limits))
line.start()
while not line.consent():
    time.sleep(0.05)
line.go([(float(sys.argv[2]), 0.0, 0.0)], 1200.0)
while True:
    line.alive()
    time.sleep(0.02)
"""

MEDDLERS = {
    "manual": ("manual", ""),
    "auto": ("auto", ""),
    "unhome": ("unhome", "on"),
    "override": ("override 0.5", "override 1.0"),
    "offset": ("mdi G92 X5", "mdi G92.1"),
    "jog": ("jog 10", ""),
    "move": ("mdi G21 G90 G53 G1 F600 X-20", ""),
    "hold": ("hold 1", "hold 0"),
}
"""What others do beside the program, and what its operator does about it."""

SOON_S = 30.0
TRIES = 5
MODES_LEFT = ("G20", "G7", "G91", "G20 G7 G91")


class Meddled:
    """A line beside which others do things, in one LinuxCNC."""

    def __init__(self, folder: Path) -> None:
        self._real = Running(folder)
        limits = Limits((-100.0,) * 3, (60.0,) * 3, 120.0, 6000.0, coordinates="tool")
        self._line = MotionLine(controller_of(self._real.endpoint, limits), BUSY)
        self._line.start()
        self._face = Face(self._line)
        self._ticker = Ticker()

    def close(self) -> None:
        self._ticker.close()
        self._line.close()
        self._face.hang()
        self._real.close()

    def go(self, place_mm: Triple, feed: float = 6000.0) -> float:
        """With a consent of its own; how long it took."""
        assert comes_true(self._line.consent)
        began_s = time.monotonic()
        self._line.go([place_mm], feed).result(PATIENCE_S)
        took_s = time.monotonic() - began_s
        self._line.release()
        return took_s

    def gone(self, place_mm: Triple) -> None:
        """There in the end: on a busy computer a move may be too late, and is sent again."""
        for _ in range(TRIES):
            self._answer()
            if comes_true(self._line.consent, SOON_S / TRIES):
                with suppress(ControllerFault):
                    self._line.go([place_mm], 6000.0).result(PATIENCE_S)
                    self._line.release()
                    return
        self.go(place_mm)

    def _answer(self) -> None:
        """The operator looked; who told the controller a word may have control for a moment yet."""
        for _ in range(TRIES):
            if self._line.state not in (State.HELD, State.FAULT):
                return
            self._line.answered().exception(PATIENCE_S)
            time.sleep(0.2)

    def sent(self) -> None:
        assert comes_true(self._line.consent)
        self._line.go([(40.0, 0.0, 0.0)], 1200.0)

    def at_rest(self, name: str) -> dict[str, object]:
        wish, mending = MEDDLERS[name]
        began_s = time.monotonic()
        self._real.followed.tell(wish)
        if name == "hold":  # it changes nothing that can be read at rest
            time.sleep(0.1)
            began_s = time.monotonic()
            self.sent()
        return self._noticed(began_s, mending)

    def on_the_way(self, name: str) -> dict[str, object]:
        wish, mending = MEDDLERS[name]
        assert any(self._under_way() for _ in range(TRIES))
        began_s = time.monotonic()
        self._real.followed.tell(wish)
        return self._noticed(began_s, mending)

    def _under_way(self) -> bool:
        """Not where the move came too late on a busy computer, as in `gone`."""
        self._answer()
        self.sent()

        def is_far() -> bool:
            return self._real.axes.at_mm[0] > 3.0

        comes_true(lambda: is_far() or self._line.state in (State.HELD, State.FAULT))
        return is_far()

    def with_modes(self, words: str) -> dict[str, object]:
        """Left behind by another client; they are left again before a move that came too late."""
        for _ in range(TRIES):
            self._real.followed.tell(f"mdi {words}")
            time.sleep(0.3)
            try:
                took_s = self.go((10.0, 0.0, 0.0), 600.0)
            except ControllerFault as problem:
                if problem.kind != MotionFault.LATE:
                    raise
                self.gone((0.0, 0.0, 0.0))
            else:
                at_mm = self._real.axes.at_mm[0]
                self.gone((0.0, 0.0, 0.0))
                return {"took_s": took_s, "at_mm": at_mm}
        raise AssertionError(f"too late {TRIES} times after {words}")

    def _noticed(self, began_s: float, mending: str) -> dict[str, object]:
        line, real = self._line, self._real
        comes_true(lambda: line.state in (State.HELD, State.FAULT), SOON_S)
        seen_s = time.monotonic()
        report: dict[str, object] = {"seen_s": seen_s - began_s}
        report |= {"state": line.state, "why": line.why}
        time.sleep(0.3)
        report |= {"held_up_s": self._ticker.held_up(began_s, seen_s)}
        report |= {"went_s": real.followed.changed_s - began_s, "moving": real.axes.moving}
        report |= {"at_mm": real.axes.at_mm[0]}
        # what another client sent ends; on a busy computer nobody tells of it for a moment
        assert comes_true(lambda: time.monotonic() - real.followed.changed_s > 0.5)
        if mending == "on":
            real.followed.switch_on()
        elif mending:
            real.followed.tell(mending)
        time.sleep(0.3)
        self._answer()
        report |= {"after_mm": real.axes.at_mm[0]}
        self.gone((-5.0, 0.0, 0.0))
        self.gone((0.0, 0.0, 0.0))
        return report


def meddled(folder: Path) -> dict[str, object]:
    """Each of `MEDDLERS`: when the machine rests, and what is then said."""
    report: dict[str, object] = {}
    meddling = Meddled(folder)
    try:
        meddling.gone((0.0, 0.0, 0.0))
        for name in MEDDLERS:
            report[f"{name} at rest"] = meddling.at_rest(name)
            if name != "move":  # it waits for the end of ours
                report[f"{name} on the way"] = meddling.on_the_way(name)
        for words in MODES_LEFT:
            report[words] = meddling.with_modes(words)
    finally:
        meddling.close()
    return report


def inch(folder: Path) -> dict[str, object]:
    """A machine of three joints in inches: how far and how long it goes when it is sent 10 mm."""
    real = Running(folder)
    report: dict[str, object] = {}
    for name, low_mm in (("beyond", -600.0), ("within", -100.0)):
        limits = Limits((low_mm,) * 3, (100.0,) * 3, 120.0, 6000.0, coordinates="joint")
        line = MotionLine(controller_of(real.endpoint, limits), BUSY)
        line.start()
        face = Face(line)
        before = real.followed.joints
        line.consent()
        began_s = time.monotonic()
        way = line.go([(10.0, -4.0, 0.0)], 600.0)
        problem = way.exception(PATIENCE_S)
        report[name] = {
            "took_s": time.monotonic() - began_s,
            "problem": str(problem or ""),
            "went": [b - a for a, b in zip(before, real.followed.joints, strict=True)],
            "read_mm": None if problem else way.result(),
        }
        line.close()
        face.hang()
    real.close()
    return report


def main() -> None:
    folder, what, *arguments = sys.argv[1:]
    if what == "session":
        name, feed, window = arguments
        report = session(Path(folder), name, float(feed), float(window))
    elif what == "disturbed":
        report = disturbed(Path(folder), int(arguments[0]), int(arguments[1]), arguments[2:])
    elif what == "continued":
        parameters = Path(folder), int(arguments[0]), int(arguments[1]), float(arguments[2])
        report = killed_and_continued(*parameters, lambda _: Running(Path(folder)))
    else:
        report = {"ended": ended, "meddled": meddled, "inch": inch}[what](Path(folder))
    print(json.dumps(report))


def figures() -> None:
    """Those of docs/benchmarks.md: two stations at 50 mm/s, with the procedure's own rest."""
    faults = [("disturbed", str(seed), "99") for seed in range(5, 12)]
    continued = [("continued", str(seed), "7", "3000") for seed in (2, 3)]
    for words in (("session", "two-station", "3000", "1.0"), ("ended",), *continued, *faults):
        print(words, commanded(Path(mkdtemp()), *words, timeout_s=1000.0), flush=True)


if __name__ == "__main__":
    if len(sys.argv) > 1:
        main()
    else:
        figures()
