"""Where the tool can be, factors, angles and the other solutions, by plain geometry beside them."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.errors import CalibrationError
from calib.tripod.geometry import Geometry, direct, inverse
from calib.tripod.workspace import (
    distortion,
    largest_cube,
    passive_angles,
    posture_of_tool,
    transmission,
    workspace_box,
    workspace_of,
    workspace_points,
)
from tests.conftest import LONG
from tests.protocols.test_on_bar import machines
from tests.tripods import DELTA, ORTHOGLIDE, TRIPODS

L_MM = 310.25
UNLIMITED = Geometry(travel_min_mm=-300.0, travel_max_mm=300.0)
FEW = settings(max_examples=20, deadline=None)
NEAR = st.tuples(*[st.floats(-40.0, 40.0)] * 3)


def test_the_cube_of_the_paper() -> None:
    """[C] 2.1: factors within ½ … 2 in 200³ mm; recomputed −126.8 … 73.2 with 0.4996 … 2.003."""
    cube = largest_cube(UNLIMITED, 2.0)
    assert cube is not None
    assert cube.side_mm == pytest.approx(200.0, abs=0.5)
    assert cube.low_mm == pytest.approx([-126.8] * 3, abs=0.5)
    assert cube.low_mm + cube.side_mm == pytest.approx([73.2] * 3, abs=0.5)


@LONG
def test_joint_limits_leave_less_than_that_cube() -> None:
    """At its lowest corner carriages are at −184 mm; the prototype's limits are −100 … 60."""
    low = -126.8 + math.sqrt(L_MM**2 - 2 * 126.8**2) - L_MM
    assert low == pytest.approx(-183.9, abs=0.1)
    cube = largest_cube(ORTHOGLIDE, 2.0)
    assert cube is not None
    # by hand: highest on an axis, 60; lowest a at its corner, where a + √(L² - 2a²) = L - 100
    a = next(
        a for a in np.arange(60.0, 100.0, 0.01) if -a + math.sqrt(L_MM**2 - 2 * a * a) < 210.25
    )
    assert 60.0 + a - 1.0 < cube.side_mm < 60.0 + a + 0.2
    axes = [np.linspace(v, v + cube.side_mm, 15) for v in cube.low_mm]
    points = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3)
    assert ORTHOGLIDE.stands(points).all()
    assert distortion(ORTHOGLIDE, points).max() <= 2.0
    workspace = workspace_of(ORTHOGLIDE, 2.0)
    assert (workspace.lowest_factor, workspace.highest_factor) == pytest.approx(
        (0.65, 2.3), abs=0.1
    )
    assert workspace.inside > 0.999
    assert largest_cube(ORTHOGLIDE, 1.0) is None


def test_half_of_the_former_grid_was_out_of_reach() -> None:
    """Of 5 × 5 × 5 points in the cube of the joint limits, faces included, 61 break these."""
    axis = np.linspace(-100.0, 60.0, 5)
    points = np.array(list(product(axis, repeat=3)))
    travel = points + np.sqrt(L_MM**2 - (points**2).sum(axis=1, keepdims=True) + points**2) - L_MM
    broken = ~((travel >= -100.0) & (travel <= 60.0)).all(axis=1)
    assert broken.sum() == 61
    assert (~ORTHOGLIDE.stands(points) == broken).all()


@FEW
@given(st.one_of(machines(), st.just(None)), st.integers(2, 5))
def test_the_tool_comes_back_from_everywhere_in_the_workspace(machine: object, cells: int) -> None:
    """Joint limits are kept, and direct kinematics lead back: no singular posture lies between."""
    geometry = DELTA if machine is None else machine.geometry()  # type: ignore[attr-defined]
    points = workspace_points(geometry, cells)
    carriage = inverse(geometry, points)
    travel = carriage - geometry.zero_mm
    assert travel.min() >= geometry.travel_min_mm - 1e-5
    assert travel.max() <= geometry.travel_max_mm + 1e-5
    assert direct(geometry, carriage) == pytest.approx(points, abs=1e-5)
    low, high = workspace_box(geometry)
    assert ((points >= low) & (points <= high)).all()


def test_all_that_joint_limits_allow_lies_in_the_box() -> None:
    """Random carriages within the limits: their tools are inside but for the coarse edge."""
    generator = np.random.default_rng(5)
    for name in ("orthoglide", "unequal-bars", "platform", "turned"):
        geometry = TRIPODS[name]
        travel = generator.uniform(geometry.travel_min_mm, geometry.travel_max_mm, (2000, 3))
        tool = direct(geometry, geometry.zero_mm + travel)
        low, high = workspace_box(geometry)
        assert (tool > low - 1.0).all()
        assert (tool < high + 1.0).all()
        assert geometry.stands(tool).all()


@pytest.mark.parametrize("name", TRIPODS)
def test_factors_are_those_of_small_movements(name: str) -> None:
    """Against central differences of the direct kinematics in every direction of the carriages."""
    geometry, step = TRIPODS[name], 1e-4
    for tool in workspace_points(geometry, 3)[::5]:
        carriage = inverse(geometry, tool)
        moved = [
            direct(geometry, carriage + h) - direct(geometry, carriage - h)
            for h in step * np.eye(3)
        ]
        factors = np.sqrt(np.linalg.eigvalsh(np.array(moved) @ np.array(moved).T))[::-1] / step / 2
        assert transmission(geometry, tool) == pytest.approx(factors, rel=1e-6)
        assert distortion(geometry, tool) == pytest.approx(
            max(factors[0], 1 / factors[2]), rel=1e-6
        )


