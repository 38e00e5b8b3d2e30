"""Tables that leave the program: what is read back is what was written, and no text is obeyed."""

from __future__ import annotations

import csv
import random
from io import BytesIO, StringIO
from pathlib import Path

import openpyxl
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pyarrow import parquet

from calib.errors import RecordError
from calib.printable import HIDDEN, printable
from protocols.data_table import FORMATS, DataTable, protected, unprotected
from protocols.machine import load_machine
from protocols.record import read_record
from protocols.session import Event, Moved, Opened, Reading, Restored, Session, Superseded, fold
from protocols.table import opened_table
from tests.conftest import SAMPLES

HOSTILE = (
    *("=1+1", "'=1+1", "+5", "-1+cmd|' /C calc'!A0", "@SUM(A1)", "a;=1+1", 'a;"=1+1', "'", "''"),
    *("'a'", " a", "a ", "\t=1", "\x1b]0;title\x07", "\u202egnirts", "<script>alert(1)</script>"),
    *(
        "\\input{x}",
        "\\u003b",
        "\\u005cu003b",
        "#REF!",
        "TRUE",
        "0012",
        "1e5",
        "a,b",
        'a"b',
        "a\nb",
    ),
    *("%s", "{{x}}", "\u200bzero", "NULL", "nan"),
)
texts = st.sampled_from(HOSTILE) | st.text(st.characters(codec="utf-8"), max_size=12)
"""A record holds names as `printable` shows them: `Name` sees to it."""


def read_back(session: Session, form: str, folder: Path) -> Session:
    path = folder / f"t.{form}"
    written = session.table().file_content(form)
    path.write_bytes(written.encode() if isinstance(written, str) else written)
    opened, events, _ = opened_table(path, session.opened.machine, "test")
    return fold([opened, *events])


OF_A_LINE = {"line", "previous", "at", "seal", "step"}


def same(first: Session, second: Session) -> bool:
    """Readings but for the step of a procedure, which a table does not have; zeros; flags."""
    lines, second_lines = (
        [reading.model_dump(exclude=OF_A_LINE) for reading in session.all_readings]
        for session in (first, second)
    )
    flags = (first.superseded, first.restored), (second.superseded, second.restored)
    return lines == second_lines and flags[0] == flags[1]


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("path", sorted(SAMPLES.glob("*.jsonl")), ids=lambda path: path.stem)
def test_a_record_written_as_a_table_is_read_back(path: Path, form: str, tmp_path: Path) -> None:
    try:
        session = fold(read_record(path).events)
    except RecordError:
        assert path.stem == "damaged"
        return
    assert same(session, read_back(session, form, tmp_path))


@given(text=texts)
@example(text="'=1'")
@settings(max_examples=200, deadline=None)
def test_a_protected_text_is_inert_and_comes_back(text: str) -> None:
    cell = protected(text)
    assert unprotected(cell.strip()) == printable(text)
    assert not HIDDEN.search(cell)
    for part in (cell, *cell.split(";")[1:]):  # as another country's spreadsheet parts it
        try:
            float(part)
        except ValueError:
            computed = part.lstrip("\"' ")[:1] in set("=+-@")
            assert not computed or part.startswith("'")


