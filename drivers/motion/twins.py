"""Simulated controllers that answer byte for byte as the real ones, and fail on demand."""

from __future__ import annotations

import contextlib
import math
import re
import socket
import socketserver
import threading
import time
from collections import deque
from collections.abc import Callable
from enum import StrEnum
from typing import Protocol

from drivers.motion.controller import Triple
from drivers.twins import Disconnected, Transport, TwinPort

SHORT_MM = 0.5
"""How far from where it was sent a simulated machine with that trouble stops."""

PASSED = 1000
"""Places that are kept for who asks which way a machine came."""


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
    CUT = "words lost to a client that asks at the same time"


class SimulatedAxes:
    """Three coordinates that go straight to where they are sent, safe from any thread.

    In compressed time they are ``hurry`` times as fast as they are told.
    """

    def __init__(self, at_mm: Triple = (0.0, 0.0, 0.0), hurry: float = 1.0) -> None:
        self._hurry = hurry
        self._lock = threading.Lock()
        self._from = self._to = at_mm
        self._departed_s, self._way_s = time.monotonic(), 0.0
        self._turned: deque[Triple] = deque(maxlen=PASSED)
        self.short_mm = 0.0

    def go(self, to_mm: Triple, feed_mm_min: float) -> None:
        """Depart from where it is."""
        with self._lock:
            self._from = self._now()
            self._turned.append(self._from)
            self._to = (to_mm[0] + self.short_mm, to_mm[1], to_mm[2])
            self._departed_s = time.monotonic()
            self._way_s = math.dist(self._from, self._to) / feed_mm_min * 60.0 / self._hurry

    def stop(self) -> None:
        """Stand still where it is."""
        with self._lock:
            self._from = self._to = self._now()
            self._way_s = 0.0

    @property
    def at_mm(self) -> Triple:
        """Where it is now."""
        with self._lock:
            return self._now()

    def passed_mm(self) -> list[Triple]:
        """Where it turned since this was asked last, and where it is now."""
        with self._lock:
            turned = [*self._turned, self._now()]
            self._turned.clear()
        return turned

    @property
    def moving(self) -> bool:
        """Whether it is on its way."""
        with self._lock:
            return time.monotonic() - self._departed_s < self._way_s

    def _now(self) -> Triple:
        gone_s = time.monotonic() - self._departed_s
        share = 1.0 if gone_s >= self._way_s else gone_s / self._way_s
        x, y, z = (a + share * (b - a) for a, b in zip(self._from, self._to, strict=True))
        return x, y, z


class MotionTwin(Protocol):
    """A simulated controller that listens."""

    axes: SimulatedAxes
    told: str
    """What names it to `drivers.motion.controller_of`."""
    moves: list[str]
    """Every line that moved it, or was to."""

    def befall(self, trouble: MotionTrouble) -> None:
        """From now on this is so."""

    def mend(self) -> None:
        """Everything is right again, as somebody at the machine makes it."""

    def close(self) -> None:
        """Stop listening."""


RIGHT = {
    "estop": "OFF",
    "machine": "ON",
    "mode": "MANUAL",
    "set_wait": "RECEIVED",
    "joint_homed": "YES YES YES NO NO NO",
    "joint_fault": "OK OK OK OK OK OK",
    "joint_limit": "OK OK OK OK OK OK",
    "joint_type": "LINEAR LINEAR LINEAR LINEAR LINEAR LINEAR",
    "user_linear_units": "MM",
}
"""What a LinuxCNC says that is switched on and homed."""

WRONG = {
    MotionTrouble.NOT_HOMED: {"joint_homed": "YES NO YES NO NO NO"},
    MotionTrouble.INCH: {"user_linear_units": "INCH"},
    MotionTrouble.OFF: {"machine": "OFF"},
    MotionTrouble.FOLLOWING: {"machine": "OFF"},
    MotionTrouble.ESTOP: {"machine": "OFF", "estop": "ON"},
}


