"""A machine that moves itself from step to step, and stops for whatever is not as it should be."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from enum import StrEnum

from calib.errors import MotionError, UsageError
from drivers.motion import controller_of
from drivers.motion.controller import ControllerFault, Limits, Triple
from drivers.motion.line import MotionLine
from protocols.machine import Machine, MotionLimits
from protocols.motion import all_ways, box_mm, came_from, moves_mm, way_mm, zero_mm
from protocols.procedure import Procedure, Step
from protocols.session import Moved


class Moving(StrEnum):
    """What a machine is doing that moves itself."""

    SET_UP = "waits for the set-up"
    UNDER_WAY = "moving"
    THERE = "there"
    STOPPED = "stopped"


UNATTENDED = (Moving.UNDER_WAY, Moving.THERE)
"""Nobody is at the machine; what stops it here is followed by a new approach."""


@dataclass(frozen=True)
class Ways:
    """All ways of a procedure, and what they come to."""

    steps: tuple[Step, ...]
    longest_mm: float
    moving_s: float
    resting_s: float


def limits_of(machine: Machine) -> Limits:
    """What no move of this machine may exceed. Raises RecordError."""
    motion, (low, high) = machine.motion or MotionLimits(), box_mm(machine)
    fastest = machine.fastest_feed_mm_min
    return Limits(low, high, motion.longest_mm, fastest, motion.reached_mm)


def feed_mm_min(machine: Machine) -> float:
    """How fast this machine is told to move."""
    return (machine.motion or MotionLimits()).feed_mm_min


def ways_of(procedure: Procedure, machine: Machine, axes: Sequence[str]) -> Ways:
    """Every way of a whole session, checked against the limits; nothing is sent.

    Raises RecordError, UsageError or MotionError for what is not allowed.
    """
    if procedure.plane is not None:
        raise UsageError(
            f"--motion with procedure {procedure.name}",
            "a stand that is slid by hand in every posture",
            "a procedure without [plane]",
            "Measure it without --motion.",
        )
    limits, found = limits_of(machine), all_ways(procedure, machine, axes)
    ways = [way for _, way in found]
    for way in ways:
        for place in way:
            limits.check(place, feed_mm_min(machine))
    moves = moves_mm(ways)
    longest = max(moves, default=0.0)
    if longest > limits.longest_mm:
        thing = f"longest move of {procedure.name}"
        allowed = f"{limits.longest_mm:g} mm, longest_mm under [motion] in the machine file"
        raise MotionError(thing, f"{longest:.1f} mm", allowed, "Nothing was sent.")
    moving_s = sum(moves) / feed_mm_min(machine) * 60.0
    return Ways(tuple(step for step, _ in found), longest, moving_s, procedure.window_s * len(ways))


def check_motion(told: str, machine: Machine) -> tuple[str, ...]:
    """What the controller says of being ready; it is let go again. Raises MotionError."""
    controller = controller_of(told, limits_of(machine))
    try:
        controller.connect()
        return controller.ready()
    finally:
        controller.close()


class Mover:
    """Moves the machine to steps, and knows whether it is there.

    Before each set-up it goes to Zero and waits for the operator's word. ``on_news`` is called in
    the thread of the controller. After a stop the next way begins anew, from the side from which
    the procedure comes. ``on_arrival`` is called before the machine is said to be there: what the
    indicators showed on the way is no rest. ``said`` is what the controller said of being ready.
    """

    def __init__(
        self, line: MotionLine, procedure: Procedure, machine: Machine, axes: Sequence[str]
    ) -> None:
        self.line = line
        self.why = ""
        self.said: tuple[str, ...] = ()
        self.on_news: Callable[[], None] = lambda: None
        self.on_arrival: Callable[[], None] = lambda: None
        self.on_set_up: Callable[[Step], None] = lambda _: None  # a simulated machine has no hands
        self._procedure, self._machine = procedure, machine
        self._steps = procedure.steps(machine.geometry(), axes)
        self._feed = feed_mm_min(machine)
        self._lock = threading.RLock()
        self._state = Moving.STOPPED
        self._asked: Future[Triple] | None = None
        self._step: Step | None = None
        self._at: Step | None = None
        self._places: list[Triple] = []
        self._at_mm: Triple | None = None
        line.listener = self._heard

    @property
    def state(self) -> Moving:
        """What the machine is doing now."""
        return self._state

    def go(self, step: Step, *, by_hand_first: bool) -> None:
        """To a step; where something is set up by hand first, to Zero, to wait there."""
        with self._lock:
            self._step = step
            if not by_hand_first:
                self._send(self._way(step), Moving.THERE)
            elif self._at is not None and self._at.at_zero:
                self._state = Moving.SET_UP
            else:
                self._send([zero_mm(self._machine)], Moving.SET_UP)
        self.on_news()

    def confirm(self) -> None:
        """The operator's word: the set-up stands and nobody is in the way."""
        with self._lock:
            if self._state is Moving.SET_UP and self._step is not None:
                self._at = None
                self.on_set_up(self._step)
                self._send(self._way(self._step), Moving.THERE)
        self.on_news()

    def stop(self, why: str) -> None:
        """End what is under way, from any thread."""
        with self._lock:
            self.line.stop()
            if self._state in UNATTENDED:
                self._stopped(why)

    def there(self, step: Step) -> Moved:
        """What the record holds of the machine's being at a step. Raises MotionError."""
        with self._lock:
            if self._state is not Moving.THERE or self._at != step or self._at_mm is None:
                raise MotionError(f"step {step.number}", self.why or self._state, "a machine there")
            asked, from_mm = self.line.at(self._places[-1]), self._at_mm
        try:
            there = asked.result()
        except ControllerFault as problem:
            self._stopped(str(problem))
            raise
        return Moved(
            driver=self.line.controller.name,
            coordinates=self._machine.mdi,
            from_mm=from_mm,
            commanded_mm=self._places[-1],
            read_back_mm=there,
            feed_mm_min=self._feed,
        )

    def close(self) -> None:
        """Stop and let go of the controller."""
        self.line.close()

    def _way(self, step: Step) -> list[Triple]:
        here = self._at if self._at is not None and self._at.place == step.place else None
        if here == step:  # once more: approached anew
            here = None
        if here is None and (before := came_from(step, self._steps)) is not None:
            return [
                *way_mm(before, before, self._procedure, self._machine),
                *way_mm(step, before, self._procedure, self._machine),
            ]
        return way_mm(step, here, self._procedure, self._machine)

    def _send(self, places: list[Triple], then: Moving) -> None:
        if self._state is Moving.UNDER_WAY:
            self.line.stop()
        began = self._places[-1] if self._at is not None else None
        self._at_mm = places[-2] if len(places) > 1 else began
        self._at, self._places, self._state, self.why = None, places, Moving.UNDER_WAY, ""
        self._asked = asked = self.line.go(places, self._feed)
        asked.add_done_callback(lambda done: self._answered(done, then))

    def _answered(self, done: Future[Triple], then: Moving) -> None:
        """In the thread of the controller."""
        with self._lock:
            if done is not self._asked or self._state is not Moving.UNDER_WAY:
                return
            problem = done.exception()
            if problem is not None:
                self._stopped(str(problem))
                return
            self.on_arrival()
            self._state = then
            self._at = self._step if then is Moving.THERE else None
        self.on_news()

    def _heard(self) -> None:
        """In the thread of the controller: something befell a machine at rest."""
        self._stopped(str(self.line.fault))

    def _stopped(self, why: str) -> None:
        with self._lock:
            self._state, self._at, self.why = Moving.STOPPED, None, why
        self.on_news()


def open_mover(told: str, procedure: Procedure, machine: Machine, axes: Sequence[str]) -> Mover:
    """Connect to the controller that ``told`` names; nothing moves yet.

    Raises UsageError, RecordError or MotionError.
    """
    ways_of(procedure, machine, axes)
    line = MotionLine(controller_of(told, limits_of(machine)))
    mover = Mover(line, procedure, machine, axes)
    mover.said = line.start()
    return mover
