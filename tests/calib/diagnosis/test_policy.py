"""The table of choices on the page of the diagnosis is the one of the code."""

from __future__ import annotations

import ast
from dataclasses import fields
from pathlib import Path

import pytest

from calib.diagnosis.policy import POLICY, Policy

ROOT = Path(__file__).parents[3]


def as_table(policy: Policy) -> str:
    """The choices as a table in Markdown."""
    head = ["| choice | value | of what | why |", "|---|---|---|---|"]
    return "\n".join(
        head
        + [
            f"| `{one.name}` | {getattr(policy, one.name):g} {one.metadata['unit']}"
            f" | {one.metadata['decides']} | {one.metadata['reason']} |"
            for one in fields(policy)
        ]
    )


def test_the_page_holds_the_choices_of_the_code() -> None:
    page = (ROOT / "docs" / "diagnosis.md").read_text(encoding="utf-8")
    assert as_table(POLICY) in page
    assert as_table(Policy(wild_sd=POLICY.wild_sd + 1.0)) not in page


def test_every_choice_is_used() -> None:
    """A choice that nothing reads decides nothing."""
    used = {
        node.attr
        for path in (ROOT / "calib" / "diagnosis").glob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Attribute)
        and isinstance(node.value, ast.Name)
        and node.value.id == "POLICY"
    }
    derived = {name for name, one in vars(Policy).items() if isinstance(one, property)}
    assert used == {one.name for one in fields(Policy)} | derived


def test_there_are_few_choices_and_a_doubt_is_half_the_evidence() -> None:
    assert len(fields(Policy)) <= 15
    assert POLICY.doubtful_odds**2 == pytest.approx(POLICY.odds)
