"""A solution in words and tables."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from rich.table import Table

from app.solving import Solved
from app.wording.caveats import SUBSET_WORDS, caveats
from app.wording.tables import new_table, signed, table_text, wrapped
from calib.solution import SUBSETS, Solution


def solution_text(solved: Solved) -> str:
    """The whole result: the sentence that matters, warnings, then the tables."""
    solution = solved.solution
    parts = [
        wrapped(
            f"{', '.join(solved.names)}: {SUBSET_WORDS[solution.subset]}, "
            f"{method_words(solution)}, {solved.reading_count} readings"
        ),
        wrapped("\n".join([verdict(solved), *caveats(solved)])),
        table_text(parameter_table(solution)),
        table_text(difference_table(solution)),
        table_text(subset_table(solved)),
        wrapped(noise_words(solution)),
    ]
    remarks = [remark for session in solved.sessions for remark in session.opened.remarks]
    remarks += [skipped_words(s.skipped) for s in solved.sessions if s.skipped]
    return "\n\n".join([*parts, *(wrapped(f"Remark: {remark}") for remark in remarks)])


def skipped_words(skipped: Mapping[int, str]) -> str:
    """How many steps were left out, and why."""
    reasons = "; ".join(dict.fromkeys(skipped.values()))
    return f"{len(skipped)} step{'s' if len(skipped) > 1 else ''} left out: {reasons}"


def method_words(solution: Solution) -> str:
    """Which estimate this is."""
    if solution.method == "exact":
        return "exact fit"
    if solution.weights == "covariance":
        return "linear system (11) weighted by covariance (14)"
    return "linear system (11), pseudoinverse as in the papers"


def verdict(solved: Solved) -> str:
    """The first lines of a result."""
    solution = solved.solution
    expanded = float(solution.expanded_mm.max())
    before, after = solved.tool_before, solved.tool_after
    return (
        f"{SUBSET_WORDS[solution.subset].capitalize()} known to ±{expanded:.3f} mm "
        "(95 %, reading noise only).\n"
        f"Leg deviations {solution.rms_before_mm:.4f} → {solution.rms_after_mm:.4f} mm r.m.s.\n"
        f"Tool over the workspace: off by {before.rms_mm:.3f} mm r.m.s. now, "
        f"{after.rms_mm:.3f} mm expected with these values."
    )


def parameter_table(solution: Solution) -> Table:
    """Identified values with their uncertainties."""
    table = new_table("parameter", "value, mm", "± U (95 %), mm", "u, mm")
    rows = (solution.names, solution.values_mm, solution.expanded_mm, solution.uncertainty_mm)
    for name, value, expanded, u in zip(*rows, strict=True):
        table.add_row(name, signed(value, 4), f"{expanded:.4f}", f"{u:.4f}")
    return table


def difference_table(solution: Solution) -> Table:
    """The (up to) twelve differences with what the model predicts."""
    table = new_table("difference", "measured, mm", "predicted, mm", "left, mm")
    measured = solution.differences
    for k in measured.published_rows:
        value, predicted = float(measured.value_mm[k]), float(solution.predicted_mm[k])
        table.add_row(
            measured.names[k], signed(value), signed(predicted), signed(value - predicted)
        )
    return table


def subset_table(solved: Solved) -> Table:
    """What each set of parameters would leave, and its expected error at the tool."""
    table = new_table("set of parameters", "left, r.m.s.", "tool error", "")
    for subset in SUBSETS:
        if subset in solved.choice.solutions:
            left = f"{solved.choice.solutions[subset].rms_after_mm:.4f}"
            expected = f"{solved.choice.tool_error_mm[subset]:.3f}"
        else:
            left, expected = "not seen", ""
        mark = "recommended" if subset == solved.choice.recommended else ""
        table.add_row(SUBSET_WORDS[subset], left, expected, mark)
    return table


def noise_words(solution: Solution) -> str:
    """Where the noise figure comes from."""
    noise = solution.noise
    source = {
        "repeats": f"from repeats, {noise.degrees_of_freedom:g} degrees of freedom",
        "instrument": "from the indicator's stated resolution and repeatability",
        "residuals": f"from residuals, {noise.degrees_of_freedom:g} degrees of freedom",
    }[noise.source]
    return (
        f"Noise of a single reading {noise.standard_deviation_mm:.4f} mm, {source}.\n"
        f"Coverage factor {solution.coverage_factor:.3f}; condition number "
        f"{solution.condition_number:.1f}; {correlation_words(solution)}"
    )


def correlation_words(solution: Solution) -> str:
    """The two parameters that are known least independently."""
    u = solution.uncertainty_mm
    if len(u) < 2 or not u.all():
        return "no correlation to state."
    correlation = solution.covariance_mm2 / np.outer(u, u)
    np.fill_diagonal(correlation, 0.0)
    first, second = divmod(int(np.abs(correlation).argmax()), len(u))
    value = float(correlation[first, second])
    return (
        f"strongest correlation {value:+.2f}, {solution.names[first]} and {solution.names[second]}."
    )


def comparison_text(before: Solution, after: Solution) -> str:
    """The differences before and after entering the offsets."""
    table = new_table("difference", "before, mm", "after, mm")
    later = dict(zip(after.differences.names, after.differences.value_mm, strict=True))
    for k in before.differences.published_rows:
        name = before.differences.names[k]
        shown = signed(float(later[name])) if name in later else "not measured"
        table.add_row(name, signed(float(before.differences.value_mm[k])), shown)
    return f"{comparison_sentence(before, after)}\n\n{table_text(table)}"


def comparison_sentence(before: Solution, after: Solution) -> str:
    """Before and after in one sentence, with what had been expected."""
    return (
        f"Leg deviations went from {before.rms_before_mm:.4f} to {after.rms_before_mm:.4f} mm "
        f"r.m.s.;\n{before.rms_after_mm:.4f} mm was expected."
    )
