"""Which set to trust: what it promises at the tool against what it really leaves there."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.identify.solution import Subset
from calib.noise.reading import IndicatorFigures
from calib.tripod.effects.drives import Backlash
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.movements import with_first_movements
from calib.tripod.pipeline import Model
from protocols.observations import to_observations
from protocols.record import read_record
from protocols.session import fold
from tests.builders import conditions_of, observed, postures
from tests.calib.identify.identified import choose_subset, identify
from tests.conftest import LONG

TOLERANCES = np.array([2.0] * 3 + [0.1] * 3)
MODEL = Model()


def test_the_usual_view_is_joint_offsets_whatever_fits_better() -> None:
    """50 µm of play at every carriage: lengths of a millimetre fit it better than offsets do."""
    conditions = with_first_movements(MODEL.geometry, conditions_of("two-station"))
    lost = tuple(EffectInstance(Backlash(), leg, (0.05,)) for leg in "xyz")
    truth = Model(parameters_mm=(-0.66, 0.46, 0.05, 0.0, 0.0, 0.0), effects=lost)
    noise = np.random.default_rng(4).normal(scale=0.002, size=len(conditions))
    data = replace(conditions, value_mm=truth.readings(conditions) + noise)
    choice = choose_subset(MODEL, data, tolerance_mm=TOLERANCES)
    solution = choice.solutions["with-tolerances"]
    assert solution.rms_after_mm < 0.8 * choice.solutions["joint-offsets"].rms_after_mm
    assert [name for name, *_ in solution.beyond_tolerance] == ["d_L_x", "d_L_y", "d_L_z"]
    assert choice.usual == "joint-offsets"
    assert not choice.solutions["joint-offsets"].beyond_tolerance


def test_weak_directions_of_a_set_with_tolerances_are_those_of_its_covariance() -> None:
    data = observed([0.5, -0.8, 0.3, 0, 0, 0], postures(repeats=3), scatter_mm=0.02, seed=2)
    solution = identify(MODEL, data, "with-tolerances", tolerance_mm=TOLERANCES)
    assert solution.weak_directions
    for direction in solution.weak_directions:
        direction_vector = np.array(
            [float(name in direction.combination) for name in solution.names]
        )
        uncertainty_mm = np.sqrt(direction_vector @ solution.covariance_mm2 @ direction_vector)
        assert direction.standard_uncertainty_mm == pytest.approx(float(uncertainty_mm), rel=0.02)


@pytest.mark.parametrize(
    ("subset", "freedom", "factor"), [("joint-offsets", 9, 2.262), ("both", 6, 2.447)]
)
def test_what_is_left_counts_with_its_own_degrees_of_freedom(
    samples: Path, subset: Subset, freedom: int, factor: float
) -> None:
    """Stated noise has k = 1.960; noise taken from six degrees of freedom must have 2.447."""
    session = fold(read_record(samples / "experiment_2_twelve.jsonl").events)
    stated = IndicatorFigures(resolution_mm=0.01, repeatability_mm=0.02)
    solution = identify(MODEL, to_observations([session]), subset, indicator=stated)
    assert solution.lack_of_fit is not None
    assert solution.lack_of_fit.degrees_of_freedom == freedom
    assert solution.coverage_factor == pytest.approx(1.960, abs=5e-4)
    ratio = solution.inflated_expanded_mm / solution.expanded_mm
    expected = np.sqrt(solution.lack_of_fit.statistic) * factor / 1.96
    np.testing.assert_allclose(ratio, expected, rtol=1e-3)


@LONG
def test_tolerances_are_no_noise_that_the_left_over_enlarges(samples: Path) -> None:
    """The inflated covariance is the error of this estimate under more noise, by simulation."""
    session = fold(read_record(samples / "experiment_2_twelve.jsonl").events)
    observations = to_observations([session])
    stated = IndicatorFigures(resolution_mm=0.01, repeatability_mm=0.02)
    solution = identify(
        MODEL, observations, "with-tolerances", indicator=stated, tolerance_mm=TOLERANCES
    )
    assert solution.lack_of_fit is not None
    assert 6.0 < solution.lack_of_fit.degrees_of_freedom < 9.0
    generator = np.random.default_rng(0)
    errors = []
    sigma = 3.0 * solution.noise.standard_deviation_mm / np.sqrt(3.0)
    for seed in range(300):
        truth = generator.normal(size=6) * TOLERANCES
        data = observed(truth.tolist(), postures(), scatter_mm=sigma, seed=seed)
        data.averaged[:] = 3.0
        refit = identify(MODEL, data, "with-tolerances", indicator=stated, tolerance_mm=TOLERANCES)
        errors.append(refit.values_mm - truth)
    true = np.sqrt(np.mean(np.square(errors), axis=0))
    np.testing.assert_allclose(np.sqrt(solution.inflated_mm2(9.0).diagonal()), true, rtol=0.15)


def test_lengths_within_tolerance_count_for_joint_offsets() -> None:
    """What an error of a bar does to d_rho is refitted by hand: the bar's tolerance, times 1.96."""
    data = observed([0.1, -0.2, 0.3, 0.0, 0.0, 0.0], postures(), scatter_mm=0.002, seed=1)
    figures = IndicatorFigures(repeatability_mm=0.002)
    choice = choose_subset(Model(), data, indicator=figures, tolerance_mm=TOLERANCES)
    plain = choice.solutions["joint-offsets"]
    longer = observed([0.1, -0.2, 0.3, 0.1, 0.0, 0.0], postures(), scatter_mm=0.002, seed=1)
    again = choose_subset(Model(), longer, indicator=figures, tolerance_mm=TOLERANCES)
    moved = again.solutions["joint-offsets"].values_mm - plain.values_mm
    assert 0.1 * plain.outside[:, 3] == pytest.approx(moved, abs=1e-4)
    assert plain.expanded_with_tolerances_mm[0] == pytest.approx(1.96 * abs(moved[0]), rel=0.02)
    difference = plain.expanded_of_difference_mm
    assert difference is not None
    assert difference[0] < 0.05 * plain.expanded_with_tolerances_mm[0]
