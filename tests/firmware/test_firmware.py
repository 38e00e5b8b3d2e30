"""The driver against the code of real firmware: where the carriages are, their pulses tell."""

from __future__ import annotations

import math
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from app.measuring.moving import check_motion
from app.measuring.unattended import measure_all
from drivers.motion import controller_of
from drivers.motion.controller import Controller, ControllerFault, Limits, MotionFault, Triple
from protocols.record import read_record
from protocols.session import Reading
from tests.app.measuring.moving_machine import SHORT, Bench, moving_session, taken
from tests.conftest import ROOT
from tests.firmware.rig import (
    AT_POWER_ON_MM,
    HOLD,
    IN_JOINTS,
    PULSES_A_MM,
    RESET,
    TRAVEL_MM,
    Board,
    CountedAxes,
)
from tests.firmware.sources import FOLDER, SOURCES, folder_of_sources, need_firmware

if sys.platform == "win32":
    pytest.skip("Windows has no pseudo-terminals", allow_module_level=True)

every = pytest.mark.parametrize(
    "firmware",
    [
        "grbl",
        pytest.param(
            "grblHAL",
            marks=pytest.mark.xfail(
                raises=ControllerFault,
                reason="the driver takes $22=1 only, and $22 is a mask in grblHAL",
                strict=True,
            ),
        ),
    ],
)
WIDE = Limits((-50.0,) * 3, (450.0,) * 3, longest_mm=300.0, fastest_mm_min=60_000.0)
"""Beyond what the board allows."""

FEED = 3000.0
PATIENCE_S = 2.0
STOP_S = 0.5
PULSE_MM = 1.0 / PULSES_A_MM
READ_MM = 2.0 * PULSE_MM
"""A reading follows a carriage that stands at a whole pulse, and so does its zero."""


@contextmanager
def beside(
    firmware: str, *, homed: bool = True, ready: bool = True
) -> Iterator[tuple[Controller, Board]]:
    need_firmware(firmware)
    with closing(Board(firmware, homed=homed)) as board:
        controller = controller_of(board.told, WIDE)
        controller.answer_s = PATIENCE_S
        with closing(controller):
            controller.connect()
            if ready:
                controller.ready()
            yield controller, board


def off_mm(carriages: CountedAxes, place_mm: Triple) -> float:
    return max(abs(a - b) for a, b in zip(carriages.joints_mm, place_mm, strict=True))


def on_the_way(board: Board, from_mm: Triple, gone_mm: float) -> None:
    end = time.monotonic() + PATIENCE_S
    while math.dist(board.carriages.joints_mm, from_mm) < gone_mm:
        assert time.monotonic() < end, "it does not depart"
        time.sleep(0.002)


class Move(threading.Thread):
    """A move in the thread that owns the controller, and what became of it."""

    def __init__(self, controller: Controller, to_mm: Triple, feed_mm_min: float) -> None:
        super().__init__(daemon=True)
        self._go: Callable[[], Triple] = lambda: controller.move_to(to_mm, feed_mm_min)
        self.problem: ControllerFault | None = None
        self.start()

    def run(self) -> None:
        try:
            self._go()
        except ControllerFault as problem:
            self.problem = problem

    def fault(self) -> ControllerFault:
        self.join(10.0)
        assert not self.is_alive()
        assert self.problem is not None
        return self.problem


@every
def test_goes_where_it_is_told(firmware: str) -> None:
    with beside(firmware) as (controller, board):
        assert off_mm(board.carriages, AT_POWER_ON_MM) < PULSE_MM
        for place in ((300.0, 320.0, 310.0), (310.25, 310.25, 310.25), (311.0, 210.25, 370.25)):
            read_back = controller.move_to(place, 2.0 * FEED)
            assert read_back == pytest.approx(place, abs=PULSE_MM)
            assert off_mm(board.carriages, place) < PULSE_MM


@every
def test_stands_still_within_half_a_second_of_a_stop(firmware: str) -> None:
    with beside(firmware) as (controller, board):
        move = Move(controller, (370.25, *AT_POWER_ON_MM[1:]), FEED)
        on_the_way(board, AT_POWER_ON_MM, 5.0)
        stopped_s = time.monotonic()
        controller.halt.set()
        assert move.fault().kind is MotionFault.STOPPED
        time.sleep(STOP_S)
        assert board.carriages.changed_s - stopped_s < STOP_S
        there = board.carriages.joints_mm
        assert there[0] < 350.0  # a second of the way was left
        assert controller.position() == pytest.approx(there, abs=PULSE_MM)
        assert len(board.moves) == 1


@every
def test_what_follows_a_stop_begins_where_it_stands(firmware: str) -> None:
    with beside(firmware) as (controller, board):
        move = Move(controller, (370.25, *AT_POWER_ON_MM[1:]), FEED)
        on_the_way(board, AT_POWER_ON_MM, 5.0)
        controller.halt.set()
        move.fault()
        controller.halt.clear()
        controller.ready()
        controller.move_to(AT_POWER_ON_MM, FEED)
        assert off_mm(board.carriages, AT_POWER_ON_MM) < PULSE_MM


