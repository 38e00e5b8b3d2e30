"""The driver against the code of real firmware: where the carriages are, their pulses tell."""

from __future__ import annotations

import math
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from app.measuring.unattended import measure_all
from drivers.motion import controller_of
from drivers.motion.controller import ControllerFault, Limits, MotionFault, Triple
from drivers.motion.line import STRICT, MotionLine, Patience
from drivers.motion.states import State
from protocols.record import read_record
from protocols.session import Reading
from tests.app.measuring.moving_machine import SHORT, Bench, moving_session, taken
from tests.conftest import LONG, ROOT
from tests.drivers.motion.bench import BUSY, comes_true, started
from tests.firmware.rig import (
    AT_POWER_ON_MM,
    HOLD,
    IN_JOINTS,
    OWN_NONE,
    PULSES_A_MM,
    RESET,
    TRAVEL_MM,
    Board,
    CountedAxes,
)
from tests.firmware.sources import FOLDER, SOURCES, folder_of_sources, need_firmware

pytestmark = LONG

if sys.platform == "win32":
    pytest.skip("Windows has no pseudo-terminals", allow_module_level=True)

firmwares = pytest.mark.parametrize("firmware", SOURCES)
WHOLE = Limits((0.0,) * 3, (TRAVEL_MM,) * 3, longest_mm=300.0, fastest_mm_min=60_000.0)
"""All that the board allows."""

FAR = (370.25, *AT_POWER_ON_MM[1:])
FEED = 3000.0
PATIENCE_S = 20.0
STOP_S = 0.5
SEES_S = 0.1
"""A busy computer runs a thread that sees a stop later than it was; the ways are of seconds."""

PULSE_MM = 1.0 / PULSES_A_MM
READ_MM = 2.0 * PULSE_MM
"""A reading follows a carriage that stands at a whole pulse, and so does its zero."""


class Rig:
    """A line that is started, the board behind it, and what stands for the screens."""

    def __init__(self, line: MotionLine, board: Board) -> None:
        self.line, self.board = line, board

    @property
    def joints_mm(self) -> Triple:
        return self.board.carriages.joints_mm

    def go(self, to_mm: Triple, feed: float = FEED) -> Triple:
        """With a consent of its own, to the end."""
        assert self.line.consent()
        there = self.line.go([to_mm], feed).result(PATIENCE_S)
        self.line.release()
        return there

    def on_the_way(self, feed: float = FEED) -> None:
        """A move of 57 mm is under way when this returns."""
        assert self.line.consent()
        self.line.go([FAR], feed)
        departed(self.board)

    def comes(self, *states: State) -> None:
        assert comes_true(lambda: self.line.state in states), (self.line.state, self.line.why)

    def rests_since(self, began_s: float) -> None:
        """At rest soon after that moment, on its way and not at its end."""
        time.sleep(STOP_S)
        assert self.board.carriages.changed_s - began_s < STOP_S
        assert self.joints_mm[0] < 350.0
        assert not self.board.carriages.moving


@contextmanager
def rig(
    firmware: str,
    *,
    homed: bool = True,
    unlocked: bool = False,
    confirmed: bool = True,
    patience: Patience = BUSY,
    settings: Mapping[str, int] = OWN_NONE,
) -> Iterator[Rig]:
    need_firmware(firmware)
    with closing(Board(firmware, homed=homed, unlocked=unlocked, settings=settings)) as board:
        controller = controller_of(board.endpoint, WHOLE)
        with started(controller, patience, homed=confirmed) as (line, _):
            yield Rig(line, board)


def off_mm(carriages: CountedAxes, place_mm: Triple) -> float:
    return max(abs(a - b) for a, b in zip(carriages.joints_mm, place_mm, strict=True))


def departed(board: Board, gone_mm: float = 5.0) -> None:
    def gone() -> bool:
        return math.dist(board.carriages.joints_mm, AT_POWER_ON_MM) > gone_mm

    assert comes_true(gone, 30.0), "it does not depart"


