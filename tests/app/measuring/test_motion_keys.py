"""Mashed keys, held keys, faults and second clients: no move without a fresh consent.

What is judged is what reaches the controller, against rules of the test's own. GLIDECAL_FUZZ=10000
plays so many sequences, from GLIDECAL_SEED on.
"""

from __future__ import annotations

import itertools
import os
import random
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, field
from typing import Any

import pytest

from app.measuring import motion_keys
from app.measuring.motion_keys import MotionKeys
from app.measuring.moving import Mover, limits_of
from drivers.motion import controller_of
from drivers.motion.line import Patience
from drivers.motion.states import State
from protocols.procedure import Step, load_procedure
from tests.app.measuring.moving_machine import FAST
from tests.drivers.motion.bench import PATIENCE_S, Ticker, comes_true, started
from tests.drivers.motion.twins import FailingAxes, FailingLinuxCnc, MotionTrouble

SEQUENCES = int(os.environ.get("GLIDECAL_FUZZ", "40"))
FIRST = int(os.environ.get("GLIDECAL_SEED", "0"))
EVENTS = 14
DEAD_S = 0.06
"""In place of the second of the program: sequences are as much shorter."""

HELD_UP_S = 0.2
"""On a busy machine a thread may be held up for so long between its last look at the wish to stop
and the line that it sends: then the stop follows that line at once."""

TROUBLES = (
    MotionTrouble.MODE,
    MotionTrouble.OVERRIDE,
    MotionTrouble.OFFSET,
    MotionTrouble.UNHOMED,
    MotionTrouble.NAK,
    MotionTrouble.ESTOP,
    MotionTrouble.HANG_UP,
)


class TimedMoves(list[str]):
    """Lines that moved the machine, each with its moment."""

    def __init__(self) -> None:
        super().__init__()
        self.at_s: list[float] = []

    def append(self, line: str) -> None:
        self.at_s.append(time.monotonic())
        super().append(line)


class TimedTwin(FailingLinuxCnc):
    """Knows when the looks before its moves began."""

    def __init__(self, axes: FailingAxes) -> None:
        super().__init__(axes, "tool")
        self.moves = TimedMoves()
        self.looks_s: list[float] = []

    def _get(self, client: Any, name: str) -> str:  # noqa: ANN401 (a class of the twin's own)
        if name == "error":  # the first question of a look
            self.looks_s.append(time.monotonic())
        return super()._get(client, name)


