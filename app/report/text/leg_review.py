"""A leg after its last step in words: whether its readings scatter as they usually do."""

from __future__ import annotations

from collections.abc import Sequence

from app.measuring.leg_review import LegReview, Usual, review_leg
from app.report.text.session import step_name
from app.report.text.tables import difference_words, new_table, paragraphs, signed
from calib.errors import GlidecalError
from calib.printable import with_capital
from protocols.procedure import Step
from protocols.session import Session


def leg_review_text(session: Session, step: Step, rests_mm: Sequence[float] = ()) -> str:
    """The review of the leg of a step, or why there is none."""
    try:
        return review_text(review_leg(session, step, rests_mm), session)
    except GlidecalError as problem:
        return str(problem)


def review_text(review: LegReview, session: Session) -> str:
    """A leg after its last step: repeatability beside the usual one, drift, differences.

    Keys in it are ids of bindings in braces.
    """
    table = new_table("axis", "scatter, mm", "repeats", "usual, mm", "return, mm")
    for along in review.axes:
        table.add_row(
            along.axis.upper(),
            "no repeats"
            if along.standard_deviation_mm is None
            else f"{along.standard_deviation_mm:.4f}",
            str(along.degrees_of_freedom),
            f"{along.usual_mm:.4f} {along.usual}",
            "" if along.worst_return_mm is None else signed(along.worst_return_mm, 4),
        )
    subject, wide, legend = f"Leg {review.leg.upper()}", 15, "leg along axis, "
    verdict = review_verdict(review, session)
    worst = verdict.startswith("WARNING:")  # on a line of its own: it stands out
    if review.leg == "tool":
        subject, wide, legend = "The plate", 22, ""
    cells = [
        f"{difference_words(name):<{wide}}{signed(value):>8}"
        for name, value in review.differences_mm
    ]
    rows = ["      ".join(cells[k : k + ACROSS]) for k in range(0, len(cells), ACROSS)]
    return paragraphs(
        *([f"✓ {subject} is done.", verdict] if worst else [f"✓ {subject} is done. {verdict}"]),
        table,
        [f"{len(cells)} differences so far, {legend}mm", *rows],
        ["{review.continue} continues, {measure.hold} holds, {measure.plot} shows the plot."],
    )


ACROSS = 2
"""Differences on a line: all twelve of a session fit into the smallest terminal."""

MORE_THAN_USUAL = 3.0
"""Scatter of so many times the usual one is worth a word."""

BESIDE = {
    Usual.STATED: "its indicator states",
    Usual.OTHERS: "the other legs do",
    Usual.AT_REST: "an indicator at rest",
}


def review_verdict(review: LegReview, session: Session) -> str:
    """Whether the scatter is as usual, in a sentence or two; which reading to look at."""
    worst = max(review.axes, key=lambda along: along.excess)
    if worst.excess > MORE_THAN_USUAL:
        much = f"{worst.excess:.0f} times as much as {BESIDE[worst.usual]}"
        warning = f"WARNING: readings along {worst.axis.upper()} scatter {much}."
        if worst.furthest is not None and worst.furthest.step:
            name = step_name(session.steps()[worst.furthest.step - 1], session)
            off = f"is {signed(worst.furthest_mm)} mm off its repeats"
            again = "{measure.hold} holds the session, then {measure.earlier} measures it again."
            warning += f" {with_capital(name)}, {off}: {again}"
        return warning
    if all(along.standard_deviation_mm is None for along in review.axes):
        return "Without repeats the scatter is not known."
    return "No scatter is suspicious."
