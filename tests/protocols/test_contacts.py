"""Contacts: places at which a tool was on a plate, from a table to arrays and back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.errors import RecordError
from protocols.journal import write_whole
from protocols.machine import load_machine
from protocols.observations import corrected_readings, indicator_figures, to_observations
from protocols.record import read_record
from protocols.session import Session, fold
from protocols.table import opened_table
from tests.app.cli import glidecal, refused

HEADER = "x_mm,y_mm,z_mm,height_mm,cycle"


def session(folder: Path, *rows: str, header: str = HEADER) -> Session:
    table = folder / "contacts.csv"
    table.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    opened, events, _ = opened_table(table, load_machine("linear-delta"), "test")
    return fold([opened, *events])


def test_a_place_is_an_observation_with_nothing_read(tmp_path: Path) -> None:
    record = session(tmp_path, "0,0,0.25,0,1", "0,60,-0.10,0,1")
    assert record.of_contacts
    assert [reading.value_mm for reading in record.readings] == [0.0, 0.0]
    assert [reading.text for reading in record.readings] == ["0.25", "-0.10"]
    observations = to_observations([record])
    assert observations.contact.all()
    assert observations.position_mm.tolist() == [[0.0, 0.0, 0.25], [0.0, 60.0, -0.10]]
    assert observations.value_mm.tolist() == [0.0, 0.0]
    assert (observations.movement == -1.0).all()  # down, whatever stood before


def test_repeats_are_at_the_mean_of_their_places(tmp_path: Path) -> None:
    """Sent 4 µm higher than the mean and on the plate, the tool at the mean is 4 µm below it."""
    rows = ("0,0,0.100,0,1", "0,60,0.3,0,1", "0.002,-0.004,0.108,0,2", "0,60,25.3,25,1")
    observations = to_observations([session(tmp_path, *rows)])
    assert (
        observations.posture.tolist() == [1, 2, 1, 0] or len(np.unique(observations.posture)) == 3
    )
    assert observations.posture[0] == observations.posture[2]
    assert (
        observations.posture[1] != observations.posture[3]
    )  # the tool is 25 mm above the plate there
    assert observations.position_mm[0] == pytest.approx([0.001, -0.002, 0.104])
    assert observations.value_mm == pytest.approx([0.004, 0.0, -0.004, 25.0])


def test_places_beside_each_other_are_no_repeats(tmp_path: Path) -> None:
    observations = to_observations(
        [session(tmp_path, "0,0,0.1,0,1", "0.06,0,0.1,0,1", "9,0,0,0,1")]
    )
    assert len(np.unique(observations.posture)) == 3


def test_the_step_is_that_of_the_places(tmp_path: Path) -> None:
    places = [f"{x},0,{z:.2f},0,1" for x, z in ((0, 0.11), (10, 0.27), (20, -0.33), (30, 0.08))]
    assert indicator_figures([session(tmp_path, *places)]).display_mm == pytest.approx(0.01)


def test_a_table_of_contacts_comes_back_the_same(tmp_path: Path) -> None:
    record = session(tmp_path, "0,0,0.25,0,1", "0,60,-0.10,0,1", "0,60,24.9,25,2")
    table = record.table()
    assert table.names[:6] == ("x_mm", "y_mm", "z_mm", "axis", "lift_mm", "height_mm")
    again = tmp_path / "again.csv"
    path = tmp_path / "s.jsonl"
    write_whole(path, record.opened, list(record.all_readings))
    run = glidecal("export", path, "--table", "readings", "--format", "csv", "-o", again)
    assert run.status == 0, run.err
    opened, events, _ = opened_table(again, record.opened.machine, "test")
    assert fold([opened, *events]).table().rows == table.rows


def test_correcting_nothing_leaves_contacts_as_they_are(tmp_path: Path) -> None:
    from calib.diagnosis.results import CleanedReadings

    record = session(tmp_path, "0,0,0.100,0,1", "0,60,0.3,0,1", "0,0,0.108,0,2")
    observations, rows = to_observations([record]), np.arange(3)
    cleaned = CleanedReadings(observations, rows, np.zeros(3, dtype=np.intp))
    assert list(corrected_readings(record, cleaned)) == []


@pytest.mark.parametrize(
    ("header", "row", "message"),
    [
        (HEADER + ",value_mm", "0,0,0,0,1,0", "not both"),
        (HEADER, "0,0,0.1,1001,1", "column height_mm: found '1001'. Allowed: a number of"),
        (HEADER, "0,0,zero,0,1", "column z_mm: found 'zero'"),
        (HEADER, "0,0,,0,1", "column z_mm: found ''"),
        ("x_mm,y_mm,height_mm", "0,0,0", "Missing: z_mm"),
        ("leg,axis,displacement_mm,height_mm", "x,y,0,0", "Missing: value_mm"),
    ],
)
def test_tables_of_contacts_that_cannot_be(
    tmp_path: Path, header: str, row: str, message: str
) -> None:
    with pytest.raises(RecordError) as problem:
        session(tmp_path, row, header=header)
    assert message in " ".join(str(problem.value).split())


def test_a_place_that_is_not_what_its_text_says_is_told(tmp_path: Path) -> None:
    record = session(tmp_path, "0,0,0.25,0,1", "0,60,-0.10,0,1")
    path, altered = tmp_path / "s.jsonl", tmp_path / "altered.jsonl"
    write_whole(path, record.opened, list(record.all_readings))
    assert glidecal("validate", path).status == 0
    first, second = read_record(path).session.all_readings
    variant = second.model_copy(update={"position_mm": (0.0, 60.0, -0.15)})
    write_whole(altered, record.opened, [first, variant])
    assert "z_mm -0.15 beside the text '-0.10'" in refused(3, "validate", altered)


def test_a_probe_is_beside_the_tool_whatever_its_set_up_is_called(tmp_path: Path) -> None:
    """What was done by hand met the plate with the tool itself."""
    record = session(
        tmp_path,
        *("0,0,0.1,0,1,zz", '0,60,0.3,0,1,"tool-z, by hand"', "9,0,0,0,1,"),
        header=f"{HEADER},mount",
    )
    machine = record.opened.machine.model_copy(update={"probe_offset_mm": (12.0, -7.0)})
    beside = replace(record, opened=record.opened.model_copy(update={"machine": machine}))
    assert to_observations([beside]).beside_mm.tolist() == [
        [12.0, -7.0, 0.0],
        [0.0, 0.0, 0.0],
        [12.0, -7.0, 0.0],
    ]
