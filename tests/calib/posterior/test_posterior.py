"""Each model is the normal distribution of its own fit, worked out here another way."""

from __future__ import annotations

import numpy as np
import pytest

from calib.arrays import FloatArray, Observations
from calib.posterior.models import Posterior, WeightedModel
from calib.posterior.posterior import posterior
from calib.posterior.problem import EVERYWHERE
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.pipeline import Model
from tests.calib.posterior.hidden_machines import SHORT, TWO_STATION, hidden, session
from tests.conftest import first_quick

STEP = 1e-4
ZERO_MM = 1e3
"""Spread of the zero of a mounting: free."""


def dense(result: Posterior, model: WeightedModel) -> tuple[FloatArray, FloatArray]:
    """Mean and covariance of lengths and offsets by normal equations about the model's machine.

    Derivatives are differences of simulations, zeros of mountings are unknowns like the others.
    """
    (cells,) = result.sessions
    means, tolerance_mm = cells.means, cells.case.tolerance_mm
    values = model.mean
    effects = [
        (result.components[k].candidate, scale * result.components[k].unit)
        for k, scale in model.key
    ]
    everywhere = [
        (result.components[k].candidate, EVERYWHERE * result.components[k].unit)
        for k in model.everywhere
    ]
    spread = np.concatenate(
        [tolerance_mm[3:], tolerance_mm[:3], *(s for _, s in everywhere), *(s for _, s in effects)]
    )

    def readings(at: FloatArray) -> FloatArray:
        acting: list[EffectInstance] = []
        begin = 6
        for candidate, sizes in (*everywhere, *effects):
            assert candidate is not None
            mine = at[begin : begin + len(sizes)]
            begin += len(sizes)
            if mine.any():
                acting += candidate.effects(mine)
        parameters = tuple(np.concatenate([at[3:6], at[:3]]).tolist())
        return Model(parameters_mm=parameters, effects=tuple(acting)).readings(means)

    now = np.zeros(len(spread))
    now[:6] = values[:6]
    width = sum(len(s) for _, s in effects)
    if width:
        now[-width:] = values[-width:]
    moved = []
    for k in range(len(spread)):
        step = np.zeros(len(spread))
        step[k] = STEP * spread[k]
        moved.append((readings(now + step) - readings(now - step)) / (2.0 * STEP))
    zeros = ZERO_MM * np.equal.outer(means.mount, np.unique(means.mount))
    design = np.column_stack([*moved, zeros]) / np.sqrt(cells.variance_mm2)[:, None]
    residual = (means.value_mm - readings(now)) / np.sqrt(cells.variance_mm2)
    inverse = np.linalg.inv(np.eye(design.shape[1]) + design.T @ design)
    before = np.concatenate([-now / spread, np.zeros(zeros.shape[1])])
    mean = inverse @ (design.T @ residual + before)
    six = slice(0, 6)
    return (
        now[six] + spread[six] * mean[six],
        spread[six] * np.sqrt(inverse.diagonal()[six]) * model.inflated,
    )


@pytest.mark.parametrize(
    "observations", first_quick([SHORT, TWO_STATION]), ids=["zero-max-min", "two-station"]
)
@pytest.mark.parametrize(
    "effects", first_quick([(), (hidden("gravity_sag", "y", 0.3),)]), ids=["nothing", "sag"]
)
def test_a_model_has_the_mean_and_the_spread_of_its_normal_equations(
    observations: Observations, effects: tuple[EffectInstance, ...]
) -> None:
    case, _ = session(observations, *effects, seed=3)
    result = posterior([case])
    model = max(result.models, key=lambda candidate: candidate.weight)
    assert [result.components[k].id for k in model.members] == [e.id for e in effects]
    mean_mm, deviation_mm = dense(result, model)
    assert (np.abs(model.mean[:6] - mean_mm) < deviation_mm / 50.0).all()
    assert np.sqrt(model.variance_at(slice(6))) == pytest.approx(deviation_mm, rel=5e-3)
    assert np.sqrt(model.covariance.diagonal()) == pytest.approx(
        np.sqrt(model.variance_at(slice(None)))
    )


def test_a_gain_that_shows_nothing_where_the_fit_starts_has_its_size() -> None:
    """At the nominal machine all readings are zero and a gain has no derivative."""
    case, _ = session(TWO_STATION, hidden("gauge_gain", "yx", 6.0), seed=4, offset_mm=2.0)
    result = posterior([case])
    (model, *_) = [
        candidate
        for candidate in result.models
        if [(result.components[k].id, result.components[k].where) for k in candidate.members]
        == [("gauge_gain", "yx")]
    ]
    deviation = float(np.sqrt(model.variance_at(slice(-1, None))[0]))
    assert abs(model.mean[-1] - 6.0) < 3.0 * deviation < 3.0


def test_weights_are_shares_and_sessions_have_offsets_of_their_own() -> None:
    first, machine = session(SHORT, seed=5)
    second, second_machine = session(SHORT, seed=6)
    result = posterior([first, second])
    assert sum(model.weight for model in result.models) == pytest.approx(1.0)
    model = result.models[0]
    offsets = np.array([machine.parameters_mm[:3], second_machine.parameters_mm[:3]]).ravel()
    deviation = np.sqrt(model.variance_at(slice(3, 9)))
    assert (np.abs(model.mean[3:9] - offsets) < 4.0 * deviation).all()
