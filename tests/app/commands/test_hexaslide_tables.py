"""Tables of postures on the command line: templates, units, and what is wrong in one."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from app.evaluating.hexaslide_calibration import calibrate_file
from app.measuring.hexaslide import import_postures
from calib.errors import RecordError
from protocols.hexaslide_session import read_postures
from tests.app.cli import glidecal, refused
from tests.app.commands.posture_sessions import IMPORT, Rows, opened, simulated, table, write


@pytest.fixture(scope="module")
def pose(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulated(tmp_path_factory.mktemp("pose") / "pose.jsonl", "pose-forward", 5)


def test_the_template_is_filled_in_and_imported(pose: Path, tmp_path: Path) -> None:
    """The values of a session through a table are those of the session."""
    empty, filled, out = (tmp_path / name for name in ("empty.csv", "t.csv", "s.jsonl"))
    import_run = glidecal(*IMPORT, "pose-forward", "--template", empty)
    assert import_run.status == 0, import_run.err
    way, *lines = empty.read_text("utf-8").splitlines()
    assert way == "# Come to the first posture with all sliders going up: play goes by it."
    blank = list(csv.reader(lines))
    rows = table(filled, pose)
    assert blank[:2] == rows[:2]
    assert [row[1:7] for row in blank[2:]] == [
        [f"{float(cell):.4f}" for cell in row[1:7]] for row in rows[2:]
    ], "the sliders stand where they are sent to"
    run = glidecal(*IMPORT, "pose-forward", filled, "-o", out)
    assert run.status == 0, run.err
    assert "16 postures written" in run.err
    assert glidecal("validate", out).status == 0
    first, second = (calibrate_file(path, None, 0.0) for path in (pose, out))
    assert first.fit.parameters == pytest.approx(second.fit.parameters, abs=1e-12)
    document = json.loads(glidecal("replay", out, "--json").out)
    assert (document["schema"], len(document["readings"])) == ("glidecal.hexaslide-replay/1", 16)
    assert document["origin"] == "imported"


def test_units_stand_in_the_second_row(pose: Path, tmp_path: Path) -> None:
    rows = table(tmp_path / "t.csv", pose)
    rows[1] = ["", *["m"] * 6, "m", "m", "mm", "rad", "mrad", "deg"]
    for row in rows[2:]:
        row[1:9] = [repr(float(cell) / 1000.0) for cell in row[1:9]]
        row[10] = repr(float(np.radians(float(row[10]))))
        row[11] = repr(1000.0 * float(np.radians(float(row[11]))))
    write(tmp_path / "t.csv", rows)
    session, odd = import_postures(tmp_path / "t.csv", tmp_path / "s.jsonl", opened("pose-forward"))
    assert odd == ()
    original, _ = read_postures(pose)
    for reading, origin in zip(session.readings, original.readings, strict=True):
        assert reading.sliders_mm == pytest.approx(origin.sliders_mm, rel=1e-12)
        assert reading.values == pytest.approx(origin.values, rel=1e-12)


def test_rows_that_were_copied_are_named(pose: Path, tmp_path: Path) -> None:
    """All counted twice the noise looks smaller by the root of two: nobody reads so often alike."""
    rows = table(tmp_path / "t.csv", pose)
    write(tmp_path / "t.csv", [*rows, *rows[2:], rows[4]])
    session, odd = import_postures(tmp_path / "t.csv", tmp_path / "s.jsonl", opened("pose-forward"))
    assert len(session.readings) == 33
    assert odd == (
        "lines with all numbers of an earlier one: 19, 20, 21, 22, 23, 24, 25, 26 …; each is used "
        "as a reading of its own",
    )


def test_a_table_has_a_posture_or_more(pose: Path, tmp_path: Path) -> None:
    rows = table(tmp_path / "t.csv", pose)
    path = tmp_path / "s.jsonl"
    write(tmp_path / "t.csv", rows[:3])
    assert len(import_postures(tmp_path / "t.csv", path, opened("pose-forward"))[0].readings) == 1
    write(tmp_path / "t.csv", rows[:2])
    with pytest.raises(RecordError, match=r"2 rows\. Allowed: a header, units, and postures"):
        import_postures(tmp_path / "t.csv", path, opened("pose-forward"))


def _cell(line: int, column: int, text: str) -> Callable[[Rows], None]:
    def change(rows: Rows) -> None:
        rows[line - 1][column] = text

    return change


def _seventh(rows: Rows) -> None:
    for number, row in enumerate(rows):
        row.append(["slider7", "mm"][number] if number < 2 else "1.0")


def _two_without_a_name(rows: Rows) -> None:
    for number, row in enumerate(rows):
        row += ["", ""] if number < 2 else ["1.0", "2.0"]


def _no_column(rows: Rows) -> None:
    for row in rows:
        del row[6]


def _no_units(rows: Rows) -> None:
    del rows[1]


OFF_MM = np.array([100.0, 2000.0, -300.0])


def _other_frame(rows: Rows) -> None:
    turn = Rotation.from_euler("xyz", [10.0, -20.0, 35.0], degrees=True)
    for row in rows[2:]:
        place = turn.apply([float(cell) for cell in row[7:10]]) + OFF_MM
        row[7:10] = map(repr, place.tolist())


def _exchanged(rows: Rows) -> None:
    for row in rows[2:]:
        row[2], row[5] = row[5], row[2]


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (_cell(2, 8, "in"), ["line 2, column y", "found in.", "Allowed: mm or m"]),
        (_cell(2, 11, "mm"), ["line 2, column psi", "deg or rad or mrad"]),
        (_no_units, ["line 2, column slider1", "where the unit is expected"]),
        (_no_column, ["line 1, column slider6", "no such column"]),
        (_seventh, ["line 1, column slider7", "more than the 6"]),
        (_two_without_a_name, ["line 3: found 15 cells", "13, one a column"]),
        (_cell(1, 8, "x"), ["line 1, column x: found twice"]),
        (_cell(4, 9, "nan"), ["line 4, column z", "found nan", "a number"]),
        (_cell(5, 9, "1,5"), ["line 5, column z", "Write decimals with a point"]),
        (_cell(5, 9, ""), ["line 5, column z", "an empty cell"]),
        (_cell(6, 3, "1400"), ["line 6, column slider3", "0 to 1050 mm"]),
        (_cell(7, 7, "9e9"), ["line 7, column x", "up to 100000"]),
        (_cell(7, 8, "1234.5"), ["line 7, column y: found 1234.5 mm. Allowed: what"]),
        (_cell(7, 11, "-9.5"), ["line 7, column psi", "order than Ry(theta) Rx(psi) Rz(phi)"]),
        (
            _other_frame,
            ["line 3, column", "pose of another frame", "turned by", "about (", "by (100."],
        ),
        (
            _exchanged,
            [
                "line 3, column slider1 … slider6",
                "As if: sliders 2 and 5 exchanged",
                "rows are like that",
            ],
        ),
    ],
    ids=lambda value: getattr(value, "__name__", None),
)
def test_a_wrong_table_is_one_paragraph_with_line_and_column(
    damage: Callable[[Rows], None], words: list[str], pose: Path, tmp_path: Path
) -> None:
    rows = table(tmp_path / "t.csv", pose)
    damage(rows)
    write(tmp_path / "t.csv", rows)
    message = refused(3, *IMPORT, "pose-forward", tmp_path / "t.csv", "-o", tmp_path / "s.jsonl")
    assert [part for part in words if part not in message] == [], message
    assert not (tmp_path / "s.jsonl").exists()


@pytest.mark.parametrize("decimal", [".", ","])
def test_semicolons_stand_beside_decimal_points_and_commas(
    decimal: str, pose: Path, tmp_path: Path
) -> None:
    rows = table(tmp_path / "t.csv", pose)
    names = ("plain.csv", "german.csv")
    write(tmp_path / names[0], rows)
    lines = [";".join(cell.replace(".", decimal) for cell in row) for row in rows]
    (tmp_path / names[1]).write_text("# of the tracker, by hand\n" + "\n".join(lines))
    plain, german = (
        import_postures(tmp_path / name, tmp_path / f"{name}.jsonl", opened("pose-forward"))[0]
        for name in names
    )
    assert [(r.sliders_mm, r.values) for r in german.readings] == [
        (r.sliders_mm, r.values) for r in plain.readings
    ]


def test_one_value_that_is_off_by_little_is_told_and_kept(pose: Path, tmp_path: Path) -> None:
    rows = table(tmp_path / "t.csv", pose)
    rows[4][7] = repr(float(rows[4][7]) + 10.0)
    write(tmp_path / "t.csv", rows)
    session, odd = import_postures(tmp_path / "t.csv", tmp_path / "s.jsonl", opened("pose-forward"))
    assert len(session.readings) == 16
    assert len(odd) == 1
    assert odd[0].startswith("line 5, ")


def test_one_posture_read_often_teaches_nothing(pose: Path, tmp_path: Path) -> None:
    """24 times the same, with noise: neither a calibration nor agreement."""
    rows, chance = table(tmp_path / "t.csv", pose), np.random.default_rng(3)
    turns = np.degrees(1e-5 * chance.normal(size=(24, 3)))
    places = 0.01 * chance.normal(size=(24, 3))
    again = [
        [
            *rows[2][:7],
            *(repr(float(cell) + off) for cell, off in zip(rows[2][7:], noise, strict=True)),
        ]
        for noise in np.hstack([places, turns]).tolist()
    ]
    write(tmp_path / "t.csv", [*rows[:2], *again])
    session, _ = import_postures(tmp_path / "t.csv", tmp_path / "s.jsonl", opened("pose-forward"))
    assert len(session.readings) == 24
    assert "found 1. Allowed: 9 or more" in refused(5, "solve", tmp_path / "s.jsonl")
    diagnosis = glidecal("diagnose", tmp_path / "s.jsonl").out
    assert "s.jsonl: cannot-tell" in diagnosis
    assert "0 beyond the parameters. Measure more different postures" in " ".join(diagnosis.split())


def test_the_noise_of_a_table_is_stated_beside_it(pose: Path, tmp_path: Path) -> None:
    filled, out = tmp_path / "t.csv", tmp_path / "s.jsonl"
    table(filled, pose)
    importing = (*IMPORT, "pose-forward", filled, "-o", out)
    assert "found 0 mm and 0.001°. Allowed: both 0" in refused(2, *importing, "--noise-mm", "0")
    template = (*IMPORT, "pose-forward", "--template", tmp_path / "e.csv", "--noise-deg", "0.01")
    assert "with a table to be read" in refused(2, *template)
    assert not out.exists()
    assert glidecal(*importing, "--noise-mm", "0.02").status == 0
    procedure = read_postures(out)[0].opened.procedure
    assert (procedure.noise_mm, procedure.noise_deg) == (0.02, 0.001)
    noise = json.loads(glidecal("solve", out, "--json").out)["noise"]
    assert noise["length_mm"] == pytest.approx(0.02)
