"""The guided session: one order for many threads; steps repeated, restored and left out."""

from __future__ import annotations

import re
import threading
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from app.measuring.demo import demo_plan
from app.measuring.doubts import Doubt
from app.measuring.gauges import Gauge
from app.measuring.opening import opened_event, start_session
from app.measuring.plan import Plan
from app.measuring.session import GuidedSession, Indicators
from app.measuring.unattended import measure_all
from app.report.text.questions import question_choices, question_text
from app.report.text.session import step_in_list, visits_of
from drivers.profile import FaultKind, IndicatorReading, Outcome, Query
from drivers.profiles.mitutoyo_01a import MITUTOYO_01A
from protocols.clock import SessionClock
from protocols.expectation import Movement
from protocols.journal import Journal
from protocols.machine import Machine
from protocols.procedure import Procedure
from protocols.record import read_record
from protocols.session import fold

NOTES = 40


def test_notes_while_readings_are_taken(tmp_path: Path) -> None:
    plan = demo_plan(tmp_path, "zero-max-min", 1)
    with start_session(plan) as guided:

        def write() -> None:
            for _ in range(NOTES):
                guided.note("meanwhile")

        writers = [threading.Thread(target=write) for _ in range(2)]
        for writer in writers:
            writer.start()
        guided.go()
        while guided.take() is not None:
            guided.go()
        for writer in writers:
            writer.join()
        assert not guided.closed
        measure_all(guided)
        assert guided.closed
    record = read_record(plan.path)
    assert record.end == "closed"
    assert sum(event.event == "noted" for event in record.events) == 2 * NOTES
    assert len(fold(record.events).readings) == 60


def quick(folder: Path, **changes: object) -> Plan:
    """Two legs, one cycle each: ZERO MAX MIN ZERO, steps 1 … 4 on x and 5 … 8 on y."""
    plan = demo_plan(folder, "zero-max-min", 1)
    short = plan.procedure.model_dump() | {"legs": ("x", "y"), "cycles": 1} | changes
    return replace(plan, procedure=Procedure.model_validate(short))


def take(guided: GuidedSession, count: int) -> list[int]:
    """Numbers of so many steps taken."""
    numbers = []
    for _ in range(count):
        guided.go()
        taken_step = guided.take()
        assert taken_step is not None
        assert not taken_step.faults
        numbers.append(taken_step.step.number)
    return numbers


def counting(guided: GuidedSession) -> dict[int, list[int]]:
    """Step → numbers of its readings that count."""
    by_step: dict[int, list[int]] = {}
    for reading in guided.session.readings:
        assert reading.step is not None
        by_step.setdefault(reading.step, []).append(reading.reading)
    return by_step


def present(guided: GuidedSession) -> int | None:
    step = guided.step()
    return step.number if step else None


def test_one_step_is_repeated_while_the_stand_is_where_it_was(tmp_path: Path) -> None:
    with start_session(quick(tmp_path)) as guided:
        take(guided, 3)
        assert guided.steps_repeated_with(2) == {2}
        again = guided.repeat(2, "a truck passed")
        assert again is not None
        assert again.number == 2
        assert guided.session.superseded == {3: "a truck passed", 4: "a truck passed"}
        assert counting(guided) == {1: [1, 2], 3: [5, 6]}
        assert take(guided, 2) == [2, 4]
        assert len(guided.session.mountings) == 1


def test_undo_takes_back_the_last_step_taken_not_the_last_of_the_list(tmp_path: Path) -> None:
    with start_session(quick(tmp_path)) as guided:
        assert guided.undo() is None
        take(guided, 3)
        guided.repeat(1, "wild")
        take(guided, 1)
        guided.undo("once more")
        assert present(guided) == 1
        assert set(counting(guided)) == {2, 3}


def test_after_the_stand_moved_a_whole_mounting_is_repeated(tmp_path: Path) -> None:
    with start_session(quick(tmp_path)) as guided:
        take(guided, 6)
        assert guided.steps_repeated_with(2) == {1, 2, 3, 4}
        assert guided.steps_repeated_with(6) == {6}
        guided.repeat(2, "wild")
        assert set(counting(guided)) == {5, 6}
        assert take(guided, 4) == [1, 2, 3, 4]
        mounts = {r.mount for r in guided.session.readings if r.leg == "x"}
        assert mounts == {"xy#2", "xz#2"}
        assert take(guided, 2) == [7, 8]
        assert {r.mount for r in guided.session.readings if r.step == 7} == {"yx#2", "yz#2"}
        assert guided.step() is None


