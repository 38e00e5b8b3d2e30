"""Ill controllers: no hang, no traceback, no false place, no move without consent, no missed stop.

40 seeds a dialect here; ``GLIDECAL_FUZZ=2000`` runs 2,000, ``GLIDECAL_FUZZ_FIRST`` is the first;
``python -m tests.drivers.motion.test_adversary grbl 17`` replays one and prints it. Several run at
once, for they wait more than they work. A controller that reports a false place consistently and in
the right form cannot be found out by anybody who only reads its answers: where an ill does that
(`Ill.false_place`) the place is not judged, all else is.
"""

from __future__ import annotations

import contextlib
import math
import os
import random
import re
import socket
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import TimeoutError as NotInTime
from contextlib import contextmanager

import pytest

from drivers.motion import controller_of
from drivers.motion.controller import ControllerFault, Triple
from drivers.motion.grbl import Grbl
from drivers.motion.guard import LEFT, Guard
from drivers.motion.line import MotionLine, Patience
from drivers.motion.linuxcnc import LinuxCnc
from drivers.motion.states import MAY_MOVE, State
from drivers.motion.twins import GrblTwin, MotionTrouble, SimulatedAxes
from drivers.twins import Transport
from tests.conftest import first_quick
from tests.drivers.motion.adversary import (
    SPAN_S,
    STRANGERS,
    Chatters,
    Front,
    Ill,
    Late,
    Link,
    Mute,
    TrueAxes,
    ills_of,
)
from tests.drivers.motion.bench import BUSY, FEED, LIMITS, START, Ticker, comes_true, started

SEEDS = int(os.environ.get("GLIDECAL_FUZZ", "40"))
FIRST = int(os.environ.get("GLIDECAL_FUZZ_FIRST", "0"))
AT_ONCE = 8
MOST_WRONG = 5
ANSWER_S = 0.2
CONNECT_S, CLOSE_S, OVER_S = 5.0, 5.0, 2.0
REST_S, NOT_STOPPED_S = 0.5, 0.7
LOOK_S = 0.1
"""A line that was sent as a stop came may reach the port so much later."""
NAMES = ("linuxcnc", "grbl")


class Present:
    """A guard that watches: starting a process for each seed is most of the time."""

    watches = runs = True

    def __init__(self, *_: object) -> None:
        """As `Guard`."""

    def wait(self) -> None:
        """As `Guard`."""

    def send(self, word: bytes) -> None:
        """As `Guard`."""

    def close(self, *, resting: bool = True) -> None:
        """As `Guard`."""


@pytest.fixture
def ticker() -> Iterator[Ticker]:
    ticker = Ticker()
    yield ticker
    ticker.close()


