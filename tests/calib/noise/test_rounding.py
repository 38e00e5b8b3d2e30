"""What rounding does to repeats, against plain simulation."""

from __future__ import annotations

import numpy as np
import pytest

from calib.noise.rounding import (
    quantisation_of_repeatability,
    quantisation_variance,
    scatter_of_repeatability,
)

PLACES = 20_000


def simulated(ratio: float, repeats: int, seed: int = 0) -> tuple[float, float]:
    """Mean square of what repeats share, and mean variance that they show, for a step of 1."""
    generator = np.random.default_rng(seed)
    place = generator.uniform(0.0, 1.0, (PLACES, 1))
    display = np.round(place + ratio * generator.normal(size=(PLACES, repeats)))
    within = display.var(axis=1, ddof=1)
    error = ((display.mean(axis=1) - place[:, 0]) ** 2).mean()
    return float(error - within.mean() / repeats), float(within.mean())


@pytest.mark.parametrize("ratio", [0.0, 0.05, 0.1, 0.2, 0.3, 0.5, 0.9])
def test_locked_and_shown_variance(ratio: float) -> None:
    locked, average = simulated(ratio, 20)
    variance = float(quantisation_variance(np.array([ratio]), 1.0)[0])
    assert variance == pytest.approx(locked, abs=0.002)
    assert ratio**2 + 1 / 12 - variance == pytest.approx(average, abs=0.002 + 0.005 * ratio)


@pytest.mark.parametrize("ratio", [0.02, 0.1, 0.2, 0.3, 0.6])
@pytest.mark.parametrize("step_mm", [0.01, 0.001])
def test_estimate_of_the_locked_part_is_right_on_average(ratio: float, step_mm: float) -> None:
    """From 12 cells of three repeats, as a standard session has, 24 degrees of freedom."""
    generator = np.random.default_rng(3)
    place = generator.uniform(0.0, 1.0, (4000, 12, 1))
    display = np.round(place + ratio * generator.normal(size=(4000, 12, 3)))
    variance = display.var(axis=2, ddof=1).mean(axis=1) * step_mm**2
    quantisation = quantisation_of_repeatability(variance, step_mm, 24.0).mean() / step_mm**2
    truth = float(quantisation_variance(np.array([ratio]), 1.0)[0])
    assert quantisation == pytest.approx(truth, abs=0.0025)


def test_no_step_locks_nothing() -> None:
    variances = np.array([0.0, 1.0, 4.0])
    assert quantisation_variance(variances, 0.0).tolist() == [0.0, 0.0, 0.0]
    assert quantisation_of_repeatability(variances, 0.0, 10.0).tolist() == [0.0, 0.0, 0.0]


def test_identical_repeats_leave_the_whole_step_locked() -> None:
    assert float(quantisation_of_repeatability(np.zeros(1), 0.01, 24.0)[0]) == pytest.approx(
        0.01**2 / 12
    )


@pytest.mark.parametrize("ratio", [0.2, 0.5, 0.9, 1.5])
def test_scatter_behind_what_repeats_show(ratio: float) -> None:
    variance = simulated(ratio, 20)[1] * 0.01**2
    assert scatter_of_repeatability(variance, 0.01) == pytest.approx(0.01 * ratio, rel=0.02)
    assert scatter_of_repeatability(0.0, 0.01) == 0.0
    assert scatter_of_repeatability(0.003**2, 0.0) == pytest.approx(0.003)
