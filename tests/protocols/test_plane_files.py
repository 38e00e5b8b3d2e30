"""Procedures and tables of readings over a reference plane."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from app.commands.demo import run_headless
from app.measuring.demo import demo_plan
from app.measuring.simulated import planned_readings
from calib.errors import RecordError
from calib.tripod.geometry import Geometry
from protocols.machine import Machine
from protocols.procedure import Plane, load_procedure
from protocols.table import empty_table, off_bar_words
from tests.app.cli import glidecal
from tests.builders import read_table
from tests.conftest import LONG, ROOT

ALONE = load_procedure("plane", Geometry())
FILE = """schema = "glidecal.procedure/1"
name = "mine"
title = "t"
cycles = 1
[plane]
{line}
"""


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ('levels = ["zero"]', "one posture only"),
        ("stations = [0.2]", "2 or more"),
        ("stations = [0.2, 0.2]", "one of them twice"),
        (
            "stations = [0.02, 0.9]",
            "line 6, stations: found station 0.02 of leg x touched at 0.020",
        ),
        ('levels = ["zero", 80.0]', "line 6, level: found 80 mm"),
        ('axes = ["u"]', "plane.axes"),
        ("[plate]\nradii_mm = [0.0, 30.0]", "plane and plate"),
    ],
)
def test_planes_that_cannot_be_measured(tmp_path: Path, line: str, message: str) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(FILE.format(line=line))
    with pytest.raises(RecordError, match=re.escape(message)):
        load_procedure(str(path), Geometry())


def test_a_machine_whose_bars_stay_askew_has_no_such_legs(tmp_path: Path) -> None:
    """Towers stand 215 mm from each other: a bar of 212 mm is upright over no place."""
    text = (ROOT / "protocols" / "machines" / "linear-delta.toml").read_text(encoding="utf-8")
    text = re.sub("(?m)^leg_length_mm = .*", "leg_length_mm = 212.0", text)
    box = "workspace_mm = [[-20.0, -20.0, 0.0], [20.0, 20.0, 50.0]]"
    short = tmp_path / "short.toml"
    short.write_text(re.sub("(?m)^workspace_mm = .*", box, text), encoding="utf-8")
    run = glidecal("identifiability", short, "--procedure", "plane")
    assert run.status == 2
    assert "are nowhere along their drives" in " ".join(run.err.split())


def test_a_table_that_was_filled_in_is_the_procedure(tmp_path: Path) -> None:
    procedure = load_procedure("zero-max-min-plane", Geometry())
    path = tmp_path / "t.csv"
    empty = empty_table(procedure, Geometry(), path)
    assert isinstance(empty, str)
    path.write_text(re.sub(r",$", ",0.125", empty, flags=re.M), encoding="utf-8")
    readings, unknown = read_table(path)
    expected = [
        (s.leg, axis, s.station, s.displacement_mm, s.over_plane)
        for s in procedure.steps(Geometry())
        for axis in s.axes
    ]
    assert unknown == ()
    assert [
        (r.leg, r.axis, r.station, r.displacement_mm, bool(r.over_plane)) for r in readings
    ] == expected
    assert {r.mount for r in readings if r.over_plane} == {"xz-plane", "yz-plane"}
    assert off_bar_words(readings, Geometry()) == ""


HEAD = "leg,axis,station,displacement_mm,plane,mount,value_mm\n"


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("x,z,0.1,0,2,,0.1\n", "column plane: found '2'"),
        ("x,z,0.1,0,1,a,0.1\nx,z,0.9,0,0,a,0.1\n", "'a' already is leg x, axis z, over a plane"),
        ("x,z,0.1,0,1,a,0.1\ny,z,0.9,0,1,a,0.1\n", "'a' already is leg x, axis z, over a plane"),
    ],
)
def test_tables_that_cannot_be_imported(tmp_path: Path, rows: str, message: str) -> None:
    path = tmp_path / "t.csv"
    path.write_text(HEAD + rows)
    with pytest.raises(RecordError, match=re.escape(message)):
        read_table(path)


def test_a_touched_point_off_the_bar_is_told(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text(HEAD + "x,z,0.99,60,1,,0.1\nx,z,0.9,60,1,,0.1\n")
    readings, _ = read_table(path)
    assert off_bar_words(readings, Geometry()).startswith("readings off the bars: 1, ")


@LONG
def test_simulated_solved_and_what_is_refused(tmp_path: Path) -> None:
    session, q = tmp_path / "p.jsonl", tmp_path / "q.jsonl"
    assert glidecal("simulate", "--protocol", "plane", "-o", session).status == 0
    result = glidecal("solve", session)
    assert result.status == 0
    words = " ".join(result.out.split())
    assert "d_rho_x + d_L_x; d_rho_y + d_L_y" in words
    assert "z_x+@p0.1" in result.out
    linear = glidecal("solve", session, "--method", "linear", "--subset", "joint-offsets")
    assert linear.status == 0
    assert glidecal("validate", session).status == 0
    assert "this lowers the bound" in " ".join(glidecal("plan", session).out.split())
    lines = " ".join(glidecal("replay", session, "--headless").out.split())
    assert "4 x z +60.00 1 xz-plane 0.9" in lines
    assert "AGREES" in glidecal("diagnose", session).out
    hidden = glidecal(
        "simulate", "--protocol", "zero-max-min-plane", "--effect", "backlash", "-o", q
    )
    assert hidden.status == 0
    assert "backlash" in glidecal("diagnose", q).out
    assert glidecal("diagnose", "--aliases", "--procedure", "plane").status == 0
    run = glidecal("postures", "orthoglide", "--procedure", "plane", "--count", "8")
    assert run.status == 2
    assert "plane" in run.err


@LONG
def test_a_demonstration_measures_over_a_plane(tmp_path: Path) -> None:
    """As ``demo --headless``, under a fixed name: the scatter is drawn by it."""
    plan = replace(demo_plan(tmp_path, "plane", 1), path=tmp_path / "plane.jsonl")
    before, after = run_headless(plan)
    assert before.solution.rms_before_mm > 0.02
    assert after.solution.rms_before_mm < 0.003


POSTURES = st.lists(st.floats(-99.0, 59.0), min_size=2, max_size=4, unique=True)
STATIONS = st.lists(st.floats(0.01, 0.99), min_size=2, max_size=3, unique=True)


@settings(max_examples=40, deadline=None)
@given(POSTURES, STATIONS, st.floats(0.02, 0.4), st.floats(0.6, 0.98), st.floats(-90.0, 60.0))
def test_nothing_over_a_plane_is_touched_off_the_bar_or_beyond_the_plane(
    levels: list[float], stations: list[float], low: float, high: float, end: float
) -> None:
    """By where each bar is: the tool at the displacement, the foot one length ahead."""
    length, plane = 287.0, (end, end + 330.0)
    machine = Machine(leg_length_mm=length, usable_bar=(low, high), plane_mm=plane)
    fields = {"levels": tuple(levels), "stations": tuple(stations), "axes": ("x", "z")}
    procedure = ALONE.model_copy(update={"plane": Plane.model_validate(fields)})
    places = [at + s * length for at in (0.0, *levels) for s in stations]
    usable = all(low <= s <= high for s in stations)
    usable = usable and all(plane[0] <= place <= plane[1] for place in places)
    try:
        planned = planned_readings(procedure, machine)
    except RecordError:
        assert not usable
    else:
        assert usable
        assert plane[0] <= planned.along_mm.min()
        assert planned.along_mm.max() <= plane[1]
