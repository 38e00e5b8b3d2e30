"""A session that runs by itself, against a simulated controller: right readings or none."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from app.evaluating.solution import solve_files
from app.measuring import unattended
from app.measuring.demo import SelfMovingBench, demo_plan
from app.measuring.moving import REST_S, MoveProposal, Mover, ways_of
from app.measuring.opening import open_indicators, start_session
from app.measuring.simulated import BenchSettings
from app.measuring.unattended import lost_words, measure_all
from calib.errors import IndicatorError, MotionError, RecordError, UsageError
from calib.tripod.simulation import hidden_machine
from drivers.exchange import Exchange
from drivers.motion.controller import Triple
from drivers.motion.states import State
from drivers.motion.twins import LinuxCncTwin
from drivers.profile import IndicatorReading, Query
from drivers.profiles.mitutoyo_01a import MITUTOYO_01A
from protocols.machine import Machine, MotionLimits
from protocols.observations import to_observations
from protocols.procedure import Procedure, load_procedure
from protocols.record import read_record
from protocols.session import Noted, fold
from tests.app.measuring.moving_machine import (
    FAST,
    PROMPT,
    SHORT,
    SLOWER,
    linuxcnc,
    moving_session,
    taken,
    with_faults,
    wrong,
)
from tests.conftest import LONG, first_quick
from tests.drivers.motion.bench import comes_true
from tests.drivers.motion.twins import TWINS, MotionTrouble

BOTH = ("xyz", "xyz")


def arrives(mover: Mover) -> None:
    while mover.under_way:
        mover.line.alive()
        time.sleep(0.01)


@pytest.mark.parametrize("name", first_quick(TWINS))
def test_a_session_measures_itself(name: str, tmp_path: Path) -> None:
    path = tmp_path / "a.jsonl"
    questions: list[tuple[object, bool]] = []
    machine = FAST.model_copy(update={"mdi": "joint"}) if name == "grbl" else FAST
    make = TWINS[name] if name == "grbl" else linuxcnc
    with moving_session(path, machine, make=make) as (guided, bench, twin):

        def agree(proposal: MoveProposal) -> bool:
            if proposal.by_hand:
                questions.append((bench.tool_mm, bench.axes.moving))
            return bench.agree(proposal)

        measure_all(guided, agree, lambda _: None)
        readings = taken(path)
    assert read_record(path).end == "closed"
    assert len(readings) == 2 * len(guided.steps)
    assert not wrong(readings, bench)
    assert [moving for _, moving in questions] == [False] * 2  # leg x, leg y
    assert all(place == pytest.approx((0.0, 0.0, 0.0), abs=1e-9) for place, _ in questions)
    for reading in readings:
        assert reading.moved is not None
        assert reading.moved.driver == name
        assert reading.moved.read_back_mm == pytest.approx(reading.moved.commanded_mm, abs=0.001)
    first = readings[0].moved
    assert first is not None
    if name == "linuxcnc":
        assert first.from_mm == (-10.0, 0.0, 0.0)
    observations = to_observations([fold(read_record(path).events)])
    assert set(observations.approach.tolist()) == {-1.0, 1.0}  # none is unknown
    assert len(twin.moves) == len(guided.steps) + 3  # Zero once, and two pre-rolls


EVERY_KIND = (
    MotionTrouble.DIED,
    MotionTrouble.HANG_UP,
    MotionTrouble.ESTOP,
    MotionTrouble.NAK,
    MotionTrouble.FOLLOWING,
    "indicator",
)


@LONG
@pytest.mark.parametrize("seed", first_quick([1, 2]))
def test_no_fault_leaves_a_reading_of_a_wrong_posture(seed: int, tmp_path: Path) -> None:
    """Six kinds, each at a moment of its own; the seventh, a killed program, has to be started
    first: `tests/drivers/motion/test_line.py` and `tests/controller`.
    """
    kinds = EVERY_KIND[seed - 1 :: 2]
    problems, stops_s, count = with_faults(
        tmp_path / "a.jsonl", seed, 3, FAST, troubles=kinds, latest_s=0.7
    )
    assert not problems
    assert len(stops_s) == count == 3
    assert read_record(tmp_path / "a.jsonl").end == "closed"


def test_a_set_up_that_is_not_confirmed_moves_nothing_but_to_zero(tmp_path: Path) -> None:
    with moving_session(tmp_path / "a.jsonl") as (guided, _, twin):
        with pytest.raises(MotionError, match="consent: found not given"):
            measure_all(guided, lambda proposal: not proposal.by_hand, lambda _: None)
        assert len(twin.moves) == 1
        assert not taken(tmp_path / "a.jsonl")


@LONG
def test_a_session_that_broke_off_is_continued_from_the_same_side(tmp_path: Path) -> None:
    path = tmp_path / "a.jsonl"
    with moving_session(path) as (guided, bench, _):

        def break_off(message: str) -> None:
            if message.startswith("step 2 "):
                raise MotionError("the program", "killed")

        with pytest.raises(MotionError, match="killed"):
            measure_all(guided, bench.agree, break_off)
    with moving_session(path) as (guided, bench, twin):
        measure_all(guided, bench.agree, lambda _: None)
        readings = taken(path)
    assert read_record(path).end == "closed"
    assert not wrong(readings, bench)
    assert len(readings) == 2 * len(guided.steps)
    again = next(reading for reading in readings if reading.step == 3)  # Min, of a new mounting
    assert again.mount == "xy#2"
    assert again.moved is not None
    assert again.moved.from_mm == (60.0, 0.0, 0.0)  # Max, as without the break
    assert [line.split()[-3] for line in twin.moves[:3]] == [
        "X0.000000",
        "X60.000000",
        "X-100.000000",
    ]


def test_an_indicator_that_is_gone_on_the_way_stops_it_and_ends_the_session(
    tmp_path: Path,
) -> None:
    path = tmp_path / "a.jsonl"
    with moving_session(path, SLOWER, profile=PROMPT) as (guided, bench, _):

        def pull_out() -> None:
            while not bench.axes.moving:
                time.sleep(0.002)
            bench.unplugged = True

        def pull(message: str) -> None:
            if message.startswith("step 1 "):
                threading.Thread(target=pull_out).start()

        with pytest.raises(IndicatorError, match="indicator"):
            measure_all(guided, bench.agree, pull)
        assert not bench.axes.moving
    assert len(taken(path)) == 2
    assert read_record(path).end != "closed"


def test_a_controller_that_is_gone_is_told_with_the_emergency_stop(tmp_path: Path) -> None:
    path = tmp_path / "a.jsonl"
    with moving_session(path, SLOWER) as (guided, bench, twin):

        def on_the_way() -> None:
            while not bench.axes.moving:
                time.sleep(0.002)
            twin.close()

        def switch_off(message: str) -> None:
            if message.startswith("step 1 "):
                threading.Thread(target=on_the_way).start()

        with pytest.raises(MotionError, match="emergency stop"):
            measure_all(guided, bench.agree, switch_off)
        mover = guided.mover
        assert mover is not None
        assert mover.line.not_stopped
        mover.line.vouch()  # as who pressed it
        assert comes_true(lambda: mover.state is State.FAULT)
    assert len(taken(path)) == 2


def test_a_second_client_is_noticed_before_the_next_take(tmp_path: Path) -> None:
    path = tmp_path / "a.jsonl"
    with moving_session(path) as (guided, _, twin):
        mover = guided.mover
        assert mover is not None
        guided.go()
        step = guided.step()
        assert step is not None
        for _ in range(2):  # to Zero, and to the first step
            assert mover.consent()
            arrives(mover)
        assert mover.is_there(step)
        twin.befall(MotionTrouble.NAK)
        with pytest.raises(MotionError, match="control"):
            guided.take()
        assert comes_true(lambda: mover.state is State.HELD)
    assert not taken(path)
    notes = [event.text for event in read_record(path).events if isinstance(event, Noted)]
    assert any("step 1 not taken" in text for text in notes)


@LONG
@pytest.mark.parametrize("moving", first_quick([True, False]), ids=["on the way", "at rest"])
def test_an_indicator_that_answers_late_is_asked_again(moving: bool, tmp_path: Path) -> None:
    path = tmp_path / "a.jsonl"
    with moving_session(path, SLOWER, profile=PROMPT) as (guided, bench, _):

        def back() -> None:
            while bench.axes.moving is not moving:
                time.sleep(0.002)
            bench.unplugged = True
            time.sleep(0.5)  # longer than an answer may take
            bench.unplugged = False

        def unplug(message: str) -> None:
            if message.startswith("step 2 "):
                threading.Thread(target=back).start()

        measure_all(guided, bench.agree, unplug)
    assert read_record(path).end == "closed"
    assert len(taken(path)) == 2 * len(guided.steps)
    assert not wrong(taken(path), bench)


def test_an_indicator_that_stays_away_ends_the_session(tmp_path: Path) -> None:
    path = tmp_path / "a.jsonl"
    with moving_session(path, SLOWER, profile=PROMPT) as (guided, bench, _):

        def unplug(message: str) -> None:
            bench.unplugged = message.startswith("step 2 ")

        with pytest.raises(IndicatorError, match="a reading"):
            measure_all(guided, bench.agree, unplug)
        assert not bench.axes.moving
    assert len(taken(path)) == 4


def test_ways_beyond_the_limits_are_refused_before_anything_is_sent() -> None:
    steps = ways_of(SHORT, FAST, BOTH)
    assert steps.longest_mm == pytest.approx(160.0)  # from Max to Min
    for motion, message in (
        (MotionLimits(longest_mm=100.0), "longest_mm"),
        (MotionLimits(low_mm=(-90.0,) * 3, high_mm=(60.0,) * 3), "machine file"),
        (MotionLimits(preroll_mm=120.0), "preroll_mm"),
    ):
        with pytest.raises((MotionError, RecordError), match=message):
            ways_of(SHORT, Machine(motion=motion), BOTH)


def test_a_stand_that_is_slid_in_every_posture_is_left_to_the_operator() -> None:
    with pytest.raises(UsageError, match="slid by hand"):
        ways_of(load_procedure("plane", FAST.geometry()), FAST, BOTH)


def test_a_controller_without_a_name_is_refused(tmp_path: Path) -> None:
    plan = replace(demo_plan(tmp_path, None, 1), motion="")
    with pytest.raises(UsageError, match="--motion: found ''"):
        open_indicators(plan)


def test_indicators_are_waited_for_longer_than_the_longest_window() -> None:
    longest = SHORT.model_dump() | {"window_s": REST_S - 20.0}
    with pytest.raises(ValueError, match="window_s"):
        Procedure.model_validate(longest)


@LONG
def test_a_demonstration_that_moves_itself_finds_the_hidden_offsets(tmp_path: Path) -> None:
    plan = demo_plan(tmp_path, None, 5, by_itself="twin")
    once = plan.procedure.model_copy(update={"cycles": 1})
    plan = replace(plan, procedure=once)
    with start_session(plan) as guided:
        measure_all(guided, lambda _: True, lambda _: None)
    offsets = solve_files([plan.path]).joint_offsets_mm
    hidden = hidden_machine(plan.machine.geometry(), 5).parameters_mm
    assert offsets == pytest.approx(hidden[:3], abs=0.1)  # lengths, 0.03 mm, are taken for offsets
    first = taken(plan.path)[0].moved
    assert first is not None
    assert first.driver == "linuxcnc"


@contextmanager
def machine_with_play(
    folder: Path, leg: str, *, outermost: bool
) -> Iterator[tuple[float, Callable[[Triple], None], Callable[[], float]]]:
    """With play of carriage x, at a step of a leg: how far that is out, and two calls.

    The first moves the machine, and nobody looks on the way; the second reads an indicator.
    """
    quick = BenchSettings(scatter_mm=0.0, hurry=1e6)
    plan = demo_plan(folder, None, 5, quick, by_itself="twin", effect="backlash:x")
    steps = [s for s in plan.procedure.steps(plan.machine.geometry()) if s.leg == leg]
    step = max(steps, key=lambda s: s.displacement_mm if outermost else -abs(s.displacement_mm))
    with closing(SelfMovingBench(plan)) as bench:
        twin = bench.controller
        assert isinstance(twin, LinuxCncTwin)
        axes = twin.axes
        exchange = Exchange(MITUTOYO_01A, bench.ports[0], Query(), 0.0)
        exchange.open()
        bench.set_up(step)

        def go(to_mm: Triple) -> None:
            axes.go(to_mm, 3000.0)
            time.sleep(0.01)

        def shown_mm() -> float:
            reading = exchange.checked_outcome()
            assert isinstance(reading, IndicatorReading)
            return reading.value_mm

        yield step.displacement_mm, go, shown_mm
        exchange.hang_up()


def test_an_indicator_knows_the_side_that_it_came_from_though_nobody_looked_on_the_way(
    tmp_path: Path,
) -> None:
    with machine_with_play(tmp_path, "x", outermost=True) as (at_mm, go, shown_mm):
        values = []
        for beside_mm in (-10.0, 10.0, -10.0):
            go((at_mm + beside_mm, 0.0, 0.0))
            go((at_mm, 0.0, 0.0))
            values.append(shown_mm())
    assert values[0] == values[2]
    assert abs(values[1] - values[0]) > 0.002


def test_zero_is_zero_where_a_controller_rounds_its_place(tmp_path: Path) -> None:
    """Seven digits of a joint at 310 mm are good for 0.05 µm."""
    with machine_with_play(tmp_path, "y", outermost=False) as (at_mm, go, shown_mm):
        assert at_mm == 0.0
        values = []
        for told_mm in (0.0, 4e-5, -4e-5):
            go((0.0, -10.0, 0.0))
            go((0.0, told_mm, 0.0))
            values.append(shown_mm())
    assert values[0] == values[1] == values[2]


def test_a_consent_from_before_an_interference_moves_nothing(tmp_path: Path) -> None:
    """Somebody jogs it while the question waits, and an indicator is silent for a moment."""
    with moving_session(tmp_path / "a.jsonl", profile=PROMPT) as (guided, bench, twin):
        mover = guided.mover
        assert mover is not None

        def agree(_: MoveProposal) -> bool:
            if bench.axes.to_mm[2] != 1.0:
                return False
            bench.unplugged = True
            bench.axes.go((3.0, -2.0, 5.0), 6000.0)
            assert comes_true(lambda: mover.state is State.HELD)
            assert comes_true(lambda: lost_words(guided) is not None)
            threading.Timer(0.3, lambda: setattr(bench, "unplugged", False)).start()
            return True

        with pytest.raises(MotionError, match="not at the commanded position"):
            measure_all(guided, agree)
        assert mover.state is State.HELD
        assert not twin.moves


def test_nothing_moves_without_a_screen_while_an_indicator_gives_no_value(tmp_path: Path) -> None:
    questions: list[MoveProposal] = []
    with moving_session(tmp_path / "a.jsonl", profile=PROMPT) as (guided, bench, twin):

        def agree(proposal: MoveProposal) -> bool:
            questions.append(proposal)
            bench.unplugged = len(questions) == 1
            assert comes_true(lambda: (lost_words(guided) is not None) is bench.unplugged)
            threading.Timer(0.3, lambda: setattr(bench, "unplugged", False)).start()
            return len(questions) == 1

        with pytest.raises(MotionError, match="consent: found not given"):
            measure_all(guided, agree)
        assert not twin.moves
    assert len(questions) == 2


def test_another_adapter_at_the_port_of_a_silent_indicator_ends_the_session(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two cables were pulled and plugged in crosswise: readings of the other one were taken."""
    with moving_session(tmp_path / "a.jsonl", profile=PROMPT) as (guided, bench, twin):
        guided.gauges[0].adapter = "A1"
        monkeypatch.setattr(unattended, "adapter_at", lambda _: "B2")

        def agree(_: MoveProposal) -> bool:
            bench.unplugged = True
            assert comes_true(lambda: lost_words(guided) is not None)
            threading.Timer(0.3, lambda: setattr(bench, "unplugged", False)).start()
            return True

        with pytest.raises(IndicatorError, match=r"adapter B2 at its port.*adapter A1, as before"):
            measure_all(guided, agree)
        assert not twin.moves