@firmwares
def test_goes_where_it_is_sent(firmware: str) -> None:
    with rig(firmware) as r:
        assert off_mm(r.board.carriages, AT_POWER_ON_MM) < PULSE_MM
        for place in ((300.0, 320.0, 310.0), (310.25, 310.25, 310.25), (311.0, 210.25, 370.25)):
            assert r.go(place, 2.0 * FEED) == pytest.approx(place, abs=PULSE_MM)
            assert off_mm(r.board.carriages, place) < PULSE_MM


@firmwares
def test_a_board_that_reports_inches_goes_as_far(firmware: str) -> None:
    with rig(firmware, settings={"13": 1}) as r:
        place = (300.0, 320.0, 310.0)
        assert r.go(place, 2.0 * FEED) == pytest.approx(place, abs=PULSE_MM)
        assert off_mm(r.board.carriages, place) < PULSE_MM


@firmwares
def test_stands_still_within_half_a_second_of_a_stop(firmware: str) -> None:
    with rig(firmware) as r:
        r.on_the_way()
        stopped_s = time.monotonic()
        r.line.stop("a test", by_operator=True)
        r.comes(State.STOPPED)
        r.rests_since(stopped_s)
        assert r.line.place_mm == pytest.approx(r.joints_mm, abs=PULSE_MM)
        assert len(r.board.moves) == 1


@firmwares
def test_what_follows_a_stop_begins_where_it_stands(firmware: str) -> None:
    with rig(firmware) as r:
        r.on_the_way()
        r.line.stop("a test", by_operator=True)
        r.comes(State.STOPPED)
        r.go(AT_POWER_ON_MM)
        assert off_mm(r.board.carriages, AT_POWER_ON_MM) < PULSE_MM


@firmwares
@pytest.mark.parametrize("place", [TRAVEL_MM + 1.0, -1.0])
def test_a_place_beyond_the_limits_of_the_board_is_refused(firmware: str, place: float) -> None:
    need_firmware(firmware)
    with closing(Board(firmware)) as board:
        controller = controller_of(board.endpoint, WHOLE)
        controller.answer_s = 2.0
        with closing(controller):
            controller.connect()
            controller.ready()
            before = board.carriages.joints_mm
            with pytest.raises(ControllerFault, match="soft limits") as refusal:
                controller.begin((place, 310.0, 310.0), FEED)
            assert refusal.value.kind is MotionFault.CONTROLLER
            assert board.carriages.joints_mm == before


@firmwares
def test_a_board_of_a_smaller_machine_is_refused(firmware: str) -> None:
    need_firmware(firmware)
    with closing(Board(firmware)) as board:
        wide = replace(WHOLE, high_mm=(TRAVEL_MM + 50.0,) * 3)
        line = MotionLine(controller_of(board.endpoint, wide))
        with pytest.raises(ControllerFault, match=r"\$130=400") as refusal:
            line.start()
        assert refusal.value.kind is MotionFault.STRANGER
        line.close()


@firmwares
def test_a_board_that_is_locked_is_homed_with_the_operators_consent_only(firmware: str) -> None:
    with rig(firmware, homed=False, confirmed=False) as r:
        assert r.line.state is State.FAULT
        assert "Alarm" in r.line.why
        assert r.line.can_home
        assert not r.line.consent()
        assert r.joints_mm == (0.0, 0.0, 0.0)
        assert r.line.consent(to_home=True)
        r.line.home().result(60.0)
        r.line.release()
        assert not r.line.needs_homing_confirmed
        r.board.carriages.homed()
        place = (60.0, 50.0, 40.0)
        assert r.go(place) == pytest.approx(place, abs=PULSE_MM)
        assert off_mm(r.board.carriages, place) < PULSE_MM


