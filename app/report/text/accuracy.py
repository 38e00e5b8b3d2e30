"""Tolerance, maps and Monte Carlo in words."""

from __future__ import annotations

from app.evaluating.accuracy import Judgement
from app.report.text.tables import new_table, table_text, wrapped
from calib.identify.accuracy import ToolMap
from calib.identify.monte_carlo import MonteCarlo

WORDS = {"pass": "passes", "fail": "fails", "undecided": "cannot be decided"}


def judged_text(judged: Judgement) -> str:
    """Against the tolerance, with the guard band."""
    return wrapped(
        f"Tolerance {judged.tolerance_mm:g} mm for the tool, r.m.s., with a guard band of the "
        f"expanded uncertainty: now it {WORDS[judged.before]}, with these values it "
        f"{WORDS[judged.after]}."
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
