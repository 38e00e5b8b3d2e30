"""Identification: exact recovery, weighting, uncertainty, refusals."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.arrays import FloatArray, Observations, conditions, observe
from calib.errors import NotIdentifiable
from calib.identify.solution import Method, Subset
from calib.noise.reading import IndicatorFigures
from calib.tripod.pipeline import Model
from tests.builders import observed, postures
from tests.calib.identify.identified import choose_subset, identify
from tests.conftest import LONG

TOLERANCES_MM = np.array([2.0] * 3 + [0.1] * 3)
MODEL = Model()
within_3_mm = st.floats(-3.0, 3.0)


@settings(max_examples=30, deadline=None)
@given(st.lists(within_3_mm, min_size=6, max_size=6))
def test_noise_free_session_gives_the_parameters_back(truth: list[float]) -> None:
    """Issue figure: offsets and lengths off by up to 3 mm, back to 1e-6 mm."""
    solution = identify(MODEL, observed(truth, postures(repeats=3)), "both", "exact")
    assert solution.values_mm == pytest.approx(truth, abs=1e-6)


@pytest.mark.parametrize("levels", [(60.0, -100.0, 25.0), (0.0, 60.0, -100.0, -50.0, 20.0)])
def test_missing_zeros_and_extra_displacements(levels: tuple[float, ...]) -> None:
    truth = [0.9, -1.2, 0.3, 0.5, 0.1, -0.4]
    solution = identify(MODEL, observed(truth, postures(levels)), "both", "exact")
    assert solution.values_mm == pytest.approx(truth, abs=1e-6)


def test_two_stations() -> None:
    middle, near = postures(), postures(station=0.3)
    plan = conditions(
        np.concatenate([middle.leg, near.leg]).tolist(),
        np.concatenate([middle.axis, near.axis]).tolist(),
        np.concatenate([middle.displacement_mm, near.displacement_mm]).tolist(),
        station=[0.5] * len(middle) + [0.3] * len(near),
    )
    truth = [0.9, -1.2, 0.3, 0.5, 0.1, -0.4]
    solution = identify(MODEL, observed(truth, plan), "both", "exact")
    assert solution.values_mm == pytest.approx(truth, abs=1e-6)
    assert len(solution.differences.published_rows) == 12


@pytest.mark.parametrize("subset", ["joint-offsets", "leg-lengths", "both"])
def test_covariance_weighting_is_the_exact_fit_to_first_order(subset: Subset) -> None:
    data = observed([1e-5, -2e-5, 1e-5, 0.0, 1e-5, 0.0], postures(), scatter_mm=1e-5)
    weighted = identify(
        MODEL,
        data,
        subset,
        "linear",
        weights="covariance",
        indicator=IndicatorFigures(repeatability_mm=1e-5),
    )
    exact = identify(
        MODEL, data, subset, "exact", indicator=IndicatorFigures(repeatability_mm=1e-5)
    )
    assert weighted.values_mm == pytest.approx(exact.values_mm, abs=1e-7)
    assert weighted.covariance_mm2 == pytest.approx(exact.covariance_mm2, rel=1e-2)


def test_weighting_by_14_against_its_own_formula() -> None:
    """Generalised least squares with the covariance matrix as printed in the papers."""
    data = observed([0.3, -0.2, 0.5, 0.0, 0.0, 0.0], postures(), scatter_mm=0.02, seed=3)
    solution = identify(
        MODEL,
        data,
        "joint-offsets",
        "linear",
        weights="covariance",
        indicator=IndicatorFigures(repeatability_mm=0.02),
    )
    block = np.array([[2.0, 0, 1, 0], [0, 2, 0, 1], [1, 0, 2, 0], [0, 1, 0, 2]])
    inverse = np.linalg.inv(np.kron(np.eye(3), block))
    a1, a2 = np.arcsin(60 / 310.25), np.arcsin(-100 / 310.25)
    system = np.zeros((12, 3))
    for row, (i, j) in enumerate([(0, 1), (1, 2), (0, 2)]):
        for k, alpha in enumerate((a1, a2)):
            a, b = np.sin(alpha), (0.5 + np.sin(alpha)) * np.tan(alpha)
            system[4 * row + 2 * k, [i, j]] = a, b
            system[4 * row + 2 * k + 1, [i, j]] = b, a
    normal = system.T @ inverse @ system
    expected = np.linalg.solve(normal, system.T @ inverse @ solution.differences.value_mm)
    assert solution.values_mm == pytest.approx(expected, abs=1e-12)
    assert solution.covariance_mm2 == pytest.approx(0.02**2 * np.linalg.inv(normal))


@LONG
def test_intervals_cover_the_truth() -> None:
    """95 % intervals with noise from repeats: between 93 and 97 % of 600 sessions x 3."""
    truth = [0.4, -0.3, 0.8, 0.0, 0.0, 0.0]
    plan = postures(repeats=3)
    hits = 0
    for seed in range(600):
        data = observed(truth, plan, scatter_mm=0.005, seed=seed)
        solution = identify(MODEL, data, "joint-offsets", "exact")
        half = solution.coverage_factor * np.sqrt(np.diag(solution.covariance_mm2))
        hits += int((np.abs(solution.values_mm - truth[:3]) <= half).sum())
    assert 0.93 < hits / 1800 < 0.97


def test_averaged_values_weigh_as_their_number_of_readings() -> None:
    single = observed([0.5, -0.4, 0.2, 0.0, 0.0, 0.0], postures(repeats=3), scatter_mm=0.01)
    means = postures()
    cells = {
        key: single.value_mm[
            (single.leg == key[0]) & (single.axis == key[1]) & (single.displacement_mm == key[2])
        ].mean()
        for key in zip(means.leg, means.axis, means.displacement_mm, strict=True)
    }
    averaged = observe(means, np.array(list(cells.values())), np.full(len(means), 3.0))
    from_single = identify(
        MODEL, single, "joint-offsets", "exact", indicator=IndicatorFigures(repeatability_mm=0.01)
    )
    three = identify(
        MODEL, averaged, "joint-offsets", "exact", indicator=IndicatorFigures(repeatability_mm=0.01)
    )
    assert from_single.values_mm == pytest.approx(three.values_mm, abs=1e-9)
    ratio = from_single.noise.standard_deviation_mm / 0.01
    assert from_single.covariance_mm2 == pytest.approx(three.covariance_mm2 * ratio**2)


@pytest.mark.parametrize("method", ["linear", "exact"])
def test_one_posture_only(method: Method) -> None:
    with pytest.raises(NotIdentifiable, match="each mounting in a single posture"):
        identify(MODEL, observed([0.0] * 6, postures((0.0,))), "both", method)


def test_one_leg_only_names_what_is_not_seen() -> None:
    full = observed([0.1] * 6, postures())
    one_leg: Observations = full.take(full.leg == 0)
    with pytest.raises(NotIdentifiable, match="not identifiable"):
        identify(MODEL, one_leg, "both", "exact", indicator=IndicatorFigures(repeatability_mm=0.01))


def test_no_degree_of_freedom_and_no_noise_figure() -> None:
    data = observed([0.1, 0.2, 0.3, 0, 0, 0], postures((60.0, -100.0)))
    few = data.take(np.isin(data.mount, [0, 2, 4]))
    with pytest.raises(NotIdentifiable, match="noise of the readings"):
        identify(MODEL, few, "joint-offsets", "exact")


def test_lack_of_fit_is_quiet_on_good_data_and_loud_on_a_bent_leg() -> None:
    plan = postures(repeats=3)
    good = observed([0.5, 0.1, -0.2, 0, 0, 0], plan, scatter_mm=0.004, seed=5)
    fit = identify(MODEL, good, "joint-offsets", "exact").lack_of_fit
    assert fit is not None
    assert fit.p_value > 0.01
    bent = observe(plan, good.value_mm + 2e-5 * plan.displacement_mm**2 * (plan.leg == 1))
    fit = identify(MODEL, bent, "joint-offsets", "exact").lack_of_fit
    assert fit is not None
    assert fit.p_value < 1e-6


def test_one_blunder_does_not_take_the_other_subsets_along() -> None:
    """A reading ten millimetres off: what can be solved is solved, what cannot is refused."""
    good = observed([-0.5, 0.5, -1.7, 0, 0, 0], postures(), scatter_mm=0.02)
    value = good.value_mm.copy()
    value[4] += 10.0
    figures = IndicatorFigures(repeatability_mm=0.02)
    bad = observe(good, value)
    choice = choose_subset(MODEL, bad, indicator=figures, tolerance_mm=TOLERANCES_MM)
    assert "joint-offsets" in choice.solutions
    fit = choice.solutions["joint-offsets"].lack_of_fit
    assert fit is not None
    assert fit.p_value < 1e-6


def test_weak_combinations_are_named_where_the_noise_is_what_the_fit_leaves() -> None:
    """Zero, Max, Min once, nothing stated: d_rho + d_L of each leg is known to many millimetres."""
    data = observed([0.3, -0.2, 0.1, 0.0, 0.0, 0.0], postures(), scatter_mm=0.1, seed=4)
    solution = identify(MODEL, data, "both")
    assert solution.noise.source == "residuals"
    names = [direction.combination for direction in solution.weak_directions]
    assert names == ["d_rho_x + d_L_x", "d_rho_y + d_L_y", "d_rho_z + d_L_z"]
    sums = np.hstack([np.eye(3), np.eye(3)])
    spread = np.sqrt(np.diag(sums @ solution.covariance_mm2 @ sums.T))
    uncertainties = [direction.standard_uncertainty_mm for direction in solution.weak_directions]
    assert uncertainties == pytest.approx(spread, rel=0.01)


def _by_hand_mm(readings: Observations) -> tuple[FloatArray, FloatArray]:
    """± (95 %) of joint offsets for 1 mm of scatter, and for 1 mm that a posture has in common."""
    step_mm, still_mm = 1e-3, Model().readings(readings)
    moved = (
        Model(parameters_mm=tuple(step_mm * np.eye(6)[k])).readings(readings) for k in range(3)
    )
    design = np.stack([one_mm - still_mm for one_mm in moved], axis=1) / step_mm
    for mount in range(readings.mount_count):
        design[readings.mount == mount] -= design[readings.mount == mount].mean(axis=0)
    estimator = np.linalg.pinv(design)
    alike = (readings.posture[:, None] == readings.posture).astype(np.float64)
    separate, shared = estimator @ estimator.T, estimator @ alike @ estimator.T
    return 1.96 * np.sqrt(separate.diagonal()), 1.96 * np.sqrt(shared.diagonal())


def test_the_budget_is_scatter_steps_and_parts() -> None:
    """Repeats lower what scatters, not what a coarse display does to all of a posture."""
    plan = postures(repeats=3)
    tolerance_mm = np.array([2.0] * 3 + [0.1] * 3)
    observations = observed([0.01, -0.02, 0.03, 0.0, 0.0, 0.0], plan)
    separate, shared = _by_hand_mm(observations)
    coarse = IndicatorFigures(resolution_mm=0.01)
    solution = identify(
        Model(), observations, "joint-offsets", indicator=coarse, tolerance_mm=tolerance_mm
    )
    scatter_mm, steps_mm, parts_mm = solution.budget_mm.values()
    assert scatter_mm == pytest.approx(np.zeros(3), abs=1e-6)
    assert steps_mm == pytest.approx(0.01 / math.sqrt(12.0) * shared, rel=1e-3)
    off_mm = 1.96 * np.linalg.norm(solution.outside * tolerance_mm, axis=1)
    assert parts_mm == pytest.approx(off_mm, rel=1e-3)

    fine = IndicatorFigures(repeatability_mm=0.02)
    solution = identify(
        Model(), observations, "joint-offsets", indicator=fine, tolerance_mm=tolerance_mm
    )
    assert solution.budget_mm["scatter of repeats"] == pytest.approx(0.02 * separate, rel=1e-3)
    assert solution.budget_mm["steps of the display"] == pytest.approx(np.zeros(3), abs=1e-9)
    together = sum(part**2 for part in solution.budget_mm.values())
    assert together == pytest.approx(solution.expanded_with_tolerances_mm**2)

    held = identify(
        Model(), observations, "with-tolerances", indicator=fine, tolerance_mm=tolerance_mm
    )
    scatter_mm, steps_mm, parts_mm = held.budget_mm.values()
    assert held.noise_expanded_mm == pytest.approx(np.hypot(scatter_mm, steps_mm))
    assert (held.noise_expanded_mm[:3] < 0.5 * held.expanded_mm[:3]).all()
    assert solution.noise_expanded_mm == pytest.approx(solution.expanded_mm)
