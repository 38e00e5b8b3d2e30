"""What a candidate costs before any reading was looked at."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from calib.diagnosis.hypotheses import causes_of, hypotheses_of, log_choices, losses
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.candidates import Candidate
from tests.calib.diagnosis.diagnosed_sessions import TWO_STATION, problem


def visible() -> list[Candidate]:
    made = problem(TWO_STATION, 0)
    return [e for e in hypotheses_of(made, CATALOGUE) if made.blocks([e.columns])[0].shape[1]]


def test_an_effect_then_one_part_or_all_then_which() -> None:
    entries = visible()
    cost = {
        (e.id, e.where): log_prior
        for e, log_prior in zip(entries, log_choices(entries), strict=True)
    }
    effects = len({e.id for e in entries})
    assert cost["gravity_sag", "all"] == pytest.approx(math.log(effects * 2))
    assert cost["gravity_sag", "x"] == pytest.approx(math.log(effects * 2 * 3))
    # Three scales that are alike are another size of machine, which the bars do not have.
    assert cost["actuator_scale", "all"] == pytest.approx(math.log(effects * 2))
    assert cost["actuator_scale", "z"] == pytest.approx(math.log(effects * 2 * 3))
    assert cost["actuator_scale", "x,y,z"] == pytest.approx(3 * math.log(effects * 2 * 3))
    # Screws of several leads are one effect.
    assert cost["actuator_cyclic", "x"] == cost["backlash", "x"]


def test_the_effects_share_their_chances_evenly() -> None:
    """Chances of the simple ways of one effect add up to its own; bars are off in any machine."""
    entries = visible()
    effects = {e.id for e in entries}
    for name in effects:
        chances = {
            (e.id, e.where, e.arrangement): math.exp(-log_prior)
            for e, log_prior in zip(entries, log_choices(entries), strict=True)
            if e.id == name and causes_of(e) == 1
        }
        share = 1.0 if name == "leg_length" else 1.0 / len(effects)
        assert sum(chances.values()) == pytest.approx(share)


@pytest.mark.parametrize(
    ("name", "usual", "beyond"), [("gauge_tilt", 100.0, 300.0), ("gauge_gain", 15.0, 60.0)]
)
def test_sizes_that_nobody_overlooks_are_not_believed(
    name: str, usual: float, beyond: float
) -> None:
    made = problem(TWO_STATION, 0)
    one = next(e for e in hypotheses_of(made, CATALOGUE) if (e.id, e.where) == (name, "xy"))
    cost = [
        losses(replace(made, y=made.y + made.free(size * one.columns[:, 0])), [[one]])[0]
        for size in (usual, beyond)
    ]
    assert cost[0] < 1.0
    assert cost[1] > 1000.0
