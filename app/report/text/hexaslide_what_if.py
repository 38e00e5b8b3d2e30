"""What a cause of some size would do to a session of postures, as the screen says it."""

from __future__ import annotations

from pathlib import Path

from app.report.text.hexaslide_diagnosis import title_of
from app.report.text.tables import new_table, table_text
from calib.hexaslide.what_if import CauseAtSize

WHICH = "Which cause?"


def cause_words(name: tuple[str, str], weight: float) -> str:
    """A line of the list of causes."""
    return f"{title_of(name)}, {100.0 * weight:.0f} %"


def heading_text(name: tuple[str, str], path: Path) -> str:
    """What is tried, on which readings."""
    return f"What if {title_of(name)}   {path.name}"


def effect_text(nominal: CauseAtSize, now: CauseAtSize) -> str:
    """Residuals and platform, without the cause and with it."""
    table = new_table("", "without", "with it")
    pair = nominal, now
    table.add_row("readings left, times the noise", *(f"{entry.times_noise:.2f}" for entry in pair))
    table.add_row("chance of so much by noise", *(f"{entry.p_value:.2g}" for entry in pair))
    table.add_row("platform, cause not compensated, mm r.m.s.", "0", _mm(now.alone_m))
    table.add_row("platform, values without it entered, mm r.m.s.", "0", _mm(now.misled_m))
    return table_text(table)


def _mm(size_m: float) -> str:
    return f"{1000.0 * size_m:.4f}"
