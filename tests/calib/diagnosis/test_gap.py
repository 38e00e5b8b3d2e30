"""The gap on readings that were left out, beside a fit that knows the effect; where a gap is."""

from __future__ import annotations

import numpy as np
import pytest

from calib.arrays import FloatArray, Observations
from calib.diagnosis.gap import Leftover, locate
from calib.posterior.cells import Cells
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.pipeline import Model, derivatives
from tests.calib.diagnosis.diagnosed_sessions import LAWS, SWEEP, TWO_STATION, case, diagnose
from tests.conftest import LONG


def left_by_the_true_effect_mm(cells: Cells, effect: EffectInstance) -> float:
    """One side of one leg at a time predicted from the rest: nothing held, the effect known.

    R.m.s. over the means of cells, which are what a diagnosis predicts.
    """
    model, means = Model(), cells.means
    base = derivatives(model.geometry, model.parameters_mm, means, (effect,))
    small = 1e-6
    bigger = EffectInstance(effect.effect, effect.place, tuple(v + small for v in effect.values))
    readings = [Model(effects=(e,)).readings(means) for e in (effect, bigger)]
    column = (readings[1] - readings[0]) / small
    zeros = np.eye(means.mount_count)[means.mount]
    root = 1.0 / np.sqrt(cells.variance_mm2)
    design: FloatArray = root[:, None] * np.column_stack([zeros, base, column])
    design = design / np.linalg.norm(design, axis=0)
    residual = root * (means.value_mm - readings[0])
    errors = []
    for leg in range(3):
        for side in (1.0, -1.0):
            out = (means.leg == leg) & (np.sign(means.displacement_mm) == side)
            x = np.linalg.lstsq(design[~out], residual[~out], rcond=1e-12)[0]
            errors.append((residual[out] - design[out] @ x) / root[out])
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))


@LONG
@pytest.mark.parametrize("observations", [SWEEP, TWO_STATION])
def test_readings_left_out_are_predicted_as_well_as_by_the_true_effect(
    observations: Observations,
) -> None:
    """Axes out of square pull the offsets of a fit without them 3 mm away: that must not hold."""
    effect = EffectInstance(LAWS["axis_squareness"], "xy", (2.0,))
    session = case(observations, effect, seed=4)
    diagnosis = diagnose([session], CATALOGUE)
    assert [(claim.id, claim.where) for claim in diagnosis.effects] == [("axis_squareness", "xy")]
    assert diagnosis.held_out is not None
    right = left_by_the_true_effect_mm(Cells.of(session), effect)
    assert diagnosis.held_out.after_rms_mm == pytest.approx(right, rel=0.1)
    assert diagnosis.held_out.before_rms_mm > 3.0 * right


def test_where_points_at_the_leg_and_the_direction() -> None:
    session = case(TWO_STATION, EffectInstance(LAWS["leg_bow"], "xy", (0.15,)), seed=6)
    shares = locate(Leftover.of([Cells.of(session)]))
    first = next(s for s in shares if s.leg and s.axis)
    assert (first.leg, first.axis) == ("x", "y")
    assert sum(s.share for s in shares if s.leg and s.axis) == pytest.approx(1.0)
