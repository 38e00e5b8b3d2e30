"""The events of a session folded into its state: what counts, what is done, what is next."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

from protocols.events import (
    Continued,
    Event,
    Mounted,
    Noted,
    Opened,
    Reading,
    Restored,
    Skipped,
    Superseded,
)
from protocols.procedure import Step

DECIMALS = re.compile(r"\d*\.(\d+)$", re.ASCII)


@dataclass(frozen=True)
class Session:
    """State of a session after its events.

    ``readings`` are those that count, in the order taken; ``superseded`` maps the numbers of the
    others to the reason, ``restored`` the numbers of those that count again, ``skipped`` the
    numbers of the steps that are left out; ``notes`` are the remarks made on the way.
    """

    opened: Opened
    readings: tuple[Reading, ...]
    superseded: dict[int, str]
    restored: dict[int, str]
    skipped: dict[int, str]
    all_readings: tuple[Reading, ...]
    mountings: tuple[Mounted, ...]
    stand_untouched: bool
    notes: tuple[str, ...] = ()

    def steps(self) -> tuple[Step, ...]:
        """The steps of the session's procedure; none for an imported table."""
        return self.opened.steps()

    def is_new_place(self, step: Step) -> bool:
        """Whether the stand must be set up for a step: another leg, station or axis."""
        last = self.mountings[-1] if self.mountings else None
        here = (step.leg, step.station, set(step.axes))
        return last is None or (last.leg, last.station, set(last.mounts)) != here

    def needs_new_zero(self, step: Step) -> bool:
        """Whether readings from here on belong to a new mounting: a new place, or after a break.

        Nobody knows what happened to stand and indicators while the program did not run.
        """
        return self.is_new_place(step) or not self.stand_untouched

    def done(self) -> frozenset[int]:
        """Numbers of the steps for which every axis has a reading that counts."""
        axes: dict[int, set[str]] = {}
        for reading in self.readings:
            if reading.step is not None:
                axes.setdefault(reading.step, set()).add(reading.axis)
        wanted = {step.number: set(step.axes) for step in self.steps()}
        return frozenset(n for n, found in axes.items() if found >= wanted.get(n, set("?")))

    def next_step(self) -> Step | None:
        """The first step that is neither done nor skipped."""
        settled = self.done() | self.skipped.keys()
        return next((step for step in self.steps() if step.number not in settled), None)

    @property
    def complete(self) -> bool:
        """Whether every step of the procedure has readings that count; none was skipped."""
        return self.done() >= {step.number for step in self.steps()}

    def time_goes_back(self) -> Reading | None:
        """The first reading with an earlier ``time_s`` than the one before: the clock was set."""
        timed = [(r.time_s, r) for r in self.all_readings if r.time_s is not None]
        return next((r for (a, _), (b, r) in pairwise(timed) if b < a), None)

    @property
    def step_mm(self) -> float | None:
        """The step in which the readings are written down: the finest decimal of any text."""
        found = (DECIMALS.search(reading.text) for reading in self.readings)
        decimals = [len(match[1]) for match in found if match]
        return 10.0 ** -max(decimals) if decimals else None


def fold(events: Iterable[Event]) -> Session:
    """The state after these events; the first one must be `Opened`."""
    opened: Opened | None = None
    readings: list[Reading] = []
    superseded: dict[int, str] = {}
    restored: dict[int, str] = {}
    skipped: dict[int, str] = {}
    mountings: list[Mounted] = []
    notes: list[str] = []
    stand_untouched = True
    for event in events:
        if isinstance(event, Opened):
            opened = event
        elif isinstance(event, Reading):
            readings.append(event)
        elif isinstance(event, Superseded):
            superseded |= dict.fromkeys(event.readings, event.reason)
            restored = _without(restored, event.readings)
        elif isinstance(event, Skipped):
            skipped |= dict.fromkeys(event.steps, event.reason)
        elif isinstance(event, Restored):
            superseded = _without(superseded, event.readings)
            restored |= dict.fromkeys(event.readings, event.reason)
            skipped = _without(skipped, event.steps)
        elif isinstance(event, Mounted):
            mountings.append(event)
            stand_untouched = True
        elif isinstance(event, Continued):
            stand_untouched = False
        elif isinstance(event, Noted):
            notes.append(event.text)
    assert opened is not None
    counting = tuple(r for r in readings if r.reading not in superseded)
    return Session(
        opened,
        counting,
        superseded,
        restored,
        skipped,
        tuple(readings),
        tuple(mountings),
        stand_untouched,
        tuple(notes),
    )


def _without(reasons: dict[int, str], numbers: tuple[int, ...]) -> dict[int, str]:
    return {number: reason for number, reason in reasons.items() if number not in numbers}
