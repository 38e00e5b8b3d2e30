"""``glidecal export`` of tables, and import of what it wrote."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from protocols.data_table import FORMATS
from tests.app.cli import glidecal, refused
from tests.conftest import LONG, SAMPLES

SESSION = SAMPLES / "experiment_2_six.jsonl"


def parameters(session: Path) -> object:
    return json.loads(glidecal("solve", session, "--json").out)["parameters"]


@pytest.mark.parametrize("form", FORMATS)
def test_readings_come_back_through_import(form: str, tmp_path: Path) -> None:
    table, again = tmp_path / f"r.{form}", tmp_path / "again.jsonl"
    run = glidecal("export", SESSION, "--format", form, "--table", "readings", "-o", table)
    assert run.status == 0, run.err
    options = ("--resolution", "0.01", "--repeatability", "0.01")
    assert glidecal("import", table, "-o", again, *options).status == 0
    record, was = (json.loads(glidecal("replay", path, "--json").out) for path in (again, SESSION))
    assert [r["value_mm"] for r in record["readings"]] == [r["value_mm"] for r in was["readings"]]
    assert refused(2, "export", SESSION, "--format", form, "--table", "readings", "-o", table)


@LONG
def test_differences_and_residuals_are_those_of_solve(tmp_path: Path) -> None:
    differences = json.loads(glidecal("solve", SESSION, "--json").out)["differences"]
    table = tmp_path / "d.csv"
    arguments = ("--format", "csv", "--table")
    assert glidecal("export", SESSION, *arguments, "differences", "-o", table).status == 0
    rows = list(csv.DictReader(table.read_text("utf-8").splitlines()))
    values = {row["difference"]: float(row["value_mm"]) for row in rows}
    assert values == {name: entry["value"] for name, entry in differences.items()}
    assert (
        glidecal("export", SESSION, *arguments, "residuals", "-o", tmp_path / "r.csv").status == 0
    )
    assert "residual_mm" in (tmp_path / "r.csv").read_text("utf-8").splitlines()[0]


def test_what_does_not_go_with_a_table_is_refused(tmp_path: Path) -> None:
    out = tmp_path / "t"
    table = ("export", SESSION, "--table", "readings", "-o", out)
    assert "csv, xlsx or parquet" in refused(2, *table, "--format", "json")
    assert "--home-offset" in refused(2, *table, "--format", "csv", "--home-offset", "1,2,3")
    assert not out.exists()


def test_a_session_is_not_imported_as_a_log(tmp_path: Path, samples: Path) -> None:
    """Before: with a machine file some of its contacts were read as answers of a probe."""
    printer, session, machine = samples / "printer", tmp_path / "p.jsonl", tmp_path / "p.toml"
    sources = (printer / "printer.cfg", printer / "probe.log")
    assert glidecal("import", *sources, "-o", session, "--machine-file-out", machine).status == 0
    again = tmp_path / "again.jsonl"
    message = refused(3, "import", session, "--machine", machine, "-o", again)
    assert "p.jsonl: found a session. Allowed: a table of readings" in message
    assert not again.exists()


def test_what_the_joints_hold_is_refused_with_its_limit(tmp_path: Path, samples: Path) -> None:
    session = samples / "experiment_1_six.jsonl"
    options = ("--format", "linuxcnc", "-o", tmp_path / "x", "--home-offset", "1e9,0,0")
    assert "such as '1.5,0,-2', up to 100,000" in refused(2, "export", session, *options)


def test_a_session_has_its_ending(tmp_path: Path) -> None:
    """Before: it was written, and no folder of sessions showed it."""
    hexaslide = ("--machine", "hexaslide", "--protocol", "position")
    for verb in (
        ("import", SAMPLES / "tables" / "experiment_1_six.csv"),
        ("import", SAMPLES / "hexaslide" / "before.csv", *hexaslide),
        ("simulate",),
        ("run", "--simulated", "--headless"),
        ("align", "--simulated"),
    ):
        message = refused(2, *verb, "-o", tmp_path / "s.txt")
        assert message.endswith("s.txt. Allowed: a path that ends with .jsonl.")
    assert not (tmp_path / "s.txt").exists()