@FEW
@given(NEAR, st.tuples(*[st.floats(250.0, 400.0)] * 3), st.floats(-30.0, 30.0))
def test_equation_1_gives_the_tool_back(
    tool: tuple[float, float, float], lengths: tuple[float, float, float], e: float
) -> None:
    """[C] (1a)–(1c), cos cos with a minus as (3) has it; e moves where a joint's line begins."""
    origin = ((e, 0.0, 0.0), (0.0, e, 0.0), (0.0, 0.0, e))
    geometry = Geometry(leg_length_mm=lengths, origin_mm=origin)
    rho = inverse(geometry, tool)
    for i, (theta, beta) in enumerate(passive_angles(geometry, np.array(tool))):
        printed = np.zeros(3)
        printed[i] = rho[i] - math.cos(theta) * math.cos(beta) * lengths[i] + e
        printed[(i + 1) % 3] = math.sin(theta) * math.cos(beta) * lengths[i]
        printed[(i + 2) % 3] = -math.sin(beta) * lengths[i]
        assert printed == pytest.approx(np.array(tool), abs=1e-9)


@FEW
@given(NEAR)
def test_every_mode_is_a_solution_of_equation_2(tool: tuple[float, float, float]) -> None:
    """[C] (3): eight carriages for a tool; [C] (4): two tools for carriages."""
    posture = posture_of_tool(ORTHOGLIDE, tool)
    p = np.array(tool)
    assert len({mode.carriage_mm for mode in posture.modes}) == 8
    for mode in posture.modes:
        q = np.array(mode.carriage_mm) + L_MM
        assert (p - q) ** 2 + (p @ p - p**2) == pytest.approx([L_MM**2] * 3, rel=1e-12)
        assert np.sign(q - p).tolist() == list(mode.signs)
    q, assembly = np.array(posture.modes[0].carriage_mm) + L_MM, posture.assembly_mm
    assert (assembly - q) ** 2 + (assembly @ assembly - assembly**2) == pytest.approx(
        [L_MM**2] * 3, rel=1e-9
    )
    assert np.linalg.norm(assembly - p) > 100.0


def test_the_other_assembly_at_zero_is_the_root_that_the_papers_print() -> None:
    posture = posture_of_tool(ORTHOGLIDE, (0.0, 0.0, 0.0))
    assert posture.assembly_mm == pytest.approx([2 * L_MM / 3] * 3)
    assert posture.stands
    assert not posture_of_tool(ORTHOGLIDE, (70.0, 40.0, 0.0)).stands  # carriage x at 67 mm


def test_milling_near_zero_does_not_show_legs_that_are_off_by_2_mm() -> None:
    """[C] 4.2: with the joint offsets of experiment 2 everything shifts by 1.8 mm.

    A workpiece of 100 mm at Zero is out of true by an eighth of that.
    """
    geometry, rho = ORTHOGLIDE, np.array([-0.4856, 0.4990, -1.6712])
    low, high = workspace_box(geometry)
    workpiece = tuple(np.maximum(low, -50.0).tolist()), tuple(np.minimum(high, 50.0).tolist())
    points = workspace_points(replace(geometry, workspace_mm=workpiece))
    shift = direct(geometry, geometry.zero_mm + rho)
    off = direct(geometry, inverse(geometry, points) + rho) - points
    absolute, relative = (np.sqrt((e**2).sum(axis=1).mean()) for e in (off, off - shift))
    assert absolute == pytest.approx(1.83, abs=0.02)
    assert relative == pytest.approx(0.23, abs=0.02)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"workspace_mm": ((0.0, 0.0, 0.0), (0.0, 1.0, 1.0))}, "which is empty"),
        (
            {"workspace_mm": ((-50.0, -50.0, -50.0), (70.0, 50.0, 50.0))},
            r"corner \(70.0, -50.0, -50.0\) mm: found carriage x at \+61.835 mm from Zero. "
            r"Allowed: its joint limits -100 … 60 mm",
        ),
        ({"usable_bar": ((0.4, 0.4),) * 3}, "usable_bar of bar x: found 0.4 … 0.4, not a part"),
    ],
)
def test_a_workspace_that_cannot_be_is_refused(changed: dict[str, object], words: str) -> None:
    with pytest.raises(CalibrationError, match=words):
        replace(ORTHOGLIDE, **changed)  # type: ignore[arg-type]


def test_the_workspace_keeps_the_joint_limits() -> None:
    """The cube of the limits itself does not: its corners ask for more travel than there is."""
    points = workspace_points(ORTHOGLIDE, 12)
    travel = inverse(ORTHOGLIDE, points) - ORTHOGLIDE.zero_mm
    assert travel.min() >= ORTHOGLIDE.travel_min_mm
    assert travel.max() <= ORTHOGLIDE.travel_max_mm
    assert 0.65 * 12**3 < len(points) < 0.75 * 12**3
