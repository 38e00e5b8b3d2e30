"""The strip chart: every reading has its dot, at its time and its height."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from app.measuring.gauges import SLOTS, Trace
from app.report.charts.strips import (
    LEAST_COLUMNS,
    LEAST_MM,
    SCALE_COLUMNS,
    chart_rows,
    scale_rows,
    strip_rows,
)

Dots = set[tuple[int, int]]


def dots_of(rows: tuple[str, ...]) -> Dots:
    """Across and down, from the numbering of the dots in Unicode: 1 2 3 7 and 4 5 6 8."""
    places = {
        1: (0, 0),
        2: (0, 1),
        3: (0, 2),
        7: (0, 3),
        4: (1, 0),
        5: (1, 1),
        6: (1, 2),
        8: (1, 3),
    }
    dots = set()
    for y, row in enumerate(rows):
        for x, character in enumerate(row):
            bits = ord(character) - 0x2800
            assert 0 <= bits < 256
            for number, (right, down) in places.items():
                if bits >> (number - 1) & 1:
                    dots.add((2 * x + right, 4 * y + down))
    return dots


readings = st.lists(
    st.tuples(st.floats(-20.0, 20.0), st.floats(0.0, 0.5)), min_size=1, max_size=SLOTS
)


@given(readings, st.integers(1, 60), st.integers(1, 8))
def test_every_reading_has_its_dot(
    heard: list[tuple[float, float]], columns: int, rows: int
) -> None:
    moments = tuple(
        (len(heard) - 1 - k, low, low + height) for k, (low, height) in enumerate(heard)
    )
    last = heard[-1][0]
    trace = Trace(moments, (last - 0.002, last + 0.002))
    chart = chart_rows(trace, columns, rows)
    assert [len(row) for row in chart] == [columns] * rows
    dots = dots_of(chart)
    wide, high = 2 * columns, 4 * rows
    lowest = min([low for _, low, _ in moments] + [last - 0.002])
    highest = max([top for _, _, top in moments] + [last + 0.002])
    for ago, low, top in moments:
        x = (SLOTS - 1 - ago) * wide // SLOTS
        column = sorted(y for across, y in dots if across == x)
        assert column, "each moment is drawn"
        if rows >= 3:
            words = scale_rows(trace, rows)
            upper, lower = (float(words[k].replace("−", "-")) for k in (0, -1))
            assert lower - 0.06 <= lowest
            assert highest <= upper + 0.06
            for value in (low, top):
                y = (upper - value) / (upper - lower) * high
                # edges are written with one decimal where the chart is high
                assert any(abs(y - 0.5 - dot) <= 1.0 + 0.06 * high for dot in column)


def test_nothing_heard_is_nothing_drawn_and_no_room_is_none_taken() -> None:
    assert dots_of(strip_rows(Trace(), 10, 2)) == set()
    assert strip_rows(Trace(), 40, 2) == ("", "")
    trace = Trace(((0, 1.0, 1.0),), (0.998, 1.002))
    assert strip_rows(trace, 0, 1) == ("",)
    assert strip_rows(trace, 10, 0) == ()


def test_at_rest_the_band_is_the_rest_limit_and_the_scale_keeps_still() -> None:
    levels = []
    for flicker in (0.0, 0.001, -0.001):
        value = 1.0003 + flicker
        moments = tuple((ago, value, value) for ago in range(SLOTS - 1, -1, -1))
        band = (value - 0.002, value + 0.002)
        dots = dots_of(chart_rows(Trace(moments, band), 40, 6))
        line = {y for x, y in dots if x % 4}
        edges = {y for x, y in dots if not x % 4} - line
        assert len(line) == 1
        assert math.isclose(max(edges) - min(edges), 24 * 0.004 / LEAST_MM, abs_tol=1.0)
        assert min(edges) < min(line) < max(edges)
        levels.append(line.pop())
    assert 1 <= levels[2] - levels[0] <= 2, "a digit down, on the same scale"


def stepped(size_mm: float) -> Trace:
    """At 1 mm, and half of the time ago a step of this size."""
    values = [1.0 if ago > SLOTS // 2 else 1.0 + size_mm for ago in range(SLOTS - 1, -1, -1)]
    moments = tuple((SLOTS - 1 - k, value, value) for k, value in enumerate(values))
    return Trace(moments, (1.0 + size_mm - 0.002, 1.0 + size_mm + 0.002))


def test_a_flicker_does_not_look_like_a_step() -> None:
    """1 µm is a dot of twenty-four at most, 1 mm half of the height, and both are written."""
    heights = []
    for size_mm in (0.001, 1.0):
        edges = {
            max(0, round(24 * share)) for share in (0.0, 1.0)
        }  # rows of dots at the ends of the chart
        dots = dots_of(chart_rows(stepped(size_mm), 40, 6))
        line = {y for x, y in dots if x % 4 and y not in edges}
        heights.append(max(line) - min(line))
    assert heights[0] <= 2
    assert heights[1] >= 11
    assert scale_rows(stepped(0.001), 1) == ("20 µm, 20 s",)
    assert scale_rows(stepped(1.0), 1) == ("2 mm, 20 s",)


def test_the_scale_stands_beside_the_chart() -> None:
    rows = strip_rows(stepped(1.0), 40, 5)
    assert all(len(row) == 40 for row in rows)
    words = [row[-SCALE_COLUMNS:].strip() for row in rows]
    assert words == ["+2.60", "2 mm, 20 s", "rest 4 µm", "", "+0.60"]
    replayed = Trace(stepped(1.0).moments, span_s=0.0)
    assert scale_rows(replayed, 2) == ("2 mm", "")
    assert len(dots_of(strip_rows(stepped(1.0), LEAST_COLUMNS - 1, 2))) > 0
