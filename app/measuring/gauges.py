"""Indicators as the session sees them: live values, their state, takes; those that gave no value:
where their adapters are now, and whether the same ones answer; which spindle is which.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Literal

from app.measuring.indicators import adapter_at, check_request, indicator_words, port_of
from drivers.line import IndicatorLine
from drivers.profile import Fault, IndicatorReading, Outcome, Profile, Query
from protocols.machine import Instrument

SLOT_S, SLOTS = 0.25, 80
"""The strip chart covers so many moments of this length: 20 s."""

STALE_S = 1.0
LOST_S, LATE = 0.35, 1.6
"""While the machine moves an indicator is missed so soon, or after this many of its intervals."""

READINGS_IN_WINDOW = 2.5
"""A slow indicator must have given at least two readings before it can be called stable."""


class Motion(StrEnum):
    """What an indicator is doing, in one word."""

    WAITING = "waiting"
    MOVING = "moving"
    STABLE = "stable"
    STALE = "stale"
    FAULT = "fault"


@dataclass(frozen=True)
class Trace:
    """The last 20 s of one indicator.

    ``moments`` are slots of time, oldest first: how many ago, least and largest reading in mm.
    Readings that stay in a band like ``band_mm`` (lower and upper edge) count as at rest. All
    slots together are ``span_s``, 0 where they are no times.
    """

    moments: tuple[tuple[int, float, float], ...] = ()
    band_mm: tuple[float, float] = (0.0, 0.0)
    span_s: float = SLOT_S * SLOTS


@dataclass(frozen=True)
class Live:
    """One indicator now: last outcome, its age, the state word and its recent readings.

    The readings are gathered when they are asked for: a strip chart wants them more seldom.
    """

    outcome: Outcome | None
    age_s: float
    motion: Motion
    trace: Callable[[], Trace] = field(default=Trace, compare=False)


class Gauge:
    """One indicator on its line with the history that tells stable from moving.

    ``on_news`` is called in the thread of the line, not for what changes nothing.
    """

    def __init__(
        self,
        profile: Profile,
        port: str,
        query: Query,
        *,
        interval_s: float | None = None,
        window_s: float,
        tolerance_mm: float,
    ) -> None:
        self.profile = profile
        self.port = port
        pace_s = profile.interval_s if interval_s is None else interval_s
        self._window_s = max(window_s, READINGS_IN_WINDOW * pace_s)
        self._stale_s = max(STALE_S, READINGS_IN_WINDOW * pace_s)
        self._lost_s = max(LOST_S, LATE * pace_s)
        self._tolerance_mm = self._still_mm = tolerance_mm
        self._lock = threading.Lock()
        self._slot = 0.0
        self._flicker_mm = self._digit_mm = 0.0
        self._heard: deque[tuple[float, Outcome]] = deque()
        self._moments: deque[tuple[int, float, float]] = deque(maxlen=SLOTS)
        self._latest: Outcome | None = None
        self._pressed = self._rests = False
        self._lowest_mm, self._highest_mm = math.inf, -math.inf
        self.on_news: Callable[[], None] = lambda: None
        self.adapter = ""
        """The serial number of what is at the port, where it has one."""
        self._asked, self._interval_s = query, interval_s
        self._line = self._line_at(port)

    def _line_at(self, port: str) -> IndicatorLine:
        return IndicatorLine(
            self.profile,
            port,
            query=self._asked,
            interval_s=self._interval_s,
            listener=self.hear,
            on_button=self.press,
        )

    def start(self) -> None:
        """Open the port. Raises IndicatorError."""
        self._line.start()
        self.adapter = adapter_at(self.port)

    def go_on_at(self, port: str) -> None:
        """The indicator is at another port now. Raises IndicatorError where that does not open.

        Then it stays where it was. Raises UsageError as `check_request`.
        """
        check_request(self.profile, port)
        line = self._line_at(port)
        line.start()
        former_line, self._line, self.port = self._line, line, port
        self.adapter = adapter_at(port)
        former_line.close()
        self.restart_window()

    def close(self) -> None:
        """Close the port."""
        self._line.close()

    def hear(self, outcome: Outcome) -> None:
        """What the line tells, in the thread of the indicator."""
        now = time.monotonic()
        with self._lock:
            changes = not self._rests or outcome != self._latest
            if isinstance(outcome, IndicatorReading):
                self._digit_mm = outcome.resolution_mm
                # a last digit that flickers is not a movement
                self._still_mm = max(self._tolerance_mm, 1.001 * outcome.resolution_mm)
                self._remember(int(now / SLOT_S), outcome.value_mm)
            # the history holds one outcome in this time, so that that of a fast indicator stays
            # short
            if self._heard and now - self._slot < 0.02:
                self._heard[-1] = (now, outcome)
            else:
                self._slot = now
                self._heard.append((now, outcome))
                while len(self._heard) > 1 and now - self._heard[1][0] >= self._window_s:
                    self._heard.popleft()  # the one before the window stays: it was heard whole
            self._latest = outcome
        if changes:
            self.on_news()

    def _remember(self, slot: int, value_mm: float) -> None:
        """A reading for the strip chart, and for how far the spindle went."""
        self._lowest_mm = min(self._lowest_mm, value_mm)
        self._highest_mm = max(self._highest_mm, value_mm)
        low = high = value_mm
        if self._moments and self._moments[-1][0] == slot:
            _, low, high = self._moments.pop()
        self._moments.append((slot, min(low, value_mm), max(high, value_mm)))

    def press(self, _: Outcome) -> None:
        """Somebody pressed the DATA button. Called by the line, which knows what is a press."""
        self._pressed = True
        self.on_news()

    def button_pressed(self) -> bool:
        """Whether the DATA button or a foot switch was pressed since the last call."""
        pressed, self._pressed = self._pressed, False
        return pressed

    def restart_window(self) -> None:
        """Forget what was stable and what was pressed: the machine is about to move."""
        with self._lock:
            self._heard.clear()
            self._pressed = self._rests = False

    @property
    def travel_mm(self) -> float:
        """How far the spindle went since the last take; 0 where nothing was heard."""
        return max(0.0, self._highest_mm - self._lowest_mm)

    def forget_travel(self) -> None:
        """A reading was taken: the way of the spindle counts from here."""
        with self._lock:
            self._lowest_mm, self._highest_mm = math.inf, -math.inf

    @property
    def rest_mm(self) -> float:
        """How far two readings may differ while nothing moves.

        A digit, and twice the most that a stable window showed: a window is short.
        """
        return self._digit_mm + 2.0 * self._flicker_mm

    def live(self) -> Live:
        """The state now; safe from any thread."""
        with self._lock:
            outcomes = tuple(self._heard)
        now = time.monotonic()
        if not outcomes:
            age_s = now - self._slot if self._latest else 0.0
            return Live(self._latest, age_s, Motion.WAITING, self._trace)
        at, outcome = outcomes[-1]
        motion = self._motion(outcomes, now)
        self._rests = motion in (Motion.STABLE, Motion.FAULT)
        return Live(outcome, now - at, motion, self._trace)

    def lost(self, *, moving: bool = False) -> str | None:
        """Why there is no reading now: a fault, or silence that its pace does not explain."""
        live = self.live()
        if live.outcome is None:
            return "no answer yet"
        if isinstance(live.outcome, Fault):
            return live.outcome.words
        longest_s = self._lost_s if moving else self._stale_s
        return f"silent for {live.age_s:.1f} s" if live.age_s > longest_s else None

    def _trace(self) -> Trace:
        """What of the last 20 s there is, the band of rest about the latest window."""
        with self._lock:
            moments = tuple(self._moments)
        slot = int(time.monotonic() / SLOT_S)
        slots = tuple((slot - at, low, high) for at, low, high in moments if slot - at < SLOTS)
        within = [m for m in slots if m[0] * SLOT_S <= self._window_s] or slots[-1:]
        if not within:
            return Trace()
        low, high = min(m[1] for m in within), max(m[2] for m in within)
        if high - low > self._still_mm:  # it moves: about the latest reading
            low, high = within[-1][1:]
        middle = (low + high) / 2.0
        return Trace(slots, (middle - self._still_mm / 2.0, middle + self._still_mm / 2.0))

    def _motion(self, outcomes: Sequence[tuple[float, Outcome]], now: float) -> Motion:
        at, outcome = outcomes[-1]
        if isinstance(outcome, Fault):
            return Motion.FAULT
        if now - at > self._stale_s:
            return Motion.STALE
        within = sum(now - moment <= self._window_s for moment, _ in outcomes)
        # the one before, too: after a gap two that came at once may still be on their way
        recent = [o.value_mm for _, o in outcomes[-within - 1 :] if isinstance(o, IndicatorReading)]
        covered = now - outcomes[0][0] >= self._window_s
        several = within >= 2 and len(recent) >= 2
        span_mm = max(recent) - min(recent) if several else math.inf
        if not (covered and span_mm <= self._still_mm):
            return Motion.MOVING
        self._flicker_mm = max(self._flicker_mm, span_mm)
        return Motion.STABLE

    def ask(self) -> Future[Outcome]:
        """A fresh reading, taken after this call."""
        return self._line.ask()


@dataclass(frozen=True)
class LostNews:
    """News of one indicator, counted from 0: its ``fault``, and the port where its adapter is now.

    Without a fault it answers again; ``adapters`` are those before and now, where they differ.
    """

    number: int
    fault: Fault | None = None
    elsewhere: str | None = None
    adapters: tuple[str, str] | None = None


class LostIndicators:
    """``ports`` are where the adapters of lost indicators are, if not where they were."""

    def __init__(self, gauges: Sequence[Gauge]) -> None:
        self._gauges, self._looking, self._looked_s = gauges, threading.Lock(), 0.0
        self.ports: dict[int, str | None] = {}

    def is_due(self) -> bool:
        """Whether to look now: at once for what changed, from time to time for an adapter."""
        if self._looking.locked():
            return False
        outcomes = [gauge.live().outcome for gauge in self._gauges]
        changed = any(isinstance(o, Fault) is not (k in self.ports) for k, o in enumerate(outcomes))
        # while an indicator is lost the serial ports are looked at so often
        return changed or (bool(self.ports) and time.monotonic() - self._looked_s > 1.0)

    def look(self) -> list[LostNews]:
        """What changed since the last look. It takes as long as to list the ports."""
        with self._looking:
            self._looked_s = time.monotonic()
            return [news for k, gauge in enumerate(self._gauges) if (news := self._news(k, gauge))]

    def faults(self, numbers: Iterable[int]) -> list[LostNews]:
        """The indicators among these that are known to be lost, and give no value now either."""
        outcomes = [(k, self._gauges[k].live().outcome) for k in numbers if k in self.ports]
        return [LostNews(k, o, self.ports[k]) for k, o in outcomes if isinstance(o, Fault)]

    def _news(self, number: int, gauge: Gauge) -> LostNews | None:
        outcome = gauge.live().outcome
        if isinstance(outcome, Fault):
            where = port_of(gauge.adapter, gauge.port)
            if number in self.ports and self.ports[number] == where:
                return None
            self.ports[number] = where
            return LostNews(number, outcome, where)
        if number not in self.ports or not isinstance(outcome, IndicatorReading):
            return None
        del self.ports[number]
        adapter_before, now = gauge.adapter, adapter_at(gauge.port)
        if not adapter_before or now == adapter_before:
            return LostNews(number)
        gauge.adapter = now
        return LostNews(number, adapters=(adapter_before, now))


PUSH_MM = 0.2
"""A push is further than this: less is somebody who touches the table."""

ALONE = 3.0
"""The spindle that is pushed moves so many times as far as the other."""

HELD_S = 5.0
"""What stays away so long is no push: the stand was moved."""

PushedIn = Literal["larger", "smaller"]


class PushResult(StrEnum):
    """What the last push told."""

    NOTHING = "nothing yet"
    RIGHT = "the one that was asked for"
    OTHER = "another one"
    BOTH = "more than one"
    SIGN = "the other sign than stated"


@dataclass
class SpindleCheck:
    """Which spindle is asked for, and what was found.

    ``ways`` tells for each indicator, counted from 0, what its reading became when its spindle was
    pushed in; ``last`` the same of the last push, whichever it was.
    """

    instruments: tuple[Instrument, ...]
    ways: dict[int, PushedIn] = field(default_factory=dict)
    finding: PushResult = PushResult.NOTHING
    last: PushedIn = "larger"
    exchanged: bool = False
    _rest_mm: tuple[float, ...] = ()
    _away_mm: tuple[float, ...] = ()
    _moved_s: float = 0.0

    @property
    def ready(self) -> bool:
        """Whether it is known where the spindles rest: a push is noticed from then on."""
        return bool(self._rest_mm)

    @property
    def done(self) -> bool:
        """Whether each indicator was found where it was asked for."""
        return len(self.ways) == len(self.instruments)

    @property
    def number_due(self) -> int:
        """The indicator whose spindle is to be pushed next."""
        return next((k for k in range(len(self.instruments)) if k not in self.ways), 0)

    def look(self, states: Sequence[Live]) -> bool:
        """What the indicators show now. Returns whether a push came to its end."""
        outcomes = [live.outcome for live in states]
        values = tuple(
            outcome.value_mm for outcome in outcomes if isinstance(outcome, IndicatorReading)
        )
        if self.done or len(values) < len(outcomes):
            return False
        still = all(live.motion is Motion.STABLE for live in states)
        if not self._rest_mm:
            return self._at_rest(values)
        now_mm = [value - rest_mm for value, rest_mm in zip(values, self._rest_mm, strict=True)]
        pairs = zip(self._away_mm, now_mm, strict=True)
        self._away_mm = tuple(max(pair, key=abs) for pair in pairs)
        if not still:
            self._moved_s = time.monotonic()
            return False
        furthest = max(map(abs, self._away_mm))
        if furthest < PUSH_MM or time.monotonic() - self._moved_s > HELD_S:
            return self._at_rest(values)
        if max(map(abs, now_mm)) > furthest / 2.0:
            return False  # still held
        self._judge()
        self._at_rest(values)
        return True

    def _at_rest(self, values: tuple[float, ...]) -> bool:
        """Begin to count a push. Returns that none has ended."""
        self._rest_mm, self._away_mm = values, (0.0,) * len(values)
        return False

    def _judge(self) -> None:
        """What the push that has just ended tells."""
        sizes = [abs(away) for away in self._away_mm]
        moved = sizes.index(max(sizes))
        self.last = "larger" if self._away_mm[moved] > 0.0 else "smaller"
        if any(ALONE * size > sizes[moved] for k, size in enumerate(sizes) if k != moved):
            self.finding = PushResult.BOTH
        elif moved != self.number_due:
            self.finding = PushResult.OTHER
        elif self.instruments[moved].pushed_in not in (None, self.last):
            self.finding = PushResult.SIGN
        else:
            self.finding = PushResult.RIGHT
            self.ways[self.number_due] = self.last

    def exchange(self) -> None:
        """The hand was right, the ports are not: each indicator takes the axes of the other.

        From here on `look` wants their states in the other order.
        """
        first, second = self.instruments
        self.instruments = (
            second.model_copy(update={"axes": first.axes}),
            first.model_copy(update={"axes": second.axes}),
        )
        pushed, self.exchanged = self.number_due, not self.exchanged
        self.ways = {pushed: self.last}
        self.finding, self._rest_mm = PushResult.RIGHT, ()

    def remark(self) -> str:
        """What goes into the record."""
        parts = ["ports exchanged"] if self.exchanged else []
        for k, instrument in enumerate(self.instruments):
            way = self.ways.get(k)
            push_words = f"pushed by hand, read {way} pushed in" if way else "not pushed by hand"
            parts.append(f"{indicator_words(k, instrument)} {push_words}")
        return "before the first reading: " + "; ".join(parts)

    def known(self) -> tuple[Instrument, ...]:
        """The indicators in their order, with what the pushes told of their sign."""
        return tuple(
            instrument.model_copy(update={"pushed_in": self.ways.get(k, instrument.pushed_in)})
            for k, instrument in enumerate(self.instruments)
        )
