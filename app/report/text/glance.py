"""The first page of a result: the verdict, what to enter, what the tool keeps, the next key."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from enum import StrEnum

from app.evaluating.solution import SessionSolution, judge
from app.report.charts.bars import now_and_after
from app.report.text.correction import FRAME_WORDS, correction_table, sole_mistake_words
from app.report.text.printer import change_tables
from app.report.text.result import (
    bound_sentence,
    comparison_sentence,
    export_caution,
    judged_sentence,
)
from app.report.text.tables import paragraphs


class Done(StrEnum):
    """What was done on a result; what comes next depends on it."""

    DIAGNOSED = "diagnosed"
    EXPORTED = "exported"
    REPORTED = "reported"


WORTHLESS = "WARNING: not to be entered, the tool would not become clearly more accurate:"
SOUND = "Nothing to enter: the tool would not become clearly more accurate:"


def glance_text(
    result: SessionSolution,
    earlier: SessionSolution | None,
    actions: Collection[Done],
    columns: int,
    *,
    exports: bool,
    measures: bool,
) -> str:
    """All that an operator needs, for a page that is not scrolled; keys are ids in braces.

    ``earlier`` is the session that this one verifies.
    """
    machine, frame = result.sessions[-1].opened.machine, result.frame
    change, correction = result.printer_change, result.entered
    tolerance_mm = machine.tool_tolerance_mm
    bars = now_and_after(correction.now_mm, correction.bound_mm, tolerance_mm, columns)
    verdict = [] if earlier else [bound_sentence(correction, frame, tolerance_mm)]
    if tolerance_mm:
        verdict = [judged_sentence(judge(result, tolerance_mm), verified=earlier is not None)]
    views = (earlier and earlier.view_solution, result.view_solution)
    if views[0] and views[1]:
        verdict.append(comparison_sentence(views[0], views[1]))
    caution = export_caution(result) if Done.EXPORTED in actions else ""
    heading = "Add to the offsets in the controller:" if any(machine.entered_offsets_mm) else ""
    if not correction.helps:
        heading = SOUND if earlier else WORTHLESS
    return paragraphs(
        [*verdict, *_cautions(result), *([f"WARNING: {caution}"] if caution else [])],
        heading,
        *(change_tables(change) if change else [correction_table(result.correction)]),
        [f"Tool error, at most (95 %), r.m.s., {FRAME_WORDS[frame]}:", *bars],
        next_text(result, actions, exports=exports, measures=measures),
    )


def _cautions(result: SessionSolution) -> Iterator[str]:
    """A short line each; the pages behind say more."""
    yield from sole_mistake_words(result)
    if result.lacks_something:
        yield "WARNING: something is missing from the model. The bound allows for it."
    elif result.suspects:
        yield "WARNING: a reading does not fit its repeats. Details name it."


def next_text(
    result: SessionSolution, actions: Collection[Done], *, exports: bool, measures: bool
) -> str:
    """What to do next with this result; nothing where nothing can be done from here."""
    session = result.sessions[-1]
    if exports and not session.closed and session.next_step() is not None:
        return CONTINUE
    if result.lacks_something and not {*actions} - {Done.REPORTED}:
        return "Next: {result.diagnose} looks for what is missing from the model."
    if not exports:
        return ""
    if not result.entered.helps:
        leave = LEFT_AS_IT_IS if Done.REPORTED in actions else LEAVE_AS_IT_IS
        return f"Next: {MORE_THAN_OFFSETS if result.corrections.more_helps else leave}"
    if Done.EXPORTED in actions:
        then = AGAIN if measures else PRINT if Done.REPORTED in actions else REPORT
        return f"Next: enter the values in the controller; {then}"
    return "Next: {result.export} writes these values as files for the controller."


CONTINUE = "Next: measure the remaining steps. Home offers to continue this session."
AGAIN = "then {result.verify} measures again and compares."
REPORT = "{result.report} writes the report to sign."
PRINT = "print the report and sign it."
LEAVE_AS_IT_IS = f"change nothing in the controller; {REPORT}"
LEFT_AS_IT_IS = f"change nothing in the controller; {PRINT}"
MORE_THAN_OFFSETS = (
    "glidecal export --format writes what the controller can hold beside joint offsets. The "
    "tool becomes clearly more accurate."
)