def hostile_session(seed: int) -> Session:
    """Readings of two mountings with strangers' words in every text, and some that do not count."""
    pick = random.Random(seed)
    names = [printable(cell) for cell in (*HOSTILE, f"n{seed}")]
    mounts = pick.sample([name for name in names if name not in ("''", "")], 2)
    columns = pick.sample([name for name in names if name.strip()], 2)
    moved = Moved(
        driver=pick.choice([name for name in names if name.strip()]),
        coordinates=pick.choice(["tool", "joint"]),
        from_mm=(-0.0, 310.25, 1e-7),
        commanded_mm=(60.0, 0.1 + 0.2, pick.uniform(-200.0, 200.0)),
        read_back_mm=(59.9997, -0.3, pick.uniform(-200.0, 200.0)),
        feed_mm_min=1500.0,
    )
    readings = [
        Reading(
            reading=number,
            leg="x",
            axis="y",
            displacement_mm=pick.choice([0.0, 60.0, 0.1 + 0.2, -1e-7]),
            value_mm=pick.uniform(-10.0, 10.0),
            text=pick.choice(names) or "0",
            mount=mounts[number % 2],
            station=0.5,
            cycle=number,
            time_s=pick.choice([None, 0.0, pick.random()]),
            temperature_c=pick.choice([None, 20.5]),
            resolution_mm=pick.choice([None, 0.001]),
            unit_assumed=pick.random() < 0.5,
            averaged=pick.choice([1, 3]),
            moved=pick.choice([None, moved]),
            extra={column: pick.choice([*names, ""]) for column in columns},
        )
        for number in range(1, 7)
    ]
    opened = Opened(program="test", origin="imported", machine=load_machine(None))
    why = pick.choice(names)
    gone: list[Event] = [
        Superseded(readings=(2, 3), reason=why),
        Restored(readings=(3,), reason=why),
    ]
    return fold([opened, *readings, *gone])


@pytest.mark.parametrize("form", FORMATS)
def test_hostile_words_in_every_field_come_back_and_are_inert(form: str, tmp_path: Path) -> None:
    for seed in range(30):
        session = hostile_session(seed)
        assert same(session, read_back(session, form, tmp_path)), seed
    if form == "xlsx":
        sheet = openpyxl.load_workbook(tmp_path / "t.xlsx").active
        kinds = {cell.data_type for row in sheet.iter_rows() for cell in row}
        assert kinds <= {"s", "n", "e", "inlineStr"}  # none is a formula


def test_numbers_stay_numbers() -> None:
    table = DataTable.plain(("name", "mm", "n"), [("a", 0.1 + 0.2, 1), ("b", 0.25, None)])
    text = table.file_content("csv")
    assert isinstance(text, str)
    assert list(csv.reader(StringIO(text)))[1] == ["a", "0.30000000000000004", "1"]
    book = table.file_content("xlsx")
    assert isinstance(book, bytes)
    sheet = openpyxl.load_workbook(BytesIO(book)).active
    # more digits than a spreadsheet shows: a text, or the value would be another one
    assert [[cell.value for cell in row] for row in sheet.iter_rows()][1:] == [
        ["a", "0.30000000000000004", 1],
        ["b", 0.25, None],
    ]
    columns = table.file_content("parquet")
    assert isinstance(columns, bytes)
    kinds = [str(field.type) for field in parquet.read_schema(BytesIO(columns))]
    assert kinds[1:] == ["double", "int64"]


@pytest.mark.parametrize("content", [b"", b"PAR1", b"PAR1" + bytes(40) + b"PAR1", b"leg,axis\n"])
def test_a_broken_parquet_file_is_told(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "t.parquet"
    path.write_bytes(content)
    with pytest.raises(RecordError, match="no readable Parquet file"):
        opened_table(path, load_machine(None), "test")


@pytest.mark.parametrize("counts", ["maybe", "NO"])
def test_whether_a_reading_counts_is_a_word_of_three(counts: str, tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text(f"leg,axis,displacement_mm,value_mm,counts\nx,y,0,1,{counts}\n", "utf-8")
    with pytest.raises(RecordError, match=r"line 2, column counts: found .* yes, no or again"):
        opened_table(path, load_machine(None), "test")


def test_legs_and_tool_in_one_session_have_no_table() -> None:
    session = hostile_session(1)
    tool = {"leg": "tool", "position_mm": (0.0, 0.0, 0.0), "mount": "t", "station": 0.0}
    mixed = session.readings[0].model_copy(update={**tool, "reading": 7})
    with pytest.raises(RecordError, match="legs and of the tool"):
        fold([session.opened, *session.all_readings, mixed]).table()
