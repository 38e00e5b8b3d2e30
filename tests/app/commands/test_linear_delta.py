"""The linear delta on the command line: five commands, a plate, and what is refused."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from protocols.machine import load_machine
from protocols.machine_files import MACHINES, machine_names
from protocols.observations import to_observations
from protocols.record import read_record
from protocols.session import fold
from tests.app.cli import glidecal, refused
from tests.blind.linear_delta import Hidden, table, tool
from tests.conftest import LONG, ROOT, SAMPLES

MACHINE = ("--machine", "linear-delta")
PERFECT = Hidden()


def ran(*arguments: str | Path) -> str:
    run = glidecal(*arguments)
    assert run.status == 0, run.err
    return run.out


def imported(folder: Path, hidden: Hidden = PERFECT, seed: int = 1) -> Path:
    source, path = folder / "plate.csv", folder / "plate.jsonl"
    source.write_text(table(hidden, seed), encoding="utf-8")
    ran("import", source, "-o", path, *MACHINE, "--resolution", "0.001")
    return path


def test_identifiability_names_the_combination_that_a_plate_cannot_show() -> None:
    report = json.loads(ran("identifiability", "linear-delta", "--json"))
    assert report["machine"] == "linear-delta"
    assert report["procedure"] == "plate-rings"
    assert report["rank"] == 5
    assert "d_rho_x + d_rho_y + d_rho_z" in json.dumps(report)


@LONG
def test_simulate_then_solve_and_diagnose_agree(tmp_path: Path) -> None:
    path = tmp_path / "simulated.jsonl"
    ran("simulate", "-o", path, *MACHINE)
    text = ran("solve", path)
    assert "Tool deviations" in text
    assert "d_rho_x + d_rho_y +" in text
    assert "glidecal plan" not in text
    assert ran("diagnose", path).startswith("AGREES")


@LONG
def test_a_table_is_solved_to_the_machine_that_made_it(tmp_path: Path) -> None:
    """Offsets but for what all towers share, lengths: from independent geometry."""
    hidden = Hidden(offset_mm=(0.4, -0.3, 0.2), length_mm=(0.1, -0.15, 0.2))
    solution = json.loads(ran("solve", imported(tmp_path, hidden), "--json"))
    assert solution["subset"] == "with-tolerances"
    values = {name: entry["value"] for name, entry in solution["parameters"].items()}
    value = [values[name] for name in ("d_rho_x", "d_rho_y", "d_rho_z")]
    length = [values[name] for name in ("d_L_x", "d_L_y", "d_L_z")]
    assert np.array(value) - np.mean(value) == pytest.approx([0.3, -0.4, 0.1], abs=0.02)
    assert length == pytest.approx([0.1, -0.15, 0.2], abs=0.06)


@LONG
def test_an_effect_is_hidden_and_found_by_its_name(tmp_path: Path) -> None:
    path = tmp_path / "hidden.jsonl"
    ran("simulate", "-o", path, *MACHINE, "--effect", "backlash:y", "--size", "0.03")
    diagnosis = json.loads(ran("diagnose", path, "--json"))
    assert [effect["id"] for effect in diagnosis["effects"]] == ["backlash"]


def test_a_direction_of_one_tower_is_hidden_by_its_place(tmp_path: Path) -> None:
    """Beside the independent simulation with that tower further out, or nearer, by 0.5 mm."""
    path, size = tmp_path / "out.jsonl", 0.5
    exact = ("--scatter", "0", "--resolution", "0")
    ran("simulate", "-o", path, *MACHINE, "--effect", "axis_offset:xr", "--size", "0.5", *exact)
    readings = json.loads(ran("replay", path, "--json"))["readings"]
    values = np.array([reading["value_mm"] for reading in readings])
    at = np.array([reading["position_mm"] for reading in readings])
    out = [
        np.array([tool(Hidden(out_mm=(sign * size, 0.0, 0.0)), p, np.zeros(3))[2] for p in at])
        for sign in (1.0, -1.0)
    ]
    off = [np.abs(values - values[0] - (z - z[0])).max() for z in out]
    assert np.ptp(values) > 0.1
    assert min(off) < 1e-6
    for place in ("axis_lean:xt", "axis_lean:x"):
        name = place.replace(":", "-") + ".jsonl"
        ran("simulate", "-o", tmp_path / name, *MACHINE, "--effect", place, "--size", "2")
    wrong = refused(2, "simulate", "-o", path, *MACHINE, "--effect", "axis_offset:w")
    assert "x, y, z, all, xr, xt, yr, yt, zr, zt" in wrong


def test_a_dry_run_lists_positions_with_one_indicator() -> None:
    text = ran("run", "--dry-run", *MACHINE)
    assert "58 steps with 1 indicator" in " ".join(text.split())
    assert "2 (0, 30, 0) mm 1 G53 G0 X0.000 Y30.000 Z0.000" in " ".join(text.split())


def test_movements_of_carriages_follow_from_positions_and_lifts(tmp_path: Path) -> None:
    source, path = tmp_path / "t.csv", tmp_path / "t.jsonl"
    rows = ["0,0,0,0.1,", "50,0,0,0.2,", "0,0,0,0.1,5", "0,0,0,0.1,"]
    source.write_text("\n".join(["x_mm,y_mm,z_mm,value_mm,lift_mm", *rows]), encoding="utf-8")
    ran("import", source, "-o", path, *MACHINE)
    observations = to_observations([fold(read_record(path).events)])
    assert observations.movement.tolist() == [[0, 0, 0], [-1, 1, -1], [-1, -1, -1], [-1, -1, -1]]
    assert observations.position_mm[1].tolist() == [50.0, 0.0, 0.0]
    assert observations.station.tolist() == [0.0] * 4


def test_replay_shows_positions(tmp_path: Path) -> None:
    path = imported(tmp_path)
    document = json.loads(ran("replay", path, "--headless", "--json"))
    assert document["readings"][1]["position_mm"] == [0.0, 30.0, 0.0]
    assert "0, 30, 0" in ran("replay", path, "--headless")


@LONG
def test_what_is_held_out_of_a_plate_is_no_leg(tmp_path: Path) -> None:
    session = tmp_path / "s.jsonl"
    hiding = ("--effect", "straightness:x", "--size", "2", "-o", session)
    ran("simulate", "--machine", "linear-delta", *hiding)
    text = " ".join(ran("diagnose", session).split())
    assert "Held out (all places on one side of Zero left out at a time" in text
    assert "one side of one leg" not in text


def test_aliases_of_a_plate() -> None:
    report = json.loads(ran("diagnose", "--aliases", *MACHINE, "--json"))
    ids = {effect["id"] for effect in report["effects"]}
    assert {"axis_offset", "actuator_scale", "backlash", "gauge_tilt"} <= ids
    assert not {"leg_taper", "leg_bow"} & ids


def test_a_machine_file_says_by_its_schema_of_what_kind_it_is(tmp_path: Path) -> None:
    drives, slides = tmp_path / "drives.toml", tmp_path / "slides.toml"
    for name, path in (("linear-delta", drives), ("hexaslide-h60", slides)):
        path.write_bytes((MACHINES / f"{name}.toml").read_bytes())
    arguments = ("identifiability", "orthoglide", "--machine-file", drives)
    text = ran(*arguments)
    assert text.startswith("linear-delta, plate-rings")  # not the name it was asked by
    assert "tool.\nWEAK" in text  # no empty line where no single set-up helps
    of_pose = ("--procedure", "pose-inverse", "--json")
    by_name = ran("identifiability", "hexaslide", "--machine-file", slides, *of_pose)
    assert ran("identifiability", slides, *of_pose) == by_name
    assert "no glidecal workspace for a hexaslide" in refused(2, "workspace", slides)
    assert "one machine file" in refused(2, "identifiability", drives, "--machine-file", slides)


def test_bad_files_end_with_the_documented_status(tmp_path: Path) -> None:
    path, out = tmp_path / "mine.toml", ("-o", tmp_path / "s.jsonl")
    path.write_text('schema = "glidecal.other/1"\n', encoding="utf-8")
    assert "another kind of machine" in refused(3, "simulate", *out, "--machine", path)
    assert "another kind of machine" in refused(3, "identifiability", path)
    path.write_text('schema = "glidecal.hexaslide/1"\n', encoding="utf-8")
    arguments = ("identifiability", "linear-delta", "--machine-file", path)
    assert "another kind of machine" in refused(3, *arguments)
    firmware = SAMPLES / "printer" / "printer.cfg"
    importing = f"glidecal import {firmware} -o first.jsonl --machine-file-out printer.toml"
    assert importing in refused(3, "simulate", *out, "--machine", firmware)
    path.write_text("[printer]\nkinematics: delta\n", encoding="utf-8")
    assert "import" not in refused(3, "simulate", *out, "--machine", path)  # whatever else it is
    source = tmp_path / "t.csv"
    source.write_text("x_mm,y_mm,z_mm,value_mm\n0,0,0,0\n400,0,0,0\n", encoding="utf-8")
    assert "the bars reach" in refused(3, "import", source, *out, *MACHINE)


@LONG
def test_a_demonstration_on_this_machine(tmp_path: Path) -> None:
    text = ran("demo", "--headless", *MACHINE, "--folder", tmp_path / "demo")
    before, after = re.findall(r"Tool deviations went from ([\d.]+) to ([\d.]+) mm", text)[0]
    assert float(after) < 0.1 * float(before)


def test_what_a_delta_does_not_do_yet_is_said_in_one_sentence(tmp_path: Path) -> None:
    out = ("-o", tmp_path / "s.jsonl")
    assert "of leg x" in refused(3, "run", *MACHINE, "--dry-run", "--protocol", "sweep")
    assert "at one Zero" in refused(2, "align", *MACHINE, "--simulated", *out)
    arguments = ("linear-delta", "--procedure", "plate-rings", "--count", "9")
    assert "optimum postures" in refused(2, "postures", *arguments)
    effect = ("--effect", "leg_taper")
    assert "nothing to see" in refused(2, "simulate", *MACHINE, *effect, *out)


def test_unknown_machines_are_named_with_those_that_are() -> None:
    for arguments in (("identifiability", "deltoid"), ("run", "--dry-run", "--machine", "deltoid")):
        message = refused(2, *arguments)
        assert "'deltoid'" in message
        assert "linear-delta" in message


def test_the_program_knows_no_machine_of_the_family_by_name() -> None:
    """Only the machine's own package and its file; the registry finds it."""
    assert machine_names() == ("linear-delta", "orthoglide")
    assert load_machine("linear-delta").name == "linear-delta"
    rooms = [ROOT / room for room in ("app", "protocols", "drivers", "calib")]
    code = [path for room in rooms for path in room.rglob("*.py")]
    naming = [p for p in code if re.search(r"\bdelta\b", p.read_text("utf-8"), re.IGNORECASE)]
    assert {p.relative_to(ROOT).parts[:2] for p in naming} <= {("calib", "tripod")}


