"""Lengths as bars of characters, with a mark where a limit is."""

from __future__ import annotations

from collections.abc import Sequence

from app.report.text.tables import uncertain

EIGHTHS = " ▏▎▍▌▋▊▉"
FULL, MARK = "█", "│"
WIDTH_WITHOUT_BARS, SHORTEST, LONGEST = 22, 8, 54
"""Columns of names and figures beside the bars, and how long the longest bar may be."""


def now_and_after(
    now_mm: float, after_mm: float | None, tolerance_mm: float | None, columns: int
) -> list[str]:
    """A bar for an error now and one for that afterwards, mm, against the tolerance.

    ``columns`` is the width of all; what is None is not known, or not stated.
    """
    pairs = (("now", now_mm), ("after", after_mm))
    lengths = [(name, f"{uncertain(mm)} mm", mm) for name, mm in pairs if mm is not None]
    limit = (f"tolerance {tolerance_mm:g} mm", tolerance_mm) if tolerance_mm else None
    return bar_rows(lengths, min(LONGEST, max(SHORTEST, columns - WIDTH_WITHOUT_BARS)), limit)


def bar_rows(
    lengths_mm: Sequence[tuple[str, str, float]],
    columns: int,
    limit: tuple[str, float] | None = None,
) -> list[str]:
    """A row for each name, figure and length, in mm; all from 0 on, on one scale.

    ``limit`` are words and a length: a mark through every bar, with the words below. ``columns``
    is the width of the longest bar.
    """
    most_mm = max(*(mm for *_, mm in lengths_mm), limit[1] if limit else 0.0)
    cells = (columns - 1) / most_mm if most_mm > 0.0 else 0.0
    mark = round(limit[1] * cells) if limit else None
    name_width = max(len(name) for name, _, _ in lengths_mm)
    figure_width = max(len(figure) for _, figure, _ in lengths_mm)
    rows = []
    for name, figure, mm in lengths_mm:
        bar = _bar(mm * cells).ljust(columns)
        if mark is not None:
            bar = bar[:mark] + MARK + bar[mark + 1 :]
        rows.append(f"{name:<{name_width}}  {figure:>{figure_width}}  {bar}".rstrip())
    if limit is not None and mark is not None:
        indent, limit_label = name_width + figure_width + 4, limit[0]
        right = mark + 2 + len(limit_label) <= columns
        caption = f"{MARK} {limit_label}" if right else f"{limit_label} {MARK}"
        start = mark if right else mark + 1 - len(caption)
        rows.append(" " * max(0, indent + start) + caption)
    return rows


def _bar(cells: float) -> str:
    """A bar of so many cells; what is not nothing is seen."""
    eighths = round(8.0 * cells)
    eighths = max(eighths, 1) if cells > 0.0 else 0
    return FULL * (eighths // 8) + EIGHTHS[eighths % 8].strip()