@dataclass
class Operator:
    """Presses keys through the same code as the screen, and remembers when."""

    mover: Mover
    twin: TimedTwin
    ticker: Ticker
    steps: tuple[Step, ...]
    chance: random.Random
    keys: MotionKeys = field(default_factory=MotionKeys)
    goes_s: list[float] = field(default_factory=list)
    taken_s: list[float] = field(default_factory=list)
    others_s: list[float] = field(default_factory=list)
    stops_s: list[float] = field(default_factory=list)
    troubles_s: list[float] = field(default_factory=list)
    at: int = 0

    def go_on(self) -> None:
        """As a session does that takes what stands still: on to the next step."""
        step = self.steps[self.at]
        if self.mover.is_there(step):
            self.at = (self.at + 1) % len(self.steps)
            following = self.steps[self.at]
            self.mover.go(following, by_hand_first=following.place != step.place)

    def press_go(self) -> None:
        self.goes_s.append(time.monotonic())
        ends = self.keys.ends_here(self.mover, goes=True)
        self.taken_s.append(time.monotonic())
        if not ends:
            self.mover.consent()

    def press_other(self) -> None:
        now_s = time.monotonic()
        self.others_s.append(now_s)
        if self.twin.axes.moving:
            self.stops_s.append(now_s)
        self.keys.ends_here(self.mover)

    def act(self) -> None:
        match self.chance.choice(("go", "go", "go", "hold", "other", "mash", "trouble", "answer")):
            case "go":
                self.press_go()
            case "hold":
                for _ in range(self.chance.randrange(2, 8)):
                    self.press_go()
                    time.sleep(0.004)
            case "other":
                self.press_other()
            case "mash":
                for _ in range(self.chance.randrange(2, 6)):
                    self.chance.choice((self.press_go, self.press_other))()
            case "trouble":
                self.interfere()
            case "answer" if self.mover.state in (State.HELD, State.FAULT):
                self.twin.mend()
                self.mover.answer().exception(PATIENCE_S)
        time.sleep(self.chance.choice((0.0, 0.01, 0.02, DEAD_S + 0.02)))
        self.go_on()

    def interfere(self) -> None:
        """Another client, the panel, a hand: what is done is noticed before the next move."""
        trouble = self.chance.choice(TROUBLES)
        if trouble is MotionTrouble.MODE and self.twin.state["mode"] == "MANUAL":
            return  # it is that already
        jogs = self.chance.random() < 0.3
        if jogs and self.mover.state is State.MOVING:
            return  # a move that is sent just then takes the place of the jog, and nothing is left
        if jogs:
            x, y, z = self.twin.axes.at_mm
            self.twin.axes.go((x, y + 1.5, z), 1e5)
        else:
            self.twin.befall(trouble)
        self.troubles_s.append(time.monotonic())  # from here on it is there to be seen

    def illegal(self, at_s: float) -> str:
        """Why a move at this moment is none that the operator wanted."""
        go_s = max((s for s in self.goes_s if s < at_s), default=None)
        if go_s is None:
            return "no consent at all"
        # one consent covers a whole set-up: what is judged is the last press that could be one
        # a press that waited for a processor is dated by the program between these two moments
        presses = [(s, t) for s, t in zip(self.goes_s, self.taken_s, strict=True) if s <= go_s]
        fresh = [
            press_s
            for (before_s, _), (press_s, taken_s) in itertools.pairwise([(-1e9, 0.0), *presses])
            if taken_s - before_s >= motion_keys.HELD_KEY_S
        ]
        consent_s = fresh[-1] if fresh else None
        if consent_s is None:
            return "only repeats of a key"
        between = [s for s in self.others_s if consent_s < s < at_s]
        if any(at_s - s > HELD_UP_S + self.ticker.held_up(s, at_s) for s in between):
            return "another key came between"
        look_s = max(s for s in self.twin.looks_s if s < at_s)
        if any(consent_s < s < look_s for s in self.troubles_s):
            return "something interfered between, and was there to be seen"
        if any(0.0 < consent_s - s < DEAD_S - 0.005 for s in self.stops_s):
            return "the consent came within the dead time"
        return ""


@pytest.fixture
def operator(monkeypatch: pytest.MonkeyPatch) -> Iterator[Operator]:
    monkeypatch.setattr(motion_keys, "HELD_KEY_S", DEAD_S)
    procedure = load_procedure("zero-max-min", FAST.geometry())
    with closing(TimedTwin(FailingAxes())) as twin, closing(Ticker()) as ticker:
        controller = controller_of(twin.endpoint, limits_of(FAST))
        steps = procedure.steps(FAST.geometry(), ("xyz", "xyz"))
        with started(controller, Patience(silence_s=3.0, dead_s=DEAD_S)) as (line, _):
            mover = Mover(line, procedure, FAST, ("xyz", "xyz"), ())
            yield Operator(mover, twin, ticker, steps, random.Random())


def test_nothing_moves_without_a_fresh_consent(operator: Operator) -> None:
    mover, moves = operator.mover, operator.twin.moves
    assert isinstance(moves, TimedMoves)
    mover.go(operator.steps[0], by_hand_first=True)
    judged = 0
    for seed in range(FIRST, FIRST + SEQUENCES):
        operator.chance = random.Random(seed)
        for _ in range(EVENTS):
            operator.act()
            wrong = [(at_s, why) for at_s in moves.at_s[judged:] if (why := operator.illegal(at_s))]
            assert not wrong, (seed, wrong, operator.mover.why)
            judged = len(moves.at_s)
        operator.press_other()
        assert comes_true(lambda: not mover.line.may_move), (seed, mover.state, mover.why)
        assert not operator.twin.axes.moving or operator.troubles_s
        operator.twin.mend()
        if mover.state in (State.HELD, State.FAULT):
            mover.answer().exception(PATIENCE_S)
            mover.go(operator.steps[operator.at], by_hand_first=False)
    assert judged > SEQUENCES / 4  # or nothing was tried
