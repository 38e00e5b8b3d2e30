"""The forward simulation against published derivatives, and its seam for effects."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from calib.arrays import conditions, observe
from calib.errors import UnreachablePosture
from calib.tripod.differences import differences, reading_matrix
from calib.tripod.geometry import Geometry
from calib.tripod.pipeline import Flow, Model, Stage, StageEffect, command, derivatives, simulate
from tests.builders import postures

NOMINAL = Geometry()


@settings(max_examples=40, deadline=None)
@given(
    length=st.floats(150.0, 900.0),
    high=st.floats(0.05, 0.5),
    low=st.floats(-0.5, -0.05),
    station=st.floats(0.1, 0.9),
)
def test_system_11_is_the_derivative_of_the_exact_pipeline(
    length: float, high: float, low: float, station: float
) -> None:
    """Issue figure: central differences of the pipeline, 1e-8, for any L, limits and station."""
    geometry = Geometry((length,) * 3, high * length, low * length)
    plan = postures((0.0, geometry.travel_max_mm, geometry.travel_min_mm), station=station)
    h = 1e-3
    steps = h * np.eye(6)
    central = (simulate(geometry, steps, plan) - simulate(geometry, -steps, plan)).T / (2 * h)
    assert reading_matrix(geometry, plan) == pytest.approx(central, abs=1e-8)


@pytest.mark.parametrize(
    ("levels", "expected_names"),
    [
        ((0.0, 60.0, -100.0), {"y_x+", "y_x-"}),
        ((60.0, -100.0), {"y_x"}),
        ((60.0, 25.0), {"y_x@60.0-(25.0)"}),
        ((0.0, 60.0, -37.0), {"y_x+", "y_x@-37.0"}),
    ],
)
def test_any_set_of_differences_is_the_derivative_of_the_exact_pipeline(
    levels: tuple[float, ...], expected_names: set[str]
) -> None:
    """Missing zeros, only Max minus Min, extra displacements: system (11) of what is there."""
    plan = postures(levels)
    measured = differences(NOMINAL, observe(plan, np.zeros(len(plan))))
    assert {name for name in measured.names if name.startswith("y_x")} == expected_names
    h = 1e-3
    steps = h * np.eye(6)
    central = (simulate(NOMINAL, steps, plan) - simulate(NOMINAL, -steps, plan)).T / (2 * h)
    system = measured.combine @ reading_matrix(NOMINAL, plan)
    assert system == pytest.approx(measured.combine @ central, abs=1e-8)


def test_complex_step_derivatives_away_from_the_nominal_machine() -> None:
    plan = postures((0.0, 60.0, 30.0, -45.0, -100.0))
    base = np.array([1.5, -2.0, 0.7, 0.4, -0.3, 1.1])
    h = 1e-4
    forward, back = (simulate(NOMINAL, base + s * h * np.eye(6), plan) for s in (1, -1))
    exact = derivatives(NOMINAL, base, plan)
    assert exact == pytest.approx((forward - back).T / (2 * h), abs=1e-8)


def test_readings_at_zero_are_zero_whatever_the_machine() -> None:
    plan = postures((0.0, 0.0))
    readings = simulate(NOMINAL, [2.0, -1.0, 3.0, 0.5, 0.2, -0.7], plan)
    assert readings == pytest.approx(np.zeros(len(plan)), abs=1e-12)


def test_batch_of_machines_equals_one_after_the_other() -> None:
    plan = postures()
    machines = np.random.default_rng(5).uniform(-3, 3, (7, 6))
    together = simulate(NOMINAL, machines, plan)
    assert together.shape == (7, len(plan))
    for machine, row in zip(machines, together, strict=True):
        assert row == pytest.approx(simulate(NOMINAL, machine, plan), abs=1e-12)


def test_commands_of_the_named_postures() -> None:
    """theory: XMax is (L + L sin a, L cos a, L cos a) with sin a = 60 / L."""
    joints = command(NOMINAL, conditions([0, 0, 0], [1, 1, 1], [0.0, 60.0, -100.0]))
    cosine = np.cos(np.arcsin(60.0 / 310.25))
    assert joints[0] == pytest.approx([310.25] * 3)
    assert joints[1] == pytest.approx([370.25, 310.25 * cosine, 310.25 * cosine])
    assert joints[2, 0] == pytest.approx(210.25)


def test_unreachable_posture_is_an_error() -> None:
    with pytest.raises(UnreachablePosture):
        simulate(NOMINAL, np.zeros(6), conditions([0], [1], [400.0]))


@dataclass(frozen=True)
class Lean:
    """Actuator axis ``leg`` leans towards ``towards`` by an angle: the foot leaves its axis."""

    leg: int
    towards: int
    angle_rad: float
    id: str = "lean"
    stage: Stage = Stage.FOOT

    def change(self, stage_input: NDArray[Any], flow: Flow) -> NDArray[Any]:
        feet = stage_input.copy()
        feet[..., self.leg, self.towards] += self.angle_rad * flow.carriage_mm[..., self.leg]
        return feet


@dataclass(frozen=True)
class Shift:
    """Actuator axis ``leg`` is shifted sideways."""

    leg: int
    towards: int
    shift_mm: float
    id: str = "shift"
    stage: Stage = Stage.FOOT

    def change(self, stage_input: NDArray[Any], flow: Flow) -> NDArray[Any]:
        feet = stage_input.copy()
        feet[..., self.leg, self.towards] += self.shift_mm
        return feet


@dataclass(frozen=True)
class Gain:
    """Every reading is scaled."""

    gain: float
    id: str = "gain"
    stage: Stage = Stage.READING

    def change(self, stage_input: NDArray[Any], flow: Flow) -> NDArray[Any]:
        return stage_input * self.gain


def slope(
    effect_at: Callable[[float], StageEffect], leg: int, axis: int, displacement: float, h: float
) -> float:
    plan = conditions([leg], [axis], [displacement])
    high = Model(effects=(effect_at(h),)).readings(plan)[0]
    low = Model(effects=(effect_at(-h),)).readings(plan)[0]
    return float(high - low) / (2 * h)


@pytest.mark.parametrize(("displacement", "expected"), [(60.0, -41.6035), (-100.0, 17.7679)])
def test_axis_lean_changes_both_readings_of_the_pair_alike(
    displacement: float, expected: float
) -> None:
    """Theory section 4: mm per rad, the same for the leaning leg and its partner."""
    assert slope(lambda e: Lean(0, 1, e), 0, 1, displacement, 1e-5) == pytest.approx(
        expected, abs=2e-4
    )
    assert slope(lambda e: Lean(0, 1, e), 1, 0, displacement, 1e-5) == pytest.approx(
        expected, abs=2e-4
    )


@pytest.mark.parametrize(
    ("leg", "axis", "displacement", "expected"),
    [(1, 0, 60.0, -0.1367), (0, 1, 60.0, -0.1934), (1, 0, -100.0, 0.0605), (0, 1, -100.0, 0.3223)],
)
def test_axis_shift(leg: int, axis: int, displacement: float, expected: float) -> None:
    """Theory section 4: axis x shifted towards y; readings of legs y and x."""
    assert slope(lambda d: Shift(0, 1, d), leg, axis, displacement, 1e-3) == pytest.approx(
        expected, abs=1e-4
    )


def test_effects_of_several_stages_compose() -> None:
    plan = postures()
    lean = Lean(1, 2, 1e-3)
    plain = Model(effects=(lean,)).readings(plan)
    assert Model(effects=(lean, Gain(1.02))).readings(plan) == pytest.approx(1.02 * plain)