def test_after_a_break_the_mounting_before_it_is_repeated_whole(tmp_path: Path) -> None:
    plan = quick(tmp_path)
    with start_session(plan) as guided:
        take(guided, 3)
    with start_session(replace(plan, continued=True)) as guided:
        assert guided.steps_repeated_with(3) == {1, 2, 3}
        assert take(guided, 1) == [4]
        assert guided.steps_repeated_with(4) == {4}
        assert guided.steps_repeated_with(1) == {1, 2, 3}
        guided.repeat(1, "not sure of the stand")
        assert take(guided, 3) == [1, 2, 3]
        assert {r.mount for r in guided.session.readings} == {"xy#2", "xz#2"}


def test_superseded_readings_count_again(tmp_path: Path) -> None:
    with start_session(quick(tmp_path)) as guided:
        take(guided, 3)
        guided.undo("wild")
        take(guided, 1)
        assert not guided.restore(3, "it has readings that count")
        guided.undo("wilder")
        assert guided.restore(3, "the second was right")
        assert counting(guided) == {1: [1, 2], 2: [3, 4], 3: [7, 8]}
        assert guided.session.superseded == {5: "wild", 6: "wild"}
        assert not guided.restore(4, "never taken")
        assert present(guided) == 4


@pytest.mark.parametrize("moved", ["remounted", "next leg", "break"])
def test_nothing_is_restored_after_the_stand_moved(tmp_path: Path, moved: str) -> None:
    plan = quick(tmp_path)
    with ExitStack() as stack:
        guided = stack.enter_context(start_session(plan))
        take(guided, 3)
        if moved == "next leg":
            guided.skip([4], "no time")
            take(guided, 1)
            guided.repeat(2, "wild")
        else:
            guided.undo("wild")
        if moved == "remounted":
            guided.remount()
        if moved == "break":
            guided.leave()
            guided = stack.enter_context(start_session(replace(plan, continued=True)))
        before = guided.session.readings
        assert not guided.restore(3, "too late")
        assert guided.session.readings == before


def test_skipped_steps_are_left_out_and_come_back(tmp_path: Path) -> None:
    with start_session(quick(tmp_path)) as guided:
        take(guided, 1)
        assert [step.number for step in guided.rest_of_place()] == [2, 3, 4]
        guided.skip([2], "collides")
        assert [step.number for step in guided.rest_of_place()] == [3, 4]
        following = guided.skip([step.number for step in guided.rest_of_place()], "no time")
        assert following is not None
        assert following.number == 5
        assert guided.session.skipped == {2: "collides", 3: "no time", 4: "no time"}
        assert take(guided, 4) == [5, 6, 7, 8]
        assert guided.step() is None
        assert guided.rest_of_place() == ()
        assert not guided.session.complete
        guided.repeat(2, "it can be reached after all")
        assert 2 not in guided.session.skipped
        assert take(guided, 2) == [1, 2]
        assert {r.mount for r in guided.session.readings if r.step in (1, 2)} == {"xy#2", "xz#2"}


def test_a_step_brought_back_on_the_same_mounting_comes_alone(tmp_path: Path) -> None:
    with start_session(quick(tmp_path)) as guided:
        take(guided, 1)
        guided.skip([2], "collides")
        take(guided, 1)
        assert guided.steps_repeated_with(2) == {2}
        guided.remount()
        assert guided.steps_repeated_with(2) == {2}
        guided.skip([4], "no time")
        assert guided.steps_repeated_with(2) == {2}


def test_a_step_brought_back_after_a_break_needs_a_zero(tmp_path: Path) -> None:
    plan = quick(tmp_path)
    with start_session(plan) as guided:
        take(guided, 1)
        guided.skip([2], "collides")
        take(guided, 1)
    with start_session(replace(plan, continued=True)) as guided:
        assert guided.steps_repeated_with(2) == {2}, "the Zero of step 4 is still to come"
        guided.skip([4], "no time")
        assert guided.steps_repeated_with(2) == {1, 2, 3}


