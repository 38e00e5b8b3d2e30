"""Machines of three drives as files, plates as procedures, tables of positions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib.errors import RecordError, UsageError
from protocols.machine import Machine, load_machine
from protocols.motion import tool_mm
from protocols.observations import to_observations
from protocols.procedure import Procedure, Step, load_procedure
from protocols.session import Opened, Reading, fold
from tests.builders import read_table
from tests.tripods import DELTA, ORTHOGLIDE

RINGS = load_procedure("plate-rings", DELTA)


def places(steps: tuple[Step, ...]) -> list[tuple[float, float, float] | None]:
    return [step.position_mm for step in steps]


def test_the_middle_and_three_rings_in_every_cycle() -> None:
    steps = RINGS.steps(DELTA)
    assert len(steps) == 3 * 19 + 1
    assert places(steps)[:3] == [(0.0, 0.0, 0.0), (0.0, 30.0, 0.0), (-25.981, 15.0, 0.0)]
    assert {(step.leg, step.axes, step.displacement_mm) for step in steps} == {
        ("tool", ("z",), 0.0)
    }
    assert [step.cycle for step in steps if step.position_mm == (0.0, 0.0, 0.0)] == [1, 2, 3, 3]
    assert steps[0].posture(DELTA) == "ZERO"
    assert steps[1].posture(DELTA) == "(0, 30, 0) mm"


def test_heights_and_positions_of_ones_own_after_the_rings() -> None:
    plate = {"radii_mm": [10.0], "points": 2, "heights_mm": [0.0, 5.0], "axis": "x"}
    mine = Procedure.model_validate_json(
        json(plate | {"positions_mm": [[1.0, 2.0, 3.0]]}), strict=True
    )
    assert mine.plate is not None
    assert mine.plate.places_mm() == [
        (0.0, 0.0, 10.0),
        (0.0, 0.0, -10.0),
        (5.0, 0.0, 10.0),
        (5.0, 0.0, -10.0),
        (1.0, 2.0, 3.0),
    ]


def json(plate: object) -> str:
    from json import dumps

    head = {"schema": "glidecal.procedure/1", "name": "m", "title": "m", "cycles": 1}
    return dumps(head | {"plate": plate})


def test_a_shuffled_plate_keeps_its_places() -> None:
    mixed = Procedure.model_validate(RINGS.model_dump() | {"random_seed": 3}).steps(DELTA)
    assert places(mixed) != places(RINGS.steps(DELTA))
    assert set(places(mixed)) == set(places(RINGS.steps(DELTA)))


SHORT = load_machine("linear-delta").model_copy(
    update={"leg_length_mm": 190.0, "workspace_mm": None}
)
"""Towers are 215 mm apart: no bar lies along its drive without leaving another one behind."""


def test_legs_of_a_machine_whose_bars_never_lie_along_their_drives_are_not_read() -> None:
    with pytest.raises(UsageError, match="are nowhere along their drives"):
        load_procedure("bars", SHORT.geometry())  # before a screen opens
    with pytest.raises(UsageError, match="are nowhere along their drives"):
        load_procedure("sweep", ORTHOGLIDE).steps(SHORT.geometry())
    assert load_procedure("sweep", ORTHOGLIDE).steps(ORTHOGLIDE)


def test_bars_of_towers_are_read_where_each_is_upright() -> None:
    """The tool is then under the joint of the carriage, and goes up from there."""
    steps = load_procedure("bars", DELTA).steps(DELTA)
    assert {(step.leg, step.displacement_mm) for step in steps} == {
        (leg, level) for leg in "xyz" for level in (0.0, 30.0, 60.0, 90.0)
    }
    for step in steps:
        place = tool_mm(step, DELTA)
        across = (place - DELTA.anchors["xyz".index(step.leg)])[:2]
        assert np.abs(across).max() < 1e-9
        assert place[2] == pytest.approx(step.displacement_mm, abs=1e-9)


def test_levels_that_bars_do_not_reach_are_named() -> None:
    with pytest.raises(RecordError, match=r"240 mm of leg x.*that the bars of every leg reach"):
        load_procedure("zero-max-min", DELTA)


def test_a_record_with_legs_of_a_machine_that_has_none_to_read_is_refused() -> None:
    machine = SHORT
    opened = Opened(program="t", origin="imported", machine=machine)
    reading = Reading(
        reading=1, leg="x", axis="y", displacement_mm=0.0, value_mm=0.0, text="0", mount="xy"
    )
    with pytest.raises(RecordError, match="whose bar is nowhere along its drive"):
        to_observations([fold([opened, reading])])


def test_a_machine_with_its_drives_written_out_is_the_same() -> None:
    """Old files say nothing of drives; written out they give the very same geometry."""
    plain = Machine()
    drives = [{"origin_mm": [0, 0, 0], "direction": d} for d in ([2, 0, 0], [0, 1, 0], [0, 0, 1])]
    from json import dumps

    assert Machine.model_validate_json(dumps({"drive": drives})).geometry() == plain.geometry()
    assert "drive" not in plain.model_dump_json(exclude_none=True)


HEADER = "x_mm,y_mm,z_mm,value_mm"
DRIVE = "[[drive]]\norigin_mm = [{}]\ndirection = [{}]\n"


def drives(*pairs: tuple[str, str], extra: str = "") -> str:
    text = 'schema = "glidecal.machine/1"\nleg_length_mm = 250.0\n' + extra
    return text + "".join(DRIVE.format(*pair) for pair in pairs)


UP = "0.0, 0.0, 1.0"
FRONT, BACK = "-100.0, -60.0, 0.0", "0.0, 120.0, 0.0"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (drives((FRONT, "0.0, 0.0, 0.0"), (BACK, UP), (BACK, UP)), "not of length 0"),
        (drives((FRONT, UP), (BACK, UP), (BACK, UP)), "singular posture at Zero"),
        (drives((FRONT, UP), ("300.0, 0.0, 0.0", UP), (BACK, UP)), "too short at Zero"),
        (drives((FRONT, UP), (BACK, UP)), "drive"),
        ('schema = "glidecal.hexaslide/1"\n', "another kind of machine"),
        (drives((FRONT, UP), extra="tower = 1\n"), r"tower: .*machine-1\.json lists the 4\d keys"),
        (drives((FRONT, UP), extra="leg_lenght_mm = 1.0\n"), "Keys like these: leg_length_mm"),
    ],
)
def test_machine_files_that_cannot_be(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(RecordError, match=message):
        load_machine(path)


def test_what_is_wrong_with_a_machine_as_a_whole_is_said_in_full(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(drives((FRONT, UP), ("300.0, 0.0, 0.0", UP), (BACK, UP)), encoding="utf-8")
    with pytest.raises(RecordError) as caught:
        load_machine(path)
    assert str(caught.value) == (
        f"machine file {path}: bar y: found 250 mm long, too short at Zero. Allowed: more than "
        "300 mm, the distance from the platform's joint to the line of the drive. Check the bar's "
        "length, the drive's origin and direction, and the platform."
    )


@pytest.mark.parametrize(
    ("table_text", "message"),
    [
        (f"{HEADER}\n0,0,0,0\n400,0,0,0\n", "the bars reach"),
        ("x_mm,y_mm,value_mm\n0,0,0\n", "Missing: z_mm"),
        (f"{HEADER},lift_mm\n0,0,0,0,-1\n", "lifted off"),
        (f"{HEADER},axis\n0,0,0,0,w\n", "x, y or z"),
    ],
)
def test_tables_that_cannot_be_imported(tmp_path: Path, table_text: str, message: str) -> None:
    source = tmp_path / "t.csv"
    source.write_text(table_text, encoding="utf-8")
    with pytest.raises(RecordError, match=message):
        read_table(source, "linear-delta")


def plate(extra: str = "", radii: str = "[0.0, 30.0]") -> str:
    return (
        'schema = "glidecal.procedure/1"\nname = "own"\ntitle = "own"\ncycles = 1\n'
        f"{extra}\n[plate]\nradii_mm = {radii}\n"
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (plate('levels = ["zero", "max"]'), "levels and plate"),
        (plate(radii="[0.0]"), "one position only"),
        (plate(radii="[0.0, 118.0]"), "within the joint limits"),
        (plate(radii="[0.0, 400.0]"), "within the joint limits"),
    ],
)
def test_plates_that_cannot_be_measured(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "own.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(RecordError, match=message):
        load_procedure(str(path), DELTA)
