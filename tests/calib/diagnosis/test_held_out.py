"""Postures that are left out, against a refit of everything without their rows."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest
from scipy.linalg import block_diag

from calib.arrays import FloatArray, IntArray, Observations
from calib.diagnosis.claims import NAMES
from calib.diagnosis.gap import FREE, LOOSE, Leftover
from calib.diagnosis.held_out import left_out_postures, on_other_sessions
from calib.posterior.cells import Cells
from calib.posterior.models import Posterior
from calib.posterior.posterior import posterior
from calib.posterior.selection import CAUSES, LOG_SCALES, SCALES
from calib.tripod.effects.effect import EffectInstance
from tests.calib.diagnosis.diagnosed_sessions import LAWS, SHORT, SWEEP, case
from tests.conftest import LONG, first_quick

Model = tuple[tuple[int, float], ...]


def sides(result: Posterior) -> Iterator[IntArray]:
    """Rows of each leg on each side of Zero."""
    leg, level = (
        np.concatenate([getattr(cells.means, name) for cells in result.sessions])
        for name in ("leg", "displacement_mm")
    )
    for number in range(3):
        for sign in (1.0, -1.0):
            yield np.flatnonzero((leg == number) & (level * sign > 0.0))


class Refit:
    """Normal sizes of base and effects as one covariance of all rows; kept rows tell the others."""

    def __init__(self, result: Posterior, out: IntArray) -> None:
        self.result, self.out = result, out
        rows = result.linear.rows
        self.kept = np.setdiff1d(np.arange(len(rows.residual)), out)
        zeros = LOOSE * block_diag(*(cells.zeros for cells in result.sessions))
        below = np.zeros((len(rows.residual) - rows.cells, zeros.shape[1]))
        spread = rows.spread * np.where(np.arange(len(rows.spread)) < 3, 1.0, FREE)
        base = np.hstack([np.vstack([zeros, below]), rows.base * spread])
        self.covariance = np.eye(len(base)) + base @ base.T
        away = np.where(np.arange(len(spread)) < 3, rows.prior - rows.value, 0.0)
        self.residual = rows.residual - rows.base @ away

    def spread_of(self, model: Model) -> FloatArray:
        covariance = self.covariance.copy()
        for number, scale in model:
            columns = scale * self.result.linear.columns[:, self.result.linear.index[number]]
            covariance += columns @ columns.T
        return np.asarray(covariance)

    def log_weight(self, model: Model) -> float:
        """Student's t of the kept rows, and the priors of names and scales."""
        rows, components = self.result.linear.rows, self.result.components
        inner_covariance = self.spread_of(model)[np.ix_(self.kept, self.kept)]
        y = self.residual[self.kept]
        square = float(y @ np.linalg.solve(inner_covariance, y))
        power = (rows.freedom + rows.free - len(self.out)) / 2.0
        log = -0.5 * np.linalg.slogdet(inner_covariance)[1] - power * math.log(
            rows.freedom + square
        )
        log += math.log(CAUSES[len(model)]) + sum(components[k].log_prior for k, _ in model)
        return float(log + sum(LOG_SCALES[SCALES.index(scale)] for _, scale in model))

    def missed(self, model: Model) -> FloatArray:
        """What is left of the rows that were out."""
        covariance = self.spread_of(model)
        across = covariance[np.ix_(self.out, self.kept)]
        inner_covariance = covariance[np.ix_(self.kept, self.kept)]
        prediction = across @ np.linalg.solve(inner_covariance, self.residual[self.kept])
        return np.asarray(self.residual[self.out] - prediction)


@LONG
@pytest.mark.parametrize("observations", first_quick([SHORT, SWEEP]), ids=["short", "sweep"])
@pytest.mark.parametrize("sessions", [1, 2])
def test_what_is_missed_is_that_of_a_refit_without_the_rows(
    observations: Observations, sessions: int
) -> None:
    effect = EffectInstance(LAWS["axis_squareness"], "xy", (0.8,))
    result = posterior([case(observations, effect, seed=3 + k) for k in range(sessions)])
    assert result.linear.rows.excess == 0.0
    names = [k for k, component in enumerate(result.components) if component.kind in NAMES]
    models: list[Model] = [((k, scale),) for k in names for scale in SCALES]
    models += [
        model.key
        for model in result.models
        if len(model.members) > 1 and not model.mistakes and {*model.members} <= {*names}
    ]
    root = np.sqrt(np.concatenate([cells.variance_mm2 for cells in result.sessions]))
    before, after, noise, chosen = [], [], [], []
    for out in sides(result):
        refit = Refit(result, out)
        best = max(models, key=refit.log_weight)
        chosen.append(best)
        before.append(root[out] * refit.missed(()))
        after.append(root[out] * refit.missed(best))
        noise.append(root[out])
    leftover = Leftover.of(result.sessions)
    gap = left_out_postures(result, leftover, leftover, ())
    assert gap is not None
    rms = [
        float(np.sqrt(np.mean(np.concatenate(values) ** 2))) for values in (before, after, noise)
    ]
    assert gap.before_rms_mm == pytest.approx(rms[0], rel=1e-3)
    assert gap.after_rms_mm == pytest.approx(rms[1], rel=1e-3)
    assert gap.noise_rms_mm == pytest.approx(rms[2], rel=1e-9)


def test_sessions_that_were_not_used_judge_a_wrong_name_badly() -> None:
    """The true effect leaves noise of them, one of the wrong sign twice what none leaves."""
    effect = EffectInstance(LAWS["axis_squareness"], "yz", (0.8,))
    wrong = EffectInstance(LAWS["axis_squareness"], "yz", (-0.8,))
    first, second = (Leftover.of([Cells.of(case(SWEEP, effect, seed=s))]) for s in (1, 9))
    right, mirrored = (
        on_other_sessions(first, second.sessions, (law,), ()) for law in (effect, wrong)
    )
    assert right is not None
    assert mirrored is not None
    assert right.after_rms_mm < 1.3 * right.noise_rms_mm
    assert right.before_rms_mm == mirrored.before_rms_mm > 2.0 * right.noise_rms_mm
    assert mirrored.after_rms_mm > 1.5 * mirrored.before_rms_mm
