"""A port, its device and the time that passes on it: hours of a line in seconds."""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import cast

import serial

from drivers.exchange import Exchange
from drivers.port import SLICE_S
from drivers.profile import IndicatorReading, Outcome, Profile, Query, Spindle
from drivers.twins import IndicatorTwin

ROUND_S = 60.0
"""The spindle of the device shows the time in s as mm, and begins anew each minute."""

Delay = Callable[[float], float]
Stalled = Callable[[float], float | None]


@dataclass
class Wire:
    """``delay`` is how long the device takes for a line, in s, at a time; in order, as lines are.

    ``unasked`` gives the pauses between lines that nobody asked for; ``stalled`` says when what is
    sent at a time gets out, None for never. A port of pyserial, as far as an exchange needs one.
    """

    profile: Profile
    delay: Delay = lambda _: 0.002
    unasked: Iterator[float] | None = None
    stalled: Stalled = lambda at: at
    now_s: float = 0.0
    questions: int = 0
    dtr: bool = True

    def __post_init__(self) -> None:
        spindle = Spindle(lambda: self.now_s % ROUND_S, 0.001)
        self._twin = IndicatorTwin(self.profile, spindle)
        self._extra = IndicatorTwin(self.profile, spindle)
        self._request = self.profile.request(Query()) if self.profile.request else b""
        self.coming: deque[tuple[float, bytes]] = deque()
        self._here = b""
        if self.unasked is None and self.profile.stream_s:
            self.unasked = iter(lambda: self.profile.stream_s, None)
        self._next_s = next(self.unasked) if self.unasked else float("inf")
        self.presses: list[float] = []
        self.exchange = Exchange(
            self.profile,
            "wire",
            Query(),
            self.profile.interval_s,
            on_button=lambda _: self.presses.append(self.now_s),
            now=lambda: self.now_s,
            wait=self.wait,
            opener=lambda *_: cast(serial.Serial, self),
        )

    def wait(self, seconds: float) -> None:
        """Let time pass; the device goes on by itself."""
        until = self.now_s + seconds
        while self._next_s <= until:
            self.now_s = max(self.now_s, self._next_s)
            self.send(self._extra.receive(self._request))
            assert self.unasked is not None
            self._next_s = self.now_s + next(self.unasked, float("inf"))
        self.now_s = until

    def press(self) -> None:
        """The DATA button, now."""
        self.send(self._extra.receive(self._request))

    def send(self, line: bytes) -> None:
        out = self.stalled(self.now_s + self.delay(self.now_s))
        if line and out is not None:
            self.coming.append((max(out, self.coming[-1][0] if self.coming else 0.0), line))

    def write(self, request: bytes) -> None:
        self.questions += 1
        self.send(self._twin.receive(request))

    @property
    def in_waiting(self) -> int:
        while self.coming and self.coming[0][0] <= self.now_s:
            self._here += self.coming.popleft()[1]
        return len(self._here)

    def read(self, size: int) -> bytes:
        until = self.now_s + SLICE_S
        while self.in_waiting < size and self.now_s < until:
            following = min(self.coming[0][0] if self.coming else until, self._next_s, until)
            self.wait(max(0.0, following - self.now_s))
        content, self._here = self._here[:size], self._here[size:]
        return content


def age_s(reading: IndicatorReading, asked_s: float) -> float:
    """How long before the question the device read its spindle; negative: after it."""
    since = (asked_s - reading.value_mm) % ROUND_S
    return since if since < ROUND_S / 2 else since - ROUND_S


@dataclass
class Tally:
    """What came of asks: how many, answers, answers older than their question."""

    asks: int = 0
    questions: int = 0
    readings: int = 0
    stale: int = 0
    oldest_s: float = 0.0

    def count(self, wire: Wire, asks: int) -> set[str]:
        """So many asks on a wire; returns the kinds of the faults."""
        kinds = set()
        for _ in range(asks):
            start_s = wire.now_s
            outcome: Outcome = wire.exchange.checked_outcome()
            if isinstance(outcome, IndicatorReading):
                self.readings += 1
                age = age_s(outcome, start_s)
                self.oldest_s = max(self.oldest_s, age)
                self.stale += age > 0.001
            else:
                kinds.add(str(outcome.kind))
        self.asks += asks
        self.questions += wire.questions
        return kinds


def always(latency_s: float) -> Delay:
    return lambda _: latency_s


def jittered(chance: random.Random, low_s: float, high_s: float) -> Delay:
    return lambda _: chance.uniform(low_s, high_s)


def stalls(of_s: float, every_s: float, *, lost: bool = False) -> Stalled:
    """Nothing gets out in the first part of each period; what was sent then waits or is lost."""

    def stalled(at: float) -> float | None:
        since = at % every_s
        return at if since >= of_s else None if lost else at - since + of_s

    return stalled
