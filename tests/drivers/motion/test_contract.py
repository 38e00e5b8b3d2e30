"""One contract for every controller: the real driver against its own twin."""

from __future__ import annotations

import math
import os
import re
import socket
import threading
import time
from contextlib import closing
from dataclasses import replace
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import serial

from calib.errors import UsageError
from drivers.motion import controller_of
from drivers.motion.controller import ControllerFault, MotionFault, Triple
from drivers.motion.guard import DETACHED
from drivers.motion.states import State
from tests.drivers.motion.bench import (
    FEED,
    LIMITS,
    PATIENCE_S,
    SLOW,
    START,
    beside,
    comes_true,
    rests,
    rig,
)
from tests.drivers.motion.twins import (
    TWINS,
    FailingAxes,
    FailingLinuxCnc,
    GrblTwin,
    MotionTrouble,
    MotionTwin,
)

controllers = pytest.mark.parametrize("name", TWINS)


@controllers
def test_goes_where_it_is_sent_and_reads_back(name: str) -> None:
    with rig(name) as r:
        for to in ((10.0, 0.25, -4.5), (10.0, 0.25, -4.5), START):
            assert r.go(to) == to
            assert not r.axes.moving
            assert r.axes.at_mm == to
            assert r.line.at(to).result(PATIENCE_S) == to
        assert len(r.twin.moves) == 3


@controllers
def test_waits_for_the_end(name: str) -> None:
    with rig(name) as r:
        began = time.monotonic()
        r.go((1.0, 2.0, 0.0), feed=SLOW)
        assert time.monotonic() - began >= 3.0 / 5.0
        assert not r.axes.moving


@controllers
def test_an_inch_machine_moves_as_far_as_any(name: str) -> None:
    def inch(axes: FailingAxes) -> MotionTwin:
        twin = TWINS[name](axes)
        twin.befall(MotionTrouble.INCH)
        return twin

    with rig(name, make=inch) as r:
        there = r.go((11.0, 2.0, -3.0))
        assert there == pytest.approx((11.0, 2.0, -3.0), abs=0.02)  # grbl: a thousandth of an inch
        assert r.axes.at_mm == pytest.approx((11.0, 2.0, -3.0), abs=1e-9)


def test_a_feed_is_of_mm_also_where_inches_were_in_force() -> None:
    """LinuxCNC takes F before G21 of the same line: 25.4 times as fast (tried with 2.9)."""
    with rig("linuxcnc") as r:
        began = time.monotonic()
        r.go((6.0, 2.0, -3.0), feed=600.0)
        assert time.monotonic() - began >= 0.5  # 5 mm at 10 mm/s


@controllers
@pytest.mark.parametrize(
    ("to", "feed"),
    [
        ((60.001, 0.0, 0.0), FEED),
        ((0.0, -100.001, 0.0), FEED),
        ((0.0, math.nan, 0.0), FEED),
        ((-100.0, -100.0, 60.0), FEED),  # inside, but too far at once
        ((0.0, 0.0, 0.0), 0.0),
        ((0.0, 0.0, 0.0), -1.0),
        ((0.0, 0.0, 0.0), math.nan),
        ((0.0, 0.0, 0.0), 60_001.0),
    ],
)
def test_nothing_is_sent_outside_the_limits(name: str, to: Triple, feed: float) -> None:
    with rig(name) as r:
        r.consent()
        with pytest.raises(ControllerFault, match=r"machine file") as refusal:
            r.line.go([to], feed).result(PATIENCE_S)
        assert refusal.value.kind is MotionFault.OUTSIDE
        assert not r.twin.moves
        assert r.axes.at_mm == START


STRANGERS = {
    "four joints": ({"[KINS]JOINTS": 4.0}, r"\[KINS\]JOINTS 4"),
    "a longer box": ({"[JOINT_1]MAX_LIMIT": 59.0}, r"\[JOINT_1\] from -1000 to 59 mm"),
    "a deeper box": ({"[JOINT_2]MIN_LIMIT": -99.0}, r"\[JOINT_2\] from -99 to 1000 mm"),
}


