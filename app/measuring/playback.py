"""A record played again: what has been shown of it, how fast, and what the panels showed."""

from __future__ import annotations

import time
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial
from itertools import pairwise
from statistics import median

from app.measuring.gauges import SLOTS, Live, Motion, Trace
from calib.errors import UsageError
from drivers.profile import Fault, FaultKind, IndicatorReading
from protocols.machine import Instrument
from protocols.procedure import Leg, Step
from protocols.record import Record
from protocols.session import (
    DECIMALS,
    Closed,
    Event,
    Faulted,
    Mounted,
    Noted,
    Opened,
    Reading,
    Skipped,
    fold,
)

LONG_BREAK_S = 30.0
BREAK_S = 2.0
"""Play time of everything longer than LONG_BREAK_S: nobody wants to watch an interruption."""

SHORTEST_S = 1.0
"""Play time between moments that were recorded at once, so that each can be read."""


EVEN_S = 2.0
"""Play time between the readings of a record that knows no times."""


@dataclass(frozen=True)
class Frame:
    """Events shown at one moment.

    ``end`` is how many events of the record are shown then, ``time_s`` the play time at ×1.
    """

    events: tuple[Event, ...]
    end: int
    time_s: float


def frames_of(events: Sequence[Event]) -> tuple[Frame, ...]:
    """The moments of a record: readings of one step together, everything else by itself.

    Times are those of the events. Where a program wrote the events at once they are the
    ``time_s`` of the readings, or EVEN_S apart where these tell nothing.
    """
    groups = _groups(events)
    last_s: float | None = None
    frames: list[Frame] = []
    time_s, end = 0.0, 0
    for group, at_s in zip(groups, _times_s(groups), strict=True):
        if frames:
            time_s += _play_gap_s(group, at_s, last_s)
        last_s = at_s if at_s is not None else last_s
        end += len(group)
        frames.append(Frame(tuple(group), end, time_s))
    return tuple(frames)


def _groups(events: Sequence[Event]) -> list[list[Event]]:
    groups: list[list[Event]] = []
    for event in events:
        if groups and _together(groups[-1], event):
            groups[-1].append(event)
        else:
            groups.append([event])
    return groups


def _together(group: Sequence[Event], event: Event) -> bool:
    """Readings, or faults, of the axes of one step."""
    if not isinstance(event, Reading | Faulted) or event.step is None:
        return False
    return all(
        isinstance(earlier, type(event))
        and earlier.step == event.step
        and earlier.axis != event.axis
        for earlier in group
    )


def _times_s(groups: Sequence[Sequence[Event]]) -> Sequence[float | None]:
    """The time of each group in seconds; None where it has none of its own."""
    opened = groups[0][0]
    recorded_s = [(group[-1].at - opened.at).total_seconds() for group in groups]
    stated_s = [last.time_s if isinstance(last := g[-1], Reading) else None for g in groups]
    measured = isinstance(opened, Opened) and opened.origin == "measured"
    if measured or _apart(groups, recorded_s):
        return recorded_s
    return stated_s if _apart(groups, stated_s) else [None] * len(groups)


def _apart(groups: Sequence[Sequence[Event]], times_s: Sequence[float | None]) -> bool:
    """Whether the readings are as far apart in time as a person measures; all need a time."""
    of_readings = [
        t for group, t in zip(groups, times_s, strict=True) if isinstance(group[0], Reading)
    ]
    known_s = [time_s for time_s in of_readings if time_s is not None]
    if len(known_s) < max(len(of_readings), 2):
        return False
    # readings closer than this on the average were written by a program, not measured
    return (known_s[-1] - known_s[0]) / (len(known_s) - 1) >= 0.5


def _play_gap_s(group: Sequence[Event], at_s: float | None, last_s: float | None) -> float:
    """Play time before a group: as recorded, breaks cut short; set where nothing is known."""
    if at_s is None:
        return EVEN_S if isinstance(group[0], Reading) else SHORTEST_S
    gap_s = at_s - last_s if last_s is not None else SHORTEST_S
    return BREAK_S if gap_s > LONG_BREAK_S else max(gap_s, SHORTEST_S)


SPEEDS = (1, 2, 5, 10, 20, 50, 100)

FALLBACK_RESOLUTION_MM = 0.001


class PlaybackState(StrEnum):
    """What the replay is doing, in one word."""

    PLAYING = "PLAYING"
    PAUSED = "PAUSED"
    END = "END"


