"""An ill controller and an operator for one seed, and what must not have happened at the end.

``python -m tests.drivers.motion.scenario grbl 17`` replays one and prints it.
"""

from __future__ import annotations

import math
import os
import random
import sys
import time
from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures import TimeoutError as NotInTime

from drivers.motion import controller_of
from drivers.motion.controller import ControllerFault, Triple
from drivers.motion.guard import DETACHED, Guard
from drivers.motion.line import MotionLine
from drivers.motion.states import MAY_MOVE, State
from drivers.twins import Transport
from tests.drivers.motion.adversary import Front, TrueAxes
from tests.drivers.motion.bench import BUSY, FEED, LIMITS, START, Ticker, comes_true
from tests.drivers.motion.ills import SPAN_S, ills_of
from tests.drivers.motion.twins import MotionTrouble

MOST_WRONG = 5
ANSWER_S = 0.2
CONNECT_S, CLOSE_S, OVER_S = 5.0, 5.0, 2.0
REST_S, NOT_STOPPED_S = 0.5, 0.7
LOOK_S = 0.1
"""A line that was sent as a stop came may reach the port so much later."""


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
        self._controller = controller_of(self._front.endpoint, LIMITS)
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
            if DETACHED:
                comes_true(lambda: all(guard.poll() is not None for guard in DETACHED), 22.0)
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
            change_near = any(at_s > self._ways[-1][0] for at_s, subject in self._front.changes)
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

    def _waits(self, subject: str, answer: Future[Triple], within_s: float) -> Triple | None:
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
            self._note(f"{subject}: {problem}")
        except NotInTime:
            self._blame(f"{subject} hangs; {self._line.state}, {self._line.why}")
        except BaseException as problem:
            self._blame(f"{subject} raised {problem!r}")
        else:
            self._note(f"{subject}: {place_mm}")
            if not all(map(math.isfinite, place_mm)):
                self._blame(f"{subject} returned {place_mm}")
        return place_mm

    def _closes(self) -> None:
        line = self._line
        guard, threads = line.guard, (line.owner, line.watcher)
        self._timed("close", CLOSE_S, line.close)
        for thread in threads:
            if thread is not None and thread.is_alive():
                self._blame(f"{thread.name} still runs")
        if isinstance(guard, Guard) and guard.process not in DETACHED and guard.runs:
            self._blame("the guard still runs")

    def _timed(self, subject: str, within_s: float, work: Callable[[], object]) -> None:
        began_s = time.monotonic()
        try:
            work()
        except ControllerFault:
            raise
        except BaseException as problem:
            self._blame(f"{subject} raised {problem!r}")
        finally:
            now_s = time.monotonic()
            took_s = now_s - began_s - self._ticker.held_up(began_s, now_s)
            if took_s > within_s:
                self._blame(f"{subject} took {took_s:.1f} s")

    def _judge_moves(self) -> None:
        """Each move lies within a consent, and none follows a change that nobody answered."""
        lines = [(s, line) for s, content in self._front.heard for line in content.split(b"\n")]
        moves = [s for s, line in lines if b"$J" in line or (b"mdi" in line and b" G1 " in line)]
        for at_s in moves:
            slack_s = LOOK_S + self._ticker.held_up(at_s - 1.0, at_s)
            if not any(begin <= at_s <= end + slack_s for begin, end in self._consents):
                self._blame(f"a move at {at_s - self._began_s:.3f} s without consent")
            # what others changed before this way was asked for, and after the last answer
            asked_s = max((s for s, _ in self._ways if s <= at_s), default=0.0)
            for changed_s, subject in self._front.changes:
                noticed = self._noticed(subject, changed_s, asked_s)
                if changed_s < asked_s and not noticed:
                    self._blame(f"{subject} at {changed_s - self._began_s:.3f} s: a move after it")
        for begin, end in self._consents:
            places = sum(n for s, n in self._ways if begin <= s <= end)
            count = sum(begin <= s <= end for s in moves)
            if count > places:
                self._blame(f"{count} moves for {places} places")

    def _noticed(self, subject: str, changed_s: float, asked_s: float) -> bool:
        """Whether somebody was told between a change and the next way, or nothing tells of it."""
        if self._place_unknown():
            return True
        if subject == "jog":
            way_mm = math.dist(self._axes.place(changed_s), self._axes.place(asked_s))
            before = [s for at_s, s in self._states if at_s <= changed_s and s != State.STOPPING]
            soon = [s for at_s, s in self._states if changed_s < at_s < changed_s + LOOK_S]
            # on the way, and where that was stopped, nobody knows where it will rest; so it is
            # between the last look before a move and the move, which goes to a place of its own
            moving = before[-1] is State.MOVING or State.MOVING in soon
            if way_mm <= LIMITS.reached_mm * 1.8 or moving:
                return True
        if subject == MotionTrouble.ELSEWHERE:
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
