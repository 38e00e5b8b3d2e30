"""The closed form against the pipeline, the batched Newton fit against scipy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from calib.arrays import (
    Conditions,
    FloatArray,
    Observations,
    conditions,
    observe,
    tool_conditions,
    without_zeros,
)
from calib.identify.fit import PlainFit, exact_fit, prior_fit
from calib.identify.solution import SUBSETS, Subset
from calib.newton import minimise, solve_positive
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.geometry import Geometry
from calib.tripod.pipeline import Model, derivatives, simulate
from calib.tripod.plain import PapersDesign, TripodDesign
from tests.builders import postures
from tests.conftest import first_quick
from tests.tripods import TRIPODS


def random_conditions(generator: np.random.Generator, geometry: Geometry) -> Conditions:
    count = 40
    leg = generator.integers(0, 3, count)
    axis = (leg + generator.integers(1, 3, count)) % 3
    displacement = generator.uniform(geometry.travel_min_mm, geometry.travel_max_mm, count)
    displacement[::7] = 0.0
    if not geometry.common_zero:  # a leg reaches less from a Zero of its own
        displacement = np.clip(displacement, 0.0, 60.0)
    station = generator.uniform(0.1, 0.9, count)
    return conditions(leg.tolist(), axis.tolist(), displacement.tolist(), station=station.tolist())


@pytest.mark.parametrize("seed", range(8))
def test_closed_form_and_its_derivatives_are_the_pipeline(seed: int) -> None:
    generator = np.random.default_rng(seed)
    geometry = Geometry(leg_length_mm=(float(generator.uniform(200.0, 900.0)),) * 3)
    assert_is_the_pipeline(geometry, random_conditions(generator, geometry), PapersDesign, seed)


@pytest.mark.parametrize("geometry", TRIPODS.values(), ids=TRIPODS)
def test_a_fit_held_by_tolerances_is_the_same_through_the_stages(geometry: Geometry) -> None:
    """Without effects in closed form, each posture once; with one of size nothing by stages."""
    low, high = geometry.workspace_mm or ((-60.0,) * 3, (40.0,) * 3)
    places = np.repeat(np.random.default_rng(2).uniform(low, high, (12, 3)), 2, axis=0)
    plan = tool_conditions(places)
    truth = Model(geometry, (0.4, -0.3, 0.2, 0.05, -0.02, 0.01))
    observations = observe(plan, truth.readings(plan))
    nothing = EffectInstance(
        next(effect for effect in CATALOGUE if effect.id == "actuator_scale"), "x", (0.0,)
    )
    tolerance_mm = np.array([2.0] * 3 + [0.1] * 3)
    plain, staged = (
        prior_fit(Model(geometry, effects=effects), observations, np.full(24, 1e6), tolerance_mm)
        for effects in ((), (nothing,))
    )
    assert plain.parameters_mm == pytest.approx(staged.parameters_mm, abs=1e-8)
    assert plain.design == pytest.approx(staged.design, abs=1e-9)
    assert plain.predicted_mm == pytest.approx(staged.predicted_mm, abs=1e-9)


@pytest.mark.parametrize("geometry", TRIPODS.values(), ids=TRIPODS)
def test_the_form_for_any_tripod_is_the_pipeline(geometry: Geometry) -> None:
    """On legs where these are read, at the tool on every machine."""
    generator = np.random.default_rng(1)
    low, high = geometry.workspace_mm or ((-60.0,) * 3, (40.0,) * 3)
    at_tool = [tool_conditions(generator.uniform(low, high, (20, 3)), axis) for axis in range(3)]
    for plan in (*at_tool, *([random_conditions(generator, geometry)] * geometry.reads_legs)):
        assert_is_the_pipeline(geometry, plan, TripodDesign, 2)


def assert_is_the_pipeline(
    geometry: Geometry,
    plan: Conditions,
    kind: type[PapersDesign] | type[TripodDesign],
    seed: int,
) -> None:
    machines = np.random.default_rng(seed).uniform(-5.0, 5.0, (6, 3))
    values, slopes = kind.of(geometry, plan).readings_and_derivatives(machines)
    for b in range(3):
        exact = simulate(geometry, machines[:, b], plan)
        np.testing.assert_allclose(values[:, b], exact, rtol=0.0, atol=1e-11)
        by_step = derivatives(geometry, machines[:, b], plan)
        np.testing.assert_allclose(slopes[:, :, b].T, by_step, rtol=0.0, atol=1e-12)


def sessions(scatter_mm: float, count: int, seed: int = 0) -> tuple[Conditions, FloatArray]:
    """Readings of standard sessions on random machines, ``(n_readings, count)``."""
    generator = np.random.default_rng(seed)
    plan = postures(repeats=3)
    truth = generator.uniform(-2.0, 2.0, (count, 6))
    zeros = generator.normal(size=(count, plan.mount_count))
    values = simulate(Geometry(), truth, plan) + zeros[:, plan.mount]
    values = values + generator.normal(scale=scatter_mm, size=values.shape)
    return plan, values.T


def by_scipy(plan: Conditions, value_mm: FloatArray, free: tuple[int, ...]) -> FloatArray:
    """Raw readings, one unknown zero for each mounting, scipy's trust region, complex step."""
    geometry, index = Geometry(), list(free)

    def full(x: FloatArray) -> FloatArray:
        parameters = np.zeros(6)
        parameters[index] = x[: len(index)]
        return parameters

    def residual(x: FloatArray) -> FloatArray:
        modelled = simulate(geometry, full(x), plan) + x[len(index) :][plan.mount]
        return np.asarray(modelled - value_mm)

    def jacobian(x: FloatArray) -> FloatArray:
        columns = derivatives(geometry, full(x), plan)[:, index]
        return np.hstack([columns, np.eye(plan.mount_count)[plan.mount]])

    start = np.zeros(len(index) + plan.mount_count)
    solution = least_squares(
        residual, start, jac=jacobian, x_scale="jac", ftol=1e-15, xtol=1e-15, gtol=1e-15
    ).x
    for _ in range(60):  # scipy stops where the sum of squares no longer moves; go on to the end
        solution = solution - np.linalg.lstsq(jacobian(solution), residual(solution), rcond=None)[0]
    return np.asarray(solution[: len(index)])


