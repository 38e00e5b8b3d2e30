"""Sizes of adopted effects are free about those of the model; held ones are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.diagnose import diagnosis_of
from calib.posterior.cells import SessionCase
from calib.posterior.correction import correction
from calib.posterior.models import Posterior
from calib.posterior.posterior import posterior
from calib.tripod.effects.drives import ActuatorCyclic
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.pipeline import Model
from tests.calib.diagnosis.diagnosed_sessions import LAWS, SWEEP, TWO_STATION, case, names, possible
from tests.conftest import LONG

PLAY = LAWS["backlash"]


def adopted(session: SessionCase, *effects: EffectInstance, held: bool = False) -> SessionCase:
    """The session against a model with these effects."""
    laws = [] if held else [(effect.effect, effect.place) for effect in effects]
    free = {law: (number, "") for number, law in enumerate(laws)}
    return replace(session, model=Model(effects=effects), free=free)


def value_and_deviation(posterior: Posterior, law: tuple[object, str]) -> tuple[float, float]:
    """Of the first size of a law in the tool's field, over all models."""
    (column, *_) = posterior.field.columns[law]  # type: ignore[index]
    middle = float(posterior.mean[column])
    square = 0.0
    for model in posterior.models_in_field:
        variance = model.inflated**2 * model.base[column, column]
        variance += float((model.root[column] ** 2).sum())
        square += model.weight * (variance + (float(model.mean[column]) - middle) ** 2)
    return middle, float(np.sqrt(square))


@LONG
@pytest.mark.parametrize("observations", [SWEEP, TWO_STATION])
def test_a_wrong_size_of_the_model_is_found_again(observations: object) -> None:
    session = case(observations, EffectInstance(PLAY, "z", (0.05,)), seed=4)  # type: ignore[arg-type]
    free = posterior([adopted(session, EffectInstance(PLAY, "z", (0.03,)))])
    diagnosis = diagnosis_of(free)
    assert diagnosis.verdict == "agrees"
    assert diagnosis.gap_before.p_value > 0.01
    entry = correction(free, "play")
    (column,) = free.field.columns[PLAY, "z"]
    middle_mm, u_mm = value_and_deviation(free, (PLAY, "z"))
    assert entry.off.values[column] == pytest.approx(middle_mm, abs=u_mm)
    assert abs(entry.off.values[column] - 0.05) < 4.0 * u_mm
    assert u_mm < 0.002
    # as well known as where it is found without a model
    without = posterior([session])
    assert u_mm == pytest.approx(value_and_deviation(without, (PLAY, "z"))[1], rel=0.2)


@pytest.mark.parametrize("seed", [2, 3, 4])
def test_what_is_adopted_leaves_the_bound_of_who_named_it(seed: int) -> None:
    """A further effect was as likely again as on a machine of which nothing is known."""
    session = case(SWEEP, EffectInstance(PLAY, "z", (0.05,)), seed=seed)
    bounds_mm = [
        correction(answer, "play").off.bound_mm["touched-off"]
        for answer in (
            posterior([session]),
            posterior([adopted(session, EffectInstance(PLAY, "z", (0.05,)))]),
        )
    ]
    assert bounds_mm[1] == pytest.approx(bounds_mm[0], rel=0.15)  # it was 1.3 to 2.5 times


@pytest.mark.parametrize("seed", [2, 3])
def test_an_effect_that_is_adopted_everywhere_has_one_size(seed: int) -> None:
    """Each bar sagged by itself: the bound was 1.6 times that of who named it."""
    sag = [EffectInstance(LAWS["gravity_sag"], leg, (0.3,)) for leg in "xyz"]
    session = case(SWEEP, *sag, seed=seed)
    one_size = replace(adopted(session, *sag), free={(s.effect, s.place): (0, "") for s in sag})
    bounds_mm = [
        correction(posterior([answer]), "kinematics").off.bound_mm["touched-off"]
        for answer in (session, one_size, adopted(session, *sag))
    ]
    assert bounds_mm[1] == pytest.approx(bounds_mm[0], rel=0.15)
    assert bounds_mm[2] > 1.2 * bounds_mm[1]


def test_less_play_than_the_model_holds_is_named() -> None:
    """No machine has play below 0; beside 0.04 mm of the model it may have 0.02 mm less."""
    session = case(SWEEP, EffectInstance(PLAY, "z", (0.02,)), seed=4)
    answer = posterior([adopted(session, EffectInstance(PLAY, "z", (0.04,)), held=True)])
    assert answer.places["backlash", "z"] > 0.9
    middle_mm, u_mm = value_and_deviation(answer, (PLAY, "z"))
    assert abs(middle_mm - 0.02) < 4.0 * u_mm


