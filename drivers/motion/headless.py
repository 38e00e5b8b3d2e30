"""A LinuxCNC of this computer behind simulated joints, started for a demonstration.

Its own kinematics are trivial: X, Y and Z are three carriages. A motor drives each, a switch closes
at one place of the motor, and homing finds it; where the carriage is then, only who simulates the
machine knows. Nothing but the package ``linuxcnc-uspace`` is needed.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

from calib.errors import MotionError, UsageError
from drivers.motion.controller import ControllerFault, Limits, Triple
from drivers.motion.linuxcnc import ACCEPT_S, PASSWORDS, LinuxCnc
from drivers.motion.twins import PASSED

OPTION = "--controller linuxcnc"
PROGRAMS = ("linuxcnc", "linuxcncrsh", "halcmd", "pidof", "stdbuf")
TWIN_ADVICE = "--controller twin shows the same without it."
LOCK = Path("/tmp/linuxcnc.lock")
PROCESSES = ("linuxcncsvr", "milltask", "rtapi_app")
START_S, END_S = 30.0, 15.0


ROOM_MM = 20.0
"""Of the joint limits beyond the box: the switches stand there."""


@dataclass(frozen=True)
class SimulatedJoints:
    """Three joints in mm: where Zero is and how far they go, and where the controller homes them.

    ``home_offset_mm`` is what its file holds; files of ``includes``, ``calib_joint0.inc`` …,
    come before it. A switch closes where its motor is at ``switch_mm``; where a motor is at 0 the
    carriage is at ``mounted_mm``.
    """

    zero_mm: Triple
    low_mm: Triple
    high_mm: Triple
    home_offset_mm: Triple
    switch_mm: float
    mounted_mm: Triple
    includes: Mapping[str, str]


def check_linuxcnc() -> None:
    """Raises UsageError where no LinuxCNC can be started."""
    missing = [name for name in PROGRAMS if shutil.which(name) is None]
    if missing:
        next_step = f"On Debian: apt install linuxcnc-uspace. {TWIN_ADVICE}"
        raise UsageError(
            OPTION, f"no {missing[0]} here", "LinuxCNC 2.9 on this computer", next_step
        )
    if sys.platform != "win32" and os.geteuid() == 0 and "RTAPI_UID" not in os.environ:
        obstacle = "root; LinuxCNC does not start as root"
        raise UsageError(OPTION, obstacle, "an ordinary user", TWIN_ADVICE)
    if LOCK.exists() or not subprocess.run(["pidof", *PROCESSES], capture_output=True).returncode:
        obstacle = "a LinuxCNC that is running: starting a second one would end it"
        next_step = f"Close it; if there is none, remove {LOCK}. {TWIN_ADVICE}"
        raise UsageError(OPTION, obstacle, "none", next_step)


class Motors:
    """Where the motors are at that moment, as HAL says, counted from ``mounted_mm``."""

    def __init__(self, mounted_mm: Triple, environment: Mapping[str, str]) -> None:
        self._mounted, self._last, self._lock = mounted_mm, mounted_mm, threading.Lock()
        self._hal = subprocess.Popen(
            # stdbuf: into a pipe halcmd would hold its answers back
            ["stdbuf", "-oL", "halcmd", "-s", "-k", "-f"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env=environment,
        )
        self._passed: deque[Triple] = deque(maxlen=PASSED)
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._follow, name="motors", daemon=True)
        self._thread.start()

    def _follow(self) -> None:
        last = self._mounted
        # motors are looked at so often: a machine that comes from below is below for longer
        while not self._ends.wait(0.005):
            if (now := self.at_mm) != last:
                self._passed.append(now)
                last = now

    def passed_mm(self) -> list[Triple]:
        """Where they were since this was asked last, and where they are now."""
        return [*(self._passed.popleft() for _ in range(len(self._passed))), self.at_mm]

    @property
    def at_mm(self) -> Triple:
        """Joint coordinates; of a controller that is gone the last ones."""
        commands, answers = self._hal.stdin, self._hal.stdout
        assert commands is not None
        assert answers is not None
        with self._lock, contextlib.suppress(OSError, ValueError):
            commands.write("".join(f"getp joint.{k}.motor-pos-fb\n" for k in range(3)))
            commands.flush()
            motors = [float(line) for line in (answers.readline() for _ in range(3))]
            x, y, z = (a + b for a, b in zip(self._mounted, motors, strict=True))
            self._last = x, y, z
        return self._last

    def close(self) -> None:
        """No more questions."""
        self._ends.set()
        self._hal.kill()  # first: who waits for its answer waits no more
        self._thread.join()
        self._hal.communicate()


class _Operator(LinuxCnc):
    """Who switches on and homes: glidecal never does, nor does its driver."""

    def prepare(self) -> None:
        for setting, name, value in (
            ("estop off", "estop", "OFF"),
            ("machine on", "machine", "ON"),
            ("mode manual", "mode", "MANUAL"),
            ("home -1", "joint_homed", "YES YES YES NO NO NO"),  # of six joints, whatever there are
        ):
            self._set(setting, ACCEPT_S)
            end_s = time.monotonic() + START_S
            while (answer := self._get(name)) != value:
                if time.monotonic() > end_s:
                    raise MotionError(f"LinuxCNC, {name}", answer, value, TWIN_ADVICE)
                time.sleep(0.05)
        self.ready()


class HeadlessLinuxCnc:
    """LinuxCNC, switched on and homed, as long as it is open; its files lie in a folder of its own.

    Its text server can be reached on every network address, so it gets passwords nobody knows.
    Raises UsageError where there is no LinuxCNC, MotionError where it does not get ready.
    """

    def __init__(self, joints: SimulatedJoints) -> None:
        check_linuxcnc()
        with socket.create_server(("127.0.0.1", 0)) as free:
            port = free.getsockname()[1]
        self.endpoint = f"linuxcnc:127.0.0.1:{port}"
        connect, enable = secrets.token_hex(6), secrets.token_hex(6)
        self._folder = Path(tempfile.mkdtemp(prefix="glidecal-linuxcnc-"))
        self._passwords = os.environ.get(PASSWORDS)
        os.environ[PASSWORDS] = f"{connect} {enable}"  # for the guard beside this program, too
        # it ends, and all of LinuxCNC with it, when the program that started it does, whatever way
        display = _template("display").format(port=port, connect=connect, enable=enable)
        for name, text in {**_files(joints), "display": display, "sim.tbl": ""}.items():
            (self._folder / name).write_text(text, encoding="utf-8")
        (self._folder / "display").chmod(0o700)
        environment = {name: value for name, value in os.environ.items() if name != "DISPLAY"}
        environment["HOME"] = str(self._folder)  # its logs
        with (self._folder / "log").open("w") as log:
            self._running = subprocess.Popen(
                ["linuxcnc", "-r", "machine.ini"],
                cwd=self._folder,
                env=environment,
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=log,
                start_new_session=True,  # a key that ends this program lets it clean up
            )
        try:
            self._homed(Limits(joints.low_mm, joints.high_mm, 0.0, 0.0))
            self.axes = Motors(joints.mounted_mm, environment)
        except BaseException:
            self._end()
            raise

    def _homed(self, limits: Limits) -> None:
        operator = _Operator(self.endpoint.removeprefix("linuxcnc:"), limits)
        operator.answer_s = ACCEPT_S
        end_s = time.monotonic() + START_S
        while True:
            try:
                operator.connect()
                break
            except ControllerFault as problem:
                if self._running.poll() is not None or time.monotonic() > end_s:
                    raise MotionError(
                        "LinuxCNC, start", self._log_end(), "", TWIN_ADVICE
                    ) from problem
                time.sleep(0.1)
        try:
            operator.prepare()
        finally:
            operator.close()

    def _log_end(self) -> str:
        """The last that it said, without the names of its logs: they are removed with it."""
        log = (self._folder / "log").read_text(encoding="utf-8", errors="replace")
        # characters of its log in a sentence
        return " ".join(log.partition("LinuxCNC terminated")[0].split())[-250:]

    def close(self) -> None:
        """End it and remove its files."""
        self.axes.close()
        self._end()

    def _end(self) -> None:
        if self._running.stdin is not None:
            self._running.stdin.close()
        try:
            self._running.wait(END_S)
        except subprocess.TimeoutExpired:
            self._running.kill()
            self._running.wait()
        shutil.rmtree(self._folder, ignore_errors=True)
        os.environ.pop(PASSWORDS, None)
        if self._passwords is not None:
            os.environ[PASSWORDS] = self._passwords


def _files(joints: SimulatedJoints) -> dict[str, str]:
    """What LinuxCNC reads, by name."""
    ini, hal = _template("machine.ini"), _template("machine.hal")
    for k, axis in enumerate("XYZ"):
        name = f"calib_joint{k}.inc"
        # homing ends within what it goes in one period at HOME_LATCH_VEL: 0.3 mm/s in 1 ms
        ini += _template("joint.ini").format(
            axis=axis,
            k=k,
            include=f"#INCLUDE {name}\n" if name in joints.includes else "",
            home_offset=joints.home_offset_mm[k],
            home=joints.zero_mm[k],
            low=joints.low_mm[k] - ROOM_MM,
            high=joints.high_mm[k] + ROOM_MM,
        )
        hal += _template("joint.hal").format(k=k, switch=joints.switch_mm)
    return {"machine.ini": ini, "machine.hal": hal, **joints.includes}


def _template(name: str) -> str:
    """A file that LinuxCNC reads, with fields to be filled in."""
    return resources.files("drivers.motion").joinpath("linuxcnc_files", name).read_text("utf-8")
