"""A solution in words and tables."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from app.evaluating.comparison import Comparison
from app.evaluating.solution import SessionSolution
from app.report.text.caveats import SUBSET_WORDS, UNKNOWN_HOME_OFFSET, caveats
from app.report.text.tables import decimals_for, new_table, signed, table_text, uncertain, wrapped
from calib.identify.accuracy import ToolError
from calib.identify.solution import SUBSETS, Solution
from calib.noise.reading import Noise
from protocols.machine import Instrument
from protocols.session import Session

if TYPE_CHECKING:  # asked for by option only, and heavy
    from app.evaluating.accuracy import Judgement
    from app.evaluating.verification import Verification
    from calib.identify.accuracy import ToolMap
    from calib.identify.monte_carlo import MonteCarlo


def solution_text(solved: SessionSolution) -> str:
    """The whole result: the sentence that matters, warnings, then the tables."""
    solution = solved.solution
    parts = [
        wrapped(
            f"{', '.join(solved.names)}: {SUBSET_WORDS[solution.subset]}, "
            f"{_method_words(solution)}, {solved.reading_count} readings"
        ),
        wrapped("\n".join([_verdict(solved), *caveats(solved)])),
        _parameter_table(solution),
        *([_size_table(solution)] if solution.sizes else []),
        _difference_table(solution),
        _subset_table(solved),
        wrapped(_noise_words(solution)),
    ]
    parts.append(wrapped("\n".join(map(_measured_words, solved.names, solved.sessions))))
    remarks = [remark for session in solved.sessions for remark in session.opened.remarks]
    for session in solved.sessions:
        remarks += dict.fromkeys(session.notes)
        if count := len(session.skipped):
            reasons = "; ".join(dict.fromkeys(session.skipped.values()))
            remarks.append(f"{count} step{'s' if count > 1 else ''} left out: {reasons}")
    return "\n\n".join([*parts, *(wrapped(f"Remark: {remark}") for remark in remarks)])


def _measured_words(name: str, session: Session) -> str:
    """When a session was measured, by whom, how warm, and with which indicators."""
    opened = session.opened
    words = [f"{name}: {opened.origin} {opened.at:%Y-%m-%d %H:%M %Z}"]
    words += [f"by {opened.operator}"] if opened.operator else []
    words += [] if opened.temperature_c is None else [f"at {opened.temperature_c:g} °C"]
    indicators = dict.fromkeys(map(_indicator_words, opened.instruments))
    return f"{' '.join(words)}; {', '.join(indicators) or 'indicators not named'}."


def _indicator_words(one: Instrument) -> str:
    known = [f"no. {one.serial_number}"] if one.serial_number else []
    of = f"of {one.certificate_date}" if one.certificate_date else ""
    certificate = " ".join(filter(None, [one.certificate, of]))
    known += [f"certificate {certificate}"] if certificate else []
    return f"{one.profile} ({', '.join(known)})" if known else one.profile


def _method_words(solution: Solution) -> str:
    if solution.method == "exact":
        return "exact fit"
    if solution.weights == "covariance":
        return "linear system (11) weighted by covariance (14)"
    return "linear system (11), pseudoinverse as in the papers"


def _verdict(solved: SessionSolution) -> str:
    solution = solved.solution
    of_tool = any(reading.leg == "tool" for one in solved.sessions for reading in one.readings)
    expanded = uncertain(float(solution.expanded_mm.max()))
    return (
        f"{SUBSET_WORDS[solution.subset].capitalize()} known to ±{expanded} mm "
        f"({_source_of_uncertainty(solution)}).\n"
        f"{'Tool' if of_tool else 'Leg'} deviations {solution.rms_before_mm:.4f} → "
        f"{solution.rms_after_mm:.4f} mm r.m.s.\n"
        f"Tool over the workspace: off by {_tool(solved, solved.tool_before)} mm r.m.s. now, "
        f"{_tool(solved, solved.tool_after)} mm expected with these values."
    )


def _source_of_uncertainty(solution: Solution) -> str:
    """What the uncertainty in the first line is made of."""
    if solution.subset == "with-tolerances":
        return "95 %, reading noise and the parts' tolerances"
    if solution.noise.source == "residuals":
        return "95 %, what the model leaves taken for noise"
    return "95 %, reading noise only"


def _tool(solved: SessionSolution, error: ToolError) -> str:
    half_mm = solved.tool_factor * error.standard_uncertainty_mm
    return f"{error.rms_mm:.{decimals_for(half_mm)}f} ± {uncertain(half_mm)}"


def _parameter_table(solution: Solution) -> str:
    table = new_table("parameter", "value, mm", "± U (95 %), mm", "u, mm")
    rows = (solution.names, solution.values_mm, solution.expanded_mm, solution.uncertainty_mm)
    decimals = decimals_for(float(solution.expanded_mm.min()), 4)
    for name, value, expanded, u in zip(*rows, strict=True):
        table.add_row(name, signed(value, decimals), uncertain(expanded, 4), uncertain(u, 4))
    return table_text(table)


def _size_table(solution: Solution) -> str:
    """Sizes of the model's effects, fitted with the parameters."""
    table = new_table("fitted with them", "value", "± U (95 %)", "unit")
    for size in solution.sizes:
        half = size.coverage_factor * size.standard_uncertainty
        table.add_row(
            size.name, signed(size.value, decimals_for(half, 4)), uncertain(half, 4), size.unit
        )
    return table_text(table)


