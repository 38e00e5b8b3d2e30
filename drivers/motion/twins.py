"""A simulated LinuxCNC that answers byte for byte as the real one."""

from __future__ import annotations

import contextlib
import math
import re
import socket
import socketserver
import threading
import time
from collections import deque
from typing import Literal

from drivers.motion.controller import MM_PER_INCH, Triple

PASSED = 1000
"""Places that are kept for who asks which way a machine came."""


class SimulatedAxes:
    """Three coordinates that go straight to where they are sent, safe from any thread.

    In compressed time they are ``hurry`` times as fast as they are told.
    """

    def __init__(self, at_mm: Triple = (0.0, 0.0, 0.0), hurry: float = 1.0) -> None:
        self._hurry = hurry
        self.lock = threading.Lock()
        self.from_mm = self.to_mm = at_mm
        self._departed_s, self.way_s = time.monotonic(), 0.0
        self._turned: deque[Triple] = deque(maxlen=PASSED)

    def go(self, to_mm: Triple, feed_mm_min: float) -> None:
        """Depart from where it is."""
        with self.lock:
            self.from_mm = self._now()
            self._turned.append(self.from_mm)
            self.to_mm = to_mm
            self._departed_s = time.monotonic()
            self.way_s = math.dist(self.from_mm, self.to_mm) / feed_mm_min * 60.0 / self._hurry

    def stop(self) -> None:
        """Stand still where it is."""
        with self.lock:
            self.from_mm = self.to_mm = self._now()
            self.way_s = 0.0

    @property
    def at_mm(self) -> Triple:
        """Where it is now."""
        with self.lock:
            return self._now()

    def passed_mm(self) -> list[Triple]:
        """Where it turned since this was asked last, and where it is now."""
        with self.lock:
            turned = [*self._turned, self._now()]
            self._turned.clear()
        return turned

    @property
    def moving(self) -> bool:
        """Whether it is on its way."""
        with self.lock:
            return time.monotonic() - self._departed_s < self.way_s

    def _now(self) -> Triple:
        elapsed_s = time.monotonic() - self._departed_s
        share = 1.0 if elapsed_s >= self.way_s else elapsed_s / self.way_s
        x, y, z = (a + share * (b - a) for a, b in zip(self.from_mm, self.to_mm, strict=True))
        return x, y, z


HEALTHY = {
    "estop": "OFF",
    "machine": "ON",
    "mode": "MANUAL",
    "set_wait": "RECEIVED",
    "feed_override": "100",
    "program_codes": "G1 G53 G17 G40 G20 G90 G94 G64 G8",
    "joint_homed": "YES YES YES NO NO NO",
    "joint_fault": "OK OK OK OK OK OK",
    "joint_limit": "OK OK OK OK OK OK",
    "joint_type": "LINEAR LINEAR LINEAR LINEAR LINEAR LINEAR",
    "user_linear_units": "MM",
}
"""What a LinuxCNC says that is switched on and homed."""

INI = {"[KINS]JOINTS": 3.0} | {
    f"[JOINT_{joint}]{end}_LIMIT": limit
    for joint in range(3)
    for end, limit in (("MIN", -1000.0), ("MAX", 1000.0))
}
"""Numbers in the INI of that LinuxCNC, in mm."""


