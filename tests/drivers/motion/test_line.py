"""The states of a machine that moves itself: each row of the table, and all that is no row."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from drivers.motion import controller_of
from drivers.motion.controller import ControllerFault
from drivers.motion.guard import DETACHED
from drivers.motion.line import STRICT, MotionLine, Patience
from drivers.motion.states import TRANSITIONS, Cause, State
from tests.conftest import LONG, first_quick
from tests.drivers.motion.bench import (
    BUSY,
    FEED,
    LIMITS,
    PATIENCE_S,
    SLOW,
    START,
    Face,
    Rig,
    comes_true,
    rig,
)
from tests.drivers.motion.twins import FailingAxes, FailingLinuxCnc, GrblTwin, MotionTrouble

WITHIN_S = 0.5
SEEN_S = 2.0
"""A test that sees a stop later than it happened, on a busy machine, measures by the way gone."""


def ready(r: Rig) -> None:
    r.comes(State.READY)


def consented(r: Rig) -> None:
    r.consent()


def moving(r: Rig) -> None:
    r.on_the_way()
    r.comes(State.MOVING)


def stopping(r: Rig) -> None:
    moving(r)
    r.twin.befall(MotionTrouble.SILENCE)
    r.line.stop("a test", by_operator=True)
    r.comes(State.STOPPING)


def stopped(r: Rig) -> None:
    moving(r)
    r.line.stop("a test", by_operator=True)
    r.comes(State.STOPPED)


def held(r: Rig) -> None:
    r.twin.befall(MotionTrouble.OFFSET)
    r.comes(State.HELD)


def fault(r: Rig) -> None:
    r.twin.befall(MotionTrouble.OFF)
    r.comes(State.FAULT)


def answer(r: Rig) -> None:
    r.twin.mend()
    r.line.answered().result(PATIENCE_S)


def vouch(r: Rig) -> None:
    assert comes_true(lambda: r.line.not_stopped)
    r.line.vouch()


def arrive(r: Rig) -> None:
    r.line.stop("a test", by_operator=True)
    r.comes(State.STOPPED)
    r.consent()
    r.line.go([(2.0, 2.0, -3.0)], FEED).result(PATIENCE_S)


def end_silence(r: Rig) -> None:
    r.twin.mend()


def homing(r: Rig) -> None:
    assert r.line.consent(to_home=True)


Act = Callable[[Rig], object]
WAYS: dict[tuple[State, Cause], tuple[Act, Act]] = {
    (State.READY, Cause.CONSENT): (ready, consented),
    (State.STOPPED, Cause.CONSENT): (stopped, consented),
    (State.READY, Cause.HOMING): (ready, homing),
    (State.STOPPED, Cause.HOMING): (stopped, homing),
    (State.FAULT, Cause.HOMING): (fault, homing),
    (State.CONSENTED, Cause.MOVE): (
        consented,
        lambda r: r.line.go([(50.0, 2.0, -3.0)], SLOW),
    ),
    (State.MOVING, Cause.ARRIVED): (moving, arrive),
    (State.CONSENTED, Cause.RELEASED): (consented, lambda r: r.line.release()),
    (State.CONSENTED, Cause.STOP): (consented, lambda r: r.line.stop("a", by_operator=True)),
    (State.MOVING, Cause.STOP): (moving, lambda r: r.line.stop("a", by_operator=True)),
    (State.STOPPING, Cause.RESTS): (stopping, end_silence),
    (State.STOPPING, Cause.VOUCHED): (stopping, vouch),
    (State.STOPPING, Cause.RESTS_HELD): (moving, lambda r: r.line.stop("an indicator")),
    (State.STOPPING, Cause.RESTS_FAULT): (
        moving,
        lambda r: r.twin.befall(MotionTrouble.ESTOP),
    ),
    (State.READY, Cause.CHANGED): (ready, held),
    (State.STOPPED, Cause.CHANGED): (stopped, held),
    (State.READY, Cause.FAILED): (ready, fault),
    (State.STOPPED, Cause.FAILED): (stopped, fault),
    (State.HELD, Cause.FAILED): (held, fault),
    (State.FAULT, Cause.FAILED): (fault, lambda r: r.line.answered().exception(PATIENCE_S)),
    (State.HELD, Cause.ANSWERED): (held, answer),
    (State.FAULT, Cause.ANSWERED): (fault, answer),
}
ENDS = {
    (State.CONSENTED, Cause.STOP): State.STOPPED,
    (State.MOVING, Cause.STOP): State.STOPPED,
}
"""What is seen in the end: stopping is soon over."""


@pytest.mark.parametrize("row", WAYS, ids=lambda row: f"{row[0]}, {row[1]}")
def test_each_row_of_the_table(row: tuple[State, Cause]) -> None:
    before, cause = WAYS[row]
    with rig("linuxcnc", answer_s=0.2) as r:
        before(r)
        cause(r)
        following = ENDS.get(row, TRANSITIONS[row])
        assert comes_true(lambda: r.line.state is following), (r.line.state, r.line.why)


def test_every_row_has_a_test() -> None:
    connecting = {(State.OFF, Cause.CONNECTED), (State.OFF, Cause.FAILED)}  # test_start…
    closing_rows = {(state, Cause.CLOSED) for state in State}
    assert set(TRANSITIONS) == set(WAYS) | connecting | closing_rows


@pytest.mark.parametrize("before", [ready, consented, moving, stopping, stopped, held, fault])
def test_closed_from_every_state(before: Act) -> None:
    with rig("linuxcnc", answer_s=0.2) as r:
        before(r)
        r.line.close()
        assert r.line.state is State.OFF
        r.twin.mend()  # where it could not be stopped the guard goes on with it
        assert comes_true(lambda: all(guard.poll() is not None for guard in DETACHED))
        assert not r.axes.moving
        assert r.axes.at_mm[0] < 49.0


def test_start_where_only_homing_helps_begins_in_a_fault() -> None:
    with closing(GrblTwin(FailingAxes(), "tcp")) as twin:
        twin.befall(MotionTrouble.NOT_HOMED)
        line = MotionLine(controller_of(twin.endpoint, LIMITS), BUSY)
        line.start()
        assert line.state is State.FAULT
        assert line.can_home
        assert not line.consent()
        face = Face(line)
        assert line.consent(to_home=True)
        line.home().result(PATIENCE_S)
        line.release()
        assert not line.needs_homing_confirmed
        line.close()
        face.hang()


def test_a_board_that_cannot_tell_whether_it_is_homed_waits_for_the_operators_word() -> None:
    with rig("grbl") as r:
        r.line.homing_confirmed = False
        assert not r.line.consent()
        r.line.homing_confirmed = True
        assert r.line.consent()


def test_a_connected_machine_is_ready_and_nothing_moves() -> None:
    with closing(FailingLinuxCnc(FailingAxes())) as twin:
        line = MotionLine(controller_of(twin.endpoint, LIMITS), BUSY)
        states = [line.state]
        line.start()
        states.append(line.state)
        line.close()
        assert states == [State.OFF, State.READY]
        assert not twin.moves


def test_nothing_moves_where_the_machine_is_not_ready() -> None:
    with closing(FailingLinuxCnc(FailingAxes())) as twin:
        twin.befall(MotionTrouble.NOT_HOMED)
        line = MotionLine(controller_of(twin.endpoint, LIMITS))
        with pytest.raises(ControllerFault, match="home it"):
            line.start()
        line.close()
        assert line.state is State.OFF
        assert not twin.moves


def test_without_a_guard_that_starts_there_is_no_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.motion.guard.PROGRAM", "raise SystemExit(1)")
    with closing(FailingLinuxCnc(FailingAxes())) as twin:
        line = MotionLine(controller_of(twin.endpoint, LIMITS), BUSY)
        with pytest.raises(ControllerFault, match="guard beside the program: found did not start"):
            line.start()
        assert line.state is State.OFF
        assert not line.consent()
        assert not twin.moves


def test_goes_by_way_of_places() -> None:
    with rig("linuxcnc") as r:
        assert r.go((-5.0, 0.0, 0.0), (0.0, 0.0, 0.0), (2.0, 0.0, 0.0)) == (2.0, 0.0, 0.0)
        ways = [move.split()[-3] for move in r.twin.moves]
        assert ways == ["X-5.000000", "X0.000000", "X2.000000"]


@pytest.mark.parametrize("before", [ready, stopped, held, fault])
def test_without_consent_nothing_is_sent(before: Act) -> None:
    with rig("linuxcnc") as r:
        before(r)
        count = len(r.twin.moves)
        with pytest.raises(ControllerFault):
            r.line.go([(2.0, 0.0, 0.0)], FEED).result(PATIENCE_S)
        assert len(r.twin.moves) == count


def test_a_consent_is_no_consent_to_what_was_asked_before_it() -> None:
    with rig("linuxcnc") as r:
        r.consent()
        before = r.line.go([(50.0, 2.0, -3.0)], SLOW)
        behind = r.line.go([(-50.0, 2.0, -3.0)], SLOW)
        assert comes_true(lambda: r.axes.moving)
        r.line.stop("a test", by_operator=True)
        r.comes(State.STOPPED)
        r.consent()
        for way in (before, behind):
            with pytest.raises(ControllerFault, match="stopped"):
                way.result(PATIENCE_S)
        assert len(r.twin.moves) == 1


@pytest.mark.parametrize("before", first_quick([ready, stopped]))
def test_a_consent_within_the_dead_time_is_none(before: Act) -> None:
    with rig("linuxcnc", Patience(silence_s=3.0, dead_s=3.0)) as r:
        assert comes_true(r.line.consent)
        r.line.release()
        assert not r.line.consent()  # released: an answer, a dialog, an arrival at Zero
        assert comes_true(r.line.consent)
        if before is stopped:
            r.line.go([(50.0, 2.0, -3.0)], SLOW)
            assert comes_true(lambda: r.axes.moving)
        r.line.stop("a test", by_operator=True)
        r.comes(State.STOPPED)
        ended_s = time.monotonic()
        assert not r.line.consent()
        assert comes_true(r.line.consent)
        assert time.monotonic() - ended_s > 0.4


def test_a_second_stop_refused_is_no_stop() -> None:
    """NAK to the abort, and the machine goes on: said until it is seen to rest."""
    with rig("linuxcnc", answer_s=0.2) as r:
        refuses = threading.Event()
        refuses.set()
        abort = FailingLinuxCnc._abort

        class Deaf(FailingLinuxCnc):
            def _abort(self) -> None:
                if not refuses.is_set():
                    abort(self)

        r.on_the_way(to=(59.0, 2.0, -3.0))
        r.twin.__class__ = Deaf
        r.line.stop("a test", by_operator=True)
        assert comes_true(lambda: r.line.not_stopped)
        assert comes_true(lambda: "NOT STOPPED" in r.line.why)
        assert r.axes.moving
        refuses.clear()
        r.comes(State.STOPPED)
        assert not r.axes.moving


def test_who_sends_behind_the_end_of_a_consent_is_told_why_it_ended() -> None:
    with rig("linuxcnc") as r:
        consented(r)
        r.line.stop("an indicator does not answer")
        r.comes(State.HELD)
        with pytest.raises(ControllerFault, match="before it moved: an indicator does not answer"):
            r.line.go([(2.0, 2.0, -3.0)], FEED).result(PATIENCE_S)
        assert r.twin.axes.at_mm == START


def test_who_asks_a_controller_that_dies_is_answered_before_anybody_vouches() -> None:
    """Within a consent the fault is a stop, too, which nobody can see: the answer must not wait."""
    with rig("linuxcnc", answer_s=0.2) as r:
        r.consent()
        r.twin.befall(MotionTrouble.SILENCE)
        assert isinstance(r.line.at(START).exception(3.0), ControllerFault)
        assert r.line.not_stopped
        r.twin.mend()
        r.comes(State.FAULT)


def test_control_that_is_lost_while_it_is_answered_is_said_and_taken_with_the_next_answer() -> None:
    with rig("linuxcnc") as r:
        fault(r)
        r.twin.mend()
        second = controller_of(r.twin.endpoint, LIMITS)
        second.connect()
        assert isinstance(r.line.answered().exception(PATIENCE_S), ControllerFault)
        assert r.line.state is State.FAULT
        assert "another client has control" in r.line.why
        second.close()
        answer(r)
        assert r.line.consent()


def test_a_stop_that_took_control_from_another_client_is_answered() -> None:
    with rig("linuxcnc") as r:
        r.on_the_way()
        twin = r.twin
        assert isinstance(twin, FailingLinuxCnc)
        with twin.lock:  # between two looks
            twin.control = None
            r.line.stop("a test", by_operator=True)
        r.comes(State.HELD)
        assert "another client has control" in r.line.why
        assert not r.axes.moving


def test_a_board_of_another_machine_is_not_homed_either() -> None:
    with closing(GrblTwin(FailingAxes(), "tcp")) as twin:
        twin.befall(MotionTrouble.NOT_HOMED)
        twin.settings["130"] = "20.000"
        line = MotionLine(controller_of(twin.endpoint, LIMITS), BUSY)
        with pytest.raises(ControllerFault, match="the board of another machine"):
            line.start()
        line.close()


@pytest.mark.parametrize("name", first_quick(["linuxcnc", "grbl"]))
def test_answers_that_are_late_keep_no_stop_waiting(name: str) -> None:
    with rig(name, answer_s=6.0) as r:
        r.on_the_way(feed=600.0, to=(59.0, 2.0, -3.0))
        r.twin.late_s = 0.35
        time.sleep(0.5)  # a question is under way
        at_mm = r.axes.at_mm[0]
        r.line.stop("a test", by_operator=True)
        assert comes_true(lambda: not r.axes.moving)
        assert r.axes.at_mm[0] - at_mm < 10.0 * WITHIN_S  # 10 mm/s
        r.comes(State.STOPPED)


def test_a_face_that_hangs_stops_the_machine() -> None:
    with rig("linuxcnc", STRICT) as r:
        assert comes_true(r.line.consent)
        r.line.go([(50.0, 2.0, -3.0)], 600.0)
        assert comes_true(lambda: r.axes.moving)
        at_mm = r.axes.at_mm[0]
        r.face.hang()
        r.comes(State.HELD)
        assert "the screen did not run" in r.line.why
        assert r.axes.at_mm[0] - at_mm < 10.0 * WITHIN_S


@pytest.mark.parametrize("end", ["kill", "hang"])
@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_without_its_guard_nothing_moves(end: str) -> None:
    with rig("linuxcnc", STRICT) as r:
        assert comes_true(r.line.consent)
        r.line.go([(50.0, 2.0, -3.0)], 600.0)
        assert comes_true(lambda: r.axes.moving)
        at_mm, guard = r.axes.at_mm[0], r.line.guard
        assert guard is not None
        guard.process.send_signal(signal.SIGKILL if end == "kill" else signal.SIGSTOP)
        r.comes(State.FAULT)
        assert "guard" in r.line.why
        assert r.axes.at_mm[0] - at_mm < 10.0 * WITHIN_S
        if end == "hang":
            guard.process.send_signal(signal.SIGKILL)
            guard.process.wait()
        answer(r)  # begins another guard
        assert comes_true(r.line.consent)
        r.line.go([(2.0, 2.0, -3.0)], FEED).result(PATIENCE_S)


@pytest.mark.parametrize("name", ["linuxcnc", "grbl"])
@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_thread_that_dies_stops_the_machine(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with rig(name, STRICT) as r:
        assert comes_true(r.line.consent)
        way = r.line.go([(50.0, 2.0, -3.0)], 600.0)
        assert comes_true(lambda: r.axes.moving)
        at_mm = r.axes.at_mm[0]
        look = r.line.controller.look

        def die() -> None:
            monkeypatch.setattr(r.line.controller, "look", look)
            raise SystemExit

        monkeypatch.setattr(r.line.controller, "look", die)
        r.comes(State.FAULT)
        assert isinstance(way.exception(PATIENCE_S), ControllerFault)
        assert r.axes.at_mm[0] - at_mm < 10.0 * WITHIN_S
        answer(r)
        r.line.homing_confirmed = True
        assert comes_true(r.line.consent)
        r.line.go([(2.0, 2.0, -3.0)], FEED).result(PATIENCE_S)


def test_whatever_a_driver_raises_is_a_fault_and_a_stop(monkeypatch: pytest.MonkeyPatch) -> None:
    with rig("linuxcnc") as r:
        r.on_the_way()

        def broken() -> None:
            raise ZeroDivisionError("of the driver")

        monkeypatch.setattr(r.line.controller, "look", broken)
        r.comes(State.FAULT)
        assert "ZeroDivisionError" in r.line.why
        assert not r.axes.moving


LIVES = """
import sys, time
from drivers.motion import controller_of
from drivers.motion.controller import Limits
from drivers.motion.line import MotionLine
line = MotionLine(controller_of(sys.argv[1], Limits((-100.0,) * 3, (60.0,) * 3, 120.0, 6000.0)))
line.start()
line.homing_confirmed = True
while not line.consent():
    time.sleep(0.05)
