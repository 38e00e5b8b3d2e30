"""What is expected before measuring, against simulated sessions of sound machines."""

from __future__ import annotations

from dataclasses import astuple

import numpy as np
import pytest

from app.planning.tripod import stated_noise
from calib.arrays import Observations, observe
from calib.noise.reading import IndicatorFigures
from calib.posterior.cells import SessionCase
from calib.posterior.correction import correction
from calib.posterior.expected import ExpectedResult, expected_of
from calib.posterior.posterior import posterior
from calib.tripod.geometry import PARAMETER_NAMES
from calib.tripod.pipeline import Model
from calib.tripod.planning import TripodPlanning
from protocols.machine import Machine
from tests.builders import conditions_of
from tests.conftest import LONG, first_quick

TOLERANCE_MM = np.array([2.0] * 3 + [0.1] * 3)


def planning(observations: Observations, noise_mm: float) -> TripodPlanning:
    return TripodPlanning(
        name="orthoglide",
        geometry=Machine().geometry(),
        procedure="any",
        planned=observations,
        of_tool=False,
        stations=(0.5,),
        step_count=len(observations) // 2,
        mounting_count=3,
        seconds_per_step=20.0,
        minutes_per_mounting=2.0,
        noise=stated_noise(Machine(), noise_mm)[0],
        noise_words="",
    )


def expected(procedure: str, noise_mm: float = 0.002) -> ExpectedResult:
    return expected_of(planning(conditions_of(procedure), noise_mm), TOLERANCE_MM)


@LONG
@pytest.mark.parametrize("procedure", first_quick(["zero-max-min", "two-station"]))
def test_the_bound_is_that_of_a_session_that_shows_nothing_new(procedure: str) -> None:
    """Of the same machine, read with this noise; its own zero readings and repeats included."""
    observations = conditions_of(procedure)
    bounds_mm = []
    for seed in range(5):
        noise = 0.002 * np.random.default_rng(seed).normal(size=len(observations))
        data = observe(observations, Model().readings(observations) + noise)
        figures = IndicatorFigures(repeatability_mm=0.002)
        result = posterior([SessionCase(Model(), data, figures, TOLERANCE_MM)])
        bounds_mm.append(correction(result, "offsets").off.bound_mm["touched-off"])
    # readings without noise speak for nothing at all: one bound in five is lower than in a session
    assert 0.8 < expected(procedure).bound_mm / np.median(bounds_mm) < 1.05


def test_more_readings_and_less_noise_lower_the_bound() -> None:
    coarse, fine = (expected("zero-max-min", noise_mm) for noise_mm in (0.02, 0.002))
    better = expected("two-station")
    assert better.bound_mm < fine.bound_mm < coarse.bound_mm


def test_parameters_are_half_widths_of_least_squares() -> None:
    """Of the derivatives that the examination of the procedure has, by normal equations."""
    observations = conditions_of("two-station")
    plan = planning(observations, 0.002)
    result = expected_of(plan, TOLERANCE_MM)
    rows = plan.examine().sensitivity.jacobian

    def half_widths(design: np.ndarray) -> np.ndarray:
        return np.asarray(1.96 * np.sqrt(np.linalg.inv(design.T @ design).diagonal()))

    alone = [*half_widths(rows[:, :3]), *half_widths(rows[:, 3:])]
    free = half_widths(rows)
    with_tolerances = half_widths(np.vstack([rows, np.diag(1.0 / TOLERANCE_MM)]))
    assert [parameter.name for parameter in result.parameters] == [*PARAMETER_NAMES]
    for number, expectation in enumerate(result.parameters):
        assert expectation.alone_mm == pytest.approx(alone[number], rel=1e-3)
        assert expectation.all_mm == pytest.approx(free[number], rel=1e-2)
        assert expectation.held_mm == pytest.approx(with_tolerances[number], rel=1e-3)
        assert expectation.held_mm <= min(free[number], 1.97 * TOLERANCE_MM[number])


def test_what_a_procedure_does_not_see_has_no_uncertainty_without_tolerances() -> None:
    """One leg tells nothing of the others; within tolerances these are as uncertain as before."""
    every = conditions_of("zero-max-min")
    result = expected_of(planning(every.take(every.leg == 0), 0.002), TOLERANCE_MM)
    for parameter in result.parameters:
        _, _, together, within = astuple(parameter)
        assert together is None
        assert 0.0 < within < 4.1
    three = expected("zero-max-min").parameters
    assert all(None not in astuple(parameter) for parameter in three)


@pytest.mark.parametrize("sure", [0, 3])
def test_a_tolerance_far_below_the_others_is_no_lost_direction(sure: int) -> None:
    """Before: infinite for all six, which no table and no document takes."""
    tolerance_mm = TOLERANCE_MM.copy()
    tolerance_mm[sure : sure + 3] = 1e-9
    result = expected_of(planning(conditions_of("zero-max-min"), 0.02), tolerance_mm)
    held_mm = [parameter.held_mm for parameter in result.parameters]
    assert held_mm[sure : sure + 3] == pytest.approx([1.96e-9] * 3, rel=1e-3)
    alone_mm = [parameter.alone_mm for parameter in result.parameters]
    free = slice(3 - sure, 6 - sure)
    assert held_mm[free] == pytest.approx(alone_mm[free], rel=0.05)
