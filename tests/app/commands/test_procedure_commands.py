"""Procedures as commands show and measure them: order, files of one's own, limits."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from protocols.record import read_record
from protocols.session import fold
from tests.app.cli import glidecal, refused
from tests.conftest import LONG

OWN = """schema = "glidecal.procedure/1"
name = "own"
title = "one leg"
legs = ["y"]
cycles = 2
levels = [
  "zero",
  {level},
]
"""
MACHINE = 'schema = "glidecal.machine/1"\nname = "short travel"\ntravel_max_mm = 20.0\n'


def own(folder: Path, level: str, ending: str = "") -> Path:
    path = folder / "own.toml"
    path.write_text(OWN.format(level=level) + ending, encoding="utf-8")
    return path


def dry_run(*arguments: str | Path) -> list[tuple[str, ...]]:
    """Leg, posture and visit of every step shown: its cycle, or the end of the leg."""
    run = glidecal("run", "--dry-run", *arguments)
    assert run.status == 0, run.err
    row = r"^ *\d+ +([xyz]) +([A-Z]+|[+-][\d.]+ mm) +(\d+[a-p]?|end) "
    return re.findall(row, run.out, re.MULTILINE)


def test_a_dry_run_writes_nothing_and_shows_every_step(tmp_path: Path) -> None:
    assert dry_run("--protocol", own(tmp_path, "12.5")) == [
        ("y", "ZERO", "1"),
        ("y", "+12.5 mm", "1"),
        ("y", "ZERO", "2"),
        ("y", "+12.5 mm", "2"),
        ("y", "ZERO", "end"),
    ]
    assert [path.name for path in tmp_path.iterdir()] == ["own.toml"]


def test_verification_visits_two_displacements_of_its_own() -> None:
    steps = dry_run("--protocol", "verify")
    assert len(steps) == 33
    assert {posture for _, posture, _ in steps} == {"ZERO", "MAX", "MIN", "+30 mm", "-50 mm"}


def test_a_random_order_shuffles_the_levels_and_nothing_else() -> None:
    plain = dry_run("--protocol", "verify")
    mixed = dry_run("--protocol", "verify", "--random-order", "5")
    assert mixed == dry_run("--protocol", "verify", "--random-order", "5")
    assert mixed != plain
    assert sorted(mixed) == sorted(plain)
    zeros = [k for k, (_, posture, _) in enumerate(plain) if posture == "ZERO"]
    assert [k for k, (_, posture, _) in enumerate(mixed) if posture == "ZERO"] == zeros


@LONG
def test_a_random_order_stays_in_the_record_and_is_measured(tmp_path: Path) -> None:
    session = tmp_path / "s.jsonl"
    arguments = ("--simulated", "--headless", "--random-order", "5", "-o", session)
    run = glidecal("run", "--protocol", "verify", *arguments)
    assert run.status == 0, run.err
    postures = [posture for _, posture, _ in dry_run("--protocol", "verify", "--random-order", "5")]
    folded = fold(read_record(session).events)
    first = json.loads(session.read_text(encoding="utf-8").splitlines()[0])
    assert first["procedure"]["random_seed"] == 5
    geometry = folded.opened.machine.geometry()
    assert [step.posture(geometry) for step in folded.steps()] == postures
    assert [r.displacement_mm for r in folded.readings[::2]] == [
        step.displacement_mm for step in folded.steps()
    ]


@pytest.mark.parametrize("name", ["sweep", "zero-min-max"])
def test_an_order_with_a_purpose_is_not_shuffled(name: str, tmp_path: Path) -> None:
    output = tmp_path / "s.jsonl"
    message = refused(
        2, "run", "--simulated", "--protocol", name, "--random-order", "1", "-o", output
    )
    assert f"random order of procedure {name}" in message
    assert not output.exists()


@pytest.mark.parametrize(
    ("level", "ending", "message"),
    [
        ("80.0", "", "line 8, level: found 80 mm. Allowed: the joint limits -100 … 60 mm"),
        ("12", "random_seed = 4\n", "random_seed: the order of this procedure"),
        ("0.0", "", "levels: one posture only"),
        ("12", 'order = "odd"\n', "line 10, order"),
    ],
)
def test_bad_files_are_refused_before_anything_is_opened(
    tmp_path: Path, level: str, ending: str, message: str
) -> None:
    path = own(tmp_path, level, ending)
    output = tmp_path / "s.jsonl"
    assert message in refused(3, "run", "--simulated", "--protocol", path, "-o", output)
    assert not output.exists()


def test_limits_are_those_of_the_machine_file(tmp_path: Path) -> None:
    machine = tmp_path / "machine.toml"
    machine.write_text(MACHINE, encoding="utf-8")
    path = own(tmp_path, "25.0")
    assert len(dry_run("--protocol", path)) == 5
    message = refused(3, "run", "--dry-run", "--protocol", path, "--machine", machine)
    assert "line 8, level: found 25 mm. Allowed: the joint limits -100 … 20 mm" in message
