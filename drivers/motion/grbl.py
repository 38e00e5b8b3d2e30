"""grbl 1.1 and grblHAL over a serial port: three carriages as X, Y, Z in joint coordinates.

A move is a jog (``$J=``): it keeps to soft limits, and 0x85 ends it without a reset and without a
lost position. Where it ends ``?`` tells; ``G4`` is acknowledged when nothing is left to do. The
port is opened once, for many boards start anew whenever that happens, and lose their homing.
"""

from __future__ import annotations

import contextlib
import os
import re
import select
import socket
import time
from typing import ClassVar, Literal

from calib.errors import IndicatorError, sentence
from drivers.motion.controller import (
    MM_PER_INCH,
    SLICE_S,
    Controller,
    ControllerFault,
    Deadline,
    Limits,
    MotionFault,
    NoLine,
    Snapshot,
    Triple,
)
from drivers.port import PORT_ERRORS, SerialPort, cannot_open, check_port, close_port, open_serial
from drivers.profile import LineSettings

LINE = LineSettings(baud=115200, dtr=False, rts=False)
"""With DTR or RTS a board starts anew each time."""

WAKE_S = 3.5
"""Many boards start anew when their port is opened."""

ACCEPT_S = 1.0
HOMING_S = 180.0
ASK_AGAIN_S = 0.2
FULL_REPORT, REPORT = b"\x87", b"?"
"""grblHAL tells all of its state for the first; grbl 1.1 drops it, and tells parts in turn."""

JOG_CANCEL, FEED_HOLD, RESET = b"\x85", b"!", b"\x18"
TURN = 32
"""So many reports tell each part once (grbl 1.1: overrides every 10 or 20, offsets 10 or 30)."""

STATUS = re.compile(r"<(\w+)(?::(\d+))?\|(.*)>", re.ASCII)
SETTING = re.compile(r"\$(\d+)=([-+.\d]+)", re.ASCII)
VERSION = re.compile(r"\[VER:1\.1\w?\.", re.ASCII)
ERROR_WORDS = {"9": "locked, as after an alarm", "15": "beyond its soft limits", "22": "no feed"}
MOVING = ("Jog", "Run", "Home")
SUPERVISED = ("Ov", "WCO", "H")


class Descriptor:
    """The port of another process, by its file descriptor."""

    def __init__(self, number: int) -> None:
        self._number = number

    def read(self, size: int = 1) -> bytes:
        """What comes within `SLICE_S`."""
        if select.select([self._number], [], [], SLICE_S)[0]:
            with contextlib.suppress(BlockingIOError):
                return os.read(self._number, size)
        return b""

    def write(self, data: bytes, /) -> int:
        """Send."""
        return os.write(self._number, data)

    def fileno(self) -> int:
        """Number of the descriptor."""
        return self._number

    def close(self) -> None:
        """Let go of it; the other process keeps its own."""
        with contextlib.suppress(OSError):
            os.close(self._number)


AXIS_SETTINGS = ("3", "100", "101", "102")
"""Settings that turn a carriage round, or move it another length."""


