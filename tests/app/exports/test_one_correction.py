"""One correction: what is shown first, printed, judged and written has the same numbers."""

from __future__ import annotations

import csv
import json
import re
import sys
import threading
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from app.evaluating.correction import ControllerCorrections
from app.evaluating.solution import SessionSolution, judge, solve_files
from app.report.schema.document import to_json
from app.report.schema.solution import SolutionReport
from app.report.text.glance import glance_text
from app.report.text.result import solution_text
from calib.posterior.correction import Holds
from calib.posterior.tool import FRAMES
from protocols.machine import Frame, load_machine
from protocols.model_file import read_model_file
from tests.app.cli import glidecal
from tests.app.report.certificates import report_of
from tests.blind.corrections import sessions
from tests.conftest import LONG, first_quick

MACHINES: dict[str, tuple[str, ...]] = {
    "play": ("--protocol", "two-station", "--effect", "backlash:y", "--size", "0.06"),
    "nothing": ("--protocol", "two-station"),
    "tilt": ("--protocol", "two-station", "--effect", "axis_squareness:xy", "--size", "2"),
    "sag": ("--protocol", "two-station", "--effect", "gravity_sag:x", "--size", "0.3"),
    "few": ("--protocol", "zero-max-min", "--effect", "straightness:x", "--size", "0.1"),
    "delta": ("--effect", "backlash:y", "--size", "0.04"),
}
"""Options of simulated machines with hidden errors."""

OFFSETS = {"d_rho_x": 0.8, "d_rho_y": -1.3, "d_rho_z": 0.4}
OF_DELTA = {"d_rho_x": 0.3, "d_rho_y": -0.4, "d_rho_z": 0.1}
INI = "[TRAJ]\nLINEAR_UNITS = mm\n" + "".join(
    f"[JOINT_{n}]\nHOME_OFFSET = {300 + n}\nHOME_LATCH_VEL = -1\nHOME_ABSOLUTE_ENCODER = 1\n"
    for n in range(3)
)


