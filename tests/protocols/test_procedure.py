"""Procedures: step lists, limits, files of one's own."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest

from calib.orthoglide.geometry import Geometry
from protocols.errors import RecordError, UsageError
from protocols.procedure import load_procedure, procedure_names

FILE = """
schema = "glidecal.procedure/1"
name = "mine"
title = "t"
cycles = 2
levels = ["zero", {level}]
"""


def test_standard_procedure_is_sixty_readings_on_six_mountings() -> None:
    steps = load_procedure("zero-max-min", Geometry()).steps(Geometry())
    assert len(steps) == 30
    assert sum(len(step.axes) for step in steps) == 60
    assert len({(step.leg, axis) for step in steps for axis in step.axes}) == 6
    assert [step.displacement_mm for step in steps[:10]] == [0, 60, -100] * 3 + [0]
    assert [step.cycle for step in steps[:10]] == [1] * 3 + [2] * 3 + [3] * 4


def test_one_indicator_measures_each_leg_twice() -> None:
    steps = load_procedure("zero-max-min", Geometry()).steps(Geometry(), ("xyz",))
    assert len(steps) == 60
    assert {step.axes for step in steps if step.leg == "y"} == {("x",), ("z",)}


@pytest.mark.parametrize("name", procedure_names())
def test_every_procedure_respects_the_limits_and_returns_to_zero(name: str) -> None:
    procedure = load_procedure(name, Geometry())
    steps = procedure.steps(Geometry())
    assert all(-100.0 <= step.displacement_mm <= 60.0 for step in steps)
    assert steps[-1].displacement_mm == 0.0
    assert [step.number for step in steps] == list(range(1, len(steps) + 1))
    assert procedure.duration_s(Geometry()) == len(steps) * procedure.seconds_per_step


def test_reapproach_in_a_sweep_comes_from_both_sides() -> None:
    steps = [s for s in load_procedure("sweep", Geometry()).steps(Geometry()) if s.leg == "x"]
    before = {
        (a.displacement_mm < b.displacement_mm)
        for a, b in itertools.pairwise(steps)
        if b.displacement_mm == 22.0
    }
    assert before == {True, False}


def test_unknown_name_lists_what_exists() -> None:
    with pytest.raises(UsageError, match="zero-max-min"):
        load_procedure("zero-min", Geometry())


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (FILE.format(level="80.0"), r"level: found 80 mm. Allowed: the joint limits"),
        (FILE.format(level='"top"'), r"levels"),
        (FILE.format(level="1.0") + "speed = 3\n", r"speed"),
        (FILE.format(level="1.0").replace("cycles = 2", "cycles = 0"), r"cycles"),
        (FILE.format(level="1.0").replace("cycles = 2", 'cycles = "2"'), r"cycles"),
        ("levels = [", r"TOML"),
        (FILE.format(level="1.0").replace("procedure/1", "procedure/2"), r"schema"),
    ],
)
def test_bad_procedure_files(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(RecordError, match=said):
        load_procedure(str(path), Geometry()).steps(Geometry())


def test_a_file_of_ones_own(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(FILE.format(level="12"))
    assert [
        s.displacement_mm for s in load_procedure(str(path), Geometry()).steps(Geometry())[:3]
    ] == [
        0,
        12,
        0,
    ]
