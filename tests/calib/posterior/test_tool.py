"""The tool over the workspace: derivatives by every law, and the bound that readings leave."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from calib.arrays import Observations, observe
from calib.noise.reading import IndicatorFigures
from calib.posterior.cells import SessionCase
from calib.posterior.correction import Correction, correction
from calib.posterior.library import laws
from calib.posterior.models import Posterior
from calib.posterior.posterior import posterior
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.candidates import tool_columns
from calib.tripod.effects.contract import fault_of
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.effects.empirical import Coupling, Repeating
from calib.tripod.geometry import Geometry, inverse
from calib.tripod.pipeline import Model
from calib.tripod.workspace import machine_at, workspace_points
from tests.builders import conditions_of, observed, postures
from tests.tripods import DELTA, ORTHOGLIDE

FIGURES = IndicatorFigures(repeatability_mm=0.002)
TOLERANCES = np.array([2.0, 2.0, 2.0, 0.1, 0.1, 0.1])


@pytest.mark.parametrize("geometry", [ORTHOGLIDE, DELTA], ids=["orthoglide", "linear-delta"])
def test_tool_columns_are_differences_of_the_machine(geometry: Geometry) -> None:
    """Against small real sizes in the pipeline, for every law that moves the machine."""
    points = workspace_points(geometry)[::25]
    targets = np.vstack([points, np.zeros(3)])
    joint_mm, conditions = inverse(geometry, targets), conditions_of("sweep")
    for effect in laws(geometry):
        for place in effect.places(conditions)[:2]:
            columns = tool_columns(geometry, points, [(effect, place)], -1.0)
            for k, parameter in enumerate(effect.parameters):
                values = [0.0] * len(effect.parameters)
                values[k] = 0.01 * parameter.tolerance
                acting = Model(geometry, effects=(EffectInstance(effect, place, tuple(values)),))
                moved = machine_at(acting, joint_mm, -1.0).tool_mm - targets
                moved = moved[:-1] - moved[-1] if geometry.set_at_zero else moved[:-1]
                assert columns[:, :, k] * values[k] == pytest.approx(moved, abs=1e-6)


def test_a_coupling_is_the_product_of_two_travels() -> None:
    """0.1 mm where both are 100 mm off Zero: 0.1 x 0.5 x -0.4 at 50 and -40 mm, along its axis."""
    joint_mm = np.add(ORTHOGLIDE.zero_mm, [[50.0, -40.0, 7.0]])
    flow: Any = SimpleNamespace(command_mm=joint_mm, geometry=ORTHOGLIDE)
    moved = Coupling().change(np.zeros((1, 3)), flow, "xy", (100.0,))
    assert moved == pytest.approx(np.array([[-0.02, 0.0, 0.0]]))
    assert fault_of(Coupling()) == ""


def test_what_repeats_has_three_harmonics_and_is_nothing_at_zero() -> None:
    """A quarter of 20 mm from Zero: sines 1, 0, -1 and cosines less one -1, -2, -1."""
    law = Repeating(20.0)
    joint_mm = np.add(ORTHOGLIDE.zero_mm, [[5.0, 0.0, 0.0], [20.0, 0.0, 0.0]])
    flow: Any = SimpleNamespace(command_mm=joint_mm, geometry=ORTHOGLIDE)
    moved = law.change(np.zeros((2, 3)), flow, "x", (1.0, 10.0, 100.0, 1e3, 1e4, 1e5))
    assert moved[0, 0] == pytest.approx((1.0 - 10.0 - 2e3 - 1e4 - 1e5) / 1e3)
    assert moved[1] == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)
    assert fault_of(law) == ""


def with_offsets(data: Observations) -> tuple[Posterior, Correction]:
    """With the joint offsets entered that these readings give."""
    result = posterior([SessionCase(Model(), data, FIGURES, TOLERANCES)])
    return result, correction(result, "offsets", "machine")


FEW = observed([0.1, -0.2, 0.3, 0.0, 0.0, 0.0], postures(), scatter_mm=0.002, seed=1)
MACHINE = Model(parameters_mm=(0.1, -0.2, 0.3, 0.0, 0.0, 0.0))
SCALE = next(effect for effect in CATALOGUE if effect.id == "actuator_scale")
WITH_SCALE = replace(MACHINE, effects=(EffectInstance(SCALE, "y", (1.0,)),))


def at_two_stations(machine: Model) -> Observations:
    stations = conditions_of("two-station")
    noise = 0.002 * np.random.default_rng(2).normal(size=len(stations))
    return observe(stations, machine.readings(stations) + noise)


def test_more_readings_lower_the_bound() -> None:
    """Three times more set-ups rule more out."""
    few, many = (with_offsets(data) for data in (FEW, at_two_stations(MACHINE)))
    for result, _ in (few, many):
        assert max(result.places.values()) < 0.5
    assert many[1].off.bound_mm["machine"] < 0.7 * few[1].off.bound_mm["machine"]


def test_a_hidden_scale_is_in_the_bound() -> None:
    """A scale of 1 mm/m does 0.05 mm at the tool, worked out here by the pipeline."""
    result, entered = with_offsets(at_two_stations(WITH_SCALE))
    points = workspace_points(ORTHOGLIDE)
    left_mm = np.subtract(WITH_SCALE.parameters_mm, entered.model.parameters_mm)
    keeps = replace(WITH_SCALE, parameters_mm=tuple(left_mm.tolist()))
    moved = machine_at(keeps, inverse(ORTHOGLIDE, points), 1.0)
    true = float(np.sqrt(((moved.tool_mm - points) ** 2).sum(axis=1).mean()))
    assert true < entered.off.bound_mm["machine"] < 3.0 * true
    scales = [p for (name, _), p in result.places.items() if name == "actuator_scale"]
    assert sum(scales) > 0.5
