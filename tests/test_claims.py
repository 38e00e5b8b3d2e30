"""The table of docs/papers-line-by-line.md: equations, tables, figures and claims of the papers."""

from __future__ import annotations

import ast
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
HEADING = "## Every claim of the papers"
VERDICTS = ("works", "paper wrong", "not applicable", "open")
PARTS = {
    "[C]": [
        *(f"({k})" for k in range(1, 15)),
        *(f"fig. {k}" for k in ("1", "2", "3", "4a", "4b", "5")),
        *(f"table {k}" for k in range(1, 4)),
        *("2.1", "2.2", "2.3", "2.4", "3.1", "3.2", "3.4", "4.1", "4.2", "5"),
    ],
    "[P]": [
        *(f"({k})" for k in range(1, 11)),
        *(f"fig. {k}" for k in range(1, 6)),
        "table 1",
        "4",
        "5",
    ],
    "[H]": [
        *(f"({k})" for k in range(1, 11)),
        *(f"fig. {k}" for k in range(1, 5)),
        *(f"table {k}" for k in range(1, 7)),
        *("2.2", "2.3", "3.1", "3.2", "3.3", "3.4", "3.5", "4", "4.1", "4.2", "abstract"),
    ],
}
"""Everything numbered in papers/000 [C], papers/002 [P] and papers/001 [H], and each section."""


@dataclass(frozen=True)
class Claim:
    where: str
    what: str
    verdict: str
    here: str
    shown_by: str


def claims() -> list[Claim]:
    text = (ROOT / "docs" / "papers-line-by-line.md").read_text(encoding="utf-8")
    lines = text.partition(HEADING)[2].splitlines()
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in lines
        if line.startswith("|")
    ]
    assert rows[0] == ["where", "what", "verdict", "here", "shown by"]
    return [Claim(*row) for row in rows[2:]]


CLAIMS = claims()


@cache
def names_in(path: str) -> frozenset[str]:
    """Functions and classes of a file, methods as ``Class.method``."""
    file = ROOT / path
    assert file.is_file(), f"{path} is not there"
    if file.suffix != ".py":
        return frozenset()
    found = set()
    for node in ast.parse(file.read_text(encoding="utf-8")).body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            found.add(node.name)
        if isinstance(node, ast.ClassDef):
            found |= {
                f"{node.name}.{one.name}" for one in node.body if isinstance(one, ast.FunctionDef)
            }
    return frozenset(found)


def there(reference: str) -> None:
    """A reference such as ```path.py::name``` or ```path``` names what exists."""
    for one in reference.split(", "):
        path, _, name = one.strip("`").partition("::")
        assert not name or name in names_in(path), f"{path} has no {name}"
        names_in(path)


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: claim.where)
def test_a_row_names_what_exists(claim: Claim) -> None:
    assert claim.verdict in VERDICTS
    assert claim.where.startswith(tuple(PARTS))
    if claim.verdict in ("works", "paper wrong"):
        assert "::test_" in claim.shown_by, "a test function shows it"
        there(claim.shown_by)
    if claim.verdict == "works" or claim.here != "–":
        there(claim.here)
    if claim.verdict in ("open", "not applicable"):
        assert claim.shown_by != "–", "the reason stands there"
        assert "::" not in claim.shown_by


def test_every_part_of_the_papers_has_a_row() -> None:
    """Each row begins with the paper and the part, such as ``[C] (4)``; each pair stands once."""
    listed = [claim.where for claim in CLAIMS]
    for paper, parts in PARTS.items():
        for part in parts:
            assert any(
                where == f"{paper} {part}"
                or where.startswith((f"{paper} {part},", f"{paper} {part} "))
                for where in listed
            ), f"{paper} {part} has no row"
    pairs = [(claim.where, claim.what) for claim in CLAIMS]
    assert len(set(pairs)) == len(pairs)


def test_the_counts_above_the_table_are_those_of_its_rows() -> None:
    text = (ROOT / "docs" / "papers-line-by-line.md").read_text(encoding="utf-8")
    counts = ", ".join(
        f"{sum(claim.verdict == verdict for claim in CLAIMS)} {verdict}" for verdict in VERDICTS
    )
    assert f"{len(CLAIMS)} rows: {counts}." in text
