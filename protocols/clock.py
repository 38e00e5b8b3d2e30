"""The clock of a session, which nobody sets."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from itertools import pairwise

from protocols.documents import LONGEST_S
from protocols.session import Event, Reading

JUMP_S = 2.0
"""The wall clock follows a time server by less than this between two looks; more was set."""


def steady_s() -> float:
    """Seconds of a clock that only goes forward, also while the computer sleeps.

    The only monotonic clock of Windows does so by itself.
    """
    if sys.platform == "win32":
        return time.monotonic()
    return time.clock_gettime(getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC))


AWAY_S = 60.0
"""Where only one clock is to be had: a busy computer is not away for so long."""


class SleepWatch:
    """Tells sleep of the computer from a program that was held up."""

    def __init__(self) -> None:
        self._before = steady_s(), time.monotonic()

    def slept_s(self) -> float:
        """Seconds of sleep since the last look, 0 where there was none.

        Of two clocks only one stands still meanwhile. Windows has no such pair.
        """
        previous, self._before = self._before, (steady_s(), time.monotonic())
        steady, awake = (now - then for now, then in zip(self._before, previous, strict=True))
        if sys.platform == "win32":
            return steady if steady > AWAY_S else 0.0
        return steady - awake if steady - awake > JUMP_S else 0.0


BREAK_S = 3.2e7
"""A year: a longer break is a clock that was set, as of a computer that begins in 1970 each time
it is switched on."""


def wall() -> datetime:
    """What the clock of the computer shows."""
    return datetime.now(UTC)


class SessionClock:
    """Time of one session in the life of one program.

    Across an interruption only the wall clock knows how long it was; where that went back, or on by
    more than `BREAK_S`, the interruption counts nothing.
    """

    def __init__(
        self,
        events: Sequence[Event],
        steady_s: Callable[[], float] = steady_s,
        wall: Callable[[], datetime] = wall,
    ) -> None:
        self._steady_s = steady_s
        self.wall = wall
        self._began_s = steady_s() - _reached_s(events)
        self._ahead_s = self._wall_ahead_s()

    def time_s(self) -> float:
        """Seconds since the session began, as many as a record takes."""
        return min(self._steady_s() - self._began_s, LONGEST_S)

    def jump_s(self) -> float:
        """By how much the wall clock was set since the last look; 0 where it was not."""
        ahead_s = self._wall_ahead_s()
        jump_s, self._ahead_s = ahead_s - self._ahead_s, ahead_s
        return jump_s if abs(jump_s) > JUMP_S else 0.0

    def _wall_ahead_s(self) -> float:
        return self.wall().timestamp() - self._steady_s()


def _reached_s(events: Sequence[Event]) -> float:
    """Session time at the last event: of the last reading that has one, and the gaps since."""
    reached_s = 0.0
    for earlier, event in pairwise(events):
        gap_s = (event.at - earlier.at).total_seconds()
        reached_s += gap_s if 0.0 < gap_s < BREAK_S else 0.0
        if isinstance(event, Reading) and event.time_s is not None:
            reached_s = event.time_s
    return reached_s
