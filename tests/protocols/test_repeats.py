"""Readings that disagree with the earlier repeats of their posture."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from protocols.events import Event, Mounted, Opened, Reading, Restored, Superseded
from protocols.machine import Machine
from protocols.procedure import Procedure
from protocols.session import disagreements, fold

LIMIT_MM = 0.05
Raw = tuple[str, float, float]
"""Mounting, displacement and value, mm."""


def opened(*, imported: bool = False) -> Opened:
    procedure = Procedure(
        schema="glidecal.procedure/1",
        name="p",
        title="p",
        cycles=9,
        levels=("zero", "max", "min"),
        repeat_limit_mm=LIMIT_MM,
    )
    return Opened(
        program="test",
        origin="imported" if imported else "measured",
        machine=Machine(),
        procedure=None if imported else procedure,
    )


def reading(number: int, raw: Raw) -> Reading:
    mount, displacement_mm, value_mm = raw
    return Reading(
        reading=number,
        leg="x",
        axis="z" if mount.startswith("xz") else "y",
        displacement_mm=displacement_mm,
        value_mm=value_mm,
        text=str(value_mm),
        mount=mount,
    )


def questioned(raw: Sequence[Raw], *, taken: int = 1) -> list[tuple[int, float, float, int]]:
    """Number, difference, earlier mean and their count for those of the last ones in question."""
    readings = [reading(k, one) for k, one in enumerate(raw, start=1)]
    found = disagreements(fold([opened(), *readings]), readings[-taken:])
    return [
        (d.reading.reading, round(d.difference_mm, 6), round(d.earlier_mean_mm, 6), d.earlier_count)
        for d in found
    ]


def test_the_first_reading_of_a_posture_is_never_questioned() -> None:
    assert questioned([("xy", 0.0, 900.0)]) == []
    assert questioned([("xy", 0.0, 0.1), ("xy", 60.0, 5.0), ("xy", -100.0, -7.0)], taken=3) == []


def test_one_wild_reading_is_compared_with_the_mean_of_the_earlier_ones() -> None:
    calm = [("xy", 60.0, 0.30), ("xy", 60.0, 0.32), ("xy", 0.0, 5.0), ("xy", 60.0, 0.34)]
    assert questioned([*calm, ("xy", 60.0, 0.50)]) == [(5, 0.18, 0.32, 3)]
    assert questioned([*calm, ("xy", 60.0, 0.20)]) == [(5, -0.12, 0.32, 3)]


@pytest.mark.parametrize(("value_mm", "count"), [(0.049, 0), (0.051, 1), (-0.049, 0), (-0.051, 1)])
def test_the_limit_is_the_procedures(value_mm: float, count: int) -> None:
    assert len(questioned([("xy", 0.0, 0.0), ("xy", 0.0, value_mm)])) == count


def test_a_stand_that_slipped_shows_in_both_axes_and_in_every_posture() -> None:
    before = [("xy", 0.0, 0.0), ("xz", 0.0, 1.0), ("xy", 60.0, 0.2), ("xz", 60.0, 1.2)]
    after = [(mount, at, value + 0.4) for mount, at, value in before]
    assert [d[:2] for d in questioned([*before, *after], taken=4)] == [
        (number, 0.4) for number in (5, 6, 7, 8)
    ]


def test_another_mounting_has_a_zero_of_its_own() -> None:
    assert questioned([("xy", 0.0, 0.1), ("xy#2", 0.0, 0.9)]) == []
    assert questioned([("xy", 0.0, 0.1), ("xy#2", 0.0, 0.9), ("xy#2", 0.0, 0.1)]) == [
        (3, -0.8, 0.9, 1)
    ]


def test_superseded_readings_are_not_compared_until_they_count_again() -> None:
    wild, calm, again = (
        reading(k, ("xy", 60.0, mm)) for k, mm in enumerate([5.0, 0.3, 0.31], start=1)
    )
    mounted = Mounted(leg="x", station=0.5, mounts={"y": "xy"})
    superseded = Superseded(readings=(1,), reason="wild")
    events: list[Event] = [opened(), mounted, wild, superseded, calm, again]
    assert disagreements(fold(events), [calm]) == ()
    assert disagreements(fold(events), [again]) == ()
    restored = Restored(readings=(1,), reason="it was not")
    (found,) = disagreements(fold([*events, restored]), [again])
    assert found.earlier_count == 2
    assert found.earlier_mean_mm == pytest.approx(2.65)


def test_an_imported_table_has_no_limit() -> None:
    readings = [reading(1, ("xy", 0.0, 0.0)), reading(2, ("xy", 0.0, 9.0))]
    assert disagreements(fold([opened(imported=True), *readings]), readings) == ()
