"""What a controller that moves the machine must do, and what holds before it is asked."""

from __future__ import annotations

import math
import re
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import ClassVar, Literal

from calib.errors import MotionError
from drivers.profile import MILLIMETRES, Unit

Triple = tuple[float, float, float]

SLICE_S = 0.02
"""The longest wait for bytes before the wish to stop is looked up."""

ANSWER_S = 0.4
"""For what is answered at once: within it, and a stop after it, a half second is kept."""

CONNECT_S = 2.0
"""For a connection, and each question while it is made: a wrong device is named within 5 s."""

STOP_S = 0.5
"""Within it a machine is at rest after the cause of a stop, or the operator is told."""

MM_PER_INCH = float(MILLIMETRES[Unit.INCH])

AGAIN_S = 0.2
"""So long after its command a stop is sent once more, by every other way there is."""

APART_S = 0.05
"""Between the two positions that must be equal for a machine to be at rest."""

STILL_MM = 0.002
"""Two positions that differ by less are equal: an encoder flickers by a count. The slowest feed,
1 mm/min, makes 0.8 µm in 50 ms: whether a machine moves its controller must deny, too."""

NOT_STOPPED = "NOT STOPPED. Use the emergency stop."

LONGEST_LINE = 4096
"""Bytes of a line without an end, after which it is no controller that sends them."""

NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", re.ASCII)
"""Python takes ``1_0`` and ``nan`` for numbers, too."""

LARGEST = 1e6
"""No place or setting of a machine is larger: it is a number that was garbled."""


class MotionFault(StrEnum):
    """Why a machine is not where it was to be."""

    UNREACHABLE = "cannot be reached"
    STRANGER = "not the controller of this machine"
    REFUSED = "refused"
    NOT_READY = "not ready"
    OUTSIDE = "outside the limits"
    CONTROL_LOST = "another client has control"
    CHANGED = "changed by somebody else"
    CONTROLLER = "an error of the controller"
    ELSEWHERE = "not at the commanded position"
    LATE = "did not arrive in time"
    STOPPED = "stopped"
    LOST = "connection lost"
    PROGRAM = "an error of this program"


class ControllerFault(MotionError):
    """A `MotionError` with its kind, worded like any `GlidecalError`."""

    def __init__(self, kind: MotionFault, *parts: str) -> None:
        self.kind = kind
        super().__init__(*parts, reason="" if any(parts[1:2]) else f"{kind}")


@dataclass(frozen=True)
class Limits:
    """What no move may exceed, in the controller's coordinates: a box, a way and a feed.

    ``reached_mm`` is how far from where it was sent the machine may be read back. ``coordinates``
    are those that the machine file says the controller takes: of the tool, or of the joints.
    """

    low_mm: Triple
    high_mm: Triple
    longest_mm: float
    fastest_mm_min: float
    reached_mm: float = 0.01
    coordinates: Literal["tool", "joint"] = "joint"

    def check(self, to_mm: Sequence[float], feed_mm_min: float) -> None:
        """Raises `ControllerFault` for a place outside the box, a feed that is none or too fast."""
        for name, value, low, high in zip("XYZ", to_mm, self.low_mm, self.high_mm, strict=True):
            if not low <= value <= high:  # nor what is no number
                raise _outside(f"move to {name}", f"{value:g} mm", f"{low:g} … {high:g} mm")
        if not 0.0 < feed_mm_min <= self.fastest_mm_min:
            feed_range = f"above 0, up to {self.fastest_mm_min:g} mm/min"
            raise _outside("feed", f"{feed_mm_min:g} mm/min", feed_range)

    def check_way(self, from_mm: Sequence[float], to_mm: Sequence[float]) -> None:
        """Raises `ControllerFault` for a single move that is too long."""
        way_mm = math.dist(from_mm, to_mm)
        if not way_mm <= self.longest_mm:
            length = f"{way_mm:.1f} mm from {place_words(from_mm)}"
            raise _outside(f"move to {place_words(to_mm)}", length, f"{self.longest_mm:g} mm")


def _outside(quantity: str, value: str, limit: str) -> ControllerFault:
    next_step = "Nothing was sent. The limits are under [motion] in the machine file."
    return ControllerFault(MotionFault.OUTSIDE, quantity, value, limit, next_step)


def place_words(place_mm: Sequence[float]) -> str:
    """``X10.000 Y0.000 Z-5.000``."""
    # + 0.0: a rounded -0.0 would be shown with its sign
    coordinates = zip("XYZ", place_mm, strict=True)
    return " ".join(f"{name}{round(mm, 3) + 0.0:.3f}" for name, mm in coordinates)


