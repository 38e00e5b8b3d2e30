"""Stated uncertainties against thousands of simulated sessions."""

from __future__ import annotations

import numpy as np
import pytest

from calib.arrays import FloatArray, observe
from calib.clusters import on_part
from calib.identify.accuracy import decide
from calib.identify.monte_carlo import Campaign, simulate_and_identify
from calib.identify.solution import SUBSETS, Subset
from calib.noise.reading import IndicatorFigures
from calib.stats import coverage_factor
from calib.tripod.pipeline import Model, measure
from tests.builders import conditions_of
from tests.calib.identify.identified import identify
from tests.conftest import LONG, first_quick

SESSIONS = 20_000
NAMED: tuple[Subset, ...] = ("joint-offsets", "leg-lengths", "both")


OBSERVED = conditions_of("zero-max-min")
"""Zero, Max, Min three times on each leg, with the return to Zero."""


@LONG
@pytest.mark.parametrize(
    ("scatter_mm", "resolution_mm"),
    first_quick(
        [(0.005, 0.0), (0.02, 0.01), (0.005, 0.01), (0.002, 0.01), (0.0005, 0.01), (0.001, 0.001)],
        several=True,
    ),
)
@pytest.mark.parametrize("subset", NAMED)
def test_95_percent_intervals_hold_the_truth(
    subset: Subset, scatter_mm: float, resolution_mm: float
) -> None:
    campaign = Campaign(
        Model(), OBSERVED, SUBSETS[subset], scatter_mm, resolution_mm, np.full(6, 1.0)
    )
    summary = simulate_and_identify(campaign, SESSIONS, seed=11)
    assert summary.failed == 0
    assert (summary.covered > 0.94).all(), summary.covered
    assert (summary.covered < 0.96).all(), summary.covered


def test_few_repeats_need_students_factor() -> None:
    """Two cycles on one leg's worth of cells: with 1.96 the intervals would hold too seldom."""
    rows = OBSERVED.cycle <= 2
    two_cycles = OBSERVED.take(rows)
    campaign = Campaign(Model(), two_cycles, SUBSETS["joint-offsets"], 0.005, 0.0, np.full(6, 1.0))
    summary = simulate_and_identify(campaign, SESSIONS, seed=3)
    assert (np.abs(summary.covered - 0.95) < 0.01).all()
    assert coverage_factor(6.0) == pytest.approx(2.447, abs=5e-4)


@pytest.mark.parametrize(("scatter_mm", "resolution_mm"), [(0.005, 0.0), (0.002, 0.01)])
def test_a_known_noise_needs_no_repeats(scatter_mm: float, resolution_mm: float) -> None:
    once = OBSERVED.take(OBSERVED.cycle == 1)
    campaign = Campaign(
        Model(),
        once,
        SUBSETS["both"],
        scatter_mm,
        resolution_mm,
        np.full(6, 1.0),
        noise_known=True,
    )
    summary = simulate_and_identify(campaign, SESSIONS, seed=4)
    assert (np.abs(summary.covered - 0.95) < 0.012).all(), summary.covered


def test_batched_intervals_are_those_of_identify() -> None:
    """The fast road and the one that every session takes must state the same uncertainty."""
    generator = np.random.default_rng(0)
    truth = Model(parameters_mm=(0.7, -1.1, 0.4, 0.02, -0.03, 0.01))
    ratios = []
    for _ in range(20):
        values = measure(truth, OBSERVED, scatter_mm=0.004, resolution_mm=0.01, generator=generator)
        solution = identify(
            Model(),
            observe(OBSERVED, values),
            "both",
            indicator=IndicatorFigures(resolution_mm=0.01, step_mm=0.01),
        )
        ratios.append(solution.uncertainty_mm)
    campaign = Campaign(truth, OBSERVED, SUBSETS["both"], 0.004, 0.01, np.zeros(6))
    many = simulate_and_identify(campaign, 4000, seed=5)
    mean_square = np.mean(np.square(ratios), axis=0)
    np.testing.assert_allclose(mean_square, many.stated_mm**2, rtol=0.25)


@pytest.mark.parametrize("subset", NAMED)
def test_the_stated_covariance_is_that_of_the_errors(subset: Subset) -> None:
    campaign = Campaign(Model(), OBSERVED, SUBSETS[subset], 0.005, 0.0, np.full(6, 0.5))
    summary = simulate_and_identify(campaign, 20_000, seed=7)
    solution = identify(
        Model(),
        observe(OBSERVED, measured(seed=2)),
        subset,
        indicator=IndicatorFigures(repeatability_mm=0.005),
    )
    scale = 0.005**2 / solution.noise.standard_deviation_mm**2
    trace = float(np.trace(summary.error_covariance_mm2))
    assert trace == pytest.approx(scale * float(np.trace(solution.covariance_mm2)), rel=0.05)


def measured(seed: int) -> FloatArray:
    return measure(
        Model(parameters_mm=(0.3, -0.2, 0.1, 0.0, 0.0, 0.0)),
        OBSERVED,
        scatter_mm=0.005,
        resolution_mm=0.0,
        generator=np.random.default_rng(seed),
    )


def test_a_decision_needs_95_of_100_machines_on_one_side() -> None:
    assert decide(0.02, 0.05, 0.05) == "pass"
    assert decide(0.02, 0.05, 0.049) == "undecided"
    assert decide(0.02, 0.05, 0.02) == "undecided"
    assert decide(0.02, 0.05, 0.0199) == "fail"


def test_memory_and_result_do_not_depend_on_how_sessions_are_cut() -> None:
    progress: list[tuple[float, int]] = []
    campaign = Campaign(Model(), OBSERVED, SUBSETS["both"], 0.005, 0.01, np.full(6, 1.0))
    token = on_part.set(lambda done, parts: progress.append((done, parts)))
    first = simulate_and_identify(campaign, 5000, seed=1)
    on_part.reset(token)
    again = simulate_and_identify(campaign, 5000, seed=1)
    assert progress == [(1, 3), (2, 3), (3, 3)]
    assert np.array_equal(first.error_covariance_mm2, again.error_covariance_mm2)


@pytest.mark.parametrize(
    ("display_mm", "scatter_mm", "step_mm"), [(0.01, 0.001, 0.01), (0.001, 0.005, 0.0)]
)
def test_sessions_like_one_have_its_noise_and_its_uncertainty(
    display_mm: float, scatter_mm: float, step_mm: float
) -> None:
    """A coarse display rounds them, too: machines differ by some of its steps then."""
    figures = IndicatorFigures(resolution_mm=display_mm, step_mm=display_mm)
    truth = Model(parameters_mm=(0.3, -0.2, 0.1, 0.0, 0.0, 0.0))
    value = measure(truth, OBSERVED, scatter_mm=scatter_mm, resolution_mm=display_mm, generator=5)
    observations = observe(OBSERVED, value)
    solution = identify(Model(), observations, "joint-offsets", indicator=figures)
    campaign = Campaign.like(solution, observations, figures)
    assert campaign.model.parameters_mm == solution.model.parameters_mm
    assert (campaign.resolution_mm, campaign.noise_known) == (step_mm, False)
    assert campaign.scatter_mm == pytest.approx(scatter_mm, rel=0.4)
    assert campaign.spread_mm == pytest.approx(10.0 * step_mm)
    summary = simulate_and_identify(campaign, 4000, seed=1)
    assert summary.true_mm == pytest.approx(summary.stated_mm, rel=0.1)
    assert summary.stated_mm == pytest.approx(np.asarray(solution.uncertainty_mm), rel=0.4)
