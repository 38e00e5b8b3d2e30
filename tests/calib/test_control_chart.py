"""Control chart and drift against numbers worked out by hand and against chance."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import t as student

from calib.arrays import FloatArray
from calib.control_chart import control_chart, drift, watch
from calib.posterior.tool import Frame, days_in_tolerance, tool_field
from calib.tripod.geometry import Geometry

LENGTH_MM = 310.25


def test_limits_are_those_of_a_worked_example() -> None:
    """Montgomery, Introduction to Statistical Quality Control, example 6.5: cost of processing
    a mortgage loan, 20 weeks: mean 300.5, mean moving range 7.79, limits 321.22 and 279.78.
    """
    weeks = [310, 288, 297, 298, 307, 303, 294, 297, 308, 306]
    weeks += [294, 299, 297, 299, 314, 295, 293, 306, 301, 304]
    chart = control_chart(np.array(weeks, float), np.full(20, 1.0), np.zeros(20, bool))
    assert not chart.changed.any()
    assert chart.centre[0] == pytest.approx(300.5)
    assert chart.centre[0] + chart.limit[0] == pytest.approx(321.22, abs=0.01)
    assert chart.centre[0] - chart.limit[0] == pytest.approx(279.78, abs=0.01)


def test_a_change_within_its_uncertainty_is_none() -> None:
    values = np.array([0.0, 0.001, -0.001, 0.0, 0.020, 0.021])
    begins = np.zeros(6, bool)
    chart = control_chart(values, np.full(6, 0.002), begins)
    assert chart.changed.tolist() == [False] * 4 + [True, False]
    assert chart.centre[[0, 5]] == pytest.approx([0.0, 0.0205])
    assert not control_chart(values, np.full(6, 0.020), begins).changed.any()
    for few in ([0.0, 0.02], [0.0, 0.001, 0.02], [0.0, 0.02, 0.021]):  # ranges know little yet
        no = np.zeros(len(few), bool)
        changes = control_chart(np.array(few), np.full(len(few), 0.002), no).changed
        assert changes.tolist() == (np.abs(np.diff(few, prepend=0.0)) > 0.01).tolist()
    begins[4] = True  # somebody said so
    assert not control_chart(values, np.full(6, 0.002), begins).changed.any()


def test_chance_is_rarely_called_a_change() -> None:
    generator = np.random.default_rng(1)
    flagged = 0
    for _ in range(200):
        chart = control_chart(generator.normal(0.0, 1.0, 20), np.full(20, 2.0), np.zeros(20, bool))
        flagged += int(chart.changed.sum())
    assert flagged < 0.01 * 200 * 20  # three standard deviations: 0.3 % with a known spread


def test_drift_is_that_of_a_weighted_line() -> None:
    days = np.array([0.0, 10.0, 20.0, 40.0])
    expanded = np.array([0.002, 0.004, 0.002, 0.002])
    values = 0.5 + 0.001 * days + np.array([0.0002, -0.0002, 0.0001, -0.0001])
    trend = drift(days, values, expanded)
    assert trend is not None
    line = np.polynomial.Polynomial.fit(days, values, 1, w=1.0 / expanded).convert()
    assert trend.per_day == pytest.approx(line.coef[1])
    assert trend.shown
    assert drift(days[:2], values[:2], expanded[:2]) is None
    assert drift(np.zeros(4), values, expanded) is None
    assert drift(0.9 * days / np.ptp(days), values, expanded) is None  # an afternoon


def test_the_interval_of_a_drift_holds_it_in_95_of_100() -> None:
    generator = np.random.default_rng(2)
    days = np.linspace(0.0, 300.0, 8)
    within_bound = 0
    for _ in range(400):
        trend = drift(days, 1e-4 * days + generator.normal(0.0, 0.002, 8), np.full(8, 0.004))
        assert trend is not None
        within_bound += abs(trend.per_day - 1e-4) <= trend.expanded
    assert 0.93 <= within_bound / 400 <= 1.0


def test_a_jump_is_no_drift_once_there_are_values_after_it() -> None:
    values = [0.0, 0.0005, 0.0, 0.0505, 0.05, 0.0505, 0.05]
    result = watch([30.0 * k for k in range(7)], values, [0.002] * 7, [False] * 7)
    assert result.chart.changed.tolist() == [k == 3 for k in range(7)]
    assert result.drift is not None
    assert not result.drift.shown
    assert result.change.tolist() == values


def tool_mm(joint_mm: FloatArray) -> FloatArray:
    """Where the tool of the Orthoglide is: docs/theory.md, direct kinematics."""
    h = joint_mm**2 - LENGTH_MM**2
    a, c = (1.0 / joint_mm**2).sum(axis=1), (h**2 / joint_mm**2).sum(axis=1)
    b = (h / joint_mm**2).sum(axis=1) - 2.0
    t = c / (-b + np.sqrt(b * b - a * c))
    return np.asarray((h + t[:, None]) / (2.0 * joint_mm))


def test_a_tolerance_lasts_as_long_as_the_drift_takes_in_the_frame() -> None:
    """A joint offset shifts the whole machine, which touching off takes up: less is left of it."""
    ends_mm = LENGTH_MM + np.array([-100.0, -50.0, 0.0, 60.0])
    joints_mm = np.stack(np.meshgrid(ends_mm, ends_mm, ends_mm), axis=-1).reshape(-1, 3)
    reached_mm = tool_mm(joints_mm)
    low, high = reached_mm.min(), reached_mm.max()
    middles = low + (np.arange(6) + 0.5) / 6.0 * (high - low)
    places = np.stack(np.meshgrid(middles, middles, middles), axis=-1).reshape(-1, 3)
    across = (places**2).sum(axis=1)[:, None] - places**2
    joint_mm = places + np.sqrt(LENGTH_MM**2 - across)
    from_zero_mm = joint_mm - LENGTH_MM
    within = ((from_zero_mm >= -100.0) & (from_zero_mm <= 60.0)).all(axis=1)
    places, joint_mm = places[within], joint_mm[within]
    per_day = np.array([0.001, 0.0, 0.0])
    moved_mm = tool_mm(joint_mm + per_day) - places
    field = tool_field(Geometry(), ())
    left_mm: dict[Frame, FloatArray] = {
        "machine": moved_mm,
        "touched-off": moved_mm - moved_mm.mean(axis=0),
    }
    for frame, error_mm in left_mm.items():
        growth_mm = np.sqrt((error_mm**2).sum(axis=1).mean())
        days = days_in_tolerance(field, frame, per_day.tolist(), 0.02, 0.07)
        assert days == pytest.approx(0.05 / growth_mm, rel=0.02)
        assert days_in_tolerance(field, frame, per_day.tolist(), 0.08, 0.07) == 0.0
        assert days_in_tolerance(field, frame, (0.0, 0.0, 0.0), 0.02, 0.07) == float("inf")


@pytest.mark.parametrize(
    ("tail", "rules"),
    [
        ([0.5], ()),
        ([2.2, 0.1, 2.3], (2,)),
        ([-2.2, 0.1, -2.3], (2,)),
        ([2.2, 0.1, -2.3], ()),  # one on each side
        ([1.2, 1.3, -0.4, 1.4, 1.2], (3,)),
        ([0.2] * 8, (4,)),
        ([0.2] * 7, ()),
    ],
)
def test_rules_of_western_electric(tail: list[float], rules: tuple[int, ...]) -> None:
    """The rules are completed by the last value; the chart is that of a steady quantity around 0.

    Its standard deviation is the stated one, 1: moving ranges are smaller here.
    """
    steady = [0.3, -0.3] * 20
    middle = np.mean([*steady, *tail])
    values = np.array([*steady, *(middle + value for value in tail)])
    chart = control_chart(values, np.full(len(values), 2.0), np.zeros(len(values), bool))
    assert not chart.changed.any()
    assert abs(chart.centre[-1] - middle) < 0.15
    assert chart.signals[-1] == rules
    assert not any(chart.signals[: len(steady)])


def test_the_uncertainty_of_a_drift_is_that_of_the_line_that_leaves_more_than_stated() -> None:
    """By the whole design of the line, and Student's t of two values less."""
    days, values = np.array([0.0, 10.0, 20.0, 40.0]), np.array([0.0, 0.5, 0.3, 1.2])
    expanded = np.array([0.1, 0.2, 0.1, 0.1])
    design = np.column_stack([np.ones(4), days]) * (2.0 / expanded)[:, None]
    target = values * 2.0 / expanded
    line, square, *_ = np.linalg.lstsq(design, target, rcond=None)
    variance = np.linalg.inv(design.T @ design)[1, 1] * float(square[0]) / 2.0
    found = drift(days, values, expanded)
    assert found is not None
    assert found.per_day == pytest.approx(line[1])
    assert found.expanded == pytest.approx(student.ppf(0.975, 2) * np.sqrt(variance), rel=1e-3)