def test_a_step_of_a_leg_that_was_left_out_brings_the_zeros_of_its_cycle(tmp_path: Path) -> None:
    with start_session(quick(tmp_path, cycles=2)) as guided:
        cycles = {step.number: step.cycle for step in guided.steps if step.leg == "x"}
        zeros = {s.number for s in guided.steps if s.leg == "x" and s.displacement_mm == 0.0}
        guided.skip(list(cycles), "no time")
        take(guided, 1)
        last = max(number for number in cycles if number not in zeros)
        expected_steps = {number for number in zeros if cycles[number] == cycles[last]} | {last}
        assert guided.steps_repeated_with(last) == expected_steps
        guided.repeat(last, "there is time")
        assert take(guided, len(expected_steps)) == sorted(expected_steps)


def killed_in_step_2(folder: Path) -> Plan:
    """One of its two readings is on the disk."""
    plan = quick(folder)
    with start_session(plan) as guided:
        take(guided, 2)
    lines = plan.path.read_bytes().splitlines(keepends=True)
    plan.path.write_bytes(b"".join(lines[:-1]))
    return plan


def test_a_step_that_is_skipped_has_no_readings_that_count(tmp_path: Path) -> None:
    """One of two readings was on the disk when the program was killed; then it is left out."""
    plan = killed_in_step_2(tmp_path)
    with start_session(replace(plan, continued=True)) as guided:
        assert counting(guided) == {1: [1, 2], 2: [3]}
        guided.skip([2], "no time")
        assert counting(guided) == {1: [1, 2]}
        assert guided.session.superseded == {3: "no time"}


def test_a_skipped_step_whose_readings_are_restored_is_skipped_no_more(tmp_path: Path) -> None:
    with start_session(quick(tmp_path)) as guided:
        take(guided, 2)
        guided.undo("wild")
        guided.skip([2], "no time")
        assert guided.restore(2, "it was right")
        assert guided.session.skipped == {}
        assert counting(guided) == {1: [1, 2], 2: [3, 4]}


def test_an_interrupted_step_is_measured_again_as_a_whole(tmp_path: Path) -> None:
    plan = killed_in_step_2(tmp_path)
    with start_session(replace(plan, continued=True)) as guided:
        assert take(guided, 1) == [2]
        assert counting(guided) == {1: [1, 2], 2: [4, 5]}
        assert guided.session.superseded == {3: "step was interrupted"}


def test_a_reading_that_disagrees_is_questioned_and_counts_when_it_is_kept(tmp_path: Path) -> None:
    """A limit finer than the scatter of the simulated machine questions something."""
    plan = quick(tmp_path, cycles=3, repeat_limit_mm=1e-3)
    questioned = []
    with start_session(plan) as guided:
        for number in range(1, 11):
            guided.go()
            taken_step = guided.take()
            assert taken_step is not None
            assert taken_step.step.number == number
            if taken_step.doubt:
                questioned.append(number)
                assert taken_step.doubt in (Doubt.BEYOND, Doubt.REPEATS, Doubt.ODD)
                following = guided.step()
                assert following is not None
                assert following.number == taken_step.questioned[0].step
                guided.keep(taken_step, "right")
        assert len(guided.session.readings) == 20
        assert guided.session.restored
    assert questioned
    assert min(questioned) >= 4


