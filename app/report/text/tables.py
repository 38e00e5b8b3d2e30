"""Tables and numbers as text, shared by every sentence and table."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from io import StringIO
from textwrap import fill
from typing import TYPE_CHECKING, TypeVar

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from calib.quantity import LEAST_MM as LEAST_MM
from calib.quantity import beside as beside
from calib.quantity import decimals as decimals
from calib.quantity import decimals_for as decimals_for
from calib.quantity import figures as figures
from calib.quantity import known_to as known_to
from calib.quantity import signed as signed
from calib.quantity import uncertain as uncertain
from protocols.data_table import DataTable

if TYPE_CHECKING:
    from calib.tripod.workspace import PlaneMap

R = TypeVar("R")

WIDTH = 76
"""Fits a terminal of 80 columns inside borders and scroll bar."""


HELP_WIDTH = 72
"""The same of a dialog with help."""


def expanded(value: float, standard_uncertainty: float) -> str:
    """A value ± its expanded uncertainty (95 %, k = 2), to two digits of that."""
    half = 2.0 * standard_uncertainty
    return f"{known_to(value, half)} ± {figures(half)}"


def new_table(*headings: str, left_columns: int = 1, rows: Iterable[Iterable[str]] = ()) -> Table:
    """A table; the first ``left_columns`` columns are text, the others numbers."""
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for number, heading in enumerate(headings):
        table.add_column(heading, justify="left" if number < left_columns else "right")
    for row in rows:
        table.add_row(*row)
    return table


def result_table(kind: type[R], results: Iterable[R] | Mapping[str, R], key: str = "") -> Table:
    """A row for each result of one kind, the columns that are for a reader; as `DataTable.of`.

    Texts before the first number are on the left.
    """
    result = DataTable.of(kind, results, key)
    left_columns = max(result.text_columns, 1)
    return new_table(*result.headings, left_columns=left_columns, rows=result.reader_rows())


def table_text(table: Table) -> str:
    """A table as plain text without blank edges; names from files are shown as they are."""
    out = StringIO()
    console = Console(
        file=out, width=WIDTH, color_system=None, markup=False, emoji=False, highlight=False
    )
    unlimited = console.options.update_width(10 * WIDTH)
    if console.measure(table, options=unlimited).maximum > WIDTH:
        table.collapse_padding = True  # closer together, before anything is broken or cut off
    console.print(table)
    return "\n".join(line.rstrip() for line in out.getvalue().strip("\n").splitlines()).strip("\n")


def paragraphs(*parts: str | list[str] | Table) -> str:
    """Texts broken at the width of a terminal, lines as they are, tables; nothing of empty ones."""
    return "\n\n".join(filter(None, map(_paragraph, parts)))


def _paragraph(part: str | list[str] | Table) -> str:
    if isinstance(part, Table):
        return table_text(part)
    return "\n".join(part) if isinstance(part, list) else wrapped(part)


DIFFERENCE = re.compile(r"([xyz])_([xyz])([+-]?)")
"""Leg, axis and end of travel in the name of a difference; both ends where there is no sign."""

ENDS = {"+": "MAX", "-": "MIN", "": "MAX − MIN"}


def difference_words(name: str) -> str:
    """``y_x+`` as ``X along Y, MAX``: leg, axis, posture less Zero; other names as they are."""
    return DIFFERENCE.sub(
        lambda part: f"{part[2].upper()} along {part[1].upper()}, {ENDS[part[3]]}", name
    )


def map_table(plane: PlaneMap, value_words: Callable[[float], str]) -> Table:
    """Values on a plane through Zero; a dash where the tool does not reach."""
    places = (f"{v:+z.0f}" for v in plane.coordinate_mm)
    table = new_table(f"{plane.up} \\ {plane.across}, mm", *places)
    for k in range(len(plane.up_mm) - 1, -1, -1):
        row = ("–" if math.isnan(v) else value_words(v) for v in plane.value[k])
        table.add_row(f"{plane.up_mm[k]:+z.0f}", *row)
    return table


def wrapped(text: str) -> str:
    """Every line of the text broken at the width of a plain terminal."""
    return "\n".join(hanging(line, "") for line in text.splitlines())


def hanging(line: str, indent: str) -> str:
    """A long line broken at the same width, later lines set in; names stay whole.

    The id of a key has the width of a letter: that is what most keys have that take its place.
    """
    ids = iter([hit[0] for hit in KEPT_WHOLE.finditer(line)])
    broken = fill(
        KEPT_WHOLE.sub(ONE_LETTER, line),
        WIDTH,
        subsequent_indent=indent,
        break_long_words=False,
        break_on_hyphens=False,
    )
    return re.sub(ONE_LETTER, lambda _: next(ids), broken)


def free_words(degrees: float, counted: float | None = None) -> str:
    """Degrees of freedom: all digits of the whole ones, however many.

    They are effective (GUM G.4) where they are no whole number, or not those that were ``counted``.
    """
    degrees_words = f"{degrees:.0f}" if degrees >= 100.0 else f"{degrees:.3g}"
    counted = round(degrees) if counted is None else counted
    effective = "" if math.isclose(degrees, counted, rel_tol=1e-6) else "effective "
    return f"{degrees_words} {effective}degrees of freedom"


KEY_ID = re.compile(r"\{([a-z_-]+\.[a-z0-9_-]+)\}")
"""A key in a text for people, by the id of its binding."""

ONE_LETTER = "\ue000"
"""Of private use: a name may have it, and then it takes its own place."""

KEPT_WHOLE = re.compile(f"{KEY_ID.pattern}|{ONE_LETTER}")
"""What has the width of one letter while a line is broken."""


def keyed(text: str, key: Callable[[str], str | None]) -> str:
    """The text with the ``key`` of each id; lines that begin with one become rows of a table."""
    lines = [KEY_ID.sub(lambda id_: key(id_[1]) or id_[0], line) for line in text.splitlines()]
    rows = [k for k, line in enumerate(text.splitlines()) if line[:1] == "{" and "  " in line]
    cells = {k: lines[k].partition("  ")[::2] for k in rows}
    width = 2 + max((len(keys) for keys, _ in cells.values()), default=0)
    for k, (keys, label) in cells.items():
        row, indent = f"{keys:<{width}}{label}", " " * width
        lines[k] = fill(row, HELP_WIDTH, subsequent_indent=indent, break_on_hyphens=False)
    return "\n".join(lines)


def copied_text(text: str) -> str:
    """How much was copied, and why it may not arrive."""
    return (
        f"{len(text.splitlines())} lines copied. If nothing arrives: some terminals do not allow "
        "it, and tmux needs `set-clipboard on`."
    )
