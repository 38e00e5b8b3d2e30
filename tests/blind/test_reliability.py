"""Bins and the Brier score count rightly."""

from __future__ import annotations

import pytest

from tests.blind.reliability import ReliabilityBin, brier, reliability
from tests.blind.scoring import Scored


def scored(true: str, probabilities: dict[str, float], noise: str = "gaussian") -> Scored:
    truth = {"hidden": [{"id": true}] if true else [], "blunder": "", "noise": noise}
    return Scored(truth, {"probabilities": list(probabilities.items())})


def test_bins_have_each_name_with_its_truth() -> None:
    sessions = [
        scored("backlash", {"backlash": 0.32, "leg_bow": 0.38, "gauge_gain": 0.005}),
        scored("leg_bow", {"backlash": 1.0}),
    ]
    third, sure = reliability(sessions)
    assert (third.least, third.most, third.count, third.right) == (0.3, 0.4, 2, 0.5)
    assert third.mean == pytest.approx(0.35)
    assert sure == ReliabilityBin(0.99, 1.0, 1, 1.0, 0.0)


def test_the_brier_score_charges_what_was_not_listed() -> None:
    assert brier([scored("backlash", {"backlash": 0.7, "leg_bow": 0.3})]) == pytest.approx(0.18)
    assert brier([scored("backlash", {"leg_bow": 0.3})]) == pytest.approx(1.09)
    assert brier([scored("", {})]) == 0.0
    # a drift in noise that wanders is neither right nor wrong
    assert brier([scored("", {"stand_drift": 0.9}, noise="wander")]) == 0.0
    assert brier([]) is None