@firmwares
def test_a_homing_that_is_stopped_ends_within_half_a_second_and_homes_nothing(
    firmware: str,
) -> None:
    with rig(firmware, homed=False) as r:  # it was homed before, says its operator
        assert r.line.consent(to_home=True)
        homing = r.line.home()
        assert comes_true(lambda: r.joints_mm[0] < -2.0)
        stopped_s = time.monotonic()
        r.line.stop("a test", by_operator=True)
        assert isinstance(homing.exception(PATIENCE_S), ControllerFault)
        r.comes(State.FAULT)
        time.sleep(STOP_S)
        assert r.board.carriages.changed_s - stopped_s < STOP_S
        assert r.joints_mm[0] > -15.0  # the switches are at -20
        assert not r.line.homing_confirmed
        assert not r.line.consent()
        assert r.line.answered().exception(PATIENCE_S)
        assert r.line.can_home


def test_a_board_that_was_unlocked_waits_for_the_operators_word() -> None:
    """A grbl 1.1 does not tell a board that was never homed from one that was."""
    with rig("grbl", homed=False, unlocked=True, confirmed=False) as r:
        assert r.line.state is State.READY
        assert r.line.needs_homing_confirmed
        assert not r.line.consent()
        assert r.board.moves == []


def test_a_board_that_was_never_homed_and_reports_so_is_refused() -> None:
    """grblHAL, which is not locked at its start with $22=1."""
    need_firmware("grblHAL")
    with closing(Board("grblHAL", homed=False, settings={"22": 1})) as board:
        line = MotionLine(controller_of(board.endpoint, WHOLE))
        with pytest.raises(ControllerFault, match="H:0") as refusal:
            line.start()
        assert refusal.value.kind is MotionFault.NOT_READY
        line.close()


@firmwares
def test_the_reset_key_of_the_panel_is_a_fault(firmware: str) -> None:
    with rig(firmware) as r:
        r.on_the_way()
        pressed_s = time.monotonic()
        r.board.press(RESET)
        r.comes(State.FAULT)
        r.rests_since(pressed_s)
        r.board.press(0)
        assert isinstance(r.line.answered().exception(PATIENCE_S), ControllerFault)
        assert not r.line.consent()
        assert not r.line.homing_confirmed


@firmwares
def test_a_reset_at_rest_is_noticed(firmware: str) -> None:
    with rig(firmware) as r:
        r.board.from_elsewhere(b"\x18")
        r.comes(State.FAULT)
        assert "started anew" in r.line.why
        assert not r.line.homing_confirmed
        assert r.board.moves == []


@firmwares
def test_the_hold_key_of_the_panel_at_rest_is_noticed(firmware: str) -> None:
    with rig(firmware) as r:
        r.board.press(HOLD)
        r.comes(State.HELD, State.FAULT)
        assert "Hold" in r.line.why
        assert not r.line.consent()
        assert r.board.moves == []


def test_the_hold_key_of_the_panel_on_the_way_stops_grbl() -> None:
    """A grblHAL drops it in a jog."""
    with rig("grbl") as r:
        r.on_the_way()
        pressed_s = time.monotonic()
        r.board.press(HOLD)
        r.comes(State.HELD, State.FAULT)
        r.rests_since(pressed_s)


