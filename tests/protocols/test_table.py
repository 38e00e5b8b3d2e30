"""Tables of readings: what is accepted, and the words for what is not."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.errors import RecordError
from calib.tripod.geometry import Geometry
from protocols.events import Reading
from protocols.table import read_table

HEADER = "leg,axis,displacement_mm,value_mm"
GOOD = f"{HEADER}\nx,y,0,0.10\nx,y,60,0.25\n"


def read(tmp_path: Path, text: str | bytes) -> tuple[tuple[Reading, ...], tuple[str, ...]]:
    path = tmp_path / "t.csv"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return read_table(path, Geometry())


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


@pytest.mark.parametrize("text", [GOOD.replace("\n", "\r\n"), "\ufeff" + GOOD, GOOD + "\n,,,\n"])
def test_windows_line_ends_byte_order_mark_and_blank_rows(tmp_path: Path, text: str) -> None:
    assert len(read(tmp_path, text)[0]) == 2


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("w,y,0,0.1", r"line 3, column leg: found 'w'. Allowed: x, y or z"),
        ("x,x,0,0.1", r"column axis: found 'x'. Allowed: an axis across the leg"),
        ("x,y,0,nan", r"column value_mm: found 'nan'"),
        ("x,y,0,inf", r"column value_mm: found 'inf'"),
        ("x,y,0,1e999", r"sensible size"),
        ("x,y,0,abc", r"found 'abc'"),
        ("x,y,0,", r"found ''"),
        ("x,y,0,1_000", r"found '1_000'"),
        ("x,y,0,\u0661", r"column value_mm"),
        ('x,y,0,"0,1"', r"Replace the decimal comma by a point"),
        ("x,y,0,0,1", r"5 fields. Allowed: 4 fields as in the header. A decimal comma"),
        ("x,y,0", r"3 fields"),
        ("x,y,400,0.1", r"less than the leg length"),
        ("x,y,-310.25,0.1", r"less than the leg length"),
        ('x,y,0,"0.1', r"line 3: found unexpected end of data"),
    ],
)
def test_bad_rows(tmp_path: Path, row: str, said: str) -> None:
    with pytest.raises(RecordError, match=said):
        read(tmp_path, f"{HEADER}\nx,y,0,0.1\n{row}\n")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", r"header: found nothing"),
        (HEADER + "\n", r"no row of readings"),
        ("leg;axis;displacement_mm;value_mm\nx;y;0;0,1\n", r"semicolons"),
        ("leg,axis,value_mm\nx,y,0\n", r"Missing: displacement_mm"),
        (HEADER + ",leg\nx,y,0,0,x\n", r"'leg' twice"),
        (b"leg,axis\xff\n", r"not UTF-8 text"),
    ],
)
def test_bad_tables(tmp_path: Path, text: str | bytes, said: str) -> None:
    with pytest.raises(RecordError, match=said):
        read(tmp_path, text)


@pytest.mark.parametrize(
    ("columns", "values", "said"),
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
def test_bad_optional_columns(tmp_path: Path, columns: str, values: list[str], said: str) -> None:
    rows = "".join(f"x,y,{60 * k},0.1,{value}\n" for k, value in enumerate(values))
    with pytest.raises(RecordError, match=said):
        read(tmp_path, f"{HEADER},{columns}\n{rows}")


def test_one_mounting_is_in_one_place(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match=r"'m' already is leg x, axis y"):
        read(tmp_path, f"{HEADER},mount\nx,y,0,0.1,m\ny,x,0,0.1,m\n")


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="No such file"):
        read_table(tmp_path / "none.csv", Geometry())


@given(st.binary(max_size=300))
def test_any_bytes_give_readings_or_a_record_error(
    tmp_path_factory: pytest.TempPathFactory, content: bytes
) -> None:
    path = tmp_path_factory.getbasetemp() / "fuzz.csv"
    path.write_bytes(HEADER.encode() + b"\n" + content)
    try:
        readings, _ = read_table(path, Geometry())
    except RecordError:
        return
    assert all(abs(r.value_mm) < 1e9 for r in readings)