@every
@pytest.mark.parametrize("place", [TRAVEL_MM + 1.0, -1.0])
def test_a_place_beyond_the_limits_of_the_board_is_refused(firmware: str, place: float) -> None:
    with beside(firmware) as (controller, board):
        near = TRAVEL_MM - 1.0 if place > TRAVEL_MM else 150.0
        controller.move_to((near, 310.0, 310.0), 9000.0)
        before = board.carriages.joints_mm
        with pytest.raises(ControllerFault, match="soft limits") as caught:
            controller.move_to((place, 310.0, 310.0), FEED)
        assert caught.value.kind is MotionFault.CONTROLLER
        assert board.carriages.joints_mm == before


@pytest.mark.parametrize("firmware", SOURCES)
def test_a_board_that_is_not_homed_is_refused(firmware: str) -> None:
    with beside(firmware, homed=False, ready=False) as (controller, board):
        with pytest.raises(ControllerFault, match="Alarm") as caught:
            controller.ready()
        assert caught.value.kind is MotionFault.NOT_READY
        assert board.carriages.joints_mm == (0.0, 0.0, 0.0)
        assert board.moves == []


@every
def test_the_reset_key_of_the_panel_is_a_fault(firmware: str) -> None:
    with beside(firmware) as (controller, board):
        move = Move(controller, (370.25, *AT_POWER_ON_MM[1:]), FEED)
        on_the_way(board, AT_POWER_ON_MM, 5.0)
        pressed_s = time.monotonic()
        board.press(RESET)
        assert move.fault().kind is MotionFault.CONTROLLER
        time.sleep(STOP_S)
        assert board.carriages.changed_s - pressed_s < STOP_S
        board.press(0)
        with pytest.raises(ControllerFault, match="Alarm"):
            controller.ready()


@every
def test_the_hold_key_of_the_panel_at_rest_is_noticed_before_a_move(firmware: str) -> None:
    """A line that is sent in a hold has no answer, and moves the machine when the hold ends."""
    with beside(firmware) as (controller, board):
        board.press(HOLD)
        time.sleep(0.2)
        with pytest.raises(ControllerFault, match="Hold"):
            controller.ready()
        assert board.moves == []


DIES = """
import sys, time
from drivers.motion import controller_of
from drivers.motion.controller import Limits
from drivers.motion.line import MotionLine
limits = Limits((0.0,) * 3, (400.0,) * 3, 120.0, 6000.0)
line = MotionLine(controller_of(sys.argv[1], limits))
line.start()
line.go([(370.25, float(sys.argv[2]), float(sys.argv[3]))], 300.0)
time.sleep(60.0)
"""


def test_a_killed_program_leaves_the_machine_at_rest() -> None:
    need_firmware("grbl")
    with closing(Board("grbl")) as board:
        y, z = map(str, AT_POWER_ON_MM[1:])
        dying = subprocess.Popen([sys.executable, "-c", DIES, board.told, y, z], cwd=ROOT)
        end = time.monotonic() + 30.0
        while math.dist(board.carriages.joints_mm, AT_POWER_ON_MM) < 2.0:
            assert time.monotonic() < end, "it does not depart"
            time.sleep(0.002)
        dying.kill()
        killed_s = time.monotonic()
        dying.wait()
        time.sleep(2.0)
        assert not board.carriages.moving
        # the guard is a program that starts with Python's own slowness; the way was eleven seconds
        assert board.carriages.changed_s - killed_s < 1.0
        assert board.carriages.joints_mm[0] < AT_POWER_ON_MM[0] + 10.0


def wrong(readings: tuple[Reading, ...], bench: Bench) -> list[str]:
    """Readings that are not those of the posture that the record says."""
    left = []
    for reading in readings:
        leg, axis = "xyz".index(reading.leg), "xyz".index(reading.axis)
        tool = [0.0, 0.0, 0.0]
        tool[leg] = reading.displacement_mm
        right = bench.reading_mm(leg, axis, reading.station, (tool[0], tool[1], tool[2]))
        if abs(reading.value_mm - right) > READ_MM:
            left.append(f"step {reading.step}: {reading.value_mm} for {right:.4f}")
    return left


def ready_board(firmware: str) -> Board:
    """One that the driver takes: what it refuses is known before indicators are asked."""
    board = Board(firmware)
    try:
        check_motion(board.told, IN_JOINTS)
    except ControllerFault:
        board.close()
        raise
    return board


@every
def test_a_whole_session(firmware: str, tmp_path: Path) -> None:
    need_firmware(firmware)
    path = tmp_path / "a.jsonl"
    with moving_session(path, IN_JOINTS, SHORT, lambda _: ready_board(firmware)) as real:
        guided, bench, _ = real
        measure_all(guided, bench.set_up, lambda _: None)
        readings = taken(path)
        assert wrong(readings, bench) == []
    assert read_record(path).end == "closed"
    assert len(readings) == len(SHORT.steps(IN_JOINTS.geometry(), ("xyz", "xyz"))) * 2
    assert {reading.moved.driver for reading in readings if reading.moved} == {"grbl"}


def test_without_sources_it_is_said_what_to_put_where(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv(FOLDER, str(tmp_path))
    (tmp_path / "grbl").mkdir()
    with pytest.raises(pytest.skip.Exception, match=f"grbl-sim into {tmp_path}.*{FOLDER}"):
        need_firmware("grbl")
    monkeypatch.delenv(FOLDER)
    assert folder_of_sources() == ROOT.parent / "firmware"
