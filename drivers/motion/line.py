"""One controller and the thread that owns it; it stops the machine when this program dies."""

from __future__ import annotations

import contextlib
import queue
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from functools import partial

from drivers.motion.controller import Controller, ControllerFault, MotionFault, Triple

IDLE_S = 0.3
"""A machine that rests is looked at so often: who took control, is it still on?"""

Wish = tuple[Callable[[], Triple], Future[Triple]]
"""What the thread is to do, and where the position after it goes."""

BROKEN = (MotionFault.LOST, MotionFault.CONTROL_LOST, MotionFault.UNREACHABLE)
"""After these the next move begins with a new connection."""


class MotionLine:
    """Moves on request; every request is answered by a position, or by why there is none.

    ``listener`` is told in the thread of the line when a machine at rest is no longer what it was;
    ``fault`` says why until the next request.
    """

    def __init__(self, controller: Controller) -> None:
        self.controller = controller
        self.listener: Callable[[], None] = lambda: None
        self.fault: ControllerFault | None = None
        self._wishes: queue.SimpleQueue[Wish | None] = queue.SimpleQueue()
        self._thread = threading.Thread(
            target=self._own, name=f"motion {controller.address}", daemon=True
        )
        self._lock = threading.Lock()
        self._stops = 0
        self._broken = False
        self._guard: subprocess.Popen[bytes] | None = None

    def start(self) -> tuple[str, ...]:
        """What is right and who says so. Raises `ControllerFault` for a machine not ready."""
        try:
            self.controller.connect()
            said = self.controller.ready()
        except ControllerFault:
            self.controller.close()
            raise
        told = f"{self.controller.name}:{self.controller.address}"
        self._guard = subprocess.Popen(
            [sys.executable, "-m", "drivers.motion.guard", told],
            stdin=subprocess.PIPE,
            start_new_session=True,  # a key that ends this program must not end it, too
        )
        self._thread.start()
        return said

    def go(self, places_mm: Sequence[Triple], feed_mm_min: float) -> Future[Triple]:
        """Move to these places one after the other, each waited for."""
        return self._asked(partial(self._went, self._stops, tuple(places_mm), feed_mm_min))

    def at(self, place_mm: Triple) -> Future[Triple]:
        """The position now, where it is still this one and nothing else is wrong."""
        return self._asked(partial(self.controller.is_at, place_mm))

    def stop(self) -> None:
        """End all that was asked for so far, from any thread."""
        with self._lock:
            self._stops += 1
            self.controller.halt.set()

    def close(self) -> None:
        """Stop, end the thread and let go of the controller."""
        self.stop()
        self._wishes.put(None)
        if self._thread.is_alive():
            self._thread.join()
        self.controller.close()  # before: until then the guard may have to stop it
        if self._guard is not None and self._guard.stdin is not None:
            with contextlib.suppress(OSError):
                self._guard.stdin.write(b"bye\n")
                self._guard.stdin.close()
            self._guard.wait()
            self._guard = None

    def _asked(self, work: Callable[[], Triple]) -> Future[Triple]:
        answer: Future[Triple] = Future()
        self._wishes.put((work, answer))
        if not self._thread.is_alive():
            self._answer_nobody()
        return answer

    def _own(self) -> None:
        while True:
            try:
                wish = self._wishes.get(timeout=IDLE_S)
            except queue.Empty:
                self._look()
                continue
            if wish is None:
                break
            self.fault = None
            work, answer = wish
            try:
                there = work()
            except ControllerFault as problem:
                self._note(problem)
                answer.set_exception(problem)
            else:
                answer.set_result(there)
        self._answer_nobody()

    def _went(self, stops: int, places_mm: Sequence[Triple], feed_mm_min: float) -> Triple:
        """At the last place; a stop since ``stops`` of them were told ends it before it moves."""
        with self._lock:
            if stops != self._stops:
                raise self.controller.fault(MotionFault.STOPPED, "before it moved")
            self.controller.halt.clear()
        if self._broken:
            self.controller.close()
            self.controller.connect()
            self._broken = False
        self.controller.ready()
        for place_mm in places_mm:
            there = self.controller.move_to(place_mm, feed_mm_min)
        return there

    def _look(self) -> None:
        """At a machine that rests; what is wrong is told once."""
        if self.fault is None:
            try:
                self.controller.moves()
            except ControllerFault as problem:
                self._note(problem)
                self.listener()

    def _note(self, problem: ControllerFault) -> None:
        self.fault = problem
        self._broken = self._broken or problem.kind in BROKEN

    def _answer_nobody(self) -> None:
        """Whoever still waits gets a fault."""
        while True:
            try:
                waiting = self._wishes.get_nowait()
            except queue.Empty:
                return
            if waiting is not None:
                gone = self.controller.fault(MotionFault.LOST, "closed")
                waiting[1].set_exception(gone)
