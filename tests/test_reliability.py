"""docs/reliability.md names tests that exist."""

from __future__ import annotations

import ast
import re

from tests.conftest import ROOT

NAMED = re.compile(r"`(tests/[\w/]+\.py)(?:::(\w+))?`")


def test_every_promise_names_tests_that_exist() -> None:
    page = (ROOT / "docs" / "reliability.md").read_text(encoding="utf-8")
    rows = [line for line in page.splitlines() if line.startswith("| ") and "| promise" not in line]
    assert len(rows) > 30
    for row in rows:
        named = NAMED.findall(row.rsplit("|", 2)[1])
        assert named, row
        for path, function in named:
            tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
            functions = {n.name for n in tree.body if isinstance(n, ast.FunctionDef)}
            functions |= {n.name for n in tree.body if isinstance(n, ast.AsyncFunctionDef)}
            assert (
                function in functions
                if function
                else any(name.startswith("test_") for name in functions)
            ), f"{path}::{function}"
