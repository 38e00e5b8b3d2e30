"""Every session of the plan can be drawn; a case that cannot is told and does not end the run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from tests.blind import generator
from tests.blind.bench_files import Folder, lines
from tests.blind.cases import TOO_STRONG, Case, plan
from tests.blind.generator import NotDrawn, make
from tests.blind.run import run
from tests.blind.table import page
from tests.conftest import LONG

SEED = 11
TOO_MUCH = Case("too/much", "beside", "sweep", "gaussian", ("joint_clearance",), (40.0,))


def hardest() -> dict[tuple[str, ...], Case]:
    """Of each procedure and hidden effects of the plan, the case where they are strongest."""
    strongest: dict[tuple[str, ...], Case] = {}
    for case in plan(0.001):
        if case.cell in ("pair", "mislabelled", "blunder", "bars", "none"):
            continue
        of = (case.procedure, *case.effects, case.shape)
        if of not in strongest or case.strengths > strongest[of].strengths:
            strongest[of] = case
    return strongest


HARDEST = hardest()


@LONG
@pytest.mark.parametrize("procedure", ["zero-max-min", "sweep", "two-station"])
def test_the_strongest_of_each_effect_can_be_drawn(procedure: str) -> None:
    """What is left to weaker ones, or to two of 3:1, can be drawn where this can."""
    cases = [case for case in HARDEST.values() if case.procedure == procedure]
    assert len(cases) == 12 + 5 + 4
    assert [len(make(case, SEED).rows) > 0 for case in cases] == [True] * len(cases)


def test_what_is_too_strong_stands_in_no_case() -> None:
    pairs = {(case.effects, case.strengths) for case in plan(0.001)}
    for effect, strength in TOO_STRONG:
        assert ((effect,), (strength,)) not in pairs
        assert ((effect,), (strength / 2,)) in pairs


def test_a_case_that_cannot_be_drawn_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(generator, "TRIES", 3)
    with pytest.raises(NotDrawn, match="too/much: no session in 3 draws"):
        make(TOO_MUCH, SEED)


def test_a_run_goes_on_without_what_cannot_be_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(generator, "TRIES", 3)
    plain = Case("plain", "none", "zero-max-min", "gaussian")
    folder = Folder(tmp_path)
    results = run([TOO_MUCH, plain, replace(plain, key="other")], folder, SEED, workers=1)
    assert len(results.scored) == len(lines(folder.results)) == 2
    assert results.not_drawn == ["too/much: no session in 3 draws"]
    assert "- Could not be drawn: too/much: no session in 3 draws." in page(results)
