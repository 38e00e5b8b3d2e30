"""Names, rivals and the verdict from weights that are written down here by hand."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from calib.diagnosis.claims import Claim, Claims, conditional, name_of
from calib.diagnosis.results import EffectName
from calib.posterior.correction import correction
from calib.posterior.library import ELSE, library
from calib.posterior.models import Posterior
from calib.posterior.posterior import posterior
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.effects.empirical import EMPIRICAL
from calib.tripod.pipeline import Model
from tests.calib.diagnosis.diagnosed_sessions import LAWS, SHORT, SWEEP, case
from tests.conftest import LONG

COMPONENTS = library([(Model(), SWEEP)])
"""What a sweep can show."""

PLAY_X, PLAY_Y, PLAY_EACH = (EffectName("backlash", where) for where in ("x", "y", "x,y,z"))
BOW, TAPER = EffectName("leg_bow", "xy"), EffectName("leg_taper", "xy")
LAW = EffectName(EMPIRICAL, "x")
SOMETHING = EffectName(ELSE, "all")
UNNAMED = {LAW, SOMETHING}

Weights = Sequence[tuple[tuple[EffectName, ...], float]]


def claims(weights: Weights) -> Claims:
    """Of models that hold these components and have these weights."""
    assert sum(weight for _, weight in weights) == pytest.approx(1.0)
    reach = {}
    for component in COMPONENTS:
        candidate = component.candidate
        separable = candidate is not None and candidate.arrangement in ("one", "each")
        reach[name_of(component)] = frozenset(s.place for s in component.shares), separable
    assert {place for places, _ in weights for place in places} <= reach.keys()
    components = {
        Claim(frozenset({*places} - UNNAMED), unnamed=bool({*places} & UNNAMED)): weight
        for places, weight in weights
    }
    return Claims(components, reach)


def test_probabilities_are_sums_over_models() -> None:
    several = claims([((), 0.2), ((PLAY_X,), 0.3), ((PLAY_X, BOW), 0.1), ((LAW, BOW), 0.4)])
    assert several.nothing == pytest.approx(0.2)
    assert several.missing == pytest.approx(0.8)
    assert several.named == pytest.approx(0.4)
    assert several.unnamed == pytest.approx(0.4)
    assert several.places == pytest.approx({BOW: 0.5, PLAY_X: 0.4})


def test_no_probability_is_above_one() -> None:
    """Weights of many models are rounded."""
    rounded = Claims({Claim(frozenset({PLAY_X}), unnamed=False): 1.0 + 4e-16}, {})
    assert rounded.missing == rounded.places[PLAY_X] == rounded.ids["backlash"] == 1.0


@pytest.mark.parametrize(
    ("weights", "verdict", "names"),
    [
        ([((), 0.6), ((PLAY_X,), 0.4)], "agrees", []),
        ([((), 0.4), ((PLAY_X,), 0.6)], "cannot-tell", []),
        ([((), 0.11), ((PLAY_X,), 0.89)], "cannot-tell", []),
        ([((), 0.01), ((PLAY_X,), 0.99)], "explained", [PLAY_X]),
        ([((PLAY_X,), 0.6), ((BOW,), 0.4)], "ambiguous", [PLAY_X]),
        ([((PLAY_X,), 0.6), ((LAW,), 0.4)], "ambiguous", [PLAY_X]),
        ([((PLAY_X,), 0.4), ((PLAY_X, BOW), 0.6)], "ambiguous", [PLAY_X, BOW]),
        ([((PLAY_X, BOW), 1.0)], "explained", [PLAY_X, BOW]),
        ([((PLAY_X, LAW), 0.98), ((LAW,), 0.02)], "partly-explained", [PLAY_X]),
        ([((PLAY_X, LAW), 0.94), ((LAW,), 0.06)], "unexplained", []),
        ([((SOMETHING,), 0.97), ((PLAY_X,), 0.03)], "unexplained", []),
        ([((SOMETHING,), 0.94), ((PLAY_X,), 0.06)], "ambiguous", [PLAY_X]),
        ([((SOMETHING,), 0.8), ((LAW, BOW), 0.2)], "unexplained", []),
    ],
)
def test_each_verdict_is_a_range_of_probabilities(
    weights: Weights, verdict: str, names: Sequence[EffectName]
) -> None:
    answer = claims(weights).answer()
    assert answer.verdict == verdict
    assert set(answer.rivals) == set(names)


def test_rivals_are_what_stands_in_the_place_of_a_name() -> None:
    answer = claims([((PLAY_X, BOW), 0.6), ((PLAY_X, TAPER), 0.3), ((LAW,), 0.1)]).answer()
    assert answer.rivals[BOW] == (TAPER, EffectName(EMPIRICAL, "xy"))
    assert answer.rivals[PLAY_X] == (EffectName(EMPIRICAL, "x"),)


def test_what_is_added_to_a_heavier_model_and_not_needed_is_no_rival() -> None:
    """A companion that the readings do not ask for stands for the law that it accompanies."""
    weights = [((PLAY_X,), 0.6), ((LAW,), 0.3), ((LAW, TAPER), 0.1)]
    assert claims(weights).answer().rivals == {PLAY_X: (EffectName(EMPIRICAL, "x"),)}
    # where the pair is the heavier one, both of it are needed
    weights = [((PLAY_X,), 0.6), ((LAW,), 0.1), ((BOW, TAPER), 0.3)]
    assert set(claims(weights).answer().rivals[PLAY_X]) >= {BOW, TAPER}


def test_an_effect_is_no_rival_of_itself_at_places_that_contain_it() -> None:
    mixture = claims([((PLAY_X,), 0.6), ((PLAY_EACH,), 0.4)])
    assert mixture.answer().rivals == {PLAY_X: ()}
    assert mixture.one_in_other(PLAY_X, PLAY_EACH)
    assert not mixture.one_in_other(PLAY_X, PLAY_Y)
    elsewhere = claims([((PLAY_X,), 0.6), ((PLAY_Y,), 0.4)])
    assert elsewhere.answer().rivals == {PLAY_X: (PLAY_Y,)}
    shared = EffectName("backlash", "all")  # one value for all is not play at one drive
    assert not mixture.one_in_other(PLAY_X, shared)
    assert mixture.one_in_other(shared, PLAY_EACH)


def test_open_claims_hold_all_but_one_in_a_hundred() -> None:
    weights = [((PLAY_X,), 0.985), ((BOW,), 0.009), ((TAPER,), 0.006)]
    assert claims(weights).answer().rivals == {PLAY_X: (BOW,)}
    assert claims([((PLAY_X,), 0.992), ((BOW,), 0.008)]).answer().rivals == {PLAY_X: ()}


def test_equal_weights_keep_the_order_of_names() -> None:
    """Which of two exact aliases is told first does not depend on rounding."""
    for difference in (1e-15, -1e-15):
        answer = claims([((TAPER,), 0.5 + difference), ((BOW,), 0.5 - difference)]).answer()
        assert answer.rivals == {BOW: (TAPER,)}


@LONG
def test_claims_of_a_posterior_are_its_models_read_one_by_one() -> None:
    """With a mistake among the names, and a law without a name on one side."""
    session = case(SHORT, EffectInstance(LAWS["backlash"], "z", (0.02,)), seed=5)
    value = session.observations.value_mm
    value[(session.observations.leg == 0) & (session.observations.axis == 1)] *= -1.0
    models = posterior([session])
    claims = Claims.of(models)
    assert sum(claims.weights.values()) == pytest.approx(1.0)
    of_names, unnamed, reversed_sign = 0.0, 0.0, 0.0
    for model in models.models:
        kinds = {models.components[k].kind for k in model.members}
        free = bool(kinds & {"nameless", ELSE})
        unnamed += model.weight * free
        of_names += model.weight * (not free and bool(kinds or model.mistakes))
        signs = [
            mistake
            for mistake in model.mistakes
            if (mistake.id, mistake.where) == ("gauge_sign", "xy")
        ]
        reversed_sign += model.weight * bool(signs)
    assert reversed_sign > 0.9
    assert claims.named == pytest.approx(of_names)
    assert claims.unnamed == pytest.approx(unnamed)
    assert claims.places[EffectName("gauge_sign", "xy")] == pytest.approx(reversed_sign)


def bounds_mm(posterior: Posterior) -> list[float]:
    """Of the tool touched off, with joint offsets and with all that a controller can hold."""
    entries = correction(posterior, "offsets"), correction(posterior, "kinematics")
    return [entry.off.bound_mm["touched-off"] for entry in entries]


@LONG
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_right_name_lowers_the_bound_and_a_certain_one_changes_nothing(seed: int) -> None:
    doubtful = posterior([case(SHORT, EffectInstance(LAWS["backlash"], "z", (0.02,)), seed=seed)])
    name = EffectName("backlash", "z")
    claims = Claims.of(doubtful)
    assert claims.answer().verdict == "ambiguous"
    assert claims.places[name] < 0.9
    certain = conditional(doubtful, [name])
    assert certain is not None
    assert sum(model.weight for model in certain.models) == pytest.approx(1.0)
    claims = Claims.of(certain)
    assert claims.probability(lambda claim: claims.holds(claim, name)) == pytest.approx(1.0)
    before_mm, after_mm = bounds_mm(doubtful), bounds_mm(certain)
    assert after_mm[0] <= before_mm[0]
    assert after_mm[1] < 0.5 * before_mm[1]
    again = conditional(certain, [name])
    assert again is not None
    assert bounds_mm(again) == pytest.approx(after_mm, rel=1e-12)


def test_models_with_the_name_at_places_that_contain_it_are_kept() -> None:
    """Also models in which a law without a name acts; no model has two rivals of that many."""
    models = posterior([case(SHORT, EffectInstance(LAWS["backlash"], "x", (0.05,)), seed=5)])
    name = EffectName("backlash", "x")
    certain = conditional(models, [name])
    assert certain is not None
    present = [{name_of(certain.components[k]) for k in m.members} for m in certain.models]
    places = {
        component.where for names in present for component in names if component.id == "backlash"
    }
    assert {"x", "x,y,z"} <= places
    assert all({name, EffectName("backlash", "x,y,z")} & names for names in present)
    assert (
        conditional(models, [name, EffectName("backlash", "y"), EffectName("leg_bow", "xy"), LAW])
        is None
    )