class Scenario:
    """One seed from the start to the end; ``wrong`` is what must not have happened."""

    def __init__(self, name: str, seed: int, ticker: Ticker, *, transport: Transport) -> None:
        self.name, self.seed = name, seed
        self.wrong: list[str] = []
        self.trace: list[str] = []
        self._ticker = ticker
        self._generator = random.Random(f"{name} {seed}")
        self._axes = TrueAxes(START)
        self._began_s = time.monotonic()
        self._ills = ills_of(seed)
        self._front = Front(name, list(self._ills), self._axes, transport)
        self._controller = controller_of(self._front.told, LIMITS)
        self._controller.answer_s = ANSWER_S
        self._line = MotionLine(self._controller, BUSY)
        self._line.listener = self._changed
        self._consents: list[list[float]] = []
        self._ways: list[tuple[float, int]] = []
        self._told: list[float] = []
        self._states: list[tuple[float, State]] = [(0.0, State.OFF)]
        self._answered_s = self._began_s
        self._last_mm = START

    def run(self) -> list[str]:
        """What went wrong."""
        self._note(", ".join(map(repr, self._ills)))
        try:
            if self._started():
                owner = self._line.owner
                end_s = time.monotonic() + SPAN_S + 0.3
                while time.monotonic() < end_s and len(self.wrong) < MOST_WRONG:
                    self._act()
                if self._line.owner is not owner or owner is None or not owner.is_alive():
                    self._blame("the thread that owns the controller ended")
            self._closes()
            self._judge_moves()
        finally:
            self._front.mend()
            self._line.close()
            if LEFT:
                comes_true(lambda: all(guard.poll() is not None for guard in LEFT), 22.0)
            self._front.close()
        return [f"{self.name} {self.seed}: {words}" for words in self.wrong]

    def _started(self) -> bool:
        try:
            # connect, then each question of ready and survey
            self._timed("start", CONNECT_S + 60.0 * ANSWER_S, self._line.start)
        except ControllerFault as problem:
            self._note(f"start: {problem}")
            return False
        self._line.homing_confirmed = True
        self._answered_s = time.monotonic()
        return True

    def _act(self) -> None:
        line, state = self._line, self._line.state
        line.alive()
        if self._generator.random() < 0.1 and not line.may_move:
            way, _, within_s = self._sent()  # without a consent
            if self._waits("go", way, within_s) is not None:
                self._blame("it went without a consent")
            return
        if state is State.STOPPING:
            self._vouches()
        elif state in (State.HELD, State.FAULT):
            if self._generator.random() < 0.5:
                self._front.twin.mend()
            if self._waits("answered", line.answered(), CONNECT_S + 60.0 * ANSWER_S) is not None:
                self._answered_s = time.monotonic()
                line.homing_confirmed = True
            else:
                time.sleep(0.1)
        else:
            self._generator.choice((self._goes, self._goes, self._stops, self._asks, self._rests))()

    def _rests(self) -> None:
        time.sleep(self._generator.uniform(0.0, 0.3))

    def _asks(self) -> None:
        wanted_mm = self._line.place_mm or START
        began_s = time.monotonic()
        place_mm = self._waits("at", self._line.at(wanted_mm), 12.0 * ANSWER_S)
        ended_s = time.monotonic()
        if place_mm is None or self._place_unknown():
            return
        moments = [began_s + (ended_s - began_s) * k / 50 for k in range(51)]
        off_mm = min(
            max(abs(a - b) for a, b in zip(self._axes.place(s), wanted_mm, strict=True))
            for s in moments
        )
        if off_mm > LIMITS.reached_mm + 0.001:  # the reports are rounded
            self._blame(f"at {wanted_mm} returned {place_mm}, {off_mm:.3f} mm off in truth")
        before_s = 0.05
        moved_s = self._axes.moved(began_s - before_s, ended_s)
        if moved_s > 0.999 * (ended_s - began_s + before_s):
            self._blame(f"at {wanted_mm} returned {place_mm} while it moved")

    def _place_unknown(self) -> bool:
        return any(ill.false_place for ill in self._ills)

    def _way(self) -> tuple[list[Triple], float]:
        there = self._line.place_mm or START
        places = []
        for _ in range(self._generator.choice((1, 1, 2))):
            x, y, z = (mm + self._generator.uniform(-3.0, 3.0) for mm in there)
            there = (
                round(min(59.0, max(-59.0, x)), 3),
                round(min(59.0, max(-59.0, y)), 3),
                round(min(59.0, max(-59.0, z)), 3),
            )
            places.append(there)
        return places, self._generator.choice((600.0, 1500.0, FEED))

    def _consented(self) -> bool:
        consent = self._line.consent()
        if consent:
            self._consents.append([time.monotonic() - 0.001, math.inf])
            self._changed()
        return consent

    def _sent(self) -> tuple[Future[Triple], list[Triple], float]:
        places, feed = self._way()
        self._ways.append((time.monotonic(), len(places)))
        self._note(f"go {places} at {feed:g}")
        way_s = 0.0
        before = self._line.place_mm or START
        for place in places:
            way_s += math.dist(before, place) / feed * 60.0
            before = place
        # each: twice its time and 5 s; a question before, what has to be accepted, one behind
        within_s = 2.0 * way_s + len(places) * (5.0 + 3.0 * 3.0) + 60.0 * ANSWER_S
        return self._line.go(places, feed), places, within_s

    def _goes(self) -> None:
        if not self._consented():
            return
        way, places, within_s = self._sent()
        place_mm = self._waits("go", way, within_s)
        now_s = time.monotonic()
        if place_mm is not None and not self._place_unknown():
            true_mm = self._axes.place(now_s)
            near = max(abs(a - b) for a, b in zip(true_mm, places[-1], strict=True))
            change_near = any(at_s > self._ways[-1][0] for at_s, what in self._front.changes)
            if near > LIMITS.reached_mm + 0.001 and not change_near:
                self._blame(f"arrived at {places[-1]}, in truth at {true_mm}")
        self._line.release()

    def _stops(self) -> None:
        if not self._consented():
            return
        way, _, within_s = self._sent()
        time.sleep(self._generator.choice((0.0, 0.0, 0.01, 0.05, 0.1, 0.2)))
        told_s = time.monotonic()
        self._line.stop("the test", by_operator=True)
        time.sleep(max(0.0, told_s + NOT_STOPPED_S - time.monotonic()))
        not_stopped, state, now_s = self._line.not_stopped, self._line.state, time.monotonic()
        self._note(f"stop -> {state}, not stopped {not_stopped}")
        slack_s = self._ticker.held_up(told_s, now_s)
        late_s = self._axes.moved(told_s + REST_S + slack_s, now_s, jogs=False)
        still_s = self._axes.moved(now_s - 0.05, now_s, jogs=False)
        if late_s > 0.0 and not not_stopped and state is not State.STOPPING:
            self._blame(f"{late_s:.2f} s of motion after a stop; {state}, {self._line.why}")
        if still_s > 0.04 and state not in MAY_MOVE and not self._place_unknown():
            self._blame(f"{state} while it moves")
        if state is State.STOPPING and not not_stopped and slack_s < 0.1:
            self._blame("neither at rest nor NOT STOPPED")
        deaf = any(ill.deaf for ill in self._ills)
        if late_s > 0.0 and not deaf:
            self._blame(f"{late_s:.2f} s of motion after a stop that it hears; {self._line.why}")
        self._waits("go", way, within_s)

    def _vouches(self) -> None:
        if not comes_true(lambda: self._line.state is not State.STOPPING, 0.8):
            self._line.vouch()
            if not comes_true(lambda: self._line.state is not State.STOPPING, OVER_S):
                self._blame(f"vouched, and still {self._line.state}: {self._line.why}")

    def _waits(self, what: str, answer: Future[Triple], within_s: float) -> Triple | None:
        """The place; the operator vouches where no rest is seen."""
        began_s = time.monotonic()
        place_mm: Triple | None = None
        try:
            while not answer.done() and time.monotonic() - began_s < within_s + OVER_S:
                self._line.alive()
                if self._line.not_stopped:
                    self._vouches()
                time.sleep(0.005)
            place_mm = answer.result(0.0)
        except ControllerFault as problem:
            self._note(f"{what}: {problem}")
        except NotInTime:
            self._blame(f"{what} hangs; {self._line.state}, {self._line.why}")
        except BaseException as problem:
            self._blame(f"{what} raised {problem!r}")
        else:
            self._note(f"{what}: {place_mm}")
            if not all(map(math.isfinite, place_mm)):
                self._blame(f"{what} returned {place_mm}")
        return place_mm

    def _closes(self) -> None:
        line = self._line
        guard, threads = line.guard, (line.owner, line.watcher)
        self._timed("close", CLOSE_S, line.close)
        for thread in threads:
            if thread is not None and thread.is_alive():
                self._blame(f"{thread.name} still runs")
        if isinstance(guard, Guard) and guard.process not in LEFT and guard.runs:
            self._blame("the guard still runs")

    def _timed(self, what: str, within_s: float, work: Callable[[], object]) -> None:
        began_s = time.monotonic()
        try:
            work()
        except ControllerFault:
            raise
        except BaseException as problem:
            self._blame(f"{what} raised {problem!r}")
        finally:
            now_s = time.monotonic()
            took_s = now_s - began_s - self._ticker.held_up(began_s, now_s)
            if took_s > within_s:
                self._blame(f"{what} took {took_s:.1f} s")

    def _judge_moves(self) -> None:
        """Each move lies within a consent, and none follows a change that nobody answered."""
        heard = [(s, line) for s, came in self._front.heard for line in came.split(b"\n")]
        moves = [s for s, line in heard if b"$J" in line or (b"mdi" in line and b" G1 " in line)]
        for at_s in moves:
            slack_s = LOOK_S + self._ticker.held_up(at_s - 1.0, at_s)
            if not any(begin <= at_s <= end + slack_s for begin, end in self._consents):
                self._blame(f"a move at {at_s - self._began_s:.3f} s without consent")
            # what others changed before this way was asked for, and after the last answer
            asked_s = max((s for s, _ in self._ways if s <= at_s), default=0.0)
            for changed_s, what in self._front.changes:
                noticed = self._noticed(what, changed_s, asked_s)
                if changed_s < asked_s and not noticed:
                    self._blame(f"{what} at {changed_s - self._began_s:.3f} s: a move after it")
        for begin, end in self._consents:
            places = sum(n for s, n in self._ways if begin <= s <= end)
            sent = sum(begin <= s <= end for s in moves)
            if sent > places:
                self._blame(f"{sent} moves for {places} places")

    def _noticed(self, what: str, changed_s: float, asked_s: float) -> bool:
        """Whether somebody was told between a change and the next way, or nothing tells of it."""
        if self._place_unknown():
            return True
        if what == "jog":
            gone = math.dist(self._axes.place(changed_s), self._axes.place(asked_s))
            before = [s for at_s, s in self._states if at_s <= changed_s and s != State.STOPPING]
            soon = [s for at_s, s in self._states if changed_s < at_s < changed_s + LOOK_S]
            # on the way, and where that was stopped, nobody knows where it will rest; so it is
            # between the last look before a move and the move, which goes to a place of its own
            moving = before[-1] is State.MOVING or State.MOVING in soon
            if gone <= LIMITS.reached_mm * 1.8 or moving:
                return True
        if what == MotionTrouble.ELSEWHERE:
            return True
        return any(changed_s <= s <= asked_s for s in self._told) or changed_s < self._answered_s

    def _changed(self) -> None:
        now_s, state = time.monotonic(), self._line.state
        self._states.append((now_s, state))
        if state not in (State.CONSENTED, State.MOVING) and self._consents:
            self._consents[-1][1] = min(self._consents[-1][1], now_s)
        if state in (State.HELD, State.FAULT, State.STOPPING):
            self._told.append(now_s)
        if not self.trace or not self.trace[-1].endswith(f"{state} {self._line.why}"):
            self._note(f"{state} {self._line.why}")

    def _note(self, words: str) -> None:
        self.trace.append(f"{time.monotonic() - self._began_s:7.3f} {words}")

    def _blame(self, words: str) -> None:
        self._note(f"WRONG: {words}")
        self.wrong.append(words)


