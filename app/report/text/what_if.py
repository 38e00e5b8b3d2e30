"""What an effect of some size would do, as the screen says it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from app.evaluating.what_if import Choice, Trial, WhatIf
from app.report.text.correction import FRAME_WORDS, SUBSET_WORDS
from app.report.text.tables import (
    LEAST_MM,
    decimals,
    difference_words,
    expanded,
    new_table,
    paragraphs,
    signed,
    table_text,
    uncertain,
    wrapped,
)
from calib.identify.solution import Solution
from calib.quantity import Sizes

WHICH = "Which effect?"
WORKING = "Working out what it does …"
NOT_YET = "This size is not worked out yet."
NOTHING = "Nothing to adopt: the size is 0. {page.back} drops the effect."
NOTHING_TO_TRY = "These readings could show no effect, so there is none to try."
DIAGNOSE_FIRST = (
    "Not adopted: no diagnosis has looked at this effect, and others may fit as well. "
    "{result.diagnose} diagnoses; adopt it from there."
)
RESIZING = "Fitting everything else …"
RESIZED = "Model written: {}."
MISTAKES = (
    "WARNING: the readings hold mistakes that were named. Correct them first: {page.back}, "
    "{diagnose.adopt}."
)
STANDING = {
    "model": ", in the model",
    "named": ", named",
    "unnamed": ", the unnamed rest",
    "candidate": ", not named",
    "undiagnosed": "",
}


def choice_words(choice: Choice) -> str:
    """A line of the list of effects."""
    return (
        f"{choice.entry.id} ({choice.entry.where}){STANDING[choice.standing]}: {choice.entry.title}"
    )


def heading_text(choice: Choice, trial: Trial, model: Path | None) -> str:
    """What is tried, on which readings, beside what."""
    models = [f"model {model.name}"] if model else []
    models += [f"{entry.id} ({entry.where})" for entry in choice.beside]
    subject = f"{choice.entry.id} ({choice.entry.where})"
    names = ", ".join(session.name for session in trial.sessions)
    beside_words = f"   beside: {', '.join(models)}" if models else ""
    return f"What if {subject}   {names}{beside_words}"


def doubt_text(choice: Choice, *, mistakes: bool) -> str:
    """What to beware of; empty where there is nothing."""
    lines = [MISTAKES] if mistakes else []
    if choice.alike:
        alike = ", ".join(choice.alike)
        lines.append(f"WARNING: these readings cannot distinguish it from: {alike}.")
    return wrapped("\n".join(lines))


def sizes_text(sizes: Sizes, values: Sequence[float], number: int) -> str:
    """A line for each size: what it is now, what fits best, how far a key moves it."""
    table = new_table("", "size", "", "fits best", "step", left_columns=1)
    for k, (name, step) in enumerate(zip(sizes.names, sizes.steps, strict=True)):
        best = "not seen"
        if sizes.best:
            best = expanded(sizes.best[k], sizes.deviations[k])
        value = signed(values[k], decimals(step))
        mark = ">" if k == number else " "
        table.add_row(f"{mark} {name}", value, sizes.units[k], best, f"{step:g}")
    return "\n".join(filter(None, [table_text(table), wrapped(sizes.why_not)]))


def effect_text(without: WhatIf, now: WhatIf) -> str:
    """Residuals and tool, without the effect and with it."""
    table = new_table(f"tool: {FRAME_WORDS[now.trial.frame]}", "without", "with it")
    pair = without.solution, now.solution
    table.add_row("differences left, mm r.m.s.", *(uncertain(s.rms_after_mm, 4) for s in pair))
    table.add_row("readings left, times the noise", *map(_times, pair))
    table.add_row("tool, effect not compensated, mm r.m.s.", "0", _tool(now.tool_mm))
    table.add_row("tool, values without it entered, mm r.m.s.", "0", _tool(now.misled_mm))
    return table_text(table)


def _tool(error_mm: float) -> str:
    return uncertain(error_mm, 4) if error_mm > LEAST_MM else "0"


def _times(solution: Solution) -> str:
    fit = solution.lack_of_fit
    return f"{math.sqrt(fit.statistic):.2f}" if fit else "not known"


def numbers_text(without: WhatIf, now: WhatIf) -> str:
    """Parameters, then each difference."""
    former, solution = without.solution, now.solution
    table = new_table(SUBSET_WORDS[solution.subset], "without, mm", "with it, mm", "± U, mm")
    rows = (solution.names, former.values_mm, solution.values_mm, solution.expanded_mm)
    for name, value, value_at_size, half_mm in zip(*rows, strict=True):
        table.add_row(name, signed(value, 4), signed(value_at_size, 4), uncertain(half_mm, 4))
    differences = solution.differences
    listed = new_table("difference", "measured, mm", "without, mm", "with it, mm", "left, mm")
    for k in differences.published_rows:
        values = differences.value_mm[k], former.predicted_mm[k], solution.predicted_mm[k]
        residual_mm = solution.left_mm[k]
        listed.add_row(
            difference_words(differences.names[k]),
            *(signed(float(mm), 4) for mm in (*values, residual_mm)),
        )
    return paragraphs(table, listed)
