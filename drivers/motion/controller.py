"""What a controller that moves the machine must do, and what holds before it is asked."""

from __future__ import annotations

import math
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import ClassVar

from calib.errors import MotionError

Triple = tuple[float, float, float]

LOOK_S = 0.02
"""Between two looks at a machine that moves: far below the half second in which it must stop."""

ANSWER_S = 0.4
"""For what is answered at once: within it, and a stop after it, a half second is kept."""

GRACE_S = 0.5
"""So long a move may take to begin, and its last look to be of now."""

SLOWER, SLACK_S = 2.0, 5.0
"""A move that takes longer than its way at its feed by this is held up by something."""


class MotionFault(StrEnum):
    """Why a machine is not where it was to be."""

    UNREACHABLE = "cannot be reached"
    REFUSED = "refused"
    NOT_READY = "not ready"
    OUTSIDE = "outside the limits"
    CONTROL_LOST = "another client has control"
    CONTROLLER = "an error of the controller"
    ELSEWHERE = "not where it was sent"
    LATE = "did not arrive in time"
    STOPPED = "stopped"
    LOST = "connection lost"


class ControllerFault(MotionError):
    """A `MotionError` with its kind, told like any `GlidecalError`."""

    def __init__(self, kind: MotionFault, *told: str, reason: str = "") -> None:
        self.kind = kind
        super().__init__(*told, reason=reason or ("" if any(told[1:2]) else f"{kind}"))


@dataclass(frozen=True)
class Limits:
    """What no move may exceed, in the controller's coordinates: a box, a way and a feed.

    ``reached_mm`` is how far from where it was sent the machine may be read back.
    """

    low_mm: Triple
    high_mm: Triple
    longest_mm: float
    fastest_mm_min: float
    reached_mm: float = 0.01

    def check(self, to_mm: Sequence[float], feed_mm_min: float) -> None:
        """Raises `ControllerFault` for a place outside the box, a feed that is none or too fast."""
        for name, value, low, high in zip("XYZ", to_mm, self.low_mm, self.high_mm, strict=True):
            if not low <= value <= high:  # nor what is no number
                raise _outside(f"move to {name}", f"{value:g} mm", f"{low:g} … {high:g} mm")
        if not 0.0 < feed_mm_min <= self.fastest_mm_min:
            allowed = f"above 0, up to {self.fastest_mm_min:g} mm/min"
            raise _outside("feed", f"{feed_mm_min:g} mm/min", allowed)

    def check_way(self, from_mm: Sequence[float], to_mm: Sequence[float]) -> None:
        """Raises `ControllerFault` for a single move that is too long."""
        way_mm = math.dist(from_mm, to_mm)
        if not way_mm <= self.longest_mm:
            found = f"{way_mm:.1f} mm from {place_words(from_mm)}"
            raise _outside(f"move to {place_words(to_mm)}", found, f"{self.longest_mm:g} mm")


def _outside(thing: str, found: str, allowed: str) -> ControllerFault:
    next_step = "Nothing was sent. The limits stand under [motion] in the machine file."
    return ControllerFault(MotionFault.OUTSIDE, thing, found, allowed, next_step)


def place_words(place_mm: Sequence[float]) -> str:
    """``X10.000 Y0.000 Z-5.000``."""
    # + 0.0: a rounded -0.0 would be shown with its sign
    words = zip("XYZ", place_mm, strict=True)
    return " ".join(f"{name}{round(mm, 3) + 0.0:.3f}" for name, mm in words)


