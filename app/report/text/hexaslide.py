"""What a Hexa Slide shows, in words: parameters, optimum postures, its screen."""

from __future__ import annotations

import math
from pathlib import Path
from statistics import median

from app.report.text.tables import new_table, paragraphs, table_text, wrapped
from calib.hexaslide.geometry import COORDINATES
from calib.hexaslide.planning import DIFFERENCE_STEP, SCALED, SCALED_WORDS, HexaSlideSeen, PaperRule
from calib.hexaslide.procedures import MEASURABLE_WORDS, ProcedureKind
from calib.hexaslide.search import BestPostures

PUBLISHED_WORDS = {
    "log10_determinant": "log10 det(JᵀJ)",
    "geometric_mean": "geometric mean of σ / √postures",
    "inverse_condition": "σ_L / σ_1",
    "smallest_singular_value": "σ_L",
    "noise_amplification": "σ_L² / σ_1",
}
"""The criteria of papers/001, section 4, in its order; the larger the better."""


def postures_text(best: BestPostures) -> str:
    """Criteria before and after, then the postures and how they were found."""
    postures = new_table(*best.postures[0], left_columns=0)
    for posture in best.postures:
        postures.add_row(*(f"{value:z.4f}" for value in posture.values()))
    procedure, moved = best.procedure, bool(best.values)
    criteria = new_table("criteria of papers/001", *(["start", "found"] if moved else ["value"]))
    sets = (best.start, best.criteria) if moved else (best.criteria,)
    for name, text in PUBLISHED_WORDS.items():
        criteria.add_row(text, *(f"{getattr(posture_set, name):.4g}" for posture_set in sets))
    machine = "six telescopic legs" if procedure.telescopic else "hexaslide"
    start_text = f" (start {best.refined.start_value:.4g})" if moved else ""
    condition = f"{best.condition_number:.4g}"
    condition += f", at the start {best.start_condition_number:.4g}" if moved else ""
    sentence = (
        f"{machine}, {procedure.kind.value}, reading {', '.join(procedure.read)}: "
        f"{len(best.postures)} postures for the {best.search.criterion.value} criterion, "
        f"{best.refined.value:.5g}{start_text}. "
        f"Condition number {condition} ({best.units}; of the {best.rank} combinations that are "
        "identifiable)."
    )
    if best.rank < best.reachable_rank:
        sentence += (
            f"\nWARNING: so few postures show {best.rank} of the {best.reachable_rank} "
            "combinations that more of them show: which are lost depends on the postures, no "
            "calibration comes of them, and their condition number compares only with that of as "
            "few."
        )
    return paragraphs(sentence, criteria, postures, _search(best))


def _search(best: BestPostures) -> str:
    size = best.coordinates.size
    where = "are on a bound of the box"
    kind = "coordinates"
    if best.space == "joints":
        where, kind = "are at an end of their travel; the box was left out", "sliders"
    share = f"{100.0 * best.refined.on_bound / size:.0f} % of the {kind} {where}"
    if not best.values:
        return f"{share}. From {best.search.source}."
    return (
        f"{share}, at the start {100.0 * best.start_on_bound / size:.0f} %. {_starts(best)}, "
        f"seed {best.search.seed}, {best.seconds:.1f} s."
    )


def _starts(best: BestPostures) -> str:
    values, source = best.values, best.search.source
    random, remaining = source == "random", best.search.starts - len(best.values)
    stopped = f"; stopped, {remaining} more were asked for" if remaining else ""
    if len(values) == 1:
        return f"One start, {'random' if random else source}{stopped}"
    first = "" if random else f", the first of them {source}"
    return (
        f"Best of {len(values)} starts{first} ({min(values):.4g} to {max(values):.4g}, median "
        f"{median(values):.4g}){stopped}"
    )


DECIDED = {
    "rows": "the number of rows",
    "parameters": "the number of parameters",
    "postures": "what so few postures can show",
}

MOST_TOLD = 4
"""So many long sums are written out."""


def seen_text(view: HexaSlideSeen) -> str:
    """What is seen and lost, the condition number with its units, then the paper's rule."""
    examined = view.seen.examined
    return paragraphs(
        f"{view.planned.name}, {examined.procedure}: {examined.posture_count} postures "
        f"({examined.source}) "
        f"reading {', '.join(examined.measured)}. Derivatives are exact; noise plays no part.",
        _verdict(view),
        _lost_words(view),
        _known_words(view),
        _conditions(view),
        _rule(view),
    )


def _verdict(view: HexaSlideSeen) -> str:
    identifiability, examined = view.seen.identifiability, view.seen.examined
    count, reachable = len(identifiability.names), examined.reachable_rank or identifiability.rank
    text = f"{identifiability.rank} of {count} combinations of the parameters are identifiable"
    text += (
        ", all of them."
        if identifiability.rank == count
        else f", {count - identifiability.rank} not."
    )
    if view.seen.limited_by == "nothing":
        text += f" Fewest postures that show so many: {examined.fewest_postures}."
    elif examined.posture_count < (examined.fewest_postures or 0):
        text += (
            f"\nToo few postures: {examined.fewest_postures} or more are needed to see the "
            f"{reachable} that this procedure can show. Measure more postures."
        )
    else:
        text += (
            f"\nThese postures are too much alike: others show {reachable}. Vary all six "
            "coordinates."
        )
    return text + (f"\n{examined.remark}" if examined.remark else "")


