"""Ways of a machine that moves itself, and what the record of its moves means for readings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.errors import RecordError
from calib.tripod.geometry import Geometry
from protocols.journal import write_whole
from protocols.machine import Instrument, Machine, MotionLimits, load_machine
from protocols.motion import (
    approach_sign,
    box_mm,
    came_from,
    commanded_mm,
    departure_mm,
    movement_signs,
    moves_mm,
    seconds_per_step,
    way_mm,
)
from protocols.observations import to_observations
from protocols.procedure import Procedure, load_procedure
from protocols.record import read_record
from protocols.session import Mounted, Moved, Opened, Reading, fold
from protocols.table import opened_table

L = 310.25
TOOL = Machine()
JOINT = Machine(mdi="joint")
DELTA = load_machine("linear-delta")
PLATE = load_procedure("plate-rings", DELTA.geometry())


def orthoglide(name: str) -> Procedure:
    return load_procedure(name, Geometry())


def moved(mode: str, start: object, to: object, there: object) -> Moved:
    positions = {"from_mm": start, "commanded_mm": to, "read_back_mm": there}
    return Moved.model_validate(
        {"driver": "linuxcnc", "coordinates": mode, "feed_mm_min": 1500.0} | positions
    )


def test_a_leg_is_told_along_its_axis_or_in_joints() -> None:
    step = next(s for s in orthoglide("zero-max-min").steps(Geometry()) if s.displacement_mm == 60)
    assert commanded_mm(step, TOOL) == (60.0, 0.0, 0.0)
    across = np.sqrt(L**2 - 60.0**2)  # papers/000, section 2.4
    assert commanded_mm(step, JOINT) == pytest.approx((L + 60.0, across, across), abs=1e-9)


def test_a_set_up_begins_from_below_and_goes_on_straight() -> None:
    procedure = orthoglide("zero-max-min")
    first, second = procedure.steps(Geometry())[:2]
    assert came_from(first, procedure.steps(Geometry())) is None
    assert way_mm(first, None, procedure, TOOL) == [(-10.0, 0.0, 0.0), (0.0, 0.0, 0.0)]
    assert way_mm(second, first, procedure, TOOL) == [commanded_mm(second, TOOL)]


def test_after_a_break_the_way_is_that_of_the_procedure() -> None:
    procedure = orthoglide("two-station")
    steps = procedure.steps(Geometry())
    down = next(s for s in steps[1:] if s.displacement_mm < steps[s.number - 2].displacement_mm)
    before = came_from(down, steps)
    assert before is not None
    assert before.displacement_mm > down.displacement_mm


def test_a_tool_that_lifts_off_does_so_at_both_ends() -> None:
    procedure = PLATE.model_copy(
        update={"plate": PLATE.plate.model_copy(update={"lift_mm": 2.0})} if PLATE.plate else {}
    )
    first, second = procedure.steps(DELTA.geometry())[:2]
    tool_drive = DELTA.model_copy(update={"mdi": "tool"})
    assert [z for _, _, z in way_mm(first, None, procedure, tool_drive)] == [2.0, 0.0]
    assert [z for _, _, z in way_mm(second, first, procedure, tool_drive)] == [2.0, 2.0, 0.0]


def test_a_pre_roll_beyond_the_joint_limits_is_refused() -> None:
    machine = Machine(motion=MotionLimits(preroll_mm=150.0))
    procedure = orthoglide("zero-max-min")
    with pytest.raises(RecordError, match="preroll_mm"):
        way_mm(procedure.steps(Geometry())[0], None, procedure, machine)


def test_lengths_of_ways() -> None:
    ways = [[(-10.0, 0.0, 0.0), (0.0, 0.0, 0.0)], [(0.0, 30.0, 40.0)]]
    assert moves_mm(ways) == [10.0, 50.0]


def test_the_box_is_that_of_the_joint_limits_or_of_the_file() -> None:
    assert box_mm(TOOL) == ((-100.0,) * 3, (60.0,) * 3)
    assert box_mm(JOINT) == ((L - 100.0,) * 3, (L + 60.0,) * 3)
    stated = MotionLimits(low_mm=(-50.0,) * 3, high_mm=(50.0,) * 3)
    assert box_mm(Machine(motion=stated)) == ((-50.0,) * 3, (50.0,) * 3)
    delta = DELTA.model_copy(update={"mdi": "tool"})
    with pytest.raises(RecordError, match="low_mm"):
        box_mm(delta)


@pytest.mark.parametrize(
    "motion",
    [
        {"feed_mm_min": 0.0},
        {"feed_mm_min": 7000.0},  # above fastest_feed_mm_min
        {"longest_mm": -1.0},
        {"low_mm": [0.0, 0.0, 0.0]},
        {"low_mm": [0.0, 0.0, 0.0], "high_mm": [1.0, 0.0, 1.0]},
    ],
)
def test_limits_that_make_no_sense(motion: dict[str, object], tmp_path: Path) -> None:
    path = tmp_path / "machine.toml"
    lines = "".join(f"{key} = {value}\n" for key, value in motion.items())
    path.write_text(f'schema = "glidecal.machine/1"\n[motion]\n{lines}')
    with pytest.raises(RecordError, match="motion"):
        load_machine(path)


@given(
    st.tuples(*(st.floats(-60.0, 50.0),) * 3),
    st.tuples(*(st.floats(-0.01, 0.01),) * 3),
)
def test_joints_that_are_read_back_tell_where_the_tool_is(
    tool: tuple[float, float, float], off: tuple[float, float, float]
) -> None:
    """Foot of bar i on axis i, of length L: each joint is the far root of its sphere."""

    def joints(at: np.ndarray) -> tuple[float, ...]:
        square = [sum(at[k] ** 2 for k in range(3) if k != i) for i in range(3)]
        return tuple(float(at[i] + np.sqrt(L**2 - square[i])) for i in range(3))

    target, there = np.array(tool), np.array(tool) + np.array(off)
    movement = moved("joint", joints(target), joints(target), joints(there))
    assert departure_mm(movement, Geometry()) == pytest.approx(off, abs=1e-9)


def test_directions() -> None:
    up = moved("tool", (-10.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert approach_sign(up, "x", Geometry()) == 1.0
    assert approach_sign(up, "y", Geometry()) == 0.0
    assert movement_signs(up, Geometry()).tolist() == [1.0, 1.0, 1.0]  # others come up to Zero


def session(path: Path, off_mm: float) -> Path:
    """Two postures of leg x, its tool ``off_mm`` too far along y in the second, as read back."""
    opened = Opened(
        program="test",
        origin="measured",
        machine=TOOL,
        procedure=orthoglide("zero-max-min"),
        instruments=(Instrument(profile="mitutoyo-01a"),) * 2,
    )
    targets = [(-10.0, 0.0, 0.0), (0.0, 0.0, 0.0), (60.0, 0.0, 0.0)]
    back = [(0.0, 0.0, 0.0), (60.0, off_mm, 0.0)]
    part = 0.5 - 60.0 / L  # where the indicator, which stands still, touches the bar at Max
    values = [0.0, (1.0 - part) * off_mm]
    readings = [
        Reading(
            reading=k + 1,
            leg="x",
            axis="y",
            displacement_mm=targets[k + 1][0],
            value_mm=values[k],
            text=f"{values[k]:.6f}",
            mount="xy",
            moved=moved("tool", targets[k], targets[k + 1], back[k]),
        )
        for k in range(2)
    ]
    mounted = Mounted(leg="x", station=0.5, mounts={"y": "xy"})
    write_whole(path, opened, [mounted, *readings])
    return path


def test_the_position_read_back_enters_in_place_of_the_command(tmp_path: Path) -> None:
    """The bar turns about its foot, so the reading is the tool's departure less its share.

    The foot of leg x stays where it is (its own coordinate changes in second order only).
    """
    recorded = fold(read_record(session(tmp_path / "a.jsonl", 0.01)).events)
    table = tmp_path / "a.csv"
    table.write_text(str(recorded.table().file_content("csv")), encoding="utf-8")
    opened, events, _ = opened_table(table, TOOL, "test")
    for sample in (recorded, fold([opened, *events])):
        observations = to_observations([sample])
        assert observations.displacement_mm.tolist() == [
            0.0,
            60.0,
        ]  # still one posture with its repeats
        assert observations.value_mm == pytest.approx([0.0, 0.0], abs=1e-6)
        assert observations.approach.tolist() == [1.0, 1.0]  # the first, too


def test_a_machine_that_stands_where_it_was_sent_is_read_as_it_is(tmp_path: Path) -> None:
    observations = to_observations([fold(read_record(session(tmp_path / "a.jsonl", 0.0)).events)])
    assert observations.value_mm.tolist() == [0.0, 0.0]


def test_a_step_takes_its_way_and_its_rest_where_the_machine_moves_itself() -> None:
    procedure = orthoglide("zero-max-min")
    assert seconds_per_step(TOOL, procedure) == 20.0  # by hand
    moving = Machine(motion=MotionLimits(feed_mm_min=3000.0))
    # a leg: 10 mm of pre-roll, then three times 60 + 160 + 100 mm, ten steps; to the pre-roll of
    # the next leg 10 mm beside Zero
    way_mm_whole = 3 * (10.0 + 3 * 320.0) + 2 * 10.0
    by_hand = way_mm_whole / 50.0 / 30.0 + procedure.window_s
    assert seconds_per_step(moving, procedure) == pytest.approx(by_hand, abs=1e-9)