def test_an_odd_one_that_was_kept_is_not_asked_about_after_a_break(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """MAX of cycle 1 was taken 0.4 mm off; two repeats settle it, and the operator keeps it."""
    plan, doubts = quick(tmp_path, cycles=4), dict[int, Doubt]()

    def measure(guided: GuidedSession, last: int) -> None:
        while (step := guided.step()) is not None and step.number <= last:
            guided.go()
            taken_step = guided.take()
            assert taken_step is not None
            if taken_step.doubt:
                doubts[step.number] = taken_step.doubt
                guided.keep(taken_step, "it is right")

    def off(gauge: Gauge) -> Future[Outcome]:
        reading, answer = honest(gauge).result(), Future[Outcome]()
        assert isinstance(reading, IndicatorReading)
        answer.set_result(replace(reading, value_mm=reading.value_mm + 0.4))
        return answer

    honest = Gauge.ask
    with start_session(plan) as guided:
        measure(guided, 1)
        with monkeypatch.context() as patched:
            patched.setattr(Gauge, "ask", off)
            measure(guided, 2)
        measure(guided, 8)
        assert Doubt.ODD in doubts.values()
    doubts.clear()
    with start_session(replace(plan, continued=True)) as guided:
        measure(guided, 13)
        assert Doubt.ODD not in doubts.values()


class Still(Gauge):
    """Shows what it is told."""

    def __init__(self, value_mm: float) -> None:
        super().__init__(MITUTOYO_01A, "port", Query(), window_s=0.1, tolerance_mm=0.004)
        self.shown = IndicatorReading(f"{value_mm}", value_mm, 0.001, unit_assumed=True)

    def ask(self) -> Future[Outcome]:
        future = Future[Outcome]()
        future.set_result(self.shown)
        return future

    def show(self, value_mm: float, resolution_mm: float = 0.001) -> None:
        self.shown = IndicatorReading(f"{value_mm}", value_mm, resolution_mm, unit_assumed=True)


@dataclass
class Time:
    now_s: float = 0.0

    def wall(self) -> datetime:
        return datetime.fromtimestamp(self.now_s, UTC)


@contextmanager
def by_hand(folder: Path, machine: Machine) -> Iterator[tuple[GuidedSession, list[Still], Time]]:
    """A real machine, its indicators at 0, and a clock to set."""
    plan = replace(quick(folder), machine=machine)
    journal = Journal.create(plan.path, opened_event(plan))
    time = Time()
    clock = SessionClock(journal.events, lambda: time.now_s, time.wall)
    gauges = [Still(0.0), Still(0.0)]
    with GuidedSession(journal, Indicators((*gauges,)), clock) as guided:
        yield guided, gauges, time


def doubt(guided: GuidedSession) -> Doubt | None:
    taken_step = guided.take()
    assert taken_step is not None
    return taken_step.doubt


def test_three_presses_without_moving_store_one_reading(tmp_path: Path) -> None:
    with by_hand(tmp_path, Machine()) as (guided, gauges, time):
        for press in (None, Doubt.UNCHANGED, Doubt.UNCHANGED):
            assert doubt(guided) is press
            time.now_s += 5.0
        assert guided.session.done() == {1}
        gauges[0].show(0.3)
        assert doubt(guided) is None
        assert guided.session.done() == {1, 2}


def test_where_readings_tell_nothing_a_press_too_soon_is_asked(tmp_path: Path) -> None:
    """60 mm at 1200 mm/min take 3 s."""
    machine = Machine(entered_offsets_mm=(0.1, 0.0, 0.0), fastest_feed_mm_min=1200.0)
    with by_hand(tmp_path, machine) as (guided, _, time):
        assert doubt(guided) is None
        time.now_s += 2.9
        assert doubt(guided) is Doubt.TOO_SOON
        time.now_s += 0.2
        assert doubt(guided) is None
        assert guided.moved() is Movement.UNKNOWN, "so that automatic waits"
    notes = [e.text for e in read_record(guided.path).events if e.event == "noted"]
    assert notes == ["step 2: no reading can show a move here; the operator's word"]


def test_a_first_reading_beyond_the_tolerances_is_asked(tmp_path: Path) -> None:
    with by_hand(tmp_path, Machine()) as (guided, gauges, time):
        assert doubt(guided) is None
        time.now_s += 20.0
        gauges[0].show(4.0)
        assert doubt(guided) is Doubt.BEYOND
        assert guided.session.done() == {1}


def test_a_stand_that_was_not_taken_to_the_next_leg_is_asked_about(tmp_path: Path) -> None:
    """Both indicators show at the first step of leg Y what they showed at the last of leg X."""
    with by_hand(tmp_path, Machine()) as (guided, gauges, time):
        for shown_mm in (0.0, 0.3, -0.4, 0.001):
            time.now_s += 20.0
            gauges[0].show(shown_mm)
            assert doubt(guided) is None
        time.now_s += 60.0
        for _ in range(2):
            taken_step = guided.take()
            assert taken_step is not None
            assert taken_step.doubt is Doubt.STAND
            assert [r.step for r in taken_step.earlier] == [4, 4]
            assert guided.session.done() == {1, 2, 3, 4}
        assert taken_step is not None
        assert (
            "Unchanged since step 4, leg X ZERO, end: was the stand set up again"
            in question_text(taken_step, guided.session)
        )
        gauges[1].show(0.6)
        assert doubt(guided) is None
        assert guided.session.done() == {1, 2, 3, 4, 5}


def test_a_stand_that_was_set_up_to_the_same_zero_is_not_asked_about(tmp_path: Path) -> None:
    with by_hand(tmp_path, Machine()) as (guided, gauges, time):
        for shown_mm in (0.0, 0.3, -0.4, 0.001):
            time.now_s += 20.0
            gauges[0].show(shown_mm)
            assert doubt(guided) is None
        for gauge in gauges:  # the spindles went far meanwhile, and both were set to zero
            for heard_mm in (0.001, 4.0, 0.001):
                gauge.show(heard_mm)
                gauge.hear(gauge.shown)
        gauges[1].show(0.0)
        time.now_s += 60.0
        assert doubt(guided) is None


def test_where_nothing_changed_the_step_before_may_be_the_wrong_one(tmp_path: Path) -> None:
    """MAX was taken at MIN: now that it is there MIN shows no change."""
    with by_hand(tmp_path, Machine()) as (guided, gauges, time):
        for shown_mm in (0.0, -0.4):
            time.now_s += 20.0
            gauges[0].show(shown_mm)
            assert doubt(guided) is None
        time.now_s += 20.0
        taken_step = guided.take()
        assert taken_step is not None
        assert taken_step.doubt is Doubt.UNCHANGED
        assert ("earlier", "Step 3 is right: measure step 2 again") in question_choices(taken_step)
        guided.measure_earlier(taken_step, "measured again")
        assert guided.session.done() == {1, 3}
        following = guided.step()
        assert following is not None
        assert following.number == 2


def test_no_two_steps_have_one_name(tmp_path: Path) -> None:
    for procedure in ("zero-max-min", "two-station", "sweep"):
        plan = demo_plan(tmp_path, procedure, 1)
        geometry = plan.machine.geometry()
        steps = plan.procedure.steps(geometry)
        visits = visits_of(steps)
        names = [(s.place, step_in_list(s, geometry, visits[s.number])) for s in steps]
        assert len(set(names)) == len(names)
        assert all(len(name) <= 10 for _, name in names), "the list is narrow"
        assert names[-1][1] == "Z ZERO end"


def test_other_decimals_in_mid_session_are_a_fault_with_a_name(tmp_path: Path) -> None:
    with by_hand(tmp_path, Machine()) as (guided, gauges, time):
        assert doubt(guided) is None
        time.now_s += 20.0
        gauges[0].show(0.3)
        gauges[1].show(0.01234, 0.00001)
        taken_step = guided.take()
        assert taken_step is not None
        (fault,) = taken_step.faults
        assert fault.kind is FaultKind.WRONG_UNIT
        for words in (
            "indicator 2 (mitutoyo-01a, port): along Z",
            "steps of 0.00001 mm",
            "before 0.001",
            "inch",
        ):
            assert words in fault.words
        assert guided.session.done() == {1}
        gauges[1].show(0.3)
        assert doubt(guided) is None


def test_the_time_of_readings_does_not_follow_the_wall_clock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Set back an hour between two steps: told, noted, and the times go on."""
    with start_session(quick(tmp_path)) as guided:
        take(guided, 2)
        clock = guided.clock
        wall_clock = clock.wall
        monkeypatch.setattr(clock, "wall", lambda: wall_clock() - timedelta(hours=1))
        take(guided, 2)
        assert guided.look_at_clock() == pytest.approx(-3600.0, abs=5.0)
        assert guided.look_at_clock() == 0.0
        times_s = [r.time_s for r in guided.session.readings if r.time_s is not None]
    assert len(times_s) == 8
    assert times_s == sorted(times_s)
    assert times_s[-1] < 600.0
    notes = [e.text for e in read_record(guided.path).events if e.event == "noted"]
    assert len(notes) == 1
    assert re.fullmatch(r"the computer's clock was set back by 3600 s; time_s goes on", notes[0])


def test_a_break_is_told_by_the_record(tmp_path: Path) -> None:
    plan = quick(tmp_path)
    with start_session(plan) as guided:
        take(guided, 1)
    with start_session(replace(plan, continued=True)) as guided:
        take(guided, 1)
        times_s = [r.time_s for r in guided.session.readings if r.time_s is not None]
    assert times_s == sorted(times_s)
    pauses = [e.paused_s for e in read_record(guided.path).events if e.event == "continued"]
    assert len(pauses) == 1
    assert pauses[0] is not None
    assert 0.0 <= pauses[0] < 600.0
