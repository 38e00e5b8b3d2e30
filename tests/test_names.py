"""Names of values are nouns of the field: a reader can look for them."""

from __future__ import annotations

import ast
from collections import Counter

import pytest

from benchmarks.structure import NO_NOUNS, PLAIN, names_of
from tests.conftest import ROOT

MOST = 0.01
"""Of all names of values and arguments; elsewhere in the field it is 0.1 to 1.2 %."""


@pytest.mark.parametrize(
    ("rooms", "no_nouns"),
    [
        (("app", "calib", "drivers", "protocols", "glidecal"), NO_NOUNS),
        (("tests", "benchmarks", "studies"), NO_NOUNS.difference(PLAIN.split())),
    ],
    ids=["rooms", "beside-them"],
)
def test_names_are_nouns(rooms: tuple[str, ...], no_nouns: frozenset[str]) -> None:
    count, places = 0, Counter[str]()
    for path in (path for room in rooms for path in (ROOT / room).rglob("*.py")):
        for name in names_of(ast.parse(path.read_text(encoding="utf-8"))):
            count += 1
            places[path.relative_to(ROOT).as_posix()] += name in no_nouns
    share = places.total() / count
    assert share <= MOST, f"{share:.2%}; most in {places.most_common(5)}"
