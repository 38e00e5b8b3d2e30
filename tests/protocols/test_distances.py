"""Distances between marks: from a table beside contacts or readings to record and arrays."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import pytest

from calib.errors import RecordError
from protocols.journal import write_whole
from protocols.machine import load_machine
from protocols.observations import measured_distances
from protocols.record import read_record
from protocols.session import Changed, Distance, Event, fold
from protocols.table import checked_distances, distances_of_table
from tests.app.cli import glidecal, refused
from tests.conftest import LONG, ROOT

HEADER = "from_x_mm,from_y_mm,from_z_mm,to_x_mm,to_y_mm,to_z_mm,distance_mm,deviation_mm"
ROWS = ("-60,0,0,60,0,0,120.13,0.02", "0,-60,0,0,60,0,119.9,")
CONTACTS = ROOT / "sample_sessions" / "tables" / "contacts.csv"


def table(folder: Path, *rows: str, header: str = HEADER) -> Path:
    path = folder / "distances.csv"
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    return path


def distances(folder: Path, *rows: str, header: str = HEADER) -> tuple[Distance, ...]:
    measured = distances_of_table(table(folder, *rows, header=header))
    return checked_distances(measured, load_machine("linear-delta").geometry(), 0.05)


def test_rows_are_distances_with_their_own_deviation(tmp_path: Path) -> None:
    first, second = distances(tmp_path, *ROWS)
    assert (first.from_mm, first.to_mm) == ((-60.0, 0.0, 0.0), (60.0, 0.0, 0.0))
    assert (first.value_mm, first.deviation_mm, first.text) == (120.13, 0.02, "120.13")
    assert (second.distance, second.value_mm, second.deviation_mm) == (2, 119.9, 0.05)


def test_decimal_commas_are_taken(tmp_path: Path) -> None:
    (only,) = distances(tmp_path, "-60;0;0;60;0;0;120,13;0,02", header=HEADER.replace(",", ";"))
    assert (only.value_mm, only.deviation_mm, only.text) == (120.13, 0.02, "120.13")


def test_from_a_table_beside_contacts_to_arrays(tmp_path: Path) -> None:
    out = tmp_path / "s.jsonl"
    options = ("--machine", "linear-delta", "--distances", table(tmp_path, *ROWS))
    run = glidecal("import", CONTACTS, "-o", out, *options, "--distance-deviation", "0.07")
    assert run.status == 0, run.err
    assert "contacts and 2 distances between marks written" in run.err
    arrays = measured_distances(read_record(out).session)
    assert arrays.first_mm.tolist() == [[-60.0, 0.0, 0.0], [0.0, -60.0, 0.0]]
    assert arrays.second_mm.tolist() == [[60.0, 0.0, 0.0], [0.0, 60.0, 0.0]]
    assert arrays.value_mm.tolist() == [120.13, 119.9]
    assert arrays.deviation_mm.tolist() == [0.02, 0.07]


@LONG
def test_a_distance_that_cannot_be_is_named(tmp_path: Path) -> None:
    """The sample's tool does what three tables of distances say; 0.8 mm longer is none of it."""
    sample = ROOT / "sample_sessions" / "tables" / "distances.csv"
    wrong = tmp_path / "wrong.csv"
    wrong.write_text(sample.read_text("utf-8").replace("119.66", "120.46"), encoding="utf-8")
    more = tmp_path / "more.csv"
    more.write_text(sample.read_text("utf-8").replace("119.66", "121.46"), encoding="utf-8")
    for path, warned in ((sample, ""), (wrong, "120.46"), (more, "121.46")):
        out = tmp_path / f"{path.stem}.jsonl"
        options = ("--machine", "linear-delta", "--distances", path)
        assert glidecal("import", CONTACTS, "-o", out, *options).status == 0
        words = " ".join(glidecal("solve", out).out.split())
        warning = f"WARNING: distance 2 of {path.stem}.jsonl, {warned} mm, is"
        assert (warning in words) == bool(warned)
        assert ("WARNING: distance" in words) == bool(warned)


@LONG
def test_distances_stand_beside_readings_of_legs(tmp_path: Path) -> None:
    readings = ROOT / "sample_sessions" / "tables" / "experiment_1_six.csv"
    out = tmp_path / "s.jsonl"
    noise = ("--resolution", "0.01", "--repeatability", "0.02")
    run = glidecal("import", readings, "-o", out, "--distances", table(tmp_path, *ROWS), *noise)
    assert run.status == 0, run.err
    assert "2 distances between marks" in glidecal("solve", out).out
    for verb in ("diagnose", "report"):
        options = ("-o", tmp_path / "r.html") if verb == "report" else ()
        run = glidecal(verb, out, *options)
        assert run.status == 0
        if verb == "diagnose":
            words = " ".join(run.out.split())
            assert (
                "The chances include the distances between marks; the millimetres are of" in words
            )


def test_what_was_measured_before_a_change_is_of_another_machine() -> None:
    record = read_record(ROOT / "sample_sessions" / "every_schema" / "5" / "contacts.jsonl")
    before, *later = record.session.distances
    changed = Changed(reason="another belt", at=datetime(2026, 11, 24, tzinfo=UTC))
    readings = record.session.all_readings
    events: list[Event] = [record.session.opened, *readings, before, changed]
    assert fold(events).distances == ()
    assert fold([*events, *later]).distances == tuple(later)


def test_numbers_count_up(tmp_path: Path) -> None:
    record = read_record(ROOT / "sample_sessions" / "every_schema" / "5" / "contacts.jsonl")
    session, (first, *remaining) = record.session, record.session.distances
    path = tmp_path / "s.jsonl"
    write_whole(path, session.opened, [*session.all_readings, *remaining, first])
    with pytest.raises(RecordError, match=r"found distance 2\. Allowed: distance 1"):
        read_record(path)


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("-60,0,0,60,0,0,12.013,0.02", "12.013 mm between marks that were commanded 120 mm apart"),
        ("-60,0,0,60,0,0,-120,0.02", "-120 mm between marks"),
        ("9,0,0,9,0,0,1,0.02", "1 mm between marks that were commanded 0 mm apart"),
        ("-60,0,0,60,0,0,x,0.02", "column distance_mm: found 'x'"),
        ("-60,0,,60,0,0,120,0.02", "column from_z_mm: found ''"),
        ("-60,0,0,600,0,0,660,0.02", "a mark at (600, 0, 0) mm. Allowed: places that the bars"),
        ("-60,0,0,60,0,0,120,0", "a standard deviation of 0 mm. Allowed: 0.0001 … 5 mm"),
        ("-60,0,0,60,0,0,120,9", "a standard deviation of 9 mm"),
    ],
)
def test_tables_that_cannot_be(tmp_path: Path, row: str, message: str) -> None:
    with pytest.raises(RecordError) as problem:
        distances(tmp_path, row)
    assert message in " ".join(str(problem.value).split())


def test_tables_in_each_others_place(tmp_path: Path) -> None:
    out, source = ("-o", tmp_path / "s.jsonl"), table(tmp_path, *ROWS)
    assert "distances between marks, and no reading" in refused(3, "import", source, *out)
    options = ("--machine", "linear-delta", "--distances", CONTACTS)
    assert "Missing: distance_mm" in refused(3, "import", CONTACTS, *out, *options)
    assert "no distances" in refused(2, "import", CONTACTS, *out, "--distance-deviation", "0.1")
    deviation = ("--distances", source, "--distance-deviation", "0")
    assert "a standard deviation of 0 mm" in refused(
        3, "import", CONTACTS, *options[:2], *out, *deviation
    )
