"""One controller, the thread that owns it, and the process that stops the machine without it."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing

import pytest

from drivers.motion import controller_of
from drivers.motion.controller import ControllerFault, Limits, MotionFault
from drivers.motion.line import MotionLine
from drivers.motion.twins import LinuxCncTwin, MotionTrouble, SimulatedAxes

LIMITS = Limits((-100.0,) * 3, (60.0,) * 3, longest_mm=120.0, fastest_mm_min=60_000.0)
FEED, SLOW = 6000.0, 120.0
PATIENCE_S = 10.0


@pytest.fixture
def twin() -> Iterator[LinuxCncTwin]:
    with closing(LinuxCncTwin(SimulatedAxes())) as twin:
        yield twin


@pytest.fixture
def line(twin: LinuxCncTwin) -> Iterator[MotionLine]:
    controller = controller_of(twin.told, LIMITS)
    controller.answer_s = 2.0
    line = MotionLine(controller)
    line.start()
    yield line
    line.close()


def comes_true(condition: Callable[[], bool]) -> bool:
    end = time.monotonic() + PATIENCE_S
    while not condition() and time.monotonic() < end:
        time.sleep(0.01)
    return condition()


def test_goes_by_way_of_places(line: MotionLine, twin: LinuxCncTwin) -> None:
    there = line.go([(-5.0, 0.0, 0.0), (0.0, 0.0, 0.0), (2.0, 0.0, 0.0)], FEED).result(PATIENCE_S)
    assert there == (2.0, 0.0, 0.0)
    assert [move.split()[-3] for move in twin.moves] == ["X-5.000000", "X0.000000", "X2.000000"]
    assert line.at(there).result(PATIENCE_S) == there


def test_stop_ends_all_that_was_asked(line: MotionLine, twin: LinuxCncTwin) -> None:
    asked = line.go([(50.0, 0.0, 0.0), (0.0, 0.0, 0.0)], SLOW)
    assert comes_true(lambda: twin.axes.moving)
    line.stop()
    with pytest.raises(ControllerFault) as said:
        asked.result(PATIENCE_S)
    assert said.value.kind is MotionFault.STOPPED
    assert len(twin.moves) == 1
    assert not twin.axes.moving
    assert line.go([(1.0, 0.0, 0.0)], FEED).result(PATIENCE_S) == (1.0, 0.0, 0.0)  # and goes on


def test_what_befalls_a_machine_at_rest_is_told(line: MotionLine, twin: LinuxCncTwin) -> None:
    told = threading.Event()
    line.listener = told.set
    twin.befall(MotionTrouble.NAK)
    assert told.wait(PATIENCE_S)
    assert line.fault is not None
    assert line.fault.kind is MotionFault.CONTROL_LOST


def test_nothing_moves_where_the_machine_is_not_ready(twin: LinuxCncTwin) -> None:
    twin.befall(MotionTrouble.NOT_HOMED)
    line = MotionLine(controller_of(twin.told, LIMITS))
    with pytest.raises(ControllerFault, match="home it"):
        line.start()
    line.close()
    assert not twin.moves


DIES = """
import sys, time
from drivers.motion import controller_of
from drivers.motion.controller import Limits
from drivers.motion.line import MotionLine
line = MotionLine(controller_of(sys.argv[1], Limits((-100.0,) * 3, (60.0,) * 3, 120.0, 6000.0)))
line.start()
line.go([(50.0, 0.0, 0.0)], 120.0)
time.sleep(60.0)
"""


def test_a_killed_program_leaves_no_machine_moving(twin: LinuxCncTwin) -> None:
    dying = subprocess.Popen([sys.executable, "-c", DIES, twin.told])
    assert comes_true(lambda: twin.axes.moving)
    dying.kill()
    dying.wait()
    assert comes_true(lambda: not twin.axes.moving)
    assert 0.0 < twin.axes.at_mm[0] < 49.0  # of 25 seconds


def test_control_that_another_client_has_is_told_before_it_is_taken(
    line: MotionLine, twin: LinuxCncTwin
) -> None:
    twin.befall(MotionTrouble.NAK)
    with pytest.raises(ControllerFault) as said:  # also where nobody looked in between
        line.go([(1.0, 0.0, 0.0)], FEED).result(PATIENCE_S)
    assert said.value.kind is MotionFault.CONTROL_LOST
    assert not twin.moves
    assert line.go([(1.0, 0.0, 0.0)], FEED).result(PATIENCE_S) == (1.0, 0.0, 0.0)


@pytest.mark.parametrize("trouble", [MotionTrouble.HANG_UP, MotionTrouble.NAK])
def test_the_next_move_begins_with_a_new_connection(
    line: MotionLine, twin: LinuxCncTwin, trouble: MotionTrouble
) -> None:
    twin.befall(trouble)
    with pytest.raises(ControllerFault) as said:
        line.at((0.0, 0.0, 0.0)).result(PATIENCE_S)
    assert said.value.kind in (MotionFault.LOST, MotionFault.CONTROL_LOST)
    assert line.go([(1.0, 0.0, 0.0)], FEED).result(PATIENCE_S) == (1.0, 0.0, 0.0)


def test_a_stop_ends_what_waits_behind_the_move_and_nothing_later(
    line: MotionLine, twin: LinuxCncTwin
) -> None:
    under_way = line.go([(50.0, 0.0, 0.0)], SLOW)
    behind = line.go([(-50.0, 0.0, 0.0)], SLOW)
    assert comes_true(lambda: twin.axes.moving)
    line.stop()
    later = line.go([(1.0, 0.0, 0.0)], FEED)  # asked before the stop was seen
    for stopped in (under_way, behind):
        with pytest.raises(ControllerFault, match="stopped"):
            stopped.result(PATIENCE_S)
    assert later.result(PATIENCE_S) == (1.0, 0.0, 0.0)
    assert len(twin.moves) == 2