@pytest.mark.parametrize("stranger", STRANGERS)
@pytest.mark.parametrize("inch", [False, True], ids=["mm", "inch"])
def test_another_machine_behind_linuxcnc_is_refused(stranger: str, inch: bool) -> None:
    numbers, words = STRANGERS[stranger]

    def other(axes: FailingAxes) -> MotionTwin:
        twin = FailingLinuxCnc(axes)
        twin.ini |= numbers
        if inch:
            twin.befall(MotionTrouble.INCH)
        return twin

    with rig("linuxcnc", make=other) as r:
        r.consent()
        with pytest.raises(ControllerFault, match=words) as refusal:
            r.line.go([(10.0, 0.0, 0.0)], FEED).result(PATIENCE_S)
        assert refusal.value.kind is MotionFault.STRANGER
        r.comes(State.FAULT)
        assert not r.twin.moves
        assert r.axes.at_mm == START


def test_limits_that_no_one_states_or_that_another_screen_heard_bind_nothing() -> None:
    def silent(axes: FailingAxes) -> MotionTwin:
        twin = FailingLinuxCnc(axes)
        twin.ini = {}
        return twin

    for make in (silent, Overheard):
        with rig("linuxcnc", make=make) as r:
            assert r.go((10.0, 0.0, 0.0)) == (10.0, 0.0, 0.0)


class Overheard(FailingLinuxCnc):
    """A screen beside the server reads each message first."""

    def _mdi(self, line: str) -> None:
        super()._mdi(line)
        self.display.clear()


def test_the_last_micrometres_behind_idle_are_no_offset_and_are_waited_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """LinuxCNC tells IDLE while it creeps on: 0.007 mm between two answers, at 50 mm/s."""
    with rig("linuxcnc") as r:
        r.go((10.0, 0.0, 0.0))
        monkeypatch.setattr(type(r.axes), "moving", property(lambda _: False))
        # 90 ms, by 4 µm between two answers, twice of what counts as still: it is waited for whole
        r.axes.go((10.036, 0.0, 0.0), 24.0)
        there = r.line.controller
        snapshots = []
        r.line.ask(lambda: snapshots.append(there.settle()) or (0.0,) * 3).result(PATIENCE_S)  # type: ignore[func-returns-value]
        assert snapshots[0].place_mm == (10.036, 0.0, 0.0)
        assert snapshots[0].states["offset"] == "0.000 0.000 0.000"


def test_diameters_of_another_client_halve_no_way() -> None:
    with rig("linuxcnc") as r:
        codes = r.twin.state["program_codes"]  # type: ignore[attr-defined]
        r.twin.state["program_codes"] = codes.replace("G8", "G7")  # type: ignore[attr-defined]
        r.go((10.0, 0.0, 0.0))
        assert "G8" in r.twin.state["program_codes"].split()  # type: ignore[attr-defined]


@controllers
@pytest.mark.parametrize(
    "trouble", [MotionTrouble.NOT_HOMED, MotionTrouble.OFF, MotionTrouble.ESTOP]
)
def test_a_machine_that_is_not_ready(name: str, trouble: MotionTrouble) -> None:
    with beside(name) as (controller, twin):
        twin.befall(trouble)
        with pytest.raises(ControllerFault) as fault:
            controller.ready()
        assert fault.value.kind in (MotionFault.NOT_READY, MotionFault.CONTROLLER)
        assert not twin.moves


STOPPED_BY = {
    MotionTrouble.ESTOP: State.FAULT,
    MotionTrouble.FOLLOWING: State.FAULT,
    MotionTrouble.NAK: None,
    MotionTrouble.HANG_UP: State.FAULT,
    MotionTrouble.MODE: None,
    MotionTrouble.UNHOMED: None,
    MotionTrouble.OVERRIDE: State.HELD,
    MotionTrouble.FEED_HOLD: None,
}
"""What the operator meets; None: held or a fault, as the controller tells it."""


