"""A quick part of the blind table: the diagnosis on sessions with hidden effects.

Limits are the targets of the whole table, loosened so far that a diagnosis which just meets them
fails less than once in a hundred runs; ``make blind`` makes the whole table.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.blind.bench_files import write_session
from tests.blind.cases import BLUNDERS, Case
from tests.blind.documents import of_the_program, row_of
from tests.blind.effects import EFFECT_IDS
from tests.blind.generator import make
from tests.blind.noise import NOISES
from tests.blind.scoring import (
    Scored,
    blunder_claimed,
    blunder_named,
    detectable,
    false_name,
    rate,
    truth_in_set,
    wrong_confident,
)
from tests.conftest import LONG

pytest.importorskip("app.evaluating.diagnosis", reason="there is no diagnosis to test yet")

SEED = 6


def diagnosed(cases: list[Case], folder: Path) -> list[Scored]:
    results = []
    for case in cases:
        session_made = make(case, SEED)
        session = folder / f"{case.session}.jsonl"
        write_session(session_made, session)
        row = row_of(of_the_program, session, case.without)
        results.append(Scored(session_made.truth, {"session": case.session, **row}))
    assert [score.row["error"] for score in results if score.verdict == "error"] == []
    return results


@LONG
def test_clean_sessions_get_no_name(tmp_path: Path) -> None:
    """12 sessions at 1 %: more than one false name happens in 0.6 % of runs."""
    cases = [Case(f"q/{p}/{n}", "none", p, n) for n in NOISES for p in ("zero-max-min", "sweep")]
    results = diagnosed(cases, tmp_path)
    assert rate(results, false_name).hits <= 1
    assert not any(blunder_claimed(score) for score in results)


@LONG
def test_over_a_plane_alone_clean_sessions_get_no_name(tmp_path: Path) -> None:
    """6 sessions at 1 %: more than one false name happens in 0.2 % of runs."""
    results = diagnosed([Case(f"q/{n}", "plane-alone-none", "plane", n) for n in NOISES], tmp_path)
    assert rate(results, false_name).hits <= 1


@LONG
@pytest.mark.parametrize("procedure", ["sweep", "two-station"])
def test_hidden_effects_are_in_the_set_and_no_other_is_claimed(
    tmp_path: Path, procedure: str
) -> None:
    """12 sessions at 95 %: fewer than 10 happens in 2 % of runs. None is wrong with confidence."""
    cases = [
        Case(f"q/{procedure}/{effect}", "single", procedure, "gaussian", (effect,), (4.0,))
        for effect in EFFECT_IDS
    ]
    results = diagnosed(cases, tmp_path)
    assert all(detectable(score) for score in results)
    assert rate(results, truth_in_set).hits >= 10
    assert rate(results, wrong_confident).hits == 0


@LONG
def test_blunders_are_named_with_their_place(tmp_path: Path) -> None:
    """6 sessions at 99 %: fewer than 5 happens in 0.1 % of runs."""
    cases = [Case(f"q/{b}", "blunder", "sweep", "gaussian", blunder=b) for b in BLUNDERS]
    assert rate(diagnosed(cases, tmp_path), blunder_named).hits >= 5


def test_an_effect_left_out_of_the_catalogue_is_never_named(tmp_path: Path) -> None:
    case = Case("q/left", "left-out", "sweep", "gaussian", ("backlash",), (4.0,))
    session = tmp_path / "left.jsonl"
    write_session(make(case, SEED), session)
    report = of_the_program(session, ())
    assert "backlash" in [candidate["id"] for candidate in report["candidates"]]
    left_out = of_the_program(session, ("backlash",))
    assert "backlash" not in str(left_out["candidates"] + left_out["effects"])