@dataclass(frozen=True)
class Snapshot:
    """One look at a controller: where the machine is read back, and all that others may change.

    ``states`` maps what is supervised to the controller's own word for it (``mode`` to ``MDI``).
    """

    place_mm: Triple
    moving: bool
    states: Mapping[str, str] = field(default_factory=dict)

    def changes(self, earlier_states: Mapping[str, str]) -> list[str]:
        """What is no longer as it was, in words, as far as both looks saw it."""
        return [
            f"{name} {state} in place of {earlier_states[name]}"
            for name, state in self.states.items()
            if earlier_states.get(name, state) != state
        ]


class Deadline:
    """A moment after which no answer is waited for."""

    def __init__(self, wait_s: float) -> None:
        self.wait_s = wait_s
        self.looked = False
        """Whether what had come by then was heard, and nothing later counts."""
        self._end_s = time.monotonic() + wait_s

    @property
    def over(self) -> bool:
        """Whether the moment has passed."""
        return time.monotonic() > self._end_s


class Controller(ABC):
    """One controller, used by one thread; only `halt` may be set by another.

    A controller takes places in its own machine coordinates, mm; whether those are of the tool or
    of joints the machine file knows. Nothing here switches a machine on, resets it or changes a
    limit. Every method raises `ControllerFault`. Every question has one deadline in total, however
    much comes meanwhile, and every wait ends within `SLICE_S` of the wish to `halt`. ``answer_s``
    is how long an answer may take.
    """

    name: ClassVar[str]
    form: ClassVar[str]
    coordinates: ClassVar[Literal["tool", "joint"] | None] = None
    """The only coordinates that it takes, where it knows no others."""

    moving_look_s: ClassVar[float] = 0.05
    """Between two looks while it moves."""

    tells_homing: bool = True
    """Whether it reports that it is homed; where it does not, the operator must confirm it."""

    locked: bool = False
    """Whether it waits for a homing that only this program can tell it to."""

    def __init__(self, address: str, limits: Limits) -> None:
        self.address = address
        self.limits = limits
        self.halt = threading.Event()
        self.answer_s = ANSWER_S
        self.homing = False
        """Whether it homes now; where only a reset ends that, a stop must know."""
        self.on_wait: Callable[[], None] = lambda: None
        """Called while an answer is waited for: who waits is alive."""
        self.takeover: ControllerFault | None = None
        """Set where control had to be taken from somebody else for the last stop."""
        self._received = b""
        self._stopping = False

    @property
    def words(self) -> str:
        """Which one it is."""
        return f"{self.name} at {self.address}"

    @abstractmethod
    def connect(self) -> None:
        """Reach the controller and make sure that it is one; it is asked to do nothing.

        Raises `ControllerFault` within 5 s for a device that is none.
        """

    def renew(self) -> None:
        """Reach the controller again after a fault."""
        self.close()
        self.connect()

    @abstractmethod
    def ready(self) -> tuple[str, ...]:
        """What is right (on, homed, no fault, this machine) and which answer says so.

        Raises `ControllerFault` for what is not.
        """

    @abstractmethod
    def look(self) -> Snapshot:
        """One look; raises for a fault of the controller, an alarm or a lost control."""

    def survey(self) -> Snapshot:
        """A look at all that is supervised, where `look` sees parts of it in turn."""
        return self.look()

    @property
    def command_states(self) -> Mapping[str, str]:
        """What its own commands make of the states that are supervised."""
        return {}

    def home(self) -> None:
        """Home all carriages, as the operator confirmed, where nobody else can tell it to."""
        raise self.fault(MotionFault.REFUSED, "home", "homing at the controller itself")

    @abstractmethod
    def begin(self, to_mm: Triple, feed_mm_min: float) -> None:
        """Send one straight move; returns when it is accepted."""

    def settle(self) -> Snapshot:
        """A look when everything that was sent is done, where the controller can be asked that."""
        return self.look()

    @abstractmethod
    def close(self) -> None:
        """Let go of the controller, in whatever state that is."""

    def handles(self) -> tuple[int, ...]:
        """File descriptors that a guard needs to stop the machine, where it cannot open its own."""
        return ()

    @abstractmethod
    def _receive(self) -> bytes:
        """What comes within `SLICE_S`: a part of a line, or nothing."""

    @abstractmethod
    def send_stop(self, attempt: int) -> None:
        """Send the command that ends the present move; of attempt 1 on by every way there is."""

    @abstractmethod
    def send_position(self) -> None:
        """Ask for the position, not waiting for the answer."""

    @abstractmethod
    def position_of(self, line: str) -> tuple[Triple, bool] | None:
        """The position that a line tells, and whether it says that the machine moves.

        None for a line about something else.
        """

    def stop(self, gives_up: Callable[[str], bool]) -> Triple:
        """End the present move; returns where the machine rests.

        At rest are two positions `APART_S` apart that are equal, while the controller denies that
        it moves. Until then ``gives_up`` is asked again and again, with why that is not yet seen;
        raises `ControllerFault` where it says so.
        """
        self._stopping = True
        try:
            return self._stopped(gives_up)
        finally:
            self._stopping = False

    def _stopped(self, gives_up: Callable[[str], bool]) -> Triple:
        attempts, send_s, ask_s, lost_s = 0, -math.inf, -math.inf, math.inf
        patience_s = AGAIN_S
        first_mm: Triple | None = None
        waits = False
        why, self.takeover = "no answer", None
        while not gives_up(why):
            now_s = time.monotonic()
            try:
                if now_s >= send_s:
                    send_s = now_s + AGAIN_S * (attempts + 1)
                    attempts += 1
                    self.send_stop(attempts - 1)
                if waits and now_s >= lost_s:
                    waits, patience_s = False, 2.0 * patience_s  # that answer is lost, or late
                if not waits and now_s >= ask_s:
                    waits, lost_s = True, now_s + patience_s
                    self.send_position()
                report = self._report()
            except ControllerFault as problem:
                why, first_mm, waits = problem.found or problem.reason, None, False
                if problem.kind is MotionFault.CONTROL_LOST:
                    self.takeover = problem
                send_s = min(send_s, now_s + APART_S)  # by another way, soon
                time.sleep(SLICE_S)
                continue
            if report is None:
                continue
            place_mm, moving = report
            # An answer to an earlier question may lie in the pipe, and a controller that was held
            # up answers all of them at once: only what was asked for later than the first tells.
            if waits and not moving and first_mm and math.dist(place_mm, first_mm) <= STILL_MM:
                return place_mm
            why = f"still moving at {place_words(place_mm)}"
            first_mm, waits = None if moving else place_mm, False
            ask_s = time.monotonic() + APART_S
        raise self.fault(MotionFault.LOST, why, "", NOT_STOPPED)

    def _report(self) -> tuple[Triple, bool] | None:
        """The next position among what comes within a moment."""
        try:
            line = self._line(Deadline(SLICE_S))
        except NoLine:
            return None
        return self.position_of(line)

    def _line(self, deadline: Deadline) -> str:
        """The next line that is not empty; CR, LF and both in any order end one.

        Raises `ControllerFault` where none comes in time, or a stop is wished for meanwhile.
        """
        while True:
            received = self._received.replace(b"\r", b"\n").lstrip(b"\n ")
            line, end, self._received = received.partition(b"\n")
            if end:
                return line.decode("latin-1").strip()
            self._received = line
            if len(line) > LONGEST_LINE:
                self._received = b""
                raise self.fault(MotionFault.LOST, f"a line without an end: {line[:40]!r}")
            if deadline.looked:
                raise NoLine(self, deadline.wait_s)
            if self.halt.is_set() and not self._stopping:
                raise self.fault(MotionFault.STOPPED, "while an answer was waited for")
            self.on_wait()
            # before a last look: it came if only we were held up
            deadline.looked = deadline.over
            self._received += self._receive()

    def finite(self, word: str) -> float:
        """A number that a controller sent. Raises `ControllerFault` for what is none."""
        value = float(word) if NUMBER.fullmatch(word) else math.nan
        if not abs(value) < LARGEST:
            raise self.fault(MotionFault.CONTROLLER, f"{word[:40]!r}", "a number")
        return value

    def is_at(self, place_mm: Triple, target_mm: Triple) -> bool:
        """Whether a place that was read back is the one that was wanted."""
        # not `<=` of a maximum: that swallows what is no number
        pairs = zip(place_mm, target_mm, strict=True)
        return all(abs(a - b) <= self.limits.reached_mm for a, b in pairs)

    def fault(
        self, kind: MotionFault, value: str = "", requirement: str = "", next_step: str = ""
    ) -> ControllerFault:
        """A fault of this controller."""
        subject = f"{self.words}, {kind}" if value else self.words
        return ControllerFault(kind, subject, value, requirement, next_step)


class NoLine(ControllerFault):
    """No line came in time."""

    def __init__(self, controller: Controller, wait_s: float) -> None:
        value = f"no answer within {wait_s:g} s"
        super().__init__(MotionFault.LOST, f"{controller.words}, {MotionFault.LOST}", value)
