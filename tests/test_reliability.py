"""docs/reliability.csv names tests that exist, and those of the page are among its promises."""

from __future__ import annotations

import ast
import csv
import re

from tests.conftest import ROOT

PAGE = ROOT / "docs" / "reliability.md"
NAMED = re.compile(r"(tests/[\w/]+\.py)(?:::(\w+))?")


def promises() -> list[dict[str, str]]:
    with PAGE.with_suffix(".csv").open(encoding="utf-8", newline="") as table:
        return list(csv.DictReader(table))


def test_every_promise_names_tests_that_exist() -> None:
    assert len(promises()) > 90
    for row in promises():
        parts = row["tests"].split(", ")
        matches = [match for part in parts if (match := NAMED.fullmatch(part))]
        assert len(matches) == len(parts), row
        for path, function in (reference.groups() for reference in matches):
            tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
            functions = {n.name for n in tree.body if isinstance(n, ast.FunctionDef)}
            functions |= {n.name for n in tree.body if isinstance(n, ast.AsyncFunctionDef)}
            assert (
                function in functions
                if function
                else any(name.startswith("test_") for name in functions)
            ), f"{path}::{function}"


def test_what_the_page_promises_is_in_the_table_with_its_tests() -> None:
    section, listed = "", []
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        if line.startswith("## "):
            section = line.removeprefix("## ")
        if line.startswith("- "):
            listed.append((section, line.removeprefix("- ")))
    assert len(listed) > 40
    assert set(listed) <= {(row["section"], row["promise"]) for row in promises()}
