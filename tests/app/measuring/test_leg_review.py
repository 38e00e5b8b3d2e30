"""The table under the indicators while a leg is measured."""

from __future__ import annotations

from app.measuring.leg_review import LegRow
from app.report.text.session import leg_table_text
from calib.tripod.geometry import Geometry

NARROW_COLUMNS = 78
"""Of 80, one column on either side is empty."""


def test_six_levels_fit_in_a_narrow_terminal() -> None:
    """A sweep has six; a line that is cut in two cannot be read from three metres."""
    levels = dict.fromkeys((22.0, 60.0, 41.0, -37.0, -71.0, -100.0), -0.123)
    rows = [LegRow(axis, 12, levels, -0.004) for axis in ("y", "z")]
    lines = leg_table_text(rows, list(levels), Geometry()).splitlines()
    assert len(lines) == 3
    assert all(len(line) == len(lines[0]) <= NARROW_COLUMNS for line in lines)
    assert lines[0].split() == [
        *("minus", "Zero", "+22", "mm", "MAX", "+41", "mm"),
        *("-37", "mm", "-71", "mm", "MIN", "back", "at", "Zero"),
    ]
    assert lines[1].split() == ["Y", "cycle", "12", *["-0.123"] * 6, "-0.004"]


def test_columns_keep_their_order_whatever_is_measured_again() -> None:
    """MAX measured again comes after MIN in the record, not on the screen."""
    again = LegRow("y", 1, {-100.0: 0.2, 60.0: 0.1}, None)
    heading, row = leg_table_text([again], [0.0, 60.0, -100.0, 0.0], Geometry()).splitlines()
    assert heading.split()[2:4] == ["MAX", "MIN"]
    assert row.split()[3:] == ["+0.100", "+0.200"]
