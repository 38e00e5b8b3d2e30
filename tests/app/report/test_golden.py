"""Texts that people read, compared with files; a changed text is a decision, not an accident.

To accept a changed text: GLIDECAL_GOLDEN=write pytest tests/app/report/test_golden.py
"""

from __future__ import annotations

import os

import pytest

from tests.app.cli import glidecal
from tests.conftest import ROOT, first_quick

GOLDEN = ROOT / "tests" / "golden"
SAMPLE = "sample_sessions/experiment_2_twelve.jsonl"
CONTACTS = "sample_sessions/every_schema/4/contacts.jsonl"
TEXTS: dict[str, tuple[str, ...]] = {
    "solve_linear": ("solve", SAMPLE, "--method", "linear", "--subset", "joint-offsets"),
    "solve_both": ("solve", SAMPLE, "--method", "linear", "--subset", "both"),
    "solve_exact": ("solve", SAMPLE),
    "solve_six": ("solve", "sample_sessions/experiment_1_six.jsonl", "--method", "linear"),
    "replay": ("replay", "sample_sessions/experiment_3_twelve.jsonl", "--headless"),
    "solve_contacts": ("solve", CONTACTS),
    "diagnose_contacts": ("diagnose", CONTACTS),
    **{
        f"macro_{dialect}": ("run", "--dry-run", "--machine", "linear-delta", "--macro", dialect)
        for dialect in ("klipper", "reprapfirmware", "marlin")
    },
    "dry_run": ("run", "--dry-run", "--protocol", "zero-max-min"),
}
SOLVED = ("solve_exact", "solve_linear", "solve_both")
"""Of one session, in three ways."""


@pytest.mark.parametrize(
    "name", first_quick(SOLVED) + [name for name in TEXTS if name not in SOLVED]
)
def test_text(name: str) -> None:
    run = glidecal(*TEXTS[name], cwd=GOLDEN.parent.parent)
    assert run.status == 0, run.err
    path = GOLDEN / f"{name}.txt"
    if os.environ.get("GLIDECAL_GOLDEN") == "write":
        path.write_text(run.out, encoding="utf-8", newline="\n")
    assert run.out == path.read_text(encoding="utf-8")
    assert max(map(len, run.out.splitlines())) <= 80
