"""What noise alone may look like: gaps, scores, chances of them, slips of an indicator."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import f as f_distribution

from calib.diagnosis.gross_errors import find_shift
from calib.diagnosis.problem import Problem
from calib.diagnosis.selection import global_p_value, null_scores, scores
from tests.calib.diagnosis.diagnosed_sessions import SWEEP, case, problem


@pytest.mark.parametrize("seed", range(3))
def test_slip_drift_and_wild_readings_are_told_apart(seed: int) -> None:
    clean = case(SWEEP, seed=seed).observed
    rows = np.flatnonzero(clean.mount == 2)
    slipped = clean.value_mm.copy()
    slipped[rows[9:]] += 0.05
    shift = find_shift(replace(clean, value_mm=slipped))
    assert shift is not None
    assert shift.rows[0] == rows[9]
    shift_mm = (slipped - shift.corrected.value_mm)[rows[9:]]
    assert shift_mm == pytest.approx(0.05, abs=0.006)
    wandering = clean.value_mm.copy()
    wandering[rows] += np.linspace(0.0, 0.1, len(rows))
    assert find_shift(replace(clean, value_mm=wandering)) is None
    wild = clean.value_mm.copy()
    wild[rows[9]] += 0.2
    assert find_shift(replace(clean, value_mm=wild)) is None
    assert find_shift(clean) is None


def test_gap_of_pure_noise_is_chi_squared() -> None:
    """Mean of gap / freedom over many sessions is 1 within its own scatter."""
    ratio = []
    for seed in range(60):
        made = problem(SWEEP, seed)
        ratio.append(made.gap(made.y) / made.structure_df)
    free = problem(SWEEP, 0).structure_df
    spread = math.sqrt((2.0 / free + 2.0 / 48.0) / len(ratio))
    assert np.mean(ratio) == pytest.approx(1.0, abs=4.0 * spread + 0.05)


@pytest.mark.parametrize("rank", [1, 2, 6])
@pytest.mark.parametrize("noise_df", [12.0, 144.0, math.inf])
def test_log_scores_against_scipy(rank: int, noise_df: float) -> None:
    squares = np.geomspace(0.01, 400.0, 40)[None, :]
    found = scores(squares, [rank], noise_df, 60, np.full(40, 1e9))[0]
    df2 = 1e9 if math.isinf(noise_df) else noise_df
    expected = f_distribution.logsf(squares[0] / rank, rank, df2)
    np.testing.assert_allclose(found, expected, rtol=0.02, atol=0.02)


@pytest.mark.parametrize("uneven", [False, True])
def test_global_p_value_is_uniform_on_noise(*, uneven: bool) -> None:
    """Also where half of the readings scatter three times as much as the others."""
    generator = np.random.default_rng(0)
    blocks = [np.linalg.qr(generator.normal(size=(40, r)))[0] for r in (1, 1, 2, 3, 1, 6)]
    deviation = np.where(np.arange(40) < 20, 0.45, 1.34) if uneven else np.ones(40)
    null = null_scores(blocks, 30.0, 40, deviation)
    found = []
    for _ in range(400):
        y = deviation * generator.normal(size=40)
        square = np.array([((b.T @ y) ** 2).sum() for b in blocks])[:, None]
        square = square / (generator.chisquare(30.0) / 30.0)
        local = scores(square, [b.shape[1] for b in blocks], 30.0, 40, np.array([1e9]))
        found.append(global_p_value(float(local.min()), null))
    assert np.mean(np.array(found) <= 0.1) == pytest.approx(0.1, abs=0.06)
    assert np.mean(np.array(found) <= 0.5) == pytest.approx(0.5, abs=0.1)


def test_unevenness_is_seen_where_stands_scatter_differently() -> None:
    assert (problem(SWEEP, 3).unevenness() == 1.0).all()
    one = case(SWEEP, seed=3)
    scatter = np.array([0.0, 0.0, 0.0, 0.01, 0.01, 0.01])[one.observed.mount]
    value = one.observed.value_mm + scatter * np.random.default_rng(3).normal(size=len(scatter))
    uneven = replace(one.observed, value_mm=value)
    own = Problem.of([one.with_readings(uneven).fitted()])
    seen = own.unevenness()
    assert seen[own.mount >= 3].min() > 1.3 * seen[own.mount < 3].max()


def test_chance_of_a_gap() -> None:
    made = problem(SWEEP, 0)
    assert made.gap_p_value(10.0, 0) == 1.0
    assert replace(made, noise_df=0.0).gap_p_value(100.0, 10) == 1.0
    assert replace(made, noise_df=math.inf).gap_p_value(100.0, 10) < 1e-10
    chance = replace(made, noise_df=40.0).gap_p_value(10.0, 10)
    assert chance == pytest.approx(f_distribution.sf(1.0, 10, 40))
