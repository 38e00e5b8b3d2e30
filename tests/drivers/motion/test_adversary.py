"""Ill controllers: no hang, no traceback, no false place, no move without consent, no missed stop.

40 seeds a dialect here; ``GLIDECAL_FUZZ=2000`` runs 2,000, ``GLIDECAL_FUZZ_FIRST`` is the first.
Several run at once, for they wait more than they work. `scenario` replays one. A controller that
reports a false place consistently and in the right form cannot be found out by anybody who only
reads its answers: where an ill does that (`Ill.false_place`) the place is not judged, all else is.
"""

from __future__ import annotations

import contextlib
import math
import os
import random
import re
import socket
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import cast

import pytest

from drivers.motion import controller_of
from drivers.motion.controller import ControllerFault
from drivers.motion.grbl import Grbl
from drivers.motion.guard import DETACHED, Guard
from drivers.motion.line import MotionLine, Patience
from drivers.motion.linuxcnc import LinuxCnc
from drivers.motion.states import State
from drivers.port import SerialPort
from drivers.twins import Transport
from tests.conftest import LONG, first_quick
from tests.drivers.motion.adversary import Front, Ill, Link, TrueAxes
from tests.drivers.motion.bench import BUSY, FEED, LIMITS, START, Ticker, comes_true, started
from tests.drivers.motion.ills import STRANGERS, Chatters, Late, Mute
from tests.drivers.motion.scenario import (
    ANSWER_S,
    CONNECT_S,
    Present,
    scenario,
)
from tests.drivers.motion.twins import FailingAxes, GrblTwin, MotionTrouble

SEEDS = int(os.environ.get("GLIDECAL_FUZZ", "40"))
FIRST = int(os.environ.get("GLIDECAL_FUZZ_FIRST", "0"))
AT_ONCE = 8
NAMES = ("linuxcnc", "grbl")


@pytest.fixture
def ticker() -> Iterator[Ticker]:
    ticker = Ticker()
    yield ticker
    ticker.close()


