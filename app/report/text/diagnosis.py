"""A diagnosis in words and tables."""

from __future__ import annotations

import math
from textwrap import fill

from app.evaluating.diagnosis import SessionDiagnosis
from app.report.text.tables import WIDTH, new_table, table_text, wrapped
from calib.diagnosis.results import (
    Contender,
    Diagnosis,
    Finding,
    HeldOutGap,
    ModelDiscrepancy,
    Share,
    Value,
)
from calib.ties import descending

SHOWN_CANDIDATES = 8
SHOWN_SHARES = 6
BAR = 20
SHOWN_MM = 0.00005
"""A gap below this is shown as nothing."""


def diagnosis_text(diagnosed: SessionDiagnosis) -> str:
    """The verdict first, then what supports it."""
    found = diagnosed.diagnosis
    parts = [wrapped(f"{found.verdict.upper()}. {found.sentence}")]
    parts.append(wrapped(gap_text(found)))
    if found.effects:
        parts.append(effects_text(found.effects))
    if found.held_out:
        parts.append(wrapped(held_out_words(found.held_out)))
    if found.left_over:
        parts.append(left_over_text(found.left_over))
    if found.next_measurement:
        parts.append(wrapped(f"Next measurement: {found.next_measurement.reason}."))
    parts.append("Where it disagrees\n" + shares_text(found.where))
    if found.candidates:
        parts.append("Candidates, best first\n" + candidates_text(found.candidates))
    if found.verdict == "agrees":
        parts.append(detectable_text(diagnosed))
    parts += [wrapped(f"Remark: {remark}") for remark in found.remarks]
    return "\n\n".join(parts)


def gap_text(found: Diagnosis) -> str:
    """The gap in the readings and its chance, before and after what was named or guessed."""
    before, after, noise_mm = found.gap_before, found.gap_after, found.noise_mm
    said = (
        f"Gap {before.rms_mm:.4f} mm r.m.s. beyond the scatter of repeats (noise of a reading "
        f"{noise_mm:.4f} mm), {before.degrees_of_freedom} degrees of freedom, chance "
        f"{chance(before.p_value)}."
    )
    if after != before:
        added = "what was named" if found.effects else "the best guess"
        said += f"\nWith {added}: {after.rms_mm:.4f} mm, chance {chance(after.p_value)}."
    return said


def chance(p_value: float) -> str:
    """A p-value in words."""
    return f"{p_value:.2f}" if p_value >= 0.01 else f"{p_value:.0e}" if p_value > 1e-99 else "none"


def effects_text(findings: tuple[Finding, ...]) -> str:
    """Named effects with their values, and what looks the same."""
    lines = []
    for one in findings:
        lines.append(f"{one.id} ({one.where}), {one.kind}: {one.title}")
        lines += [f"    {value_words(value)}" for value in one.parameters]
        lines.append(f"    gap {one.gap_rms_before_mm:.4f} → {one.gap_rms_after_mm:.4f} mm")
        if one.indistinguishable_from:
            rivals = ", ".join(f"{r.id} ({r.where})" for r in one.indistinguishable_from)
            lines.append(f"    these data cannot tell it from: {rivals}")
    return "\n".join(wrapped(line) if not line.startswith(" ") else hanging(line) for line in lines)


def hanging(line: str) -> str:
    """A long indented line broken with the same indent."""
    indent = line[: len(line) - len(line.lstrip())]
    return fill(line, WIDTH, subsequent_indent=indent, break_long_words=False)


def left_over_text(left: ModelDiscrepancy) -> str:
    """The unnamed law of what is left, its values, and what it would take away."""
    law = left.law
    begin = (
        "A law without a name explains all, in place of what was named"
        if left.whole
        else "What is left has no name, but follows a law"
    )
    lines = [wrapped(f"{begin}: {law.title}.")]
    lines += [f"    {value_words(value)}" for value in law.parameters]
    lines.append(f"    gap {law.gap_rms_before_mm:.4f} → {law.gap_rms_after_mm:.4f} mm")
    if left.held_out:
        lines.append(hanging("    " + held_out_words(left.held_out)))
    return "\n".join(lines)


def value_words(value: Value) -> str:
    """A parameter with its standard uncertainty, both to two figures of the uncertainty."""
    u = value.standard_uncertainty
    places = decimals(u)
    return f"{value.name} = {value.value:+.{places}f} ± {u:.{places}f} {value.unit}"


def decimals(size: float) -> int:
    """Decimals that show two significant figures of a size."""
    return max(0, 1 - math.floor(math.log10(size))) if size > 0.0 else 4


def figures(size: float) -> str:
    """A size to two significant figures, without an exponent."""
    rounded = float(f"{size:.1e}")
    return f"{rounded:.{decimals(rounded)}f}"


def held_out_words(held: HeldOutGap) -> str:
    """Whether the gap shrinks on what the choice did not see."""
    said = (
        f"Held out ({held.how}): {held.before_rms_mm:.4f} → {held.after_rms_mm:.4f} mm, "
        f"noise {held.noise_rms_mm:.4f} mm."
    )
    if held.before_rms_mm < SHOWN_MM:
        return said + " There is no gap that could shrink."
    if held.after_rms_mm >= held.before_rms_mm:
        said += " The gap shrinks only on the readings that were used."
    return said


def shares_text(shares: tuple[Share, ...]) -> str:
    """The parts of the readings where the gap lies."""
    table = new_table("part", "share", "", "chance", left=1)
    for share in shares[:SHOWN_SHARES]:
        bar = "█" * round(BAR * min(share.share, 1.0))
        table.add_row(part_words(share), f"{share.share:.0%}", bar, chance(share.p_value))
    return table_text(table)


def part_words(share: Share) -> str:
    """Leg, axis or pattern."""
    if share.leg == "tool":
        return f"the tool along {share.axis.upper()}"
    if share.leg and share.axis:
        return f"leg {share.leg.upper()} along {share.axis.upper()}"
    if share.leg:
        return f"leg {share.leg.upper()}"
    return f"axis {share.axis.upper()}" if share.axis else share.pattern


def candidates_text(candidates: tuple[Contender, ...]) -> str:
    """The race, with what each would leave."""
    held = any(one.held_out_gap_rms_mm is not None for one in candidates)
    columns = ["effect", "where", "gap left, mm", *(["held out, mm"] if held else []), ""]
    table = new_table(*columns, left=2)
    for one in _shown(candidates):
        row = [one.id, one.where, f"{one.gap_rms_after_mm:.4f}"]
        if held:
            left = one.held_out_gap_rms_mm
            row.append("" if left is None else f"{left:.4f}")
        table.add_row(*row, one.reason_rejected or "named")
    return table_text(table)


def _shown(candidates: tuple[Contender, ...]) -> tuple[Contender, ...]:
    """The first ones, and the one that does most for readings it never saw."""
    first, rest = candidates[:SHOWN_CANDIDATES], candidates[SHOWN_CANDIDATES:]
    held = [one for one in candidates if one.held_out_gap_rms_mm is not None]
    best = descending(held, lambda one: -(one.held_out_gap_rms_mm or 0.0))[:1]
    return (*first, *(one for one in best if one in rest))


def detectable_text(diagnosed: SessionDiagnosis) -> str:
    """What would have been found."""
    table = new_table("would have been found", "from", "", left=1)
    for one in diagnosed.diagnosis.smallest_detectable:
        table.add_row(one.id, figures(one.size), one.unit)
    return table_text(table)
