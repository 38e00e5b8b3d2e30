"""A controller beside its twin, and the line that moves it with the consent of a test."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager

from drivers.motion import controller_of
from drivers.motion.controller import Controller, Limits, Triple
from drivers.motion.line import MotionLine, Patience
from drivers.motion.states import State
from tests.drivers.motion.twins import TWINS, FailingAxes, MotionTrouble, MotionTwin

LIMITS = Limits((-100.0,) * 3, (60.0,) * 3, longest_mm=120.0, fastest_mm_min=60_000.0)
START = (1.0, 2.0, -3.0)
FEED = 6000.0
SLOW = 300.0  # 5 mm/s: nothing that is tested here arrives
PATIENCE_S = 60.0  # of a busy machine
BUSY = Patience(silence_s=3.0, dead_s=0.0)
"""Tests run on busy machines: only those of the silence itself are as impatient as the program."""


class Face:
    """What stands for the screens: it tells that it runs."""

    def __init__(self, line: MotionLine) -> None:
        self._line, self._ends = line, threading.Event()
        self._thread = threading.Thread(target=self._tell, name="face")
        self._thread.start()

    def _tell(self) -> None:
        while not self._ends.wait(0.03):
            self._line.alive()

    def hang(self) -> None:
        """It runs no more."""
        self._ends.set()
        self._thread.join()


class Ticker:
    """What this computer held up by itself: no driver is blamed for it."""

    def __init__(self) -> None:
        self.gaps: list[tuple[float, float]] = []
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._tick, name="ticker")
        self._thread.start()

    def _tick(self) -> None:
        last_s = time.monotonic()
        while not self._ends.wait(0.005):
            now_s = time.monotonic()
            if now_s - last_s > 0.015:
                self.gaps.append((now_s, now_s - last_s))
            last_s = now_s

    def held_up(self, from_s: float, to_s: float) -> float:
        """For how long nothing ran between two moments; three threads in turn are held up."""
        return 3.0 * sum(gap_s for at_s, gap_s in self.gaps if from_s <= at_s <= to_s + gap_s)

    def close(self) -> None:
        self._ends.set()
        self._thread.join()


@contextmanager
def beside(name: str, *troubles: MotionTrouble) -> Iterator[tuple[Controller, MotionTwin]]:
    """A controller that is connected, without a line."""
    twin = TWINS[name](FailingAxes(START))
    for trouble in troubles:
        twin.befall(trouble)
    controller = controller_of(twin.endpoint, LIMITS)
    controller.answer_s = 2.0
    try:
        controller.connect()
        yield controller, twin
    finally:
        controller.close()
        twin.close()


class Rig:
    """A line that is started, its twin and its face."""

    def __init__(self, line: MotionLine, twin: MotionTwin, face: Face) -> None:
        self.line, self.twin, self.face = line, twin, face

    @property
    def axes(self) -> FailingAxes:
        return self.twin.axes

    def go(self, *places_mm: Triple, feed: float = FEED) -> Triple:
        """With a consent of its own, to the end."""
        self.consent()
        there = self.line.go(places_mm, feed).result(PATIENCE_S)
        self.line.release()
        return there

    def consent(self) -> None:
        assert self.line.consent()

    def on_the_way(self, *, to: Triple = (50.0, 2.0, -3.0), feed: float = SLOW) -> None:
        """A move is under way when this returns."""
        self.consent()
        self.line.go([to], feed)
        assert comes_true(lambda: self.axes.moving and self.axes.at_mm != START)

    def comes(self, state: State) -> None:
        assert comes_true(lambda: self.line.state is state), (self.line.state, self.line.why)


@contextmanager
def started(
    controller: Controller, patience: Patience = BUSY, answer_s: float = 2.0, *, homed: bool = True
) -> Iterator[tuple[MotionLine, Face]]:
    """A line that is started, and its face; ``homed`` by the operator's word. Both end."""
    controller.answer_s = answer_s
    line = MotionLine(controller, patience)
    line.start()
    line.homing_confirmed = homed
    face = Face(line)
    try:
        yield line, face
    finally:
        line.close()
        face.hang()


@contextmanager
def rig(
    name: str,
    patience: Patience = BUSY,
    answer_s: float = 2.0,
    make: Callable[[FailingAxes], MotionTwin] | None = None,
) -> Iterator[Rig]:
    """A started line; whatever the test did, it ends."""
    with closing((make or TWINS[name])(FailingAxes(START))) as twin:
        controller = controller_of(twin.endpoint, LIMITS)
        with started(controller, patience, answer_s) as (line, face):
            yield Rig(line, twin, face)


def comes_true(condition: Callable[[], bool], within_s: float = PATIENCE_S) -> bool:
    """Whether it did; where it did, the condition is asked no more."""
    end_s = time.monotonic() + within_s
    while time.monotonic() < end_s:
        if condition():
            return True
        time.sleep(0.002)
    return False


def rests(axes: FailingAxes) -> bool:
    """Whether it stands still, on its way or at its end."""
    before_mm = axes.at_mm
    time.sleep(0.1)
    return axes.at_mm == before_mm