@LONG
@pytest.mark.timeout(900 + SEEDS * 5)
@pytest.mark.parametrize("name", first_quick(NAMES))
def test_ill_controllers(name: str, ticker: Ticker, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.motion.line.Guard", Present)
    with ThreadPoolExecutor(AT_ONCE) as pool:
        wrong = list(
            pool.map(lambda seed: scenario(name, seed, ticker).run(), range(FIRST, FIRST + SEEDS))
        )
    assert not any(wrong), "\n".join(words for messages in wrong for words in messages)


@pytest.mark.parametrize(
    "word", ["1_0.0", "9" * 300, "1e7", "0.0.0", "-", "", "nan", "-inf", "\xb2"]
)
def test_no_place_is_made_of_what_is_none(word: str) -> None:
    controller = controller_of("linuxcnc:127.0.0.1:9", LIMITS)
    with pytest.raises(ControllerFault, match="Allowed: a number"):
        controller.finite(word)
    assert controller.finite("-310.25") == -310.25
    assert controller.finite("1.5e-05") == 1.5e-05


class Flood:
    """A wire on which whole lines come faster than they are read."""

    def __init__(self, line: bytes) -> None:
        self._lines, self.sent = 20 * line, b""

    def read(self, size: int = 1) -> bytes:
        return self._lines

    def write(self, data: bytes, /) -> int:
        self.sent += data
        return len(data)

    def fileno(self) -> int:
        return -1

    def close(self) -> None:
        """As a port."""


@pytest.mark.parametrize(
    "line", first_quick([b"+0001.234\r\n", b"<Idle|MPos:1.0,2.0,3.0|FS:0,0>\r\n", b"ok\n"])
)
def test_no_flood_of_whole_lines_makes_a_question_longer(
    line: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each line that came used to be a reason to wait for the next one."""
    monkeypatch.setattr("drivers.motion.grbl.WAKE_S", 0.5)
    controller = controller_of("grbl:/dev/none", LIMITS)
    assert isinstance(controller, Grbl)
    controller.answer_s = ANSWER_S
    controller.state = "Idle"
    flood = Flood(line)
    controller.wire = cast("SerialPort", flood)
    for work in (controller.connect, controller.look, lambda: controller.begin(START, FEED)):
        controller.wire = cast("SerialPort", flood)
        began_s = time.monotonic()
        with contextlib.suppress(ControllerFault):
            work()
        assert time.monotonic() - began_s < CONNECT_S


@pytest.mark.timeout(900 + SEEDS)
@pytest.mark.parametrize("name", NAMES)
def test_ill_controllers_leave_no_guard(name: str, ticker: Ticker) -> None:
    """A twentieth of the seeds, with the process beside the program."""
    wrong = [scenario(name, seed, ticker).run() for seed in range(FIRST, FIRST + SEEDS, 20)]
    assert not DETACHED or all(guard.poll() is not None for guard in DETACHED)
    assert not any(wrong), "\n".join(words for messages in wrong for words in messages)


@contextmanager
def fronted(name: str, *ills: Ill, transport: Transport = "tcp") -> Iterator[Front]:
    front = Front(name, list(ills), TrueAxes(START), transport)
    try:
        yield front
    finally:
        front.close()


@contextmanager
def lined(
    name: str, *ills: Ill, answer_s: float = ANSWER_S, patience: Patience = BUSY
) -> Iterator[tuple[Front, MotionLine]]:
    """A line that is started at a front."""
    with fronted(name, *ills) as front:
        controller = controller_of(front.endpoint, LIMITS)
        with started(controller, patience, answer_s) as (line, _):
            try:
                yield front, line
            finally:
                front.mend()


def always(kind: type[Ill], **traits: object) -> Ill:
    """An ill from the start to the end, with these traits in place of random ones."""
    ill = kind(random.Random(0), 0.0, math.inf)
    for name, value in traits.items():
        setattr(ill, name, value)
    return ill


def test_a_late_report_is_not_the_place_now() -> None:
    """Asked twice, it answers twice: the second answer is of before what happened since."""
    with fronted("grbl", always(Late, late_s=0.25, single=False)) as front:
        controller = controller_of(front.endpoint, LIMITS)
        controller.answer_s = 1.0
        controller.connect()
        for there in ((6.0, 2.0, -3.0), (1.0, 7.0, -3.0), (1.0, 2.0, -9.0)):
            controller.look()
            front.axes.jog(there, 1e9)
            assert controller.look().place_mm == there
        controller.close()


class ParsesLate(Ill):
    """A board that hears single characters at once, and lines when it comes to them, in turn."""

    def choose(self) -> None:
        self.kept: list[tuple[float, bytes]] = []

    def hears(self, front: Front, link: Link, content: bytes) -> bytes:
        if not self.kept and b"$J" not in content:
            return content
        if content in (b"?", b"!", b"~", b"\x18", b"\x85", b"\x87"):
            return content
        self.kept.append((time.monotonic() + 0.4, content))
        return b""

    def acts(self, front: Front) -> None:
        for due_s, line in list(self.kept):
            if time.monotonic() >= due_s:
                self.kept.remove((due_s, line))
                front.does(front.links[0], line)


def test_a_jog_that_waits_in_the_board_moves_nothing_after_its_stop(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The stop comes before it: two equal positions are no rest while it is not acknowledged."""
    monkeypatch.setattr("drivers.motion.line.Guard", Present)
    with lined("grbl", always(ParsesLate), answer_s=2.0) as (front, line):
        assert line.consent()
        line.go([(50.0, 2.0, -3.0)], 600.0)
        assert comes_true(lambda: b"$J" in front.heard[-1][1])
        line.stop("a test", by_operator=True)
        assert comes_true(lambda: line.state is State.STOPPED)
        stopped_s = time.monotonic()
        time.sleep(0.6)
        assert front.axes.moved(stopped_s, time.monotonic()) == 0.0
        assert line.place_mm == pytest.approx(front.axes.at_mm, abs=0.001)


@pytest.mark.skipif(os.name != "posix", reason="file descriptors for another process")
def test_the_guard_has_the_port_as_it_is_after_a_new_connection(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    patience = Patience(silence_s=0.6, dead_s=0.0)
    with lined("grbl", answer_s=2.0, patience=patience) as (front, line):
        before = line.guard
        front.drops()
        assert comes_true(lambda: line.state is State.FAULT)
        line.answered().result(10.0)
        assert line.guard is not before
        line.homing_confirmed = True
        assert comes_true(line.consent)
        line.go([(50.0, 2.0, -3.0)], 600.0)
        assert comes_true(lambda: line.state is State.MOVING and front.axes.moving)
        monkeypatch.setattr(Guard, "watches", True)
        monkeypatch.setattr(line, "tell_guard", lambda _: None)  # as from a program that hangs
        assert comes_true(lambda: not front.axes.moving, 3.0)
        assert front.axes.at_mm[0] < 49.0


@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_nothing_moves_before_the_guard_is_armed(monkeypatch: pytest.MonkeyPatch) -> None:
    """That it started is no sign that it would stop the machine: only a beat arms it."""
    with lined("linuxcnc", patience=Patience(silence_s=1.0, dead_s=0.0)) as (front, line):
        monkeypatch.setattr(
            line, "tell_guard", lambda _: None
        )  # as if killed before the first beat
        assert line.consent()
        assert isinstance(line.go([(2.0, 2.0, -3.0)], FEED).exception(10.0), ControllerFault)
        assert not front.twin.moves


def test_a_close_waits_for_no_question(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.motion.line.Guard", Present)
    with lined("linuxcnc") as (front, line):
        front.drops()
        assert comes_true(lambda: line.state is State.FAULT)
        front.ills = [always(Mute)]
        answer, owner = line.answered(), line.owner
        time.sleep(0.1)
        began_s = time.monotonic()
        line.close()
        assert time.monotonic() - began_s < 1.0
        assert owner is not None
        assert not owner.is_alive()
        assert isinstance(answer.exception(1.0), ControllerFault)


def test_what_happens_while_the_guard_is_waited_for_is_noticed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("drivers.motion.line.Guard", Present)
    with lined("linuxcnc") as (front, line):
        monkeypatch.setattr(Present, "watches", False)
        assert line.consent()
        way = line.go([(10.0, 2.0, -3.0)], FEED)
        time.sleep(0.05)
        monkeypatch.setattr("drivers.motion.line.REST_LOOK_S", 1e9)
        front.axes.jog((1.0, 9.0, -3.0), 1e9)
        time.sleep(0.05)
        monkeypatch.setattr(Present, "watches", True)
        assert isinstance(way.exception(10.0), ControllerFault)
        assert not front.twin.moves


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("begun", [False, True])
def test_what_moved_it_as_the_operator_stopped_it_is_noticed(
    name: str, begun: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Startled by a jog, the operator stops it before the next look: that is no answer to it."""
    monkeypatch.setattr("drivers.motion.line.Guard", Present)
    monkeypatch.setattr("drivers.motion.line.REST_LOOK_S", 1e9)
    with lined(name, answer_s=2.0) as (front, line):
        assert line.consent()
        if begun:
            line.go([(50.0, 2.0, -3.0)], 600.0)
            assert comes_true(lambda: front.axes.moving)
            monkeypatch.setattr(line.controller, "moving_look_s", 1e9)
            time.sleep(0.1)
        x, y, z = front.axes.at_mm
        front.axes.jog((x, y + 9.0, z), 1e9)
        line.stop("a test", by_operator=True)
        assert comes_true(lambda: line.state is not State.STOPPING)
        assert line.state is State.HELD
        assert "Y11.000" in line.why
        assert not line.consent()
        line.answered().result(5.0)
        for _ in range(2):  # a stop where nothing else moved it is the operator's own
            assert line.consent()
            line.stop("a test", by_operator=True)
            assert comes_true(lambda: line.state is State.STOPPED)


def test_a_jog_that_ended_meanwhile_is_not_put_on_hold() -> None:
    """A hold is no more than a cancel in a jog, and locks a board that rests (tried with grbl)."""
    controller = controller_of("grbl:/dev/none", LIMITS)
    assert isinstance(controller, Grbl)
    wire = Flood(b"")
    controller.wire = cast("SerialPort", wire)
    controller.state = "Jog"  # as it was told last
    for attempt in range(3):
        controller.send_stop(attempt)
    assert set(wire.sent) == {0x85}


def test_a_position_that_was_cut_is_none() -> None:
    controller = controller_of("linuxcnc:127.0.0.1:9", LIMITS)
    assert isinstance(controller, LinuxCnc)
    assert controller.place_of("1.5 2.0 -3.25 0.0 0.0 0.0") == (1.5, 2.0, -3.25)
    for answer in ("1.5 2.0 -3", "1.5 2.0 -3.25 0.0 0.0", "0 0.000000", ""):
        with pytest.raises(ControllerFault):
            controller.place_of(answer)


def test_an_operator_who_vouches_is_heard_whatever_a_driver_raises(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("drivers.motion.line.Guard", Present)
    with lined("linuxcnc") as (_, line):

        def broken(_: object) -> None:
            raise ZeroDivisionError("of the driver")

        monkeypatch.setattr(line.controller, "stop", broken)
        assert line.consent()
        line.stop("a test", by_operator=True)
        assert comes_true(lambda: line.not_stopped)
        assert "ZeroDivisionError" in line.why
        line.vouch()
        assert comes_true(lambda: line.state is State.FAULT, 3.0)


class Hesitates(Late):
    """It greets late, and never acknowledges how commands wait."""

    def tells(self, front: Front, link: Link, answer: bytes) -> bytes:
        return b"" if b"SET_WAIT" in answer else answer


def test_a_connection_has_one_deadline(monkeypatch: pytest.MonkeyPatch) -> None:
    create = socket.create_connection

    def slowly(address: tuple[str, int], timeout: float) -> socket.socket:
        time.sleep(1.8)
        return create(address, timeout)

    monkeypatch.setattr(socket, "create_connection", slowly)
    with fronted("linuxcnc", always(Hesitates, late_s=1.8, single=True)) as front:
        controller = controller_of(front.endpoint, LIMITS)
        began_s = time.monotonic()
        with pytest.raises(ControllerFault):
            controller.connect()
        controller.close()
        assert time.monotonic() - began_s < CONNECT_S


def firmware(axes: FailingAxes) -> GrblTwin:
    """A board that is none of grbl 1.1."""

    class Other(GrblTwin):
        def answer(self, line: str) -> str:
            if line == "$I":
                return "[VER:3.7 FluidNC v3.7.12:]\r\n[OPT:PHS]\r\nok\r\n"
            return super().answer(line)

    return Other(axes, "tcp")


QUESTIONS = {"grbl": rb"\?|\x87|\$I\n|\$\$\n|\$#\n", "linuxcnc": rb"(hello|get) [^\n]*\n"}
PREPARES = rb"set (echo off|verbose on|enable \w+|set_wait received)\n"
"""What a text server is told before it answers readily; it moves nothing."""


def asked_only(front: Front, *, server: bool = False) -> bool:
    """Whether nothing was sent but questions."""
    allowed = QUESTIONS[front.name] + (rb"|" + PREPARES if server else rb"")
    content = b"".join(came for _, came in front.heard)
    return re.fullmatch(rb"(" + allowed + rb")*", content) is not None


def stranger(name: str, stream: bytes, every_s: float, ticker: Ticker) -> list[str]:
    """What is wrong where this device is in the place of a controller."""
    wrong = []
    ills = [always(Mute), always(Chatters, line=stream, every_s=every_s)] if stream else []
    transport: Transport = "pty" if name == "grbl" and os.name == "posix" else "tcp"
    with fronted(name, *(ills or [always(Mute)]), transport=transport) as front:
        line = MotionLine(controller_of(front.endpoint, LIMITS), BUSY)
        began_s = time.monotonic()
        try:
            line.start()
            wrong.append("it starts")
        except ControllerFault as problem:
            if "\n" in str(problem):
                wrong.append(f"no sentence: {problem}")
        now_s = time.monotonic()
        if now_s - began_s > CONNECT_S + ticker.held_up(began_s, now_s):
            wrong.append(f"{now_s - began_s:.1f} s")
        line.close()
        time.sleep(0.05)
        if not asked_only(front):
            wrong.append(f"sent {front.heard}")
    return [f"{stream[:30]!r} each {every_s:g} s: {words}" for words in wrong]


@pytest.mark.parametrize("name", first_quick(NAMES))
def test_a_stranger_behind_the_port(name: str, ticker: Ticker) -> None:
    """An indicator, a printer, FluidNC, no line's end, or nothing; now and then or without end."""
    devices = [(b"", 0.0), *((s, 0.0) for s in STRANGERS), *((s, 0.1) for s in STRANGERS[::3])]
    with ThreadPoolExecutor(AT_ONCE) as pool:
        wrong = list(pool.map(lambda device: stranger(name, device[0], device[1], ticker), devices))
    assert not any(wrong), "\n".join(words for messages in wrong for words in messages)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    "trouble", [MotionTrouble.NOT_HOMED, MotionTrouble.ESTOP, MotionTrouble.OFF]
)
def test_a_machine_that_is_not_ready_is_only_asked(name: str, trouble: MotionTrouble) -> None:
    with fronted(name) as front:
        front.twin.befall(trouble)
        line = MotionLine(controller_of(front.endpoint, LIMITS), BUSY)
        began_s = time.monotonic()
        if name == "linuxcnc":
            with pytest.raises(ControllerFault):
                line.start()
        else:
            with contextlib.suppress(ControllerFault):
                line.start()  # a board that waits for its homing begins in a fault
            assert line.state in (State.OFF, State.FAULT)
        assert time.monotonic() - began_s < CONNECT_S
        line.close()
        time.sleep(0.05)
        assert asked_only(front, server=True), front.heard


def test_unknown_firmware_is_only_asked() -> None:
    front = Front("grbl", [], TrueAxes(START), make=firmware)
    line = MotionLine(controller_of(front.endpoint, LIMITS), BUSY)
    with pytest.raises(ControllerFault, match="FluidNC"):
        line.start()
    assert asked_only(front), front.heard
    front.close()
