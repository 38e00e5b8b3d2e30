"""LinuxCNC through its text server ``linuxcncrsh``; asked for nothing but to move, read and abort.

What it does that is unexpected, each tried with LinuxCNC 2.9: a dropped connection lets a move go
on; whoever enables last has control and the others are told NAK without a reason; a refused line
is acknowledged and only ``get error`` tells, one message a call; ``joint_homed`` lists six joints
whatever there are; a program that waits for ``done`` hears no abort, and may be told it is done
while it moves; how commands wait is one setting for all clients, and an answer to one takes 0.1 s;
clients that ask at the same time disturb each other (it parses with ``strtok`` in threads): answers
are cut or lost, and a line may be, so that only the position that is read back tells where it went.
"""

from __future__ import annotations

import contextlib
import math
import os
import socket
import time
from collections.abc import Mapping, Sequence
from typing import ClassVar

from drivers.motion.controller import (
    CONNECT_S,
    MM_PER_INCH,
    SLICE_S,
    STILL_MM,
    Controller,
    ControllerFault,
    Deadline,
    Limits,
    MotionFault,
    Snapshot,
    Triple,
)

PORT = 5007
SERVER_QUESTION = "Is linuxcncrsh running there, and does this port belong to it?"
ACCEPT_S = 3.0
"""For what the controller has to accept; it looks ten times a second."""

REJOIN_S = 0.2
"""For a new connection to a controller that must be stopped now."""

MOST_ERRORS = 20
JOINTS = 3
AXES = 6
"""Of a position, whatever there are."""

IDENTITY = "1"
"""The kinematics in which X, Y and Z are the joints themselves."""

PASSWORDS = "GLIDECAL_LINUXCNC_PASSWORDS"
"""Environment variable: the password to connect with, a blank, and the one to enable with."""

USUAL_PASSWORDS = "EMC EMCTOO"

MODES = ("G21", "G90", "G94", "G8", "G40", "G61")
"""mm, absolute, mm/min, X as a radius, no compensation of a cutter, exact way. In a line of their
own, before the move: in one line F is taken before G21, and where G20 was active the machine goes
25.4 times as fast. Under G7, diameters, X goes half its way. Under G61 it stops with its whole
acceleration, under the usual G64 with half of it."""

MARK = "glidecal"
TRAVEL = " ".join(
    f"#<_ini[JOINT_{joint}]{end}_LIMIT>" for joint in range(JOINTS) for end in ("MIN", "MAX")
)
BINDING = f"mdi (DEBUG,{MARK} #<_ini[KINS]JOINTS> {TRAVEL})"
"""A comment in which LinuxCNC puts numbers of its INI: nothing else of it can be read."""

BIND_TRIES = 3
ABSENT = "######"
"""In the place of a number that does not stand in the INI."""

READY = (
    ("estop", ("OFF",), "release the emergency stop"),
    ("machine", ("ON",), "switch the machine on"),
    ("joint_homed", ("YES",), "home it"),
    ("joint_fault", ("OK",), "look at the controller"),
    ("joint_limit", ("OK",), "jog it off its limit"),
    ("user_linear_units", ("MM", "INCH"), "choose mm or inch"),
    ("joint_type", ("LINEAR",), "glidecal moves three linear joints"),
    ("program_status", ("IDLE",), "wait for the end of its program"),
)
"""What must be right before a move, and what the operator does where it is not."""

SUPERVISED = ("mode", "joint_homed", "joint_fault", "joint_limit", "feed_override")
"""What another client or the panel may change while nobody looks."""

LOOK = ("error", "enable", "estop", "machine", *SUPERVISED)
PLACES = ("program_status", "abs_act_pos", "abs_cmd_pos", "rel_cmd_pos")