@controllers
@pytest.mark.parametrize("trouble", STOPPED_BY)
def test_trouble_on_the_way_stops_it(name: str, trouble: MotionTrouble) -> None:
    with rig(name) as r:
        r.on_the_way()
        r.twin.befall(trouble)
        if name == "grbl" and trouble is MotionTrouble.HANG_UP:  # a cable that is out ends nothing
            assert comes_true(lambda: "Use the emergency stop" in r.line.why)
            assert r.line.not_stopped
            r.line.vouch()
            r.comes(State.FAULT)
            return
        assert comes_true(lambda: r.line.state in (State.HELD, State.FAULT)), r.line.why
        assert r.line.state is (STOPPED_BY[trouble] or r.line.state), r.line.why
        assert r.line.why
        assert rests(r.axes)
        assert 1.0 < r.axes.at_mm[0] < 49.0


@controllers
def test_a_controller_that_falls_silent_is_not_stopped_and_says_so(name: str) -> None:
    with rig(name, answer_s=0.2) as r:
        r.on_the_way()
        r.twin.befall(MotionTrouble.SILENCE)
        assert comes_true(lambda: r.line.not_stopped)
        assert comes_true(lambda: "NOT STOPPED. Use the emergency stop." in r.line.why)
        r.twin.mend()
        r.comes(State.FAULT)
        assert not r.axes.moving


def test_an_acknowledgement_that_is_lost_is_asked_for_again() -> None:
    class Interrupted(GrblTwin):
        def answer(self, line: str) -> str:
            reply = super().answer(line)
            if line.startswith("$J"):
                self.befall(MotionTrouble.SILENCE)
            return reply

    with rig("grbl", answer_s=0.2, make=lambda axes: Interrupted(axes, "tcp")) as r:
        r.on_the_way()
        assert comes_true(lambda: "NOT STOPPED. Use the emergency stop." in r.line.why)
        r.twin.mend()
        r.comes(State.FAULT)
        assert not r.axes.moving
        assert r.line.answered().result(PATIENCE_S) == pytest.approx(r.axes.at_mm, abs=0.001)


@controllers
def test_who_leaves_a_machine_that_is_not_seen_to_rest_reads_that(name: str) -> None:
    with rig(name, answer_s=0.2) as r:
        r.on_the_way()
        r.twin.befall(MotionTrouble.SILENCE)
        r.line.close()
        assert r.line.not_stopped
        assert r.line.why.startswith("NOT STOPPED. Use the emergency stop.")
        r.twin.mend()
        assert comes_true(lambda: all(guard.poll() is not None for guard in DETACHED))


@controllers
def test_stops_short(name: str) -> None:
    with rig(name) as r:
        r.twin.befall(MotionTrouble.ELSEWHERE)
        r.consent()
        with pytest.raises(ControllerFault, match=r"X10\.500 Y0\.000 Z0\.000 in place of X10\.000"):
            r.line.go([(10.0, 0.0, 0.0)], FEED).result(PATIENCE_S)
        r.comes(State.HELD)