def _difference_table(solution: Solution) -> str:
    """The (up to) twelve differences with what the model predicts."""
    table = new_table("difference", "measured, mm", "u, mm", "predicted, mm", "residual, mm")
    measured = solution.differences
    for k in measured.published_rows:
        table.add_row(
            measured.names[k],
            signed(float(measured.value_mm[k])),
            uncertain(float(solution.difference_uncertainty_mm[k]), 4),
            signed(float(solution.predicted_mm[k])),
            signed(float(solution.left_mm[k])),
        )
    return table_text(table)


def _subset_table(solved: SessionSolution) -> str:
    """What each set of parameters would leave, and its expected error at the tool."""
    table = new_table("set of parameters", "residual r.m.s., mm", "tool, mm", "")
    for subset in SUBSETS:
        residual, expected = "left out", ""
        if subset in solved.choice.solutions:
            residual = f"{solved.choice.solutions[subset].rms_after_mm:.4f}"
            expected = uncertain(solved.choice.tool_error_mm[subset])
        mark = "recommended" if subset == solved.choice.recommended else ""
        table.add_row(SUBSET_WORDS[subset], residual, expected, mark)
    return table_text(table)


def _noise_words(solution: Solution) -> str:
    """Where the noise figure comes from, and the parameters known least independently."""
    noise = solution.noise
    mean = "" if noise.pooled else " r.m.s. over the indicators"
    value, first, second = solution.strongest_correlation or (0.0, "", "")
    shown = signed(value, 2)
    correlation = f"strongest correlation {shown}, {first} and {second}."
    if float(shown) == 0.0:
        correlation = "no correlation to state."
    return (
        f"Noise of a single reading {uncertain(noise.standard_deviation_mm, 4)} mm{mean}, "
        f"{_source_words(noise)}.\n"
        f"Coverage factor {solution.coverage_factor:.3f}; condition number "
        f"{solution.condition_number:.1f}; {correlation}"
    )


def _source_words(noise: Noise) -> str:
    free = noise.degrees_of_freedom
    degrees = "" if math.isinf(free) else f", {free:.3g} degrees of freedom"
    if noise.source == "repeats":
        return f"from repeats{degrees}"
    if noise.source == "residuals":
        return f"from what the model leaves{degrees}"
    if noise.repeated == "rounding":
        return f"most of it the rounding of the display{degrees}"
    if noise.repeated == "equal":
        return "from resolution and repeatability as stated or seen in the digits"
    return "from the indicator's stated resolution and repeatability"


DECISION_WORDS = {"pass": "passes", "fail": "fails", "undecided": "cannot be decided"}


def judged_text(judged: Judgement) -> str:
    """Against the tolerance, with the guard band."""
    return wrapped(
        f"Tolerance {judged.tolerance_mm:g} mm for the tool, r.m.s., with a guard band of the "
        f"expanded uncertainty: now it {DECISION_WORDS[judged.before]}, with these values it "
        f"{DECISION_WORDS[judged.after]}."
    )


def maps_text(maps: tuple[ToolMap, ...]) -> str:
    """Expected tool error in µm on planes through Zero."""
    parts = []
    for one in maps:
        table = new_table(
            f"{one.up} \\ {one.across}, mm", *(f"{v:+.0f}" for v in one.coordinate_mm)
        )
        for k in range(len(one.up_mm) - 1, -1, -1):
            row = (f"{1000.0 * v:.0f}" for v in one.error_mm[k])
            table.add_row(f"{one.up_mm[k]:+.0f}", *row)
        parts.append(table_text(table))
    return "Expected tool error with these values, µm\n\n" + "\n\n".join(parts)


def monte_carlo_text(found: MonteCarlo) -> str:
    """Stated against true uncertainty."""
    table = new_table("parameter", "stated u, mm", "true, mm", "95 % held")
    for row in zip(found.names, found.stated_mm, found.true_mm, found.covered, strict=True):
        name, stated, true, covered = row
        table.add_row(name, f"{stated:.4f}", f"{true:.4f}", f"{covered:.1%}")
    return f"{found.sessions} simulated sessions, {found.failed} failed\n{table_text(table)}"


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


