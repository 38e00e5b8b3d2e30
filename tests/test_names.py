"""Names of values are nouns of the field: a reader can look for them."""

from __future__ import annotations

import ast
from collections import Counter

from benchmarks.structure import NO_NOUNS, names_of
from tests.conftest import ROOT

ROOMS = ("app", "calib", "drivers", "protocols", "glidecal", "tests", "benchmarks", "studies")

MOST = 0.01
"""Of all names of values and arguments; elsewhere in the field it is 0.1 to 1.2 %."""


def test_names_are_nouns() -> None:
    count, places = 0, Counter[str]()
    for path in (path for room in ROOMS for path in (ROOT / room).rglob("*.py")):
        for name in names_of(ast.parse(path.read_text(encoding="utf-8"))):
            count += 1
            places[path.relative_to(ROOT).as_posix()] += name in NO_NOUNS
    share = places.total() / count
    assert share <= MOST, f"{share:.2%}; most in {places.most_common(5)}"