@controllers
@pytest.mark.parametrize("coordinate", range(3))
def test_a_place_that_is_no_number_is_a_fault(
    coordinate: int, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = tuple(math.nan if k == coordinate else mm for k, mm in enumerate(START))
    with rig(name) as r:
        monkeypatch.setattr(type(r.axes), "at_mm", property(lambda _: place), raising=True)
        r.comes(State.FAULT)
        assert "Allowed: a number" in r.line.why


@controllers
@pytest.mark.parametrize(
    "trouble",
    [MotionTrouble.MODE, MotionTrouble.UNHOMED, MotionTrouble.OVERRIDE, MotionTrouble.OFFSET],
)
def test_what_others_change_at_rest_is_noticed_before_anything_moves(
    name: str, trouble: MotionTrouble
) -> None:
    with rig(name) as r:
        r.go((10.0, 0.0, 0.0))
        r.consent()
        r.twin.befall(trouble)
        with pytest.raises(ControllerFault):
            r.line.go([(20.0, 0.0, 0.0)], FEED).result(PATIENCE_S)
        assert len(r.twin.moves) == 1
        assert comes_true(lambda: r.line.state in (State.HELD, State.FAULT))
        assert not r.line.consent()


@controllers
def test_what_others_change_at_rest_is_noticed_without_a_move(name: str) -> None:
    with rig(name) as r:
        r.twin.befall(MotionTrouble.OFFSET)
        r.comes(State.HELD)
        assert "-5.000" in r.line.why


@controllers
def test_somebody_else_moved_it(name: str) -> None:
    with rig(name) as r:
        r.go((10.0, 0.0, 0.0))
        r.axes.go((10.02, 0.0, 0.0), 1e9)
        r.comes(State.HELD)
        assert "X10.020 Y0.000 Z0.000 in place of X10.000" in r.line.why


def test_a_second_client_is_noticed() -> None:
    with rig("linuxcnc") as r:
        second = controller_of(r.twin.endpoint, LIMITS)
        second.connect()
        r.comes(State.HELD)
        assert "another client has control" in r.line.why
        second.close()


def test_an_answer_that_came_while_the_program_was_held_up_counts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A second passes whenever the clock is asked, more than an answer may take."""
    with beside("linuxcnc") as (controller, _):
        controller.answer_s = 0.4
        seconds = SimpleNamespace(monotonic=count().__next__)
        monkeypatch.setattr("drivers.motion.controller.time", seconds)
        monkeypatch.setattr("drivers.motion.linuxcnc.SLICE_S", 2.0)
        assert controller.look().place_mm == START


def test_password_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    for words in ("WRONG EMCTOO", "EMC WRONG"):
        monkeypatch.setenv("GLIDECAL_LINUXCNC_PASSWORDS", words)
        with pytest.raises(ControllerFault, match="password") as fault, beside("linuxcnc"):
            pass
        assert fault.value.kind is MotionFault.REFUSED


@pytest.mark.parametrize(
    ("words", "why"),
    [
        ("linuxcnc:127.0.0.1:9", "Is linuxcncrsh running there"),
        ("linuxcnc:127.0.0.1:x", "Allowed: 1 … 65535"),
        ("linuxcnc:[::1]:9", "Is linuxcncrsh running there"),
        ("linuxcnc:[::1", "Is linuxcncrsh running there"),
        ("linuxcnc:a..b:5007", "no name of a computer"),
        (f"linuxcnc:{'a' * 70}.b:5007", "no name of a computer"),
        ("linuxcnc:\0:5007", "Is linuxcncrsh running there"),
        ("linuxcnc:/dev/ttyACM0", "'/dev/ttyACM0', no name of a computer"),
        ("grbl:/dev/none", "cannot be reached: found no such port"),
        ("grbl:socket://127.0.0.1:9", "found no device answers at this address"),
        ("grbl:spy://x", "cannot be reached: found 'spy'"),
    ],
)
def test_nobody_there(words: str, why: str) -> None:
    controller = controller_of(words, LIMITS)
    with pytest.raises(ControllerFault, match=re.escape(why)) as refusal:
        controller.connect()
    assert refusal.value.kind is MotionFault.UNREACHABLE


@pytest.mark.skipif(os.name != "posix", reason="Windows has no files that are ports")
def test_a_file_is_no_port_of_a_board(tmp_path: Path) -> None:
    plain = tmp_path / "plain.txt"
    plain.write_text("kept")
    for path in (plain, tmp_path, Path(os.devnull)):
        with pytest.raises(ControllerFault, match="cannot be reached: found no serial port"):
            controller_of(f"grbl:{path}", LIMITS).connect()
    assert plain.read_text() == "kept"


@pytest.mark.parametrize("hangs_up", [True, False])
def test_a_server_that_is_no_linuxcnc_is_asked_about(
    hangs_up: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drivers.motion.linuxcnc.CONNECT_S", 0.3)
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            client, _ = server.accept()
            client.recv(100)
            if hangs_up:
                client.close()
            clients.append(client)

        clients: list[socket.socket] = []
        thread = threading.Thread(target=serve)
        thread.start()
        port = server.getsockname()[1]
        with pytest.raises(ControllerFault, match="Is linuxcncrsh running there"):
            controller_of(f"linuxcnc:127.0.0.1:{port}", LIMITS).connect()
        thread.join()
        clients[0].close()


@pytest.mark.parametrize("address", ["linuxcnc", "linuxcnc:", "klipper:/dev/x", ""])
def test_unknown_controllers(address: str) -> None:
    with pytest.raises(UsageError, match="linuxcnc:HOST:PORT or grbl:PORT"):
        controller_of(address, LIMITS)


@pytest.mark.skipif(os.name != "posix", reason="pseudo-terminals")
def test_grbl_over_a_terminal() -> None:
    with rig("grbl", make=lambda axes: GrblTwin(axes, "pty")) as r:
        assert r.go((3.0, 2.0, -3.0)) == (3.0, 2.0, -3.0)


def test_the_port_of_a_board_is_opened_once_and_without_dtr(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A board that resets when its port is opened loses its homing."""
    opened: list[tuple[bool, bool]] = []
    open_port = serial.serial_for_url

    def recorded(*words: Any, **settings: Any) -> serial.Serial:  # noqa: ANN401 (pyserial's)
        port = open_port(*words, **settings)
        open_now = port.open

        def open_it() -> None:
            opened.append((port.dtr, port.rts))
            open_now()

        port.open = open_it  # type: ignore[method-assign]
        return port

    monkeypatch.setattr("serial.serial_for_url", recorded)
    with rig("grbl") as r:
        r.twin.befall(MotionTrouble.OFFSET)
        r.comes(State.HELD)
        r.twin.mend()
        r.line.answered().result(PATIENCE_S)
        r.go((3.0, 2.0, -3.0))
        descriptor = r.line.controller.handles()
        assert descriptor  # what the guard speaks through
    assert opened == [(False, False)]


def test_grbl_knows_no_tool() -> None:
    with pytest.raises(ControllerFault, match='mdi = "tool" in the machine file'):
        controller_of("grbl:/dev/none", replace(LIMITS, coordinates="tool"))


def test_bytes_of_the_text_server() -> None:
    """As LinuxCNC 2.9 answered them, recorded with a client of its own."""
    recorded = [
        ("hello WRONG me 1", b"HELLO NAK\r\n"),
        ("hello EMC me 1", b"HELLO ACK EMCNETSVR 1.1\r\n"),
        ("set echo off", b"set echo off\n"),
        ("get enable", b"ENABLE OFF\r\n"),
        ("set enable WRONG", b"SET ENABLE NAK\n\r"),
        ("set verbose on", b"SET VERBOSE ACK\n\r"),
        ("set enable EMCTOO", b"SET ENABLE ACK\n\r"),
        ("get joint_homed", b"JOINT_HOMED YES YES YES NO NO NO\r\n"),
        ("get user_linear_units", b"USER_LINEAR_UNITS MM\r\n"),
        ("get nonsense", b"GET NONSENSE NAK\r\n\r\n"),
        ("get error", b"ERROR OK\r\n"),
        ("set mdi G21 G90 G53 G1 F0 X0 Y0 Z0", b"SET MDI ACK\n\r"),
        ("get error", b"ERROR Cannot do g1 with zero feed rate\r\n"),
        ("get operator_display", b"OPERATOR_DISPLAY OK\r\n"),
        (
            "set mdi (DEBUG,glidecal #<_ini[KINS]JOINTS> #<_ini[JOINT_4]MIN_LIMIT>)",
            b"SET MDI ACK\n\r",
        ),
        ("get operator_display", b"OPERATOR_DISPLAY glidecal 3.000000 ######\r\n"),
        ("get operator_display", b"OPERATOR_DISPLAY OK\r\n"),
        ("set enable off", b"SET ENABLE ACK\n\r"),
        ("get enable", b"ENABLE OFF\r\n"),
        (
            "get abs_act_pos",
            b"ABS_ACT_POS 1.000000 2.000000 -3.000000 0.000000 0.000000 0.000000\r\n",
        ),
    ]
    with closing(FailingLinuxCnc(FailingAxes(START))) as twin:
        host, _, port = twin.address.partition(":")
        with socket.create_connection((host, int(port)), timeout=2.0) as client:
            for request, answer in recorded:
                client.sendall(request.encode() + b"\n")
                content = b""
                while len(content) < len(answer):
                    content += client.recv(4096)
                assert content == answer, request
