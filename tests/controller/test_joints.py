"""Entries of joints in LinuxCNC: is the carriage where the controller believes it to be?"""

from __future__ import annotations

from pathlib import Path

import pytest

from calib.tripod.controller import ControllerJoint
from calib.tripod.pipeline import Model
from tests.conftest import LONG
from tests.controller.joints import (
    HERE,
    OFFSETS,
    PLAY,
    SCALE,
    WHOLE,
    found,
    on_switch,
    worst_um,
)
from tests.controller.machine import L, Machine, homing
from tests.controller.running import need_linuxcnc

pytestmark = LONG


@pytest.mark.parametrize("way", [1.0, -1.0], ids=["latched-up", "latched-down"])
@pytest.mark.parametrize(
    "figures", [{}, PLAY, SCALE, WHOLE], ids=["offsets", "play", "scale", "whole"]
)
def test_homed_on_a_switch_the_carriage_is_where_it_is_believed(
    figures: dict[str, float], way: float, tmp_path: Path
) -> None:
    need_linuxcnc()
    machine = Machine(OFFSETS, joint=figures)
    joints = on_switch(machine, way)
    assert worst_um(tmp_path, machine, found(machine), joints, homing(0.0, way)) < 3.0


def test_a_switch_beyond_the_ends_of_the_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    need_linuxcnc()
    monkeypatch.setattr("tests.controller.machine.SWITCH_MM", 400.0)
    machine = Machine(OFFSETS, joint=WHOLE)
    joints = on_switch(machine, 1.0)
    assert worst_um(tmp_path, machine, found(machine), joints, homing(0.0)) < 3.0


@pytest.mark.parametrize("way", [1.0, -1.0], ids=["latched-up", "latched-down"])
def test_a_joint_that_counts_against_its_drive(way: float, tmp_path: Path) -> None:
    need_linuxcnc()
    machine = Machine(OFFSETS, joint=WHOLE)
    joints = [joint.turned() for joint in on_switch(machine, way)]
    home = homing(0.0, way)
    turned = {key: -float(home[key]) for key in ("HOME", "HOME_SEARCH_VEL", "HOME_LATCH_VEL")}
    limits = {"MIN_LIMIT": -1000, "MAX_LIMIT": 0}
    home = {**home, **turned, **limits}
    assert worst_um(tmp_path, machine, found(machine), joints, home, way=-1) < 3.0


@pytest.mark.parametrize("encoder", [0, 1, 2], ids=["here", "encoder-1", "encoder-2"])
@pytest.mark.parametrize("figures", [{}, SCALE], ids=["offsets", "scale"])
def test_homed_without_a_switch_the_carriage_is_where_it_is_believed(
    figures: dict[str, float], encoder: int, tmp_path: Path
) -> None:
    """The motor stands at 0 and is believed to be at L."""
    need_linuxcnc()
    machine = Machine(OFFSETS, joint=figures)
    joints = [ControllerJoint(L, absolute_encoder=encoder > 0)] * 3
    home = {**HERE, "HOME_ABSOLUTE_ENCODER": encoder}
    assert worst_um(tmp_path, machine, found(machine), joints, home) < 3.0


@pytest.fixture(scope="module")
def uncorrected_um(tmp_path_factory: pytest.TempPathFactory) -> float:
    need_linuxcnc()
    machine = Machine(OFFSETS, joint=WHOLE)
    joints = on_switch(machine, 1.0)
    return worst_um(tmp_path_factory.mktemp("before"), machine, Model(), joints, homing(0.0))


def test_with_the_signs_turned_it_is_worse_than_before(
    uncorrected_um: float, tmp_path: Path
) -> None:
    machine = Machine(OFFSETS, joint=WHOLE)
    joints = on_switch(machine, 1.0)
    turned_um = worst_um(tmp_path, machine, found(machine), joints, homing(0.0), sign=-1.0)
    assert uncorrected_um > 1000.0
    assert turned_um > 1.5 * uncorrected_um
