"""docs/papers-line-by-line.csv and .md: equations, tables, figures and claims of the papers."""

from __future__ import annotations

import ast
import csv
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "papers-line-by-line.md"
TABLE = PAGE.with_suffix(".csv")
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

MISPRINTS = (
    *("[C] (1)", "[C] (4), root", "[C] (11), right side", "[P] (1)", "[P] (4), root"),
    *("[C] 2.4, α", "[C] 3.4", "[C] 3.4, α"),
    *("[C] table 1", "[C] table 2", "[C] table 2, experiment 3", "[C] table 1, table 2"),
)
"""Rows where the paper is wrong that the page has in its table of misprints, with more detail."""


@dataclass(frozen=True)
class Claim:
    where: str
    what: str
    verdict: str
    here: str
    shown_by: str


def claims() -> list[Claim]:
    with TABLE.open(encoding="utf-8", newline="") as file:
        first, *rows = csv.reader(file)
    assert first == ["where", "what", "verdict", "here", "shown by"]
    return [Claim(*row) for row in rows]


CLAIMS = claims()


@cache
def names_in(path: str) -> frozenset[str]:
    """Functions and classes of a file, methods as ``Class.method``."""
    file = ROOT / path
    assert file.is_file(), f"{path} is not there"
    if file.suffix != ".py":
        return frozenset()
    names = set()
    for node in ast.parse(file.read_text(encoding="utf-8")).body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            names.add(node.name)
        if isinstance(node, ast.ClassDef):
            names |= {
                f"{node.name}.{method.name}"
                for method in node.body
                if isinstance(method, ast.FunctionDef)
            }
    return frozenset(names)


def there(reference: str) -> None:
    """A reference such as ``path.py::name`` or ``path`` names what exists."""
    for part in reference.split(", "):
        path, _, name = part.partition("::")
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


def test_the_page_has_the_counts_and_every_row_where_the_paper_is_wrong() -> None:
    text = PAGE.read_text(encoding="utf-8")
    counts = ", ".join(
        f"{sum(claim.verdict == verdict for claim in CLAIMS)} {verdict}" for verdict in VERDICTS
    )
    assert f"{len(CLAIMS)} rows: {counts}." in text
    wrong = [claim for claim in CLAIMS if claim.verdict == "paper wrong"]
    assert {claim.where for claim in wrong} >= set(MISPRINTS)
    misprints, _, below = text.partition("| where | wrong |\n|---|---|\n")
    assert below.splitlines() == [
        f"| {claim.where} | {claim.what} |" for claim in wrong if claim.where not in MISPRINTS
    ]
    table = misprints.partition("## Misprints")[2].partition("**Experiment 3.**")[0]
    for where in MISPRINTS:
        paper, _, part = where.partition(" ")
        assert f"{paper} {part.partition(',')[0]}" in table, where
