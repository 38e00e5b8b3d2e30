"""What a model leaves, against dense least squares; its chance; lengths of other sessions."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from scipy.stats import chi2
from scipy.stats import f as f_distribution

from calib.arrays import FloatArray, Observations
from calib.diagnosis.gap import Leftover, residuals
from calib.noise.reading import IndicatorFigures
from calib.posterior.cells import Cells
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.pipeline import Model, derivatives
from tests.calib.diagnosis.diagnosed_sessions import LAWS, SHORT, SWEEP, TWO_STATION, case
from tests.conftest import LONG

STEP_MM = 1e-4
STEPS = 4


def dense(
    sessions: list[Cells], effects: tuple[EffectInstance, ...] = ()
) -> tuple[float, float, list[FloatArray]]:
    """Chi-square, r.m.s. over the readings and what is left of means, by Gauss and Newton.

    Unknown are the lengths, within their tolerance, and of each session its offsets and the zeros
    of its mountings, which are free. Every mean has its own variance.
    """
    count = len(sessions)
    starts = np.cumsum([0] + [cells.means.mount_count for cells in sessions])
    at = np.zeros(3 + 3 * count)
    for number, cells in enumerate(sessions):
        at[3 + 3 * number : 6 + 3 * number] = cells.model.parameters_mm[:3]
    at[:3] = np.mean([cells.model.parameters_mm[3:] for cells in sessions], axis=0)
    for _ in range(STEPS):
        blocks, targets = [], []
        for number, cells in enumerate(sessions):
            means, root = cells.means, 1.0 / np.sqrt(cells.variance_mm2)
            offsets = at[3 + 3 * number : 6 + 3 * number]
            present = (*cells.case.model.effects, *effects)
            model = Model(parameters_mm=(*offsets, *at[:3]), effects=present)
            by_base = derivatives(model.geometry, np.array(model.parameters_mm), means, present)
            block = np.zeros((len(means), len(at) + starts[-1]))
            block[:, :3] = by_base[:, 3:]
            block[:, 3 + 3 * number : 6 + 3 * number] = by_base[:, :3]
            block[np.arange(len(means)), len(at) + starts[number] + means.mount] = 1.0
            blocks.append(root[:, None] * block)
            targets.append(root * (means.value_mm - model.readings(means)))
        constraint = np.zeros((3, blocks[0].shape[1]))
        constraint[:, :3] = np.diag(1.0 / sessions[0].case.tolerance_mm[3:])
        design = np.vstack([*blocks, constraint])
        target = np.concatenate([*targets, -at[:3] / sessions[0].case.tolerance_mm[3:]])
        size = np.linalg.norm(design, axis=0)
        solution = np.linalg.lstsq(design / size, target, rcond=1e-12)[0] / size
        residual = target - design @ solution
        at = at + solution[: len(at)]
    parts = np.split(residual, np.cumsum([len(cells.means) for cells in sessions]))
    left_mm = [p * np.sqrt(c.variance_mm2) for p, c in zip(parts, sessions, strict=False)]
    together = [cells.means.averaged for cells in sessions]
    square = sum(float((n * off**2).sum()) for n, off in zip(together, left_mm, strict=True))
    rms_mm = math.sqrt(square / float(np.concatenate(together).sum()))
    return float(residual @ residual), rms_mm, left_mm


@pytest.mark.parametrize("sessions", [1, 2])
@pytest.mark.parametrize("observations", [SHORT, SWEEP, TWO_STATION])
@pytest.mark.parametrize("in_model", [False, True])
def test_a_gap_is_that_of_dense_least_squares(
    observations: Observations, sessions: int, in_model: bool
) -> None:
    """Without a name and with the true effect in the model."""
    play = EffectInstance(LAWS["backlash"], "y", (0.02,))
    cells = [Cells.of(case(observations, play, seed=seed)) for seed in range(sessions)]
    assert all(not cell.serial for cell in cells)
    effects = (play,) if in_model else ()
    leftover = Leftover.of(cells, effects)
    chi_square, rms_mm, left_mm = dense(cells, effects)
    gap = leftover.gap()
    assert gap.chi_square == pytest.approx(chi_square, rel=2e-3)
    assert gap.rms_mm == pytest.approx(rms_mm, rel=2e-3)
    for ours, theirs in zip(leftover.cells_mm(leftover.left), left_mm, strict=True):
        assert ours == pytest.approx(theirs, abs=2e-5)
    rows, zeros = (
        sum(len(c.means) for c in cells),
        sum(c.means.mount_count for c in cells),
    )
    # lengths are held by their tolerance and take nothing; the effect's size was chosen
    assert gap.degrees_of_freedom == rows - zeros - 3 * sessions - len(effects)
    assert gap.p_value == pytest.approx(
        f_distribution.sf(
            gap.chi_square / gap.degrees_of_freedom,
            gap.degrees_of_freedom,
            sum(c.freedom for c in cells),
        ),
        rel=1e-6,
    )


@LONG
def test_gap_of_pure_noise_is_chi_squared() -> None:
    """Mean of gap / freedom over many sessions is 1 within its own scatter."""
    ratio, noise_df = [], []
    for seed in range(60):
        leftover = Leftover.of([Cells.of(case(SWEEP, seed=seed))])
        gap = leftover.gap()
        ratio.append(gap.chi_square / gap.degrees_of_freedom)
        noise_df.append(leftover.noise_freedom)
    spread = math.sqrt((2.0 / gap.degrees_of_freedom + 2.0 / 48.0) / len(ratio))
    assert min(noise_df) > 0.0
    assert np.mean(ratio) == pytest.approx(1.0, abs=4.0 * spread + 0.05)


def test_chance_of_a_gap() -> None:
    leftover = Leftover.of([Cells.of(case(SWEEP, seed=0))])
    assert leftover.p_value(10.0, 0) == 1.0
    (cells,) = leftover.sessions
    assert cells.noise is not None
    unknown = replace(leftover, sessions=(replace(cells, noise=None),))
    assert unknown.p_value(100.0, 10) == 1.0

    figures = IndicatorFigures(repeatability_mm=0.002)
    full = case(SHORT, seed=2)
    once = full.observations.take(full.observations.cycle == 1)
    stated = replace(full, observations=once, indicator=figures)
    certain = Leftover.of([Cells.of(stated)])
    assert math.isinf(certain.noise_freedom)
    assert certain.p_value(100.0, 10) == pytest.approx(chi2.sf(100.0, 10))
    assert certain.p_value(100.0, 10) < 1e-10
    free = leftover.noise_freedom
    assert leftover.p_value(10.0, 10) == pytest.approx(f_distribution.sf(1.0, 10, free))
    repeated_once = cast(Cells, SimpleNamespace(noise=cells.noise, freedom=1.0))
    rough = replace(leftover, sessions=(repeated_once,))
    assert rough.p_value(100.0, 10) == pytest.approx(f_distribution.sf(10.0, 10, 1.0))


def test_residual_cells_are_means_of_what_is_left_at_each_place() -> None:
    """Of two sessions, by a loop over places; after the play was adopted it is gone."""
    play = EffectInstance(LAWS["backlash"], "y", (0.05,))
    cells = [Cells.of(case(SWEEP, play, seed=seed)) for seed in (1, 2)]
    before, after = Leftover.of(cells), Leftover.of(cells, (play,))
    table = residuals(before, after)
    left_mm = np.concatenate(before.cells_mm(before.left))
    places: dict[tuple[object, ...], list[float]] = {}
    means = [cells[k].means for k in (0, 1)]
    rows = zip(
        np.concatenate([t.leg for t in means]).tolist(),
        np.concatenate([t.axis for t in means]).tolist(),
        np.concatenate([t.displacement_mm for t in means]).tolist(),
        np.concatenate([t.approach for t in means]).tolist(),
        left_mm.tolist(),
        strict=True,
    )
    for leg, axis, displacement, approach, off in rows:
        key = "xyz"[leg], "xyz"[axis], round(displacement, 4), int(approach)
        places.setdefault(key, []).append(off)
    assert len(table.cells) == len(places)
    for cell in table.cells:
        key = cell.leg, cell.axis, cell.displacement_mm, cell.approach
        assert cell.before_mm == pytest.approx(np.mean(places[key]), abs=1e-12)
    assert max(abs(cell.strength) for cell in table.cells) > 5.0
    assert table.after_rms_mm is not None
    assert table.after_rms_mm < 1.3 * table.noise_rms_mm < 0.5 * table.before_rms_mm
    assert residuals(before, None).after_rms_mm is None