def scenario(name: str, seed: int, ticker: Ticker) -> Scenario:
    """The one of this seed; grbl behind a terminal every other time."""
    terminal = name == "grbl" and os.name == "posix" and seed % 2 == 1
    return Scenario(name, seed, ticker, transport="pty" if terminal else "tcp")


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
    controller.wire = flood = Flood(line)
    for work in (controller.connect, controller.look, lambda: controller.begin(START, FEED)):
        controller.wire = flood
        began_s = time.monotonic()
        with contextlib.suppress(ControllerFault):
            work()
        assert time.monotonic() - began_s < CONNECT_S


@pytest.mark.timeout(900 + SEEDS)
@pytest.mark.parametrize("name", NAMES)
def test_ill_controllers_leave_no_guard(name: str, ticker: Ticker) -> None:
    """A twentieth of the seeds, with the process beside the program."""
    wrong = [scenario(name, seed, ticker).run() for seed in range(FIRST, FIRST + SEEDS, 20)]
    assert not LEFT or all(guard.poll() is not None for guard in LEFT)
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
        controller = controller_of(front.told, LIMITS)
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
        controller = controller_of(front.told, LIMITS)
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

    def hears(self, front: Front, link: Link, came: bytes) -> bytes:
        if not self.kept and b"$J" not in came:
            return came
        if came in (b"?", b"!", b"~", b"\x18", b"\x85", b"\x87"):
            return came
        self.kept.append((time.monotonic() + 0.4, came))
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
    controller.wire = wire = Flood(b"")
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
        controller = controller_of(front.told, LIMITS)
        began_s = time.monotonic()
        with pytest.raises(ControllerFault):
            controller.connect()
        controller.close()
        assert time.monotonic() - began_s < CONNECT_S


