"""The guided session: steps, indicators and record tied together; every face drives this."""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from itertools import chain, count
from pathlib import Path

from app.measuring.doubts import Doubt, TakenStep, examined, plausible
from app.measuring.gauges import Gauge
from app.measuring.moving import Mover
from calib.errors import MotionError, UsageError
from calib.tripod.pipeline import StageEffect
from drivers.profile import Fault, IndicatorReading, Outcome
from protocols.clock import SessionClock
from protocols.expectation import ExpectedReading, Movement, expected, movement, since_last_repeat
from protocols.journal import Journal
from protocols.procedure import Leg, Step, default_mount
from protocols.session import (
    Changed,
    Event,
    Faulted,
    Line,
    Mounted,
    Moved,
    Noted,
    Reading,
    Restored,
    Session,
    Skipped,
    Superseded,
    fold,
)


@dataclass(frozen=True)
class Indicators:
    """Indicators that answer, and how to move the machine where that can be done.

    ``go`` is called with each step before it is measured and moves a simulated machine, ``turn`` a
    screw of it. Without, the operator moves the machine, so that only the readings tell of it, or
    the ``mover`` does, which is there or not.
    """

    gauges: tuple[Gauge, ...]
    go: Callable[[Step], None] | None = None
    close_bench: Callable[[], None] = lambda: None
    turn: Callable[[StageEffect, Step], None] | None = None
    mover: Mover | None = None

    def close(self) -> None:
        """Let go of a controller, close every port, then switch a simulated machine off."""
        if self.mover is not None:
            self.mover.line.close()
        for gauge in self.gauges:
            gauge.close()
        self.close_bench()


