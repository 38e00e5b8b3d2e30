"""A solution in words and tables."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table

from app.evaluating.comparison import BothValues, Comparison, RemainingOffset, both_values
from app.evaluating.solution import SessionSolution
from app.report.text.caveats import (
    UNKNOWN_HOME_OFFSET,
    caveats,
    caveats_of_view,
    gauge_word,
    taken_word,
)
from app.report.text.correction import (
    FRAME_WORDS,
    SUBSET_WORDS,
    before_or_now,
    correction_table,
    value_parts,
)
from app.report.text.tables import (
    beside,
    decimals_for,
    difference_words,
    free_words,
    map_table,
    new_table,
    paragraphs,
    result_table,
    signed,
    table_text,
    uncertain,
)
from calib.identify.solution import SUBSETS, Difference, Estimate, Solution
from protocols.machine import Instrument
from protocols.session import Session

if TYPE_CHECKING:  # asked for by option only, and heavy
    from app.evaluating.comparison import Verification
    from app.evaluating.correction import SessionCorrection
    from app.evaluating.printer import PrinterChange
    from app.evaluating.solution import Judgement
    from calib.identify.monte_carlo import MonteCarlo
    from calib.tripod.workspace import PlaneMap
    from protocols.machine import Frame

BLIND_CONDITION = 1e12
"""Condition number from which on only rounding tells one combination of parameters."""


def solution_text(result: SessionSolution) -> str:
    """What to enter and what the tool keeps then; below it a set of the papers as a view."""
    remarks = [remark for session in result.sessions for remark in session.opened.remarks]
    for session in result.sessions:
        remarks += [*dict.fromkeys(session.notes), *left_out_words(session)]
    return paragraphs(
        *entered_parts(result),
        *view_parts(result),
        "\n".join(map(_measured_words, result.sessions)),
        *(f"Remark: {remark}" for remark in remarks),
    )


def entered_parts(result: SessionSolution) -> list[str | Table]:
    """The correction: values, the bound with them, what other exports would keep, cautions."""
    where = "firmware" if result.printer_change else "controller"
    head = (
        f"{', '.join(result.names)}: values to enter in the {where}, "
        f"{FRAME_WORDS[result.frame]}, {result.reading_count} {taken_word(result)}s"
    )
    parts = value_parts(result, correction_table(result.correction))
    return [head, *parts, "\n".join(caveats(result))]


def view_parts(result: SessionSolution) -> list[str | Table]:
    """One set of parameters as the papers identify it: a view, which is not what is entered."""
    if (solution := result.view_solution) is None:
        return [f"View: none. {result.choice.refused['joint-offsets']}"]
    return [
        f"View: {SUBSET_WORDS[solution.subset]}, {_method_words(solution)}",
        verdict_words(result),
        parameter_table(solution),
        result_table(Estimate, solution.effect_sizes, "fitted effect") if solution.sizes else "",
        "\n".join(caveats_of_view(result)),
        result_table(Difference, solution.tabulated, "difference"),
        subset_table(result),
        noise_words(result),
    ]


def left_out_words(session: Session) -> list[str]:
    """How many steps were left out and why; nothing where none was."""
    count, reasons = len(session.skipped), "; ".join(dict.fromkeys(session.skipped.values()))
    return [f"{count} step{'s' if count > 1 else ''} left out: {reasons}"] if count else []


def _measured_words(session: Session) -> str:
    """When a session was measured, by whom, how warm, and with which indicators."""
    opened = session.opened
    origin = [f"{session.name}: {opened.origin} {opened.at:%Y-%m-%d %H:%M %Z}"]
    origin += [f"measured on {opened.measured_on}"] if opened.measured_on else []
    origin += [f"by {opened.operator}"] if opened.operator else []
    origin += [] if opened.temperature_c is None else [f"at {opened.temperature_c:g} °C"]
    indicators = dict.fromkeys(map(indicator_words, opened.instruments))
    unnamed = "contacts" if session.of_contacts else "indicators not named"
    parts = [", ".join(indicators) or unnamed]
    if session.distances:
        count = len(session.distances)
        parts.append(f"{count} distance{'s' if count > 1 else ''} between marks")
    return "; ".join([" ".join(origin), *parts]) + "."


def indicator_words(instrument: Instrument) -> str:
    """Which indicator, and who calibrated it."""
    details = [f"no. {instrument.serial_number}"] if instrument.serial_number else []
    of = f"of {instrument.certificate_date}" if instrument.certificate_date else ""
    certificate = " ".join(filter(None, [instrument.certificate, of]))
    details += [f"certificate {certificate}"] if certificate else []
    return f"{instrument.profile} ({', '.join(details)})" if details else instrument.profile


def _method_words(solution: Solution) -> str:
    if solution.method == "exact":
        return "exact fit"
    if solution.weights == "covariance":
        return "linear system (11) weighted by covariance (14)"
    return "linear system (11), pseudoinverse as in the papers"


def verdict_words(result: SessionSolution) -> str:
    """How well the parameters of the view are known, and what that is at legs, a line each."""
    solution = result.solution
    return (
        f"{_known_words(result)}\n"
        f"{'Tool' if result.reads_tool else 'Leg'} deviations {solution.rms_before_mm:.4f} → "
        f"{solution.rms_after_mm:.4f} mm r.m.s."
    )


def _known_words(result: SessionSolution) -> str:
    """What is known to how much; of joint offsets often only how they differ from the bars."""
    solution = result.solution
    source = f"95 %, {taken_word(result)} noise only"
    if solution.subset == "with-tolerances":
        source = f"95 %, {taken_word(result)} noise and tolerances of the parts"
    elif solution.noise.source == "residuals":
        source = "95 %, residual taken as noise"
    width = uncertain(float(solution.expanded_with_tolerances_mm.max()))
    difference_mm = solution.expanded_of_difference_mm
    if difference_mm is not None:
        return (
            f"The readings determine d_rho − d_L to ±{uncertain(float(difference_mm.max()))} mm "
            f"({source}). A joint offset alone is uncertain by ±{width} mm, because each bar may "
            "be off within its tolerance."
        )
    is_whole = solution.subset in ("both", "with-tolerances")
    values = SUBSET_WORDS["both" if is_whole else solution.subset].capitalize()
    sentence = f"{values} are known to ±{width} mm"
    if is_whole:
        return f"{sentence} ({source})."
    noise = uncertain(float(solution.expanded_mm.max()))
    return (
        f"{sentence} (95 %) if the others are within their tolerances. Noise alone gives "
        f"±{noise} mm ({source})."
    )


def parameter_table(solution: Solution) -> Table:
    """Identified parameters with their uncertainties, and how much of these is noise."""
    table = new_table("parameter", "value, mm", "± U (95 %), mm", "of noise, mm")
    every_mm = solution.expanded_with_tolerances_mm
    rows = (solution.names, solution.values_mm, every_mm, solution.noise_expanded_mm)
    decimals = decimals_for(float(solution.expanded_mm.min()), 4)
    for name, value, expanded, noise in zip(*rows, strict=True):
        table.add_row(name, signed(value, decimals), uncertain(expanded, 4), uncertain(noise, 4))
    return table


def subset_table(result: SessionSolution) -> Table:
    """What each set of parameters leaves of the differences."""
    left = {
        subset: f"{solution.rms_after_mm:.4f}"
        for subset, solution in result.choice.solutions.items()
    }
    rows = ((SUBSET_WORDS[subset], left.get(subset, "left out")) for subset in SUBSETS)
    return new_table("set of parameters", "residual r.m.s., mm", rows=rows)


def noise_words(result: SessionSolution) -> str:
    """Where the noise figure comes from, and the parameters known least independently."""
    solution, noise = result.solution, result.noise
    mean = "" if noise.pooled else f" r.m.s. over the {gauge_word(result)}s"
    value, first, second = solution.strongest_correlation or (0.0, "", "")
    value_words = signed(value, 2)
    correlation = f"strongest correlation {value_words}, {first} and {second}."
    if float(value_words) == 0.0:
        correlation = "no correlation to state."
    step_mm = result.display_found_mm
    display = f"; display step {step_mm:g} mm, found in the values" if step_mm else ""
    return (
        f"Noise of a single {taken_word(result)} "
        f"{uncertain(noise.standard_deviation_mm, 4)} mm{mean}, "
        f"{_source_words(result)}{display}.\n"
        f"Coverage factor {solution.coverage_factor:.3f}; condition number "
        f"{_condition_words(solution.condition_number)}; {correlation}"
    )


def _condition_words(condition_number: float) -> str:
    """A condition number; of what is not seen at all only rounding is left, which has no digits."""
    if condition_number > BLIND_CONDITION:
        return f"beyond {BLIND_CONDITION:.0e}"
    return f"{condition_number:.1f}"


def _source_words(result: SessionSolution) -> str:
    noise = result.noise
    free = noise.degrees_of_freedom
    degrees = "" if math.isinf(free) else f", {free_words(free, noise.scatter_of_repeats[1])}"
    if noise.source == "repeats":
        return f"from repeats{degrees}"
    if noise.source == "residuals":
        return f"from the residuals{degrees}"
    if noise.repeated == "rounding":
        return f"mostly rounding of the display{degrees}"
    if noise.repeated == "equal":
        return "from resolution and repeatability as stated or seen in the digits"
    return f"from the {gauge_word(result)}'s stated resolution and repeatability"


def bound_sentence(
    correction: SessionCorrection | PrinterChange,
    frame: Frame,
    tolerance_mm: float | None,
    *,
    entered: bool = False,
) -> str:
    """What the tool keeps with the values to enter, and without; they may be ``entered`` since."""
    now, then = (beside(mm, tolerance_mm) for mm in (correction.now_mm, correction.bound_mm))
    begin = "Predicted with the" if entered else "With these"
    return (
        f"{begin} values entered{':' * entered} the tool is off by at most {then} mm r.m.s. over "
        f"the workspace (95 %), {FRAME_WORDS[frame]}; {before_or_now(entered)} by at most {now} mm."
    )


def judged_sentence(judged: Judgement, *, verified: bool, entered: bool = False) -> str:
    """The decision that heads a result: after a verification that of the machine as it is now.

    The values may be ``entered`` since.
    """
    if verified:
        return f"{judged.before.upper()}: tolerance {judged.tolerance_mm:g} mm, against the bound."
    return (
        f"{judged.after.upper()} with these values entered, {judged.before.upper()} "
        f"{before_or_now(entered)}: tolerance {judged.tolerance_mm:g} mm for the tool, r.m.s., "
        "against the bound."
    )


DECISION_RULE = (
    "Decision rule (ISO 14253-1). Pass: the 95 % upper bound of the error is within the tolerance. "
    "Fail: the expected error exceeds the tolerance by more than its expanded uncertainty (95 %). "
    "Otherwise undecided."
)


def judged_text(judged: Judgement) -> str:
    """Against the tolerance, with the guard band."""
    return paragraphs(
        f"Tool error, r.m.s., against the tolerance of {judged.tolerance_mm:g} mm: {judged.before} "
        f"now, {judged.after} with these values. {DECISION_RULE}"
    )


def maps_text(maps: tuple[PlaneMap, ...], frame: Frame) -> str:
    """Expected tool error in µm on planes through Zero."""
    with_these = f"with the values of this view, {FRAME_WORDS[frame]}"
    title = f"Expected tool error {with_these}, µm (–: beyond the joint limits)"
    return paragraphs(title, *(map_table(plane, lambda mm: f"{1000.0 * mm:.0f}") for plane in maps))


def monte_carlo_text(monte_carlo: MonteCarlo) -> str:
    """Stated against true uncertainty."""
    table = new_table("parameter", "stated u, mm", "true, mm", "95 % held")
    columns = (monte_carlo.stated_mm, monte_carlo.true_mm, monte_carlo.covered)
    for name, stated_mm, true, covered in zip(monte_carlo.names, *columns, strict=True):
        table.add_row(name, f"{stated_mm:.4f}", f"{true:.4f}", f"{covered:.1%}")
    return (
        f"{monte_carlo.sessions} simulated sessions, {monte_carlo.failed} "
        f"failed\n{table_text(table)}"
    )


def comparison_text(earlier: Solution, later: Solution, *, changed: bool = False) -> str:
    """The differences before and after entering the offsets, or a mechanical change."""
    pairs = both_values(earlier, later).items()
    rows = {difference_words(name): pair for name, pair in pairs}
    heading = "leg along axis" if any(" along " in name for name in rows) else "difference"
    table = result_table(BothValues, rows, heading)
    sentence = comparison_sentence(earlier, later)
    if changed:
        sentence = (
            sentence.partition(";")[0] + ".\nThe machine was mechanically changed between them."
        )
    return paragraphs(sentence, table)


def comparison_sentence(earlier: Solution, later: Solution) -> str:
    """One sentence on before and after, with what had been expected."""
    alone = earlier.subset == "joint-offsets"  # of a plate lengths are found with them
    of_tool = any("(" in name for name in earlier.differences.names)
    return (
        f"{'Tool' if of_tool else 'Leg'} deviations went from {earlier.rms_before_mm:.4f} to "
        f"{later.rms_before_mm:.4f} mm r.m.s.;\n{earlier.rms_after_mm:.4f} mm was expected"
        f"{'' if alone else ' with the lengths entered, too'}."
    )


WORKING_OUT = "Working out what to enter …"
WRITING_REPORT = "Writing the report …"
REPORT_WRITTEN = "Report written beside the session: {}. Open it in a browser, print and sign it."

WHICH_SET = "Which set of parameters? It is a view: the values to enter stay."


def result_heading(result: SessionSolution, path: Path, model: Path | None) -> str:
    """Which session, in which folder, on a line."""
    others_words = f" and {len(result.names) - 1} more" if len(result.names) > 1 else ""
    model_text = f"   with model {model.name}" if model else ""
    return f"{path.name}{others_words}   in {path.absolute().parent.name or '/'}{model_text}"


NO_PLAN = (
    "This session cannot be measured again from here: it is a table, or its ports are those of "
    "another computer."
)


def exported_text(folder: Path, paths: Sequence[Path]) -> str:
    """What was written; the folder without its path, which may be long, is beside the session."""
    names = ", ".join(path.name for path in paths)
    return f"Written to {folder.name}, beside the session: {names}"


def export_caution(result: SessionSolution) -> str:
    """What could not be known of an export; empty where nothing is to be said."""
    homed = result.sessions[0].opened.machine.home_at_mm() is not None
    return "" if homed else UNKNOWN_HOME_OFFSET


def comparison_report(comparison: Comparison) -> str:
    """Which sessions, what a reader must know, then the differences of both."""
    earlier, later = comparison.before, comparison.after
    return paragraphs(
        [f"before: {earlier.names[0]}", f"after:  {later.names[0]}"],
        *(f"Remark: {remark}" for remark in comparison.remarks),
        comparison_text(earlier.solution, later.solution, changed=comparison.changed),
    )


WRONG = {
    "not entered": "the old error is still there. Enter the offset, and home again.",
    "wrong sign": "twice the old error: it was entered with the wrong sign.",
    "something else": "neither 0 nor the old error. Was the machine changed mechanically?",
}


NOT_SHOWN = (
    "± U is as large as the offset, so the readings do not show whether it was entered. Measure "
    "more (glidecal plan)."
)


def verification_text(verification: Verification) -> str:
    """The decision first, then what was expected and found, then what to do."""
    earlier, later = verification.compared.before, verification.compared.after
    head = [f"before: {earlier.names[0]}", f"after:  {later.names[0]}"]
    return paragraphs(head, *verification_parts(verification))


def verification_parts(verification: Verification) -> list[str | Table]:
    """The decision, what was expected and found, what to do, what to know of the sessions."""
    expected_mm = verification.compared.before.entered.bound_mm
    return [
        f"{decided(verification)} At most {uncertain(expected_mm)} mm was expected.",
        offsets_table(verification),
        "\n".join(what_to_do(verification)),
        *(f"Remark: {remark}" for remark in verification.compared.remarks),
    ]


def offsets_table(verification: Verification) -> Table:
    """Joint offsets of both sessions, and whether they were entered."""
    return result_table(RemainingOffset, verification.offsets)


def decided(verification: Verification) -> str:
    """The decision in a sentence, with the figure that decides."""
    later = verification.compared.after
    off = beside(later.correction.now_mm, verification.tolerance_mm)
    figure = (
        f"the tool is off by at most {off} mm r.m.s. over the workspace (95 %), "
        f"{FRAME_WORDS[later.frame]}"
    )
    if verification.decision is None or verification.tolerance_mm is None:
        return (
            f"NOT JUDGED: {figure}. There is no --tolerance, and no tool_tolerance_mm in the "
            "machine file."
        )
    return (
        f"{verification.decision.upper()}: {figure}. Tolerance: {verification.tolerance_mm:g} mm."
    )


def what_to_do(verification: Verification) -> list[str]:
    """What went wrong at the controller, or in the model."""
    later = verification.compared.after
    wrong = {
        kind: [offset.name for offset in verification.offsets if offset.entered == kind]
        for kind in WRONG
    }
    lines = [f"{', '.join(names)}: {WRONG[kind]}" for kind, names in wrong.items() if names]
    hidden = [offset.name for offset in verification.offsets if offset.entered == "not shown"]
    if hidden and verification.decision != "pass":
        lines.append(f"{', '.join(hidden)}: {NOT_SHOWN}")
    if later.lacks_something:
        lines.append(f"Something is missing from the model: glidecal diagnose {later.names[0]}")
    if not lines and verification.decision in ("fail", "undecided"):
        lines.append(
            "The offsets are as expected. Measure more (glidecal plan), or fit the lengths too."
        )
    return lines
