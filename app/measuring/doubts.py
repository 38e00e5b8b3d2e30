"""What is doubtful about readings just taken: the machine, the stand, the unit, a repeat."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

from app.measuring.gauges import Gauge
from drivers.profile import Fault, FaultKind, IndicatorReading, Outcome
from protocols.expectation import ExpectedReading, Movement, contradiction, movement
from protocols.procedure import Step
from protocols.session import (
    LARGEST_READING_MM,
    Event,
    Line,
    Noted,
    Reading,
    Session,
    Superseded,
    fold,
)


class Doubt(StrEnum):
    """Why a reading is questioned."""

    UNCHANGED = "unchanged"
    TOO_SOON = "taken too soon"
    BEYOND = "further off than expected"
    REPEATS = "other than its repeat"
    ODD = "the odd one of its repeats"
    STAND = "as on the set-up before"


QUESTIONED = "questioned: {}"
"""Why readings do not count, in the record, until their question is answered."""

HANDLED_MM = 0.2
"""A spindle that went further between two set-ups was set up; less is a table that is touched."""

UNMOVED_MM = 0.01
"""So much a stand that nobody touched may drift until the next leg is read."""


@dataclass(frozen=True)
class TakenStep:
    """What came of one take: the readings on the disk, or the faults that prevented it.

    With a ``doubt`` the ``questioned`` ones do not count until they are kept; ``due`` is what was
    expected. ``earlier`` are readings of another step that may be wrong instead, or the odd ones of
    three repeats.
    """

    step: Step
    readings: tuple[Reading, ...]
    faults: tuple[Fault, ...]
    due: tuple[ExpectedReading, ...] = ()
    doubt: Doubt | None = None
    earlier: tuple[Reading, ...] = ()

    @property
    def questioned(self) -> tuple[Reading, ...]:
        """The readings that wait for an answer, where there is a doubt."""
        return self.earlier if self.doubt is Doubt.ODD else self.readings


def plausible(outcome: Outcome, axis: str, resolution_before_mm: float | None) -> Outcome:
    """A fault for a reading too far off, or whose last digit means something else than before.

    That may be another unit.
    """
    if not isinstance(outcome, IndicatorReading):
        return outcome
    if abs(outcome.value_mm) > LARGEST_READING_MM:
        text = f"{outcome.value_mm:+.0f} mm is further than any indicator moves"
        return Fault(FaultKind.OVER_RANGE, outcome.text, text)
    if resolution_before_mm in (None, outcome.resolution_mm):
        return outcome
    now, previous = (
        f"{mm:.7f}".rstrip("0") for mm in (outcome.resolution_mm, resolution_before_mm)
    )
    text = (
        f"along {axis.upper()} it now shows steps of {now} mm, before {previous}: inch for mm? "
        "Set it back, or pause the session and continue it with this setting"
    )
    return Fault(FaultKind.WRONG_UNIT, outcome.text, text)


def examined(
    step_taken: TakenStep,
    record: Sequence[Event],
    session: Session,
    gauges: Sequence[Gauge],
    *,
    simulated: bool,
    controlled: bool,
) -> tuple[TakenStep, list[Line]]:
    """The readings with what is doubtful about them, and what to note behind them.

    ``record`` ends with the readings of the step, ``session`` has none of them. A
    ``simulated`` machine is where it was sent; of a ``controlled`` one its controller says so.
    """
    doubt: Doubt | None = None
    remarks: list[Line] = []
    if not simulated:
        doubt, remarks = _movement_doubt(step_taken, session, gauges, controlled=controlled)
    if doubt:
        earlier: tuple[Reading, ...] = ()
        if doubt is Doubt.UNCHANGED:  # or it was here early
            step_before = step_taken.due[0].previous.step
            earlier = tuple(r for r in session.readings if r.step and r.step == step_before)
        step_taken = replace(step_taken, doubt=doubt, earlier=earlier)
    elif step_taken.due:
        step_taken = _compared(step_taken, record)
    elif not simulated and (last := _unmoved_stand(step_taken, session, gauges)):
        step_taken = replace(step_taken, doubt=Doubt.STAND, earlier=last)
    if not step_taken.doubt:
        return step_taken, remarks
    numbers = tuple(r.reading for r in step_taken.questioned)
    question = Superseded(readings=numbers, reason=QUESTIONED.format(step_taken.doubt))
    return step_taken, [*(remarks if step_taken.doubt is Doubt.ODD else []), question]


def _movement_doubt(
    step_taken: TakenStep, session: Session, gauges: Sequence[Gauge], *, controlled: bool
) -> tuple[Doubt | None, list[Line]]:
    """Whether it is doubtful that the machine moved, and what to note where nothing tells."""
    step, due = step_taken.step, step_taken.due
    if not due:
        return None, []
    time_s = step_taken.readings[0].time_s or 0.0
    rests_mm = [gauges[number].rest_mm for number in step.indicators]
    moved = movement(step, due, [r.value_mm for r in step_taken.readings], rests_mm, time_s)
    if moved is Movement.UNCHANGED:
        return Doubt.UNCHANGED, []
    if moved is not Movement.UNKNOWN or controlled:
        return None, []
    if time_s < _arrival_s(step, due[0].previous, session):
        return Doubt.TOO_SOON, []
    word = f"step {step.number}: no reading can show a move here; the operator's word"
    return None, [Noted(text=word)]


def _arrival_s(step: Step, previous: Reading, session: Session) -> float:
    """When the machine can be there at the earliest, in time of the session."""
    way_mm = abs(step.displacement_mm - previous.displacement_mm)
    if step.position_mm and previous.position_mm:
        way_mm = math.dist(step.position_mm, previous.position_mm)
    fastest_mm_s = session.opened.machine.fastest_feed_mm_min / 60.0
    return (previous.time_s or 0.0) + way_mm / fastest_mm_s


def _unmoved_stand(
    step_taken: TakenStep, session: Session, gauges: Sequence[Gauge]
) -> tuple[Reading, ...]:
    """The last readings of the set-up before, where the first of a new one are the same.

    None where a spindle went far since: then somebody set it up, to the same zero.
    """
    counting, step = session.readings, step_taken.step
    elsewhere = [
        r for r in counting if r.set_up != step_taken.readings[0].set_up and r.step is not None
    ]
    elsewhere = [r for r in elsewhere if r.posture_mm == step.posture_mm]
    if not elsewhere:
        return ()
    last = tuple(r for r in elsewhere if r.step == elsewhere[-1].step)
    step_before = session.steps()[(last[0].step or 1) - 1]
    shown_mm = dict(zip(step_before.indicators, (r.value_mm for r in last), strict=False))
    stayed = counting[-1].step == step_before.number
    for number, reading in zip(step.indicators, step_taken.readings, strict=True):
        gauge = gauges[number]
        apart_mm = abs(reading.value_mm - shown_mm.get(number, math.inf))
        handled = stayed and gauge.travel_mm > HANDLED_MM
        if handled or apart_mm > gauge.rest_mm + UNMOVED_MM:
            return ()
    return last


def _compared(step_taken: TakenStep, record: Sequence[Event]) -> TakenStep:
    """The readings with a doubt where they disagree with others of the session that has them.

    Odd ones that were kept although the others settled it are not doubted again.
    """
    pairs = zip(step_taken.due, step_taken.readings, strict=True)
    beyond = any(due.is_beyond(reading.value_mm) for due, reading in pairs)
    disagreement = contradiction(fold(record), step_taken.readings, beyond=beyond)
    if disagreement is None:
        return step_taken
    doubt = Doubt.REPEATS if disagreement.repeats else Doubt.BEYOND
    if not disagreement.latest:
        if _asked_before(record) & {r.reading for r in disagreement.earlier}:
            return step_taken
        doubt = Doubt.ODD
    return replace(step_taken, doubt=doubt, earlier=disagreement.earlier)


def _asked_before(record: Sequence[Event]) -> set[int]:
    """Readings that were questioned as the odd ones: those that count were kept by the operator."""
    reason = QUESTIONED.format(Doubt.ODD)
    questions = (e for e in record if isinstance(e, Superseded) and e.reason == reason)
    return {number for question in questions for number in question.readings}
