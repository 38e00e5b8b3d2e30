"""Where the noise figure comes from."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.arrays import conditions, numbered, observe
from calib.noise.reading import (
    IndicatorFigures,
    IndicatorNoise,
    Noise,
    reading_noise,
    reading_weights,
    visit_means,
    visit_numbers,
)
from calib.noise.repeats import Repeats
from calib.stats import coverage_factor, variance_ratio_p_value
from calib.tripod.pipeline import round_to
from tests.builders import observed, postures

TRUTH = [0.3, -0.2, 0.1, 0.0, 0.0, 0.0]


def test_repeats_first() -> None:
    data = observed(TRUTH, postures(repeats=3), scatter_mm=0.01, seed=2)
    noise = reading_noise(data, IndicatorFigures(0.001, 0.5))
    assert noise is not None
    assert (noise.source, noise.degrees_of_freedom) == ("repeats", 36.0)
    scatter = data.value_mm.reshape(6, 3, 3).std(axis=1, ddof=1)
    assert noise.standard_deviation_mm == pytest.approx(math.sqrt((scatter**2).mean()))


@pytest.mark.parametrize(
    "indicator", [IndicatorFigures(resolution_mm=0.01), IndicatorFigures(step_mm=0.01)]
)
def test_identical_repeats_leave_it_to_the_resolution(indicator: IndicatorFigures) -> None:
    data = observed(TRUTH, postures(repeats=3))
    rounded = observe(data, round_to(data.value_mm, 0.01))
    noise = reading_noise(rounded, indicator)
    assert noise is not None
    assert noise.source == "instrument"
    assert noise.standard_deviation_mm == pytest.approx(0.01 / math.sqrt(12))


def test_a_step_that_the_values_show_serves_as_a_stated_one_does() -> None:
    data = observed(TRUTH, postures(repeats=3), scatter_mm=0.003, seed=2)
    rounded = observe(data, round_to(data.value_mm, 0.01))
    stated = reading_noise(rounded, IndicatorFigures(resolution_mm=0.01, step_mm=1e-6))
    estimate = reading_noise(rounded, IndicatorFigures(step_mm=1e-6, values_step_mm=0.01))
    assert stated == estimate
    figures = IndicatorFigures(values_step_mm=0.01, repeatability_mm=0.002)
    assert figures.noise() == IndicatorFigures(0.01, 0.002).noise()


def test_a_step_is_no_noise_without_repeats() -> None:
    """It is the least that a reading scatters: the most is what intervals need."""
    data = observed(TRUTH, postures(), scatter_mm=0.01)
    assert reading_noise(data, IndicatorFigures(values_step_mm=0.001)) is None


def test_equal_repeats_are_no_noise_of_zero() -> None:
    """(0.1 + 0.1 + 0.1) / 3 is not 0.1: rounding of the arithmetic must not pose as noise."""
    conditions = postures(repeats=3)
    assert (
        reading_noise(observe(conditions, np.full(len(conditions), 0.1)), IndicatorFigures())
        is None
    )


def test_nothing_known() -> None:
    assert reading_noise(observed(TRUTH, postures()), IndicatorFigures()) is None
    assert IndicatorFigures(None, 0.0).noise() is None


def test_cells_pool_what_ought_to_be_equal() -> None:
    data = observed(TRUTH, postures(repeats=3), scatter_mm=0.01)
    assert data.cell.max() + 1 == 18
    assert Repeats.of(data).degrees_of_freedom.tolist() == [36.0]


def test_the_two_directions_of_approach_are_different_cells() -> None:
    data = observed(TRUTH, postures(repeats=4), scatter_mm=0.001)
    approach = np.where(np.arange(len(data)) % 6 < 3, 1.0, -1.0)
    lost_motion = replace(data, approach=approach, value_mm=data.value_mm + 0.02 * approach)
    noise = reading_noise(lost_motion, IndicatorFigures())
    assert noise is not None
    assert noise.standard_deviation_mm < 0.0015


def test_repeats_in_place_count_as_one_visit() -> None:
    """Readings with no motion between them share the error of their approach."""
    conditions = postures((0.0, 0.0, 0.0, 60.0, 60.0, -100.0), repeats=2)
    data = observed(TRUTH, conditions, scatter_mm=0.01)
    visits = visit_means(data)
    assert len(visits) == 6 * 2 * 3
    assert visits.value_mm[0] == pytest.approx(data.value_mm[:3].mean())
    assert visits.averaged == pytest.approx(np.ones(36))
    noise = reading_noise(visits, IndicatorFigures())
    assert noise is not None
    assert noise.degrees_of_freedom == 18


def test_only_repeats_in_place_leave_it_to_the_instrument() -> None:
    data = observed(TRUTH, postures((0.0, 0.0, 60.0, 60.0)), scatter_mm=0.01)
    noise = reading_noise(visit_means(data), IndicatorFigures(repeatability_mm=0.02))
    assert noise == IndicatorFigures(repeatability_mm=0.02).noise()


@pytest.mark.parametrize(("df", "k"), [(6, 2.447), (1, 12.706), (math.inf, 1.960)])
def test_coverage_factors_of_student(df: float, k: float) -> None:
    """Table G.2 of the GUM, 95 %."""
    assert coverage_factor(df) == pytest.approx(k, abs=5e-4)


def test_tail_areas_against_scipy_stats() -> None:
    from scipy import stats

    assert variance_ratio_p_value(2.5, 6, 12) == pytest.approx(stats.f.sf(2.5, 6, 12))
    assert variance_ratio_p_value(2.5, 6, math.inf) == pytest.approx(stats.chi2.sf(15.0, 6))


def test_values_of_a_posture_weigh_together_as_their_mean() -> None:
    """1/(s²/n + B) for each mounting's posture, whatever the other mountings read there."""
    data = observed(TRUTH, postures(repeats=3))
    noise = Noise((IndicatorNoise(4.0, 0.5, math.inf),), "instrument")
    together = np.bincount(data.posture, reading_weights(data, noise))
    assert together == pytest.approx(np.full(18, 1.0 / (4.0 / 3.0 + 0.5)))


@given(
    st.lists(
        st.tuples(st.integers(0, 2), st.sampled_from((0.0, 60.0)), st.booleans()),
        min_size=1,
        max_size=30,
    )
)
def test_a_visit_goes_on_until_its_mounting_is_read_elsewhere(
    taken: list[tuple[int, float, bool]],
) -> None:
    """Beside going through the readings one by one; mountings take turns, contacts are apart."""
    legs, levels_mm, contacts = zip(*taken, strict=True)
    rows = conditions(legs, [1] * len(taken), levels_mm, mount=numbered(np.array(legs)).tolist())
    observations = observe(replace(rows, contact=np.array(contacts)), np.zeros(len(taken)))
    visit_of: dict[int, tuple[float, int]] = {}
    expected: list[int] = []
    for mount, level_mm, contact in zip(
        observations.mount.tolist(), levels_mm, contacts, strict=True
    ):
        before = visit_of.get(mount)
        number = max(expected, default=-1) + 1
        if before and before[0] == level_mm and not contact:
            number = before[1]
        visit_of[mount] = level_mm, number
        expected.append(number)
    assert visit_numbers(observations).tolist() == expected