class GuidedSession:
    """One session being measured.

    ``clock`` gives ``time_s`` of the readings; by default it goes on from the record. ``motion``
    names the controller that the operator chose, if any.
    """

    def __init__(
        self,
        journal: Journal,
        indicators: Indicators,
        clock: SessionClock | None = None,
        motion: str | None = None,
    ) -> None:
        self._journal, self.motion = journal, motion
        self.gauges, self.mover = indicators.gauges, indicators.mover
        self.turn, self._go, self._on_close = indicators.turn, indicators.go, indicators.close
        self.session: Session = fold(journal.events)
        self.steps = self.session.steps()
        self._closed = False
        self._lock = threading.RLock()
        self.clock = clock or SessionClock(journal.events)
        self._untold_jump_s = 0.0
        self._digits_mm: dict[int, float] = {}
        self._due: tuple[Session, tuple[ExpectedReading, ...]] | None = None

    @property
    def path(self) -> Path:
        """The file of the record."""
        return self._journal.path

    @property
    def closed(self) -> bool:
        """Whether the record is finished or left and the ports are free."""
        return self._closed

    @property
    def there(self) -> bool:
        """Whether the machine is where this step is read, or nobody but the operator knows."""
        step = self.step()
        return self.mover is None or (step is not None and self.mover.is_there(step))

    def step(self) -> Step | None:
        """The step to measure now; None when the procedure is done."""
        return self.session.next_step()

    def name_of(self, number: int) -> str:
        """Words for an indicator, counted from 0: its number, profile and port."""
        gauge = self.gauges[number]
        return f"indicator {number + 1} ({gauge.profile.name}, {gauge.port})"

    def go(self) -> None:
        """Tell the machine, where it can be told, to move to the present step."""
        step = self.step()
        if step is not None:
            for gauge in self.gauges:
                gauge.restart_window()
            if self.mover is not None:
                self.mover.go(step, by_hand_first=self.session.needs_new_zero(step))
            elif self._go is not None:
                self._go(step)

    def take(self) -> TakenStep | None:
        """Read every indicator of the present step and write the readings to the disk.

        None when the procedure is done. Raises RecordError where the disk refuses; then nothing is
        taken.
        """
        with self._lock:
            step = self.step()
            return None if step is None or self._closed else self._take(step)

    def look_at_clock(self) -> float:
        """Seconds by which the computer's clock was set since the last call, 0 where it was not.

        It is noted in the record. Raises RecordError.
        """
        with self._lock:
            if not self._closed:
                self._mark_jump()
            jump_s, self._untold_jump_s = self._untold_jump_s, 0.0
            return jump_s

    def _mark_jump(self) -> None:
        jump_s = self.clock.jump_s()
        if jump_s:
            self._untold_jump_s += jump_s
            way = "forward" if jump_s > 0.0 else "back"
            text = f"the computer's clock was set {way} by {abs(jump_s):.0f} s; time_s goes on"
            self._append([Noted(text=text)])

    def _take(self, step: Step) -> TakenStep:
        self._mark_jump()
        self._where(step)
        queries = [self.gauges[number].ask() for number in step.indicators]
        outcomes = [
            self._plausible(number, axis, query.result())
            for number, axis, query in zip(step.indicators, step.axes, queries, strict=True)
        ]
        moved = self._where(step)  # as before the question
        faults, failed = [], []
        for number, axis, outcome in zip(step.indicators, step.axes, outcomes, strict=True):
            if isinstance(outcome, Fault):
                message = f"{self.name_of(number)}: {outcome.words}"
                faults.append(replace(outcome, words=message))
                kind, text = outcome.kind, outcome.text
                failed.append(Faulted(step=step.number, axis=axis, kind=kind, text=text))
        if faults:
            self._append(failed)
            return TakenStep(step, (), tuple(faults))
        mounted = [self._new_mounting(step)] if self.session.needs_new_zero(step) else []
        mounts = (mounted or self.session.mountings)[-1].mounts
        readings = self._readings(step, outcomes, mounts, moved)
        time_s = readings[0].time_s or 0.0
        due = expected(self.session, step, time_s)
        # a step cut off between its two readings is measured again as a whole
        leftovers = self._superseded((step.number,), "step was interrupted")
        events: list[Event] = [*mounted, *leftovers, *readings]
        step_taken, remarks = examined(
            TakenStep(step, readings, (), due),
            [*self._journal.events, *events],
            self.session,
            self.gauges,
            simulated=self._go is not None,
            controlled=self.mover is not None,
        )
        self._append([*events, *remarks])
        for gauge in self.gauges:
            gauge.forget_travel()
        self.moved()  # what is due next is worked out in this thread, not in that of the pictures
        return step_taken

    def _where(self, step: Step) -> Moved | None:
        """Where a machine that moves itself is; raises MotionError where that is elsewhere."""
        if self.mover is None:
            return None
        try:
            return self.mover.there(step)
        except MotionError as problem:
            self._append([Noted(text=f"step {step.number} not taken: {problem}")])
            raise

    def _plausible(self, number: int, axis: str, outcome: Outcome) -> Outcome:
        reading = plausible(outcome, axis, self._digits_mm.get(number))
        if isinstance(reading, IndicatorReading):
            self._digits_mm[number] = reading.resolution_mm
        return reading

    def moved(self) -> Movement:
        """Whether the indicators tell, as they stand now, that the machine moved to this step."""
        step = self.step()
        if self._go is not None or self.mover is not None or step is None:
            return Movement.CONFIRMED
        time_s = self.clock.time_s()
        if self._due is None or self._due[0] is not self.session:
            self._due = self.session, expected(self.session, step, time_s)
        outcomes = [self.gauges[number].live().outcome for number in step.indicators]
        values_mm = [o.value_mm for o in outcomes if isinstance(o, IndicatorReading)]
        if len(values_mm) < len(outcomes):
            return Movement.UNKNOWN
        rests_mm = [self.gauges[number].rest_mm for number in step.indicators]
        return movement(step, self._due[1], values_mm, rests_mm, time_s)

    def keep(self, step_taken: TakenStep, reason: str) -> None:
        """Questioned readings count after all."""
        numbers = tuple(r.reading for r in step_taken.questioned)
        self._append([Restored(readings=numbers, reason=reason)])

    def answer(self, answer: str, step_taken: TakenStep, reason: str) -> tuple[int, ...]:
        """What the operator says to readings in question; only "keep" lets them count.

        Returns the steps that are measured again for a new zero.
        """
        if answer == "keep":
            self.keep(step_taken, reason)
            return ()
        self.note(f"step {step_taken.step.number}: {reason}")
        if answer == "earlier":
            self.measure_earlier(step_taken, reason)
        return self.remount_since(reason) if answer == "stand" else ()

    def measure_earlier(self, step_taken: TakenStep, reason: str) -> None:
        """The new readings are right, the earlier ones wrong: their step becomes the next one."""
        if step_taken.doubt is Doubt.ODD:  # they count no more as it is
            return
        latest, earlier = (
            tuple(r.reading for r in readings)
            for readings in (step_taken.readings, step_taken.earlier)
        )
        right = Restored(readings=latest, reason=reason)
        self._append([right, Superseded(readings=earlier, reason=reason)])

    @property
    def last_step(self) -> int | None:
        """The number of the last step taken whose readings are valid."""
        return self.session.readings[-1].step if self.session.readings else None

    def begun_steps(self) -> list[Step]:
        """Steps that were read or skipped."""
        session = self.session
        numbers = {r.step for r in session.all_readings} | session.skipped.keys()
        return [step for step in self.steps if step.number in numbers]

    def why_superseded(self, number: int) -> str:
        """The reason why the last readings of a step, counted from 1, are not used."""
        last = max(r.reading for r in self.session.all_readings if r.step == number)
        return self.session.superseded[last]

    def undo(self, reason: str = "repeated by the operator") -> Step | None:
        """Supersede the readings of the last step taken; it becomes the present step again."""
        with self._lock:
            last = self.last_step
            return None if last is None else self.repeat(last, reason)

    def repeat(self, number: int, reason: str) -> Step | None:
        """Supersede the readings of a step so that it is measured again; returns the next step.

        Where the stand has left that mounting, readings of one step alone would have no zero:
        then every step of the mounting is measured again. The same for a step that was skipped.
        """
        with self._lock:
            steps = self.steps_repeated_with(number)
            skipped = tuple(n for n in steps if n in self.session.skipped)
            restored = [Restored(steps=skipped, reason=reason)] if skipped else []
            self._append([*self._superseded(steps, reason), *restored])
            return self.step()

    def steps_repeated_with(self, number: int) -> frozenset[int]:
        """Which steps must be measured again when this one is: itself, or its whole mounting."""
        mounts = {r.mount for r in self.session.readings if r.step == number}
        if not mounts:
            return self._brought_back_with(self.steps[number - 1])
        last = self.session.mountings[-1].mounts.values()
        if mounts <= set(last) and self.session.stand_untouched:
            return frozenset((number,))
        return self._taken_on(mounts)

    def _brought_back_with(self, step: Step) -> frozenset[int]:
        """Steps for one without readings: where the stand has left, its new mounting needs a Zero.

        A Zero that is still to come will do. Else what was measured there is measured again, or
        where all was skipped the Zeros of its cycle come back too.
        """
        alone = frozenset((step.number,))
        settled = self.session.done() | self.session.skipped.keys()
        steps = [s for s in self.steps if s.place == step.place]
        zeros = [s for s in steps if s.at_zero]
        coming = any(s.number not in settled for s in zeros)
        if coming or not self.session.needs_new_zero(step):
            return alone
        numbers = {s.number for s in steps}
        mounts = [r.mount for r in self.session.readings if r.step in numbers]
        if mounts:
            groups = (set(m.mounts.values()) for m in self.session.mountings)
            together = next((names for names in groups if mounts[-1] in names), {mounts[-1]})
            return self._taken_on(together) | alone
        return alone | {s.number for s in zeros if s.cycle == step.cycle}

    def _taken_on(self, mounts: Collection[str]) -> frozenset[int]:
        """Steps whose counting readings were taken on these mountings."""
        steps_taken = (r.step for r in self.session.readings if r.mount in mounts)
        return frozenset(number for number in steps_taken if number is not None)

    def rest_of_place(self) -> tuple[Step, ...]:
        """The present step and the unsettled ones that follow it on the same mounting."""
        step = self.step()
        settled = self.session.done() | self.session.skipped.keys()
        return tuple(
            s for s in self.steps if step and s.place == step.place and s.number not in settled
        )

    def restore(self, number: int, reason: str) -> bool:
        """Let the last superseded readings of a step count again, if it has none by now.

        Only while the stand is where it was. Returns whether there was anything to restore.
        """
        with self._lock:
            session = self.session
            step = next(step for step in self.steps if step.number == number)
            if any(r.step == number for r in session.readings) or not session.stand_untouched:
                return False
            mounts = set(session.mountings[-1].mounts.values()) if session.mountings else set()
            old = [r for r in session.all_readings if r.step == number and r.mount in mounts]
            last = tuple(r.reading for r in old[-len(step.axes) :])
            if not last:
                return False
            skipped = (number,) if number in session.skipped else ()
            self._append([Restored(readings=last, steps=skipped, reason=reason)])
            return True

    def skip(self, numbers: Sequence[int], reason: str) -> Step | None:
        """Leave steps out, with the reason; returns the next step.

        Readings that they have, such as one of an interrupted step, count no more.
        """
        with self._lock:
            skipped = Skipped(steps=tuple(numbers), reason=reason)
            self._append([*self._superseded(numbers, reason), skipped])
            return self.step()

    def remount(self) -> None:
        """The stand was moved: later readings of this place get a new zero."""
        with self._lock:
            step = self.step()
            if step is not None:
                self._append([self._new_mounting(step)])

    def remount_since(self, reason: str) -> tuple[int, ...]:
        """The stand has moved, nobody knows when: the steps that are measured again for it.

        They are those since the stand was last seen where it had been; all later readings get a
        new zero.
        """
        with self._lock:
            step = self.step()
            unsure = since_last_repeat(self.session)
            numbers = tuple(r.reading for r in unsure)
            events: list[Line] = [Superseded(readings=numbers, reason=reason)] if numbers else []
            self._append([*events, *([self._new_mounting(step)] if step else [])])
            return tuple(dict.fromkeys(r.step for r in unsure if r.step is not None))

    def change(self, change: Changed) -> None:
        """Parts of the machine were moved: every step is measured again, on new set-ups."""
        self._append([change])

    def watch(self, step: Step) -> None:
        """Tell a simulated machine to stand as for this set-up, which is no step of its own."""
        if self._go is not None:
            self._go(step)

    def go_on_at(self, number: int, port: str) -> None:
        """An indicator, counted from 0, is at another port now; noted in the record.

        Raises UsageError for the port of another indicator, as `Gauge.go_on_at`, and RecordError.
        """
        ports_beside = [gauge.port for k, gauge in enumerate(self.gauges) if k != number]
        if port in ports_beside:
            raise UsageError(f"port of indicator {number + 1}", port, "a port of its own")
        former_name = self.name_of(number)
        self.gauges[number].go_on_at(port)
        adapter = self.gauges[number].adapter
        adapter_words = f", adapter {adapter}" if adapter else ""
        self.note(f"{former_name} goes on at {port}{adapter_words}")

    def note(self, *texts: str) -> None:
        """Remarks for the record."""
        if texts:
            self._append([Noted(text=text) for text in texts])

    def finish(self) -> None:
        """Close the record: complete if every step is done. Raises RecordError."""
        with self._lock:
            if not self._closed:
                self._journal.finish(complete=self.session.complete)
                self._release()

    def leave(self) -> None:
        """Stop for now; a take under way is given up, the session can be continued.

        Raises RecordError where another program removed or changed the record.
        """
        if self.mover is not None:
            self.mover.stop("left", by_operator=True)
        for gauge in self.gauges:
            gauge.close()
        with self._lock:
            if not self._closed:
                try:
                    self._journal.close()
                finally:
                    self._release()

    def _release(self) -> None:
        self._closed = True
        self._on_close()

    def __enter__(self) -> GuidedSession:
        return self

    def __exit__(self, *_: object) -> None:
        self.leave()

    def _append(self, events: Sequence[Line]) -> None:
        with self._lock:
            self._journal.append(*events)
            self.session = fold(self._journal.events)

    def _new_mounting(self, step: Step) -> Mounted:
        names = {name for mounted in self.session.mountings for name in mounted.mounts.values()}
        mounts: dict[Leg, str] = {}
        for axis in step.axes:
            usual = default_mount(step.leg, axis, step.place[1])
            numbered = chain([usual], (f"{usual}#{number}" for number in count(2)))
            mounts[axis] = next(name for name in numbered if name not in names)
        over = step.over_plane or None
        return Mounted(leg=step.leg, station=step.station, mounts=mounts, over_plane=over)

    def _superseded(self, steps: Collection[int], reason: str) -> list[Superseded]:
        """What ends the counting of all readings of these steps, where there are any."""
        numbers = tuple(r.reading for r in self.session.readings if r.step in steps)
        return [Superseded(readings=numbers, reason=reason)] if numbers else []

    def _readings(
        self, step: Step, outcomes: Sequence[Outcome], mounts: dict[Leg, str], moved: Moved | None
    ) -> tuple[Reading, ...]:
        opened = self.session.opened
        time_s = round(self.clock.time_s(), 3)
        first = len(self.session.all_readings) + 1
        return tuple(
            Reading.of_step(
                step,
                axis,
                opened.procedure,
                reading=first + offset,
                value_mm=outcome.value_mm,
                text=outcome.text,
                mount=mounts[axis],
                moved=moved,
                time_s=time_s,
                temperature_c=opened.temperature_c,
                resolution_mm=outcome.resolution_mm,
                unit_assumed=outcome.unit_assumed,
            )
            for offset, (axis, outcome) in enumerate(zip(step.axes, outcomes, strict=True))
            if isinstance(outcome, IndicatorReading)
        )
