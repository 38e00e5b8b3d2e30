"""What a machine is as the operator left it, whether it still is, and a move that is watched.

Whatever is not as it was is a `ControllerFault`: another mode or offset, a place where nobody sent
it, a way that is left, a move that makes no way. The thread that owns the controller calls this.
"""

from __future__ import annotations

import math
import time

from drivers.motion.controller import (
    STILL_MM,
    Controller,
    ControllerFault,
    MotionFault,
    Snapshot,
    Triple,
    place_words,
)

GRACE_S = 0.5
"""So long a move may take to begin."""

STALL_S = 1.0
"""A move that makes no way for so long is held by something."""

SLOWER, SLACK_S = 2.0, 5.0
"""A move that takes longer than its way at its feed by this is held up by something."""

STRAY_MM = 1.0
"""So far beside its straight way a machine may be while it moves: following errors are less."""


class Supervision:
    """One controller, and what it was at the last look that counted.

    ``rest_mm`` is where the machine was last seen at rest, ``way_mm`` both ends of the straight way
    that it was sent; None where that is not known.
    """

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._states: dict[str, str] = {}
        self.rest_mm: Triple | None = None
        self.way_mm: tuple[Triple, Triple] | None = None

    def baseline(self, snapshot: Snapshot) -> None:
        """Note how the controller is to be found from here on."""
        self._states = dict(snapshot.states)
        self.rests(snapshot.place_mm)

    def rests(self, place_mm: Triple | None) -> None:
        """Note where the machine rests; None: somewhere."""
        self.rest_mm = place_mm or self.rest_mm
        self.way_mm = (place_mm, place_mm) if place_mm else None

    def survey(self) -> Snapshot:
        """All that is supervised, found as it was when the operator consented."""
        snapshot = self._controller.survey()
        self.compare(snapshot)
        return snapshot

    def at(self, place_mm: Triple) -> Triple:
        """The position, where it is still this one; raises for what is not as it was."""
        snapshot = self._controller.look()
        self.compare(snapshot)
        if not self._controller.is_at(snapshot.place_mm, place_mm):
            raise self._elsewhere(snapshot.place_mm, place_mm)
        return snapshot.place_mm

    def compare(self, snapshot: Snapshot) -> None:
        """Raises for anything at rest that is not as it was."""
        self._compare_states(snapshot)
        if snapshot.moving:
            value = "a move that is not of this session"
            raise self._controller.fault(MotionFault.CHANGED, value)
        if self.rest_mm is not None and not self._controller.is_at(snapshot.place_mm, self.rest_mm):
            raise self._elsewhere(snapshot.place_mm, self.rest_mm)

    def _compare_states(self, snapshot: Snapshot) -> None:
        if changes := snapshot.changes(self._states):
            raise self._controller.fault(MotionFault.CHANGED, ", ".join(changes))
        self._states |= {k: v for k, v in snapshot.states.items() if k not in self._states}

    def _elsewhere(self, place_mm: Triple, target_mm: Triple) -> ControllerFault:
        value = f"{place_words(place_mm)} in place of {place_words(target_mm)}"
        tolerance = f"within {self._controller.limits.reached_mm:g} mm of it"
        return self._controller.fault(MotionFault.ELSEWHERE, value, tolerance)

    def strayed(self, place_mm: Triple) -> ControllerFault | None:
        """What is wrong with where it rests after an operator's stop: something else moved it."""
        if self.way_mm is None:
            return None
        from_mm, to_mm = self.way_mm
        if from_mm == to_mm and not self._controller.is_at(place_mm, to_mm):
            return self._elsewhere(place_mm, to_mm)
        try:
            self._check_way(place_mm, from_mm, to_mm)
        except ControllerFault as problem:
            return problem
        return None

    def move(self, from_mm: Triple, to_mm: Triple, feed_mm_min: float) -> Triple:
        """One straight move: begun, watched, settled, and read back where it was to be."""
        controller = self._controller
        controller.limits.check_way(from_mm, to_mm)
        if controller.halt.is_set():
            raise controller.fault(MotionFault.STOPPED, "before it moved")
        self._states |= controller.command_states
        self.way_mm = from_mm, to_mm
        controller.begin(to_mm, feed_mm_min)
        way_s = math.dist(from_mm, to_mm) / feed_mm_min * 60.0
        self._wait_there(from_mm, to_mm, SLOWER * way_s + SLACK_S)
        snapshot = controller.settle()
        self._compare_states(snapshot)
        if snapshot.moving or not controller.is_at(snapshot.place_mm, to_mm):
            raise self._elsewhere(snapshot.place_mm, to_mm)
        return snapshot.place_mm

    def _wait_there(self, from_mm: Triple, to_mm: Triple, patience_s: float) -> None:
        """Wait until it no longer moves and is there, or will not be."""
        controller = self._controller
        began_s = way_s = time.monotonic()
        idle_s: float | None = None
        last_mm = from_mm
        while True:
            if controller.halt.wait(controller.moving_look_s):
                why = f"on the way to {place_words(to_mm)}"
                raise controller.fault(MotionFault.STOPPED, why)
            controller.on_wait()
            now_s = time.monotonic()
            snapshot = controller.look()
            self._compare_states(snapshot)
            self._check_way(snapshot.place_mm, from_mm, to_mm)
            if math.dist(snapshot.place_mm, last_mm) > STILL_MM:
                last_mm, way_s = snapshot.place_mm, now_s
                idle_s = None  # it may tell that it is done while it moves
            if snapshot.moving:
                idle_s = None
            else:
                idle_s = idle_s or now_s
                arrived = controller.is_at(snapshot.place_mm, to_mm)
                if arrived or now_s - idle_s > GRACE_S:
                    return
            if now_s - way_s > STALL_S or now_s - began_s > patience_s:
                waited_s = now_s - began_s
                value = f"no further than {place_words(last_mm)} after {waited_s:.1f} s"
                next_step = "Look for a feed hold, or an override of 0."
                raise controller.fault(MotionFault.LATE, value, place_words(to_mm), next_step)

    def _check_way(self, place_mm: Triple, from_mm: Triple, to_mm: Triple) -> None:
        """Raises for a place beside the straight way."""
        if not beside(place_mm, from_mm, to_mm) <= STRAY_MM:
            way = f"within {STRAY_MM:g} mm of the way to {place_words(to_mm)}"
            raise self._controller.fault(MotionFault.ELSEWHERE, place_words(place_mm), way)


def beside(place_mm: Triple, from_mm: Triple, to_mm: Triple) -> float:
    """Distance of a place from the straight line between two others, mm."""
    way = [b - a for a, b in zip(from_mm, to_mm, strict=True)]
    departure = [b - a for a, b in zip(from_mm, place_mm, strict=True)]
    length2 = sum(part * part for part in way)
    share = sum(a * b for a, b in zip(way, departure, strict=True)) / length2 if length2 else 0.0
    share = min(1.0, max(0.0, share))
    return math.dist(departure, [share * part for part in way])