class Controller(ABC):
    """One controller, used by one thread; only `halt` may be set by another.

    Nothing here switches a machine on, homes it, or resets anything. A controller is told places in
    its own machine coordinates, mm; whether those are of the tool or of joints the machine file
    knows. Every method raises `ControllerFault`. ``answer_s`` is how long an answer may take.
    """

    name: ClassVar[str]
    form: ClassVar[str]

    def __init__(self, address: str, limits: Limits) -> None:
        self.address = address
        self.limits = limits
        self.halt = threading.Event()
        self.answer_s = ANSWER_S
        self._received = b""

    @property
    def words(self) -> str:
        """Which one it is."""
        return f"{self.name} at {self.address}"

    @abstractmethod
    def connect(self) -> None:
        """Reach the controller; it is not asked to do anything."""

    @abstractmethod
    def ready(self) -> tuple[str, ...]:
        """What is right (on, homed, no fault, mm) and which answer says so; raises if it is not."""

    @abstractmethod
    def position(self) -> Triple:
        """Where the controller reads the machine back, mm."""

    @abstractmethod
    def moves(self) -> bool:
        """One look: whether a move is under way; raises for whatever is wrong."""

    @abstractmethod
    def _begin(self, to_mm: Triple, feed_mm_min: float) -> None:
        """Send one straight move; returns when it is accepted."""

    @abstractmethod
    def _barrier(self) -> None:
        """Return when everything that was sent is done. Called at the end of a move."""

    @abstractmethod
    def stop(self) -> None:
        """End the present move at once, over a new connection where this one is gone."""

    @abstractmethod
    def close(self) -> None:
        """Let go of the controller, in whatever state that is."""

    @abstractmethod
    def _receive(self) -> bytes:
        """What comes within a moment: a part of a line, or nothing."""

    def _line(self, patience_s: float) -> str:
        """The next line that is not empty; CR, LF and both in any order end one."""
        end_s, late = time.monotonic() + patience_s, False
        while True:
            received = self._received.replace(b"\r", b"\n").lstrip(b"\n ")
            line, end, self._received = received.partition(b"\n")
            if end:
                return line.decode("latin-1").strip()
            self._received = line
            if late:
                raise self.fault(MotionFault.LOST, f"no answer within {patience_s:g} s")
            late = time.monotonic() > end_s  # before a last look: it came if only we were held up
            self._received += self._receive()

    def move_to(self, to_mm: Triple, feed_mm_min: float) -> Triple:
        """One straight move, waited for; returns where the machine is read back.

        Limits hold before a byte of it is sent. Whatever goes wrong ends the move first.
        """
        self.limits.check(to_mm, feed_mm_min)
        from_mm = self.position()
        self.limits.check_way(from_mm, to_mm)
        try:
            if self.halt.is_set():
                raise self.fault(MotionFault.STOPPED, "before it moved")
            self._begin(to_mm, feed_mm_min)
            way_s = math.dist(from_mm, to_mm) / feed_mm_min * 60.0
            return self._wait_done(to_mm, SLOWER * way_s + SLACK_S)
        except ControllerFault as problem:
            self._stopped(problem)
            raise

    def _wait_done(self, to_mm: Triple, patience_s: float) -> Triple:
        """No longer moving, the barrier, and then the position: none of them tells it alone."""
        end_s = time.monotonic() + patience_s
        idle_s: float | None = None
        while True:
            if self.halt.wait(LOOK_S):
                raise self.fault(MotionFault.STOPPED, f"on the way to {place_words(to_mm)}")
            now_s = time.monotonic()
            if now_s > end_s:
                found = f"still on the way to {place_words(to_mm)} after {patience_s:.1f} s"
                raise self.fault(MotionFault.LATE, found, next_step="Look for a feed hold.")
            if self.moves():
                idle_s = None
                continue
            idle_s = idle_s or now_s
            if self._is_at(self.position(), to_mm) or now_s - idle_s > GRACE_S:
                break
        self._barrier()
        there = self.position()
        if not self._is_at(there, to_mm):
            found = f"{place_words(there)} in place of {place_words(to_mm)}"
            raise self.fault(
                MotionFault.ELSEWHERE, found, f"within {self.limits.reached_mm:g} mm of it"
            )
        return there

    def is_at(self, place_mm: Triple) -> Triple:
        """The position, where it is still this one, nothing moves and nobody else has control.

        Raises `ControllerFault`.
        """
        if self.moves():
            raise self.fault(MotionFault.ELSEWHERE, "a move that is not of this session")
        there = self.position()
        if not self._is_at(there, place_mm):
            found = f"{place_words(there)} in place of {place_words(place_mm)}"
            raise self.fault(MotionFault.ELSEWHERE, found, "the position that was reached")
        return there

    def _is_at(self, there: Triple, wanted: Triple) -> bool:
        off = max(abs(a - b) for a, b in zip(there, wanted, strict=True))
        return off <= self.limits.reached_mm

    def _stopped(self, problem: ControllerFault) -> None:
        """Stop after a problem. Raises where that is impossible: then somebody must do it."""
        try:
            self.stop()
        except ControllerFault as second:
            why = second.found or second.reason
            next_step = f"IT COULD NOT BE TOLD TO STOP ({why}): use the emergency stop."
            told = problem.thing, problem.found, "", next_step
            raise ControllerFault(problem.kind, *told, reason=problem.reason) from problem

    def fault(
        self, kind: MotionFault, found: str = "", allowed: str = "", next_step: str = ""
    ) -> ControllerFault:
        """A fault of this controller."""
        thing = f"{self.words}, {kind}" if found else self.words
        return ControllerFault(kind, thing, found, allowed, next_step)