class Playback:
    """One record and a place in it.

    Moving by hand pauses. A table has one step for each reading. Raises RecordError or UsageError
    where the procedure of the record cannot be followed.
    """

    def __init__(self, record: Record) -> None:
        self.record = record
        self.is_table = record.opened.procedure is None
        self.frames = frames_of(record.events)
        self._events = _numbered(record.events) if self.is_table else record.events
        self.steps = (
            _table_steps(self._events) if self.is_table else fold(record.events[:1]).steps()
        )
        self._by_number = {step.number: step for step in self.steps}
        self._speed = SPEEDS.index(_first_speed([frame.time_s for frame in self.frames]))
        self.time_s = 0.0  # play time at ×1 since the first event
        self._ticked_s = time.monotonic()
        self.go(0)

    @property
    def position(self) -> int:
        """How many events are shown; never less than the first one."""
        return self.frame.end

    @property
    def speed(self) -> int:
        """How many seconds of the record pass in one."""
        return SPEEDS[self._speed]

    @property
    def state(self) -> PlaybackState:
        """Playing, paused, or at the end."""
        if self.at_end:
            return PlaybackState.END
        return PlaybackState.PLAYING if self._playing else PlaybackState.PAUSED

    @property
    def at_end(self) -> bool:
        """Whether every event is shown."""
        return self._frame == len(self.frames) - 1

    @property
    def instruments(self) -> tuple[Instrument | None, ...]:
        """One for each panel that the picture needs; None where the record names fewer."""
        count = max((step.indicators.stop for step in self.steps), default=1)
        return (*self.record.opened.instruments, None, None)[:count]

    def toggle(self) -> None:
        """Play or pause; at the end play from the start."""
        if self.at_end:
            self.go(0)
            self._playing = not self.at_end
        else:
            self._playing = not self._playing

    def pause(self) -> None:
        """Stand still."""
        self._playing = False

    def faster(self, by: int = 1) -> None:
        """So many speeds up; down where negative."""
        self._speed = min(max(self._speed + by, 0), len(SPEEDS) - 1)

    def advance(self, elapsed_s: float) -> bool:
        """Let time pass. Returns whether other events are shown now."""
        if not self._playing:
            return False
        self.time_s = min(self.time_s + max(elapsed_s, 0.0) * self.speed, self.frames[-1].time_s)
        frame = bisect_right(self.frames, self.time_s, key=lambda frame: frame.time_s) - 1
        if frame == self._frame:
            return False
        self._show(frame)
        self._playing = not self.at_end
        return True

    def tick(self) -> bool:
        """Let the time pass since the last tick, as `advance`."""
        last_s, self._ticked_s = self._ticked_s, time.monotonic()
        return self.advance(self._ticked_s - last_s)

    def step(self, by: int) -> None:
        """So many moments on; back where negative."""
        self.go(self._frame + by)

    def jump_to(self, text: str) -> None:
        """Jump to when a step was first taken, or skipped; in a table to a reading.

        Raises UsageError where it was never reached, or the text is no number.
        """
        try:
            number = int(text)
        except ValueError as problem:
            raise UsageError(self.unit, repr(text), "a whole number") from problem
        place = next(
            (k for k, frame in enumerate(self.frames) if self._settles(frame, number)), None
        )
        if place is None:
            last = self.steps[-1].number if self.steps else 0
            never = f"{number}, which was never taken" if 1 <= number <= last else str(number)
            raise UsageError(self.unit, never, f"1 … {last}, as far as the record goes")
        self.go(place)

    @property
    def unit(self) -> str:
        """What the steps are called."""
        return "reading" if self.is_table else "step"

    def _settles(self, frame: Frame, number: int) -> bool:
        first = frame.events[0]
        if isinstance(first, Reading):
            return number == (first.reading if self.is_table else first.step)
        return isinstance(first, Skipped) and number in first.steps

    def go(self, frame: int) -> None:
        """Go to one of the frames, or as far as there are any."""
        self._show(min(max(frame, 0), len(self.frames) - 1))
        self.time_s = self.frame.time_s
        self._playing = False

    def _show(self, frame: int) -> None:
        """``session`` is that after the events shown, as `fold` gives it.

        ``shown`` is the one for the picture: steps known, also of a table; with its mounting.
        """
        self._frame = frame
        self.session = fold(self.record.events[: self.position])
        session = fold(self._events[: self.position]) if self.is_table else self.session
        if not session.mountings and session.all_readings:
            session = replace(session, mountings=(_mounting(session.all_readings),))
        self.shown = replace(session, known_steps=self.steps)

    @property
    def now(self) -> Step | None:
        """The step just taken; after anything else that changes the order, the one to take."""
        events = reversed(self._events[: self.position])
        last = next(event for event in events if not isinstance(event, Noted | Closed))
        if isinstance(last, Reading | Faulted) and last.step in self._by_number:
            return self._by_number[last.step]
        return self.shown.next_step() or (self.steps[-1] if self.steps else None)

    @property
    def frame(self) -> Frame:
        """The moment that is shown."""
        return self.frames[self._frame]

    @property
    def place(self) -> str:
        """Which step is shown, out of how many."""
        now = self.now
        return f"{self.unit} {now.number if now else 0} of {len(self.steps)}"

    @property
    def live(self) -> list[Live]:
        """What each indicator of the present step showed when it was read, and before."""
        now = self.now
        axes = now.axes if now else ()
        mounts = self._mounts(now) if now else {}
        live_values = [self._fault(axis) or self._live(axis, mounts.get(axis)) for axis in axes]
        waiting = Live(None, 0.0, Motion.WAITING)
        displays = [waiting] * (now.first if now else 0) + live_values
        return displays + [waiting] * (len(self.instruments) - len(displays))

    def _mounts(self, step: Step) -> dict[Leg, str]:
        """The present mounting of each axis; none where the stand is not at this step."""
        last = self.shown.mountings[-1] if self.shown.mountings else None
        here = last is not None and last.place[:2] == step.place[:2]
        return last.mounts if last is not None and here else {}

    def _live(self, axis: Leg, mount: str | None) -> Live:
        readings = [r for r in self.shown.all_readings if r.axis == axis and r.mount == mount]
        if not readings:
            return Live(None, 0.0, Motion.WAITING)
        last_readings = readings[-SLOTS:]
        moments = tuple(
            (len(last_readings) - k, r.value_mm, r.value_mm) for k, r in enumerate(last_readings, 1)
        )
        # line numbers count events from 1
        shown_in = bisect_left(self.frames, readings[-1].line, key=lambda frame: frame.end)
        age_s = self.time_s - self.frames[shown_in].time_s
        trace = partial(Trace, moments, span_s=0.0)
        return Live(_outcome(readings[-1]), age_s, Motion.STABLE, trace)

    def _fault(self, axis: Leg) -> Live | None:
        """The fault of this axis if the take shown last failed."""
        for event in self.frame.events:
            if isinstance(event, Faulted) and event.axis == axis:
                is_known = event.kind in list(FaultKind)
                kind = FaultKind(event.kind) if is_known else FaultKind.NOT_UNDERSTOOD
                fault = Fault(kind, event.text, event.kind)
                return Live(fault, self.time_s - self.frame.time_s, Motion.FAULT)
        return None


