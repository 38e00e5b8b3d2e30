"""LinuxCNC through its text server ``linuxcncrsh``; asked for nothing but to move, read and abort.

What it does that is unexpected, each tried with LinuxCNC 2.9: a dropped connection lets a move go
on; whoever enables last has control and the others are told NAK without a reason; a refused line
is acknowledged and only ``get error`` tells, one message a call; ``joint_homed`` lists six joints
whatever there are; a program that waits for ``done`` hears no abort; how commands wait is one
setting for all clients; clients that ask at the same time disturb each other (it parses with
``strtok`` in threads): answers are cut or lost, and a line may be, so that only the position that
is read back tells where it went.
"""

from __future__ import annotations

import contextlib
import os
import socket
from typing import ClassVar

from drivers.motion.controller import (
    LOOK_S,
    Controller,
    ControllerFault,
    Limits,
    MotionFault,
    Triple,
)

PORT = 5007
CONNECT_S = 2.0
ACCEPT_S = 3.0
"""For what the controller has to accept; it looks ten times a second."""

MOST_ERRORS = 20
JOINTS = 3
PASSWORDS = "GLIDECAL_LINUXCNC_PASSWORDS"
"""Environment variable: the password to connect with, a blank, and the one to enable with."""

USUAL = "EMC EMCTOO"


