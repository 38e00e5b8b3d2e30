"""What is timed, and tables of a run put in their places on a page of Markdown."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence

from benchmarks.pictures import cells

Table = list[str]


def seconds(work: Callable[[], object], rounds: int = 7) -> float:
    """Median time of one call."""
    taken = []
    for _ in range(rounds):
        start = time.perf_counter()
        work()
        taken.append(time.perf_counter() - start)
    return statistics.median(taken)


def tables_of(lines: Sequence[str]) -> list[Table]:
    """The tables among lines, in their order."""
    found: list[Table] = []
    before = ""
    for line in lines:
        if line.startswith("|"):
            if not before.startswith("|"):
                found.append([])
            found[-1].append(line)
        before = line
    return found


def with_tables(page: str, tables: Sequence[Table]) -> tuple[str, list[str]]:
    """The page with its tables replaced by those that have the same first heading.

    The second result are the first headings that the page does not have.
    """
    new = {cells(table[0])[0]: table for table in tables}
    lines, place = page.splitlines(), 0
    written: list[str] = []
    met: set[str] = set()
    for old in tables_of(lines):
        start = lines.index(old[0], place)
        heading = cells(old[0])[0]
        written += lines[place:start] + new.get(heading, old)
        met.add(heading)
        place = start + len(old)
    return "\n".join([*written, *lines[place:]]) + "\n", [name for name in new if name not in met]


def with_versions(page: str, versions: str) -> str:
    """The page with the line that tells the versions replaced."""
    return (
        "\n".join(versions if line.startswith("Python 3") else line for line in page.splitlines())
        + "\n"
    )
