"""A diagnosis in words and tables: what the command prints, and the pages of the screen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from rich.table import Table

from app.evaluating.diagnosis import AdoptedTool, DiagnosedTool, SessionDiagnosis, mistakes_of
from app.evaluating.printer import tower_names
from app.report.text.caveats import changed_lines
from app.report.text.correction import FRAME_WORDS
from app.report.text.printer import tower_remedies
from app.report.text.tables import (
    expanded,
    hanging,
    new_table,
    paragraphs,
    result_table,
    signed,
    table_text,
    uncertain,
    wrapped,
)
from calib.arrays import descending
from calib.diagnosis.pattern import RAREST, once_in
from calib.diagnosis.results import (
    SEEN,
    Cell,
    Contender,
    Detectable,
    Diagnosis,
    Finding,
    Gap,
    GapPart,
    HeldOutGap,
    ModelDiscrepancy,
)
from calib.posterior.correction import HOLDS, Holds
from calib.quantity import probability_words
from calib.stats import UNLIKELY
from calib.tripod.effects.empirical import EMPIRICAL

LOOKING = "Looking for what is missing …"
NOT_YET = "The diagnosis is not ready yet."
NOTHING_FOUND = "There is no diagnosis, so there is nothing to adopt, write or copy."
NOTHING_NAMED = (
    "Nothing to adopt: the diagnosis names no effect of the machine or of what measured it, and "
    "the rest follows no simple pattern."
)
NO_NEXT = "No measurement is proposed: there are no two effects that one would decide between."
CORRECT = "correct"
WHAT_TO_ADOPT = "What do you want to adopt into the model, or to correct?"
CORRECTED = "Corrected session written: {}. Diagnosing it; {} is not changed."
WHICH_SESSION = "Write the corrected session to which file?"
WHICH_FILE = "Write the model to which file?"
ADOPTED = "Adopted in {}: gap {:.4f} → {:.4f} mm."
MODEL_WRITTEN = "Model written: {}. Diagnosing again with it."
NEXT_WRITTEN = "Written. Measure it with: glidecal run --protocol {}"
NO_FILE_NEEDED = "No file is needed: glidecal run --protocol {}"

INDENT = "    "
SHOWN_CANDIDATES = 8
LIKELY = 0.005
"""Probability of a candidate that is shown; a smaller one is written as < 0.01."""

BESIDE_AGREEMENT = 0.05
"""The same where readings and model agree: of many candidates some are a little likely."""

SHOWN_SHARES = 6
MOST_RIVALS = 8
STRONG = 5.0
"""Standard deviations of a mean residual that get a second mark."""

SHOWN_MM = 0.00005
"""A gap below this is shown as nothing."""

WORTH_SAYING = 0.9
"""Of the bound with joint offsets: what leaves more is not worth a sentence."""

FIRMWARE = "all values of the firmware entered"
WITH: dict[Holds, str] = {
    "offsets": "joint offsets entered",
    "play": "play as well",
    "tables": "play and a table of each joint as well",
    "kinematics": "all that a controller can hold",
}


def headline(diagnosis: Diagnosis) -> str:
    """The verdict in a sentence."""
    return f"{diagnosis.verdict.upper()}. {diagnosis.sentence}"


def diagnosis_text(diagnosed: SessionDiagnosis, adopted: AdoptedTool | None = None) -> str:
    """The verdict first, then what supports it; ``adopted`` is the tool with adopted names."""
    return paragraphs(
        *diagnosis_parts(diagnosed, adopted),
        *changed_lines(diagnosed.corrections, diagnosed.names),
        *(f"Remark: {remark}" for remark in diagnosed.diagnosis.remarks),
    )


def diagnosis_parts(
    diagnosed: SessionDiagnosis, adopted: AdoptedTool | None = None, *, entered: bool = False
) -> list[str | Table]:
    """The verdict and all that supports it, but for what limits the readings.

    Values may be ``entered`` since.
    """
    diagnosis = diagnosed.diagnosis
    return [
        headline(diagnosis),
        open_text(diagnosis),
        gap_text(diagnosed),
        effects_text(diagnosis.effects, tower_names(diagnosed.sessions[0].opened.machine)),
        "\n".join(_pattern(diagnosed)),
        *_support(diagnosed),
        tool_text(diagnosed.tool, entered=entered),
        adopted_text(adopted, diagnosed.tool) if adopted else "",
        GAP_LIES,
        shares_table(diagnosis.where),
        *candidates_parts(diagnosis),
        *_detectable(diagnosis),
    ]


def verdict_text(diagnosed: SessionDiagnosis, adopted: str = "") -> str:
    """The first page of the screen; ``adopted`` says what a step before did."""
    diagnosis = diagnosed.diagnosis
    return paragraphs(
        headline(diagnosis),
        adopted,
        _next(diagnosed),
        open_text(diagnosis),
        *changed_lines(diagnosed.corrections, diagnosed.names),
        effects_text(diagnosis.effects, tower_names(diagnosed.sessions[0].opened.machine)),
        tool_text(diagnosed.tool),
        gap_text(diagnosed),
        _pattern(diagnosed),
        *_support(diagnosed, " {diagnose.next} writes it."),
        *_detectable(diagnosis),
        *(f"Remark: {remark}" for remark in (*diagnosed.warnings, *diagnosis.remarks)),
    )


def _next(diagnosed: SessionDiagnosis) -> str:
    """What to do with such a verdict."""
    diagnosis = diagnosed.diagnosis
    advice = "{page.2} shows where the gap lies. Look at the machine and the set-up there."
    if mistakes_of(diagnosed):
        advice = "{diagnose.adopt} writes a corrected session and diagnoses that."
    elif diagnosis.verdict == "agrees":
        advice = "{diagnose.result} shows the result."
    elif diagnosis.verdict == "explained":
        advice = "{diagnose.adopt} adopts what was named. Then {diagnose.result} shows the result."
    elif diagnosis.verdict == "partly-explained":
        advice = "{diagnose.adopt} adopts what was named, and looks again for the rest."
    elif diagnosed.separation:
        advice = "measure what is proposed below, then diagnose both sessions together."
    elif diagnosis.left_over:
        advice += " {diagnose.adopt} adopts the law without a name that is stated below."
    return f"Next: {advice}"


def _support(diagnosed: SessionDiagnosis, key: str = "") -> list[str]:
    """What held-out readings say, what has no name, and what to measure next."""
    diagnosis, separation = diagnosed.diagnosis, diagnosed.separation
    return [
        held_out_words(diagnosis.held_out) if diagnosis.held_out else "",
        discrepancy_text(diagnosis.left_over) if diagnosis.left_over else "",
        f"Next measurement: {separation.words}.{key}" if separation else "",
    ]


def tool_text(tool: DiagnosedTool, *, entered: bool = False) -> str:
    """What the tool is off by at most, as it is, or was before values were ``entered``, and with
    values entered.
    """
    bounds_mm = _bounds_mm(tool)
    text = " ".join(f"With {way}: {uncertain(bounds_mm[way])} mm." for way in _ways(tool))
    return (
        f"Tool over the workspace, r.m.s. (95 %), {FRAME_WORDS[tool.frame]}: at most "
        f"{uncertain(tool.now_mm)} mm {'before' if entered else 'now'}. {text}"
    )


def _bounds_mm(tool: DiagnosedTool) -> dict[str, float]:
    """What the tool is off by at most, by the words for what is entered."""
    bounds_mm = {WITH[holds]: mm for holds, mm in tool.entered_mm.items()}
    return bounds_mm if tool.firmware_mm is None else {**bounds_mm, FIRMWARE: tool.firmware_mm}


def _ways(tool: DiagnosedTool) -> list[str]:
    """Joint offsets, and what keeps the tool best where they do not as well.

    Of a printer first all that its firmware holds, whatever other controllers may.
    """
    if tool.firmware_mm is not None:
        return [FIRMWARE, WITH["offsets"]]
    entered = tool.entered_mm
    better = [h for h in HOLDS[1:] if entered[h] < WORTH_SAYING * entered["offsets"]]
    best = sorted(better, key=entered.__getitem__)[:1]
    return [WITH[holds] for holds in ("offsets", *best)]


def adopted_text(adopted: AdoptedTool, all_models: DiagnosedTool) -> str:
    """What the tool is off by at most if the adopted names are true, beside all models."""
    tool = adopted.tool
    names = " and ".join(f"{name.id} ({name.where})" for name in adopted.names)
    bounds_mm, over_all_mm = _bounds_mm(tool), _bounds_mm(all_models)
    bounds = ", ".join(
        f"at most {uncertain(bounds_mm[way])} mm with {way} (over all models "
        f"{uncertain(over_all_mm[way])} mm)"
        for way in _ways(tool)
    )
    frame = FRAME_WORDS[tool.frame]
    return f"Given {names}: tool over the workspace, r.m.s. (95 %), {frame}, {bounds}."


def words_on_adopting(diagnosed: SessionDiagnosis, candidate: str | None) -> str:
    """What the names that are adopted from this diagnosis change at the tool."""
    adopted = diagnosed.adopted_tool(candidate)
    return adopted_text(adopted, diagnosed.tool) if adopted else ""


def _pattern(diagnosed: SessionDiagnosis) -> list[str]:
    """Whether several sessions leave one pattern: chance, and each pair; empty for one session."""
    pattern = diagnosed.diagnosis.pattern
    if pattern is None:
        return []
    names = (*diagnosed.names, *diagnosed.held_out)
    sentence = (
        f"{'One pattern' if pattern.reproducible else 'No common pattern'} in what is left of"
        f" {len(pattern.sessions)} sessions: {pattern.common_share:.1%} in one of"
        f" {pattern.directions} directions; by chance {once_in(pattern.p_value_directions)},"
        f" with set-ups exchanged {once_in(pattern.p_value_permutations)}"
    )
    pairs = [
        hanging(
            f"{INDENT}{names[pair.second]} less {pair.scale:.2f} × {names[pair.first]} (cosine "
            f"{pair.cosine:.3f}): {pair.before_rms_mm:.4f} → {pair.after_rms_mm:.4f} mm, noise "
            f"alone {pair.noise_rms_mm:.4f} mm",
            INDENT,
        )
        for pair in pattern.pairs
    ]
    return [wrapped(sentence), *pairs]


GAP_LIES = "Where the gap lies (shares overlap)"

WITH_DISTANCES = (
    "The chances include the distances between marks; the millimetres are of the readings alone."
)


GEOMETRY_FITTED = (
    "The fit has such parameters of the machine within their tolerance, so the gap hardly shows "
    "them. What is off by more than twice its tolerance is named."
)


def gap_text(diagnosed: SessionDiagnosis) -> str:
    """The gap in the readings and its chance, before and after what was named or guessed."""
    diagnosis, noise = diagnosed.diagnosis, diagnosed.noise
    gap_before, gap_after = diagnosis.gap_before, diagnosis.gap_after
    if noise is None:
        return (
            f"Gap {gap_before.rms_mm:.4f} mm r.m.s., {freedom_words(gap_before)}; "
            "without a scatter of repeats or a stated noise it may be chance."
        )
    noise_words = uncertain(noise.standard_deviation_mm, 4)
    mistakes = mistakes_of(diagnosed)
    is_corrected = any(mistake.gap_rms_before_mm > gap_before.rms_mm for mistake in mistakes)
    begin = "With the mistakes of the readings corrected the gap is" if is_corrected else "Gap"
    sentence = (
        f"{begin} {gap_before.rms_mm:.4f} mm r.m.s. beyond the scatter of repeats (noise of a "
        f"reading {noise_words} mm), {freedom_words(gap_before)}; "
        f"it {by_chance(gap_before.p_value)}."
    )
    if gap_after != gap_before:
        added = "what was named" if diagnosis.effects else "the best guess"
        sentence += (
            f"\nWith {added}: {gap_after.rms_mm:.4f} mm; that {by_chance(gap_after.p_value)}."
        )
    if diagnosed.names_geometry and gap_before.p_value > UNLIKELY:
        sentence += f"\n{GEOMETRY_FITTED}"
    if any(session.distances for session in diagnosed.sessions):
        sentence += f"\n{WITH_DISTANCES}"
    return sentence


def open_text(diagnosis: Diagnosis) -> str:
    """How likely it is that anything is missing, and that it has no name, where that is open."""
    if diagnosis.verdict in ("agrees", "explained"):
        return ""
    if diagnosis.verdict != "cannot-tell" and diagnosis.something_else < BESIDE_AGREEMENT:
        return ""
    missing, unnamed = map(probability_words, (diagnosis.missing, diagnosis.something_else))
    return (
        f"Probability that anything is missing: {missing}; that something without a name acts: "
        f"{unnamed}."
    )


def freedom_words(gap: Gap) -> str:
    """The degrees of freedom of a gap."""
    count = gap.degrees_of_freedom
    return f"{count} degree{'s' if count != 1 else ''} of freedom"


def by_chance(p_value: float) -> str:
    """A p-value in a sentence."""
    often = f"1 of {round(float(f'{1.0 / max(p_value, RAREST):.2g}')):,}"
    share_words = "most" if p_value > 0.5 else often if p_value > RAREST else f"fewer than {often}"
    return f"would happen by chance in {share_words} sessions"


def p_words(p_value: float) -> str:
    """A p-value in a table."""
    if p_value >= 0.01:
        return f"{p_value:.2f}"
    return f"{p_value:.0e}" if p_value > 1e-99 else "< 1e-99"


def effects_text(findings: tuple[Finding, ...], towers: Mapping[str, str]) -> str:
    """Named effects with their values, what to do, and what looks the same.

    ``towers`` names those of a printer by drive.
    """
    lines = []
    for finding in findings:
        likely = probability_words(finding.probability)
        lines.append(
            wrapped(f"{finding.id} ({finding.where}), {finding.kind}, {likely}: {finding.title}")
        )
        below = [*_values_and_gap(finding), *tower_remedies(finding.effects, towers)]
        if rivals := _rivals(finding):
            below.append(f"these readings cannot distinguish it from: {rivals}")
        lines += [hanging(INDENT + line, INDENT) for line in below]
    return "\n".join(lines)


def _rivals(finding: Finding) -> str:
    """Each rival once, with its place where it has but one."""
    places: dict[str, list[str]] = {}
    for rival in finding.indistinguishable_from:
        places.setdefault(rival.id, []).append(rival.where)
    return ", ".join(f"{name} ({at[0]})" if len(at) == 1 else name for name, at in places.items())


def _values_and_gap(finding: Finding) -> list[str]:
    """Parameters with their expanded uncertainty, then the gap before and after."""
    lines = [
        f"{value.name} = {expanded(value.value, value.standard_uncertainty)} {value.unit}"
        for value in finding.parameters
    ]
    return [*lines, f"gap {finding.gap_rms_before_mm:.4f} → {finding.gap_rms_after_mm:.4f} mm"]


def discrepancy_text(discrepancy: ModelDiscrepancy) -> str:
    """The unnamed effect of the residuals, its values, and what it would take away."""
    below = _values_and_gap(discrepancy)
    if discrepancy.held_out_gap:
        below.append(held_out_words(discrepancy.held_out_gap))
    begin = f"What has no name is most likely this: {discrepancy.title}."
    return "\n".join([begin, *(hanging(INDENT + line, INDENT) for line in below)])


def held_out_words(gap: HeldOutGap) -> str:
    """Whether the gap shrinks on what the choice did not see."""
    if gap.after_rms_mm == gap.before_rms_mm:
        return (
            f"Held out ({gap.how}): {gap.before_rms_mm:.4f} mm, noise {gap.noise_rms_mm:.4f} mm. "
            "No effect was named that could reduce it."
        )
    gaps = f"{gap.before_rms_mm:.4f} → {gap.after_rms_mm:.4f} mm"
    sentence = f"Held out ({gap.how}): {gaps}, noise {gap.noise_rms_mm:.4f} mm."
    if gap.before_rms_mm < SHOWN_MM:
        return sentence + " There is no gap to reduce."
    if gap.after_rms_mm >= gap.before_rms_mm:
        sentence += " Only the gap of the readings that were used is smaller."
    return sentence


def shares_table(shares: tuple[GapPart, ...]) -> Table:
    """The parts of the readings where the gap lies."""
    table = new_table("part", "share", "", "p-value", left_columns=1)
    for share in shares[:SHOWN_SHARES]:
        bar = "█" * round(20 * min(share.share, 1.0))
        table.add_row(part_words(share), f"{share.share:.0%}", bar, p_words(share.p_value))
    return table


def part_words(share: GapPart) -> str:
    """Leg, axis or pattern."""
    if share.leg == "tool" and share.axis:
        return f"the tool along {share.axis.upper()}"
    if share.leg and share.axis:
        return f"leg {share.leg.upper()} along {share.axis.upper()}"
    if share.leg:
        return f"leg {share.leg.upper()}"
    return f"axis {share.axis.upper()}" if share.axis else share.posture_or_pattern


def shown_candidates(diagnosis: Diagnosis) -> list[Contender]:
    """The likely candidates, and the one that does most for readings that it never saw.

    By probability, the largest first.
    """
    least = BESIDE_AGREEMENT if diagnosis.verdict == "agrees" else LIKELY
    likely = [c for c in diagnosis.candidates if c.probability >= least][:SHOWN_CANDIDATES]
    if diagnosis.verdict != "agrees":
        judged = [c for c in diagnosis.candidates if c.held_out_gap_rms_mm is not None]
        # through ties: every processor must show the same one
        best = descending(judged, lambda c: -(c.held_out_gap_rms_mm or 0.0))[:1]
        likely += [c for c in best if c not in likely]
    return descending(likely, lambda c: c.probability)


def candidates_table(candidates: Sequence[Contender]) -> Table:
    """The candidates, each with the part of the gap that it explains alone and what it leaves."""
    held_out = any(candidate.held_out_gap_rms_mm is not None for candidate in candidates)
    last = "held out" if held_out else "explains"
    table = new_table("effect", "where", "likely", "gap, mm", last, "why", left_columns=2)
    table.columns[-1].justify = "left"
    for candidate in candidates:
        likely = probability_words(candidate.probability)
        unseen_mm = candidate.held_out_gap_rms_mm
        unseen = "" if unseen_mm is None else f"{unseen_mm:.4f}"
        alone = unseen if held_out else f"{candidate.explained:.0%}"
        gap_text, why = f"{candidate.gap_rms_after_mm:.4f}", candidate.reason_rejected or "named"
        table.add_row(candidate.id, candidate.where, likely, gap_text, alone, why)
    return table


def candidates_parts(diagnosis: Diagnosis) -> list[str | Table]:
    """The candidates that are shown, the likeliest first; empty where there is no choice."""
    candidates = shown_candidates(diagnosis)
    text = "Candidates, the likeliest first, and the gap that each alone leaves"
    return [text, candidates_table(candidates)] if len(candidates) > 1 else []


def _detectable(diagnosis: Diagnosis) -> list[Table]:
    """What would have been found, where readings and model agree."""
    table = result_table(Detectable, diagnosis.smallest_detectable)
    for name in diagnosis.not_shown:
        table.add_row(name, "not shown")
    return [table] if diagnosis.verdict == "agrees" else []


def heading_text(names: Sequence[str], model: Path | None) -> str:
    """What is diagnosed, on one line."""
    against = f"model {model.name}" if model else "nominal machine"
    return f"{', '.join(names)}   against: {against}"


def problem_text(problem: Exception) -> str:
    """Why there is no diagnosis."""
    return wrapped(f"This cannot be diagnosed.\n\n{problem}")


def where_text(diagnosed: SessionDiagnosis) -> str:
    """The residual map, a table for each station, and the shares of the gap."""
    cells = diagnosed.diagnosis.residuals.cells
    stations = sorted({cell.station for cell in cells})
    parts = []
    for station in stations:
        at = f", {station:.0%} from the tool end" if len(stations) > 1 else ""
        here = [cell for cell in cells if cell.station == station]
        parts.append(f"Mean residual of each leg, µm{at}\n{_map_text(here)}")
    return paragraphs(
        *parts,
        f"▲ ▼ more than {SEEN:.0f}, ▲▲ ▼▼ more than {STRONG:.0f} standard deviations of a mean"
        + ("\n↑ ↓ reached while moving up, down" if _both_ways(cells) else ""),
        GAP_LIES,
        shares_table(diagnosed.diagnosis.where),
    )


def _map_text(cells: Sequence[Cell]) -> str:
    columns = list(dict.fromkeys((cell.leg, cell.axis) for cell in cells))
    cells_both_ways = _both_ways(cells)
    table = new_table("at, mm", left_columns=0)
    for leg, axis in columns:
        touched = "tool" if leg == "tool" else f"leg {leg.upper()}"
        table.add_column(f"{touched}\nalong {axis.upper()}", justify="right")
    at = {(c.leg, c.axis, c.displacement_mm, c.approach, c.position_mm or ()): c for c in cells}
    for displacement, approach, position in sorted({key[2:] for key in at}, reverse=True):
        arrow = {1: " ↑", -1: " ↓"}.get(approach, "  ") if displacement in cells_both_ways else ""
        row = [at.get((*column, displacement, approach, position)) for column in columns]
        place = f"{displacement:+.0f}" if displacement else "Zero"
        if any(position):
            place = ", ".join(f"{part:g}" for part in position)
        table.add_row(f"{place}{arrow}", *(_cell_text(mean) for mean in row))
    return table_text(table)


def _both_ways(cells: Sequence[Cell]) -> set[float]:
    """Displacements that were reached from more than one side."""
    sides = {(cell.displacement_mm, cell.approach) for cell in cells}
    places = [displacement for displacement, _ in sides]
    return {place for place in places if places.count(place) > 1}


def _cell_text(cell: Cell | None) -> str:
    if cell is None:
        return "-"
    mark = "▲" if cell.strength > 0 else "▼"
    times = 2 if abs(cell.strength) > STRONG else 1 if abs(cell.strength) > SEEN else 0
    return f"{signed(1000.0 * cell.before_mm, 1)} {mark * times:<2}"


def ranking_text(diagnosed: SessionDiagnosis) -> str:
    """The candidates with what each explains alone; then what looks the same."""
    diagnosis = diagnosed.diagnosis
    fallback = "No effect of the catalogue is likely in these readings."
    if diagnosis.effects:
        fallback = "There is no choice: the verdict names the only likely effects."
    parts = candidates_parts(diagnosis) or [fallback]
    for finding in filter(lambda finding: finding.effects, diagnosis.effects):
        subject = f"{finding.id} ({finding.where})"
        sentence = f"In these readings no other effect looks like {subject}."
        if rivals := _rivals(finding):
            sentence = f"These readings cannot distinguish {subject} from: {rivals}."
        parts.append(sentence)
    return paragraphs(*parts)


def change_text(diagnosed: SessionDiagnosis) -> str:
    """The chart in one line."""
    residuals = diagnosed.diagnosis.residuals
    change, last = "", " This diagnosis names nothing to adopt."
    if residuals.after_rms_mm is not None:
        after_um, last = 1000.0 * residuals.after_rms_mm, ""
        change = f" before, {after_um:.1f} µm after adopting what was named"
    return wrapped(
        f"Mean residuals {1000.0 * residuals.before_rms_mm:.1f} µm r.m.s.{change}; their noise "
        f"{1000.0 * residuals.noise_rms_mm:.1f} µm, x marks twice the noise.{last}"
    )


def adopt_choices(diagnosed: SessionDiagnosis) -> list[tuple[str, str]]:
    """What can be adopted: answers for a dialog with their words. The first is what was named.

    An answer is `CORRECT`, ``named``, ``empirical`` (what was named and the unnamed effect of the
    rest), or a candidate as ``id:where``.
    """
    diagnosis = diagnosed.diagnosis
    findings = [finding for finding in diagnosis.effects if finding.effects]
    text = " and ".join(f"{finding.id} ({finding.where})" for finding in findings)
    rivals = {(r.id, r.where) for finding in findings for r in finding.indistinguishable_from}
    rival_candidates = [c for c in diagnosis.candidates if (c.id, c.where) in rivals and c.effects]
    mistakes = ", ".join(f"{finding.id} ({finding.where})" for finding in mistakes_of(diagnosed))
    choices = [(CORRECT, f"correct the readings in a new session: {mistakes}")] if mistakes else []
    choices += [("named", f"adopt {text}")] if findings else []
    if diagnosis.left_over:
        where = diagnosis.left_over.where
        words_of_rest = (
            f"adopt {f'{text} and ' if findings else ''}the rest as an unnamed effect ({where})"
        )
        choices.append((EMPIRICAL, words_of_rest))
    choices += [
        (f"{finding.id}:{finding.where}", f"adopt {finding.id} ({finding.where}) instead")
        for finding in rival_candidates[:MOST_RIVALS]
    ]
    return choices
