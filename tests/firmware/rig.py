"""A board that runs real firmware, at a serial port, with three carriages on it.

Where the carriages are, the pulses tell that left the board: neither the firmware's belief nor the
driver under test has a part in it. What is done at the machine by hand is done here: power, homing,
keys of the panel.
"""

from __future__ import annotations

import mmap
import os
import queue
import re
import struct
import subprocess
import threading
import time
import tty
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from types import MappingProxyType

from drivers.motion.controller import Triple
from protocols.machine import Machine as MachineFile
from protocols.machine import MotionLimits
from tests.controller.machine import L
from tests.drivers.motion.twins import FailingAxes, MotionTrouble
from tests.firmware.sources import compiled

PULSES_A_MM = 160
TRAVEL_MM = 400.0
FASTEST_MM_MIN = 9000.0
SWITCH_MM = -20.0
"""The switch of each carriage, from where that is when the power comes on."""

AT_POWER_ON_MM = (L + 3.0, L - 2.0, L + 1.0)
"""Where its operator leaves the machine, in joint coordinates; Zero of an Orthoglide is at L."""

SETTINGS = {
    "10": 1,  # MPos
    "13": 0,  # mm
    "22": 1,  # homing
    "20": 1,  # soft limits, which it takes after homing only
    "23": 7,  # towards the lower end
    "24": 200,
    "25": 3000,
    "26": 25,
    "27": 1,
    **{f"10{k}": PULSES_A_MM for k in range(3)},
    **{f"11{k}": int(FASTEST_MM_MIN) for k in range(3)},
    **{f"12{k}": 500 for k in range(3)},
    **{f"13{k}": int(TRAVEL_MM) for k in range(3)},
}
OWN_SETTINGS: Mapping[str, Mapping[str, int]] = MappingProxyType(
    {"grbl": {}, "grblHAL": {"22": 1 + 4 + 8}}
)
"""A grblHAL is locked until it is homed, and counts from its switches, by bits of $22."""

OWN_NONE: Mapping[str, int] = MappingProxyType({})
IN_JOINTS = MachineFile(
    mdi="joint",
    motion=MotionLimits(feed_mm_min=FASTEST_MM_MIN),
    fastest_feed_mm_min=60_000.0,
)
HOLD, RESET, START, ESTOP = 1, 2, 4, 8
"""Keys of the panel."""

FORM = struct.Struct("=3ii3ii")
PRESSED = struct.Struct("=i")
PATIENCE_S = 40.0
LOOK_S = 0.002
RESTS_S = 0.08
"""Longer than a frame of the simulator, in which it does nothing at all."""

STARTED, LOCKED = "Grbl", "ALARM:11"
"""What both say when their power comes on, and one of them until it is homed."""

JOG = re.compile(rb"\$J=[^\n]*")


class CountedAxes(FailingAxes):
    """Where the carriages are, by the pulses that were counted since the machine was homed."""

    def __init__(self, memory: mmap.mmap) -> None:
        super().__init__()
        self._memory = memory
        self._home = (0, 0, 0)
        self._ends = False
        self.changed_s = time.monotonic()
        self._thread = threading.Thread(target=self._follow, daemon=True)
        self._thread.start()

    def _follow(self) -> None:
        before = self._turns()
        while not self._ends:
            now = self._turns()
            if now != before:
                before, self.changed_s = now, time.monotonic()
            time.sleep(LOOK_S)

    def _turns(self) -> int:
        return int(FORM.unpack_from(self._memory)[3])

    def _pulses(self) -> tuple[int, int, int]:
        x, y, z, *_ = FORM.unpack_from(self._memory)
        return x, y, z

    def homed(self) -> None:
        """The carriages are where the firmware counts from."""
        self._home = self._pulses()

    @property
    def joints_mm(self) -> Triple:
        """Places of the carriages in the coordinates of the firmware."""
        x, y, z = (
            (now - home) / PULSES_A_MM for now, home in zip(self._pulses(), self._home, strict=True)
        )
        return x, y, z

    @property
    def at_mm(self) -> Triple:
        """Where the carriages are: what this board counts in."""
        return self.joints_mm

    @property
    def moving(self) -> bool:
        return time.monotonic() - self.changed_s < RESTS_S

    def close(self) -> None:
        self._ends = True
        self._thread.join()


