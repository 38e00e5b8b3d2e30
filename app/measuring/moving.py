"""A machine that moves itself from step to step, and stops for whatever is not as it should be."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Literal

from app.measuring.gauges import Gauge, Motion
from app.measuring.proof import FEED_MM_MIN, Proof, ProofMove
from calib.errors import MotionError, UsageError
from drivers.motion import controller_of
from drivers.motion.controller import Limits, Triple
from drivers.motion.line import STRICT, MotionLine, Patience
from drivers.motion.states import LOOKED_AT, State
from drivers.profile import IndicatorReading
from protocols.machine import Instrument, Machine, MotionLimits
from protocols.motion import all_ways, box_mm, came_from, moves_mm, way_mm, zero_mm
from protocols.procedure import Procedure, Step
from protocols.session import Moved


@dataclass(frozen=True)
class Ways:
    """All ways of a procedure, and what they come to; rests at the steps are in the duration."""

    steps: tuple[Step, ...]
    longest_mm: float
    duration_s: float


def limits_of(machine: Machine) -> Limits:
    """What no move of this machine may exceed. Raises RecordError."""
    motion, (low, high) = machine.motion or MotionLimits(), box_mm(machine)
    fastest = machine.fastest_feed_mm_min
    return Limits(low, high, motion.longest_mm, fastest, motion.reached_mm, machine.mdi)


def feed_mm_min(machine: Machine) -> float:
    """How fast this machine is told to move."""
    return (machine.motion or MotionLimits()).feed_mm_min


def ways_of(procedure: Procedure, machine: Machine, axes: Sequence[str]) -> Ways:
    """Every way of a whole session, checked against the limits; nothing is sent.

    Raises RecordError, UsageError or MotionError for what is not allowed.
    """
    if procedure.plane is not None:
        raise UsageError(
            f"--motion with procedure {procedure.name}",
            "a stand that is slid by hand in every posture",
            "a procedure without [plane]",
            "Measure it without --motion.",
        )
    limits, step_ways = limits_of(machine), all_ways(procedure, machine, axes)
    ways = [way for _, way in step_ways]
    for way in ways:
        for place in way:
            limits.check(place, feed_mm_min(machine))
    moves = moves_mm(ways)
    longest = max(moves, default=0.0)
    if longest > limits.longest_mm:
        raise MotionError(
            f"longest move of {procedure.name}",
            f"{longest:.1f} mm",
            f"{limits.longest_mm:g} mm, longest_mm under [motion] in the machine file",
            "Nothing was sent.",
        )
    duration_s = sum(moves) / feed_mm_min(machine) * 60.0 + procedure.window_s * len(ways)
    return Ways(tuple(step for step, _ in step_ways), longest, duration_s)


@dataclass(frozen=True)
class MoveProposal:
    """What the operator's consent lets the machine do: nothing else, and only once.

    ``places_mm`` is the first way, from ``from_mm``; none where the machine is there. It leads to
    ``step``, and on through the other ``steps`` of the same set-up, or to Zero (``to_zero``).
    ``by_hand``: a stand is set up before; ``clears``: it is taken away. With a ``proof`` one
    carriage moves a little and back, and nothing else.
    """

    step: Step
    from_mm: Triple | None
    places_mm: tuple[Triple, ...]
    to_zero: bool
    by_hand: bool
    steps: int
    proof: ProofMove | None = None
    clears: bool = False

    @property
    def first_mm(self) -> float:
        """How long the first way is."""
        places = self.places_mm if self.from_mm is None else (self.from_mm, *self.places_mm)
        return sum(math.dist(a, b) for a, b in pairwise(places))


Goal = Step | Literal["Zero", "proof"]
"""Where a way ends: at a step, at Zero to wait there, or at an end of a move that proves."""


class Mover:
    """Moves the machine to steps within the operator's consent, and knows whether it is there.

    A consent covers the steps of one set-up, or the way to Zero before the next one; it ends with
    them, with every stop, and with `release`. ``on_news`` is called in whichever thread the news
    come. After a stop the next way begins anew, from the side from which the procedure comes. The
    ``gauges`` are all of the session. While a ``proof`` is needed only its moves are proposed;
    None: there is nothing to prove.
    """

    def __init__(
        self,
        line: MotionLine,
        procedure: Procedure,
        machine: Machine,
        axes: Sequence[str],
        gauges: Sequence[Gauge],
    ) -> None:
        self.line, self._gauges = line, gauges
        self.on_news: Callable[[], None] = lambda: None
        self.on_set_up: Callable[[Step], None] = lambda _: None  # a simulated machine has no hands
        self.proof: Proof | None = None
        self._arrived_s = 0.0
        self._procedure, self._machine = procedure, machine
        self._steps = procedure.steps(machine.geometry(), axes)
        self._feed = feed_mm_min(machine)
        self._lock = threading.RLock()
        self._way: Future[Triple] | None = None
        self._step: Step | None = None
        self._by_hand = False
        self._at: Goal | None = None
        self._place: object = None
        self._places: tuple[Triple, ...] = ()
        self._from_mm: Triple | None = None
        line.listener = lambda: self.on_news()

    def exchange(self) -> None:
        """Each indicator is at the port of the other, before the first move."""
        self._gauges = self._gauges[::-1]
        if self.proof is not None:
            self.proof.exchange()

    @property
    def state(self) -> State:
        """What the machine may do now."""
        return self.line.state

    @property
    def why(self) -> str:
        """What ended the last consent, in words."""
        return self.line.why

    @property
    def interrupted(self) -> bool:
        """Whether something happened that the operator must answer."""
        return self.line.not_stopped or self.state in (State.HELD, State.FAULT)

    def fits(self, answer: str) -> bool:
        """Whether the operator can ``answer``, ``vouch`` or ``home`` now; any other word fits."""
        able = {
            "answer": self.state in (State.HELD, State.FAULT),
            "vouch": self.line.not_stopped,
            "home": self.state is State.FAULT and self.line.can_home,
        }
        return able.get(answer, True)

    @property
    def under_way(self) -> bool:
        """Whether a way was sent and has not ended, with what belongs to it."""
        return self._way is not None or self.proving

    @property
    def unproved(self) -> Proof | None:
        """The proof that is needed before anything else moves."""
        proof = self.proof
        return proof if proof is not None and proof.needed(self.line.facts) else None

    @property
    def proving(self) -> bool:
        """Whether a move of a proof is under way, or rests half-way."""
        return self.proof is not None and self.proof.move is not None

    def is_there(self, step: Step) -> bool:
        """Whether the machine rests at a step."""
        return self._at == step and self.state in LOOKED_AT

    @property
    def proposal(self) -> MoveProposal | None:
        """What waits for the operator's consent; None where nothing does. Raises RecordError."""
        with self._lock:
            step = self._step
            if step is None or self.under_way or self.line.may_move:
                return None
            if (proof := self.unproved) is not None:
                return self._proof_proposal(proof, step)
            arrived = self.is_there(step)
            to_zero = self._by_hand and not (arrived or self._stands_at_zero)
            places = [zero_mm(self._machine)] if to_zero else [] if arrived else self._way_to(step)
            steps = sum(
                step_after.place == step.place for step_after in self._steps[step.number - 1 :]
            )
            by_hand = self._by_hand and not (arrived or to_zero)
            from_mm = self.line.place_mm
            clears = to_zero and self.proof is not None and self.proof.stands
            return MoveProposal(
                step, from_mm, tuple(places), to_zero, by_hand, steps, clears=clears
            )

    def _proof_proposal(self, proof: Proof, step: Step) -> MoveProposal | None:
        from_mm = self.line.place_mm
        if from_mm is None or proof.question:
            return None
        try:
            move = proof.next_move(step, from_mm)
        except MotionError as problem:
            proof.wrong = str(problem)
            return None
        by_hand = proof.sets_up(step)
        return MoveProposal(step, from_mm, (move.to_mm,), False, by_hand, 0, move)

    @property
    def _stands_at_zero(self) -> bool:
        if self._at == "Zero" or (isinstance(self._at, Step) and self._at.at_zero):
            return True
        place_mm, zero = self.line.place_mm, zero_mm(self._machine)
        return place_mm is not None and self.line.controller.is_at(place_mm, zero)

    def go(self, step: Step, *, by_hand_first: bool) -> None:
        """Move to a step, at once where the consent covers it; else propose it.

        Where something is set up by hand first, to Zero, to wait there.
        """
        with self._lock:
            self._step, self._by_hand = step, by_hand_first
            covered = not by_hand_first and self._place == step.place
            if self.line.state is State.CONSENTED and covered:
                self._send(self._way_to(step), step)
            else:
                self.release()
        self.on_news()

    def consent(self) -> bool:
        """The operator's word: the proposal may be done, and nobody is in the way.

        Returns whether it is taken: not so shortly after a stop, an arrival or a fault.
        """
        with self._lock:
            proposal = self.proposal
            if proposal is not None and proposal.proof is not None:
                return self._begin_proof(proposal.proof)
            if proposal is None or not self.line.consent():
                return False
            if proposal.by_hand:
                self.on_set_up(proposal.step)
            self._place = None if proposal.to_zero else proposal.step.place
            if proposal.places_mm:
                goal: Goal = "Zero" if proposal.to_zero else proposal.step
                self._send(proposal.places_mm, goal)
        self.on_news()
        return True

    def _begin_proof(self, move: ProofMove) -> bool:
        shown_mm = self._shown_mm(move, at_rest=True)
        if self.proof is None or shown_mm is None or not self.line.consent():
            return False
        self._place = None
        self.proof.begin(move, shown_mm)
        self._send([move.to_mm], "proof")
        return True

    def watch(self) -> list[str]:
        """Go on with the move of a proof as the indicators tell; called often while it may move.

        Returns what is to be noted in the record.
        """
        with self._lock:
            proof = self.proof
            if proof is None:
                return []
            if proof.move is not None:
                self._watch(proof, proof.move)
            news, proof.news = proof.news, []
        return news

    def _watch(self, proof: Proof, move: ProofMove) -> None:
        if self.line.state not in (State.MOVING, State.CONSENTED):
            proof.drop()  # stopped: it begins anew, from where it is then
        elif self._way is not None:
            shown_mm = self._shown_mm(move, at_rest=False)
            if shown_mm is not None and proof.beyond(shown_mm):
                self.stop(f"not proved. {proof.wrong}")
        elif (shown_mm := self._shown_mm(move, at_rest=True)) is not None:
            if self._places[-1] != move.to_mm:
                proof.back(shown_mm)
                proof.finish(self.line.facts)
                self.release()
            elif proof.there(shown_mm):
                self._send([move.from_mm], "proof")
            else:
                self.release()
            self.on_news()
        elif time.monotonic() - self._arrived_s > REST_S:
            self.release()

    def _shown_mm(self, move: ProofMove, *, at_rest: bool) -> tuple[float, ...] | None:
        """What the indicators of a move show; None without a reading of each, at rest if wished."""
        states = [self._gauges[number].live() for number in move.step.indicators]
        if at_rest and any(live.motion is not Motion.STABLE for live in states):
            return None
        outcomes = [live.outcome for live in states]
        values = tuple(o.value_mm for o in outcomes if isinstance(o, IndicatorReading))
        return values if outcomes and len(values) == len(outcomes) else None

    def answer_proof(self, *, yes: bool) -> list[str]:
        """What the operator saw of a carriage; returns what is to be noted in the record."""
        with self._lock:
            assert self.proof is not None
            self.proof.answer(yes=yes)
            self.proof.finish(self.line.facts)
            self.line.calm()
        self.on_news()
        return self.watch()

    def release(self) -> None:
        """Nothing moves any more without another consent."""
        with self._lock:
            self._place = None
        self.line.release()

    def stop(self, why: str, *, by_operator: bool = False) -> None:
        """End what is under way or allowed, from any thread."""
        self.line.stop(why, by_operator=by_operator)

    def answer(self) -> Future[Triple]:
        """The operator looked at what happened: ready again, if the controller is."""
        with self._lock:
            self._at = None
        return self.line.answered()

    def home(self) -> Future[Triple] | None:
        """Home the machine, with the operator's word; None where it is not taken."""
        with self._lock:
            if not self.line.consent(to_home=True):
                return None
            self._at = None
            homed = self.line.home()
        homed.add_done_callback(lambda _: self.release())
        return homed

    def there(self, step: Step) -> Moved:
        """What the record holds of the machine's being at a step. Raises MotionError."""
        with self._lock:
            if not self.is_there(step):
                raise MotionError(f"step {step.number}", self.why or self.state, "a machine there")
            place_mm, from_mm = self._places[-1], self._from_mm
            position = self.line.at(place_mm)
        read_back_mm = position.result()
        assert from_mm is not None  # of a way that was gone
        return Moved(
            driver=self.line.controller.name,
            coordinates=self._machine.mdi,
            from_mm=from_mm,
            commanded_mm=place_mm,
            read_back_mm=read_back_mm,
            feed_mm_min=self._feed,
        )

    def _way_to(self, step: Step) -> list[Triple]:
        here = self._at if isinstance(self._at, Step) and self._at.place == step.place else None
        if here == step:  # once more: approached anew
            here = None
        if here is None and (origin := came_from(step, self._steps)) is not None:
            return [
                *way_mm(origin, origin, self._procedure, self._machine),
                *way_mm(step, origin, self._procedure, self._machine),
            ]
        return way_mm(step, here, self._procedure, self._machine)

    def _send(self, places: Sequence[Triple], goal: Goal) -> None:
        began = self._places[-1] if isinstance(self._at, Step) else self.line.place_mm
        self._from_mm = places[-2] if len(places) > 1 else began
        self._at, self._places = None, tuple(places)
        feed = min(FEED_MM_MIN, self._feed) if goal == "proof" else self._feed
        self._way = self.line.go(list(places), feed)
        self._way.add_done_callback(partial(self._arrived, goal))

    def _arrived(self, goal: Goal, motion: Future[Triple]) -> None:
        """Note the arrival at a goal, or nowhere; called in the thread of the controller."""
        with self._lock:
            if motion is not self._way:
                return
            self._way, self._arrived_s = None, time.monotonic()
            if motion.exception() is None:
                for gauge in self._gauges:  # what they showed on the way is no rest
                    gauge.restart_window()
                self._at = goal
                if goal == "Zero":
                    if self.proof is not None:
                        self.proof.stands = False
                    self.release()
        self.on_news()


REST_S = 90.0
"""Longer than any window, 60 s: indicators that do not come to rest within it never do."""

Proves = Literal["never", "once", "anew"]
"""Whether a machine that moves itself is proved: never, once a machine, or even if it was."""


def open_mover(
    controller: str,
    procedure: Procedure,
    machine: Machine,
    instruments: Sequence[Instrument],
    gauges: Sequence[Gauge],
    patience: Patience = STRICT,
    proves: Proves = "never",
) -> Mover:
    """Connect to the controller that ``NAME:ADDRESS`` names; nothing moves yet.

    Raises UsageError, RecordError or MotionError.
    """
    axes = tuple(instrument.axes for instrument in instruments)
    ways_of(procedure, machine, axes)
    limits = limits_of(machine)
    line = MotionLine(controller_of(controller, limits), patience)
    mover = Mover(line, procedure, machine, axes, gauges)
    line.start()
    if proves != "never":
        mover.proof = Proof(machine, limits, instruments, controller, anew=proves == "anew")
    return mover
