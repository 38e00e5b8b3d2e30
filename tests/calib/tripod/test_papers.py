"""Sentences of papers/000 that no other test proves, by plain geometry beside the program."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from calib.arrays import conditions
from calib.tripod.differences import reading_matrix
from calib.tripod.geometry import Geometry, inverse, tool_jacobians
from calib.tripod.pipeline import Flow, Model, command
from tests.builders import postures

NOMINAL = Geometry()
L_MM = 310.25


def test_transmission_is_one_at_zero_and_half_to_two_in_a_cube_of_200() -> None:
    """2.1: the cube lies at -126.8 … 73.2 mm; about Zero, -100 … 100, the factor reaches 3.6."""
    at_zero, _ = tool_jacobians(NOMINAL, [0.0] * 3, [L_MM] * 3)
    assert np.linalg.svd(at_zero, compute_uv=False) == pytest.approx([1.0] * 3, abs=1e-12)
    for low, expected in ((-126.8, (0.4996, 2.003)), (-100.0, (0.5800, 3.627))):
        grid = np.linspace(low, low + 200.0, 11)
        tools = np.array(list(product(grid, grid, grid)))
        by_joints, _ = tool_jacobians(NOMINAL, tools, inverse(NOMINAL, tools))
        factors = np.linalg.svd(by_joints, compute_uv=False)
        assert (factors.min(), factors.max()) == pytest.approx(expected, abs=5e-4)


def test_legs_stay_parallel_to_their_planes_on_the_nominal_machine() -> None:
    """2.1 and 2.4: the x-leg at XMax, Zero and XMin is parallel to X."""
    rows = [
        (leg, axis, at)
        for leg in range(3)
        for axis in range(3)
        if axis != leg
        for at in (60.0, 0.0, -100.0)
    ]
    leg, axis, displacement = zip(*rows, strict=True)
    for station in (0.1, 0.5, 0.9):
        plan = conditions(leg, axis, displacement, station=station)
        assert Model().readings(plan) == pytest.approx(np.zeros(len(plan)), abs=1e-12)


def test_gauges_stand_at_10() -> None:
    """(10), of first order: the touched point of each leg at Zero."""
    rho, length = np.array([0.02, -0.01, 0.03]), np.array([-0.01, 0.02, 0.015])
    plan = conditions([0, 1, 2], [1, 2, 0], [0.0] * 3)
    model = Model(NOMINAL, tuple(np.concatenate([rho, length]).tolist()))
    flow = Flow(NOMINAL, model.parameters_mm, plan, command(NOMINAL, plan))
    middle = 0.5 * (flow.tool_mm + flow.foot_mm[np.arange(3), plan.leg])
    printed = np.tile(0.5 * (rho - length), (3, 1))
    printed[np.arange(3), np.arange(3)] = 0.5 * (L_MM - length) + rho
    assert middle == pytest.approx(printed, abs=1e-5)
    assert flow.touched_mm == pytest.approx(middle, abs=1e-12)


def test_parameter_mu() -> None:
    """3.2: μ = 0.5 + S - S ΔL/L, here the part of the bar from the foot, at XMax."""
    length = 0.1
    parameters = np.array([0.0, 0.0, 0.0, length, 0.0, 0.0])
    plan = conditions([0, 0], [1, 1], [60.0, 0.0])  # the last row is Zero
    flow = Flow(NOMINAL, parameters, plan, command(NOMINAL, plan))
    mu = 1.0 - flow.fraction[0]
    sine = 60.0 / L_MM
    assert mu == pytest.approx(0.5 + sine - sine * length / L_MM, abs=1e-7)


def test_differences_of_offsets_and_lengths_describe_the_full_set() -> None:
    """4.2, resume: what joint offsets and lengths share, d_rho - d_L, is all that shows well."""
    matrix = reading_matrix(NOMINAL, postures())
    common = np.abs(matrix @ np.vstack([np.eye(3), np.eye(3)])).max()
    apart = np.abs(matrix @ np.vstack([np.eye(3), -np.eye(3)])).max()
    assert common < 0.02
    assert apart > 0.6