class LinuxCncTwin:
    """A LinuxCNC of three homed joints that is switched on, behind its text server on loopback.

    Answers as those of LinuxCNC 2.9: gets end in \\r\\n, sets in \\n\\r; six joints are listed; who
    enables last has control; a client that leaves ends no move; waiting is one setting for all.
    """

    def __init__(self, axes: SimulatedAxes) -> None:
        self.axes, self.moves, self.errors = axes, list[str](), deque[str]()
        self._connect, self._enable = "EMC", "EMCTOO"
        self._lock = threading.Lock()
        self._control: _Client | None = None
        self._state = dict(RIGHT)
        self._silent = self._cut = self._failed = False
        self._clients: list[socket.socket] = []
        self._dead = False
        self._listen(0)
        self.address = f"127.0.0.1:{self._server.server_address[1]}"
        self.told = f"linuxcnc:{self.address}"

    def _listen(self, port: int) -> None:
        twin = self

        class Handler(socketserver.BaseRequestHandler):
            def handle(self) -> None:
                twin.serve(self.request)

        self._server = _Server(("127.0.0.1", port), Handler)
        self._thread = threading.Thread(
            target=self._server.serve_forever, args=(0.05,), name=f"twin at {port}", daemon=True
        )
        self._thread.start()

    def befall(self, trouble: MotionTrouble) -> None:
        """From now on this is so."""
        with self._lock:
            self._state |= WRONG.get(trouble, {})
            if trouble is MotionTrouble.NAK:
                self._control = None
            elif trouble is MotionTrouble.SILENCE:
                self._silent = True
            elif trouble is MotionTrouble.ELSEWHERE:
                self.axes.short_mm = SHORT_MM
            elif trouble is MotionTrouble.CUT:
                self._cut = True
            elif trouble in (MotionTrouble.OFF, MotionTrouble.FOLLOWING, MotionTrouble.ESTOP):
                self.axes.stop()
                if trouble is MotionTrouble.FOLLOWING:
                    self._failed = True
                    self.errors.append("joint 0 following error")
        if trouble is MotionTrouble.HANG_UP:
            self.hang_up()
        if trouble is MotionTrouble.DIED:
            self.axes.stop()  # nothing drives it any more
            self._end()

    def mend(self) -> None:
        """Switched on and homed again; one that was killed runs again at the same port."""
        with self._lock:
            self._state, self._silent, self.axes.short_mm = dict(RIGHT), False, 0.0
            self._failed = False
        if self._dead:
            self._dead, self._control = False, None
            self._listen(self._server.server_address[1])

    def hang_up(self) -> None:
        """Close every connection; the move that is under way goes on."""
        for client in self._clients:
            with contextlib.suppress(OSError):
                client.shutdown(socket.SHUT_RDWR)

    def serve(self, connection: socket.socket) -> None:
        """One client until it leaves, in a thread of its own."""
        client = _Client()
        self._clients.append(connection)
        received = b""
        with contextlib.suppress(OSError):
            while came := connection.recv(4096):
                if client.echo and client.linked:
                    connection.sendall(came)
                received = (received + came).replace(b"\r", b"\n")
                *lines, received = received.split(b"\n")
                for line in lines:
                    answer = self._answer(client, line.decode("latin-1").split())
                    if answer and not self._silent:
                        connection.sendall(answer.encode("latin-1"))

    def _answer(self, client: _Client, words: list[str]) -> str:
        match [word.upper() for word in words[:2]]:
            case ["HELLO", _]:
                client.linked = client.linked or words[1] == self._connect
                return "HELLO ACK EMCNETSVR 1.1\r\n" if client.linked else "HELLO NAK\r\n"
            case ["GET", name] if client.linked:
                return self._got(client, name.lower())
            case ["SET", name] if client.linked:
                done = self._set(client, name.lower(), words[2:])
                if done and not client.verbose:
                    return ""
                return f"SET {name} {'ACK' if done else 'NAK'}\n\r"
        return "SET NAK\r\n" if words and words[0].upper() == "SET" else ""

    def _got(self, client: _Client, name: str) -> str:
        moving = self.axes.moving
        with self._lock:
            if name == "error":
                value = self.errors.popleft() if self.errors else "OK"
            elif name == "enable":
                value = "ON" if self._control is client else "OFF"
            elif name == "program_status":
                value = "RUNNING" if moving else "IDLE"
            elif name == "abs_act_pos":
                value = " ".join(f"{mm:.6f}" for mm in (*self.axes.at_mm, 0.0, 0.0, 0.0))
            elif name in self._state:
                value = self._state[name]
            else:
                return f"GET {name.upper()} NAK\r\n\r\n"
        return f"{name.upper()} {value}\r\n"

    def _set(self, client: _Client, name: str, words: list[str]) -> bool:
        if name in ("echo", "verbose"):
            setattr(client, name, words[:1] == ["on"])
            return True
        with self._lock:
            if name == "enable" and words[:1] == [self._enable]:
                self._control = client
            if self._control is not client or name == "enable":
                return self._control is client and words[:1] == [self._enable]
            if name in ("mode", "set_wait"):
                self._state[name] = words[0].upper()
            elif name == "abort":
                self.axes.stop()
            elif name == "mdi":
                self._mdi(" ".join(words))
        if name == "wait":
            return self._waited(words)
        return name in ("mode", "set_wait", "abort", "mdi")

    def _waited(self, words: list[str]) -> bool:
        """NAK without a word to wait for, and where the last command ended in an error."""
        if self._cut:
            self._cut, words = False, []
        while words and self.axes.moving:
            time.sleep(0.01)
        return words[:1] == ["done"] and not self._failed

    def _mdi(self, line: str) -> None:
        """Acknowledged whatever comes of it."""
        self.moves.append(line)
        found = {word[0]: float(word[1:]) for word in re.findall(r"[FXYZ][-+.\d]+", line)}
        if self._state["machine"] != "ON" or "NO" in self._state["joint_homed"].split()[:3]:
            self.errors.append("Can't issue MDI command when not homed")
        elif found.get("F", 0.0) <= 0.0:
            self.errors.append("Cannot do g1 with zero feed rate")
        else:
            self.axes.go((found["X"], found["Y"], found["Z"]), found["F"])

    def close(self) -> None:
        """Stop listening."""
        if not self._dead:
            self._end()

    def _end(self) -> None:
        self._dead = True
        self._server.shutdown()
        self.hang_up()
        self._server.server_close()
        self._thread.join()


