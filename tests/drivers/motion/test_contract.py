"""One contract for every controller: the real driver against its own twin."""

from __future__ import annotations

import math
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from itertools import count
from types import SimpleNamespace

import pytest

from calib.errors import UsageError
from drivers.motion import controller_of
from drivers.motion.controller import Controller, ControllerFault, Limits, MotionFault, Triple
from drivers.motion.twins import (
    TWINS,
    GrblTwin,
    LinuxCncTwin,
    MotionTrouble,
    MotionTwin,
    SimulatedAxes,
)

LIMITS = Limits((-100.0,) * 3, (60.0,) * 3, longest_mm=120.0, fastest_mm_min=60_000.0)
START = (1.0, 2.0, -3.0)
FEED = 6000.0
PATIENCE_S = 2.0  # of a busy machine
SLOW = 300.0  # 5 mm/s: nothing that is tested here arrives

every = pytest.mark.parametrize("name", TWINS)


@contextmanager
def beside(name: str, *troubles: MotionTrouble) -> Iterator[tuple[Controller, MotionTwin]]:
    twin = TWINS[name](SimulatedAxes(START))
    for trouble in troubles:
        twin.befall(trouble)
    controller = controller_of(twin.told, LIMITS)
    controller.answer_s = PATIENCE_S
    try:
        controller.connect()
        yield controller, twin
    finally:
        controller.close()
        twin.close()


def later(delay_s: float, act: object, *args: object) -> threading.Timer:
    timer = threading.Timer(delay_s, act, args)  # type: ignore[arg-type]
    timer.start()
    return timer


@every
def test_goes_where_it_is_told_and_reads_back(name: str) -> None:
    with beside(name) as (controller, twin):
        assert controller.ready()
        assert controller.position() == START
        for to in ((10.0, 0.25, -4.5), (10.0, 0.25, -4.5), START):
            assert controller.move_to(to, FEED) == to
            assert not twin.axes.moving
            assert twin.axes.at_mm == to
            assert controller.is_at(to) == to
        assert len(twin.moves) == 3


@every
def test_waits_for_the_end(name: str) -> None:
    with beside(name) as (controller, twin):
        began = time.monotonic()
        controller.move_to((1.0, 2.0, 0.0), SLOW)
        assert time.monotonic() - began >= 3.0 / 5.0
        assert not twin.axes.moving


@every
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
def test_nothing_is_sent_outside_the_limits(
    name: str, to: tuple[float, float, float], feed: float
) -> None:
    with beside(name) as (controller, twin):
        with pytest.raises(ControllerFault, match=r"machine file") as said:
            controller.move_to(to, feed)
        assert said.value.kind is MotionFault.OUTSIDE
        assert not twin.moves
        assert twin.axes.at_mm == START


@every
@pytest.mark.parametrize(
    "trouble", [MotionTrouble.NOT_HOMED, MotionTrouble.OFF, MotionTrouble.INCH, MotionTrouble.ESTOP]
)
def test_a_machine_that_is_not_ready(name: str, trouble: MotionTrouble) -> None:
    with beside(name) as (controller, twin):
        twin.befall(trouble)
        with pytest.raises(ControllerFault) as said:
            controller.ready()
        assert said.value.kind in (MotionFault.NOT_READY, MotionFault.CONTROLLER)
        assert not twin.moves


STOPPED_BY = {
    MotionTrouble.ESTOP: {MotionFault.NOT_READY, MotionFault.CONTROLLER},
    MotionTrouble.FOLLOWING: {MotionFault.CONTROLLER},
    MotionTrouble.NAK: {MotionFault.CONTROL_LOST, MotionFault.CONTROLLER},
    MotionTrouble.SILENCE: {MotionFault.LOST},
    MotionTrouble.HANG_UP: {MotionFault.LOST},
}


@every
@pytest.mark.parametrize("trouble", STOPPED_BY)
def test_trouble_on_the_way(name: str, trouble: MotionTrouble) -> None:
    with beside(name) as (controller, twin):
        if trouble is MotionTrouble.SILENCE:
            controller.answer_s = 0.2
        late = later(0.15, twin.befall, trouble)
        with pytest.raises(ControllerFault) as said:
            controller.move_to((60.0, 2.0, -3.0), SLOW)
        late.join()
        assert said.value.kind in STOPPED_BY[trouble]
        deaf = trouble is MotionTrouble.SILENCE or (
            name == "grbl" and trouble is MotionTrouble.HANG_UP
        )
        if deaf:  # a cable that is out ends nothing: somebody is told to
            assert "emergency stop" in str(said.value) or not twin.axes.moving
        else:
            assert not twin.axes.moving
            assert 1.0 < twin.axes.at_mm[0] < 59.0


@every
def test_stops_short(name: str) -> None:
    with beside(name, MotionTrouble.ELSEWHERE) as (controller, _):
        with pytest.raises(
            ControllerFault, match=r"X10\.500 Y0\.000 Z0\.000 in place of X10\.000"
        ) as said:
            controller.move_to((10.0, 0.0, 0.0), FEED)
        assert said.value.kind is MotionFault.ELSEWHERE