def _lost_words(view: HexaSlideSeen) -> str:
    names = [parameter.name for parameter in view.seen.unidentifiable]
    lines = []
    for motion, axes in grouped([name for name in names if name in view.always]).items():
        first_axes = f"{', '.join(axes[:-1])} and " if len(axes) > 1 else ""
        lines.append(f"NOT IDENTIFIABLE ({len(axes)}): {motion} {first_axes}{axes[-1]}.")
    if lines:
        lines.append("  No posture shows this: nothing that is read depends on it.")
    other_names = [name for name in names if name not in view.always]
    lines += [f"NOT IDENTIFIABLE (1): {name}." for name in other_names[:MOST_TOLD]]
    if len(other_names) > MOST_TOLD:
        lines.append(
            f"NOT IDENTIFIABLE ({len(other_names) - MOST_TOLD}): more such sums; --json lists them."
        )
    if other_names:
        lines.append("  Other postures show this.")
    return "\n".join(lines)


def grouped(names: list[str]) -> dict[str, list[str]]:
    """Last words of names by what stands before them: the axes of one motion."""
    groups: dict[str, list[str]] = {}
    for name in names:
        motion, _, axis = name.rpartition(" ")
        groups.setdefault(motion, []).append(axis)
    return groups


def _known_words(view: HexaSlideSeen) -> str:
    known_names = view.seen.identifiability.individually_known
    if len(known_names) == len(view.seen.identifiability.names):
        return "Every parameter is identifiable alone."
    if not known_names:
        return "No parameter is identifiable alone: each is part of a combination that is not."
    return f"Identifiable alone ({len(known_names)}): {', '.join(known_names)}."


def _conditions(view: HexaSlideSeen) -> str:
    plain, scaled = view.seen.identifiability.condition_number, view.conditions[SCALED]
    conditions = {
        units: value
        for k, (units, value) in enumerate(view.conditions.items())
        if units != SCALED and (k == 0 or not math.isclose(value, plain))  # no angles, no °
    }
    figures = "; ".join(f"{value:.4g} in {units}" for units, value in conditions.items())
    return (
        f"Condition number of the identifiable combinations: {figures} (columns not scaled; 1 is "
        "the least possible). It depends on the units: compare only equal ones. Scaled "
        f"({SCALED_WORDS}), where no unit matters: {scaled:.4g}."
    )


def _rule(view: HexaSlideSeen) -> str:
    identifiability, qr = view.seen.identifiability, view.seen.qr
    counted = len(identifiability.names) - len(qr.flagged)
    lines = [
        f"Rule of papers/001, QR in the order of the parameters, |r_ii| ≤ {qr.tolerance:.2g}: "
        f"rank {counted} with exact derivatives, flags {', '.join(qr.flagged) or 'none'}."
    ]
    if counted != identifiability.rank:
        lines.append(
            f"WARNING: {counted} is wrong: without exchange of columns the rule needs more rows "
            f"than {identifiability.row_count}."
        )
    elif qr.flagged:
        lines.append(
            "Which ones it flags is a choice of frame and of their order, no fact about them."
        )
    return "\n".join([*lines, *(_on_differences(rule) for rule in view.rules)])


def _on_differences(rule: PaperRule) -> str:
    text = (
        f"With forward differences of {DIFFERENCE_STEP:g} m, as in the paper, at "
        f"{rule.posture_count} postures its rank is {rule.counted}"
    )
    if rule.decided_by == "geometry":
        return f"{text}."
    text += f". WARNING: that is {DECIDED[rule.decided_by]}, not what is identifiable"
    text += f" ({rule.reachable_rank})."
    if rule.errors is None or rule.counted <= rule.rank:
        return text
    low, high = (math.floor(math.log10(max(error, 1.0))) for error in rule.errors)
    orders = f"{low}" if low == high else f"{low} to {high}"
    return (
        f"{text} For the errors of such derivatives the rule is {orders} orders of magnitude too "
        "tight."
    )


PROCEDURE_WORDS = {
    ProcedureKind.POSE_INVERSE: "whole posture, residuals of the sliders",
    ProcedureKind.POSE_FORWARD: "whole posture, residuals of the posture",
    ProcedureKind.POSITION: "position alone",
    ProcedureKind.CONSTRAINT_LINK: "constraint link of fixed length",
}

LOOKING = "Computing what this procedure can identify …"
NO_VIEW = "There is nothing to search: this machine or procedure cannot be used."
NOT_YET = "No postures yet: {hexaslide.search} searches for the best ones."
WHICH_PROCEDURE = "Which procedure?"
WHICH_MACHINE = "Machine file of the Hexa Slide; empty: the example H60."
WHICH_COMPONENTS = f"What is measured of each posture: some of {MEASURABLE_WORDS}."
STOPPED = "Stopped. The best so far stays."
DRAWING_WORDS = "· rail   ⡇ link and its number   ▀ platform   : box of the postures"


