"""What is named beside rivals, and what is not: rivals, large effects, effects in many places."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.diagnose import sentence
from calib.diagnosis.results import EffectName
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.effect import EffectInstance
from tests.calib.diagnosis.diagnosed_sessions import (
    LAWS,
    SHORT,
    SWEEP,
    TWO_STATION,
    case,
    diagnose,
    names,
    with_values,
)
from tests.conftest import LONG, first_quick


@pytest.mark.parametrize("seed", first_quick(range(4)))
def test_two_indicators_are_a_rival_of_one_bar(seed: int) -> None:
    """Both indicators of a leg askew do what the shape of one bar does."""
    tilts = [
        EffectInstance(LAWS["gauge_tilt"], place, (v,))
        for place, v in (("yx", 30.0), ("yz", -40.0))
    ]
    diagnosis = diagnose([case(SWEEP, *tilts, seed=seed)], CATALOGUE)
    possible = {effect.id for effect in diagnosis.effects}
    possible |= {
        rival.id for effect in diagnosis.effects for rival in effect.indistinguishable_from
    }
    assert "gauge_tilt" in possible


@LONG
def test_six_indicators_that_all_differ_are_one_name() -> None:
    gains = (7.0, -2.6, -3.7, -3.6, 3.2, 7.0)
    places = ("xy", "xz", "yx", "yz", "zx", "zy")
    effects = [
        EffectInstance(LAWS["gauge_gain"], p, (g,)) for p, g in zip(places, gains, strict=True)
    ]
    diagnosis = diagnose([case(TWO_STATION, *effects, seed=2, scatter_mm=0.0002)], CATALOGUE)
    assert diagnosis.verdict == "explained"
    assert names(diagnosis) == [("gauge_gain", "x,y,z")]
    assert diagnosis.gap_after.p_value > 0.01
    # All six together are a longer machine: only the tolerance of the lengths tells how much.
    sizes = diagnosis.effects[0].parameters
    assert all(size.standard_uncertainty > 3.0 for size in sizes)
    off = np.array([size.value for size in sizes]) - gains
    assert np.ptp(off) < 0.2 * sizes[0].standard_uncertainty


@LONG
@pytest.mark.parametrize("seed", [5, 6, 7])
def test_a_large_effect_is_followed_beyond_its_derivatives(seed: int) -> None:
    """Six milliradians beside 0.2 µm of noise: squares of the lean are many times that."""
    lean = EffectInstance(LAWS["axis_squareness"], "xz", (6.0,))
    diagnosis = diagnose([case(TWO_STATION, lean, seed=seed, scatter_mm=0.0002)], CATALOGUE)
    assert names(diagnosis) == [("axis_squareness", "xz")]
    assert diagnosis.verdict == "explained"
    (value,) = diagnosis.effects[0].parameters
    assert abs(value.value - 6.0) < 4.0 * value.standard_uncertainty
    assert diagnosis.gap_after.p_value > 0.01


def test_the_first_sentence_stays_a_sentence() -> None:
    diagnosis = diagnose(
        [case(SWEEP, EffectInstance(LAWS["gauge_tilt"], "xy", (60.0,)), seed=1)], CATALOGUE
    )
    many = tuple(EffectName(f"name_{k}", "x") for k in range(9))
    finding = replace(diagnosis.effects[0], indistinguishable_from=many)
    words = sentence("ambiguous", [finding], "")
    assert "name_0, name_1, name_2, name_3, 5 others. These readings cannot decide." in words
    plain = replace(finding, indistinguishable_from=())
    assert sentence("ambiguous", [plain], "").endswith(
        "More may be missing beside it; these readings cannot decide."
    )


def test_a_rival_of_the_same_name_is_told_by_its_place() -> None:
    """Else the sentence offers a name instead of itself."""
    taper = EffectInstance(LAWS["leg_taper"], "xz", (3.0,))
    (finding, *_) = diagnose([case(SWEEP, taper, seed=1)], CATALOGUE).effects
    rivals = (
        EffectName("leg_taper", "xy"),
        EffectName("axis_offset", "xy"),
        EffectName("axis_offset", "yz"),
    )
    words = sentence("ambiguous", [replace(finding, indistinguishable_from=rivals)], "")
    assert words.endswith("or instead axis_offset, leg_taper (xy). These readings cannot decide.")


@LONG
def test_a_law_that_leaves_more_than_there_was_is_not_stated() -> None:
    """An indicator whose sign is reversed on two legs: no law of travel explains that."""
    session = case(SHORT, seed=2)
    observations = session.observations
    reversed_mm = np.where(observations.axis == 2, -observations.value_mm, observations.value_mm)
    law = diagnose([with_values(session, reversed_mm)], CATALOGUE).left_over
    assert law is None or law.gap_rms_after_mm < law.gap_rms_before_mm