@every
def test_halt_stops_on_the_way(name: str) -> None:
    with beside(name) as (controller, twin):
        late = later(0.2, controller.halt.set)
        with pytest.raises(ControllerFault) as said:
            controller.move_to((60.0, 2.0, -3.0), SLOW)
        late.join()
        assert said.value.kind is MotionFault.STOPPED
        assert not twin.axes.moving
        assert 1.0 < twin.axes.at_mm[0] < 59.0  # of twelve seconds


@every
def test_somebody_else_moved_it(name: str) -> None:
    with beside(name) as (controller, twin):
        controller.move_to((10.0, 0.0, 0.0), FEED)
        twin.axes.go((10.02, 0.0, 0.0), 1e9)
        with pytest.raises(ControllerFault) as said:
            controller.is_at((10.0, 0.0, 0.0))
        assert said.value.kind is MotionFault.ELSEWHERE


def test_a_second_client_is_noticed() -> None:
    with beside("linuxcnc") as (controller, twin):
        controller.move_to((10.0, 0.0, 0.0), FEED)
        second = controller_of(twin.told, LIMITS)
        second.connect()
        with pytest.raises(ControllerFault) as said:
            controller.is_at((10.0, 0.0, 0.0))
        assert said.value.kind is MotionFault.CONTROL_LOST
        second.close()


class Arriving(SimulatedAxes):
    """Something befalls it when it is asked where it is and has arrived."""

    then: Callable[[], None] | None = None

    @property
    def at_mm(self) -> Triple:
        there = super().at_mm
        if self.then is not None and there == (10.0, 0.0, 0.0):
            self.then()
        return there


def test_a_barrier_whose_word_was_lost_is_asked_for_again() -> None:
    with beside("linuxcnc", MotionTrouble.CUT) as (controller, twin):
        assert controller.move_to((10.0, 0.0, 0.0), FEED) == (10.0, 0.0, 0.0)
        assert len(twin.moves) == 1


def test_a_refused_barrier_says_what_is_wrong() -> None:
    """An error between the last look and the barrier: the reason, not the NAK."""
    axes = Arriving(START)
    with closing(LinuxCncTwin(axes)) as twin:
        axes.then = lambda: twin.errors.extend(["joint 0 following error"] * (not twin.errors))
        twin.befall(MotionTrouble.CUT)
        controller = controller_of(twin.told, LIMITS)
        controller.answer_s = PATIENCE_S
        controller.connect()
        with pytest.raises(ControllerFault, match="joint 0 following error") as said:
            controller.move_to((10.0, 0.0, 0.0), FEED)
        assert said.value.kind is MotionFault.CONTROLLER
        controller.close()


def test_an_answer_that_came_while_the_program_was_held_up_counts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A second passes whenever the clock is asked, more than an answer may take."""
    with beside("linuxcnc") as (controller, _):
        controller.answer_s = 0.4
        seconds = SimpleNamespace(monotonic=count().__next__)
        monkeypatch.setattr("drivers.motion.controller.time", seconds)
        monkeypatch.setattr("drivers.motion.linuxcnc.LOOK_S", PATIENCE_S)
        assert controller.position() == START


def test_password_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    for words in ("WRONG EMCTOO", "EMC WRONG"):
        monkeypatch.setenv("GLIDECAL_LINUXCNC_PASSWORDS", words)
        with pytest.raises(ControllerFault, match="password") as said, beside("linuxcnc"):
            pass
        assert said.value.kind is MotionFault.REFUSED


@pytest.mark.parametrize("told", ["linuxcnc:127.0.0.1:9", "linuxcnc:127.0.0.1:x", "grbl:/dev/none"])
def test_nobody_there(told: str) -> None:
    controller = controller_of(told, LIMITS)
    with pytest.raises(ControllerFault) as said:
        controller.connect()
    assert said.value.kind is MotionFault.UNREACHABLE


@pytest.mark.parametrize("told", ["linuxcnc", "linuxcnc:", "klipper:/dev/x", ""])
def test_unknown_controllers(told: str) -> None:
    with pytest.raises(UsageError, match="linuxcnc:HOST:PORT or grbl:PORT"):
        controller_of(told, LIMITS)


@pytest.mark.skipif(os.name != "posix", reason="pseudo-terminals")
def test_grbl_over_a_terminal() -> None:
    with closing(GrblTwin(SimulatedAxes(START), "pty")) as twin:
        controller = controller_of(twin.told, LIMITS)
        controller.connect()
        assert controller.move_to((3.0, 2.0, -3.0), FEED) == (3.0, 2.0, -3.0)
        controller.close()


def test_bytes_of_the_text_server() -> None:
    """As LinuxCNC 2.9 answered them, recorded with a client of its own."""
    import socket

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
        ("set wait done", b"SET WAIT ACK\n\r"),
        ("set wait", b"SET WAIT NAK\n\r"),
        (
            "get abs_act_pos",
            b"ABS_ACT_POS 1.000000 2.000000 -3.000000 0.000000 0.000000 0.000000\r\n",
        ),
    ]
    with closing(LinuxCncTwin(SimulatedAxes(START))) as twin:
        host, _, port = twin.address.partition(":")
        with socket.create_connection((host, int(port)), timeout=2.0) as client:
            for asked, answer in recorded:
                client.sendall(asked.encode() + b"\n")
                got = b""
                while len(got) < len(answer):
                    got += client.recv(4096)
                assert got == answer, asked
