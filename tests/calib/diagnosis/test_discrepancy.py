"""Unnamed laws: diagnosis, described, sized; not where there is nothing or no law."""

from __future__ import annotations

import numpy as np
import pytest

from calib.arrays import Observations
from calib.diagnosis.diagnose import NO_LAW
from calib.diagnosis.results import Diagnosis, ModelDiscrepancy
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.effects.empirical import BASES, Empirical, Repeating, empirical_effect
from calib.tripod.pipeline import Model, Stage
from tests.calib.diagnosis.diagnosed_sessions import (
    LAWS,
    SWEEP,
    TWO_STATION,
    case,
    diagnose,
    names,
    with_values,
)
from tests.conftest import LONG

OFF = (1.2, -0.9, 0.6, 0.03, -0.02, 0.01)


def cube(size: float, leg: str = "x") -> EffectInstance:
    return EffectInstance(Empirical(("travel_cube_at_100mm",)), leg, (size,))


def law_of(diagnosis: Diagnosis) -> ModelDiscrepancy:
    assert diagnosis.left_over is not None
    return diagnosis.left_over


def test_a_cube_of_travel_is_described_and_never_named() -> None:
    session = case(TWO_STATION, cube(800.0), seed=3)
    diagnosis = diagnose([session], CATALOGUE)
    assert diagnosis.verdict in ("partly-explained", "unexplained")
    unnamed = law_of(diagnosis)
    assert (unnamed.id, unnamed.kind, unnamed.where) == ("empirical", "empirical", "x")
    assert unnamed.title == "a carriage is off along its way with the cube of travel"
    (value,) = unnamed.parameters
    assert abs(value.value - 800.0) < 4.0 * value.standard_uncertainty
    assert unnamed.gap_rms_after_mm < 0.4 * unnamed.gap_rms_before_mm
    assert "empirical" not in {effect.id for effect in diagnosis.effects}
    assert "empirical" not in {effect.id for effect in diagnosis.candidates}
    gap = law_of(diagnosis).held_out_gap
    assert gap is not None
    assert gap.after_rms_mm < 0.5 * gap.before_rms_mm


@LONG
def test_held_out_sessions_judge_the_law() -> None:
    sessions = [case(TWO_STATION, cube(800.0), seed=seed) for seed in (3, 4)]
    gap = law_of(diagnose(sessions[:1], CATALOGUE, sessions[1:])).held_out_gap
    assert gap is not None
    assert gap.how == "sessions that were not used"
    assert gap.after_rms_mm < 1.5 * gap.noise_rms_mm < 0.5 * gap.before_rms_mm


def test_readings_that_depend_on_time_and_direction() -> None:
    """With the direction: hysteresis of both indicators. The rest is put on their carriage."""
    term = Empirical(("cube_at_100mm", "up_less_down"))
    effects = [EffectInstance(term, place, (60.0, 25.0)) for place in ("yx", "yz")]
    diagnosis = diagnose([case(SWEEP, *effects, seed=6)], [LAWS["thermal_drift"]])
    assert diagnosis.verdict == "partly-explained"
    assert names(diagnosis) == [("gauge_hysteresis", "y")]
    for lag in diagnosis.effects[0].parameters:
        assert abs(lag.value + 25.0) < 4.0 * lag.standard_uncertainty
    unnamed = law_of(diagnosis)
    assert unnamed.where == "y"
    assert "with the cube of travel" in unnamed.title
    assert unnamed.gap_rms_after_mm < 0.3 * unnamed.gap_rms_before_mm


def test_a_law_beside_what_was_named() -> None:
    """A name is kept, and what it leaves is described by itself: guide or display, who knows."""
    effects = (
        EffectInstance(LAWS["backlash"], "z", (0.05,)),
        EffectInstance(Empirical(("fourth_at_100mm",)), "xy", (30.0,)),
    )
    diagnosis = diagnose([case(TWO_STATION, *effects, seed=7)], [LAWS["backlash"]])
    assert [(effect.id, effect.where) for effect in diagnosis.effects] == [("backlash", "z")]
    assert diagnosis.verdict == "partly-explained"
    law = law_of(diagnosis)
    assert law.where == "xy"
    assert law.gap_rms_after_mm < 0.5 * law.gap_rms_before_mm
    assert law.gap_rms_before_mm == pytest.approx(diagnosis.gap_after.rms_mm)


