"""The bound at the tool: its quantile, its derivatives, and what readings take away of it."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from calib.arrays import Observations, observe
from calib.identify.subset_choice import choose_subset
from calib.identify.tool_bound import NAMELESS, ToolBound, claim_of, quantile_mm
from calib.noise.reading import IndicatorFigures
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.candidates import tool_columns
from calib.tripod.effects.contract import fault_of
from calib.tripod.effects.drives import effects_of
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.effects.empirical import Coupling
from calib.tripod.geometry import Geometry, inverse
from calib.tripod.pipeline import Model
from calib.tripod.workspace import machine_at, workspace_points
from tests.builders import conditions_of, observed, postures
from tests.tripods import DELTA, ORTHOGLIDE

FIGURES = IndicatorFigures(repeatability_mm=0.002)
TOLERANCES = np.array([2.0, 2.0, 2.0, 0.1, 0.1, 0.1])


def test_the_quantile_is_that_of_drawn_errors() -> None:
    """Against a million draws: two moments give the 95 % quantile within 2 %."""
    generator = np.random.default_rng(3)
    root, spread = generator.normal(size=(2, 5, 5))
    metric, covariance = root @ root.T, spread @ spread.T
    for mean in (np.zeros(5), generator.normal(size=5) * 3.0):
        draws = mean + generator.normal(size=(1_000_000, 5)) @ spread.T
        square = np.einsum("ni,ij,nj->n", draws, metric, draws)
        true = float(np.sqrt(np.quantile(square, 0.95)))
        assert quantile_mm(metric, mean, covariance) == pytest.approx(true, rel=0.02)


@pytest.mark.parametrize("geometry", [ORTHOGLIDE, DELTA], ids=["orthoglide", "linear-delta"])
def test_tool_columns_are_differences_of_the_machine(geometry: Geometry) -> None:
    """Against small real sizes in the pipeline, for every effect that moves the machine."""
    points = workspace_points(geometry)[::25]
    wanted = np.vstack([points, np.zeros(3)])
    joint_mm, taken = inverse(geometry, wanted), conditions_of("sweep")
    for effect in (*effects_of(CATALOGUE, geometry), *NAMELESS):
        for place in effect.places(taken)[:2]:
            found = tool_columns(geometry, points, [(effect, place)], -1.0)
            for k, parameter in enumerate(effect.parameters):
                values = [0.0] * len(effect.parameters)
                values[k] = 0.01 * parameter.tolerance
                acting = Model(geometry, effects=(EffectInstance(effect, place, tuple(values)),))
                moved = machine_at(acting, joint_mm, -1.0).tool_mm - wanted
                moved = moved[:-1] - moved[-1] if geometry.set_at_zero else moved[:-1]
                assert found[:, :, k] * values[k] == pytest.approx(moved, abs=1e-6)


def test_a_coupling_is_the_product_of_two_travels() -> None:
    """0.1 mm where both are 100 mm off Zero: 0.1 x 0.5 x -0.4 at 50 and -40 mm, along its axis."""
    joint_mm = np.add(ORTHOGLIDE.zero_mm, [[50.0, -40.0, 7.0]])
    flow: Any = SimpleNamespace(command_mm=joint_mm, geometry=ORTHOGLIDE)
    moved = Coupling().change(np.zeros((1, 3)), flow, "xy", (100.0,))
    assert moved == pytest.approx(np.array([[-0.02, 0.0, 0.0]]))
    assert fault_of(Coupling()) == ""


def test_the_workspace_keeps_the_joint_limits() -> None:
    """The cube of the limits itself does not: its corners ask for more travel than there is."""
    points = workspace_points(ORTHOGLIDE, 12)
    travel = inverse(ORTHOGLIDE, points) - ORTHOGLIDE.zero_mm
    assert travel.min() >= ORTHOGLIDE.travel_min_mm
    assert travel.max() <= ORTHOGLIDE.travel_max_mm
    assert 0.65 * 12**3 < len(points) < 0.75 * 12**3


def bound_with_offsets(data: Observations) -> ToolBound:
    """With the joint offsets entered that these readings give."""
    choice = choose_subset(Model(), data, indicator=FIGURES, tolerance_mm=TOLERANCES)
    fitted, entered = choice.fitted.model, choice.solutions["joint-offsets"].model
    claim, _ = claim_of(fitted, data, choice.fitted.noise, TOLERANCES, (0.0,) * 6)
    return claim.bound(np.array(entered.parameters_mm) - np.array(fitted.parameters_mm))


def test_more_readings_lower_the_bound_and_a_hidden_scale_is_in_it() -> None:
    """Three times more set-ups rule more out; a scale of 1 mm/m does 0.05 mm at the tool."""
    few = observed([0.1, -0.2, 0.3, 0.0, 0.0, 0.0], postures(), scatter_mm=0.002, seed=1)
    stations = conditions_of("two-station")
    hidden = Model(parameters_mm=(0.1, -0.2, 0.3, 0.0, 0.0, 0.0))
    generator = np.random.default_rng(2)
    noise = 0.002 * generator.normal(size=len(stations))
    scale = next(effect for effect in CATALOGUE if effect.id == "actuator_scale")
    wrong = replace(hidden, effects=(EffectInstance(scale, "y", (1.0,)),))
    bounds = [
        bound_with_offsets(data)
        for data in (
            few,
            observe(stations, hidden.readings(stations) + noise),
            observe(stations, wrong.readings(stations) + noise),
        )
    ]
    assert bounds[1].bound_mm < 0.7 * bounds[0].bound_mm
    # r.m.s. of 1 mm/m of travel over the workspace, from the pipeline
    points = workspace_points(ORTHOGLIDE)
    moved = machine_at(replace(Model(), effects=wrong.effects), inverse(ORTHOGLIDE, points), 1.0)
    true = float(np.sqrt(((moved.tool_mm - points) ** 2).sum(axis=1).mean()))
    assert true < bounds[2].bound_mm < 3.0 * true
    assert bounds[2].parameters_mm < 0.5 * true  # what would be claimed without the catalogue
    # of these readings the first two show nothing, the third the scale and what looks like it
    assert bounds[0].worst_shown is bounds[1].worst_shown is None
    assert bounds[0].worst_unseen == bounds[0].names[0]
    shown = {one.id: one.bound_mm for one in bounds[2].names if one.shown}
    assert shown["actuator_scale"] > true


def test_lengths_within_tolerance_count_for_joint_offsets() -> None:
    """What an error of a bar does to d_rho is refitted by hand: the bar's tolerance, times 1.96."""
    data = observed([0.1, -0.2, 0.3, 0.0, 0.0, 0.0], postures(), scatter_mm=0.002, seed=1)
    choice = choose_subset(Model(), data, indicator=FIGURES, tolerance_mm=TOLERANCES)
    plain = choice.solutions["joint-offsets"]
    longer = observed([0.1, -0.2, 0.3, 0.1, 0.0, 0.0], postures(), scatter_mm=0.002, seed=1)
    again = choose_subset(Model(), longer, indicator=FIGURES, tolerance_mm=TOLERANCES)
    moved = again.solutions["joint-offsets"].values_mm - plain.values_mm
    assert 0.1 * plain.outside[:, 3] == pytest.approx(moved, abs=1e-4)
    assert plain.expanded_with_tolerances_mm[0] == pytest.approx(1.96 * abs(moved[0]), rel=0.02)
    difference = plain.expanded_of_difference_mm
    assert difference is not None
    assert difference[0] < 0.05 * plain.expanded_with_tolerances_mm[0]
