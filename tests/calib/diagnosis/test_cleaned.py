"""Readings that a diagnosis holds after each kind of mistake: labels, values, slips, what is out.

Mistakes are put on a known session here by a loop of its own; the cleaned readings must be that
session again, whatever order and repeats within visits it has.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calib.arrays import FloatArray, IntArray, Observations
from calib.diagnosis.results import CleanedReadings, Diagnosis
from calib.posterior.cells import SessionCase
from tests.calib.diagnosis.diagnosed_sessions import (
    SHORT,
    SWEEP,
    case,
    diagnose,
    mistakes,
    with_values,
)
from tests.conftest import LONG, first_quick

Change = Callable[[Observations, FloatArray], FloatArray]


def rows_of(observations: Observations, place: str) -> IntArray:
    leg, axis = map("xyz".index, place)
    return np.flatnonzero((observations.leg == leg) & (observations.axis == axis))


def swapped(first: str, second: str) -> Change:
    """Values of two tables exchanged, visit by visit."""

    def change(observations: Observations, value: FloatArray) -> FloatArray:
        here, there = rows_of(observations, first), rows_of(observations, second)
        value[here], value[there] = value[there], value[here].copy()
        return value

    return change


def times(place: str, factor: float) -> Change:
    def change(observations: Observations, value: FloatArray) -> FloatArray:
        value[rows_of(observations, place)] *= factor
        return value

    return change


def postures_exchanged(place: str, cycle: int) -> Change:
    def change(observations: Observations, value: FloatArray) -> FloatArray:
        rows = rows_of(observations, place)
        rows = rows[observations.cycle[rows] == cycle]
        high, low = (rows[observations.displacement_mm[rows] == level] for level in (60.0, -100.0))
        value[high], value[low] = value[low], value[high].copy()
        return value

    return change


def twice_read(observations: Observations) -> Observations:
    """Every reading written down twice in a row: one visit of two readings."""
    return observations.take(np.repeat(np.arange(len(observations)), 2))


def changed(session: SessionCase, change: Change) -> tuple[SessionCase, Diagnosis]:
    value = change(session.observations, session.observations.value_mm.copy())
    wrong = with_values(session, value)
    return wrong, diagnose([wrong])


def cleaned(diagnosis: Diagnosis) -> CleanedReadings:
    (session,) = diagnosis.cleaned
    return session


def key(observations: Observations) -> list[tuple[float, ...]]:
    """Labels and value of every reading, in any order."""
    columns = (
        observations.leg,
        observations.axis,
        observations.station,
        observations.displacement_mm,
        observations.approach,
        observations.cycle,
        observations.value_mm.round(9),
    )
    return sorted(zip(*(column.tolist() for column in columns), strict=True))


@pytest.mark.parametrize(
    ("name", "change"),
    first_quick(
        [
            ("gauge_swap", swapped("zx", "zy")),
            ("gauge_sign", times("yz", -1.0)),
            ("unit_mixup", times("xz", 25.4)),
            ("unit_mixup", times("xz", 1.0 / 25.4)),
            ("postures_exchanged", postures_exchanged("xy", 2)),
        ],
        several=True,
    ),
)
@pytest.mark.parametrize("repeated", first_quick([False, True]), ids=["once", "twice"])
def test_values_go_back_to_their_labels(name: str, change: Change, repeated: bool) -> None:
    session = case(SHORT, seed=3)
    if repeated:
        session = replace(session, observations=twice_read(session.observations))
    wrong, diagnosis = changed(session, change)
    assert [mistake.id for mistake in mistakes(diagnosis)] == [name]
    right = cleaned(diagnosis)
    assert right.rows.tolist() == list(range(len(session.observations)))
    assert not right.slips.any()
    assert key(right.observations) == key(session.observations)
    assert key(wrong.observations) != key(session.observations)
    groups = np.unique(
        np.column_stack(
            [right.observations.mount, right.observations.leg, right.observations.axis]
        ),
        axis=0,
    )
    assert len(groups) == session.observations.mount_count


@LONG
def test_two_mistakes_are_put_right_one_after_the_other() -> None:
    """An indicator reads the wrong way, and it changed places with the other one."""
    session = case(SHORT, seed=7)

    def both(observations: Observations, value: FloatArray) -> FloatArray:
        value = times("zx", -1.0)(observations, value)
        return swapped("zx", "zy")(observations, value)

    _, diagnosis = changed(session, both)
    assert {mistake.id for mistake in mistakes(diagnosis)} == {"gauge_sign", "gauge_swap"}
    assert key(cleaned(diagnosis).observations) == key(session.observations)


@pytest.mark.parametrize("repeated", first_quick([False, True]), ids=["once", "twice"])
def test_a_slip_gives_what_follows_a_mounting_of_its_own(repeated: bool) -> None:
    session = case(SWEEP, seed=6)
    if repeated:
        session = replace(session, observations=twice_read(session.observations))
    rows = rows_of(session.observations, "yx")
    moved = rows[18:] if repeated else rows[9:]

    def slip(observations: Observations, value: FloatArray) -> FloatArray:
        value[moved] += 0.05
        return value

    wrong, diagnosis = changed(session, slip)
    assert [mistake.id for mistake in mistakes(diagnosis)] == ["stand_slip"]
    right = cleaned(diagnosis)
    assert np.flatnonzero(right.slips).tolist() == moved.tolist()
    assert right.observations.mount_count == session.observations.mount_count + 1
    assert len(np.unique(right.observations.mount[moved])) == 1
    still = np.setdiff1d(rows, moved)
    assert {*right.observations.mount[still]}.isdisjoint({*right.observations.mount[moved]})
    assert np.array_equal(right.observations.value_mm, wrong.observations.value_mm)


@LONG
@pytest.mark.parametrize(("place", "off_mm"), [("zy", 0.1), ("xz", -2.0)])
@pytest.mark.parametrize("repeated", first_quick([False, True]), ids=["once", "twice"])
def test_a_wild_visit_is_left_out_and_nothing_else(
    place: str, off_mm: float, repeated: bool
) -> None:
    session = case(SHORT, seed=8)
    if repeated:
        session = replace(session, observations=twice_read(session.observations))
    rows = rows_of(session.observations, place)
    wild = rows[8:10] if repeated else rows[4:5]

    def change(observations: Observations, value: FloatArray) -> FloatArray:
        value[wild] += off_mm
        return value

    _, diagnosis = changed(session, change)
    assert [mistake.id for mistake in mistakes(diagnosis)] == ["wild_reading"]
    right = cleaned(diagnosis)
    good_rows = np.setdiff1d(np.arange(len(session.observations)), wild)
    assert right.rows.tolist() == good_rows.tolist()
    assert key(right.observations) == key(session.observations.take(good_rows))


@LONG
def test_a_wild_reading_in_an_exchanged_table_is_out_where_it_was_written() -> None:
    session = case(SHORT, seed=3)
    wild = rows_of(session.observations, "zx")[4]

    def both(observations: Observations, value: FloatArray) -> FloatArray:
        value = swapped("zx", "zy")(observations, value)
        value[wild] += 0.5
        return value

    _, diagnosis = changed(session, both)
    assert {mistake.id for mistake in mistakes(diagnosis)} == {"gauge_swap", "wild_reading"}
    right = cleaned(diagnosis)
    assert np.setdiff1d(np.arange(len(session.observations)), right.rows).tolist() == [wild]
    row = rows_of(session.observations, "zy")[4]
    expected = session.observations.take(np.setdiff1d(np.arange(len(session.observations)), [row]))
    assert key(right.observations) == key(expected)


@LONG
def test_only_the_session_with_the_mistake_is_changed() -> None:
    good, second_case = case(SHORT, seed=1), case(SHORT, seed=2)
    value = times("yz", -1.0)(second_case.observations, second_case.observations.value_mm.copy())
    diagnosis = diagnose([good, with_values(second_case, value)])
    first, second = diagnosis.cleaned
    assert key(first.observations) == key(good.observations)
    assert key(second.observations) == key(second_case.observations)


def test_the_readings_of_a_sound_session_are_as_they_were() -> None:
    session = case(SWEEP, seed=1)
    right = cleaned(diagnose([session]))
    for name in ("value_mm", "leg", "axis", "displacement_mm", "approach", "cycle", "mount"):
        assert np.array_equal(
            getattr(right.observations, name), getattr(session.observations, name)
        )
    assert right.rows.tolist() == list(range(len(session.observations)))