class Grbl(Controller):
    """One board on one port, which nobody else opens meanwhile."""

    name: ClassVar[str] = "grbl"
    form: ClassVar[str] = "PORT"
    coordinates: ClassVar[Literal["tool", "joint"] | None] = "joint"

    def __init__(self, address: str, limits: Limits) -> None:
        super().__init__(address, limits)
        self.wire: SerialPort | Descriptor | None = None
        self._unit_mm = 1.0
        self._ask = REPORT
        self._firmware = ""
        self.state = self._part = ""
        self._fields: dict[str, str] = {}
        self._acknowledged = True
        self._answers_more = False
        self._under_way = 0
        self.tells_homing = False

    def connect(self) -> None:
        """Open the port and wait for a status report; nothing is asked of the machine.

        In a hold it is not asked who it is: its lines would wait for the hold's end.
        """
        if self.wire is None:
            self.wire = self._opened()
        try:
            self._wake()
            if self.state in ("Idle", "Alarm"):
                self._identify()
        except ControllerFault:
            self.close()
            raise

    def renew(self) -> None:
        """Speak through the port again, which is opened anew only where it is gone."""
        self._drain()
        self.connect()

    def adopt(self, descriptor: int) -> None:
        """Speak through the open port of another process, whose last line may wait in the board."""
        self.wire = Descriptor(descriptor)
        self._acknowledged = False

    def handles(self) -> tuple[int, ...]:
        """The port, which cannot be opened twice."""
        # not on Windows
        return (self.wire.fileno(),) if self.wire and hasattr(self.wire, "fileno") else ()

    def _opened(self) -> SerialPort:
        try:
            check_port(self.address)
            return open_serial(self.address, LINE, SLICE_S, self.answer_s)
        except IndicatorError as problem:
            raise self.fault(MotionFault.UNREACHABLE, problem.found, problem.allowed) from problem
        except PORT_ERRORS as problem:
            cause = cannot_open(self.address, problem)
            next_step = sentence(cause.next_step)
            raise self.fault(MotionFault.UNREACHABLE, cause.reason, "", next_step) from problem

    def _wake(self) -> None:
        """The first status report; raises with what came in its place."""
        deadline, sample = Deadline(WAKE_S), ""
        self._acknowledged = True
        while not deadline.over:
            self._question(REPORT)
            retry = Deadline(min(self.answer_s, WAKE_S))
            while not retry.over:
                try:
                    line = self._line(retry)
                except NoLine:
                    break
                if self._note(line) is not None:
                    return
                if not line.startswith(("Grbl", "grbl", "[MSG", "ok")):
                    sample = line
        value = f"{sample[:60]!r}" if sample else "no answer"
        requirement, next_step = "a status report of grbl", "Is another device at this port?"
        raise self.fault(MotionFault.STRANGER, value, requirement, next_step)

    def _identify(self) -> None:
        answers = self._done("$I")
        version = next((line for line in answers if line.startswith("[VER:")), "no [VER:…]")
        if not VERSION.match(version):
            raise self.fault(MotionFault.STRANGER, f"firmware {version}", "grbl 1.1 or grblHAL")
        letters = next((line for line in answers if line.startswith("[AXS:")), "[AXS:3:XYZ]")
        if not letters.rstrip("]").endswith("XYZ"):
            raise self.fault(MotionFault.STRANGER, letters, "the axes X Y Z")
        self._ask = FULL_REPORT if any("grblHAL" in line for line in answers) else REPORT
        self._firmware = version

    def ready(self) -> tuple[str, ...]:
        """What is right, in the controller's own words."""
        self.homing = False
        self._status()
        self.locked = self.state == "Alarm"
        if self.state not in ("Idle", "Alarm"):
            raise self._not_idle("At the controller: end its present task.")
        settings = dict(SETTING.findall("\n".join(self._done("$$"))))
        homing = settings.get("22", "none")
        if not (homing.isdecimal() and int(homing) & 1):  # of grblHAL a mask
            next_step = "Without homing the positions of its carriages are unknown."
            raise self.fault(MotionFault.NOT_READY, f"$22={homing}", "$22=1", next_step)
        self._unit_mm = MM_PER_INCH if settings.get("13") == "1" else 1.0
        self._check_travel(settings)
        if self.locked:
            raise self._not_idle("It is locked until it is homed.")
        self._survey()
        self.tells_homing = "H" in self._fields
        if not self._fields.get("H", "1").startswith("1"):
            raise self.fault(MotionFault.NOT_READY, f"H:{self._fields['H']}", "H:1", "Home it.")
        soft = settings.get("20", "none")
        return (
            self._firmware,
            f"state {self.state}",
            "H:1: homed" if self.tells_homing else f"$22={homing}: it locks until it is homed",
            f"$13={settings.get('13', 'none')}: {'inch' if self._unit_mm != 1.0 else 'mm'}",
            f"$20={soft}: {'its own soft limits are on' if soft == '1' else 'no soft limits'}",
            " ".join(f"${number}={settings.get(number, 'none')}" for number in AXIS_SETTINGS)
            + ": directions, and steps a mm",
        )

    def _not_idle(self, next_step: str) -> ControllerFault:
        value = f"state {self._words}"
        return self.fault(MotionFault.NOT_READY, value, "state Idle", next_step)

    def _check_travel(self, settings: dict[str, str]) -> None:
        """Raises where the box of the machine file is no part of the travel of this board."""
        box = zip(("130", "131", "132"), self.limits.low_mm, self.limits.high_mm, strict=True)
        for number, low_mm, high_mm in box:
            travel_mm = abs(self.finite(settings.get(number, "none")))
            ends_mm = max(abs(low_mm), abs(high_mm))
            if high_mm - low_mm > travel_mm or ends_mm > travel_mm:
                raise self.fault(
                    MotionFault.STRANGER,
                    f"${number}={travel_mm:g}, its travel in mm",
                    f"a travel that contains {low_mm:g} … {high_mm:g} mm of the machine file",
                    "Is it the board of another machine?",
                )

    @property
    def _words(self) -> str:
        return f"{self.state}:{self._part}" if self._part else self.state

    def look(self) -> Snapshot:
        """One look at the state of the board; parts of it are told in turn."""
        return self._snapshot(self._status())

    def survey(self) -> Snapshot:
        """A look that holds every part of the state."""
        return self._snapshot(self._survey())

    def _survey(self) -> Triple:
        self._fields.clear()
        place_mm = self._status()
        for _ in range(1 if self._ask == FULL_REPORT else TURN):
            if {"Ov", "WCO"} <= self._fields.keys():
                return place_mm
            place_mm = self._status()
        if self.state == "Idle":  # a board whose $10 leaves them out
            offsets = [line for line in self._done("$#") if line.startswith(("[G92:", "[TLO:"))]
            self._fields["WCO"] = " ".join(offsets)
        return place_mm

    def _snapshot(self, place_mm: Triple) -> Snapshot:
        if self.state not in ("Idle", "Jog"):
            value = f"state {self._words}"
            raise self.fault(MotionFault.CONTROLLER, value, "Idle, or Jog on the way")
        states = {name: self._fields[name] for name in SUPERVISED if name in self._fields}
        return Snapshot(place_mm, self.state == "Jog", states)

    def begin(self, to_mm: Triple, feed_mm_min: float) -> None:
        """Send a jog in machine coordinates and mm, whatever units and offsets the board has."""
        coordinates = "".join(f"{name}{mm:.4f}" for name, mm in zip("XYZ", to_mm, strict=True))
        self._done(f"$J=G21G90G53{coordinates}F{feed_mm_min:.1f}")

    def settle(self) -> Snapshot:
        """A look behind a pause, which is acknowledged when nothing is before it."""
        self._done("G4P0.01")
        return self.look()

    def home(self) -> None:
        """Home all carriages, as the operator confirmed; only a reset ends that."""
        self.homing = True  # until it is done
        self._done("$H", HOMING_S)
        self.homing = False

    def close(self) -> None:
        """Let go of the port."""
        wire, self.wire, self._received = self.wire, None, b""
        shared: socket.socket | None = getattr(wire, "_socket", None)
        if shared is not None:  # pyserial would shut it down, for the guard, too
            shared.close()
        if isinstance(wire, Descriptor):
            wire.close()
        elif wire is not None:
            close_port(wire)

    def send_stop(self, attempt: int) -> None:
        """End the jog; no reset, no position lost. Homing hears nothing but a reset."""
        if self.wire is None:  # its cable is out; it may be back
            self.wire = self._opened()
        self._send(RESET if self.homing else JOG_CANCEL)
        if not self._acknowledged and (attempt or isinstance(self.wire, Descriptor)):
            self._answers_more = True
            self._send(b"\n")  # its "ok" comes after one that was lost, or another process has read
        if attempt and self.state == "Run":  # a jog may have ended: at rest a hold locks the board
            self._send(FEED_HOLD)
        if self.state == "Hold" and self._part == "0" and not self._acknowledged:
            self._send(RESET)  # a jog that waits in its buffer would move when the hold ends

    def send_position(self) -> None:
        """Ask for a status report."""
        self._question(REPORT)

    def _question(self, mark: bytes) -> None:
        self._under_way += 1
        self._send(mark)

    def position_of(self, line: str) -> tuple[Triple, bool] | None:
        """The place in a line, and whether the machine may move: also before a jog's "ok"."""
        place_mm = self._note(line)
        if place_mm is None:
            self._acknowledged |= line.startswith(("ok", "error:", "Grbl", "grblHAL"))
            return None
        holds = self.state == "Hold" and self._part != "0"
        waits = not self._acknowledged and self.state != "Alarm"
        return place_mm, holds or waits or self.state in MOVING

    def _status(self) -> Triple:
        """The position of a fresh status report; its fields are kept.

        Reports of earlier questions, asked twice or given up, are late: they come before "ok".
        """
        # in a hold a line waits for its end
        if self._under_way and self.state in ("Idle", "Jog", "Alarm"):
            self._done("")
        deadline = Deadline(self.answer_s)
        while True:
            self._question(self._ask)
            retry = Deadline(min(self.answer_s, ASK_AGAIN_S))  # a question may be lost
            try:
                while (place_mm := self._note(self._fresh_line(retry))) is None:
                    pass
            except NoLine:
                if deadline.over:
                    raise
            else:
                return place_mm

    def _note(self, line: str) -> Triple | None:
        """The position that a status report tells; None for another line."""
        report = STATUS.fullmatch(line)
        if report is None:
            return None
        self._under_way = max(0, self._under_way - 1)
        name, part, text = report.groups()
        fields = dict(field.partition(":")[::2] for field in text.split("|"))
        self.state, self._part = name, part or ""
        self._fields |= {key: value for key, value in fields.items() if key in SUPERVISED}
        place = fields.get("MPos", "").split(",")
        if len(place) < 3:
            requirement = "MPos, the machine's position: $10 with its lowest bit set"
            raise self.fault(MotionFault.NOT_READY, text[:60], requirement)
        x, y, z = (self.finite(word) * self._unit_mm for word in place[:3])
        return x, y, z

    def _done(self, command: str, wait_s: float = ACCEPT_S) -> list[str]:
        """Send a line; what came until it was acknowledged."""
        deadline = Deadline(wait_s)
        if self._answers_more or not self._acknowledged:  # of a line that a stop cut short
            self._drain()
        self._send(command.encode() + b"\n")
        self._acknowledged = False
        answers: list[str] = []
        while (line := self._fresh_line(deadline)) != "ok":
            if line.startswith("error:"):
                self._acknowledged = True
                cause = ERROR_WORDS.get(line[6:], "see its list of errors")
                raise self.fault(MotionFault.CONTROLLER, f"{line} ({cause})")
            if STATUS.fullmatch(line) is None:  # one that came by itself
                answers.append(line)
            if len(answers) > 1000:
                raise self.fault(MotionFault.LOST, "lines without an end")
        self._acknowledged, self._under_way = True, 0
        return answers

    def _drain(self) -> None:
        """Hear out what is still on its way."""
        if self.wire is None:
            return
        quiet = time.monotonic()
        deadline = Deadline(self.answer_s)
        while time.monotonic() - quiet < 2 * SLICE_S and not deadline.over:
            if self._receive():
                quiet = time.monotonic()
        self._received, self._acknowledged, self._under_way = b"", True, 0
        self._answers_more = False

    def _fresh_line(self, deadline: Deadline) -> str:
        """The next line; an alarm, or a board that started anew, is a fault."""
        line = self._line(deadline)
        if line.startswith("ALARM:"):
            raise self.fault(MotionFault.CONTROLLER, line)
        if line.startswith(("Grbl", "grblHAL")):
            self._acknowledged = True
            next_step = "Its homing is lost: home it."
            raise self.fault(MotionFault.CONTROLLER, f"it restarted ({line})", "", next_step)
        return line

    def _receive(self) -> bytes:
        try:
            if self.wire is None:
                raise self.fault(MotionFault.LOST, "the port is closed")
            waiting = getattr(self.wire, "in_waiting", 0)
            return bytes(self.wire.read(max(1, waiting)))
        except PORT_ERRORS as problem:
            raise self._connection_lost(problem) from problem

    def _send(self, request: bytes) -> None:
        try:
            if self.wire is None:
                raise self.fault(MotionFault.LOST, "the port is closed")
            self.wire.write(request)
        except PORT_ERRORS as problem:
            raise self._connection_lost(problem) from problem

    def _connection_lost(self, problem: Exception) -> ControllerFault:
        self.close()
        return self.fault(MotionFault.LOST, str(problem))
