"""Names of values are nouns of the field: a reader can look for them."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterator

from tests.conftest import ROOT

ROOMS = ("app", "calib", "drivers", "protocols", "glidecal", "tests", "benchmarks", "studies")

LIST = (
    "found one said told held own known asked shown given other left rest it them taken wanted "
    "made seen kept every some both each more most whole these those that this others another same"
)
NO_NOUNS = frozenset(LIST.split())
"""Participles and pronouns, which say nothing of what a value is."""

MOST = 0.01
"""Of all names of values and arguments; elsewhere in the field it is 0.1 to 1.2 %."""


def names_of(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id.strip("_")
        elif isinstance(node, ast.arg):
            yield node.arg.strip("_")


def test_names_are_nouns() -> None:
    count, places = 0, Counter[str]()
    for path in (path for room in ROOMS for path in (ROOT / room).rglob("*.py")):
        for name in names_of(ast.parse(path.read_text(encoding="utf-8"))):
            count += 1
            places[path.relative_to(ROOT).as_posix()] += name in NO_NOUNS
    share = places.total() / count
    assert share <= MOST, f"{share:.2%}; most in {places.most_common(5)}"
