"""Proposed measurements: their separations worked out another way, and what is preferred."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag

from calib.arrays import Conditions, FloatArray, Observations, observe
from calib.diagnosis.next_measurement import (
    GOAL,
    Added,
    Explanation,
    Judge,
    Preparation,
    added_conditions,
    best_addition,
    options,
)
from calib.diagnosis.policy import POLICY
from calib.diagnosis.problem import Case, Problem
from calib.noise.reading import IndicatorFigures
from calib.tripod.effects.candidates import Candidate, candidates
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.geometry import Geometry
from calib.tripod.pipeline import Model, derivatives, measure
from tests.calib.diagnosis.diagnosed_sessions import LAWS, SHORT, TOLERANCE_MM

NOISE_MM = 0.002
OFF = (1.2, -0.9, 0.6, 0.03, -0.02, 0.01)


def problem(taken: Observations = SHORT, *effects: EffectInstance) -> Problem:
    truth = Model(parameters_mm=OFF, effects=effects)
    value = measure(
        truth,
        taken,
        scatter_mm=NOISE_MM,
        resolution_mm=0.0,
        generator=np.random.default_rng(2),
    )
    figures = IndicatorFigures(repeatability_mm=NOISE_MM)
    return Problem.of([Case(Model(), observe(taken, value), figures, TOLERANCE_MM).fitted()])


def candidate(model: Model, taken: Conditions, name: str, where: str) -> Candidate:
    found = candidates(model, taken, [LAWS[name]])
    return next(c for c in found if (c.id, c.where) == (name, where))


def explanation(made: Problem, name: str, where: str, *values: float) -> Explanation:
    one = made.fitted_sessions[0]
    return Explanation(candidate(one.model, one.observed, name, where), np.array(values))


def stacked(made: Problem, model: Model, taken: Conditions, one: Candidate) -> FloatArray:
    """Whitened columns on old and new readings together."""
    fitted_session = made.fitted_sessions[0]
    old = candidate(fitted_session.model, fitted_session.observed, one.id, one.where).columns
    new = candidate(model, taken, one.id, one.where).columns
    noise_mm = float(np.sqrt(np.mean(made.root_weight**-2.0)))
    return np.vstack([made.root_weight[:, None] * old, new / noise_mm])


def left(made: Problem, added: Added, true: Explanation, other: Explanation) -> float:
    """What the other leaves of the true one: least squares over both sessions.

    All columns are free but the lengths: both sessions share them, held by their tolerance.
    """
    model = added.preparation.model(made.fitted_sessions[0].model)
    taken = added_conditions([(added.stations[0], added.levels_mm)])
    taken = taken.take([k for k in range(len(taken)) if "xyz"[taken.leg[k]] in added.legs])
    signal = stacked(made, model, taken, true.candidate) @ true.values
    base = derivatives(model.geometry, model.parameters_mm, taken, model.effects)
    zeros = np.eye(taken.mount_count)[taken.mount]
    session, new_base = made.fitted_sessions[0], base / made.noise_mm
    old_zeros = np.eye(session.observed.mount_count)[session.observed.mount]
    bars = np.vstack([made.root_weight[:, None] * session.base[:, 3:] / 0.1, new_base[:, 3:]])
    free = block_diag(np.hstack([old_zeros, session.base[:, :3]]), np.hstack([zeros, base[:, :3]]))
    design = np.hstack([free, bars, stacked(made, model, taken, other.candidate)])
    held = np.zeros((3, design.shape[1]))
    held[:, free.shape[1] : free.shape[1] + 3] = 10.0 * np.eye(3)
    design, signal = np.vstack([design, held]), np.append(signal, np.zeros(3))
    size = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
    rest = signal - design / size @ np.linalg.lstsq(design / size, signal, rcond=1e-9)[0]
    return float(rest @ rest)


@pytest.mark.parametrize(
    "preparation", [Preparation(), Preparation(load=2.0), Preparation((0.0, 5.0, 0.0))]
)
@pytest.mark.parametrize("legs", [("y",), ("x", "y", "z")])
def test_separations_against_least_squares(preparation: Preparation, legs: tuple[str, ...]) -> None:
    made = problem()
    first = explanation(made, "gauge_gain", "yz", 1.5)
    second = explanation(made, "leg_taper", "yz", 0.5)
    third = explanation(made, "gravity_sag", "y", 0.2)
    added = Added(legs, (0.3,), (24.0, 55.0, -40.0, -90.0), preparation)
    judge = Judge(made, [[first], [second], [third]], ())
    model = preparation.model(made.fitted_sessions[0].model)
    (found,) = judge.separations(model, [added])
    for a, b, one, other in ((0, 1, first, second), (0, 2, first, third), (1, 2, second, third)):
        expected = min(left(made, added, one, other), left(made, added, other, one))
        assert found[a, b] == found[b, a] == pytest.approx(expected, rel=0.02, abs=0.1)


def test_several_explanations_of_a_name_count_by_the_nearest() -> None:
    made = problem()
    scale = explanation(made, "actuator_scale", "x", 1.0)
    play = explanation(made, "backlash", "x", 0.02)
    bow = explanation(made, "leg_bow", "xy", 0.05)
    added = Added(("x",), (0.5,), (24.0, 60.0, -40.0, -100.0))
    model = made.fitted_sessions[0].model
    (each,) = Judge(made, [[scale], [play], [bow]], ()).separations(model, [added])
    (both,) = Judge(made, [[scale], [play, bow]], ()).separations(model, [added])
    assert both[0, 1] == pytest.approx(min(each[0, 1], each[0, 2]))


def test_what_stays_is_no_help_to_tell_them_apart() -> None:
    """An effect that is kept beside them is free, so it can take over a part of the difference."""
    made = problem()
    gain = explanation(made, "gauge_gain", "yz", 1.5)
    taper = explanation(made, "leg_taper", "yz", 0.5)
    tilt = explanation(made, "gauge_tilt", "yz", 0.0)
    added = Added(("y",), (0.3,), (24.0, 55.0, -40.0, -90.0), Preparation((0.0, 0.0, 5.0)))
    model = added.preparation.model(made.fitted_sessions[0].model)
    (alone,) = Judge(made, [[gain], [taper]], ()).separations(model, [added])
    (beside,) = Judge(made, [[gain], [taper]], (tilt,)).separations(model, [added])
    assert beside[0, 1] < 0.9 * alone[0, 1]


def test_play_and_a_scale_need_no_change_of_the_machine() -> None:
    made = problem()
    names = [
        [explanation(made, "backlash", "x", 0.03)],
        [explanation(made, "actuator_cyclic", "x", 20.0, 5.0)],
    ]
    added, apart = best_addition(made, names, np.ones(2))
    assert apart[0, 1] >= GOAL
    assert added.preparation == Preparation()
    assert len(added.legs) == 1


def test_weight_is_told_from_a_scale_by_weight() -> None:
    made = problem()
    names = [
        [explanation(made, "gravity_sag", "y", 0.5)],
        [explanation(made, "actuator_scale", "y", -1.6)],
    ]
    as_it_stands, _ = best_addition(made, names, np.ones(2))
    loaded, apart = best_addition(made, names, np.ones(2), load_tells=True)
    judge = Judge(made, names, ())
    model = made.fitted_sessions[0].model
    plain = judge.separations(model, list(options(model.geometry, Preparation())))
    assert as_it_stands.preparation.load == 1.0
    assert loaded.preparation.load == 2.0
    assert apart[0, 1] >= GOAL > POLICY.decisive > plain[:, 0, 1].max()
    assert "load the tool to 2 times its weight" in loaded.words


def test_a_shifted_offset_keeps_clear_of_the_joint_limits() -> None:
    geometry = Geometry()
    shifted = list(options(geometry, Preparation((5.0, 0.0, 0.0))))
    assert max(max(one.levels_mm) for one in shifted) == geometry.travel_max_mm - 5.0
    assert min(min(one.levels_mm) for one in shifted) == geometry.travel_min_mm + 5.0
    plain = list(options(geometry, Preparation()))
    assert max(max(one.levels_mm) for one in plain) == geometry.travel_max_mm
    assert shifted[0].words.startswith("add +5 mm to the entered joint offset of X; then leg X,")


def test_an_entered_offset_is_gone_from_the_machine() -> None:
    model = Preparation((1.2, 0.0, -0.4), 3.0).model(Model(parameters_mm=OFF))
    assert model.parameters_mm == pytest.approx((0.0, -0.9, 1.0, 0.03, -0.02, 0.01))
    assert model.geometry == replace(Geometry(), load=3.0)


def test_steps_as_they_are_measured() -> None:
    added = Added(("x",), (0.3, 0.7), (20.0, 60.0))
    assert added.steps == 2 * (3 * 3 + 1)
    taken = added_conditions([(0.3, (20.0, 60.0))])
    mine = (taken.leg == 0) & (taken.axis == 1)
    assert taken.displacement_mm[mine].tolist() == [0.0, 20.0, 60.0] * 3 + [0.0]
    assert taken.approach[mine].tolist() == [0.0, 1.0, 1.0] + [-1.0, 1.0, 1.0] * 2 + [-1.0]
    assert taken.cycle[mine].tolist() == [1] * 3 + [2] * 3 + [3] * 3 + [4]
    assert taken.mount_count == 6
