"""The kinematics module in LinuxCNC against the pipeline and against hand-written geometry."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from app.exports.linuxcnc import pins
from calib.arrays import FloatArray, tool_conditions
from calib.tripod.effects.bars import GravitySag, LegLength
from calib.tripod.effects.drives import AxisOffset, AxisSquareness, Straightness
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.geometry import Geometry
from calib.tripod.pipeline import Flow, Model
from protocols.machine import load_machine
from tests.conftest import LONG
from tests.controller.running import SimulatedJoint, Stop, need_linuxcnc, run

pytestmark = LONG

POSTURES = 100


def orthoglide() -> Model:
    effects = (
        EffectInstance(AxisSquareness(), "xy", (2.0,)),
        EffectInstance(AxisSquareness(), "yz", (-1.5,)),
        EffectInstance(AxisOffset(), "xz", (0.2,)),
        EffectInstance(AxisOffset(), "zy", (-0.15,)),
        EffectInstance(Straightness(), "yx", (0.05,)),
        EffectInstance(LegLength(), "y", (0.4,)),
        EffectInstance(GravitySag(), "x", (0.02,)),
        EffectInstance(GravitySag(), "z", (0.03,)),
    )
    return Model(Geometry(), (0.0, 0.0, 0.0, 0.3, -0.2, 0.1), effects)


def delta() -> Model:
    return Model(load_machine("linear-delta").geometry(), (0.0, 0.0, 0.0, 0.4, -0.3, 0.2))


def targets(geometry: Geometry) -> FloatArray:
    low, high = geometry.workspace_mm or ((-60.0,) * 3, (40.0,) * 3)
    return np.random.default_rng(4).uniform(low, high, (POSTURES, 3))


@pytest.mark.parametrize("half", [0, 1])
@pytest.mark.parametrize("model", [orthoglide(), delta()], ids=["orthoglide", "linear-delta"])
def test_joints_of_the_module_bring_the_model_to_the_target(
    model: Model, half: int, tmp_path: Path
) -> None:
    need_linuxcnc()
    points = np.round(targets(model.geometry), 3)[half::2]
    stops = moved(model, points, tmp_path)
    joints = np.array([stop.joint for stop in stops])
    tools = Flow(
        model.geometry,
        model.parameters_mm,
        tool_conditions(np.zeros((len(points), 3))),
        joints,
        model.effects,
    ).tool_mm
    assert np.abs(tools - points).max() < 5e-6  # straightness follows the command, not the carriage
    assert np.abs(np.array([stop.tool for stop in stops]) - points).max() < 1e-6, "and back"


def test_lengths_alone_are_three_spheres(tmp_path: Path) -> None:
    """No code of the program: the distances from target to feet are the lengths."""
    need_linuxcnc()
    model = Model(Geometry(), (0.0, 0.0, 0.0, 0.3, -0.2, 0.1))
    points = np.round(targets(model.geometry), 3)[:20]
    for stop, target in zip(moved(model, points, tmp_path), points, strict=True):
        for k, length in enumerate((310.55, 310.05, 310.35)):
            foot = [stop.joint[k] if axis == k else 0.0 for axis in range(3)]
            assert math.dist(foot, target) == pytest.approx(length, abs=1e-6)


def test_joints_in_another_order_and_one_turned_bring_the_same(tmp_path: Path) -> None:
    need_linuxcnc()
    model = orthoglide()
    points = np.round(targets(model.geometry), 3)[:20]
    plain = np.array([stop.joint for stop in moved(model, points, tmp_path / "plain")])
    other_order = moved(model, points, tmp_path / "other", [(2, 1), (0, -1), (1, 1)])
    joints = np.array([stop.joint for stop in other_order])
    assert joints[:, [2, 0, 1]] * (1, -1, 1) == pytest.approx(plain, abs=1e-9)
    assert np.abs(np.array([stop.tool for stop in other_order]) - points).max() < 1e-6


def moved(
    model: Model,
    points: FloatArray,
    folder: Path,
    order: Sequence[tuple[int, int]] = ((0, 1), (1, 1), (2, 1)),
) -> list[Stop]:
    """Stops of LinuxCNC at the targets, homed where it stands; ``order`` as `pins` takes it."""
    zero = model.geometry.zero_mm
    lines = [f"G21 G90 G53 G1 F54000 X{x:.3f} Y{y:.3f} Z{z:.3f}" for x, y, z in points]
    hal = pins(model, joints=order)
    of_joint = {joint: way * float(q) for q, (joint, way) in zip(zero, order, strict=True)}
    joints = [SimulatedJoint({"mounting": of_joint[n]}) for n in range(3)]
    entries = [
        {"HOME": of_joint[n], "HOME_OFFSET": of_joint[n], "MIN_LIMIT": -1000} for n in range(3)
    ]
    return run(folder, joints, entries, hal, ["home", *lines])[1:]
