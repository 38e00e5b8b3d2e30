"""What a controller is told of a model, against values worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from calib.errors import ImpossibleRequest
from calib.tripod.controller import (
    ControllerJoint,
    carriage_error_mm,
    commanded_with,
    joint_entries,
    kinematics_of,
    not_told,
    table_of,
    tool_error_mm,
)
from calib.tripod.effects.bars import GravitySag
from calib.tripod.effects.drives import (
    ActuatorCyclic,
    ActuatorScale,
    AxisOffset,
    AxisSquareness,
    Backlash,
    Straightness,
)
from calib.tripod.effects.effect import Effect, EffectInstance
from calib.tripod.effects.gauges import GaugeGain
from calib.tripod.geometry import Geometry, inverse
from calib.tripod.pipeline import Model
from calib.tripod.workspace import machine_at, workspace_jacobian, workspace_points
from tests.tripods import TRIPODS

L = 310.25
OFFSETS = (0.8, -1.3, 0.45)


def model(*effects: tuple[Effect, str, tuple[float, ...]]) -> Model:
    placed = tuple(EffectInstance(effect, place, values) for effect, place, values in effects)
    return Model(Geometry(), (*OFFSETS, 0.0, 0.0, 0.0), placed)


def test_error_of_a_carriage_by_hand() -> None:
    machine = model((ActuatorScale(), "x", (0.5,)), (Backlash(), "y", (0.06,)))
    joints = np.array([[L + 60.0, L, L], [L - 100.0, L - 100.0, L]])
    up = carriage_error_mm(machine, joints, 1.0)
    down = carriage_error_mm(machine, joints, -1.0)
    assert up == pytest.approx(np.array([[0.83, -1.3, 0.45], [0.75, -1.3, 0.45]]), abs=1e-12)
    assert down - up == pytest.approx(np.array([[0.0, 0.06, 0.0]] * 2), abs=1e-12)


def test_a_table_is_read_where_the_corrected_controller_is() -> None:
    """Offset entered, believed q + offset is the old q: the sine moves with it."""
    table = table_of(model((ActuatorCyclic(5.0), "x", (10.0, 0.0))), 0)
    assert table is not None
    old = table.joint_mm - OFFSETS[0]
    for _ in range(20):
        error = 0.01 * np.sin(2 * math.pi * (old - L) / 5.0)
        old = table.joint_mm - OFFSETS[0] - error
    # 5 nm: the error between the places at which it was worked out
    assert table.error_up_mm == pytest.approx(error, abs=5e-6)
    assert table.error_down_mm == pytest.approx(error, abs=5e-6)
    fine = np.linspace(table.joint_mm[0], table.joint_mm[-1], 10_001)
    old = fine - OFFSETS[0]
    for _ in range(20):
        exact = 0.01 * np.sin(2 * math.pi * (old - L) / 5.0)
        old = fine - OFFSETS[0] - exact
    assert np.abs(np.interp(fine, table.joint_mm, table.error_up_mm) - exact).max() < 1.1e-3
    assert len(table.joint_mm) <= 256


def test_a_proportional_error_takes_two_points_and_nothing_none() -> None:
    assert table_of(model(), 0) is None
    assert table_of(model((GaugeGain(), "xy", (1.0,))), 0) is None, "no effect on the carriage"
    table = table_of(model((ActuatorScale(), "z", (0.5,))), 2)
    assert table is not None
    assert len(table.joint_mm) == 2
    assert table.error_up_mm[1] - table.error_up_mm[0] == pytest.approx(0.08, abs=1e-4)


@pytest.mark.parametrize(("switch_mm", "travel_mm"), [(345.0, 345.0 - L), (395.0, 60.0 - 0.8)])
def test_homing_absorbs_what_the_table_holds_at_the_switch(
    switch_mm: float, travel_mm: float
) -> None:
    """Beyond its end the controller holds the end: 60 mm believed, of which 0.8 are the offset."""
    machine = model((ActuatorScale(), "x", (0.5,)))
    entries = joint_entries(machine, 0, ControllerJoint(switch_mm, latch_sign=1))
    absorbed_mm = 0.5e-3 * travel_mm / (1.0 if travel_mm < 40.0 else 1.0005)
    assert entries.home_change_mm == pytest.approx(0.8 + absorbed_mm, abs=1e-9)


def test_an_error_too_fine_for_256_points_is_refused() -> None:
    with pytest.raises(ImpossibleRequest, match="256 points"):
        table_of(model((ActuatorCyclic(1.0), "x", (20.0, 0.0))), 0)


def test_drives_and_bars_by_hand() -> None:
    """Axis x leans 1 mrad to y, y to x; axis z is 0.2 mm towards x; 0.05 mm of bow per 100² mm²."""
    kinematics = kinematics_of(
        Model(
            Geometry(),
            (*OFFSETS, 0.3, -0.2, 0.1),
            (
                EffectInstance(AxisSquareness(), "xy", (2.0,)),
                EffectInstance(AxisOffset(), "zx", (0.2,)),
                EffectInstance(Straightness(), "xz", (0.05,)),
                EffectInstance(GravitySag(), "z", (0.02,)),
                EffectInstance(Backlash(), "x", (0.06,)),
            ),
        )
    )
    direction = np.eye(3)
    direction[0, 1] = direction[1, 0] = 1e-3
    assert kinematics.direction[1:] == pytest.approx(direction[1:], abs=1e-12)
    # straightness follows the command, 0.8 mm behind the carriage: a lean and a shift of its own
    assert kinematics.direction[0] == pytest.approx([1.0, 1e-3, -2 * 5e-6 * 0.8], abs=1e-9)
    assert kinematics.bend_per_mm[0] == pytest.approx([0.0, 0.0, 5e-6], abs=1e-12)
    assert kinematics.origin_mm[2] == pytest.approx([0.2, 0.0, 0.0], abs=1e-9)
    assert kinematics.length_mm == pytest.approx([L + 0.3, L - 0.2, L + 0.1])
    assert kinematics.sag_mm == pytest.approx([0.0, 0.0, 0.02])
    assert kinematics.misfit_mm < 1e-9


def test_what_is_told_leaves_nothing_and_offsets_leave_what_the_jacobian_says() -> None:
    machine = model((Backlash(), "x", (0.06,)), (AxisOffset(), "xy", (0.1,)))
    assert tool_error_mm(not_told(machine, kinematics=True)) == pytest.approx(0.0, abs=1e-12)
    axes = tool_error_mm(not_told(machine, kinematics=False))
    # the bar takes up 0.1 mm times its slope p_y / L, whose r.m.s. over the workspace is 0.18
    assert axes == pytest.approx(0.018, rel=0.25)
    small = Model(Geometry(), (1e-4, -2e-4, 1e-4, 0.0, 0.0, 0.0))
    moved = workspace_jacobian(Geometry()) @ np.array(small.parameters_mm)
    expected = math.sqrt((moved**2).sum(axis=1).mean())
    assert tool_error_mm(small) == pytest.approx(expected, rel=1e-4)
    assert tool_error_mm(not_told(small, kinematics=False)) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("geometry", TRIPODS.values(), ids=TRIPODS)
def test_a_controller_that_knows_the_parameters_sends_the_tool_where_it_should_be(
    geometry: Geometry,
) -> None:
    parameters = (0.6, -0.4, 0.2, 0.3, -0.2, 0.1)
    machine = Model(geometry, parameters)
    points = workspace_points(geometry)
    joints = commanded_with(geometry, parameters)(points)
    assert machine_at(machine, joints, 1.0).tool_mm == pytest.approx(points, abs=1e-9)
    assert tool_error_mm(machine, commanded_with(geometry, parameters)) == pytest.approx(
        0.0, abs=1e-9
    )
    assert commanded_with(geometry, (0.0,) * 6)(points) == pytest.approx(inverse(geometry, points))
