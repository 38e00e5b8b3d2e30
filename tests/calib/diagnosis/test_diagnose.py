"""Verdicts of the diagnosis and their names; `tests/blind` judges them on data of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.arrays import Observations, observe
from calib.diagnosis.results import Diagnosis
from calib.noise.reading import IndicatorFigures
from calib.posterior.cells import Cells
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.bars import BarGrowth
from calib.tripod.effects.drives import ActuatorCyclic, ScrewGrowth
from calib.tripod.effects.effect import Effect, EffectInstance
from calib.tripod.pipeline import Model
from tests.calib.diagnosis.diagnosed_sessions import (
    LAWS,
    SHORT,
    SWEEP,
    TWO_STATION,
    case,
    diagnose,
    names,
    with_readings,
)
from tests.conftest import LONG, first_quick


@LONG
@pytest.mark.parametrize("observations", first_quick([SHORT, SWEEP, TWO_STATION]))
def test_nothing_missing_agrees_and_says_what_would_have_been_seen(
    observations: Observations,
) -> None:
    verdicts = [diagnose([case(observations, seed=seed)], CATALOGUE) for seed in range(6)]
    assert sum(diagnosis.verdict == "agrees" for diagnosis in verdicts) >= 5
    quiet = next(diagnosis for diagnosis in verdicts if diagnosis.verdict == "agrees")
    assert quiet.effects == ()
    sizes = {effect.id: effect.size for effect in quiet.smallest_detectable}
    assert 0.0 < sizes["backlash"] < 0.1


@pytest.mark.parametrize(("resolution_mm", "verdict"), [(None, "cannot-tell"), (0.001, "agrees")])
@pytest.mark.parametrize("all_alike", [True, False], ids=["stuck", "exact"])
def test_readings_without_any_scatter_name_nothing(
    all_alike: bool, resolution_mm: float | None, verdict: str
) -> None:
    """A factor shows in nothing that stands still, and no effect explains what rounding leaves."""
    exact_mm = Model(parameters_mm=(0.3, 0.2, -0.1, 0.0, 0.0, 0.0)).readings(SHORT)
    value_mm = np.full(len(SHORT), 0.5) if all_alike else exact_mm
    session = with_readings(case(SHORT), observe(SHORT, value_mm))
    diagnosis = diagnose([replace(session, indicator=IndicatorFigures(resolution_mm))], CATALOGUE)
    assert (diagnosis.verdict, diagnosis.effects) == (verdict, ())
    assert "best guess" not in diagnosis.sentence


@pytest.mark.parametrize(
    ("name", "place", "value", "where"),
    first_quick(
        [
            ("axis_squareness", "xy", 0.6, "xy"),
            ("backlash", "y", 0.03, "y"),
            ("leg_bow", "xz", 0.05, "xz"),
            ("thermal_drift", "z", 300.0, "z"),
        ],
        several=True,
    ),
)
def test_one_effect_is_named_with_place_and_size(
    name: str, place: str, value: float, where: str
) -> None:
    diagnosis = diagnose(
        [case(TWO_STATION, EffectInstance(LAWS[name], place, (value,)), seed=3)], CATALOGUE
    )
    assert diagnosis.verdict == "explained"
    assert names(diagnosis) == [(name, where)]
    (parameter,) = diagnosis.effects[0].parameters
    assert abs(parameter.value - value) < 4.0 * parameter.standard_uncertainty
    assert diagnosis.gap_after.rms_mm < 0.7 * diagnosis.gap_before.rms_mm
    assert diagnosis.gap_after.p_value > 0.01
    assert diagnosis.held_out is not None
    assert diagnosis.held_out.after_rms_mm < 0.8 * diagnosis.held_out.before_rms_mm


def test_look_alikes_are_not_told_apart() -> None:
    """With Zero, Max and Min an offset axis and a tapered bar can be one and the same."""
    diagnosis = diagnose(
        [case(SHORT, EffectInstance(LAWS["leg_taper"], "xy", (0.4,)), seed=1)], CATALOGUE
    )
    assert diagnosis.verdict == "ambiguous"
    names_possible = {diagnosis.effects[0].id} | {
        r.id for r in diagnosis.effects[0].indistinguishable_from
    }
    assert "leg_taper" in names_possible
    assert len(names_possible) > 1


def test_two_effects() -> None:
    effects = (
        EffectInstance(LAWS["axis_squareness"], "xy", (0.8,)),
        EffectInstance(LAWS["backlash"], "z", (0.03,)),
    )
    diagnosis = diagnose([case(TWO_STATION, *effects, seed=5)], CATALOGUE)
    assert sorted(names(diagnosis)) == [("axis_squareness", "xy"), ("backlash", "z")]
    assert diagnosis.verdict == "explained"


@LONG
def test_sessions_share_effects_and_keep_their_own_offsets() -> None:
    effect = EffectInstance(LAWS["axis_squareness"], "yz", (0.4,))
    sessions = [case(SWEEP, effect, seed=seed) for seed in (1, 2)]
    diagnosis = diagnose(sessions, CATALOGUE, held_out=[case(SWEEP, effect, seed=9)])
    assert names(diagnosis) == [("axis_squareness", "yz")]
    assert diagnosis.held_out is not None
    assert diagnosis.held_out.how == "sessions that were not used"
    assert diagnosis.held_out.after_rms_mm < 1.3 * diagnosis.held_out.noise_rms_mm
    assert diagnosis.held_out.before_rms_mm > 2.0 * diagnosis.held_out.noise_rms_mm


def test_a_model_that_has_the_effect_agrees() -> None:
    effect = EffectInstance(LAWS["backlash"], "x", (0.05,))
    model = Model(effects=(effect,))
    diagnosis = diagnose([case(SWEEP, effect, seed=2, model=model)], CATALOGUE)
    assert diagnosis.verdict == "agrees"


@LONG
def test_an_effect_out_of_the_catalogue_is_not_given_a_name_with_confidence() -> None:
    laws = [effect for effect in CATALOGUE if effect.id not in ("backlash",)]
    diagnosis = diagnose([case(TWO_STATION, EffectInstance(LAWS["backlash"], "x", (0.05,)))], laws)
    assert diagnosis.verdict in ("unexplained", "partly-explained")


def test_without_repeats_and_noise_nothing_is_judged() -> None:
    first = SWEEP.take(np.unique(SWEEP.displacement_mm * 10 + SWEEP.mount, return_index=True)[1])
    session = case(first, EffectInstance(LAWS["axis_squareness"], "xy", (1.0,)))
    diagnosis = diagnose([session], CATALOGUE)
    assert diagnosis.verdict == "cannot-tell"
    assert diagnosis.effects == ()
    assert Cells.of(session).noise is None
    assert (diagnosis.smallest_detectable, diagnosis.not_shown) == ((), ())


@pytest.mark.parametrize(
    ("change", "name", "where"),
    first_quick(
        [
            (lambda v, o: np.where((o.leg == 0) & (o.axis == 1), -v, v), "gauge_sign", "xy"),
            (lambda v, o: np.where((o.leg == 2) & (o.axis == 0), v / 25.4, v), "unit_mixup", "zx"),
        ],
        several=True,
    ),
)
def test_blunders_are_named_and_the_data_left_alone(change: object, name: str, where: str) -> None:
    assert callable(change)
    session = case(SWEEP, seed=4)
    wrong = replace(
        session.observations, value_mm=change(session.observations.value_mm, session.observations)
    )
    before = wrong.value_mm.copy()
    diagnosis = diagnose([replace(session, observations=wrong)], CATALOGUE)
    assert (diagnosis.effects[0].id, diagnosis.effects[0].where) == (name, where)
    assert diagnosis.effects[0].gap_rms_after_mm < 0.1 * diagnosis.effects[0].gap_rms_before_mm
    assert np.array_equal(wrong.value_mm, before)


@LONG
def test_a_near_alias_is_a_rival_of_a_small_effect_and_none_of_a_large_one() -> None:
    """Sag has 99 % of the direction of scale: a matter of size, not of the procedure alone."""

    def with_scale(value: float) -> Diagnosis:
        effect = EffectInstance(LAWS["actuator_scale"], "x", (value,))
        return diagnose([case(TWO_STATION, effect, seed=1)], CATALOGUE)

    small, large = with_scale(-0.6), with_scale(-6.0)  # no bar gets longer under a weight
    (doubtful,) = small.effects
    names_possible = {doubtful.id} | {rival.id for rival in doubtful.indistinguishable_from}
    assert small.verdict == "ambiguous"
    assert {"actuator_scale", "gravity_sag"} <= names_possible
    assert large.verdict == "explained"
    assert names(large) == [("actuator_scale", "x")]


def test_two_effects_do_not_pass_for_one_in_every_place() -> None:
    """Six tapers can imitate nearly every pair of effects on the bars."""
    pair = (
        EffectInstance(LAWS["gauge_gain"], "yx", (3.0,)),
        EffectInstance(LAWS["axis_squareness"], "xy", (0.7,)),
    )
    diagnosis = diagnose([case(SWEEP, *pair, seed=1)], CATALOGUE)
    ids = {name for name, _ in names(diagnosis)}
    rivals = {r.id for effect in diagnosis.effects for r in effect.indistinguishable_from}
    assert {"gauge_gain", "axis_squareness"} <= ids | rivals
    assert ("leg_taper", "x,y,z") not in names(diagnosis)


@LONG
@pytest.mark.parametrize(("law", "value"), [(ScrewGrowth(), 11.5), (BarGrowth(), 3.6)])
def test_what_is_warmer_grows(law: Effect, value: float) -> None:
    """Screws of steel, 11.5 µm/m K, or bars of steel, 310 mm, from 18 to 26 °C.

    Bars that shrink would fit growing screws as well, but no machine has them.
    """
    warming = replace(
        TWO_STATION, temperature_c=18.0 + 8.0 * TWO_STATION.time_s / TWO_STATION.time_s.max()
    )
    effects = [EffectInstance(law, leg, (value,)) for leg in "xyz"]
    diagnosis = diagnose([case(warming, *effects, seed=3)], CATALOGUE)
    assert names(diagnosis) == [("thermal_growth", "all")]
    assert diagnosis.effects[0].title == law.title
    (parameter,) = diagnosis.effects[0].parameters
    assert abs(parameter.value - value) < 4.0 * parameter.standard_uncertainty


def test_two_leads_of_one_screw_are_terms_of_a_series() -> None:
    effects = [
        EffectInstance(effect, "y", (0.0, 30.0))
        for effect in CATALOGUE
        if isinstance(effect, ActuatorCyclic) and effect.lead_mm in (5.0, 20.0)
    ]
    single, two = (
        diagnose([case(SWEEP, *subset, seed=2)], CATALOGUE) for subset in (effects[:1], effects)
    )
    assert (single.verdict, names(single)) == ("explained", [("actuator_cyclic", "y")])
    assert names(two) == [("actuator_cyclic", "y")]
    sizes = {size.name: size for size in two.effects[0].parameters}
    for lead in (5, 20):
        for wave, value in (("sine", 0.0), ("cosine", 30.0)):
            size = sizes[f"{wave}_{lead}mm"]
            assert abs(size.value - value) < 4.0 * size.standard_uncertainty
    assert two.gap_after.p_value > 0.01
    assert not any("fit as well" in remark for remark in two.remarks)
    assert two.verdict == "explained"


def test_ten_thousand_readings_stay_near_linear() -> None:
    """Many cycles: the work is done on arrays; no step grows with the square of the readings."""
    cycles = 36
    many = TWO_STATION.take(np.tile(np.arange(len(TWO_STATION)), cycles))
    many = replace(many, cycle=np.repeat(np.arange(cycles), len(TWO_STATION)))
    assert len(many) == 9936
    diagnosis = diagnose([case(many, scatter_mm=0.002)], CATALOGUE)
    assert diagnosis.verdict == "agrees"
