"""Input and surroundings that want a traceback and get a paragraph."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.app.cli import glidecal, refused
from tests.conftest import ROOT

EXPERIMENT = ROOT / "sample_sessions" / "experiment_2_twelve.jsonl"
TABLE = ROOT / "sample_sessions" / "tables" / "experiment_2_twelve.csv"


@pytest.mark.parametrize(
    "arguments",
    [
        ("import", TABLE, "--resolution", "inf"),
        ("import", TABLE, "--repeatability", "nan"),
        ("simulate", "--resolution", "inf"),
        ("simulate", "--scatter", "nan"),
        ("run", "--simulated", "--headless", "--temperature", "nan"),
        ("simulate", "--seed", "-1"),
    ],
)
def test_numbers_out_of_range(arguments: tuple[str | Path, ...], tmp_path: Path) -> None:
    run = glidecal(*arguments, "-o", tmp_path / "s.jsonl")
    assert run.status == 2
    assert "Traceback" not in run.err
    assert not list(tmp_path.iterdir())


def test_coarse_display_and_tiny_repeatability(tmp_path: Path) -> None:
    made = tmp_path / "s.jsonl"
    assert glidecal("simulate", "--resolution", "10", "-o", made).status == 0
    kept = tmp_path / "t.jsonl"
    assert glidecal("import", TABLE, "-o", kept, "--repeatability", "1e-300").status == 0
    assert glidecal("solve", kept).status == 0


@pytest.mark.parametrize("output", ["", ".", "/"])
def test_output_that_is_no_file(output: str, tmp_path: Path) -> None:
    refused(3, "simulate", "-o", output, cwd=tmp_path)


@pytest.mark.parametrize("text", ["x=" + "[" * 3000, "x=" + "9" * 5000, "x = 1\n" * 2])
def test_hostile_toml(text: str, tmp_path: Path) -> None:
    path = tmp_path / "m.toml"
    path.write_text(text)
    said = refused(3, "run", "--dry-run", "--machine", path)
    assert len(said) < 900


def test_messages_stay_short(tmp_path: Path) -> None:
    path = tmp_path / "m.toml"
    path.write_text("".join(f"key{n} = {n}\n" for n in range(3000)))
    said = refused(3, "run", "--dry-run", "--machine", path)
    assert "and 2997 more" in said
    assert len(said) < 900
    assert len(refused(3, "simulate", "--model", EXPERIMENT, "-o", tmp_path / "s")) < 900


def test_very_long_procedure_name(tmp_path: Path) -> None:
    refused(3, "run", "--dry-run", "--protocol", "p" * 5000 + ".toml", cwd=tmp_path)


def test_replay_without_a_terminal_opens_no_screen() -> None:
    assert "no terminal" in refused(2, "replay", EXPERIMENT)


def test_all_readings_zero_say_that_no_noise_is_seen(tmp_path: Path) -> None:
    table = tmp_path / "t.csv"
    rows = [
        f"{leg},{axis},{level},0"
        for leg in "xyz"
        for axis in "xyz"
        if axis != leg
        for level in (0, 60, -100)
    ]
    table.write_text("leg,axis,displacement_mm,value_mm\n" + "\n".join(rows) + "\n")
    assert glidecal("import", table, "-o", tmp_path / "s.jsonl").status == 0
    run = glidecal("solve", tmp_path / "s.jsonl")
    assert run.status == 0
    assert "these readings show no noise" in run.out


def test_readings_of_another_world_are_refused(tmp_path: Path) -> None:
    table = tmp_path / "t.csv"
    table.write_text(TABLE.read_text().replace("0.08", "9999"))
    assert glidecal("import", table, "-o", tmp_path / "s.jsonl").status == 0
    refused(5, "solve", tmp_path / "s.jsonl", "--method", "linear", "--subset", "both")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_standard_output_on_a_full_disk() -> None:
    with Path("/dev/full").open("w") as full:
        run = subprocess.run(
            [sys.executable, "-m", "app", "replay", "--json", EXPERIMENT],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
            timeout=60,
        )
    assert run.returncode == 3
    assert "standard output: No space left" in run.stderr
    assert "Traceback" not in run.stderr


@pytest.mark.skipif(os.name != "posix", reason="needs a POSIX pipe")
def test_reader_of_the_output_goes_away() -> None:
    read_end, write_end = os.pipe()
    os.close(read_end)
    run = subprocess.run(
        [sys.executable, "-m", "app", "solve", EXPERIMENT],
        stdout=write_end,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
        timeout=60,
    )
    os.close(write_end)
    assert run.returncode == 130
    assert "Traceback" not in run.stderr


def test_thousands_of_readings_stay_cheap(tmp_path: Path) -> None:
    """The map from readings to differences is sparse; a dense one took 2 GB here."""
    table = tmp_path / "t.csv"
    levels = [k * 0.05 - 90.0 for k in range(1000)]
    rows = [
        f"{leg},{axis},{level:.2f},{0.001 * (k % 7)}"
        for leg in "xyz"
        for axis in "xyz"
        if axis != leg
        for k, level in enumerate(levels)
    ]
    table.write_text("leg,axis,displacement_mm,value_mm\n" + "\n".join(rows) + "\n")
    made = tmp_path / "s.jsonl"
    assert glidecal("import", table, "-o", made).status == 0
    run = glidecal("solve", made, "--method", "linear")
    assert run.status == 0, run.err
