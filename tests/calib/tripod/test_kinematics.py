"""Exact kinematics against their definitions, for the Orthoglide and for other tripods."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.arrays import FloatArray
from calib.errors import UnreachablePosture
from calib.tripod.geometry import Geometry, direct, inverse, tool_jacobians, trilaterate
from tests.tripods import TRIPODS

L = 310.25
ORTHOGLIDE = Geometry()
inside = st.floats(-100.0, 100.0)
length_error = st.floats(-3.0, 3.0)


def test_direct_after_inverse_over_the_workspace() -> None:
    """Issue figure: 1e5 random points of the 200 mm cube come back to 1e-9 mm."""
    tool = np.random.default_rng(1).uniform(-100.0, 100.0, (100_000, 3))
    assert np.abs(direct(ORTHOGLIDE, inverse(ORTHOGLIDE, tool)) - tool).max() < 1e-9


@pytest.mark.parametrize("geometry", TRIPODS.values(), ids=TRIPODS)
def test_bars_keep_their_lengths_and_the_tool_comes_back(geometry: Geometry) -> None:
    low, high = geometry.workspace_mm or ((-60.0,) * 3, (40.0,) * 3)
    tool = np.random.default_rng(1).uniform(low, high, (2000, 3))
    carriage = inverse(geometry, tool)
    feet = geometry.origins + geometry.directions * carriage[:, :, None]
    bars = np.linalg.norm(tool[:, None] + geometry.platform - feet, axis=2)
    assert np.abs(bars - geometry.lengths).max() < 1e-9
    assert np.abs(direct(geometry, carriage) - tool).max() < 1e-9


def test_direct_satisfies_the_leg_lengths_with_unequal_legs() -> None:
    generator = np.random.default_rng(2)
    error = generator.uniform(-3.0, 3.0, (5000, 3))
    lengths = L + error
    carriage = inverse(ORTHOGLIDE, generator.uniform(-100.0, 60.0, (5000, 3)))
    tool = direct(ORTHOGLIDE, carriage, error)
    legs = np.linalg.norm(tool[:, None, :] - carriage[:, :, None] * np.eye(3), axis=2)
    assert np.abs(legs - lengths).max() < 1e-9


def test_zero_posture_is_the_minus_root() -> None:
    """Erratum in the papers: the plus root would give (2L/3, 2L/3, 2L/3)."""
    assert direct(ORTHOGLIDE, [L, L, L]) == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)


@given(st.tuples(inside, inside, inside), st.tuples(length_error, length_error, length_error))
def test_trilateration_equals_the_closed_form_of_the_papers(
    tool: tuple[float, float, float], errors: tuple[float, float, float]
) -> None:
    lengths = L + np.array(errors)
    carriage = inverse(ORTHOGLIDE, np.array(tool))
    general = trilaterate(carriage[:, None] * np.eye(3), lengths, ORTHOGLIDE.side)
    assert general == pytest.approx(equation_4(carriage, lengths), abs=1e-9)


def equation_4(carriage: FloatArray, lengths: FloatArray) -> FloatArray:
    """The minus root of papers/000 (4), written out."""
    excess = carriage**2 - lengths**2
    a, b = (1 / carriage**2).sum(), (excess / carriage**2).sum() - 2
    c = (excess**2 / carriage**2).sum()
    square = c / (np.sqrt(b * b - a * c) - b)
    return np.asarray((excess + square) / (2 * carriage))


@pytest.mark.parametrize("shape", [(3,), (1, 3), (4, 5, 3), (2, 3000, 3), (0, 3)])
def test_any_leading_shape(shape: tuple[int, ...]) -> None:
    tool = np.random.default_rng(3).uniform(-50.0, 50.0, shape)
    position = direct(ORTHOGLIDE, inverse(ORTHOGLIDE, tool))
    assert position.shape == shape
    assert position == pytest.approx(tool, abs=1e-9)


@pytest.mark.parametrize("carriage", [[L, L, 5 * L], [np.nan, L, L]])
def test_unreachable_carriages_are_an_error_not_a_nan(carriage: list[float]) -> None:
    with pytest.raises(UnreachablePosture, match="unreachable posture"):
        direct(ORTHOGLIDE, [[L, L, L], carriage])


def test_unreachable_feet_and_tools() -> None:
    with pytest.raises(UnreachablePosture, match="feet at"):
        trilaterate(np.diag([L, L, 5 * L]), np.full(3, L), -1.0)
    with pytest.raises(UnreachablePosture, match="tool at"):
        inverse(ORTHOGLIDE, [0.0, 300.0, 300.0])


@pytest.mark.parametrize("geometry", TRIPODS.values(), ids=TRIPODS)
def test_jacobians_against_central_differences(geometry: Geometry) -> None:
    low, high = geometry.workspace_mm or ((-60.0,) * 3, (40.0,) * 3)
    tool = np.random.default_rng(4).uniform(low, high, (20, 3))
    carriage = inverse(geometry, tool)
    by_offset, by_length = tool_jacobians(geometry, tool, carriage)
    h = 1e-4
    for k in range(3):
        step = h * np.eye(3)[k]
        offset = direct(geometry, carriage + step) - direct(geometry, carriage - step)
        length = direct(geometry, carriage, step) - direct(geometry, carriage, -step)
        offset, length = offset / (2 * h), length / (2 * h)
        assert by_offset[..., k] == pytest.approx(offset, abs=1e-7)
        assert by_length[..., k] == pytest.approx(length, abs=1e-7)


def test_jacobian_of_zero_and_xmax_as_published() -> None:
    """papers/000 equations (6) and (8)."""
    sine = 60.0 / L
    tangent, cosine = sine / np.sqrt(1 - sine**2), np.sqrt(1 - sine**2)
    zero_offset, zero_length = tool_jacobians(ORTHOGLIDE, [0.0, 0.0, 0.0], [L, L, L])
    assert zero_offset == pytest.approx(np.eye(3))
    assert zero_length == pytest.approx(-np.eye(3))
    tool = np.array([60.0, 0.0, 0.0])
    by_offset, by_length = tool_jacobians(ORTHOGLIDE, tool, inverse(ORTHOGLIDE, tool))
    assert by_offset == pytest.approx(np.array([[1, 0, 0], [tangent, 1, 0], [tangent, 0, 1]]))
    expected = np.array([[-1, 0, 0], [-tangent, -1 / cosine, 0], [-tangent, 0, -1 / cosine]])
    assert by_length == pytest.approx(expected)


@pytest.mark.parametrize(("askew", "common"), [(0.0, True), (0.09, True), (0.11, False)])
def test_legs_have_one_zero_where_bars_lie_along_their_drives(askew: float, common: bool) -> None:
    """Each carriage runs beside Zero by that part of the bar, across its drive."""
    beside = askew * 310.25
    origins = ((0.0, beside, 0.0), (0.0, 0.0, beside), (beside, 0.0, 0.0))
    geometry = Geometry(origin_mm=origins)
    assert geometry.common_zero == common
    drives_alike = Geometry(direction=((1.0, 0.0, 0.0), (0.95, 0.3122499, 0.0), (0.0, 0.0, 1.0)))
    assert not drives_alike.common_zero
