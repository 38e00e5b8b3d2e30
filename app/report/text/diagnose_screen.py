"""What the diagnosis screen says."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from app.evaluating.diagnosis import SessionDiagnosis
from app.report.text.diagnosis import (
    SHOWN_CANDIDATES,
    detectable_text,
    effects_text,
    gap_text,
    held_out_words,
    left_over_text,
    shares_text,
)
from app.report.text.tables import new_table, signed, table_text, wrapped
from calib.diagnosis.results import SEEN, Cell, Contender, Finding
from calib.tripod.effects.empirical import EMPIRICAL

DIAGNOSE_HELP = """\
1 2 3 4       Verdict, Where, Candidates, Before/after
Tab, arrows   the next page; up and down scroll it
A             adopt what was named, another effect that fits as well, or
              what is left as a law without a name: writes a model file
              and diagnoses again with it
N             write the next measurement, the one that separates what
              stayed ambiguous, as a procedure file
Y             copy the text of this page to the clipboard
Escape, F10   back, quit

Where shows what the model leaves of the readings at each place, in µm,
offsets, lengths and zeros fitted. ▲ and ▼ are more than noise, ▲▲ and ▼▼
much more. Adopting changes the model alone, never the readings."""

LOOKING = "Looking for what is missing …"
NOT_YET = "The diagnosis is not ready yet."
NOTHING_FOUND = "There is no diagnosis, so there is nothing to adopt, write or copy."
NOTHING_NAMED = (
    "Nothing to adopt: the diagnosis names no effect of the machine or its indicators, and what is "
    "left, if anything, follows no simple law."
)
NO_NEXT = "No measurement is proposed: nothing stayed ambiguous between two effects."
WHAT_TO_ADOPT = "What shall become part of the model?"
WHICH_FILE = "Write the model to which file?"

STRONG = 5.0
BAR = 10
MOST_RIVALS = 8

SHORT = {
    "no better than chance among so many candidates": "no more than chance",
    "another one explains it with more weight": "another weighs more",
}
"""Reasons that would not fit on the line of a candidate."""


def heading_text(names: Sequence[str], model: Path | None) -> str:
    """What is diagnosed, on one line."""
    against = f"model {model.name}" if model else "nominal machine"
    return f"{', '.join(names)}   against: {against}"


def verdict_text(diagnosed: SessionDiagnosis, adopted: str = "") -> str:
    """The sentence first, then what supports it; ``adopted`` says what a step before did."""
    found = diagnosed.diagnosis
    parts = [wrapped(f"{found.verdict.upper()}. {found.sentence}")]
    if adopted:
        parts.append(wrapped(adopted))
    if found.effects:
        parts.append(effects_text(found.effects))
    parts.append(wrapped(gap_text(found)))
    if found.held_out:
        parts.append(wrapped(held_out_words(found.held_out)))
    if found.left_over:
        parts.append(left_over_text(found.left_over))
    if found.next_measurement:
        parts.append(wrapped(f"Next measurement: {found.next_measurement.reason}. Key N."))
    if found.verdict == "agrees":
        parts.append(detectable_text(diagnosed))
    said = (*diagnosed.warnings, *found.remarks)
    return "\n\n".join([*parts, *(wrapped(f"Remark: {one}") for one in said)])


def problem_text(problem: Exception) -> str:
    """Why there is no diagnosis."""
    return wrapped(f"This cannot be diagnosed.\n\n{problem}")


def adopted_words(model: Path, before_rms_mm: float, now_rms_mm: float) -> str:
    """What adopting did to the gap."""
    return f"Adopted in {model.name}: gap {before_rms_mm:.4f} → {now_rms_mm:.4f} mm."


def where_text(diagnosed: SessionDiagnosis) -> str:
    """The residual map, a table for each station, and the shares of the gap."""
    cells = diagnosed.diagnosis.residuals.cells
    stations = sorted({cell.station for cell in cells})
    parts = []
    for station in stations:
        at = f", {station:.0%} from the tool end" if len(stations) > 1 else ""
        here = [cell for cell in cells if cell.station == station]
        parts.append(f"Mean residual of each leg, µm{at}\n{_map_text(here)}")
    parts.append(
        f"▲ ▼ more than {SEEN:.0f}, ▲▲ ▼▼ more than {STRONG:.0f} standard deviations of a mean"
        + ("\n↑ ↓ reached while moving up, down" if _both_ways(cells) else "")
    )
    parts.append("Where the gap lies\n" + shares_text(diagnosed.diagnosis.where))
    return "\n\n".join(parts)


def _touched(leg: str) -> str:
    return "tool" if leg == "tool" else f"leg {leg.upper()}"


def _map_text(cells: Sequence[Cell]) -> str:
    columns = list(dict.fromkeys((cell.leg, cell.axis) for cell in cells))
    both = _both_ways(cells)
    headings = [f"{_touched(leg)}\nalong {axis.upper()}" for leg, axis in columns]
    table = new_table("at, mm", *headings, left=0)
    held = {(c.leg, c.axis, c.displacement_mm, c.approach, c.position_mm or ()): c for c in cells}
    for displacement, approach, position in sorted({key[2:] for key in held}, reverse=True):
        arrow = {1: " ↑", -1: " ↓"}.get(approach, "  ") if displacement in both else ""
        row = [held.get((*column, displacement, approach, position)) for column in columns]
        place = f"{displacement:+.0f}" if displacement else "Zero"
        if any(position):
            place = ", ".join(f"{part:g}" for part in position)
        table.add_row(f"{place}{arrow}", *(_cell_text(one) for one in row))
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
    """The candidates, best first, with what each explains alone; then what looks the same."""
    found = diagnosed.diagnosis
    if not found.candidates:
        return "No effect of the catalogue shows in these readings."
    held = any(one.held_out_gap_rms_mm is not None for one in found.candidates)
    columns = ["effect", "where", "explains", "gap left", *(["held out"] if held else []), "why"]
    table = new_table(*columns, left=3)
    table.columns[-1].justify = "left"
    for one in found.candidates[:SHOWN_CANDIDATES]:
        table.add_row(*_ranked(one, held=held))
    parts = ["Candidates, best first; gaps in mm\n" + table_text(table)]
    parts += [wrapped(_alike(one)) for one in found.effects if one.effects]
    return "\n\n".join(parts)


def _ranked(one: Contender, *, held: bool) -> list[str]:
    bar = "█" * round(BAR * one.explained)
    row = [one.id, one.where, f"{bar:<{BAR}} {one.explained:>4.0%}"]
    row.append(f"{one.gap_rms_after_mm:.4f}")
    if held:
        left = one.held_out_gap_rms_mm
        row.append("" if left is None else f"{left:.4f}")
    return [*row, SHORT.get(one.reason_rejected, one.reason_rejected) or "named"]


def _alike(one: Finding) -> str:
    rivals = ", ".join(f"{r.id} ({r.where})" for r in one.indistinguishable_from)
    if not rivals:
        return f"No other effect looks like {one.id} ({one.where}) in these readings."
    return f"These readings cannot tell {one.id} ({one.where}) from: {rivals}."


def change_text(diagnosed: SessionDiagnosis) -> str:
    """The chart in one line."""
    found = diagnosed.diagnosis.residuals
    before, noise = 1000.0 * found.before_rms_mm, 1000.0 * found.noise_rms_mm
    if found.after_rms_mm is None:
        return wrapped(
            f"Mean residuals {before:.1f} µm r.m.s., their noise {noise:.1f} µm, drawn twice "
            "as large. This diagnosis names nothing to adopt."
        )
    return wrapped(
        f"Mean residuals {before:.1f} µm r.m.s. before, {1000.0 * found.after_rms_mm:.1f} µm after "
        f"adopting what was named; their noise {noise:.1f} µm, drawn twice as large."
    )


def adopt_choices(diagnosed: SessionDiagnosis) -> list[tuple[str, str]]:
    """What can be adopted: answers for a dialog with their words. The first is what was named.

    An answer is ``named``, ``empirical`` (what was named and the unnamed law of what is left), or
    a candidate as ``id:where``.
    """
    found = diagnosed.diagnosis
    named = [one for one in found.effects if one.effects]
    words = " and ".join(f"{one.id} ({one.where})" for one in named)
    rivals = {(r.id, r.where) for one in named for r in one.indistinguishable_from}
    others = [c for c in found.candidates if (c.id, c.where) in rivals and c.effects]
    choices = [("named", f"what was named: {words}")] if named else []
    if found.left_over:
        where = found.left_over.law.where
        also = f"{words} and what is left" if named else "what is left"
        whole = f"instead a law without a name ({where}), which explains all"
        law = whole if found.left_over.whole else f"{also}, as a law without a name ({where})"
        choices.append((EMPIRICAL, law))
    choices += [
        (f"{one.id}:{one.where}", f"instead {one.id} ({one.where})") for one in others[:MOST_RIVALS]
    ]
    return [(answer, f"{k}  {said}") for k, (answer, said) in enumerate(choices, start=1)]


def model_written(path: Path) -> str:
    """The file of a model, and what it is for."""
    return f"Model written: {path}. Diagnosing again with it."


def next_written(path: Path) -> str:
    """How to run the procedure."""
    return f"Written. Measure it with: glidecal run --protocol {path}"


def run_named(protocol: str) -> str:
    """A procedure that comes with the program needs no file."""
    return f"No file is needed: glidecal run --protocol {protocol}"


def taken_words(path: Path) -> str:
    """A file that is there already is not replaced."""
    return f"{path} is there already and is not replaced. Give another name."
