"""The runner of names counts rightly: bins, Brier score, both answerers on the same sessions."""

from __future__ import annotations

from typing import Any

import pytest

from tests.blind.cases import Case
from tests.blind.generator import make
from tests.blind.naming import Bin, brier, cases, page, reliability, with_every_rival
from tests.blind.scoring import Scored

Json = dict[str, Any]


def scored(true: str, probabilities: Json, noise: str = "gaussian") -> Scored:
    truth = {"hidden": [{"id": true}] if true else [], "blunder": "", "noise": noise}
    return Scored(truth, {"probabilities": list(probabilities.items())})


def test_bins_hold_each_name_with_its_truth() -> None:
    chosen = [
        scored("backlash", {"backlash": 0.32, "leg_bow": 0.38, "gauge_gain": 0.005}),
        scored("leg_bow", {"backlash": 1.0}),
    ]
    third, sure = reliability(chosen)
    assert (third.least, third.most, third.count, third.right) == (0.3, 0.4, 2, 0.5)
    assert third.mean == pytest.approx(0.35)
    assert sure == Bin(0.99, 1.0, 1, 1.0, 0.0)


def test_brier_score_charges_what_was_not_named() -> None:
    assert brier([scored("backlash", {"backlash": 0.7, "leg_bow": 0.3})]) == pytest.approx(0.18)
    assert brier([scored("backlash", {"leg_bow": 0.3})]) == pytest.approx(1.09)
    assert brier([scored("", {})]) == 0.0
    # a drift in noise that wanders is neither right nor wrong
    assert brier([scored("", {"stand_drift": 0.9}, noise="wander")]) == 0.0


def test_both_columns_are_over_the_sessions_that_both_answered() -> None:
    case = Case("test/naming", "none", "sweep", "gaussian")
    made = make(case, 1)
    said: Json = {"verdict": "agrees", "effects": [], "cpu_s": 0.1}
    wrong: Json = {
        "verdict": "explained",
        "effects": [{"id": "backlash", "kind": "machine", "where": "x", "also": [], "also_at": []}],
        "cpu_s": 0.1,
    }
    truths = {"a": made.truth, "b": made.truth}
    posterior = [{"session": "a", **said, "probabilities": []}]
    today = [{"session": "a", **said}, {"session": "b", **wrong}]
    text = page(truths, {"today": today, "posterior": posterior})
    # of one sound session: no name, no wrong name, no wrong place, in both columns
    assert text.count("(0.0 … 97.5; 0/1)") == 6
    assert "0/2" not in text
    assert "1/2" not in text


def test_what_stands_beside_the_catalogue_imitates_too() -> None:
    """A drift of everything is one of every stand as well; the session itself stays the same."""
    case = Case("test/drift", "left-out", "sweep", "gaussian", ("thermal_drift",), (4.0,))
    plain, known = make(case, 4), make(with_every_rival(case), 4)
    assert plain.table == known.table
    (alone,), (beside,) = plain.truth["hidden"], known.truth["hidden"]
    assert alone["rival_share"] < 0.7
    assert beside["rival"] == "stand_drift"
    assert beside["rival_share"] > 0.99


def test_gross_errors_are_left_out() -> None:
    chosen = cases(200)
    assert 100 < len(chosen) < 700
    assert not any(case.blunder for case in chosen)
