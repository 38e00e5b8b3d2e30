"""Which tests a small error meets, and what the page states of the errors that were tried."""

from __future__ import annotations

import ast
import csv
import re
from collections import Counter

import pytest

from benchmarks.mutation import LineTests, Mutant, annotation_spans
from tests.conftest import ROOT

PAGE = ROOT / "docs" / "reliability.md"
STATS = "tests/calib/test_stats.py::"
RACE = "tests/calib/posterior/test_selection.py::"
FIRST, LAST = 11, 15
"""Lines of a function in the middle of its module."""


def mutants() -> list[dict[str, str]]:
    with (ROOT / "docs" / "mutants.csv").open(encoding="utf-8", newline="") as table:
        return list(csv.DictReader(table))


@pytest.fixture
def tests(monkeypatch: pytest.MonkeyPatch) -> LineTests:
    monkeypatch.setattr("benchmarks.mutation.function_lines", lambda _: (FIRST, LAST))
    names = [f"{STATS}slow", f"{STATS}quick", f"{STATS}beside", f"{RACE}other", f"{RACE}far"]
    seconds = dict(zip(names, (5.0, 1.0, 0.1, 0.5, 0.2), strict=True))
    slow, quick, _, other, far = names
    lines = {12: {slow, quick, other}, 14: {quick}, 40: {far}}
    return LineTests(seconds, {"calib/stats.py": lines})


@pytest.mark.parametrize(
    ("line", "limit_s", "expected"),
    [
        (12, 99.0, ["quick", "slow", "other", "beside", "far"]),  # its own file first
        (12, 2.0, ["quick", "other", "beside", "far"]),  # what is too slow is left out
        (14, 99.0, ["quick", "beside", "slow"]),
        (13, 99.0, ["quick", "slow", "other", "beside", "far"]),  # all that reach its function
        (41, 99.0, ["quick", "slow", "other", "beside", "far"]),
    ],
)
def test_an_error_meets_the_tests_that_reach_its_line_then_those_beside(
    tests: LineTests, line: int, limit_s: float, expected: list[str]
) -> None:
    mutant = Mutant("calib/stats.py", line, 0, "core/AddNot", 0)
    tests_of_mutant = tests.of(mutant, limit_s)
    assert [name.partition("::")[2] for name in tests_of_mutant] == expected
    assert tests.of(Mutant("calib/other.py", 1, 0, "core/AddNot", 0), limit_s) == []


def test_annotations_of_functions_have_no_errors() -> None:
    source = "x: int | None = 1\ndef f(a: int | None, *b: str) -> int | None:\n    c: int = 1\n"
    spots = [((2, 9), (2, 19)), ((2, 25), (2, 28)), ((2, 33), (2, 43)), ((3, 7), (3, 10))]
    assert sorted(annotation_spans(ast.parse(source))) == spots


def test_errors_that_were_not_seen_have_a_test_now_or_a_reason() -> None:
    for row in mutants():
        assert (ROOT / row["module"]).exists()
        path, _, name = row["test or reason"].partition("::")
        if row["outcome"] == "seen now":
            tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
            assert name in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
        else:
            assert row["outcome"] in ("no effect", "not seen")
            assert not name


def test_the_page_has_their_numbers() -> None:
    text = " ".join(PAGE.read_text(encoding="utf-8").split())
    outcomes = Counter(row["outcome"] for row in mutants())
    figures = re.search(
        r"puts (\d+) small errors into .*?: (\d+) change nothing, "
        r"at least (\d+) were seen at first "
        r"\((\d+) % of the others; [^)]*\), (\d+) are seen now \((\d+) %\), (\d+) are not\.",
        text,
    )
    assert figures is not None
    tried, nothing, before, percent, now, percent_now, left = map(int, figures.groups())
    assert (nothing, left) == (outcomes["no effect"], outcomes["not seen"])
    assert now == before + outcomes["seen now"] == tried - nothing - left
    others = tried - nothing
    assert (percent, percent_now) == (round(100 * before / others), round(100 * now / others))
