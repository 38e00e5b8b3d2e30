"""The table under the indicators while a leg is measured, and the review after it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from app.measuring.leg_review import LegRow, Usual, leg_rows, review_leg
from app.report.text.leg_review import review_text
from app.report.text.session import leg_table_text
from calib.tripod.geometry import Geometry
from protocols.record import read_record
from protocols.session import Session
from tests.conftest import SAMPLES

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


def measured(*, repeatability_mm: float | None, legs: str = "xyz") -> Session:
    """The sample session, its indicators with this stated, after these legs."""
    session = read_record(SAMPLES / "simulated_zero-max-min.jsonl").session
    opened = session.opened
    update = {"repeatability_mm": repeatability_mm, "resolution_mm": None}
    instruments = tuple(instrument.model_copy(update=update) for instrument in opened.instruments)
    readings = tuple(r for r in session.readings if r.leg in legs)
    return replace(
        session,
        opened=opened.model_copy(update={"instruments": instruments}),
        readings=readings,
        all_readings=readings,
    )


def with_wrong(session: Session, step: int, off_mm: float) -> Session:
    """One step of it read this wrong along the first axis."""
    wrong = next(r.reading for r in session.readings if r.step == step)
    readings = tuple(
        r.model_copy(update={"value_mm": r.value_mm + off_mm}) if r.reading == wrong else r
        for r in session.readings
    )
    return replace(session, readings=readings, all_readings=readings)


def test_scatter_is_judged_where_nothing_is_stated() -> None:
    """On the first leg by an indicator at rest: 0.004 mm may lie between readings at rest."""
    session = measured(repeatability_mm=None, legs="x")
    step = session.steps()[0]
    calm = review_leg(session, step)
    assert all(axis.usual is Usual.AT_REST for axis in calm.axes)
    assert all(axis.usual_mm == 0.004 for axis in calm.axes)
    assert "No scatter is suspicious." in review_text(calm, session)
    wrong = with_wrong(session, 5, 0.94)
    review = review_leg(wrong, step)
    text = " ".join(review_text(review, wrong).split())
    first, second = review.axes
    deviation_mm = first.standard_deviation_mm
    assert deviation_mm is not None
    assert deviation_mm > 0.2
    assert second.excess < 1.0
    assert f"scatter {deviation_mm / 0.004:.0f} times as much as an indicator at rest." in text
    assert "Step 5, leg X MAX, cycle 2, is +0.9" in text
    assert "No scatter is suspicious" not in text
    assert review_leg(session, step, [0.02, 0.0]).axes[0].usual_mm == 0.02


def test_the_other_legs_teach_how_much_is_usual() -> None:
    """What would be nothing beside an indicator at rest is much beside four calm axes."""
    session = measured(repeatability_mm=None)
    step = session.steps()[-1]
    calm = review_leg(session, step)
    assert all(axis.usual is Usual.OTHERS for axis in calm.axes)
    assert "No scatter is suspicious." in review_text(calm, session)
    usual_mm = calm.axes[0].usual_mm
    legs = [review_leg(session, session.steps()[k]).axes for k in (0, 10)]
    spreads = [axis.standard_deviation_mm or 0.0 for leg in legs for axis in leg]
    spreads.append(calm.axes[1].standard_deviation_mm or 0.0)
    assert np.isclose(usual_mm, np.median(spreads))
    restless = with_wrong(session, 25, 12.0 * usual_mm)
    assert "times as much as the other legs do" in review_text(review_leg(restless, step), restless)


def test_what_is_stated_is_held_against_it_too() -> None:
    session = measured(repeatability_mm=0.0001, legs="x")
    review = review_leg(session, session.steps()[0])
    assert all(axis.usual is Usual.STATED for axis in review.axes)
    assert "times as much as its indicator states" in review_text(review, session)


def test_a_step_measured_again_later_stands_in_the_row_of_its_cycle() -> None:
    """MAX of cycle 1 was read after MAX of cycle 3."""
    session = measured(repeatability_mm=None, legs="x")
    first = [r for r in session.readings if r.step == 2]
    other_readings = [r for r in session.readings if r.step != 2]
    later = replace(session, readings=(*other_readings, *first))
    rows, before = (leg_rows(s, s.steps()[0]) for s in (later, session))
    assert [row.minus_zero_mm for row in rows] == [row.minus_zero_mm for row in before]
    assert rows[0].minus_zero_mm[60.0] == first[0].value_mm - other_readings[0].value_mm
