"""What is timed, tables of a run put in their places on a page of Markdown, their bars as SVG.

A picture shows the same figures as the page; the words around its tables stay. Rich draws the bars
and writes the SVG, as for the pictures of the screens.
"""

from __future__ import annotations

import math
import re
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

from rich.bar import Bar
from rich.console import Console
from rich.table import Table as Grid
from rich.text import Text

WIDTH, NAME_WIDTH, BAR_WIDTH = 126, 68, 40
OURS, PEERS = "bright_cyan", "bright_black"
WIDE_SPAN = 10.0
"""Values that differ by more stand on a logarithmic scale."""


Table = list[str]


def seconds(work: Callable[[], object], rounds: int = 7) -> float:
    """Median time of one call."""
    times = []
    for _ in range(rounds):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def tables_of(lines: Sequence[str]) -> list[Table]:
    """The tables among lines, in their order."""
    tables: list[Table] = []
    before = ""
    for line in lines:
        if line.startswith("|"):
            if not before.startswith("|"):
                tables.append([])
            tables[-1].append(line)
        before = line
    return tables


def with_tables(page: str, tables: Sequence[Table]) -> tuple[str, list[str]]:
    """The page with its tables replaced by those that have the same first heading.

    The second result are the first headings that the page does not have.
    """
    new = {cells(table[0])[0]: table for table in tables}
    lines, place = page.splitlines(), 0
    page_lines: list[str] = []
    met: set[str] = set()
    for old in tables_of(lines):
        start = lines.index(old[0], place)
        heading = cells(old[0])[0]
        page_lines += lines[place:start] + new.get(heading, old)
        met.add(heading)
        place = start + len(old)
    return "\n".join([*page_lines, *lines[place:]]) + "\n", [
        name for name in new if name not in met
    ]


def with_versions(page: str, versions: str) -> str:
    """The page with the line that tells the versions replaced."""
    return (
        "\n".join(versions if line.startswith("Python 3") else line for line in page.splitlines())
        + "\n"
    )


def cells(line: str) -> list[str]:
    """The cells of a row of Markdown."""
    return [cell.strip() for cell in line.strip().strip("|").split("|")]


@dataclass(frozen=True)
class Drawn:
    """Which columns of which table become bars.

    ``table`` begins the first heading; the first ``names`` cells name a row.
    """

    picture: str
    table: str
    columns: tuple[str, ...]
    names: int = 1


DRAWN = (
    Drawn("bench_kinematics", "direct kinematics", ("ratio",)),
    Drawn("bench_identification", "one session", ("ms",)),
    Drawn("bench_postures", "12 of 1000", ("ms", "determinant / best, median")),
    Drawn("bench_hexaslide", "H60", ("median", "s a start"), names=2),
    Drawn("bench_indicators", "request → value", ("median, ms", "p99, ms")),
)


@dataclass(frozen=True)
class Row:
    """A bar; without a value where the program is not installed."""

    name: str
    shown: str
    value: float | None


def rows_of(table: Sequence[str], column: str, names: int = 1) -> list[Row]:
    """Names and values of one column of a Markdown table."""
    place = cells(table[0]).index(column)
    rows = []
    for line in table[2:]:
        row = cells(line)
        text = row[place]
        number = re.fullmatch(r"[\d.,]+(e[+-]?\d+)?", text)
        value = float(text.replace(",", "")) if number else None
        rows.append(Row(", ".join(row[:names]), text, value))
    return rows


def shares(rows: Sequence[Row]) -> tuple[list[float], bool]:
    """Length of each bar as a share of the longest, and whether the scale is logarithmic.

    A logarithmic scale begins at the decade below the least value.
    """
    values = [row.value for row in rows if row.value]
    least, largest = min(values, default=1.0), max(values, default=1.0)
    if largest / least <= WIDE_SPAN:
        return [(row.value or 0.0) / largest for row in rows], False
    first = math.ceil(math.log10(least)) - 1
    span = math.log10(largest) - first
    lengths = [(math.log10(row.value) - first) / span if row.value else 0.0 for row in rows]
    return lengths, True


def panel(rows: Sequence[Row], column: str) -> Grid:
    """One column as bars."""
    lengths, logarithmic = shares(rows)
    table = Grid(box=None, pad_edge=False)
    table.add_column("", width=NAME_WIDTH)
    table.add_column(column + (", logarithmic" if logarithmic else ""), width=BAR_WIDTH)
    table.add_column("", justify="right", no_wrap=True)
    for row, length in zip(rows, lengths, strict=True):
        colour = OURS if "glidecal" in row.name or is_own(row.name) else PEERS
        bar = Bar(1.0, 0.0, length, width=BAR_WIDTH, color=colour)
        table.add_row(Text(row.name), bar, Text(row.shown))
    return table


def is_own(name: str) -> bool:
    """Rows of our own that do not carry the name of the program."""
    return name.startswith(("closed form", "trilateration", "through the owner thread"))


def svg(drawn: Drawn, table: Sequence[str]) -> str:
    """The picture of a Markdown table, without the addresses of web fonts."""
    console = Console(record=True, width=WIDTH, file=StringIO(), force_terminal=True)
    for column in drawn.columns:
        console.print(panel(rows_of(table, column, drawn.names), column))
        console.print()
    text = console.export_svg(title=cells(table[0])[0])
    return re.sub(r"@font-face \{.*?\}", "", text, flags=re.DOTALL)


def write_pictures(tables: Sequence[Sequence[str]], folder: Path) -> list[Path]:
    """One SVG for each table that is to be drawn."""
    folder.mkdir(parents=True, exist_ok=True)
    page_lines = []
    for drawn in DRAWN:
        for table in tables:
            if cells(table[0])[0].startswith(drawn.table):
                path = folder / f"{drawn.picture}.svg"
                path.write_text(svg(drawn, table), encoding="utf-8", newline="\n")
                page_lines.append(path)
    return page_lines