def test_adopted_it_is_gone_and_the_model_agrees() -> None:
    session = case(TWO_STATION, cube(800.0), seed=3)
    effects = law_of(diagnose([session], CATALOGUE)).effects
    again = case(TWO_STATION, cube(800.0), seed=3, model=Model(effects=effects))
    diagnosis = diagnose([again], CATALOGUE)
    assert diagnosis.verdict == "agrees"
    assert diagnosis.left_over is None


@LONG
@pytest.mark.parametrize("observations", [SWEEP, TWO_STATION])
def test_noise_has_no_law(observations: Observations) -> None:
    for seed in range(4):
        assert diagnose([case(observations, seed=seed)], []).left_over is None


def test_what_follows_no_law_is_said_to_follow_none() -> None:
    session = case(SWEEP, seed=2)
    value = session.observations.value_mm.copy()
    keys = list(zip(session.observations.mount, session.observations.displacement_mm, strict=True))
    off_mm = {key: np.random.default_rng(abs(hash(key)) % 1000).normal(0, 0.02) for key in keys}
    value += np.array([off_mm[key] for key in keys])
    rough = with_values(session, value)
    diagnosis = diagnose([rough], [])
    assert diagnosis.verdict == "unexplained"
    assert diagnosis.left_over is None
    assert NO_LAW in diagnosis.remarks


def test_bases_and_laws_by_hand() -> None:
    readings = Empirical(("square_at_100mm", "per_hour"))
    plain, conditions = Model(parameters_mm=OFF), TWO_STATION
    changed = Model(parameters_mm=OFF, effects=(EffectInstance(readings, "xz", (20.0, 6.0)),))
    moved = changed.readings(conditions) - plain.readings(conditions)
    here = (conditions.leg == 0) & (conditions.axis == 2)
    expected = (
        0.020 * (conditions.displacement_mm / 100.0) ** 2 + 0.006 * conditions.time_s / 3600.0
    )
    assert moved == pytest.approx(np.where(here, expected, 0.0), abs=1e-12)
    carriage = Empirical(("travel_square_at_100mm",))
    off = Model(parameters_mm=OFF, effects=(EffectInstance(carriage, "y", (100.0,)),))
    scale = Model(
        parameters_mm=OFF, effects=(EffectInstance(LAWS["actuator_scale"], "y", (-0.6,)),)
    )
    low = (conditions.leg == 1) & (np.abs(conditions.displacement_mm) == 60.0)
    for at in np.flatnonzero(low & (conditions.displacement_mm > 0)):
        # 100 µm · 0.6² = 36 µm at +60 mm, as much as -0.6 mm/m · 60 mm, but the other way
        first = off.readings(conditions)[at] - plain.readings(conditions)[at]
        second = scale.readings(conditions)[at] - plain.readings(conditions)[at]
        assert first == pytest.approx(-second, rel=1e-2)


def test_laws_that_are_none() -> None:
    assert empirical_effect(()) is None
    assert empirical_effect(("cube_at_100mm", "nonsense")) is None
    assert empirical_effect(("cube_at_100mm", "travel_cube_at_100mm")) is None
    names_of_repeating = [parameter.name for parameter in Repeating(5.56).parameters]
    assert empirical_effect(names_of_repeating) == Repeating(5.56)
    assert empirical_effect(names_of_repeating[1:]) is None
    assert empirical_effect((*names_of_repeating, "cube_at_100mm")) is None
    assert empirical_effect([name.replace("5.56", "0") for name in names_of_repeating]) is None
    mixed = empirical_effect(("per_hour", "line_at_100mm"))
    assert isinstance(mixed, Empirical)
    assert mixed.bases == ("line_at_100mm", "per_hour")
    assert {BASES[name].stage for name in mixed.bases} == {Stage.READING}


@LONG
@pytest.mark.parametrize("leg", ["x", "y"])
def test_a_cube_of_travel_goes_by_no_name(leg: str) -> None:
    """On a sweep a bowed bar does nearly the same, and may be told as its rival."""
    diagnosis = diagnose([case(SWEEP, cube(400.0, leg), seed=3)], CATALOGUE)
    assert diagnosis.something_else > 0.9
    assert all(name.probability < 0.1 for name in diagnosis.effects)
    assert diagnosis.verdict in ("unexplained", "ambiguous")
    unnamed = law_of(diagnosis)
    assert unnamed.where == leg
    assert "a carriage is off along its way with the cube of travel" in unnamed.title