class LinuxCncTwin:
    """A LinuxCNC of three homed joints that is switched on, behind its text server on loopback.

    Answers as those of LinuxCNC 2.9: gets end in \\r\\n, sets in \\n\\r; six joints are listed; who
    enables last has control; a client that leaves ends no move; waiting is one setting for all; F
    is taken before G21 of the same line. It takes ``coordinates`` of the tool, or of its joints.
    """

    def __init__(
        self, axes: SimulatedAxes, coordinates: Literal["tool", "joint"] = "joint"
    ) -> None:
        self.axes, self.moves, self.errors = axes, list[str](), deque[str]()
        self.ini, self.display = dict(INI), deque[str]()
        self._connect, self._enable = "EMC", "EMCTOO"
        self.offset_mm = 0.0
        self.lock = threading.Lock()
        self.control: Client | None = None
        self.healthy = {**HEALTHY, "kinematics_type": "1" if coordinates == "joint" else "4"}
        self.state = dict(self.healthy)
        self._clients: list[socket.socket] = []
        self.listen(0)
        self.address = f"127.0.0.1:{self._server.server_address[1]}"
        self.endpoint = f"linuxcnc:{self.address}"

    def listen(self, port: int) -> None:
        """Answer clients at a port of loopback, 0: a free one."""
        twin = self

        class Handler(socketserver.BaseRequestHandler):
            def handle(self) -> None:
                twin.serve(self.request)

        self._server = _Server(("127.0.0.1", port), Handler)
        self._thread = threading.Thread(
            target=self._server.serve_forever, args=(0.05,), name=f"twin at {port}", daemon=True
        )
        self._thread.start()

    def hang_up(self) -> None:
        """Close every connection; the move that is under way goes on."""
        for client in self._clients:
            with contextlib.suppress(OSError):
                client.shutdown(socket.SHUT_RDWR)

    def serve(self, connection: socket.socket) -> None:
        """One client until it leaves, in a thread of its own."""
        client = Client()
        self._clients.append(connection)
        received = b""
        with contextlib.suppress(OSError):
            while chunk := connection.recv(4096):
                if client.echo and client.linked:
                    connection.sendall(chunk)
                received = (received + chunk).replace(b"\r", b"\n")
                *lines, received = received.split(b"\n")
                for line in lines:
                    answer = self.answer(client, line.decode("latin-1").split())
                    if answer:
                        connection.sendall(answer.encode("latin-1"))

    def answer(self, client: Client, fields: list[str]) -> str:
        """What one client hears for one line."""
        match [word.upper() for word in fields[:2]]:
            case ["HELLO", _]:
                client.linked = client.linked or fields[1] == self._connect
                return "HELLO ACK EMCNETSVR 1.1\r\n" if client.linked else "HELLO NAK\r\n"
            case ["GET", name] if client.linked:
                return self._get(client, name.lower())
            case ["SET", name] if client.linked:
                is_set = self._set(client, name.lower(), fields[2:])
                if is_set and not client.verbose:
                    return ""
                return f"SET {name} {'ACK' if is_set else 'NAK'}\n\r"
        return "SET NAK\r\n" if fields and fields[0].upper() == "SET" else ""

    def _get(self, client: Client, name: str) -> str:
        moving = self.axes.moving
        with self.lock:
            if name == "error":
                value = self.errors.popleft() if self.errors else "OK"
            elif name == "operator_display":
                value = self.display.popleft() if self.display else "OK"
            elif name == "enable":
                value = "ON" if self.control is client else "OFF"
            elif name == "program_status":
                value = "RUNNING" if moving else "IDLE"
            elif name in ("abs_act_pos", "abs_cmd_pos", "rel_act_pos", "rel_cmd_pos"):
                x, y, z = self.axes.at_mm
                x += self.offset_mm if name.startswith("rel") else 0.0
                unit = MM_PER_INCH if self.state["user_linear_units"] == "INCH" else 1.0
                value = " ".join(f"{mm / unit:.6f}" for mm in (x, y, z, 0.0, 0.0, 0.0))
            elif name in self.state:
                value = self.state[name]
            else:
                return f"GET {name.upper()} NAK\r\n\r\n"
        return f"{name.upper()} {value}\r\n"

    def _set(self, client: Client, name: str, fields: list[str]) -> bool:
        if name in ("echo", "verbose"):
            setattr(client, name, fields[:1] == ["on"])
            return True
        with self.lock:
            if name == "enable" and fields[:1] == [self._enable]:
                self.control = client
            if name == "enable" and fields[:1] == ["off"] and self.control is client:
                self.control = None
                return True
            if self.control is not client or name == "enable":
                return self.control is client and fields[:1] == [self._enable]
            if name in ("mode", "set_wait"):
                self.state[name] = fields[0].upper()
            elif name == "abort":
                if self.state["machine"] != "ON":
                    return False
                self._abort()
            elif name == "mdi":
                self._mdi(" ".join(fields))
        return name in ("mode", "set_wait", "abort", "mdi")

    def _abort(self) -> None:
        """Stop; the modes of the interpreter are the usual ones again."""
        self.axes.stop()
        self.modal({"G64"})

    def modal(self, command_codes: set[str]) -> None:
        """Words of G-code take the place of those that exclude them."""
        codes = self.state["program_codes"].split()
        for group in ({"G20", "G21"}, {"G90", "G91"}, {"G93", "G94"}, {"G61", "G64"}, {"G7", "G8"}):
            if new := group & command_codes:
                codes = [code for code in codes if code not in group] + sorted(new)
        self.state["program_codes"] = " ".join(codes)

    def _mdi(self, line: str) -> None:
        """Acknowledged whatever comes of it."""
        if line.startswith("(DEBUG,"):
            self.display.append(re.sub(r"#<_ini(\S+)>", self._number, line[7:-1]))
            return
        axis_words = {word[0]: float(word[1:]) for word in re.findall(r"[FXYZ][-+.\d]+", line)}
        unit = MM_PER_INCH if "G20" in self.state["program_codes"].split() else 1.0
        self.modal(set(line.split()))
        if not axis_words:
            return
        self.moves.append(line)
        if self.state["machine"] != "ON" or "NO" in self.state["joint_homed"].split()[:3]:
            self.errors.append("Can't issue MDI command when not homed")
        elif axis_words.get("F", 0.0) <= 0.0:
            self.errors.append("Cannot do g1 with zero feed rate")
        else:
            self.axes.go(
                (axis_words["X"], axis_words["Y"], axis_words["Z"]), axis_words["F"] * unit
            )

    def _number(self, name: re.Match[str]) -> str:
        """A number of the INI as a message of G-code shows it, or that there is none."""
        inch = self.state["user_linear_units"] == "INCH" and name[1].endswith("_LIMIT")
        value = self.ini.get(name[1])
        return "######" if value is None else f"{value / (MM_PER_INCH if inch else 1.0):.6f}"

    def close(self) -> None:
        """Stop listening."""
        self._server.shutdown()
        self.hang_up()
        self._server.server_close()
        self._thread.join()


class _Server(socketserver.ThreadingTCPServer):
    allow_reuse_address = True


class Client:
    """What the text server knows of one connection."""

    linked = False
    echo = True
    verbose = False