line.go([(50.0, 2.0, -3.0)], 600.0)
end = time.monotonic() + 60.0
while time.monotonic() < end:
    line.alive()
    time.sleep(0.02)
    if line.state == "held":
        print(line.why, flush=True)
        line.close()
        break
"""


@LONG
@pytest.mark.parametrize("name", ["linuxcnc", "grbl"])
@pytest.mark.parametrize("way", ["SIGKILL", "SIGSTOP"])
@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_a_program_that_is_killed_or_suspended_leaves_no_machine_moving(
    name: str, way: str
) -> None:
    from tests.drivers.motion.twins import TWINS

    with closing(TWINS[name](FailingAxes())) as twin:
        program = subprocess.Popen(
            [sys.executable, "-c", LIVES, twin.endpoint], stdout=subprocess.PIPE, text=True
        )
        assert comes_true(lambda: twin.axes.moving)
        at_mm = twin.axes.at_mm[0]
        program.send_signal(getattr(signal, way))
        assert comes_true(lambda: not twin.axes.moving)
        assert twin.axes.at_mm[0] - at_mm < 10.0 * WITHIN_S
        if way == "SIGSTOP":
            time.sleep(0.5)
            program.send_signal(signal.SIGCONT)
            output, _ = program.communicate(timeout=PATIENCE_S)
            assert "the program did not run for" in output or "no sign of it" in output
            assert not twin.axes.moving
        else:
            program.communicate()


@pytest.mark.skipif(os.name != "posix", reason="links of folders")
def test_the_guard_runs_no_file_of_a_strange_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nor where an empty PYTHONPATH means the current folder."""
    for name in ("drivers/__init__", "calib", "serial", "socket", "app"):
        path = tmp_path / f"{name}.py"
        path.parent.mkdir(exist_ok=True)
        path.write_text("open('ran', 'w')\nraise SystemExit('a stranger ran')\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", "")
    with rig("linuxcnc") as r:
        r.go((2.0, 0.0, 0.0))
    assert not (tmp_path / "ran").exists()


