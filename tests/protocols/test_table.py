"""Tables of readings: what is accepted, and the words for what is not."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZipFile

import openpyxl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.errors import RecordError, UsageError
from protocols.data_table import MOST_UNPACKED_BYTES
from protocols.machine import load_machine
from protocols.procedure import load_procedure
from protocols.session import MOVED, Reading
from protocols.table import empty_table
from tests.builders import read_table
from tests.conftest import LONG

HEADER = "leg,axis,displacement_mm,value_mm"
GOOD = f"{HEADER}\nx,y,0,0.10\nx,y,60,0.25\n"


def read(tmp_path: Path, text: str | bytes) -> tuple[tuple[Reading, ...], tuple[str, ...]]:
    path = tmp_path / "t.csv"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return read_table(path)


def test_smallest_table(tmp_path: Path) -> None:
    readings, unknown = read(tmp_path, GOOD)
    assert [(r.leg, r.axis, r.displacement_mm, r.value_mm) for r in readings] == [
        ("x", "y", 0.0, 0.10),
        ("x", "y", 60.0, 0.25),
    ]
    assert readings[0].text == "0.10"
    assert (readings[0].mount, readings[0].averaged, readings[0].station) == ("xy", 1, 0.5)
    assert unknown == ()


def test_all_columns_and_unknown_ones_are_kept(tmp_path: Path) -> None:
    readings, unknown = read(
        tmp_path,
        HEADER + ",cycle,time_s,mount,station,temperature_c,averaged,seq,weather\n"
        "z,x,-100,-.5,2,12.5,first,0.3,21.5,3,1,rain\n",
    )
    (r,) = readings
    assert (r.cycle, r.time_s, r.mount, r.station) == (2, 12.5, "first", 0.3)
    assert (r.temperature_c, r.averaged, r.extra) == (21.5, 3, {"weather": "rain"})
    assert unknown == ("weather",)


def test_a_height_beside_the_value_of_an_indicator_on_a_leg_is_kept_only(tmp_path: Path) -> None:
    readings, unknown = read(tmp_path, f"{HEADER},height_mm\nx,y,0,0.10,7\nx,y,60,0.25,8\n")
    assert [(r.value_mm, r.text) for r in readings] == [(0.10, "0.10"), (0.25, "0.25")]
    assert readings[1].extra == {"height_mm": "8"}
    assert unknown == ("height_mm",)


@pytest.mark.parametrize("text", [GOOD.replace("\n", "\r\n"), "\ufeff" + GOOD, GOOD + "\n,,,\n"])
def test_windows_line_ends_byte_order_mark_and_blank_rows(tmp_path: Path, text: str) -> None:
    assert len(read(tmp_path, text)[0]) == 2


@pytest.mark.parametrize("first", ["sep=;", '"sep=;"', "SEP=;;;", "sep=,"])
def test_a_first_line_that_names_the_separator_is_passed_over(tmp_path: Path, first: str) -> None:
    rows = GOOD if "," in first else GOOD.replace(",", ";").replace(".", ",")
    readings, unknown = read(tmp_path, f"{first}\n{rows}")
    assert [r.value_mm for r in readings] == [0.10, 0.25]
    assert unknown == ()
    with pytest.raises(RecordError, match="line 5, column leg"):  # lines count as in an editor
        read(tmp_path, f"{first}\n{rows}w{rows.splitlines()[-1][1:]}\n")


@pytest.mark.parametrize("mark", ["|", "\t"])
def test_another_separator_is_refused_with_its_line(tmp_path: Path, mark: str) -> None:
    with pytest.raises(RecordError, match=r"line 1: found 'sep=.*'\. Allowed: sep=; or sep=,"):
        read(tmp_path, f"sep={mark}\n{GOOD.replace(',', mark)}")


@pytest.mark.parametrize("temperature", ["-273.16", "-280", "-300"])
def test_a_temperature_below_absolute_zero_is_refused(tmp_path: Path, temperature: str) -> None:
    with pytest.raises(RecordError, match=r"line 2, column temperature_c: .* absolute zero"):
        read(tmp_path, f"{HEADER},temperature_c\nx,y,0,0.1,{temperature}\n")
    readings, _ = read(tmp_path, f"{HEADER},temperature_c\nx,y,0,0.1,-273.15\n")
    assert readings[0].temperature_c == -273.15


def test_tabs_between_columns_are_told(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match=r"found tabs between columns\. Allowed: commas"):
        read(tmp_path, "leg\taxis\tdisplacement_mm\tvalue_mm\nx\ty\t0\t1\n")


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("w,y,0,0.1", r"line 3, column leg: found 'w'. Allowed: x, y or z"),
        ("x,x,0,0.1", r"column axis: found 'x'. Allowed: an axis across the leg"),
        ("x,y,0,nan", r"column value_mm: found 'nan'"),
        ("x,y,0,inf", r"column value_mm: found 'inf'"),
        ("x,y,0,1e999", r"sensible size, up to 1000 mm"),
        ("x,y,0,5000", r"found '5000'. Allowed: a number of sensible size, up to 1000"),
        ("x,y,0,abc", r"found 'abc'"),
        ("x,y,0,", r"found ''.*Leave out the row of a reading that was not taken"),
        ("x,y,0,1_000", r"found '1_000'"),
        ("x,y,0,\u0661", r"column value_mm"),
        ('x,y,0,"0,1"', r"Replace the decimal comma by a point"),
        (
            "x,y,0,0,1",
            r"5 fields. Allowed: 4 fields as in the header. With decimal commas",
        ),
        ("x,y,0", r"3 fields"),
        ("x,y,400,0.1", r"less than the leg length"),
        ("x,y,-310.25,0.1", r"less than the leg length"),
        ('x,y,0,"0.1', r"line 3: found unexpected end of data"),
    ],
)
def test_bad_rows(tmp_path: Path, row: str, message: str) -> None:
    with pytest.raises(RecordError, match=message):
        read(tmp_path, f"{HEADER}\nx,y,0,0.1\n{row}\n")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"header: found nothing"),
        (HEADER + "\n", r"no row of readings"),
        ("leg,axis,value_mm\nx,y,0\n", r"Missing: displacement_mm"),
        (HEADER + ",leg\nx,y,0,0,x\n", r"'leg' twice"),
        (b"leg,axis\xff\n", r"not UTF-8 text\. Save it as UTF-8"),
    ],
)
def test_bad_tables(tmp_path: Path, text: str | bytes, message: str) -> None:
    with pytest.raises(RecordError, match=message):
        read(tmp_path, text)


@pytest.mark.parametrize(
    ("columns", "values", "message"),
    [
        ("seq", ["1", "3"], r"column seq: found '3'. Allowed: 2"),
        ("seq", ["1", "1"], r"column seq: found '1'. Allowed: 2"),
        ("seq", ["7", "8"], r"column seq: found '7'. Allowed: 1"),
        ("seq", ["1", ""], r"column seq"),
        ("cycle", ["1", "1.5"], r"column cycle: found '1.5'. Allowed: a whole number"),
        ("averaged", ["1", "0"], r"column averaged: found '0'"),
        ("averaged", ["1", "99999999999999999999"], r"column averaged"),
        ("station", ["0.5", "1.2"], r"column station: found '1.2'"),
        ("temperature_c", ["20", "warm"], r"column temperature_c: found 'warm'"),
    ],
)
def test_bad_optional_columns(
    tmp_path: Path, columns: str, values: list[str], message: str
) -> None:
    rows = "".join(f"x,y,{60 * k},0.1,{value}\n" for k, value in enumerate(values))
    with pytest.raises(RecordError, match=message):
        read(tmp_path, f"{HEADER},{columns}\n{rows}")


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"read_back_2_mm": ""}, "column read_back_2_mm: found ''. Allowed: filled in as the"),
        ({"moved_in": "work"}, "column moved_in: found 'work'. Allowed: tool or joint"),
        ({"from_1_mm": "nan"}, "column from_1_mm: found 'nan'"),
        ({"feed_mm_min": "0"}, "feed_mm_min"),
        ({"commanded_3_mm": "1e8"}, "readings of sensible size"),
    ],
)
def test_how_a_machine_was_moved_is_all_there_or_refused(
    tmp_path: Path, changed: dict[str, str], message: str
) -> None:
    complete = dict.fromkeys(MOVED, "1.5") | {"moved_by": "linuxcnc", "moved_in": "tool"}

    def of(cells: dict[str, str]) -> tuple[tuple[Reading, ...], tuple[str, ...]]:
        table = f"{HEADER},{','.join(MOVED)}\nx,y,0,0.1,{','.join(cells.values())}\n"
        return read(tmp_path, table)

    (row,), unknown = of(complete)
    assert row.moved is not None
    assert unknown == ()
    assert of(dict.fromkeys(MOVED, ""))[0][0].moved is None
    with pytest.raises(RecordError, match=message):
        of(complete | changed)


def test_one_mounting_is_in_one_place(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match=r"'m' already is leg x, axis y"):
        read(tmp_path, f"{HEADER},mount\nx,y,0,0.1,m\ny,x,0,0.1,m\n")
    with pytest.raises(RecordError, match="a new name: 'm") as problem:
        read(
            tmp_path,
            f"{HEADER},mount\n" + "".join(f"{leg},0,0.1,{'m' * 5000}\n" for leg in ("x,y", "y,x")),
        )
    assert len(str(problem.value)) < 700  # as long as other refusals


def german(text: str) -> str:
    return text.replace(",", ";").replace(".", ",")


def test_semicolons_and_decimal_commas_are_the_same_table(tmp_path: Path) -> None:
    table = f"{HEADER},station\nx,y,0,0.10,0.5\nx,y,-59.5,-1.25,0.5\n"
    plain, _ = read(tmp_path, table)
    commas, _ = read(tmp_path, german(table))
    assert [r.model_dump(exclude={"at"}) for r in commas] == [
        r.model_dump(exclude={"at"}) for r in plain
    ]
    assert commas[0].text == "0.10", "the record is the same everywhere"
    points, _ = read(tmp_path, table.replace(",", ";"))
    assert [r.value_mm for r in points] == [r.value_mm for r in plain]


def test_a_minus_of_a_word_processor_is_told(tmp_path: Path) -> None:
    """It looks like a hyphen: "found '−60'. Allowed: a finite number" says nothing."""
    with pytest.raises(RecordError, match=r"found '−60'.*Write minus as -"):
        read(tmp_path, f"{HEADER}\nx,y,0,0.1\nx,y,−60,0.2\n")


def test_empty_columns_of_a_spreadsheet_are_none(tmp_path: Path) -> None:
    """Two at the end were "'' twice", one was kept under no name."""
    table = f"{HEADER}\nx,y,0,0.10\nx,y,-59.5,-1.25\n"
    plain, _ = read(tmp_path, table)
    for end in (",", ",,"):
        wide, unknown = read(tmp_path, table.replace("\n", f"{end}\n") + ",,,,,,\n")
        assert not unknown
        assert [r.value_mm for r in wide] == [r.value_mm for r in plain]
    with pytest.raises(RecordError, match="found 6 fields"):
        read(tmp_path, table.replace("\n", ",\n").replace("0.10,", "0.10,,a note"))
    _, unknown = read(tmp_path, f"leg,,{HEADER[4:]}\nx,,y,0,0.10\nx,,y,60,0.20\n")
    assert unknown == ("column 2",)


@pytest.mark.parametrize("odd", ["1.234", "1.234,5", "0,1,2", ",", "1,5e", "0,1 "])
def test_one_decimal_mark_in_a_table(tmp_path: Path, odd: str) -> None:
    table = f"{german(HEADER)}\nx;y;0;0,10\nx;y;60;{odd}\n"
    if odd.strip() == "0,1":
        assert read(tmp_path, table)[0][1].value_mm == 0.1
        return
    with pytest.raises(RecordError, match="a finite number with a decimal comma, as in other rows"):
        read(tmp_path, table)


def workbook_of(path: Path, rows: Sequence[Sequence[object]]) -> Path:
    book = openpyxl.Workbook()
    for row in rows:
        book.active.append(row)
    book.create_sheet("notes").append(["not read"])
    book.save(path)
    return path


def test_a_workbook_is_the_same_table(tmp_path: Path) -> None:
    header = [*HEADER.split(","), "weather"]
    rows: list[list[object]] = [
        ["x", "y", 0, 0.1 + 0.2, "rain"],
        [None] * 5,
        ["x", "y", -59.5, -1e-05],
    ]
    readings, unknown = read_table(workbook_of(tmp_path / "t.XLSX", [header, *rows]))
    assert [(r.displacement_mm, r.value_mm) for r in readings] == [(0.0, 0.3), (-59.5, -1e-05)]
    assert readings[0].text == "0.3", "as the spreadsheet shows it"
    assert [r.extra for r in readings] == [{"weather": "rain"}, {"weather": ""}]
    assert unknown == ("weather",)


@pytest.mark.parametrize(
    ("cell", "message"),
    [
        (None, r"line 3, column value_mm: found ''"),
        ("0,1", r"found '0,1'.*decimal point"),
        (True, r"found 'True'"),
        (datetime(2026, 1, 2), r"found '2026-01-02"),
        ("=1+1", r"found ''"),
        (1e300, r"sensible size"),
    ],
)
def test_bad_cells_of_a_workbook(tmp_path: Path, cell: object, message: str) -> None:
    rows: list[list[object]] = [[*HEADER.split(",")], ["x", "y", 0, 0.1], ["x", "y", 60, cell]]
    with pytest.raises(RecordError, match=message):
        read_table(workbook_of(tmp_path / "t.xlsx", rows))


def test_workbooks_that_are_none_and_one_that_is_too_large_unpacked(tmp_path: Path) -> None:
    path = tmp_path / "t.xlsx"
    for content in (b"", GOOD.encode(), b"PK\x03\x04"):
        path.write_bytes(content)
        with pytest.raises(RecordError, match=r"t\.xlsx: no readable workbook\. Save"):
            read_table(path)
    with ZipFile(path, "w", ZIP_DEFLATED) as packed, packed.open("xl/workbook.xml", "w") as part:
        for _ in range(MOST_UNPACKED_BYTES // 10_000_000 + 1):
            part.write(b" " * 10_000_000)
    assert path.stat().st_size < 1_000_000
    with pytest.raises(RecordError, match="no readable workbook"):
        read_table(path)


def test_a_workbook_without_openpyxl(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = workbook_of(tmp_path / "t.xlsx", [HEADER.split(",")])
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    with pytest.raises(UsageError, match=r'pip install "openpyxl>=3.1", or save the table as CSV'):
        read_table(path)


@pytest.mark.parametrize("suffix", [".csv", ".xlsx"])
@pytest.mark.parametrize("machine", ["orthoglide", "linear-delta"])
def test_a_template_that_was_filled_in_holds_every_reading(
    tmp_path: Path, suffix: str, machine: str
) -> None:
    machine_read = load_machine(machine)
    geometry, path = machine_read.geometry(), tmp_path / f"t{suffix}"
    procedure = load_procedure(machine_read.usual_procedure, geometry)
    empty = empty_table(procedure, geometry, path)
    path.write_bytes(empty.encode() if isinstance(empty, str) else empty)
    with pytest.raises(RecordError, match="line 2, column value_mm: found ''"):
        read_table(path, machine)
    if isinstance(empty, str):
        path.write_text(re.sub(r",$", ",0.125", empty, flags=re.M), encoding="utf-8")
    else:
        book = openpyxl.load_workbook(path)
        for row in book.active.iter_rows(min_row=2):
            row[-1].value = 0.125
        book.save(path)
    readings, unknown = read_table(path, machine)
    steps = procedure.steps(geometry)
    expected = [
        (s.leg, axis, s.displacement_mm, s.position_mm, s.cycle, s.station)
        for s in steps
        for axis in s.axes
    ]
    values = [
        (r.leg, r.axis, r.displacement_mm, r.position_mm, r.cycle, r.station) for r in readings
    ]
    assert values == expected
    assert {r.value_mm for r in readings} == {0.125}
    assert unknown == ()


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="No such file"):
        read_table(tmp_path / "none.csv")


NUMBERS_AS_TYPED = st.floats(-500.0, 500.0).map(lambda v: f"{v:.4f}")
CELLS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(allow_nan=False, allow_infinity=False),
    st.text(st.characters(min_codepoint=32, exclude_categories=["Cs", "Cc", "Cn"]), max_size=8),
    st.sampled_from(["x", "y", "z", "0,5", "1.5", "1;5", "=1/0", "#DIV/0!"]),
)


@LONG
@settings(deadline=None)
@given(st.lists(st.tuples(NUMBERS_AS_TYPED, NUMBERS_AS_TYPED), min_size=1, max_size=8))
def test_points_commas_and_workbooks_say_the_same(
    tmp_path_factory: pytest.TempPathFactory, pairs: list[tuple[str, str]]
) -> None:
    folder = tmp_path_factory.getbasetemp()
    text = "\n".join([HEADER, *(f"x,y,{float(at) / 5:.4f},{value}" for at, value in pairs)])
    (folder / "point.csv").write_text(text, encoding="utf-8")
    (folder / "comma.csv").write_text(german(text), encoding="utf-8")
    rows = [line.split(",") for line in text.split("\n")]
    numbers = [[*row[:2], *map(float, row[2:])] for row in rows[1:]]
    workbook_of(folder / "cells.xlsx", [rows[0], *numbers])
    names = ("point.csv", "comma.csv", "cells.xlsx")
    point, comma, cells = (
        [(r.displacement_mm, r.value_mm) for r in read_table(folder / name)[0]] for name in names
    )
    assert point == comma == cells


@LONG
@settings(deadline=None)
@given(st.lists(st.lists(CELLS, max_size=6), max_size=5))
def test_any_cells_give_readings_or_a_record_error(
    tmp_path_factory: pytest.TempPathFactory, rows: list[list[object]]
) -> None:
    path = tmp_path_factory.getbasetemp() / "fuzz.xlsx"
    workbook_of(path, [HEADER.split(","), *rows])
    try:
        readings, _ = read_table(path)
    except RecordError:
        return
    assert all(abs(r.value_mm) < 1e9 for r in readings)


@LONG
@settings(deadline=None)
@given(st.lists(st.integers(0, 5000), max_size=6), st.binary(max_size=6))
def test_a_spoilt_workbook_is_refused_in_a_sentence(
    tmp_path_factory: pytest.TempPathFactory, places: list[int], replacement: bytes
) -> None:
    path = tmp_path_factory.getbasetemp() / "spoilt.xlsx"
    content = bytearray(workbook_of(path, [HEADER.split(","), ["x", "y", 0, 0.1]]).read_bytes())
    for at, byte in zip(places, replacement, strict=False):
        content[at % len(content)] = byte
    path.write_bytes(content)
    try:
        readings, _ = read_table(path)
    except RecordError:
        return
    assert all(abs(r.value_mm) < 1e9 for r in readings)


@given(st.sampled_from([HEADER, german(HEADER)]), st.binary(max_size=300))
def test_any_bytes_give_readings_or_a_record_error(
    tmp_path_factory: pytest.TempPathFactory, header: str, content: bytes
) -> None:
    path = tmp_path_factory.getbasetemp() / "fuzz.csv"
    path.write_bytes(header.encode() + b"\n" + content)
    try:
        readings, _ = read_table(path)
    except RecordError:
        return
    assert all(abs(r.value_mm) < 1e9 for r in readings)
