"""grbl 1.1 and its relatives over a serial port: three carriages as X, Y, Z in joint coordinates.

A move is a jog (``$J=``): it keeps to soft limits, and 0x85 ends it without a reset and without a
lost position. Where it ends ``?`` tells; ``G4`` is acknowledged when nothing is left to do. What is
believed of the firmware stands in its own documentation (interface, jogging), not tried on one.
"""

from __future__ import annotations

import contextlib
import re
import time
from typing import ClassVar

import serial

from calib.errors import IndicatorError
from drivers.motion.controller import Controller, ControllerFault, Limits, MotionFault, Triple
from drivers.port import PORT_ERRORS, SLICE_S, check_port, close_port

BAUD = 115200
WAKE_S = 4.0
"""Many boards start anew when their port is opened."""

ACCEPT_S = 2.0
STOP_S = 2.0
JOG_CANCEL = b"\x85"
STATUS = re.compile(r"<(\w+)(?::\d+)?\|(.*)>", re.ASCII)
SETTING = re.compile(r"\$(\d+)=([-+.\d]+)", re.ASCII)
SAFE = {"9": "locked, as after an alarm", "15": "beyond its soft limits", "22": "no feed"}


class Grbl(Controller):
    """One board on one port, which nobody else opens meanwhile."""

    name: ClassVar[str] = "grbl"
    form: ClassVar[str] = "PORT"

    def __init__(self, address: str, limits: Limits) -> None:
        super().__init__(address, limits)
        self._port: serial.Serial | None = None

    def connect(self) -> None:
        """Open the port; nothing is asked of the machine."""
        try:
            check_port(self.address)
            self._port = serial.serial_for_url(
                self.address,
                baudrate=BAUD,
                timeout=SLICE_S,
                write_timeout=self.answer_s,
                do_not_open=True,
            )
            if "://" not in self.address:
                self._port.exclusive = True
            self._port.open()
        except IndicatorError as problem:
            raise self.fault(MotionFault.UNREACHABLE, problem.found, problem.allowed) from problem
        except PORT_ERRORS as problem:
            next_step = "glidecal ports lists what is there; close other programs that use it."
            raise self.fault(MotionFault.UNREACHABLE, str(problem), "", next_step) from problem
        end_s = time.monotonic() + WAKE_S
        while True:
            try:
                self._status()
            except ControllerFault:
                if time.monotonic() > end_s:
                    raise
            else:
                return

    def ready(self) -> tuple[str, ...]:
        """What is right, in the controller's own words."""
        state, shown = self._status()
        if state != "Idle":
            next_step = "At the controller: home it, or end what it does."
            raise self.fault(MotionFault.NOT_READY, f"state {state}", "state Idle", next_step)
        held = dict(SETTING.findall("\n".join(self._done("$$"))))
        for number, wanted, otherwise in (
            ("13", "0", "it reports inches: glidecal moves machines in mm only"),
            ("22", "1", "without homing nobody knows where its carriages are"),
        ):
            if (found := held.get(number, "none")) != wanted:
                shown = f"${number}={found}"
                raise self.fault(MotionFault.NOT_READY, shown, f"${number}={wanted}", otherwise)
        letters = next((one for one in self._done("$I") if one.startswith("[AXS:")), "[AXS:3:XYZ]")
        if not letters.rstrip("]").endswith("XYZ"):
            raise self.fault(MotionFault.NOT_READY, letters, "the axes X Y Z")
        return f"state {state}", "$22=1: it locks until it is homed", f"$13={held['13']}: mm"

    def position(self) -> Triple:
        """Where the machine is read back, mm."""
        _, shown = self._status()
        found = re.search(r"MPos:([-.\d]+),([-.\d]+),([-.\d]+)", shown)
        if found is None:
            allowed = "MPos, the machine's position: $10 with its lowest bit set"
            raise self.fault(MotionFault.NOT_READY, shown[:60], allowed)
        x, y, z = (float(number) for number in found.groups())
        return x, y, z

    def moves(self) -> bool:
        """One look at the state of the board."""
        state, _ = self._status()
        if state == "Idle":
            return False
        if state != "Jog":
            raise self.fault(MotionFault.CONTROLLER, f"state {state}", "Idle, or Jog on the way")
        return True

    def _begin(self, to_mm: Triple, feed_mm_min: float) -> None:
        words = "".join(f"{name}{mm:.4f}" for name, mm in zip("XYZ", to_mm, strict=True))
        # machine coordinates in mm, whatever units and offsets the board is set to
        self._done(f"$J=G21G90G53{words}F{feed_mm_min:.1f}")

    def _barrier(self) -> None:
        self._done("G4P0.01")

    def stop(self) -> None:
        """End the jog; no reset, no position lost."""
        if self._port is None:  # its cable is out; it may be back
            self.connect()
        self._send(JOG_CANCEL)
        end_s = time.monotonic() + STOP_S
        while time.monotonic() < end_s and self._port is not None:
            with contextlib.suppress(ControllerFault):  # an alarm is told on the way, too
                if self._status()[0] != "Jog":
                    return
        raise self.fault(MotionFault.LOST, "no answer that it stopped")

    def close(self) -> None:
        """Let go of the port."""
        port, self._port = self._port, None
        if port is not None:
            close_port(port)

    def _status(self) -> tuple[str, str]:
        """State and fields of a fresh status report."""
        self._send(b"?")
        while True:
            found = STATUS.fullmatch(self._told(self.answer_s))
            if found:
                return found[1], found[2]

    def _done(self, words: str) -> list[str]:
        """Send a line; what was told until it was acknowledged."""
        self._send(words.encode() + b"\n")
        told: list[str] = []
        while (line := self._told(ACCEPT_S)) != "ok":
            if line.startswith("error:"):
                why = SAFE.get(line[6:], "see its list of errors")
                raise self.fault(MotionFault.CONTROLLER, f"{line} ({why})")
            told.append(line)
        return told

    def _told(self, patience_s: float) -> str:
        """The next line; an alarm, or a board that started anew, is a fault."""
        told = self._line(patience_s)
        if told.startswith("ALARM:"):
            raise self.fault(MotionFault.CONTROLLER, told)
        if told.startswith("Grbl"):
            raise self.fault(MotionFault.CONTROLLER, f"it started anew ({told})")
        return told

    def _receive(self) -> bytes:
        try:
            if self._port is None:
                raise self.fault(MotionFault.LOST)
            return bytes(self._port.read(max(1, self._port.in_waiting)))
        except PORT_ERRORS as problem:
            raise self._gone(problem) from problem

    def _send(self, words: bytes) -> None:
        try:
            if self._port is None:
                raise self.fault(MotionFault.LOST)
            self._port.write(words)
        except PORT_ERRORS as problem:
            raise self._gone(problem) from problem

    def _gone(self, problem: Exception) -> ControllerFault:
        self.close()
        return self.fault(MotionFault.LOST, str(problem))