RESULT_HELP = """\
1 2 3         joint offsets, leg lengths, or both
4             both, held by the tolerances of the parts
Tab, arrows   Result, Plot, and after a verification Before/after
E             write the joint offsets, in every format, into a folder
              beside the session
V             measure again after the offsets were entered, and compare
D             diagnose: where readings and model disagree, what is missing
Y             copy the text to the clipboard
H, F10        home, quit

U is the expanded uncertainty (95 %) of a parameter, from the noise of
the readings alone. The residual is what the model does not explain: where
it is much larger than the noise, something is missing from the model."""

NEXT = (
    "Next: E exports the joint offsets. Enter them in the controller, then V measures again "
    "and compares."
)
LOOK_FIRST = (
    "Next: D looks for what is missing from the model. Until that is found, offsets that E exports "
    "carry its error."
)
ONLY_SHOWN = "This program only shows: nothing is written and nothing is measured."
NO_PLAN = (
    "This session cannot be measured again from here: it is a table, or its ports are those of "
    "another computer."
)


def result_text(
    solved: SessionSolution, before: SessionSolution | None, *, measured_here: bool
) -> str:
    """The text of the result; what to do next, or what the verification says, stands first."""
    if before is not None:
        first = comparison_sentence(before.solution, solved.solution) + "\n\n"
    elif solved.solution.lacks_fit:
        first = LOOK_FIRST + "\n\n"
    else:
        first = NEXT + "\n\n" if measured_here else ""
    return first + solution_text(solved)


def exported_text(
    folder: Path, paths: Sequence[Path], solved: SessionSolution, refused: str
) -> str:
    """What was written where, what was not, and what could not be known."""
    said = f"Written to {folder}: {', '.join(path.name for path in paths)}"
    if refused:
        said += f". No files for LinuxCNC (any there are older): {refused}"
    elif solved.sessions[0].opened.machine.home_offset_mm is None:
        said += ". WARNING: " + UNKNOWN_HOME_OFFSET
    return said


def copied_text(text: str) -> str:
    """How much was copied, and why it may not arrive."""
    return (
        f"{len(text.splitlines())} lines copied. If nothing arrives: some terminals do not allow "
        "it, and tmux needs `set-clipboard on`."
    )


def comparison_report(comparison: Comparison) -> str:
    """Which sessions, what a reader must know, then the differences of both."""
    before, after = comparison.before, comparison.after
    heading = f"before: {before.names[0]}\nafter:  {after.names[0]}"
    remarks = [wrapped(f"Remark: {remark}") for remark in comparison.remarks]
    return "\n\n".join([heading, *remarks, comparison_text(before.solution, after.solution)])


COMPARISON_HELP = """\
Each difference between two postures, before and after the joint offsets
were entered in the controller. "Expected" is what the fit of the first
session left over: offsets cannot remove more than that.

G  the plot in the place of the text, and back
Y  copies the text"""


WRONG = {
    "not entered": "the value before is still there. Enter it, and home again.",
    "wrong sign": "twice the value before. It was entered with the wrong sign.",
    "something else": "neither 0 nor the value before. Was the machine changed mechanically?",
}


def verification_text(found: Verification) -> str:
    """The decision first, then what was expected and found, then what to do."""
    before, after = found.compared.before, found.compared.after
    table = new_table("joint offset", "before, mm", "remaining, mm", "± U (95 %), mm", "")
    for one in found.offsets:
        decimals = decimals_for(one.expanded_mm, 4)
        shown = (signed(one.before_mm, decimals), signed(one.found_mm, decimals))
        table.add_row(one.name, *shown, uncertain(one.expanded_mm, 4), one.entered)
    said = (
        f"{_decided(found)} Tool over the workspace: expected {_tool(before, found.expected)} mm "
        f"r.m.s., found {_tool(after, found.found)} mm."
    )
    remarks = [wrapped(f"Remark: {remark}") for remark in found.compared.remarks]
    heading = f"before: {before.names[0]}\nafter:  {after.names[0]}"
    return "\n\n".join([heading, wrapped(said), table_text(table), *_what_to_do(found), *remarks])


def _decided(found: Verification) -> str:
    if found.decision is None:
        return "NOT JUDGED: no --tolerance, and no tool_tolerance_mm in the machine file."
    words = {"pass": "PASS", "fail": "FAIL", "undecided": "UNDECIDED"}[found.decision]
    return f"{words}: tolerance {found.tolerance_mm:g} mm, guard band the expanded uncertainty."


def _what_to_do(found: Verification) -> list[str]:
    """What went wrong at the controller, or in the model."""
    after = found.compared.after.names[0]
    wrong = {kind: [one.name for one in found.offsets if one.entered == kind] for kind in WRONG}
    said = [f"{', '.join(names)}: {WRONG[kind]}" for kind, names in wrong.items() if names]
    if found.something_missing:
        said.append(f"Something is missing from the model: glidecal diagnose {after}")
    if not said and found.decision in ("fail", "undecided"):
        said.append("The offsets are as expected: measure more (glidecal plan), or fit lengths.")
    return [wrapped("\n".join(said))] if said else []