def test_a_place_beside_the_way_is_a_stop() -> None:
    with rig("linuxcnc") as r:
        r.on_the_way()
        x, y, z = r.axes.at_mm
        r.axes.go((x, y + 30.0, z), 6000.0)
        r.comes(State.HELD)
        assert "mm of the way to X50.000" in r.line.why
        assert not r.axes.moving


@pytest.mark.parametrize("name", ["linuxcnc", "grbl"])
def test_a_controller_that_is_done_too_early_is_waited_for(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with rig(name) as r:
        monkeypatch.setattr(type(r.axes), "moving", property(lambda _: False))
        place = (11.0, 2.0, -3.0)  # a second's way
        assert r.go(place, feed=600.0) == pytest.approx(place, abs=0.01)


@pytest.mark.parametrize(
    ("place", "beside"), [((5.0, 0.0, 0.0), 0.0), ((5.0, 3.0, 4.0), 5.0), ((13.0, 4.0, 0.0), 5.0)]
)
def test_how_far_a_place_is_beside_a_way(place: tuple[float, ...], beside: float) -> None:
    from drivers.motion.supervision import beside as distance_beside

    x, y, z = place
    assert math.isclose(distance_beside((x, y, z), (0.0,) * 3, (10.0, 0.0, 0.0)), beside)


@pytest.mark.parametrize("before", [ready, consented, moving, stopped, held, fault])
def test_pairs_that_are_no_row_change_nothing(before: Act) -> None:
    with rig("linuxcnc") as r:
        before(r)
        state = r.line.state
        for cause, act in {
            Cause.CONSENT: r.line.consent,
            Cause.HOMING: lambda: r.line.consent(to_home=True),
            Cause.ANSWERED: r.line.answered,
            Cause.RELEASED: r.line.release,
            Cause.STOP: lambda: r.line.stop("a test"),
            Cause.VOUCHED: r.line.vouch,
        }.items():
            if (state, cause) not in TRANSITIONS and (state, cause) != (
                State.MOVING,
                Cause.RELEASED,
            ):
                act()  # of a machine that moves the end of its consent is a stop
                time.sleep(0.1)
                assert r.line.state is state, cause
