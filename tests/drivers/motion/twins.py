"""Simulated controllers that fail on demand: the program's LinuxCNC, and a board with grbl."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from enum import StrEnum
from typing import Protocol

from drivers.motion.controller import MM_PER_INCH, Triple
from drivers.motion.twins import Client, LinuxCncTwin, SimulatedAxes
from drivers.twins import Disconnected, Transport, TwinPort

SHORT_MM = 0.5
"""How far from where it was sent a simulated machine with that trouble stops."""


class MotionTrouble(StrEnum):
    """What may befall a machine that moves by itself."""

    NOT_HOMED = "not homed"
    OFF = "off"
    INCH = "inch"
    ESTOP = "emergency stop"
    FOLLOWING = "following error"
    NAK = "another client has control"
    SILENCE = "no answer"
    HANG_UP = "hung up"
    ELSEWHERE = "stops short"
    DIED = "killed, and started again when it is mended"
    MODE = "another mode, chosen at the panel"
    UNHOMED = "a joint unhomed"
    OVERRIDE = "feed override turned"
    OFFSET = "G92 of another client"
    FEED_HOLD = "feed hold, which it does not report"


class FailingAxes(SimulatedAxes):
    """Axes that may be held on their way, or stop ``short_mm`` beside where they are sent."""

    short_mm = 0.0
    frozen = False

    def go(self, to_mm: Triple, feed_mm_min: float) -> None:
        super().go((to_mm[0] + self.short_mm, to_mm[1], to_mm[2]), feed_mm_min)

    def stop(self) -> None:
        super().stop()
        self.frozen = False

    def freeze(self) -> None:
        """Stand still on its way, which it has not given up."""
        super().stop()
        self.frozen = True

    @property
    def moving(self) -> bool:
        return self.frozen or super().moving


class MotionTwin(Protocol):
    """A simulated controller that listens."""

    axes: FailingAxes
    endpoint: str
    """What names it to `drivers.motion.controller_of`."""
    moves: list[str]
    """Every line that moved it, or was to."""
    late_s: float
    """How long it takes to answer."""

    def befall(self, trouble: MotionTrouble) -> None:
        """Let this trouble begin."""

    def mend(self) -> None:
        """Everything is right again, as somebody at the machine makes it."""

    def close(self) -> None:
        """Stop listening."""


TROUBLE_STATES = {
    MotionTrouble.NOT_HOMED: {"joint_homed": "YES NO YES NO NO NO"},
    MotionTrouble.INCH: {"user_linear_units": "INCH"},
    MotionTrouble.OFF: {"machine": "OFF"},
    MotionTrouble.FOLLOWING: {"machine": "OFF"},
    MotionTrouble.ESTOP: {"machine": "OFF", "estop": "ON"},
    MotionTrouble.MODE: {"mode": "MANUAL"},
    MotionTrouble.UNHOMED: {"joint_homed": "YES NO YES NO NO NO"},
    MotionTrouble.OVERRIDE: {"feed_override": "50"},
}


class FailingLinuxCnc(LinuxCncTwin):
    """An answer comes after ``late_s``; ``aborts`` counts what told it to stop."""

    axes: FailingAxes
    late_s = 0.0
    aborts = 0
    _silent = _dead = False

    def answer(self, client: Client, fields: list[str]) -> str:
        answer = super().answer(client, fields)
        time.sleep(self.late_s)
        return "" if self._silent else answer

    def _abort(self) -> None:
        self.aborts += 1
        super()._abort()

    def befall(self, trouble: MotionTrouble) -> None:
        """Let this trouble begin."""
        with self.lock:
            self.state |= TROUBLE_STATES.get(trouble, {})
            if trouble is MotionTrouble.NAK:
                self.control = None
            elif trouble is MotionTrouble.SILENCE:
                self._silent = True
            elif trouble is MotionTrouble.ELSEWHERE:
                self.axes.short_mm = SHORT_MM
            elif trouble is MotionTrouble.OFFSET:
                self.offset_mm = -5.0
            elif trouble is MotionTrouble.FEED_HOLD:
                self.axes.freeze()
            elif trouble in (MotionTrouble.OFF, MotionTrouble.FOLLOWING, MotionTrouble.ESTOP):
                self.axes.stop()
                if trouble is MotionTrouble.FOLLOWING:
                    self.errors.append("joint 0 following error")
        if trouble is MotionTrouble.HANG_UP:
            self.hang_up()
        if trouble is MotionTrouble.DIED:
            self.axes.stop()  # nothing drives it any more
            self.close()

    def mend(self) -> None:
        """Switched on and homed again; one that was killed runs again at the same port."""
        with self.lock:
            mode = {"mode": self.state["mode"], "program_codes": self.state["program_codes"]}
            self.state, self._silent, self.axes.short_mm = self.healthy | mode, False, 0.0
            self.offset_mm, self.axes.frozen = 0.0, False
        if self._dead:
            self._dead, self.control = False, None
            self.listen(int(self.address.rpartition(":")[2]))

    def close(self) -> None:
        if not self._dead:
            self._dead = True
            super().close()


BOARD_STATES = {
    MotionTrouble.NOT_HOMED: "Alarm",
    MotionTrouble.UNHOMED: "Alarm",
    MotionTrouble.OFF: "Alarm",
    MotionTrouble.FOLLOWING: "Alarm",
    MotionTrouble.ESTOP: "Alarm",
    MotionTrouble.FEED_HOLD: "Hold:0",
    MotionTrouble.MODE: "Hold:0",
    MotionTrouble.NAK: "Run",
}
REALTIME = re.compile(rb"[?!~\x18\x85]")
JOG = re.compile(r"\$J=G21G90G53X([-.\d]+)Y([-.\d]+)Z([-.\d]+)F([.\d]+)", re.ASCII)


class GrblTwin:
    """A board with grbl 1.1 whose three carriages are homed, on a port of its own."""

    def __init__(self, axes: FailingAxes, transport: Transport) -> None:
        self.axes, self.moves = axes, list[str]()
        self.received = b""
        self.state = ""
        self._pending: list[str] = []
        self.settings = {"10": "1", "13": "0", "20": "1", "22": "1"}
        self.settings |= {"130": "1000.000", "131": "1000.000", "132": "1000.000"}
        self._silent = self._gone = False
        self.override, self.offset_mm, self.late_s = 100, 0.0, 0.0
        self.aborts = self._reports = 0
        self._port = TwinPort(self, transport)
        self.address = self._port.url
        self.endpoint = f"grbl:{self.address}"

    def befall(self, trouble: MotionTrouble) -> None:
        """Let this trouble begin."""
        self.state = BOARD_STATES.get(trouble, self.state)
        if self.state == "Hold:0":
            self.axes.freeze()
        elif trouble is MotionTrouble.OVERRIDE:
            self.override = 50
        elif trouble is MotionTrouble.OFFSET:
            self.offset_mm = -5.0
        elif trouble is MotionTrouble.INCH:
            self.settings["13"] = "1"
        elif trouble in (MotionTrouble.FOLLOWING, MotionTrouble.ESTOP):
            self.axes.stop()
            self._pending = ["ALARM:3"]
        elif trouble is MotionTrouble.SILENCE:
            self._silent = True
        elif trouble is MotionTrouble.ELSEWHERE:
            self.axes.short_mm = SHORT_MM
        elif trouble is MotionTrouble.HANG_UP:
            self._gone = True

    def mend(self) -> None:
        """Unlocked and homed again; a cable that is out stays out."""
        self.state, self._silent, self.axes.short_mm = "", False, 0.0
        self._pending, self.settings["13"] = [], "0"
        self.override, self.offset_mm, self.axes.frozen = 100, 0.0, False

    def receive(self, request: bytes) -> bytes:
        """Realtime characters take effect at once, lines when they are whole."""
        if self._gone:
            raise Disconnected
        reply = "".join(f"{line}\r\n" for line in self._pending)
        self._pending = []
        for mark in REALTIME.findall(request):
            if mark == b"?":
                reply += self._report()
            elif mark == b"\x85":
                self.aborts += 1
                self.axes.stop()
            elif mark == b"!" and self.state == "Run":
                self.axes.freeze()
                self.state = "Hold:0"
        *lines, self.received = (self.received + REALTIME.sub(b"", request)).split(b"\n")
        for line in lines:
            reply += self.answer(line.decode("latin-1").strip())
        time.sleep(self.late_s)
        return b"" if self._silent else reply.encode("latin-1")

    def _report(self) -> str:
        state = self.state or ("Jog" if self.axes.moving else "Idle")
        self._reports += 1
        part = {1: f"|WCO:{self.offset_mm:.3f},0.000,0.000", 2: f"|Ov:{self.override},100,100"}
        unit = MM_PER_INCH if self.settings["13"] == "1" else 1.0
        place = ",".join(f"{mm / unit:.3f}" for mm in self.axes.at_mm)
        return f"<{state}|MPos:{place}|FS:0,0{part.get(self._reports % 10, '')}>\r\n"

    def answer(self, line: str) -> str:
        """What the board says to one line."""
        if line == "$$":
            return "".join(f"${n}={v}\r\n" for n, v in self.settings.items()) + "ok\r\n"
        if line == "$I":
            return "[VER:1.1h.20190825:]\r\n[OPT:V,15,128]\r\nok\r\n"
        if line in ("", "$H"):  # an empty line is there to synchronize
            self.state = "" if line else self.state
            return "ok\r\n"
        if line == "G4P0.01":
            return "error:9\r\n" if self.state or self.axes.moving else "ok\r\n"
        self.moves.append(line)
        jog = JOG.fullmatch(line)
        x, y, z, feed = map(float, jog.groups()) if jog else (0.0,) * 4
        if jog and feed and not self.state:
            self.axes.go((x, y, z), feed)
            return "ok\r\n"
        return "error:20\r\n" if not jog else "error:9\r\n" if self.state else "error:22\r\n"

    def close(self) -> None:
        """Stop listening."""
        self._port.close()


TWINS: dict[str, Callable[[FailingAxes], MotionTwin]] = {
    "linuxcnc": FailingLinuxCnc,
    "grbl": lambda axes: GrblTwin(axes, "tcp"),
}
