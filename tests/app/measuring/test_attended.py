"""What a press of the key that takes leads to, what is taken without one, and what waits."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from app.measuring import attended
from app.measuring.attended import AttendedSession, Press, TakenBy
from app.measuring.demo import demo_plan
from app.measuring.gauges import Live, Motion, Trace
from app.measuring.opening import start_session
from drivers.profile import Fault, FaultKind, IndicatorReading
from protocols.expectation import Movement


def shown(motion: Motion) -> Live:
    outcome = IndicatorReading("0.5", 0.5, 0.001, False)
    return Live(outcome, 0.0, motion, Trace)


@pytest.fixture
def driven(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[AttendedSession]:
    monkeypatch.setattr(attended, "HELD_KEY_S", 0.0)
    with start_session(demo_plan(tmp_path, "zero-max-min", 1)) as guided:
        yield AttendedSession(guided)


def test_a_press_takes_what_rests_and_the_second_one_what_moves(
    driven: AttendedSession, monkeypatch: pytest.MonkeyPatch
) -> None:
    ready = [True]
    monkeypatch.setattr(driven, "ready_by_hand", lambda: ready[0])
    rest = [shown(Motion.STABLE)] * 2
    assert driven.press(busy=True) is Press.REPEATS
    assert driven.press(busy=False) is Press.TAKES
    ready[0] = False
    assert driven.press(busy=False) is Press.MOVES
    assert driven.press(busy=False) is Press.TAKES
    driven.waits_for_press()
    assert driven.press(busy=False) is Press.MOVES
    assert not driven.settled(rest)
    ready[0] = True
    assert not driven.settled([shown(Motion.MOVING), shown(Motion.STABLE)])
    assert driven.settled(rest)
    assert not driven.settled(rest), "said once"
    monkeypatch.setattr(attended, "HELD_KEY_S", 60.0)
    assert driven.press(busy=False) is Press.REPEATS, "a key that is held"


def test_on_hold_nothing_is_taken_and_the_record_has_both(driven: AttendedSession) -> None:
    driven.hold(True, "on hold")
    assert driven.mode == "ON HOLD"
    assert driven.press(busy=False) is Press.ON_HOLD
    driven.hold(False, "continued")
    assert driven.press(busy=False) in (Press.TAKES, Press.MOVES)
    assert driven.guided.session.notes == ("on hold", "continued")


def test_by_itself_what_does_not_move_is_told_once(
    driven: AttendedSession, monkeypatch: pytest.MonkeyPatch
) -> None:
    moved = [Movement.UNCHANGED]
    monkeypatch.setattr(driven.guided, "moved", lambda: moved[0])
    rest = [shown(Motion.STABLE)] * 2
    assert driven.mode == "by hand"
    assert driven.by_itself(rest) is None, "by hand nothing is"
    driven.take_by_itself(True)
    assert driven.taken_by is TakenBy.INDICATORS
    assert driven.by_itself([shown(Motion.STABLE), shown(Motion.MOVING)]) is None
    assert driven.by_itself(rest) is Movement.UNCHANGED
    assert driven.by_itself(rest) is None
    moved[0] = Movement.UNKNOWN
    assert driven.by_itself(rest) is Movement.UNKNOWN
    by: TakenBy = driven.taken_by
    assert by is TakenBy.HAND, "the step says the same as the line below it"
    moved[0] = Movement.CONFIRMED
    assert driven.by_itself(rest) is Movement.CONFIRMED
    driven.by_hand()
    assert driven.by_itself(rest) is None


def test_a_fault_is_taken_at_once_to_be_shown(
    driven: AttendedSession, monkeypatch: pytest.MonkeyPatch
) -> None:
    fault = Live(Fault(FaultKind.NO_ANSWER, "", "no answer"), 0.0, Motion.FAULT, Trace)
    monkeypatch.setattr(driven, "live", lambda: [fault, shown(Motion.STABLE)])
    assert driven.ready_by_hand()
    monkeypatch.setattr(driven, "live", lambda: [fault, shown(Motion.MOVING)])
    assert not driven.ready_by_hand()
    assert driven.press(busy=False) is Press.LACKS_VALUE
    assert driven.press(busy=False) is Press.LACKS_VALUE, "no second press takes the other one"