def _first_speed(times_s: Sequence[float]) -> int:
    """The highest speed at which a typical moment still stays for SHORTEST_S."""
    gaps_s = [later - earlier for earlier, later in pairwise(times_s)]
    typical_s = median(gaps_s) if gaps_s else SHORTEST_S
    return max((s for s in SPEEDS if typical_s / s >= SHORTEST_S), default=SPEEDS[0])


def _numbered(events: Sequence[Event]) -> tuple[Event, ...]:
    """The events of a table, each reading as a step of its own."""
    return tuple(
        event.model_copy(update={"step": event.reading}) if isinstance(event, Reading) else event
        for event in events
    )


def _table_steps(events: Sequence[Event]) -> tuple[Step, ...]:
    return tuple(
        Step(
            r.reading,
            r.leg,
            r.displacement_mm,
            r.cycle,
            r.station,
            (r.axis,),
            r.position_mm,
            bool(r.over_plane),
        )
        for r in events
        if isinstance(r, Reading)
    )


def _mounting(readings: Sequence[Reading]) -> Mounted:
    """The mounting that the last readings stand for, where the record has no event of it."""
    last = readings[-1]
    together = [r for r in readings[-2:] if r.step == last.step and r.station == last.station]
    mounts = {r.axis: r.mount for r in together}
    return Mounted(leg=last.leg, station=last.station, mounts=mounts, over_plane=last.over_plane)


def _outcome(reading: Reading) -> IndicatorReading:
    """What the indicator said; the resolution from the text where the record does not state it."""
    decimals = DECIMALS.search(reading.text)
    shown_mm = 10.0 ** -len(decimals[1]) if decimals else FALLBACK_RESOLUTION_MM
    return IndicatorReading(
        text=reading.text,
        value_mm=reading.value_mm,
        resolution_mm=reading.resolution_mm or shown_mm,
        unit_assumed=reading.unit_assumed,
    )