def heading_text(file: Path | None, view: HexaSlideSeen | None) -> str:
    """Machine file, none for the example, and procedure on one line."""
    machine = file.name if file else "example H60"
    if view is None:
        return machine
    kind = view.procedure.kind
    number = (
        f"{[*ProcedureKind].index(kind) + 1} of {len(ProcedureKind)}"
        if view.published
        else "your own"
    )
    return f"{machine}   {number}: {kind.value}"


def problem_text(problem: Exception) -> str:
    """Why nothing is shown."""
    return wrapped(f"This machine or procedure cannot be used.\n\n{problem}")


def sees_text(
    view: HexaSlideSeen, best_postures: BestPostures | None, best: dict[str, float] | None
) -> str:
    """Rank, what is lost, what is known, how many postures it takes; the paper beside it."""
    seen_by = view.seen
    rank, count = seen_by.identifiability.rank, len(seen_by.identifiability.names)
    published = seen_by.examined.published_rank
    paper = "" if published is None else f" (papers/001: {published})"
    table = new_table("condition number", *view.conditions)
    conditions = map(_number, view.conditions.values())
    table.add_row(f"{seen_by.examined.posture_count} random postures", *conditions)
    if best_postures is not None and best is not None:
        start = best_postures.start_condition_number
        table.add_row(f"{len(best_postures.begin)} random, the start of the search", _number(start))
        table.add_row(f"{len(best_postures.begin)} optimum postures", *map(_number, best.values()))
    if (paper_set := view.published) is not None:
        table.add_row(f"papers/001: {paper_set.count} random", _number(paper_set.random))
        table.add_row(f"papers/001: {paper_set.count} optimum", _number(paper_set.best))
    return paragraphs(
        f"{PROCEDURE_WORDS[view.procedure.kind].capitalize()}: reads "
        f"{', '.join(seen_by.examined.measured)}.\n"
        f"IDENTIFIABLE: {rank} of {count} combinations of the parameters{paper}.\n"
        f"NOT IDENTIFIABLE by any posture: {lost_words(view)}.\n"
        f"FEWEST POSTURES: {view.fewest}.",
        seen_by.examined.remark,
        f"{table_text(table)}\nColumns not scaled, so the number depends on the units.",
        _known_words(view),
    )


def lost_words(view: HexaSlideSeen) -> str:
    """Motions of one frame in one breath; other combinations are long and only counted."""
    motions = {name for name, _ in view.seen.examined.sensitivity.motions}
    names = [parameter.name for parameter in view.seen.unidentifiable if parameter.name in motions]
    other_count = len(view.seen.unidentifiable) - len(names)
    motion_words = [f"{motion} {', '.join(axes)}" for motion, axes in grouped(names).items()]
    if other_count:
        motion_words.append(f"{other_count} other combination{'s' if other_count > 1 else ''}")
    return "; ".join(motion_words) or "nothing"


def _number(value: float) -> str:
    return f"{value:,.0f}".replace(",", " ") if value >= 1000.0 else f"{value:.1f}"


def search_text(
    view: HexaSlideSeen, count: int, best: BestPostures | None, *, searching: bool
) -> str:
    """How the search stands, in one or two lines."""
    if best is None:
        waiting = f"Searching for {count} postures, the first start …  {{page.back}} stops."
        change = f"{NOT_YET} Now {count} of them; {{hexaslide.count}} changes that."
        return waiting if searching else change
    share = best.refined.on_bound / best.refined.coordinates.size
    paper = f", papers/001 {_number(view.published.best)}" if view.published else ""
    sentence = (
        f"{len(best.begin)} postures, start {len(best.values)} of {best.search.starts}: "
        f"condition number {_number(best.start_condition_number)} → "
        f"{_number(best.condition_number)} (m, rad){paper}; {share:.0%} of the coordinates on a "
        "bound."
    )
    return wrapped(f"{sentence} {{page.back}} stops." if searching else sentence)


def list_text(best: BestPostures | None) -> str:
    """The best postures as a table, in metres and degrees."""
    if best is None:
        return NOT_YET
    table = new_table("", *COORDINATES)
    for number, posture in enumerate(best.coordinates.tolist(), start=1):
        places = (f"{value:z.4f}" for value in posture[:3])
        angles = (f"{math.degrees(value):z.2f}" for value in posture[3:])
        table.add_row(f"{number}", *places, *angles)
    return table_text(table)


def drawn_at_text(number: int, count: int) -> str:
    """The posture at which the machine is drawn."""
    where = "the middle of the box" if number == 0 else f"optimum posture {number} of {count}"
    turn = "   {hexaslide.next_posture} and {hexaslide.posture_before} draw the others"
    return f"Drawn at {where}.{turn * bool(count)}\n{DRAWING_WORDS}"
