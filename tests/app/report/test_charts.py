"""What plots are made of: scales, thinned points, names on rows."""

from __future__ import annotations

from itertools import pairwise, permutations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.report.charts.characters import chart_text
from app.report.charts.charts import (
    Chart,
    Series,
    even_limits,
    round_ticks,
    spread,
    thinned,
    tick_labels,
    turned,
    turned_limits,
)

VALUES = st.floats(-1e4, 1e4, allow_nan=False).map(lambda v: round(v, 4))


@pytest.mark.parametrize(
    ("values", "ticks"),
    [
        ([-0.52, 0.62], [-0.6, -0.4, -0.2, 0.0, 0.2, 0.4, 0.6, 0.8]),
        ([0.3, 0.5], [0.0, 0.1, 0.2, 0.3, 0.4, 0.5]),
        ([-100.0, 60.0], [-100.0, -50.0, 0.0, 50.0, 100.0]),
        ([], [-0.002, -0.001, 0.0, 0.001, 0.002]),
        ([0.0001], [-0.002, -0.001, 0.0, 0.001, 0.002, 0.003]),
    ],
)
def test_round_numbers_around_all_values_and_zero(values: list[float], ticks: list[float]) -> None:
    assert round_ticks(values) == pytest.approx(ticks)


@given(st.lists(VALUES, min_size=1, max_size=20))
def test_ticks_hold_everything_and_are_few(values: list[float]) -> None:
    ticks = round_ticks(values)
    assert ticks[0] <= min(0.0, *values) + 1e-9
    assert max(0.0, *values) - 1e-9 <= ticks[-1]
    assert 0.0 in ticks
    assert 2 <= len(ticks) <= 8
    steps = {round(later - tick, 9) for tick, later in pairwise(ticks)}
    assert max(steps) == pytest.approx(min(steps))


@pytest.mark.parametrize(
    ("room", "label_room", "labelled"),
    [
        (80, 8, [-0.6, -0.4, -0.2, 0.0, 0.2, 0.4, 0.6, 0.8]),
        (34, 8, [-0.4, 0.0, 0.4, 0.8]),
        (16, 8, [-0.0, 0.8]),
        (1, 8, [0.0]),
    ],
)
def test_labels_that_fit_and_zero(room: int, label_room: int, labelled: list[float]) -> None:
    assert spread(round_ticks([-0.52, 0.62]), room, label_room) == pytest.approx(labelled)


def test_labels_have_no_needless_decimals() -> None:
    assert tick_labels(round_ticks([-0.52, 0.3])) == ["-0.6", "-0.4", "-0.2", "0.0", "0.2", "0.4"]
    assert tick_labels(round_ticks([-100.0, 60.0])) == ["-100", "-50", "0", "50", "100"]
    assert tick_labels(round_ticks([0.0045])) == [f"0.00{k}" for k in range(6)]


def test_two_points_a_column_lowest_and_highest() -> None:
    cloud = Series("along X", (0.0, 0.0, 0.0, 10.0, 20.0, 20.0), (0.3, 0.1, 0.2, 0.5, 0.7, 0.6))
    series = thinned(cloud, 3)
    assert series.x == (0.0, 0.0, 10.0, 20.0, 20.0)
    assert series.y == (0.1, 0.3, 0.5, 0.6, 0.7)


@given(st.lists(st.tuples(VALUES, VALUES), max_size=200), st.integers(1, 60))
def test_thinned_points_keep_the_extremes(points: list[tuple[float, float]], columns: int) -> None:
    cloud = Series("any", tuple(x for x, _ in points), tuple(y for _, y in points))
    series = thinned(cloud, columns)
    assert set(zip(series.x, series.y, strict=True)) <= set(points)
    assert len(series.x) <= 2 * columns
    if points:
        assert (min(series.y), max(series.y)) == (min(cloud.y), max(cloud.y))


@given(st.lists(VALUES, max_size=8), st.integers(1, 120))
def test_every_round_number_falls_on_a_cell_of_its_own(values: list[float], cells: int) -> None:
    ticks = round_ticks(values)
    lower, upper = even_limits(ticks, cells)
    places = [(tick - lower) / (upper - lower) * (cells - 1) for tick in ticks]
    if cells < len(ticks):
        assert (lower, upper) == (ticks[0], ticks[-1])
    else:
        assert places == pytest.approx([round(place) for place in places], abs=1e-6)
        assert min(later - place for place, later in pairwise(places)) > 0.999
        assert places[0] >= -1e-6
        assert places[-1] <= cells - 1 + 1e-6


@given(st.integers(2, 12), st.integers(0, 40))
def test_every_name_falls_on_a_row_of_its_own(names: int, surplus: int) -> None:
    rows = names + surplus
    lower, upper = turned_limits(names, rows)
    places = [(name - lower) / (upper - lower) * (rows - 1) for name in range(1, names + 1)]
    assert places == pytest.approx([round(place) for place in places], abs=1e-6)
    assert len({round(place) for place in places}) == names
    assert places[0] >= -1e-6
    assert places[-1] <= rows - 1 + 1e-6


@pytest.mark.parametrize(("rows", "places"), [(3, [[3, 2, 1], [3, 2, 1]]), (6, [[3, 2], [2.5]])])
def test_series_of_a_turned_chart_share_a_row_only_where_they_must(
    rows: int, places: list[list[float]]
) -> None:
    names = ("a", "b", "c")
    first = Series("first", (0.88, 1.88, 2.88), (1.0, 2.0, 3.0))
    second = Series("second", (1.12, 2.12, 3.12), (1.0, 2.0, 3.0))
    side = turned(Chart("any", "", "mm", (first, second), names), rows)
    for series, expected in zip(side.series, places, strict=True):
        assert series.x == (1.0, 2.0, 3.0)
        assert list(series.y[: len(expected)]) == expected


def test_where_no_name_has_room_groups_are_named_in_words() -> None:
    names = tuple(
        f"{leg} along {axis}, {end}"
        for end in ("MAX", "MIN")
        for leg, axis in permutations("XYZ", 2)
    )
    legs = tuple(name.partition(",")[0] for name in names)
    series = Series("left", tuple(range(1, 13)), tuple(range(12)))
    chart = Chart("Left", "", "mm", (series,), names, x_groups=legs)
    low, high = chart_text(chart, 12, 80), chart_text(chart, 20, 80)
    assert "each: MAX, MIN" in low
    assert all(leg in low for leg in legs)
    assert all(name in high for name in names), "one below the other"
    assert "each" not in high
