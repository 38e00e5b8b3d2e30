"""The step of a display, found in the values that it showed."""

from __future__ import annotations

import numpy as np
import pytest

from calib.arrays import FloatArray
from calib.noise.display import INCH_MM, display_step_mm

WRITTEN_MM = 1e-6


def shown(step_mm: float, count: int, seed: int = 0, decimals: int = 6) -> FloatArray:
    """Readings over a millimetre as a display of this step shows them, written in mm."""
    values = np.random.default_rng(seed).uniform(-0.5, 0.5, count)
    return np.round(np.round(values / step_mm) * step_mm, decimals)


@pytest.mark.parametrize("step_mm", [0.01, 0.005, 0.002, 0.001, 0.0005, 0.0002, 0.0001])
def test_a_step_in_mm_is_found_whatever_digits_are_written(step_mm: float) -> None:
    assert display_step_mm(shown(step_mm, 60), WRITTEN_MM) == pytest.approx(step_mm)
    assert display_step_mm(shown(step_mm, 60), None) == pytest.approx(step_mm)


@pytest.mark.parametrize("step_in", [0.001, 0.0005, 0.0001, 0.00005])
@pytest.mark.parametrize("decimals", [4, 6])
def test_a_step_in_inches_is_found_in_rounded_millimetres(step_in: float, decimals: int) -> None:
    values = shown(step_in * INCH_MM, 60, decimals=decimals)
    assert display_step_mm(values, 10.0**-decimals) == pytest.approx(step_in * INCH_MM)


def test_the_step_in_which_values_are_written_is_not_found_again() -> None:
    assert display_step_mm(shown(0.001, 60), 0.001) is None


@pytest.mark.parametrize(("step_mm", "written_mm"), [(0.002, 0.001), (0.005, 0.001)])
def test_even_last_digits_tell_when_there_are_enough_of_them(
    step_mm: float, written_mm: float
) -> None:
    assert display_step_mm(shown(step_mm, 60), written_mm) == pytest.approx(step_mm)
    assert display_step_mm(shown(step_mm, 4), written_mm) is None


def test_fine_readings_have_no_step() -> None:
    steps = [display_step_mm(shown(1e-6, 10, seed), WRITTEN_MM) for seed in range(300)]
    assert steps == [None] * 300
    steps = [display_step_mm(shown(0.001, 10, seed), 0.001) for seed in range(300)]
    assert steps == [None] * 300


def test_equal_readings_count_once_and_zeros_not_at_all() -> None:
    """0.5 lies on every decimal step: read a hundred times it is no more evidence than once."""
    assert display_step_mm(np.full(100, 0.5), 0.001) is None
    assert display_step_mm(np.zeros(100), WRITTEN_MM) is None
    assert display_step_mm(np.zeros(0), None) is None


def test_a_single_finer_value_leaves_its_own_step() -> None:
    values = np.append(shown(0.01, 60), 0.1234)
    assert display_step_mm(values, WRITTEN_MM) == pytest.approx(0.0002)
