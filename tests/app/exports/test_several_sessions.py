"""What is entered may come from several sessions: of legs, of a plate, of one machine."""

from __future__ import annotations

import json
from itertools import permutations
from math import asin, sin, tan
from pathlib import Path
from random import Random
from typing import Any

import pytest

from tests.app.cli import glidecal, refused
from tests.conftest import LONG, ROOT

MACHINES = ROOT / "protocols" / "machines"


def simulated(folder: Path, protocol: str, machine: str = "linear-delta") -> Path:
    session = folder / f"{protocol}.jsonl"
    words = ("--machine", machine, "--protocol", protocol, "--seed", "3", "-o", session)
    assert glidecal("simulate", *words).status == 0
    return session


def document(*words: str | Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads(glidecal(*words).out)
    return content


@LONG
def test_bars_and_plate_in_one_export(tmp_path: Path) -> None:
    """Readings of bars and of the tool: the values are those of the common solution."""
    sessions = simulated(tmp_path, "bars"), simulated(tmp_path, "plate-rings")
    exported = document("export", *sessions, "--format", "json", "-o", "-")
    result = document("solve", *sessions, "--json")
    assert exported["source"] == "bars.jsonl, plate-rings.jsonl"
    for name in ("d_rho_x", "d_rho_y", "d_rho_z"):
        expected = result["correction"]["values"][name]
        parameter = exported["parameters"][name]
        for key in ("value", "standard_uncertainty", "expanded_uncertainty"):
            assert parameter[key] == pytest.approx(expected[key], abs=1e-12)
    bound = result["correction"]["bound"]["touched_off_mm"]
    assert f"at most {bound:.4f} mm with these values" in exported["cautions"][0]


def test_sessions_between_which_something_was_entered_are_refused(tmp_path: Path) -> None:
    before = simulated(tmp_path, "zero-max-min", "orthoglide")
    machine, after = tmp_path / "m.toml", tmp_path / "after.jsonl"
    machine.write_text(
        'schema = "glidecal.machine/1"\nname = "orthoglide"\nentered_offsets_mm = [0.1, 0.0, 0.0]\n'
    )
    words = ("simulate", "--machine", machine, "--seed", "3", "-o", after)
    assert glidecal(*words).status == 0
    text = refused(2, "export", before, after, "--format", "json", "-o", "-")
    assert (
        "found offsets entered between them, entered_offsets_mm (0, 0, 0) and (0.1, 0, 0)" in text
    )


def test_one_session_for_a_table_and_of_postures(tmp_path: Path, samples: Path) -> None:
    pair = samples / "experiment_2_six.jsonl", samples / "experiment_3_six.jsonl"
    text = refused(2, "export", *pair, "--format", "xlsx", "-o", tmp_path / "a.xlsx")
    assert "found 2 files. Allowed: one session, for a table" in text
    assert not (tmp_path / "a.xlsx").exists()


def imported(folder: Path, name: str, day: str, offset_mm: float) -> Path:
    """A table of a machine with one joint offset, by the twelve equations of docs/theory.md."""
    rows, noise = ["leg,axis,displacement_mm,value_mm,cycle"], Random(name)
    for cycle in (1, 2, 3):
        for leg, axis in permutations("xyz", 2):
            for moved_mm in (0.0, 60.0, -100.0):
                phi = asin(moved_mm / 310.25)
                on_leg, on_axis = (0.5 + sin(phi)) * tan(phi), sin(phi)
                read_mm = offset_mm * (on_leg * (leg == "x") + on_axis * (axis == "x"))
                read_mm += noise.gauss(0.0, 0.003)
                rows.append(f"{leg},{axis},{moved_mm},{read_mm:.3f},{cycle}")
    table, session = folder / f"{name}.csv", folder / f"{name}.jsonl"
    table.write_text("\n".join(rows) + "\n")
    assert glidecal("import", table, "--measured-on", day, "-o", session).status == 0
    return session


@LONG
def test_values_are_for_the_session_that_was_measured_last(tmp_path: Path) -> None:
    """However sessions are named: a machine that drifted is corrected as it is now."""
    now = imported(tmp_path, "a", "2026-02-01", 0.20)
    earlier = imported(tmp_path, "b", "2026-01-01", 0.10)
    for command in ("solve", "diagnose", "plan"):
        documents = [document(command, *pair, "--json") for pair in permutations((now, earlier))]
        assert documents[0] == documents[1]
        if command == "diagnose":  # bars of other lengths would look alike; a switch moves sooner
            assert documents[0]["verdict"] == "agrees"
    exported = document("export", now, earlier, "--format", "json", "-o", "-")
    assert exported["parameters"]["d_rho_x"]["value"] == pytest.approx(0.20, abs=0.02)
    assert exported["source"] == "b.jsonl, a.jsonl"


def test_switches_alone_are_no_other_geometry(tmp_path: Path) -> None:
    """New endstops of a printer move its limits of travel with them."""
    geometry = (MACHINES / "linear-delta.toml").read_text()
    pair = []
    for number, top_mm in enumerate((240.0, 240.3)):
        machine, session = tmp_path / f"{number}.toml", tmp_path / f"{number}.jsonl"
        held = geometry.replace("travel_max_mm = 240.0", f"travel_max_mm = {top_mm}")
        stops = f"position_endstop_mm = [{top_mm}, {top_mm}, {top_mm}]"
        machine.write_text(held.replace("\n[[drive]]", f"\n{stops}\n[[drive]]", 1))
        words = ("--machine", machine, "--seed", str(number), "-o", session)
        assert glidecal("simulate", *words).status == 0
        pair.append(session)
    run = glidecal("compare", *pair)
    assert run.status == 0, run.err
    assert "the firmware got other" not in " ".join(run.out.split())


def test_sessions_in_the_wrong_order_are_told_by_the_stated_days(tmp_path: Path) -> None:
    now = imported(tmp_path, "a", "2026-02-01", 0.0)
    earlier = imported(tmp_path, "b", "2026-01-01", 0.2)
    assert "is the order right?" in " ".join(glidecal("compare", now, earlier).out.split())
    assert "is the order right?" not in glidecal("compare", earlier, now).out
