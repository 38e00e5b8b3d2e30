"""Where the noise figure comes from."""

from __future__ import annotations

import math

import numpy as np
import pytest

from calib.distributions import coverage_factor, variance_ratio_p_value
from calib.noise import cells, instrument_noise, reading_noise
from calib.observations import observe
from calib.simulation import round_to
from tests.builders import observed, postures

TRUTH = [0.3, -0.2, 0.1, 0.0, 0.0, 0.0]


def test_repeats_first() -> None:
    data = observed(TRUTH, postures(repeats=3), scatter_mm=0.01, seed=2)
    noise = reading_noise(data, resolution_mm=0.001, repeatability_mm=0.5)
    assert noise is not None
    assert (noise.source, noise.degrees_of_freedom) == ("repeats", 36.0)
    scatter = data.value_mm.reshape(6, 3, 3).std(axis=1, ddof=1)
    assert noise.standard_deviation_mm == pytest.approx(math.sqrt((scatter**2).mean()))


def test_identical_repeats_leave_it_to_the_resolution() -> None:
    data = observed(TRUTH, postures(repeats=3))
    rounded = observe(data, round_to(data.value_mm, 0.01))
    noise = reading_noise(rounded, resolution_mm=0.01)
    assert noise is not None
    assert noise.source == "instrument"
    assert noise.standard_deviation_mm == pytest.approx(0.01 / math.sqrt(12))


def test_nothing_known() -> None:
    assert reading_noise(observed(TRUTH, postures())) is None
    assert instrument_noise(None, 0.0) is None


def test_cells_pool_what_ought_to_be_equal() -> None:
    grouped = cells(observed(TRUTH, postures(repeats=3), scatter_mm=0.01))
    assert len(grouped) == 18
    assert grouped.degrees_of_freedom == 36
    assert grouped.weight == pytest.approx(np.full(18, 3.0))


@pytest.mark.parametrize(("df", "k"), [(6, 2.447), (1, 12.706), (math.inf, 1.960)])
def test_coverage_factors_of_student(df: float, k: float) -> None:
    """Table G.2 of the GUM, 95 %."""
    assert coverage_factor(df) == pytest.approx(k, abs=5e-4)


def test_tail_areas_against_scipy_stats() -> None:
    from scipy import stats

    assert variance_ratio_p_value(2.5, 6, 12) == pytest.approx(stats.f.sf(2.5, 6, 12))
    assert variance_ratio_p_value(2.5, 6, math.inf) == pytest.approx(stats.chi2.sf(15.0, 6))