def identify_many(
    observations: Observations, free: tuple[int, ...], values: FloatArray
) -> FloatArray:
    """Free parameters ``(k, sessions)``, NaN where a session has no optimum."""
    optimum = PlainFit(Model(), observations, free, observations.averaged).solve(values)
    return np.where(optimum.converged, optimum.values, np.nan)


@pytest.mark.parametrize("subset", first_quick(["joint-offsets", "leg-lengths", "both"]))
@pytest.mark.parametrize("scatter_mm", first_quick([1e-4, 0.01]))
def test_same_optimum_as_scipy(subset: Subset, scatter_mm: float) -> None:
    free = SUBSETS[subset]
    plan, values = sessions(scatter_mm, 6)
    observations = observe(plan, values[:, 0])
    solutions = identify_many(observations, free, values)
    for b in range(values.shape[1]):
        expected = by_scipy(plan, values[:, b], free)
        np.testing.assert_allclose(solutions[:, b], expected, rtol=0.0, atol=1e-9)


def test_every_one_of_many_sessions_converges() -> None:
    plan, values = sessions(0.01, 3000, seed=4)
    observations = observe(plan, values[:, 0])
    solutions = identify_many(observations, SUBSETS["both"], values)
    assert np.isfinite(solutions).all()
    alone = exact_fit(Model(), observations, SUBSETS["both"], np.ones(len(plan)))
    np.testing.assert_allclose(solutions[:, 0], alone.parameters_mm, atol=1e-9)


def test_a_session_out_of_reach_is_told_and_leaves_the_others_alone() -> None:
    plan, values = sessions(0.001, 4)
    values[:, 2] = 1e6 * np.random.default_rng(1).normal(size=len(values))
    solutions = identify_many(observe(plan, values[:, 0]), SUBSETS["both"], values)
    assert np.isfinite(solutions[:, [0, 1, 3]]).all()
    alone = identify_many(observe(plan, values[:, 0]), SUBSETS["both"], values[:, [0, 1, 3]])
    np.testing.assert_allclose(solutions[:, [0, 1, 3]], alone, atol=1e-9)


def test_unequal_weights_count_in_means_as_in_raw_readings() -> None:
    plan, values = sessions(0.02, 1, seed=9)
    generator = np.random.default_rng(2)
    weight = generator.uniform(0.5, 3.0, len(plan))
    observations = observe(plan, values[:, 0])
    fit = exact_fit(Model(), observations, SUBSETS["both"], weight)
    residual = without_zeros(observations, weight, observations.value_mm - fit.predicted_mm)
    centred = without_zeros(observations, weight, fit.design)
    assert np.abs(centred.T @ (weight * residual)).max() < 1e-8


def test_rosenbrock_needs_the_damping() -> None:
    """Full Newton steps overshoot there; the damped ones arrive, all problems at once."""
    start = np.array([[-1.2, 0.0, 3.0], [1.0, 0.0, -2.0]])

    def evaluate(x: FloatArray, _: object) -> tuple[FloatArray, FloatArray]:
        residual = np.stack([-10.0 * (x[1] - x[0] ** 2), x[0] - 1.0])
        unit = np.ones_like(x[0])
        slope = np.stack(
            [np.stack([-20.0 * x[0], -unit]), np.stack([10.0 * unit, np.zeros_like(unit)])]
        )
        return residual, slope

    minimum = minimise(evaluate, start, np.zeros((2, 2, 2)))
    assert minimum.converged.all()
    np.testing.assert_allclose(minimum.values, 1.0, atol=1e-7)


def test_cholesky_over_the_last_axis_against_numpy() -> None:
    generator = np.random.default_rng(5)
    factor = generator.normal(size=(7, 6, 6))
    matrix = factor @ factor.transpose(0, 2, 1)
    matrix[3] -= 50.0 * np.eye(6)
    right = generator.normal(size=(7, 6))
    solution, positive = solve_positive(matrix.transpose(1, 2, 0), right.T)
    assert positive.tolist() == [True, True, True, False, True, True, True]
    expected = np.linalg.solve(matrix, right[..., None])[..., 0]
    good = [0, 1, 2, 4, 5, 6]
    np.testing.assert_allclose(solution.T[good], expected[good], rtol=1e-8)


def test_observations_are_not_touched() -> None:
    plan, values = sessions(0.01, 2)
    observations = observe(plan, values[:, 0])
    before = Observations(**vars(observations))
    identify_many(observations, SUBSETS["both"], values)
    assert np.array_equal(before.value_mm, observations.value_mm)
