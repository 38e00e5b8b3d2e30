"""A session that a person attends: what a press leads to, what is taken unasked, what waits."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Sequence
from contextlib import suppress
from enum import StrEnum

from app.measuring.gauges import Live, Motion
from app.measuring.session import GuidedSession
from app.measuring.unattended import lost_words, release_lost
from protocols.expectation import Movement

GATHER_S = 0.015
"""One picture shows all that is heard within so long after the first news."""

IDLE_S = 5.0
IDLE_GATHER_S = 0.09
"""After so long of standing still only a last digit flickers: ten pictures a second are enough.

With GATHER_S alone waiting takes half as much again (`make bench` allows 5 % of a core).
"""

HELD_KEY_S = 0.15
"""Presses that follow this closely are one held key."""


class Press(StrEnum):
    """What a press of the key that takes readings leads to."""

    TAKES = "the readings are taken"
    ENDS = "every step is done"
    REPEATS = "a key that is held, or comes while readings are taken"
    ON_HOLD = "nothing is taken on hold"
    NOT_THERE = "the machine is not at the step"
    LACKS_VALUE = "one indicator of the step is in fault, another moves"
    MOVES = "the readings move: the next press takes them"


class TakenBy(StrEnum):
    """Who moves the machine and takes the readings of a step."""

    HAND = "by hand"
    INDICATORS = "automatic"
    CONTROLLER = "a controller"
    NOBODY = "a replay"


class AttendedSession:
    """How a person drives a session.

    ``automatic``: readings that moved are taken when they rest. ``on_hold``: nothing is taken.
    """

    def __init__(self, guided: GuidedSession) -> None:
        self.guided = guided
        self.automatic = guided.mover is not None
        self.on_hold = False
        self._waits: tuple[int, Movement] | None = None
        self._pressed_at = self._anyway_until = self._moved_at = 0.0
        self._motion: tuple[object, ...] | None = None

    @property
    def mode(self) -> str:
        """How steps are taken, in a word or two."""
        return "ON HOLD" if self.on_hold else "automatic" if self.automatic else "by hand"

    @property
    def taken_by(self) -> TakenBy:
        """Who takes the present step; a person where readings at rest cannot show the move."""
        step = self.guided.step()
        if self.guided.mover is not None:
            return TakenBy.CONTROLLER
        if step is not None and self._waits == (step.number, Movement.UNKNOWN):
            return TakenBy.HAND
        return TakenBy.INDICATORS if self.automatic else TakenBy.HAND

    def watch(self) -> None:
        """Tell the controller's thread that somebody looks, and look at the indicators.

        Both stop a machine that nobody watches. Raises RecordError.
        """
        mover = self.guided.mover
        if mover is None or self.guided.closed:
            return
        mover.line.alive()
        try:
            self.guided.note(*mover.watch())
        finally:
            if mover.line.may_move:
                lost_words(self.guided)
                release_lost(self.guided)

    async def news(self) -> AsyncIterator[None]:
        """Whenever a picture is due of what indicators and machine tell, one for all of it."""
        loop, news = asyncio.get_running_loop(), asyncio.Event()

        def tell() -> None:  # called in the thread of an indicator
            if not news.is_set():  # else the picture that is due shows it, too
                with suppress(RuntimeError):  # the loop has ended: nobody looks any more
                    loop.call_soon_threadsafe(news.set)

        for gauge in self.guided.gauges:
            gauge.on_news = tell
        if self.guided.mover is not None:
            self.guided.mover.on_news = tell
        while True:
            await news.wait()
            idle = time.monotonic() - self._moved_at > IDLE_S
            await asyncio.sleep(IDLE_GATHER_S if idle else GATHER_S)
            news.clear()
            yield

    def live(self, *, busy: bool = False) -> list[Live]:
        """What the indicators show now; pictures come faster while they move, or are ``busy``."""
        states = [gauge.live() for gauge in self.guided.gauges]
        if busy or any(live.motion is not Motion.STABLE for live in states):
            self._moved_at = time.monotonic()
        return states

    def ready_by_hand(self) -> bool:
        """Whether a single press takes: nothing moves, or there is a fault to be shown."""
        moving = (Motion.MOVING, Motion.WAITING)
        return all(live.motion not in moving for live in self._of_step(self.live()))

    def press(self, *, busy: bool) -> Press:
        """The key that takes was pressed, twice for readings that still move."""
        now, mover, step = time.monotonic(), self.guided.mover, self.guided.step()
        repeats, self._pressed_at = now - self._pressed_at < HELD_KEY_S, now
        if repeats or busy:
            return Press.REPEATS
        if self.on_hold:
            return Press.ON_HOLD
        if step is None:
            return Press.ENDS
        if mover is not None and not mover.is_there(step):
            return Press.NOT_THERE
        if now < self._anyway_until or self.ready_by_hand():
            return Press.TAKES
        lacks_value = any(live.motion is Motion.FAULT for live in self._of_step(self.live()))
        # how long a second press takes readings that still move
        self._anyway_until = 0.0 if lacks_value else now + 4.0
        return Press.LACKS_VALUE if lacks_value else Press.MOVES

    def waits_for_press(self) -> None:
        """A press of before leads to nothing any more."""
        self._anyway_until = 0.0

    def settled(self, states: Sequence[Live]) -> bool:
        """Whether what moved when the key was pressed rests now, once."""
        at_rest = all(live.motion is Motion.STABLE for live in states)
        if not self._anyway_until or not at_rest or not self.ready_by_hand():
            return False
        self._anyway_until = 0.0
        return True

    def by_itself(self, states: Sequence[Live]) -> Movement | None:
        """What readings at rest tell of a move, where they are taken without a press.

        What does not tell of one is returned once for each step.
        """
        at_rest = all(live.motion is Motion.STABLE for live in self._of_step(states))
        if not self.automatic or not at_rest:
            return None
        step, moved = self.guided.step(), self.guided.moved()
        if step is None or moved is Movement.CONFIRMED:
            return Movement.CONFIRMED
        if (step.number, moved) == self._waits:
            return None
        self._waits = step.number, moved
        return moved

    def hold(self, on_hold: bool, note: str) -> None:
        """Nothing is taken and nothing moves, or all goes on. Raises RecordError."""
        if on_hold and self.guided.mover is not None:
            self.guided.mover.release()
        self.guided.note(note)
        self.on_hold = on_hold

    def by_hand(self) -> None:
        """Nothing is taken, and nothing moves, without a key."""
        self.automatic = False
        if self.guided.mover is not None:
            self.guided.mover.release()

    def take_by_itself(self, automatic: bool) -> None:
        """What rests is taken without a press, or no longer."""
        self.automatic, self._waits = automatic, None

    def motion_changed(self) -> bool:
        """Whether a machine that moves itself does something else than at the last look."""
        mover, step = self.guided.mover, self.guided.step()
        if mover is None or step is None or self.guided.closed:  # leaving stops it, too
            return False
        asks, wrong = (proof.question, proof.wrong) if (proof := mover.unproved) else ("", "")
        arrived = mover.is_there(step)
        news = mover.state, mover.why, arrived, mover.line.not_stopped, mover.proving, asks, wrong
        previous, self._motion = self._motion, news
        return news != previous

    def _of_step(self, states: Sequence[Live]) -> Sequence[Live]:
        step = self.guided.step()
        return [states[k] for k in step.indicators] if step else states
