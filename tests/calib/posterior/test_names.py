"""Names, rivals and the verdict from weights that are written down here by hand."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from calib.arrays import Observations
from calib.posterior.cells import Case
from calib.posterior.library import ELSE, Component, library
from calib.posterior.names import Claims, Diagnosis, Place, diagnosis_of
from calib.posterior.posterior import posterior
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.effects.empirical import EMPIRICAL
from calib.tripod.pipeline import Model
from tests.calib.diagnosis.diagnosed_sessions import LAWS, SHORT, SWEEP, TWO_STATION, case

COMPONENTS = [
    *library([(Model(), SWEEP)]),
    Component(ELSE, "all", ELSE, np.ones(1), None),
]
"""What a sweep can show."""

PLAY_X, PLAY_Y, PLAY_EACH = (Place("backlash", where) for where in ("x", "y", "x,y,z"))
BOW, TAPER = Place("leg_bow", "xy"), Place("leg_taper", "xy")
UNNAMED = Place(EMPIRICAL, "x")
SOMETHING = Place(ELSE, "all")


def claims(weights: Sequence[tuple[tuple[Place, ...], float]]) -> Claims:
    """Of models that hold these components and have these weights."""
    number = {(one.id, one.where): k for k, one in reversed(list(enumerate(COMPONENTS)))}
    models = [(tuple(number[p.id, p.where] for p in places), w) for places, w in weights]
    assert sum(w for _, w in weights) == pytest.approx(1.0)
    return Claims.of(COMPONENTS, models)


def test_probabilities_are_sums_over_models() -> None:
    found = claims([((), 0.2), ((PLAY_X,), 0.3), ((PLAY_X, BOW), 0.1), ((UNNAMED, BOW), 0.4)])
    assert found.nothing == pytest.approx(0.2)
    assert found.named == pytest.approx(0.4)
    assert found.unnamed == pytest.approx(0.4)
    assert found.ids == pytest.approx({"leg_bow": 0.5, "backlash": 0.4})
    assert found.places == pytest.approx({BOW: 0.5, PLAY_X: 0.4})


@pytest.mark.parametrize(
    ("weights", "verdict", "names"),
    [
        ([((), 0.6), ((PLAY_X,), 0.4)], "agrees", []),
        ([((), 0.4), ((PLAY_X,), 0.6)], "cannot-tell", []),
        ([((), 0.01), ((PLAY_X,), 0.99)], "explained", [PLAY_X]),
        ([((PLAY_X,), 0.6), ((BOW,), 0.4)], "ambiguous", [PLAY_X]),
        ([((PLAY_X,), 0.6), ((UNNAMED,), 0.4)], "ambiguous", [PLAY_X]),
        ([((PLAY_X,), 0.4), ((PLAY_X, BOW), 0.6)], "ambiguous", [PLAY_X, BOW]),
        ([((PLAY_X, BOW), 1.0)], "explained", [PLAY_X, BOW]),
        ([((PLAY_X, UNNAMED), 0.98), ((UNNAMED,), 0.02)], "partly-explained", [PLAY_X]),
        ([((SOMETHING,), 0.97), ((PLAY_X,), 0.03)], "unexplained", []),
        ([((SOMETHING,), 0.8), ((UNNAMED,), 0.2)], "unexplained", []),
    ],
)
def test_each_verdict_is_a_range_of_probabilities(
    weights: Sequence[tuple[tuple[Place, ...], float]], verdict: str, names: Sequence[Place]
) -> None:
    found = claims(weights).answer()
    assert found.verdict == verdict
    assert set(found.rivals) == set(names)


def test_rivals_are_what_stands_in_the_place_of_a_name() -> None:
    found = claims([((PLAY_X, BOW), 0.6), ((PLAY_X, TAPER), 0.3), ((UNNAMED,), 0.1)]).answer()
    assert found.rivals[BOW] == (TAPER, Place(EMPIRICAL, "xy"))
    assert found.rivals[PLAY_X] == (Place(EMPIRICAL, "x"),)


def test_what_is_added_to_a_heavier_model_and_not_needed_is_no_rival() -> None:
    """A companion that the readings do not ask for stands for the law that it accompanies."""
    weights = [((PLAY_X,), 0.6), ((UNNAMED,), 0.3), ((UNNAMED, TAPER), 0.1)]
    assert claims(weights).answer().rivals == {PLAY_X: (Place(EMPIRICAL, "x"),)}
    # where the pair is the heavier one, both of it are needed
    weights = [((PLAY_X,), 0.6), ((UNNAMED,), 0.1), ((BOW, TAPER), 0.3)]
    assert set(claims(weights).answer().rivals[PLAY_X]) >= {BOW, TAPER}


def test_an_effect_is_no_rival_of_itself_at_places_that_contain_it() -> None:
    weights = [((PLAY_X,), 0.6), ((PLAY_EACH,), 0.4)]
    found = claims(weights)
    assert found.answer().rivals == {PLAY_X: ()}
    assert found.one_in_other(PLAY_X, PLAY_EACH)
    assert not found.one_in_other(PLAY_X, PLAY_Y)
    elsewhere = claims([((PLAY_X,), 0.6), ((PLAY_Y,), 0.4)])
    assert elsewhere.answer().rivals == {PLAY_X: (PLAY_Y,)}
    shared = Place("backlash", "all")  # one value for all is not play at one drive
    assert not found.one_in_other(PLAY_X, shared)
    assert found.one_in_other(shared, PLAY_EACH)


def test_open_claims_hold_all_but_one_in_a_hundred() -> None:
    weights = [((PLAY_X,), 0.985), ((BOW,), 0.009), ((TAPER,), 0.006)]
    assert claims(weights).answer().rivals == {PLAY_X: (BOW,)}
    assert claims([((PLAY_X,), 0.992), ((BOW,), 0.008)]).answer().rivals == {PLAY_X: ()}


def test_equal_weights_keep_the_order_of_names() -> None:
    """Which of two exact aliases is told first does not depend on rounding."""
    for more in (1e-15, -1e-15):
        found = claims([((TAPER,), 0.5 + more), ((BOW,), 0.5 - more)]).answer()
        assert found.rivals == {BOW: (TAPER,)}


def told(taken: Observations, *effects: EffectInstance, seed: int = 0) -> Diagnosis:
    one = case(taken, *effects, seed=seed)
    whole = Case(one.model, one.observed, one.indicator, one.tolerance_mm)
    return diagnosis_of(posterior([whole]))


def test_play_is_named_with_its_size_and_what_it_leaves() -> None:
    found = told(TWO_STATION, EffectInstance(LAWS["backlash"], "y", (0.05,)))
    assert found.verdict == "explained"
    (play,) = found.effects
    assert (play.id, play.where, play.kind) == ("backlash", "y", "machine")
    assert play.probability > 0.95
    (size,) = play.parameters
    assert abs(size.value - 0.05) < 3.0 * size.standard_uncertainty
    assert size.standard_uncertainty < 0.003
    # scatter of 2 µm, two takes of each posture: the name takes the gap down to noise
    assert found.gap_before_mm == play.gap_rms_before_mm > 0.005
    assert found.gap_after_mm == play.gap_rms_after_mm < 0.002
    assert [effect.place for effect in play.effects] == ["y"]
    assert found.nothing < 0.01
    assert dict(found.names)["backlash"] >= play.probability


@pytest.mark.parametrize("seed", range(3))
def test_a_sound_machine_has_no_name(seed: int) -> None:
    found = told(SWEEP, seed=seed)
    assert found.verdict == "agrees"
    assert found.effects == ()
    assert found.nothing + found.named + found.unnamed == pytest.approx(1.0)


def test_exact_look_alikes_are_one_name_with_its_rivals() -> None:
    """In Zero, Max, Min a gain, a tilt and a taper change the readings of one mounting alike."""
    found = told(SHORT, EffectInstance(LAWS["gauge_gain"], "xy", (5.0,)))
    assert found.verdict == "ambiguous"
    ids = {one.id for one in found.effects}
    ids |= {rival.id for one in found.effects for rival in one.indistinguishable_from}
    assert ids >= {"gauge_gain", "gauge_tilt", "leg_taper"}
    assert max(probability for _, probability in found.names) < 0.9