@LONG
def test_sizes_of_held_out_sessions_are_those_of_the_others() -> None:
    """The size that the model states would leave a gap there."""
    wrong = EffectInstance(PLAY, "z", (0.03,))
    first, second = (
        adopted(case(SWEEP, EffectInstance(PLAY, "z", (0.05,)), seed=seed), wrong)
        for seed in (4, 9)
    )
    gap = diagnosis_of(posterior([first]), [replace(second, free={})]).held_out
    assert gap is not None
    assert gap.before_rms_mm < 1.5 * gap.noise_rms_mm


def test_a_held_size_stays_and_what_it_lacks_is_missing() -> None:
    session = case(SWEEP, EffectInstance(PLAY, "z", (0.05,)), seed=4)
    constant = posterior([adopted(session, EffectInstance(PLAY, "z", (0.03,)), held=True)])
    (column,) = constant.field.columns[PLAY, "z"]
    assert constant.start[column] == pytest.approx(0.03)
    diagnosis = diagnosis_of(constant)
    assert diagnosis.missing > 0.99
    assert ("backlash", "z") in possible(diagnosis)
    (size,) = diagnosis.effects[0].parameters
    assert size.value == pytest.approx(0.02, abs=4.0 * size.standard_uncertainty)


def test_each_place_of_an_effect_is_free() -> None:
    sizes_mm = dict(zip("xyz", (0.05, 0.02, 0.04), strict=True))
    session = case(SWEEP, *(EffectInstance(PLAY, p, (mm,)) for p, mm in sizes_mm.items()), seed=2)
    free = posterior([adopted(session, *(EffectInstance(PLAY, p, (0.03,)) for p in sizes_mm))])
    assert diagnosis_of(free).verdict == "agrees"
    for place, mm in sizes_mm.items():
        middle_mm, u_mm = value_and_deviation(free, (PLAY, place))
        assert abs(middle_mm - mm) < 4.0 * u_mm
        assert u_mm < 0.002


def test_a_searched_lead_of_the_model_is_free() -> None:
    """No library has it, and nothing is left of it in which it could be searched."""
    law = ActuatorCyclic(7.3)
    session = case(SWEEP, EffectInstance(law, "x", (12.0, 0.0)), seed=2)
    free = posterior([adopted(session, EffectInstance(law, "x", (11.0, 0.0)))])
    middle_um, u_um = value_and_deviation(free, (law, "x"))
    assert abs(middle_um - 12.0) < 4.0 * u_um
    assert u_um > 0.1
    assert diagnosis_of(free).verdict == "agrees"


def test_a_size_that_fits_is_kept_and_its_uncertainty_is_in_the_bound() -> None:
    effect = EffectInstance(LAWS["actuator_scale"], "y", (0.5,))
    session = case(SWEEP, effect, seed=2)
    free, constant = (
        posterior([adopted(session, effect, held=is_fixed)]) for is_fixed in (False, True)
    )
    middle, u = value_and_deviation(free, (effect.effect, "y"))
    assert abs(middle - 0.5) < 4.0 * u
    assert value_and_deviation(constant, (effect.effect, "y"))[1] < 0.5 * u
    bounds_mm = [
        correction(result, "tables").off.bound_mm["touched-off"] for result in (free, constant)
    ]
    assert bounds_mm[0] > bounds_mm[1]


@LONG
def test_what_is_missing_beside_an_adopted_effect_is_named() -> None:
    """Whatever size of the adopted one is stated; postures that are left out find it again, too."""
    hidden = EffectInstance(PLAY, "z", (0.05,)), EffectInstance(LAWS["leg_bow"], "xy", (0.3,))
    session, before_mm = case(SWEEP, *hidden, seed=3), []
    for stated_mm in (0.01, 0.05):
        variant = adopted(session, EffectInstance(PLAY, "z", (stated_mm,)))
        diagnosis = diagnosis_of(posterior([variant]))
        assert diagnosis.verdict == "explained"
        assert names(diagnosis) == [("leg_bow", "xy")]
        assert diagnosis.gap_after.p_value > 0.01
        assert diagnosis.held_out is not None
        assert diagnosis.held_out.after_rms_mm < 1.1 * diagnosis.held_out.noise_rms_mm
        before_mm.append(diagnosis.held_out.before_rms_mm)
    assert before_mm[0] == pytest.approx(before_mm[1], rel=0.003)