@pytest.fixture(scope="module", params=first_quick(MACHINES))
def session(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session of a machine with offsets and what its name says."""
    offsets = OF_DELTA if request.param == "delta" else OFFSETS
    return simulated(tmp_path_factory.mktemp(request.param), MACHINES[request.param], offsets)


def simulated(folder: Path, options: tuple[str, ...], offsets: dict[str, float]) -> Path:
    path, hidden = folder / "s.jsonl", folder / "truth.json"
    machine = load_machine("linear-delta" if offsets is OF_DELTA else None)
    document = {
        "schema": "glidecal.model/1",
        "machine": machine.model_dump(mode="json", by_alias=True),
        "parameters_mm": offsets,
    }
    hidden.write_text(json.dumps(document))
    run = glidecal("simulate", *options, "--model", hidden, "--seed", "3", "-o", path)
    assert run.status == 0, run.err
    return path


def shown_first(text: str) -> dict[str, float]:
    """Names and values of the first table of a text."""
    (table,) = [part for part in text.split("\n\n") if part.strip().startswith("enter ")]
    rows = [line.split() for line in table.splitlines()[2:]]
    return {" ".join(row[:-3]): float(row[-3]) for row in rows}


@cache
def solved_for(
    session: Path, holds: Holds = "offsets", frame: Frame | None = None
) -> SessionSolution:
    return solve_files([session], holds=holds, frame=frame).work_out()


def answered(session: Path, holds: Holds = "offsets", frame: Frame | None = None) -> dict[str, Any]:
    """``correction`` as solve --json has it."""
    document = SolutionReport.of(solved_for(session, holds, frame), None, None, None)
    correction: dict[str, Any] = json.loads(to_json(document))["correction"]
    return correction


def exported(session: Path, out: Path, *options: str | Path) -> Path:
    run = glidecal("export", session, *options, "-o", out)
    assert run.status == 0, run.err
    return out


@LONG
def test_every_number_that_is_shown_first_is_written(session: Path, tmp_path: Path) -> None:
    correction = answered(session)
    values = {name: entry["value"] for name, entry in correction["values"].items()}
    assert list(values) == ["d_rho_x", "d_rho_y", "d_rho_z"]
    document = json.loads(exported(session, tmp_path / "j", "--format", "json").read_text())
    assert {name: entry["value"] for name, entry in document["parameters"].items()} == values
    lines = exported(session, tmp_path / "c", "--format", "csv").read_text().splitlines()
    rows = csv.DictReader(line for line in lines if not line.startswith("#"))
    rounded = {name: round(value, 6) for name, value in values.items()}
    assert {row["parameter"]: float(row["value_mm"]) for row in rows} == rounded
    result = solved_for(session)
    on_screen = glance_text(result, None, (), 76, exports=True, measures=True)
    for text in (solution_text(result), on_screen):
        assert shown_first(text) == {name: round(value, 4) for name, value in values.items()}
    report = report_of([session])
    (section,) = [s for s in report.sections if s.heading == "What to enter in the controller"]
    table = next(part for part in section.parts if not isinstance(part, str))
    added = [float(cell) for cell in table.columns[2].cells]  # type: ignore[union-attr,arg-type]
    assert added == [round(value, 4) for value in values.values()]


def test_one_bound_is_shown_judged_and_written(session: Path, tmp_path: Path) -> None:
    correction = answered(session)
    bound, now = correction["bound"]["touched_off_mm"], correction["bound_now"]["touched_off_mm"]
    text = " ".join(solution_text(solved_for(session)).split())
    match = re.search(r"touched off: a shift is free ([\d.]+) ([\d.]+) ", text)
    assert match is not None
    assert (float(match[1]), float(match[2])) == pytest.approx((now, bound), abs=5e-4)
    (line, *_) = json.loads(exported(session, tmp_path / "o", "--format", "json").read_text())[
        "cautions"
    ]
    assert f"at most {match[1]} mm now, at most {match[2]} mm with these values" in line
    for tolerance, decision in ((1.001 * bound, "pass"), (0.999 * bound, "undecided")):
        assert judge(solved_for(session), tolerance).after == decision


def test_what_more_a_controller_holds_is_written_too(session: Path, tmp_path: Path) -> None:
    """The kinematics as a model; tables through joints, homed by encoders that meet nothing."""
    correction = answered(session, "kinematics")
    path = exported(session, tmp_path / "m.json", "--format", "model")
    model, values = read_model_file(path), correction["values"]
    sizes = {
        f"{effect.id} {effect.where}: {entry.of or name}": entry.value
        for effect in model.effects
        for name, entry in effect.parameters.items()
    }
    parameters = {name: mm for name, mm in model.parameters_mm.items() if mm}
    assert parameters | sizes == {name: entry["value"] for name, entry in values.items()}
    bounds = {
        alternative["holds"]: alternative["bound_mm"] for alternative in answered(session)["others"]
    }
    assert bounds["kinematics"] == correction["bound"]["touched_off_mm"]
    assert glidecal("simulate", "--model", path, "-o", tmp_path / "again.jsonl").status == 0
    (tmp_path / "m.ini").write_text(INI)
    out = exported(session, tmp_path / "l", "--format", "linuxcnc", "--ini", tmp_path / "m.ini")
    values = answered(session, "tables")["values"]
    for n, leg in enumerate("xyz"):
        text = (out / f"calib_joint{n}.inc").read_text()
        home = float(text.rpartition("HOME_OFFSET = ")[2].split()[0])
        assert home == pytest.approx(300 + n + values[f"d_rho_{leg}"]["value"], abs=1e-6)
        play = values.get(f"backlash {leg}: play", {"value": 0.0})["value"]
        if "COMP_FILE" not in text:
            assert ("BACKLASH" in text) == (play > 1e-6)  # less is none
        if "BACKLASH = " in text:
            value = float(text.rpartition("BACKLASH = ")[2].split()[0])
            assert value == pytest.approx(play, abs=2e-4)


@pytest.fixture(scope="module")
def play(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulated(tmp_path_factory.mktemp("play"), MACHINES["play"], OFFSETS)


@pytest.fixture(scope="module")
def tilt(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulated(tmp_path_factory.mktemp("tilt"), MACHINES["tilt"], OFFSETS)


def test_what_a_format_cannot_hold_is_in_its_bound_and_named(play: Path, tmp_path: Path) -> None:
    """Play in a file of three offsets: no silence, and not the bound of a table."""
    offsets, tables = answered(play), answered(play, "tables")
    assert offsets["bound"]["touched_off_mm"] > 3.0 * tables["bound"]["touched_off_mm"]
    assert tables["values"]["backlash y: play"]["value"] == pytest.approx(0.06, abs=0.005)
    cautions = json.loads(exported(play, tmp_path / "o", "--format", "json").read_text())
    gain = next(line for line in cautions["cautions"] if line.startswith("Other exports"))
    by_tables = next(
        alternative["bound_mm"]
        for alternative in offsets["others"]
        if alternative["holds"] == "tables"
    )
    assert f"a table of each joint (linuxcnc) at most {by_tables:.4f} mm" in gain
    run = glidecal("export", play, "--format", "linuxcnc", "-o", tmp_path / "l")
    assert run.status == 0
    message = " ".join(run.err.split())
    assert "Left out: " in message
    assert "play of y" in message
    assert "states how the joints home" in message


@LONG
def test_the_frame_changes_the_values_and_stands_beside_them(tilt: Path, tmp_path: Path) -> None:
    """Two axes out of square: offsets that serve a workpiece that is aligned are others."""
    machine, aligned = (answered(tilt, frame=frame) for frame in FRAMES[:0:-1])
    assert (machine["frame"], aligned["frame"]) == ("machine", "aligned")
    entered = [answer["values"]["d_rho_x"]["value"] for answer in (machine, aligned)]
    assert abs(entered[0] - entered[1]) > 0.05
    key = "aligned_mm"
    assert aligned["bound"][key] < machine["bound"][key]
    options = ("--format", "json", "--frame", "aligned")
    document = json.loads(exported(tilt, tmp_path / "o", *options).read_text())
    assert document["parameters"]["d_rho_x"]["value"] == entered[1]
    assert "with these values, for an aligned workpiece;" in document["cautions"][0]


@LONG
def test_the_frame_of_the_machine_file_is_taken(tilt: Path, tmp_path: Path) -> None:
    record = tmp_path / "aligned.jsonl"
    machine = tmp_path / "m.toml"
    machine.write_text('schema = "glidecal.machine/1"\nframe = "aligned"\n')
    table = tmp_path / "t.csv"
    options = ("--table", "readings", "--format", "csv", "-o", table)
    assert glidecal("export", tilt, *options).status == 0
    assert glidecal("import", table, "--machine", machine, "-o", record).status == 0
    assert answered(record)["frame"] == "aligned"
    assert answered(record)["values"] == answered(record, frame="aligned")["values"]


@LONG
def test_an_adopted_effect_is_in_the_correction_once(play: Path, tmp_path: Path) -> None:
    """With a model that has the play, the play is its size: not twice, and not left out."""
    model = tmp_path / "m.json"
    assert glidecal("diagnose", play, "--adopt", model).status == 0
    run = glidecal("solve", play, "--model", model, "--holds", "tables", "--json")
    correction = json.loads(run.out)["correction"]
    plain = answered(play, "tables")
    for name in ("backlash y: play", "d_rho_x", "d_rho_y"):
        pair = correction["values"][name]["value"], plain["values"][name]["value"]
        assert pair[0] == pytest.approx(pair[1], abs=0.003)
    by_offsets = next(
        alternative["bound_mm"]
        for alternative in correction["others"]
        if alternative["holds"] == "offsets"
    )
    assert by_offsets == pytest.approx(answered(play)["bound"]["touched_off_mm"], rel=0.1)
    assert by_offsets > 3.0 * correction["bound"]["touched_off_mm"]


def test_a_set_that_is_asked_for_is_written_as_it_is_identified(tilt: Path, tmp_path: Path) -> None:
    """With its own bound, which is not smaller than that of the correction."""
    options = ("--subset", "joint-offsets")
    result = json.loads(glidecal("solve", tilt, *options, "--json").out)
    out = exported(tilt, tmp_path / "o", *options, "--format", "json")
    document = json.loads(out.read_text())
    for name, parameter in result["parameters"].items():
        assert document["parameters"][name]["value"] == parameter["value"]
    assert document["cautions"][1].startswith("NOTE: the set joint-offsets is written as")
    bound = re.search(r"at most ([\d.]+) mm with these values", document["cautions"][0])
    assert bound is not None
    assert float(bound[1]) >= round(result["correction"]["bound"]["touched_off_mm"], 3) - 5e-4


def test_sessions_of_one_machine_are_corrected_together(samples: Path) -> None:
    pair = [samples / f"simulated_zero-{order}.jsonl" for order in ("max-min", "min-max")]
    result = solve_files(pair)
    assert [len(cells.means) > 0 for cells in result.corrections.posterior.sessions] == [True, True]
    less_lengths_mm = (0.83, -1.27, 0.39)  # legs show d_rho - d_L
    offsets_mm = result.correction.model.parameters_mm[:3]
    assert offsets_mm == pytest.approx(less_lengths_mm, abs=0.015)


@LONG
def test_an_export_without_its_parts_is_not_recommended_beside_itself(tmp_path: Path) -> None:
    """Without an INI file nobody knows how the joints home: play is left out."""
    path = simulated(tmp_path, MACHINES["play"], OFFSETS)
    run = glidecal("export", path, "--format", "linuxcnc-kins", "-o", tmp_path / "k")
    others = " ".join(run.err.split()).partition("Other exports for this controller")[2]
    assert run.status == 0
    assert "this export with the parts that it leaves out at most" in others
    assert "(linuxcnc-kins)" not in others


@LONG
def test_a_likely_mistake_in_the_readings_is_named_with_the_values(tmp_path: Path) -> None:
    """A sign reversed on one mounting, by the machine and the mistakes of the blind bench."""
    ((_, hidden),) = sessions(1, 6, ["gross mistakes beside"])
    table, path = tmp_path / "table.csv", tmp_path / "s.jsonl"
    table.write_text(hidden.table, encoding="utf-8")
    run = glidecal("import", table, "-o", path)
    assert run.status == 0, run.err
    first, *_ = answered(path)["mistakes"]
    assert (first["id"], first["where"], first["title"]) == ("gauge_sign", "zy", "sign reversed")
    assert first["probability"] > 0.9
    words = " ".join(solution_text(solved_for(path)).split())
    assert "WARNING: likely a mistake in the readings" in words
    assert "sign reversed (zy), > 0.99" in words
    assert "sign reversed (zy)" in exported(path, tmp_path / "c", "--format", "csv").read_text()


def test_another_thread_may_work_out_corrections_while_it_is_asked_for_them() -> None:
    """A screen asks at every change of its size; it ended with "changed size during iteration"."""
    corrections = object.__new__(ControllerCorrections)
    made: dict[object, None] = {}
    object.__setattr__(corrections, "_corrections", made)
    interval_s = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        keys = (("offsets", (("table", f"{number}"),)) for number in range(30_000))
        worker = threading.Thread(target=lambda: made.update((key, None) for key in keys))
        worker.start()
        while worker.is_alive():
            assert not corrections.is_worked_out
        worker.join()
    finally:
        sys.setswitchinterval(interval_s)
