"""Serial correlation of repeats: estimated, and what it adds to variances."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from calib.arrays import FloatArray, Observations, without_means
from calib.noise.serial import SerialCorrelation, serial_correlation, steady_drifts
from tests.builders import conditions_of, observed, postures


def session(
    rho: float, seed: int, *, rate_mm: float = 0.0, procedure: str = "sweep"
) -> Observations:
    """Repeats of unit variance whose errors are correlated from visit to visit of a mounting."""
    taken = conditions_of(procedure)
    values = wandering(taken, rho, np.random.default_rng(seed))
    return replace(taken, value_mm=0.001 * values + rate_mm * taken.time_s / taken.time_s.max())


def wandering(taken: Observations, rho: float, generator: np.random.Generator) -> FloatArray:
    values = generator.normal(size=len(taken))
    for rows in taken.mountings:
        for before, row in pairwise(rows):
            values[row] = rho * values[before] + np.sqrt(1.0 - rho**2) * values[row]
    return values


def estimate(data: Observations, beside: FloatArray | None = None) -> SerialCorrelation:
    return serial_correlation(data, np.full(len(data), 1e6), beside)


@pytest.mark.parametrize("procedure", ["zero-max-min", "sweep", "two-station"])
def test_repeats_that_are_independent_have_none(procedure: str) -> None:
    found = [estimate(session(0.0, seed, procedure=procedure)) for seed in range(40)]
    assert np.mean([one.rho for one in found]) < 0.2
    assert np.mean([one.rho > 0.5 for one in found]) <= 0.1


@pytest.mark.parametrize("rho", [0.5, 0.8])
def test_a_correlation_is_found_within_its_uncertainty(rho: float) -> None:
    found = [estimate(session(rho, seed)) for seed in range(40)]
    assert np.median([one.rho for one in found]) == pytest.approx(rho, abs=0.12)
    off = [(one.rho - rho) / one.standard_uncertainty for one in found]
    assert np.mean(np.abs(off) < 2.0) >= 0.85


def test_a_steady_drift_is_no_correlation() -> None:
    found = [estimate(session(0.0, seed, rate_mm=0.02)) for seed in range(20)]
    assert np.mean([one.rho for one in found]) < 0.1


def test_without_repeats_nothing_is_known_and_nothing_is_added() -> None:
    one = estimate(observed([0.0] * 6, postures(), scatter_mm=0.01))
    assert (one.rho, one.standard_uncertainty) == (0.0, 0.0)


def test_equal_repeats_have_none() -> None:
    still = conditions_of("sweep")
    assert estimate(still).rho == 0.0


def test_variance_of_a_rate_against_simulation() -> None:
    """A rate beside a zero of each mounting, fitted to errors of a correlation of 0.8."""
    taken = conditions_of("sweep")
    rate = without_means(taken.mount, np.ones(len(taken)), taken.time_s)
    rate = rate / np.linalg.norm(rate)
    generator = np.random.default_rng(3)
    slopes = [rate @ wandering(taken, 0.8, generator) for _ in range(600)]
    known = SerialCorrelation(np.array([0.8]), np.array([1.0]))
    assert known.variance_factor(taken, rate[:, None]) == pytest.approx(np.var(slopes), rel=0.15)
    none = SerialCorrelation(np.array([0.0]), np.array([1.0]))
    assert none.variance_factor(taken, rate[:, None]) == pytest.approx(1.0)


def test_share_of_the_variance_that_repeats_show_against_simulation() -> None:
    """Errors of unit variance: what is left of them beside the means of cells, for each freedom."""
    taken = conditions_of("zero-max-min")
    cells = np.eye(int(taken.cell.max()) + 1)[taken.cell]
    cells = cells / np.sqrt(cells.sum(axis=0))
    generator = np.random.default_rng(4)
    shown = []
    for _ in range(400):
        errors = wandering(taken, 0.8, generator)
        left = errors - cells @ (cells.T @ errors)
        shown.append(left @ left / (len(taken) - cells.shape[1]))
    known = SerialCorrelation(np.array([0.8]), np.array([1.0]))
    assert known.shown_share(taken, cells) == pytest.approx(np.mean(shown), rel=0.05)
    assert np.mean(shown) < 0.7


def test_variance_of_the_mean_of_a_cell_by_hand() -> None:
    """Of two values k visits apart (1 + rho^k) / 2 over 1 / 2."""
    taken = conditions_of("zero-max-min")
    known = SerialCorrelation(np.array([0.8]), np.array([1.0]))
    factors = known.cell_mean_factors(taken)
    assert len(factors) == taken.cell.max() + 1
    rows = next(np.flatnonzero(taken.cell == k) for k in range(9) if sum(taken.cell == k) == 3)
    steps = np.searchsorted(np.flatnonzero(taken.mount == taken.mount[rows[0]]), rows)
    apart = np.abs(np.subtract.outer(steps, steps))
    assert factors[taken.cell[rows[0]]] == pytest.approx((0.8**apart).sum() / 3.0)


def test_errors_of_one_mounting_do_not_reach_another() -> None:
    taken = conditions_of("zero-max-min")
    known = SerialCorrelation(np.array([0.5]), np.array([1.0]))
    matrix = known.correlated(taken, np.eye(len(taken)))
    assert np.allclose(matrix, matrix.T)
    other = taken.mount[:, None] != taken.mount
    assert not matrix[other].any()
    assert matrix.diagonal().tolist() == [1.0] * len(taken)


def test_likelihood_against_the_whole_covariance() -> None:
    """Restricted likelihood as it is defined: of the values in a basis of what repeats leave."""
    data = session(0.6, 5, procedure="zero-max-min")
    found = estimate(data)
    free = np.hstack([np.eye(int(data.cell.max()) + 1)[data.cell], steady_drifts(data)])
    left, singular, _ = np.linalg.svd(free)
    repeats = left[:, int((singular > 1e-9).sum()) :]
    value = repeats.T @ data.value_mm
    visit = np.zeros(len(data))
    for rows in data.mountings:
        visit[rows] = np.arange(len(rows))
    apart = np.abs(np.subtract.outer(visit, visit))
    logs = []
    for rho in found.rhos.tolist():
        errors = np.where(data.mount[:, None] == data.mount, rho**apart, 0.0)
        covariance = repeats.T @ errors @ repeats
        square = value @ np.linalg.solve(covariance, value)
        logs.append(-0.5 * (np.linalg.slogdet(covariance)[1] + len(value) * np.log(square)))
    prior = np.where(found.rhos == 0.0, 0.5, 0.5 / 19.0)
    weights = prior * np.exp(np.array(logs) - max(logs))
    assert found.weights == pytest.approx(weights / weights.sum(), rel=1e-6)


def test_beside_a_law_that_is_true_there_is_none() -> None:
    """A drift that all mountings share is not theirs: beside its one column nothing follows."""
    correlated, beside = [], []
    for seed in range(20):
        data = session(0.0, seed, rate_mm=0.03, procedure="zero-max-min")
        hours = data.time_s[:, None] / 3600.0
        beside.append(estimate(data, hours).rho)
        correlated.append(estimate(session(0.8, seed, procedure="zero-max-min"), hours).rho)
    assert np.mean(beside) < 0.15
    assert np.mean(correlated) > 0.5


def test_a_law_that_repeats_do_not_show_takes_nothing_away() -> None:
    """A column that is the same in all repeats of a cell is nothing but rounding beside it."""
    data = session(0.8, 3, procedure="zero-max-min")
    weight = np.random.default_rng(0).uniform(0.5, 2.0, data.mount_count)[data.mount]
    of_cells = np.random.default_rng(1).normal(size=int(data.cell.max()) + 1)[data.cell]
    nothing = np.zeros((len(data), 1))
    for columns in (of_cells[:, None], np.column_stack([np.pi * of_cells, nothing])):
        beside = serial_correlation(data, weight, columns)
        assert beside.weights == pytest.approx(serial_correlation(data, weight, nothing).weights)
        assert beside.rho > 0.5