def verified(folder: Path, before: Hidden, after: Hidden) -> dict[str, str]:
    """What ``verify`` says of each joint offset, of two plates of these machines."""
    (folder / "before").mkdir(parents=True)
    (folder / "after").mkdir()
    paths = imported(folder / "before", before), imported(folder / "after", after, seed=2)
    run = glidecal("verify", *paths, "--json")
    assert run.status == 7, "no tolerance is stated, so nothing is decided"
    report = json.loads(run.out)
    return {offset["name"]: offset["entered"] for offset in report["offsets"]}


@LONG
def test_offsets_that_were_not_entered_are_seen_on_a_plate(tmp_path: Path) -> None:
    """What all towers share is not known by 1 mm; each less that is, by hundredths."""
    off = Hidden(offset_mm=(0.4, -0.5, 0.1))
    entries = verified(tmp_path / "none", off, off)
    assert {entries[f"d_rho_{leg}"] for leg in "xyz"} == {"not entered"}
    entered = verified(tmp_path / "right", off, PERFECT)
    assert {entered[f"d_rho_{leg}"] for leg in "xyz"} == {"as expected"}
    turned = verified(tmp_path / "wrong", off, Hidden(offset_mm=(0.8, -1.0, 0.2)))
    assert "as expected" not in {turned[f"d_rho_{leg}"] for leg in "xyz"}
