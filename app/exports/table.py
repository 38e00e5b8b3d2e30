"""Rows as CSV: the only writer of such files."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Sequence
from io import StringIO

from calib.printable import printable
from protocols.table import NUMBER

FORMULA = re.compile(r"""["'\s]*[=+\-@]""")
"""A spreadsheet computes a cell that begins so, quotes left out."""

FORMULA_INSIDE = re.compile(rf"([,;]){FORMULA.pattern}")
"""A line of notes is not quoted, so a spreadsheet may find cells in it."""


def csv_text(rows: Iterable[Sequence[str]], notes: Iterable[str] = ()) -> str:
    """Notes as one ``#`` line each, then the rows. No text is a formula in a spreadsheet."""
    out = StringIO()
    for note in notes:
        line = printable(" ".join(note.split()))
        out.write("# " + FORMULA_INSIDE.sub(lambda found: f"{found[1]} '{found[0][1:]}", line))
        out.write("\n")
    csv.writer(out, lineterminator="\n").writerows(
        [_harmless(cell) for cell in row] for row in rows
    )
    return out.getvalue()


def _harmless(cell: str) -> str:
    """The text as a cell: what is no number and looks like a formula gets an apostrophe."""
    text = printable(cell)
    return f"'{text}" if FORMULA.match(text) and not NUMBER.fullmatch(text) else text
