"""The guided session: steps, indicators and record tied together; every face drives this."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from app.acquisition import Gauge
from drivers.outcome import Fault, FaultKind, Outcome
from drivers.outcome import Reading as IndicatorReading
from protocols.events import Faulted, Line, Mounted, Noted, Reading, Superseded
from protocols.journal import Journal
from protocols.procedure import Leg, Step, default_mount
from protocols.session import Session, fold


@dataclass(frozen=True)
class Taken:
    """What came of one take: the readings on the disk, or the faults that prevented it."""

    step: Step
    readings: tuple[Reading, ...]
    faults: tuple[Fault, ...]


LONGEST_MM = 1000.0
"""No indicator moves so far: a reading beyond is a fault of the device."""


def _plausible(outcome: Outcome) -> Outcome:
    if isinstance(outcome, IndicatorReading) and abs(outcome.value_mm) > LONGEST_MM:
        words = f"{outcome.value_mm:+.0f} mm is further than any indicator moves"
        return Fault(FaultKind.OVER_RANGE, outcome.text, words)
    return outcome


class GuidedSession:
    """One session being measured.

    ``go`` is called with each step before it is measured; a simulated machine moves then, with a
    real one it does nothing and the operator moves the machine. ``on_close`` frees the ports.
    """

    def __init__(
        self,
        journal: Journal,
        gauges: Sequence[Gauge],
        go: Callable[[Step], None],
        on_close: Callable[[], None],
    ) -> None:
        self._journal = journal
        self.gauges = tuple(gauges)
        self._go = go
        self._on_close = on_close
        self.session: Session = fold(journal.events)
        self.steps = self.session.steps()
        self._closed = False
        self._lock = threading.RLock()

    @property
    def path(self) -> Path:
        """The file of the record."""
        return self._journal.path

    @property
    def closed(self) -> bool:
        """Whether the record is finished or left and the ports are free."""
        return self._closed

    def step(self) -> Step | None:
        """The step to measure now; None when the procedure is done."""
        return self.session.next_step()

    def go(self) -> None:
        """Tell the machine, where it can be told, to move to the present step."""
        step = self.step()
        if step is not None:
            for gauge in self.gauges:
                gauge.restart_window()
            self._go(step)

    def take(self) -> Taken | None:
        """Read every indicator of the present step and write the readings to the disk.

        None when the procedure is done. Raises RecordError where the disk refuses; then nothing is
        taken.
        """
        with self._lock:
            step = self.step()
            return None if step is None or self._closed else self._take(step)

    def _take(self, step: Step) -> Taken:
        with ThreadPoolExecutor(len(step.axes)) as pool:
            asked = list(pool.map(Gauge.ask, self.gauges[: len(step.axes)]))
        outcomes = [_plausible(outcome) for outcome in asked]
        faults = tuple(outcome for outcome in outcomes if isinstance(outcome, Fault))
        events: list[Line] = []
        if faults:
            events += [
                Faulted(step=step.number, axis=axis, kind=outcome.kind, text=outcome.text)
                for axis, outcome in zip(step.axes, outcomes, strict=True)
                if isinstance(outcome, Fault)
            ]
            self._append(events)
            return Taken(step, (), faults)
        mounts, mounting = self._mounting(step)
        readings = self._readings(step, outcomes, mounts)
        self._append([*mounting, *self._supersede_leftovers(step), *readings])
        return Taken(step, readings, ())

    def undo(self, reason: str = "repeated by the operator") -> Step | None:
        """Supersede the readings of the last step taken; it becomes the present step again."""
        with self._lock:
            last = self.session.readings[-1] if self.session.readings else None
            if last is None:
                return None
            numbers = tuple(r.reading for r in self.session.readings if r.step == last.step)
            self._append([Superseded(readings=numbers, reason=reason)])
            return self.step()

    def remount(self) -> None:
        """The stand was moved: later readings of this place get a new zero."""
        with self._lock:
            step = self.step()
            if step is not None:
                self._append([self._new_mounting(step)])

    def note(self, text: str) -> None:
        """A remark for the record."""
        with self._lock:
            self._append([Noted(text=text)])

    def finish(self) -> None:
        """Close the record: complete if every step is done. Raises RecordError."""
        with self._lock:
            if not self._closed:
                self._journal.finish(complete=self.step() is None)
                self._release()

    def leave(self) -> None:
        """Stop for now; a take under way is given up, the session can be continued."""
        for gauge in self.gauges:
            gauge.close()
        with self._lock:
            if not self._closed:
                self._journal.close()
                self._release()

    def _release(self) -> None:
        self._closed = True
        self._on_close()

    def __enter__(self) -> GuidedSession:
        return self

    def __exit__(self, *_: object) -> None:
        self.leave()

    def _append(self, events: Sequence[Line]) -> None:
        self._journal.append(*events)
        self.session = fold(self._journal.events)

    def _mounting(self, step: Step) -> tuple[dict[Leg, str], list[Mounted]]:
        """Names of the mountings for this step, and the event where the stand is new."""
        if not self.session.needs_new_zero(step):
            return self.session.mountings[-1].mounts, []
        mounted = self._new_mounting(step)
        return mounted.mounts, [mounted]

    def _new_mounting(self, step: Step) -> Mounted:
        used = {name for mounted in self.session.mountings for name in mounted.mounts.values()}
        mounts: dict[Leg, str] = {}
        for axis in step.axes:
            base = name = default_mount(step.leg, axis, step.station)
            number = 2
            while name in used:
                name, number = f"{base}#{number}", number + 1
            mounts[axis] = name
        return Mounted(leg=step.leg, station=step.station, mounts=mounts)

    def _supersede_leftovers(self, step: Step) -> list[Superseded]:
        """A step cut off between its two readings is measured again as a whole."""
        numbers = tuple(r.reading for r in self.session.readings if r.step == step.number)
        return [Superseded(readings=numbers, reason="step was interrupted")] if numbers else []

    def _readings(
        self, step: Step, outcomes: Sequence[Outcome], mounts: dict[Leg, str]
    ) -> tuple[Reading, ...]:
        opened = self.session.opened
        elapsed = (datetime.now(UTC) - opened.at).total_seconds()
        first = len(self.session.all_readings) + 1
        return tuple(
            Reading(
                reading=first + offset,
                step=step.number,
                leg=step.leg,
                axis=axis,
                displacement_mm=step.displacement_mm,
                value_mm=outcome.value_mm,
                text=outcome.text,
                cycle=step.cycle,
                mount=mounts[axis],
                station=step.station,
                time_s=round(elapsed, 3),
                temperature_c=opened.temperature_c,
                resolution_mm=outcome.resolution_mm,
                unit_assumed=outcome.unit_assumed,
            )
            for offset, (axis, outcome) in enumerate(zip(step.axes, outcomes, strict=True))
            if isinstance(outcome, IndicatorReading)
        )
