"""Serial correlation of repeats: estimated, and taken out of columns."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from calib.arrays import FloatArray, Observations
from calib.noise.serial import LEAST_RHO, RHOS, independent, serial_correlation
from tests.builders import conditions_of, observed, postures

SD_MM = 0.001


def session(
    rho: float, seed: int, *, rate_mm: float = 0.0, procedure: str = "sweep"
) -> Observations:
    """Repeats whose errors are correlated from visit to visit of a mounting."""
    conditions = conditions_of(procedure)
    values = SD_MM * wandering(conditions, rho, np.random.default_rng(seed))
    return replace(
        conditions, value_mm=values + rate_mm * conditions.time_s / conditions.time_s.max()
    )


def wandering(conditions: Observations, rho: float, generator: np.random.Generator) -> FloatArray:
    values = generator.normal(size=len(conditions))
    for rows in conditions.mountings:
        for before, row in pairwise(rows):
            values[row] = rho * values[before] + np.sqrt(1.0 - rho**2) * values[row]
    return values


def estimate(data: Observations) -> float:
    return serial_correlation(data, data.cell, np.full(len(data), SD_MM**2))


@pytest.mark.parametrize("procedure", ["zero-max-min", "sweep", "two-station"])
def test_repeats_that_are_independent_have_none(procedure: str) -> None:
    rhos = [estimate(session(0.0, seed, procedure=procedure)) for seed in range(40)]
    assert np.mean(rhos) < 0.2
    assert np.mean(np.array(rhos) > 0.5) <= 0.1


@pytest.mark.parametrize("rho", [0.5, 0.8])
def test_a_correlation_is_found(rho: float) -> None:
    rhos = [estimate(session(rho, seed)) for seed in range(40)]
    assert np.median(rhos) == pytest.approx(rho, abs=0.12)


def test_a_steady_drift_is_no_correlation() -> None:
    rhos = [estimate(session(0.0, seed, rate_mm=0.02)) for seed in range(20)]
    assert np.mean(rhos) < 0.1


def test_without_repeats_nothing_is_known() -> None:
    assert estimate(observed([0.0] * 6, postures(), scatter_mm=0.01)) == 0.0


def test_equal_repeats_have_none() -> None:
    assert estimate(conditions_of("sweep")) == 0.0


def test_errors_made_independent_are_the_inverse_root_of_their_covariance() -> None:
    """R = rho^|i - k|; a root W with W'W = inverse of R."""
    rho, count = 0.6, 7
    apart = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    root = independent(rho, np.eye(count))
    assert root.T @ root == pytest.approx(np.linalg.inv(rho**apart), abs=1e-12)
    assert np.array_equal(independent(0.0, np.eye(count)), np.eye(count))


def test_likelihood_against_the_whole_covariance() -> None:
    """Restricted likelihood as it is defined: of the values in a basis of what repeats leave."""
    data = session(0.6, 5, procedure="zero-max-min")
    visit = np.zeros(len(data))
    drifts = np.zeros((len(data), data.mount_count))
    for mount, rows in enumerate(data.mountings):
        visit[rows] = drifts[rows, mount] = np.arange(len(rows))
    vectors, singular, _ = np.linalg.svd(
        np.hstack([np.eye(int(data.cell.max()) + 1)[data.cell], drifts])
    )
    repeats = vectors[:, int((singular > 1e-9).sum()) :]
    value = repeats.T @ data.value_mm
    apart = np.abs(np.subtract.outer(visit, visit))
    logs = []
    for rho in RHOS.tolist():
        errors = np.where(data.mount[:, None] == data.mount, rho**apart, 0.0)
        covariance = repeats.T @ errors @ repeats
        square = value @ np.linalg.solve(covariance, value)
        logs.append(-0.5 * (np.linalg.slogdet(covariance)[1] + len(value) * np.log(square)))
    prior = np.where(RHOS == 0.0, 0.5, 0.5 / 19.0)
    weights = prior * np.exp(np.array(logs) - max(logs))
    expected = float(weights @ RHOS / weights.sum())
    assert expected > LEAST_RHO
    assert estimate(data) == pytest.approx(expected, rel=1e-6)