class Board:
    """In the place of a twin: a board with firmware, homed by its operator."""

    def __init__(
        self,
        firmware: str,
        *,
        homed: bool = True,
        unlocked: bool = False,
        settings: Mapping[str, int] = OWN_NONE,
    ) -> None:
        folder = Path(mkdtemp(prefix="glidecal-run-"))
        changes = {**OWN_SETTINGS[firmware], **settings}
        (folder / "EEPROM.DAT").write_bytes(_configured(firmware, tuple(changes.items())))
        self._simulator = Simulator(firmware, folder)
        self.moves: list[str] = []
        self.late_s = 0.0
        self.carriages = CountedAxes(self._simulator.memory)
        self.axes: FailingAxes = self.carriages
        if homed or unlocked:
            try:
                self._home() if homed else self._simulator.done("$X")
            except AssertionError:
                self._simulator.close()
                self.carriages.close()
                raise
        self._ours, self._theirs = os.openpty()
        tty.setraw(self._theirs)  # held open: a port does not hang up when a program leaves it
        self.endpoint = f"grbl:{os.ttyname(self._theirs)}"
        self._simulator.answer_to(self._ours)
        self._thread = threading.Thread(target=self._carry, daemon=True)
        self._thread.start()

    def _home(self) -> None:
        """What its operator does with another program, which lets go of the port then."""
        self._simulator.done("$H")
        self.carriages.homed()
        x, y, z = AT_POWER_ON_MM
        self._simulator.done(f"$J=G21G90G53X{x}Y{y}Z{z}F{FASTEST_MM_MIN * 3**0.5:.0f}")
        end = time.monotonic() + PATIENCE_S
        off = 1.0
        while off > 1.0 / PULSES_A_MM or self.carriages.moving:
            assert time.monotonic() < end, f"the carriages are at {self.carriages.joints_mm}"
            time.sleep(LOOK_S)
            off = max(abs(a - b) for a, b in zip(self.carriages.joints_mm, (x, y, z), strict=True))

    def _carry(self) -> None:
        line = b""
        while received := self._read():
            with suppress(OSError, ValueError):  # a guard may still speak while all is closed
                self._simulator.send(received)
            *lines, line = (line + received).split(b"\n")
            for words in lines:
                self.moves += [jog.decode("latin-1") for jog in JOG.findall(words)]

    def _read(self) -> bytes:
        try:
            return os.read(self._ours, 4096)
        except OSError:
            return b""

    def press(self, keys: int) -> None:
        """Keys of the panel that are held from now on."""
        self._simulator.press(keys)

    def from_elsewhere(self, words: bytes) -> None:
        """Sent by another program through another way into the board; all hear its answers."""
        self._simulator.send(words)

    def befall(self, trouble: MotionTrouble) -> None:
        raise NotImplementedError(f"{trouble}: done at a board by its panel")

    def mend(self) -> None:
        self.press(0)

    def close(self) -> None:
        self._simulator.close()
        self.carriages.close()
        os.close(self._theirs)  # the last end: the thread that reads ours hears it
        self._thread.join()
        os.close(self._ours)


class Simulator:
    """The process, its memory, and who hears its answers: the operator, or a port."""

    def __init__(self, firmware: str, folder: Path) -> None:
        path = folder / "board"
        at = round(SWITCH_MM * PULSES_A_MM)
        path.write_bytes(FORM.pack(0, 0, 0, 0, at, at, at, 0))
        with path.open("r+b") as file:
            self.memory = mmap.mmap(file.fileno(), FORM.size)
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._port: int | None = None
        self._lock = threading.Lock()
        self._process = subprocess.Popen(
            [compiled(firmware), "-n", "-s", os.devnull, "-b", os.devnull],
            cwd=folder,
            env={**os.environ, "GLIDECAL_BOARD": str(path)},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            bufsize=0,
        )
        self._thread = threading.Thread(target=self._hear, daemon=True)
        self._thread.start()
        self._until(STARTED)

    def _hear(self) -> None:
        assert self._process.stdout is not None
        line = b""
        while received := os.read(self._process.stdout.fileno(), 4096):
            with self._lock:
                if self._port is not None:
                    os.write(self._port, received)
                    continue
            *lines, line = (line + received).split(b"\n")
            for words in lines:
                self._lines.put(words.decode("latin-1").strip())

    def send(self, words: bytes) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(words)

    def done(self, line: str) -> None:
        """A line by the operator, acknowledged."""
        self.send(f"{line}\n".encode())
        self._until("ok")

    def _until(self, prefix: str) -> None:
        end, lines = time.monotonic() + PATIENCE_S, list[str]()
        while not (lines and lines[-1].startswith(prefix)):
            try:
                lines.append(self._lines.get(timeout=max(0.0, end - time.monotonic())))
            except queue.Empty:
                raise AssertionError(f"no {prefix!r} but {lines}") from None
            if lines[-1] != LOCKED and prefix != STARTED:
                assert not lines[-1].startswith(("error:", "ALARM:")), lines

    def answer_to(self, port: int) -> None:
        """From now on what it answers is heard there."""
        with self._lock:
            self._port = port

    def press(self, keys: int) -> None:
        PRESSED.pack_into(self.memory, FORM.size - PRESSED.size, keys)

    def close(self) -> None:
        self._process.kill()
        self._process.wait()
        self._thread.join()
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        self._process.stdout.close()


@cache
def _configured(firmware: str, changes: tuple[tuple[str, int], ...]) -> bytes:
    """What a board keeps without power once its settings were written."""
    folder = Path(mkdtemp(prefix="glidecal-run-"))
    simulator = Simulator(firmware, folder)
    for number, value in {**SETTINGS, **dict(changes)}.items():
        simulator.done(f"${number}={value}")
    simulator.close()
    return (folder / "EEPROM.DAT").read_bytes()
