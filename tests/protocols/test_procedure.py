"""Procedures: step lists, limits, files of one's own."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest
from pydantic import ValidationError

from calib.errors import RecordError, UsageError
from calib.tripod.geometry import Geometry
from protocols.machine import load_machine
from protocols.procedure import Procedure, guided_procedure_names, load_procedure

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


@pytest.mark.parametrize("name", guided_procedure_names(Geometry()))
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
    ("text", "message"),
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
def test_bad_procedure_files(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(RecordError, match=message):
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


def procedure(**changes: object) -> Procedure:
    fields: dict[str, object] = {
        "schema": "glidecal.procedure/1",
        "name": "mine",
        "title": "t",
        "cycles": 6,
        "levels": ("zero", "max", "min", 10.0, -20.0),
        "order": "free",
    }
    return Procedure.model_validate(fields | changes)


def visits(plan: Procedure) -> dict[tuple[str, int], list[float]]:
    """Displacements of each leg and cycle, without the return at the end of a leg."""
    levels: dict[tuple[str, int], list[float]] = {}
    for step in plan.steps(Geometry()):
        levels.setdefault((step.leg, step.cycle), []).append(step.displacement_mm)
    for leg in plan.legs:
        if plan.return_to_zero:
            assert levels[leg, plan.cycles].pop() == 0.0
    return levels


@pytest.mark.parametrize("seed", [0, 1, 7, 12345])
def test_a_shuffled_cycle_has_zero_first_and_every_level_once(seed: int) -> None:
    plain, mixed = visits(procedure()), visits(procedure(random_seed=seed))
    assert plain.keys() == mixed.keys()
    for place, order in mixed.items():
        assert order[0] == 0.0
        assert sorted(order) == sorted(plain[place]) == [-100.0, -20.0, 0.0, 10.0, 60.0]
    assert len({tuple(order) for order in mixed.values()}) > len(mixed) / 2


def test_a_seed_gives_its_own_order_again() -> None:
    assert visits(procedure(random_seed=3)) == visits(procedure(random_seed=3))
    assert visits(procedure(random_seed=3)) != visits(procedure(random_seed=4))


def test_both_axes_of_one_indicator_see_the_same_shuffled_order() -> None:
    steps = procedure(random_seed=3).steps(Geometry(), ("xyz",))
    on_x = {
        axis: [s.displacement_mm for s in steps if s.leg == "x" and s.axes == (axis,)]
        for axis in ("y", "z")
    }
    assert on_x["y"] == on_x["z"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"order": "fixed", "random_seed": 1}, "random_seed: the order of this procedure is"),
        ({"levels": ("zero", 0.0)}, "levels: one posture only"),
        ({"levels": (5.0, 5.0)}, "levels: one posture only"),
        ({"levels": ("zero", 5.0, 5.0)}, 'order = "free": a level is there twice'),
        ({"legs": ("x", "y", "x")}, "one of them twice"),
        ({"stations": (0.5, 0.5)}, "one of them twice"),
        ({"random_seed": -1}, "random_seed"),
        ({"stations": tuple(k / 1000 for k in range(1, 1000))}, "steps; up to 20000"),
        ({"window_s": 0.0}, "window_s"),
        ({"tolerance_mm": 0.0}, "tolerance_mm"),
        ({"repeat_limit_mm": 0.0}, "repeat_limit_mm"),
    ],
)
def test_procedures_without_sense_are_refused(changes: dict[str, object], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        procedure(**changes)


def test_zero_comes_before_cycles_that_do_not_begin_with_it() -> None:
    plan = procedure(levels=("max", "min"), cycles=2, legs=("y",))
    assert [s.displacement_mm for s in plan.steps(Geometry())] == [0, 60, -100, 0, 60, -100, 0]
    bare = procedure(levels=("max", "min"), cycles=2, legs=("y",), return_to_zero=False)
    assert [s.displacement_mm for s in bare.steps(Geometry())] == [60, -100] * 2


def test_readings_in_place_are_counted() -> None:
    assert procedure().repeats_in_place(Geometry()) == 0
    ends_at_zero = procedure(order="fixed", levels=("zero", "max", "zero"), cycles=2, legs=("x",))
    assert [s.displacement_mm for s in ends_at_zero.steps(Geometry())] == [0, 60, 0, 0, 60, 0, 0]
    assert ends_at_zero.repeats_in_place(Geometry()) == 2


def test_verification_visits_what_calibration_did_not() -> None:
    displacements_mm = {s.displacement_mm for s in load("zero-max-min").steps(Geometry())}
    verified = {s.displacement_mm for s in load("verify").steps(Geometry())}
    assert verified - displacements_mm == {30.0, -50.0}
    assert displacements_mm < verified


def load(name: str) -> Procedure:
    return load_procedure(name, Geometry())


MANY_LINES = """
schema = "glidecal.procedure/1"
name = "mine"       # levels = [1, 2]
title = "t"
cycles = 2
levels = [          # a comment, with [brackets]
  "zero", 10.0,
  # 999.0,
  {level},
]
"""


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (MANY_LINES.format(level="80.0"), "line 9, level: found 80 mm"),
        (MANY_LINES.format(level="-100.5"), r"line 9, level: found -100\.5 mm"),
        (MANY_LINES.format(level='"top"'), r"line 9, levels\.2"),
        (MANY_LINES.format(level="1.0").replace("cycles = 2", "cycles = 0"), "line 5, cycles"),
        (MANY_LINES.format(level="1.0") + "speed = 3\n", "line 11, speed"),
        (MANY_LINES.format(level="1.0") + 'order = "any"\n', "line 11, order"),
    ],
)
def test_errors_in_files_name_their_line_on_load(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(RecordError, match=message):
        load_procedure(str(path), Geometry())


def test_limits_are_those_of_the_machine_at_hand(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(MANY_LINES.format(level="58.0"), encoding="utf-8")
    assert load_procedure(str(path), Geometry()).levels[2] == 58.0
    with pytest.raises(RecordError, match=r"line 9, level: found 58 mm.*-100 … 50 mm"):
        load_procedure(str(path), Geometry(travel_max_mm=50.0))


def test_a_machine_is_offered_what_it_can_measure() -> None:
    zero_procedures = "zero-max-min", "zero-max-min-plane"
    legs = ("align", "plane", "sweep", "two-station", "verify", *zero_procedures, "zero-min-max")
    assert guided_procedure_names(Geometry()) == legs
    assert guided_procedure_names(load_machine("linear-delta").geometry()) == (
        "bars",
        "plate-rings",
    )
    short = Geometry(travel_max_mm=10.0)  # the levels of the sweep go further
    assert "sweep" not in guided_procedure_names(short)


@pytest.mark.parametrize(
    ("axes", "found"), [(("xy", "y"), "@xy and @y"), (("x",), "@x"), ((), "none")]
)
def test_indicators_that_cannot_read_over_a_plane_are_named(
    axes: tuple[str, ...], found: str
) -> None:
    plane = load_procedure("plane", Geometry())
    with pytest.raises(UsageError, match=rf"found {found}\. Allowed: one along z, over the plane"):
        list(plane.steps(Geometry(), axes))