@firmwares
@pytest.mark.parametrize("by_operator", [False, True], ids=["seen in a look", "stopped at once"])
def test_a_move_that_waits_in_a_hold_never_starts(
    firmware: str, by_operator: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Pressed between the last look and the line: that has no answer, and ``~`` would start it."""
    with rig(firmware) as r:
        begin = r.line.controller.begin

        def late(to_mm: Triple, feed: float) -> None:
            r.board.from_elsewhere(b"!")
            time.sleep(0.1)
            begin(to_mm, feed)

        monkeypatch.setattr(r.line.controller, "begin", late)
        assert r.line.consent()
        way = r.line.go([FAR], FEED)
        if by_operator:
            assert comes_true(lambda: len(r.board.moves) == 1)
            r.line.stop("a test", by_operator=True)
        assert isinstance(way.exception(PATIENCE_S), ControllerFault)
        if not by_operator:
            r.comes(State.FAULT)
        assert len(r.board.moves) == 1
        r.board.from_elsewhere(b"~")
        time.sleep(1.0)
        assert off_mm(r.board.carriages, AT_POWER_ON_MM) < PULSE_MM


@firmwares
def test_an_offset_of_another_client_is_noticed_before_the_next_move(firmware: str) -> None:
    with rig(firmware) as r:
        r.board.from_elsewhere(b"G92X0Y0Z0\n")
        time.sleep(0.1)
        if r.line.consent():
            assert isinstance(r.line.go([FAR], FEED).exception(PATIENCE_S), ControllerFault)
        r.comes(State.HELD)
        assert r.board.moves == []
        assert "WCO" in r.line.why


@firmwares
def test_a_jog_of_another_client_is_noticed_at_rest(firmware: str) -> None:
    with rig(firmware) as r:
        r.board.from_elsewhere(b"$J=G91G21X1F600\n")
        r.comes(State.HELD)
        assert not r.line.consent()


@firmwares
@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGSTOP])
def test_without_its_guard_it_rests(firmware: str, end: signal.Signals) -> None:
    with rig(firmware, patience=STRICT) as r:
        assert comes_true(r.line.consent)
        r.line.go([FAR], FEED)
        departed(r.board)
        guard = r.line.guard
        assert guard is not None
        ended_s = time.monotonic()
        guard.process.send_signal(end)
        r.comes(State.FAULT)
        assert "guard" in r.line.why
        r.rests_since(ended_s)
        guard.process.send_signal(signal.SIGKILL)


LIVES = """
import sys, time
from drivers.motion import controller_of
from drivers.motion.controller import Limits
from drivers.motion.line import MotionLine
limits = Limits((0.0,) * 3, (400.0,) * 3, 120.0, 6000.0)
line = MotionLine(controller_of(sys.argv[1], limits))
line.start()
line.homing_confirmed = True
while not line.consent():
    time.sleep(0.05)
line.go([tuple(map(float, sys.argv[2:]))], 3000.0)
while True:
    line.alive()
    time.sleep(0.02)
"""


@firmwares
@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGSTOP])
def test_a_program_that_is_killed_or_suspended_leaves_the_machine_at_rest(
    firmware: str, end: signal.Signals
) -> None:
    need_firmware(firmware)
    with closing(Board(firmware)) as board:
        words = [sys.executable, "-c", LIVES, board.endpoint, *map(str, FAR)]
        program = subprocess.Popen(words, cwd=ROOT)
        try:
            departed(board)
            ended_s = time.monotonic()
            program.send_signal(end)
            assert comes_true(lambda: not board.carriages.moving)
            assert board.carriages.changed_s - ended_s < STOP_S
            time.sleep(STOP_S)
            assert not board.carriages.moving
            assert board.carriages.joints_mm[0] < 350.0
        finally:
            program.kill()
            program.wait()


def wrong(readings: tuple[Reading, ...], bench: Bench) -> list[str]:
    """Readings that are not those of the posture that the record says."""
    differences = []
    for reading in readings:
        leg, axis = "xyz".index(reading.leg), "xyz".index(reading.axis)
        tool = [0.0, 0.0, 0.0]
        tool[leg] = reading.displacement_mm
        right = bench.reading_mm(leg, axis, reading.station, (tool[0], tool[1], tool[2]))
        if abs(reading.value_mm - right) > READ_MM:
            differences.append(f"step {reading.step}: {reading.value_mm} for {right:.4f}")
    return differences


@firmwares
def test_a_whole_session(firmware: str, tmp_path: Path) -> None:
    need_firmware(firmware)
    path = tmp_path / "a.jsonl"
    with moving_session(path, IN_JOINTS, SHORT, lambda _: Board(firmware)) as real:
        guided, bench, _ = real
        measure_all(guided, bench.agree, lambda _: None)
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