class _Server(socketserver.ThreadingTCPServer):
    allow_reuse_address = True


class _Client:
    """What the text server knows of one connection."""

    linked = False
    echo = True
    verbose = False


REALTIME = re.compile(rb"[?!~\x18\x85]")
JOG = re.compile(r"\$J=G21G90G53X([-.\d]+)Y([-.\d]+)Z([-.\d]+)F([.\d]+)", re.ASCII)


class GrblTwin:
    """A board with grbl 1.1 whose three carriages are homed, on a port of its own."""

    def __init__(self, axes: SimulatedAxes, transport: Transport) -> None:
        self.axes, self.moves = axes, list[str]()
        self._received = b""
        self._state = ""
        self._pending: list[str] = []
        self._settings = {"10": "1", "13": "0", "20": "1", "22": "1"}
        self._silent = self._gone = False
        self._port = TwinPort(self, transport)
        self.address = self._port.url
        self.told = f"grbl:{self.address}"

    def befall(self, trouble: MotionTrouble) -> None:
        """From now on this is so."""
        if trouble in (MotionTrouble.NOT_HOMED, MotionTrouble.OFF):
            self._state = "Alarm"
        elif trouble is MotionTrouble.INCH:
            self._settings["13"] = "1"
        elif trouble in (MotionTrouble.FOLLOWING, MotionTrouble.ESTOP):
            self.axes.stop()
            self._state, self._pending = "Alarm", ["ALARM:3"]
        elif trouble is MotionTrouble.NAK:
            self._state = "Run"
        elif trouble is MotionTrouble.SILENCE:
            self._silent = True
        elif trouble is MotionTrouble.ELSEWHERE:
            self.axes.short_mm = SHORT_MM
        elif trouble is MotionTrouble.HANG_UP:
            self._gone = True

    def mend(self) -> None:
        """Unlocked and homed again; a cable that is out stays out."""
        self._state, self._silent, self.axes.short_mm = "", False, 0.0
        self._pending, self._settings["13"] = [], "0"

    def receive(self, request: bytes) -> bytes:
        """Realtime characters take effect at once, lines when they are whole."""
        if self._gone:
            raise Disconnected
        told = "".join(f"{line}\r\n" for line in self._pending)
        self._pending = []
        for mark in REALTIME.findall(request):
            if mark == b"?":
                told += self._report()
            elif mark in (b"!", b"\x85"):
                self.axes.stop()
        *lines, self._received = (self._received + REALTIME.sub(b"", request)).split(b"\n")
        for line in lines:
            told += self._answer(line.decode("latin-1").strip())
        return b"" if self._silent else told.encode("latin-1")

    def _report(self) -> str:
        state = self._state or ("Jog" if self.axes.moving else "Idle")
        place = ",".join(f"{mm:.3f}" for mm in self.axes.at_mm)
        return f"<{state}|MPos:{place}|FS:0,0>\r\n"

    def _answer(self, line: str) -> str:
        if line == "$$":
            return "".join(f"${n}={v}\r\n" for n, v in self._settings.items()) + "ok\r\n"
        if line == "$I":
            return "[VER:1.1h.20190825:]\r\n[OPT:V,15,128]\r\nok\r\n"
        if line == "G4P0.01":
            return "error:9\r\n" if self._state or self.axes.moving else "ok\r\n"
        self.moves.append(line)
        found = JOG.fullmatch(line)
        x, y, z, feed = map(float, found.groups()) if found else (0.0,) * 4
        if found and feed and not self._state:
            self.axes.go((x, y, z), feed)
            return "ok\r\n"
        return "error:20\r\n" if not found else "error:9\r\n" if self._state else "error:22\r\n"

    def close(self) -> None:
        """Stop listening."""
        self._port.close()


TWINS: dict[str, Callable[[SimulatedAxes], MotionTwin]] = {
    "linuxcnc": LinuxCncTwin,
    "grbl": lambda axes: GrblTwin(axes, "tcp"),
}