class LinuxCnc(Controller):
    """One client of one server."""

    name: ClassVar[str] = "linuxcnc"
    form: ClassVar[str] = "HOST:PORT"
    moving_look_s: ClassVar[float] = 0.02

    def __init__(self, address: str, limits: Limits) -> None:
        super().__init__(address, limits)
        self._socket: socket.socket | None = None
        self._before: list[socket.socket] = []
        self._unit_mm = 1.0
        self._aborted = self._last_try = self._took_control = self._bound = False
        self._program = ""

    def connect(self) -> None:
        """Open the connection; nothing is asked of the machine."""
        self._join()
        self._set("set_wait received", self.answer_s)
        units = self._get("user_linear_units")
        self._unit_mm = MM_PER_INCH if units == "INCH" else 1.0

    def _join(self) -> None:
        """Open a connection that has control."""
        self._bound = False
        self._open(CONNECT_S)
        deadline = Deadline(CONNECT_S)
        connect, _, enable = os.environ.get(PASSWORDS, USUAL_PASSWORDS).partition(" ")
        try:
            self._send(f"hello {connect} glidecal 1")
            answer = self._line(deadline)
            if answer.startswith("HELLO NAK"):
                raise self._refused("the password to connect")
            if not answer.startswith("HELLO ACK"):
                raise self._not_understood(answer, MotionFault.STRANGER)
            # without verbose what is accepted has no answer
            self._send("set echo off\nset verbose on")
            while self._line(deadline) != "SET VERBOSE ACK":  # what is echoed until then
                if deadline.over:
                    raise self._not_understood("lines without end", MotionFault.STRANGER)
            self._took_control = True
            self._send(f"set enable {enable}")
            if self._line(deadline) != "SET ENABLE ACK":
                raise self._refused("the password to enable")
        except ControllerFault as problem:
            self.close()
            if problem.kind is MotionFault.LOST:
                raise self.fault(
                    problem.kind, problem.found, next_step=SERVER_QUESTION
                ) from problem
            raise

    def _open(self, within_s: float) -> None:
        host, _, port = self.address.rpartition(":")
        if not host or host.endswith(":") or (host.startswith("[") != host.endswith("]")):
            host, port = self.address, str(PORT)
        host = host.removeprefix("[").removesuffix("]")  # [::1]:5007, as in a URL
        if not (port.isascii() and port.isdecimal() and 0 < int(port) < 65536):
            raise self.fault(MotionFault.UNREACHABLE, f"port {port!r}", "1 … 65535")
        self._socket = None
        try:
            self._socket = socket.create_connection((host, int(port)), timeout=within_s)
        except (OSError, ValueError) as problem:  # ValueError: a name that is none
            reason = getattr(problem, "strerror", None) or str(problem) or "no answer"
            if isinstance(problem, ValueError) or "/" in host:
                reason = f"{host[:60]!r}, no name of a computer"
            raise self.fault(
                MotionFault.UNREACHABLE, reason, next_step=SERVER_QUESTION
            ) from problem
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._received = b""

    def _refused(self, password: str) -> ControllerFault:
        next_step = f"Set {PASSWORDS} to both, as 'CONNECT ENABLE'."
        value = f"{password} is another one"
        return self.fault(MotionFault.REFUSED, value, next_step=next_step)

    def ready(self) -> tuple[str, ...]:
        """What is right, in the controller's own words."""
        facts = []
        answers = [self._get(name) for name, _, _ in READY]
        for (name, ready_states, remedy), answer in zip(READY, answers, strict=True):
            states = answer.split()[:JOINTS]  # of six joints, whatever there are
            if not states or len(set(states)) != 1 or states[0] not in ready_states:
                next_step = f"At the controller: {remedy}."
                value = f"{name} {' '.join(states)}"
                requirement = f"{name} {' or '.join(ready_states)}"
                raise self.fault(MotionFault.NOT_READY, value, requirement, next_step)
            facts.append(f"{name} {' '.join(states)}")
        self._errors()  # of before
        self._in_control(self._get("enable"))
        return (*facts, self._check_joints())

    def _check_joints(self) -> str:
        """Raises where this is no machine of three joints, or takes other coordinates."""
        homed = self._get("joint_homed").split()
        if "YES" in homed[JOINTS:]:
            value = f"joint_homed {' '.join(homed)}, more than three joints"
            raise self.fault(MotionFault.STRANGER, value, "three joints, one for each carriage")
        kinematics = self._get("kinematics_type")
        identity = self.limits.coordinates == "joint"
        if (kinematics == IDENTITY) != identity:
            takes = "joint" if kinematics == IDENTITY else "tool"
            value = f"kinematics_type {kinematics}: it takes {takes} coordinates"
            requirement = f'mdi = "{self.limits.coordinates}", as the machine file says'
            raise self.fault(MotionFault.STRANGER, value, requirement, "Correct one of the two.")
        return f"kinematics_type {kinematics}"

    def _in_control(self, enable: str) -> None:
        if enable != "ON":
            next_step = "Close the other client; the next move takes control again."
            value = f"enable {enable}"
            raise self.fault(MotionFault.CONTROL_LOST, value, "one client at a time", next_step)

    def look(self) -> Snapshot:
        """One look at errors, control, switches, all that is supervised, and the place."""
        answers = {name: self._get(name) for name in (*LOOK, *PLACES)}
        if answers["error"] != "OK":
            messages = [answers["error"], *self._errors()]
            raise self.fault(MotionFault.CONTROLLER, "; ".join(messages))
        self._in_control(answers["enable"])
        for name, state in (("estop", "OFF"), ("machine", "ON")):
            if answers[name] != state:
                if messages := self._errors():  # switched off since the first look: it says why
                    raise self.fault(MotionFault.CONTROLLER, "; ".join(messages))
                value = f"{name} {answers[name]}"
                raise self.fault(MotionFault.NOT_READY, value, f"{name} {state}")
        states = {name: _short(answers[name]) for name in SUPERVISED}
        place_mm = self.place_of(answers["abs_act_pos"])
        moving = answers["program_status"] != "IDLE"
        commanded = answers["abs_cmd_pos"]
        if not moving and self._get("abs_cmd_pos") == commanded:  # else they are of two moments
            offset = zip(
                self.place_of(answers["rel_cmd_pos"]), self.place_of(commanded), strict=True
            )
            states["offset"] = " ".join(f"{round(a - b, 3) + 0.0:.3f}" for a, b in offset)
        return Snapshot(place_mm, moving, states)

    def place_of(self, answer: str) -> Triple:
        """The place that an answer tells, mm."""
        numbers = answer.split()
        if len(numbers) < AXES:  # one that was cut may be another number
            raise self._not_understood(answer)
        x, y, z = (self.finite(word) * self._unit_mm for word in numbers[:JOINTS])
        return x, y, z

    def begin(self, to_mm: Triple, feed_mm_min: float) -> None:
        """Send a move that knows no offset of a workpiece and no unit but mm.

        Nothing waits for it on this connection: what waits for "done" hears no abort.
        """
        if self._get("mode") != "MDI":
            self._set("mode mdi", ACCEPT_S)
        if not self._bound:
            self._bind()
        # G1, for G0 knows no feed; G53, whatever offset of a workpiece is active
        coordinates = " ".join(f"{name}{mm:.6f}" for name, mm in zip("XYZ", to_mm, strict=True))
        if not set(MODES) <= set(self._get("program_codes").split()):
            self._set(f"mdi {' '.join(MODES)}", ACCEPT_S)
        self._set(f"mdi G53 G1 F{feed_mm_min:.3f} {coordinates}", ACCEPT_S)

    def _bind(self) -> None:
        """Raises where this is no machine of three joints, or the box is no part of their travel.

        It tells so in MDI only, and once: a screen beside the server may hear the message in place
        of this client. What it did not hear it does not judge.
        """
        for _ in range(BIND_TRIES):
            self._set(BINDING, ACCEPT_S)
            fields = self._get("operator_display").split()
            if fields[:1] == [MARK] and len(fields) == 2 + 2 * JOINTS:
                break
        else:
            return
        _, joints, *travel = fields
        if joints != ABSENT and self.finite(joints) != JOINTS:
            value = f"[KINS]JOINTS {self.finite(joints):g}"
            raise self.fault(MotionFault.STRANGER, value, "three joints, one for each carriage")
        if self.limits.coordinates == "joint":
            self._check_travel(travel)
        self._bound = True

    def _check_travel(self, travel: Sequence[str]) -> None:
        limits = self.limits
        ends = zip(travel[::2], travel[1::2], limits.low_mm, limits.high_mm, strict=True)
        for joint, (low, high, low_mm, high_mm) in enumerate(ends):
            least_mm = -math.inf if low == ABSENT else self.finite(low) * self._unit_mm
            most_mm = math.inf if high == ABSENT else self.finite(high) * self._unit_mm
            if low_mm < least_mm or high_mm > most_mm:
                raise self.fault(
                    MotionFault.STRANGER,
                    f"[JOINT_{joint}] from {least_mm:g} to {most_mm:g} mm",
                    f"limits that contain {low_mm:g} … {high_mm:g} mm of the machine file",
                    "Is it the controller of another machine?",
                )

    def settle(self) -> Snapshot:
        """A look when the last micrometres are gone, too."""
        deadline, earlier = Deadline(self.answer_s), self.look()
        while True:
            # it tells IDLE some milliseconds before the last micrometres of a move
            time.sleep(0.01)
            snapshot = self.look()
            still = math.dist(earlier.place_mm, snapshot.place_mm) <= STILL_MM
            if (still and "offset" in snapshot.states) or deadline.over:
                return snapshot
            earlier = snapshot

    @property
    def command_states(self) -> Mapping[str, str]:
        """A move is told in MDI."""
        return {"mode": "MDI"}

    def send_stop(self, attempt: int) -> None:
        """Abort; then also over a new connection: this one is gone, has no control, or is deaf.

        The old one stays open meanwhile: what is on its way there must not be lost with it.
        """
        if attempt == 0 and self._socket is not None:
            self._aborted = self._last_try = False
            with contextlib.suppress(ControllerFault):  # gone
                self._send("set abort")
                return
        if self._last_try and self._socket is not None:
            self._send("set abort")
            return
        if self._socket is not None:
            self._before.append(self._socket)
        self._aborted, self._last_try, self._took_control = False, True, True
        self._open(REJOIN_S)
        connect, _, enable = os.environ.get(PASSWORDS, USUAL_PASSWORDS).partition(" ")
        # "get machine": it refuses an abort while it believes from before that the machine is off
        self._send(
            f"hello {connect} glidecal 1\nset echo off\nset verbose on\n"
            f"set enable {enable}\nget machine\nset abort"
        )

    def send_position(self) -> None:
        """Ask whether a program runs, and for the place."""
        self._send("get program_status\nget abs_act_pos")

    def position_of(self, line: str) -> tuple[Triple, bool] | None:
        """Answers come in the order of questions: what comes before that of the abort is old.

        A refused abort is tried with control of its own; refused again, the machine is off.
        """
        name, _, value = line.partition(" ")
        if name == "SET" and value.startswith("ABORT "):
            self._aborted = True
            if value.endswith("NAK") and not self._last_try:
                raise self.fault(MotionFault.CONTROL_LOST, "NAK to abort")
        elif name == "PROGRAM_STATUS":
            self._program = value
        elif name == "ABS_ACT_POS" and self._aborted:
            return self.place_of(value), self._program != "IDLE"
        return None

    def close(self) -> None:
        """Let go of the connection."""
        if self._socket is not None and self._took_control:
            with contextlib.suppress(ControllerFault):
                # Else the next stranger with the same number of a socket has control unasked. It is
                # waited for: heard late it would take control from the connection that comes next.
                self._accepts("enable off", REJOIN_S)
        self._hang_up()

    def _hang_up(self) -> None:
        connections = [*self._before, *([self._socket] if self._socket else [])]
        self._socket, self._before, self._received = None, [], b""
        self._took_control = False
        for connection in connections:
            connection.close()

    def _errors(self) -> list[str]:
        """What the controller complains of, each message once."""
        messages: list[str] = []
        while len(messages) < MOST_ERRORS and (message := self._get("error")) != "OK":
            messages.append(message)
        return messages

    def _get(self, name: str) -> str:
        """The answer to one question.

        One by one: ten take 0.14 ms. All at once they take 44 ms, for the server waits for an
        acknowledgement (Nagle), and a stop would wait behind them.
        """
        deadline = Deadline(self.answer_s)
        self._send(f"get {name}")
        answer = self._line(deadline)
        label, _, value = answer.partition(" ")
        if label != name.upper():
            raise self._not_understood(answer)
        return value.strip()

    def _set(self, command: str, wait_s: float) -> None:
        """Raises for a NAK what is wrong, where that can be seen: it gives no reason itself."""
        if not self._accepts(command, wait_s):
            self.look()
            answer = f"NAK to {command.split()[0]}"
            raise self.fault(MotionFault.CONTROLLER, answer, "", "Look at the controller.")

    def _accepts(self, command: str, wait_s: float) -> bool:
        deadline = Deadline(wait_s)
        self._send(f"set {command}")
        name, answer = command.split()[0].upper(), self._line(deadline)
        if answer not in (f"SET {name} ACK", f"SET {name} NAK"):
            raise self._not_understood(answer)
        return answer.endswith("ACK")

    def _send(self, command: str) -> None:
        try:
            self._connection.sendall(command.encode() + b"\n")
        except OSError as problem:
            raise self._connection_lost(problem.strerror or str(problem)) from problem

    def _receive(self) -> bytes:
        try:
            received = self._connection.recv(4096)
        except TimeoutError:
            return b""
        except OSError as problem:
            raise self._connection_lost(problem.strerror or str(problem)) from problem
        if not received:
            raise self._connection_lost("it hung up")
        return received

    @property
    def _connection(self) -> socket.socket:
        if self._socket is None:
            raise self.fault(MotionFault.LOST, "no connection")
        self._socket.settimeout(SLICE_S)
        return self._socket

    def _connection_lost(self, reason: str) -> ControllerFault:
        if self._socket is not None:
            self._before.append(self._socket)
            self._socket = None
        return self.fault(MotionFault.LOST, reason)

    def _not_understood(self, answer: str, kind: MotionFault = MotionFault.LOST) -> ControllerFault:
        requirement = "what linuxcncrsh answers"
        return self.fault(kind, repr(answer[:60]), requirement, "Is it another program?")


def _short(states: str) -> str:
    """States of the three joints that move, of six whatever there are."""
    return " ".join(states.split()[:JOINTS])