def firmware(axes: SimulatedAxes) -> GrblTwin:
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
    sent = b"".join(came for _, came in front.heard)
    return re.fullmatch(rb"(" + allowed + rb")*", sent) is not None


def stranger(name: str, stream: bytes, every_s: float, ticker: Ticker) -> list[str]:
    """What is wrong where this device is in the place of a controller."""
    wrong = []
    ills = [always(Mute), always(Chatters, line=stream, every_s=every_s)] if stream else []
    transport: Transport = "pty" if name == "grbl" and os.name == "posix" else "tcp"
    with fronted(name, *(ills or [always(Mute)]), transport=transport) as front:
        line = MotionLine(controller_of(front.told, LIMITS), BUSY)
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
        line = MotionLine(controller_of(front.told, LIMITS), BUSY)
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
    line = MotionLine(controller_of(front.told, LIMITS), BUSY)
    with pytest.raises(ControllerFault, match="FluidNC"):
        line.start()
    assert asked_only(front), front.heard
    front.close()


def main() -> None:
    """Replay seeds of a dialect: NAME SEED…"""
    from drivers.motion import line

    name, *seeds = sys.argv[1:]
    setattr(line, "Guard", Present)  # noqa: B010
    ticker = Ticker()
    for seed in seeds:
        replayed = scenario(name, int(seed), ticker)
        began_s = time.monotonic()
        replayed.run()
        print(f"--- {name} {seed}: {time.monotonic() - began_s:.1f} s", *replayed.trace, sep="\n")
    ticker.close()


if __name__ == "__main__":
    main()