class LinuxCnc(Controller):
    """One client of one server."""

    name: ClassVar[str] = "linuxcnc"
    form: ClassVar[str] = "HOST:PORT"

    def __init__(self, address: str, limits: Limits) -> None:
        super().__init__(address, limits)
        self._socket: socket.socket | None = None

    def connect(self) -> None:
        """Open the connection; nothing is asked of the machine."""
        self._join()
        self._set("set_wait received", ACCEPT_S)

    def _join(self) -> None:
        """Open a connection that has control."""
        host, _, port = self.address.rpartition(":")
        if not host:
            host, port = self.address, str(PORT)
        if not (port.isascii() and port.isdecimal() and 0 < int(port) < 65536):
            raise self.fault(MotionFault.UNREACHABLE, f"port {port!r}", "1 … 65535")
        try:
            self._socket = socket.create_connection((host, int(port)), timeout=CONNECT_S)
        except OSError as problem:
            said = problem.strerror or str(problem) or "no answer"
            next_step = "Is linuxcncrsh running there, and does this port belong to it?"
            raise self.fault(MotionFault.UNREACHABLE, said, next_step=next_step) from problem
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connect, _, enable = os.environ.get(PASSWORDS, USUAL).partition(" ")
        try:
            if not self._asked(f"hello {connect} glidecal 1", CONNECT_S).startswith("HELLO ACK"):
                raise self._refused("the password to connect")
            # without verbose what is accepted has no answer
            told = self._asked("set echo off\nset verbose on", CONNECT_S)
            while told != "SET VERBOSE ACK":
                told = self._line(CONNECT_S)  # what is echoed until then
            if self._asked(f"set enable {enable}", CONNECT_S) != "SET ENABLE ACK":
                raise self._refused("the password to enable")
        except ControllerFault:
            self.close()
            raise

    def _refused(self, what: str) -> ControllerFault:
        next_step = f"Set {PASSWORDS} to both, as 'CONNECT ENABLE'."
        return self.fault(MotionFault.REFUSED, f"{what} is another one", next_step=next_step)

    def ready(self) -> tuple[str, ...]:
        """What is right, in the controller's own words."""
        said = []
        for what, wanted, otherwise in (
            ("estop", "OFF", "release the emergency stop"),
            ("machine", "ON", "switch the machine on"),
            ("joint_homed", "YES", "home it"),
            ("joint_fault", "OK", "look at the controller"),
            ("joint_limit", "OK", "jog it off its limit"),
            ("user_linear_units", "MM", "glidecal moves machines in mm only"),
            ("joint_type", "LINEAR", "glidecal moves three linear joints"),
            ("program_status", "IDLE", "wait for the end of its program"),
        ):
            found = self._get(what).split()[:JOINTS]  # of six joints, whatever there are
            if not found or set(found) != {wanted}:
                next_step = f"At the controller: {otherwise}."
                shown = f"{what} {' '.join(found)}"
                raise self.fault(MotionFault.NOT_READY, shown, f"{what} {wanted}", next_step)
            said.append(f"{what} {' '.join(found)}")
        self._errors()  # of before
        self._in_control()
        return tuple(said)

    def _in_control(self) -> None:
        if (found := self._get("enable")) != "ON":
            next_step = "Close the other client; the next move takes control again."
            shown = f"enable {found}"
            raise self.fault(MotionFault.CONTROL_LOST, shown, "one client at a time", next_step)

    def position(self) -> Triple:
        """Where the machine is read back, mm."""
        found = self._get("abs_act_pos").split()
        try:
            x, y, z = (float(word) for word in found[:3])
        except ValueError:
            raise self._not_understood(" ".join(found)) from None
        return x, y, z

    def moves(self) -> bool:
        """One look at errors, control, switches and the interpreter."""
        if told := self._errors():
            raise self.fault(MotionFault.CONTROLLER, "; ".join(told))
        self._in_control()
        if (found := self._get("estop")) != "OFF":
            raise self.fault(MotionFault.NOT_READY, f"estop {found}", "estop OFF")
        if (found := self._get("machine")) != "ON":
            if told := self._errors():  # switched off since the first look: it says why
                raise self.fault(MotionFault.CONTROLLER, "; ".join(told))
            raise self.fault(MotionFault.NOT_READY, f"machine {found}", "machine ON")
        return self._get("program_status") != "IDLE"

    def _begin(self, to_mm: Triple, feed_mm_min: float) -> None:
        if self._get("mode") != "MDI":
            self._set("mode mdi", ACCEPT_S)
        # G1, for G0 knows no feed; G53, whatever offset of a workpiece is active; mm, absolute
        words = " ".join(f"{name}{mm:.6f}" for name, mm in zip("XYZ", to_mm, strict=True))
        self._set(f"mdi G21 G90 G94 G53 G1 F{feed_mm_min:.3f} {words}", ACCEPT_S)

    def _barrier(self) -> None:
        """Asked twice where it is refused for no reason that shows.

        In emcrsh.cc `setWait` says NAK where the last command ended in an error, of which `moves`
        knows, and where another client that asked at that moment took the word ``done`` away:
        then nothing was waited for. It changes nothing, so it may be asked once more.
        """
        if not self._accepts("wait done", ACCEPT_S):
            self.moves()
            self._set("wait done", ACCEPT_S)

    def stop(self) -> None:
        """Abort; over a new connection where this one is gone or has no control."""
        if self._socket is not None:
            with contextlib.suppress(
                ControllerFault
            ):  # gone; where it says NAK another has control
                if self._accepts("abort", self.answer_s):
                    return
        self.close()
        self._join()
        try:
            self._asked("set abort", self.answer_s)
        finally:
            self.close()

    def close(self) -> None:
        """Let go of the connection."""
        connection, self._socket, self._received = self._socket, None, b""
        if connection is not None:
            connection.close()

    def _errors(self) -> list[str]:
        """What the controller complains of, each told once."""
        found: list[str] = []
        while len(found) < MOST_ERRORS and (told := self._get("error")) != "OK":
            found.append(told)
        return found

    def _get(self, what: str) -> str:
        answer = self._asked(f"get {what}", self.answer_s)
        name, _, value = answer.partition(" ")
        if name != what.upper():
            raise self._not_understood(answer)
        return value.strip()

    def _set(self, what: str, patience_s: float) -> None:
        """Raises for a NAK what is wrong, where that can be seen: it gives no reason itself."""
        if not self._accepts(what, patience_s):
            self.moves()
            answer = f"NAK to {what.split()[0]}"
            raise self.fault(MotionFault.CONTROLLER, answer, "", "Look at the controller.")

    def _accepts(self, what: str, patience_s: float) -> bool:
        name, answer = what.split()[0].upper(), self._asked(f"set {what}", patience_s)
        if answer not in (f"SET {name} ACK", f"SET {name} NAK"):
            raise self._not_understood(answer)
        return answer.endswith("ACK")

    def _asked(self, words: str, patience_s: float) -> str:
        """The next line after these words; none has a number, so a missing one spoils the rest."""
        if self._socket is None:
            raise self.fault(MotionFault.LOST)
        self._socket.settimeout(patience_s)
        try:
            self._socket.sendall(words.encode() + b"\n")
        except OSError as problem:
            raise self.fault(MotionFault.LOST, problem.strerror or str(problem)) from problem
        return self._line(patience_s)

    def _receive(self) -> bytes:
        if self._socket is None:
            raise self.fault(MotionFault.LOST)
        self._socket.settimeout(LOOK_S)
        try:
            came = self._socket.recv(4096)
        except TimeoutError:
            return b""
        except OSError as problem:
            raise self.fault(MotionFault.LOST, problem.strerror or str(problem)) from problem
        if not came:
            raise self.fault(MotionFault.LOST, "it hung up")
        return came

    def _not_understood(self, answer: str) -> ControllerFault:
        wanted = "what linuxcncrsh answers"
        return self.fault(MotionFault.LOST, repr(answer[:60]), wanted, "Is it another program?")
