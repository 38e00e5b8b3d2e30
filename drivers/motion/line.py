"""One controller, the thread that owns it, and everything that holds before and while it moves.

The states and their causes stand in `states`. Nothing moves but after `consent`; a consent ends
with every stop, fault and change, and with `release`. Three watch each other while the machine may
move: the thread that owns the controller, a thread that looks whether that one and the face of the
program still run, and the guard, a process that looks whether this one does.
"""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field

from drivers.motion.controller import (
    NOT_STOPPED,
    SLICE_S,
    STOP_S,
    Controller,
    ControllerFault,
    MotionFault,
    Snapshot,
    Triple,
)
from drivers.motion.guard import BEAT, BEAT_S, HOMING, REST, SILENCE_S, Guard
from drivers.motion.states import LOOKED_AT, MAY_MOVE, TRANSITIONS, Cause, State
from drivers.motion.supervision import Supervision

REST_LOOK_S = 0.2
"""A machine at rest is looked at so often: hands may be in it."""

DEAD_S = 1.0
"""After a stop, an arrival, a fault or an answer no consent is taken: a key pressed then was meant
for what was before."""

CLOSE_S = 1.5
"""For a stop before the program leaves; then the guard goes on with it."""

BROKEN = (MotionFault.LOST, MotionFault.CONTROL_LOST, MotionFault.UNREACHABLE, MotionFault.PROGRAM)
"""After these a new connection is made before anything else."""

INTERFERENCE = (
    MotionFault.CONTROL_LOST,
    MotionFault.CHANGED,
    MotionFault.ELSEWHERE,
    MotionFault.LATE,
    MotionFault.STOPPED,
)
"""The controller is well, but somebody or something interfered."""


@dataclass(frozen=True)
class Patience:
    """How long is waited before something counts as wrong, s; tests on busy machines wait longer.

    ``silence_s`` without a sign of life of the program or one of its threads stops the machine,
    ``dead_s`` is the time after a stop in which no consent is taken.
    """

    silence_s: float = SILENCE_S
    dead_s: float = DEAD_S


STRICT = Patience()


@dataclass
class Job:
    """What the thread is to do, and where its answer goes."""

    work: Callable[[], Triple]
    answer: Future[Triple] = field(default_factory=Future)


class MotionLine:
    """Moves within a consent; every request is answered by a position, or by why there is none.

    ``listener`` is called, in whichever thread, when `state` or what it says changes.
    """

    def __init__(self, controller: Controller, patience: Patience = STRICT) -> None:
        self.controller = controller
        self.listener: Callable[[], None] = lambda: None
        self._why = self._doubt = ""
        self.homing_confirmed = False
        """The operator says that it is homed, where the controller cannot tell."""
        self.facts: tuple[str, ...] = ()
        """What the controller reported when it was last found ready."""
        self._watched = Supervision(controller)
        self._patience = patience
        self._lock = threading.RLock()
        self._state = State.OFF
        self._jobs: queue.SimpleQueue[Job] = queue.SimpleQueue()
        self._job: Job | None = None
        self._unanswered: tuple[Job, ControllerFault] | None = None
        self._problem: ControllerFault | None = None
        self._by_operator = self._vouched = self._closing = self._broken = False
        self._closed_moving = False
        self._consent = 0
        now_s = time.monotonic()
        self._calm_s = self._cause_s = self._owner_s = self._face_s = now_s
        self.owner: threading.Thread | None = None
        self.watcher: threading.Thread | None = None
        self.guard: Guard | None = None
        controller.on_wait = self._lives

    @property
    def state(self) -> State:
        """What the machine may do now."""
        return self._state

    @property
    def may_move(self) -> bool:
        """Whether every key is a stop now."""
        return self._state in MAY_MOVE

    @property
    def not_stopped(self) -> bool:
        """Whether a stop should have been seen by now, or before all was let go, and was not."""
        is_late = time.monotonic() - self._cause_s > STOP_S
        return self._closed_moving or (self._state is State.STOPPING and is_late)

    @property
    def why(self) -> str:
        """What ended the last consent, in words."""
        return f"{NOT_STOPPED} {self._why} ({self._doubt})" if self.not_stopped else self._why

    @property
    def place_mm(self) -> Triple | None:
        """Where the machine was last seen at rest."""
        return self._watched.rest_mm

    @property
    def dead(self) -> bool:
        """Whether a key that comes now was meant for what was before."""
        return time.monotonic() - self._calm_s < self._patience.dead_s

    @property
    def needs_homing_confirmed(self) -> bool:
        """Whether only the operator can tell that the machine is homed."""
        return not (self.controller.tells_homing or self.homing_confirmed)

    @property
    def can_home(self) -> bool:
        """Whether homing by this program, with the operator's consent, would help."""
        return self.controller.locked

    def start(self) -> tuple[str, ...]:
        """`facts`: what is right, and who says so.

        Raises `ControllerFault` for a machine that is not ready. One that only homing makes ready,
        and that nobody else can home, begins in a fault.
        """
        controller, cause = self.controller, Cause.CONNECTED
        try:
            controller.connect()
            try:
                self.facts = controller.ready()
                self._watched.baseline(controller.survey())
            except ControllerFault as problem:
                if not controller.locked or problem.kind is not MotionFault.NOT_READY:
                    raise
                cause, self._why = Cause.FAILED, str(problem)
            self.guard = Guard(controller, self._patience.silence_s)
            self.guard.wait()
        except ControllerFault:
            controller.close()
            raise
        self._change(cause)
        self._start_owner()
        self.watcher = threading.Thread(
            target=self._watch, name=f"motion watch {self.controller.address}", daemon=True
        )
        self.watcher.start()
        return self.facts

    def _start_owner(self) -> None:
        self._owner_s = time.monotonic()
        self.owner = threading.Thread(
            target=self._run, name=f"motion {self.controller.address}", daemon=True
        )
        self.owner.start()

    def alive(self) -> None:
        """The face of the program runs: called more often than the patience is long."""
        self._face_s = time.monotonic()

    def consent(self, *, to_home: bool = False) -> bool:
        """The operator's consent to what is sent next. Returns whether it is taken.

        It is not where the machine is not ready, and not within the dead time.
        """
        with self._lock:
            unknown = self.needs_homing_confirmed and not to_home
            if self.dead or unknown or not self._change(Cause.HOMING if to_home else Cause.CONSENT):
                return False
            self._consent += 1
            self._why = ""
            self._face_s = time.monotonic()
        self.listener()
        return True

    def calm(self) -> None:
        """Something was answered: a key that follows at once was meant for that."""
        self._calm_s = time.monotonic()

    def release(self) -> None:
        """The consent ends; what moves is stopped."""
        with self._lock:
            if self._state is State.MOVING:
                self.stop("the consent ended", by_operator=True)
            elif self._change(Cause.RELEASED):
                self._calm_s = time.monotonic()
        self.listener()

    def deny_homing(self) -> None:
        """The operator says that it is not homed, where only homing by this program helps."""
        self.controller.locked = True  # until it is asked again whether it is ready
        next_step = "Its positions are unknown until it is homed."
        self._interrupt(
            self.controller.fault(MotionFault.NOT_READY, "not homed", "a homed machine", next_step)
        )

    def go(self, places_mm: Sequence[Triple], feed_mm_min: float) -> Future[Triple]:
        """Move to these places one after the other, each waited for, within the present consent."""
        consent = self._consent
        return self.ask(lambda: self._travel(consent, tuple(places_mm), feed_mm_min))

    def home(self) -> Future[Triple]:
        """Home the machine, within the present consent."""
        consent = self._consent
        return self.ask(lambda: self._homed(consent))

    def at(self, place_mm: Triple) -> Future[Triple]:
        """The position now, where it is still this one and nothing else is wrong."""
        return self.ask(lambda: self._is_at(place_mm))

    def answered(self) -> Future[Triple]:
        """The operator looked at what happened: ready again, if the controller is."""
        return self.ask(self._ready_again)

    def vouch(self) -> None:
        """The operator saw that the machine stands still, which the controller cannot tell."""
        with self._lock:
            self._vouched = self._state is State.STOPPING

    def stop(self, why: str, *, by_operator: bool = False) -> None:
        """End what is under way or allowed, from any thread; nothing where nothing is."""
        with self._lock:
            if self.may_move:
                self._interrupt(ControllerFault(MotionFault.STOPPED, why), by_operator=by_operator)

    def close(self) -> None:
        """Stop, end the threads and let go of the controller."""
        self.stop("closed", by_operator=True)
        end_s = time.monotonic() + CLOSE_S
        while self._state is State.STOPPING and self._owner_lives and time.monotonic() < end_s:
            time.sleep(SLICE_S)
        self._closing = True
        self.controller.halt.set()  # whatever is asked, nobody waits for it any more
        for thread in (self.owner, self.watcher):
            if thread is not None and thread is not threading.current_thread():
                thread.join(CLOSE_S)
        resting = self._state is not State.STOPPING
        self._closed_moving = self._closed_moving or not resting
        self._answer_nobody()
        self.controller.close()
        if self.guard is not None:
            self.guard.close(resting=resting)
            self.guard = None
        self._change(Cause.CLOSED)

    # What follows is of the states.

    def _change(self, cause: Cause) -> bool:
        with self._lock:
            following = TRANSITIONS.get((self._state, cause))
            if following is None:
                return False
            self._state = following
        return True

    def _interrupt(self, problem: ControllerFault, *, by_operator: bool = False) -> None:
        """Something ends the consent, or befalls a machine at rest."""
        with self._lock:
            if self._change(Cause.STOP):
                self.controller.halt.set()
                self._problem, self._by_operator = problem, by_operator
                self._cause_s = time.monotonic()
                self._vouched = False
            elif problem.kind in INTERFERENCE:
                if not self._change(Cause.CHANGED):
                    return
            elif not self._change(Cause.FAILED):
                return
            self._why = problem.thing if problem.kind is MotionFault.STOPPED else str(problem)
            self.homing_confirmed &= problem.kind in INTERFERENCE  # a fault may have lost it
            self._broken = self._broken or problem.kind in BROKEN
            self._calm_s = time.monotonic()
        self.listener()

    def _rests(self, place_mm: Triple | None) -> None:
        """Note that the machine rests, as seen after a stop or vouched for by the operator."""
        with self._lock:
            problem = self._problem
            if place_mm is None:
                cause, self._broken = Cause.VOUCHED, True
            elif self._by_operator and (stray := self._watched.strayed(place_mm)):
                cause, self._why = Cause.RESTS_HELD, str(stray)
            elif self._by_operator:
                cause = Cause.RESTS
            elif problem is not None and problem.kind not in INTERFERENCE:
                cause = Cause.RESTS_FAULT
            else:
                cause = Cause.RESTS_HELD
            self._watched.rests(place_mm)
            self.controller.halt.clear()
            self._change(cause)
            self._calm_s = time.monotonic()
        self.listener()

    # What follows runs in the thread that owns the controller.

    def _lives(self) -> None:
        self._owner_s = time.monotonic()

    def _run(self) -> None:
        look_s = time.monotonic()
        while not self._closing or self._state is State.STOPPING:
            self._lives()
            if self._state is State.STOPPING:
                self._bring_to_rest()
                if self._closing:
                    break
                continue
            with contextlib.suppress(queue.Empty):
                self._do(self._jobs.get(timeout=SLICE_S))
            if time.monotonic() - look_s > REST_LOOK_S:
                look_s = time.monotonic()
                self._guarded(self._look_at_rest)
        self._answer_nobody()

    def _do(self, job: Job) -> None:
        self._job = job
        try:
            job.answer.set_result(job.work())
        except ControllerFault as problem:
            self._ended(problem, job)
        except Exception as problem:  # whatever it is: the machine is stopped, and it is said
            self._ended(_of_program(problem), job)

    def _ended(self, problem: ControllerFault, job: Job) -> None:
        """A stop is waited for before the answer, as long as it may take."""
        if problem.kind is not MotionFault.STOPPED:
            self._interrupt(problem)
        self._unanswered = job, problem
        while self._state is State.STOPPING and not self._closing:
            self._bring_to_rest()
        self._answer()

    def _answer(self) -> None:
        """The fault to whoever waits for it; once."""
        if self._unanswered is not None:
            job, problem = self._unanswered
            self._unanswered = None
            with contextlib.suppress(Exception):
                job.answer.set_exception(problem)

    def _guarded(self, work: Callable[[], object]) -> None:
        try:
            work()
        except ControllerFault as problem:
            if problem.kind is not MotionFault.STOPPED:
                self._interrupt(problem)
        except Exception as problem:  # as above
            self._interrupt(_of_program(problem))

    def _bring_to_rest(self) -> None:
        """Stop it; until that is seen the operator is told after `STOP_S`, and it is tried on."""
        try:
            place_mm = self.controller.stop(self._gives_up)
        except Exception as problem:  # as above
            if not isinstance(problem, ControllerFault):
                self._why = str(_of_program(problem))
                time.sleep(SLICE_S)
            if self._vouched:
                self._rests(None)
        else:
            takeover = self.controller.takeover
            if self._by_operator and takeover is not None:  # a key did not take control away
                self._by_operator, self._problem, self._why = False, takeover, str(takeover)
            self._rests(place_mm)

    def _gives_up(self, why: str) -> bool:
        """Whether nobody waits to see it rest any more; why it is not seen is said meanwhile."""
        self._lives()
        self._doubt = why
        if self.not_stopped:
            self._answer()
        return self._vouched or self._closing

    def _travel(self, consent: int, places_mm: tuple[Triple, ...], feed_mm_min: float) -> Triple:
        """Travel along a way, to its last place."""
        limits = self.controller.limits
        for place_mm in places_mm:
            limits.check(place_mm, feed_mm_min)
        self._wait_for_guard()
        there_mm = self._watched.survey().place_mm
        self._begun(consent)
        for place_mm in places_mm:
            there_mm = self._watched.move(there_mm, place_mm, feed_mm_min)
        self._arrived(there_mm)
        return there_mm

    def _wait_for_guard(self) -> None:
        """Wait until the guard's first beat came back: before the last look at the machine."""
        guard = self.guard
        end_s = time.monotonic() + self._patience.silence_s
        while self._state is State.CONSENTED and time.monotonic() < end_s:
            if guard is None or guard.watches:
                break
            self._lives()
            time.sleep(SLICE_S / 4)

    def _begun(self, consent: int) -> None:
        """Raises where this consent is not the present one, or nobody guards."""
        guard = self.guard
        with self._lock:
            if consent != self._consent or self._state is not State.CONSENTED:
                raise self._stopped("before it moved")
            if guard is None or not guard.watches:
                raise _guard_gone()
            self._face_s = self._owner_s = time.monotonic()
            self._change(Cause.MOVE)
        self.listener()

    def _arrived(self, there_mm: Triple) -> None:
        with self._lock:
            if not self._change(Cause.ARRIVED):
                raise self._stopped("as it arrived")
            self._watched.rests(there_mm)
            self._calm_s = time.monotonic()

    def _stopped(self, when: str) -> ControllerFault:
        """The consent ended: when, and why where that is known."""
        value = f"{when}: {self._why}" if self._why else when
        return self.controller.fault(MotionFault.STOPPED, value)

    def _homed(self, consent: int) -> Triple:
        self._wait_for_guard()
        self._begun(consent)
        self._watched.way_mm = None
        self.controller.home()
        self.facts = self.controller.ready()
        self.homing_confirmed = True
        snapshot = self.controller.survey()
        self._watched.baseline(snapshot)
        self._arrived(snapshot.place_mm)
        return snapshot.place_mm

    def _is_at(self, place_mm: Triple) -> Triple:
        """The position, where it is still this one; raises for what is not as it was."""
        if self._state not in LOOKED_AT:
            raise self.controller.fault(MotionFault.STOPPED, self._why or f"{self._state}")
        return self._watched.at(place_mm)

    def _look_at_rest(self) -> None:
        if self._state in LOOKED_AT:
            self._watched.compare(self.controller.look())
        elif self._state is State.HELD:
            self.controller.look()  # a fault only: what was changed is said already

    def _ready_again(self) -> Triple:
        """Make ready after the operator's answer, with a new connection where that is needed."""
        if self._state not in (State.HELD, State.FAULT):
            raise self.controller.fault(MotionFault.STOPPED, f"{self._state}", "held, or a fault")
        try:
            snapshot = self._ready_at_rest()
        except ControllerFault as problem:  # of now, not of before
            self._why, self._broken = str(problem), self._broken or problem.kind in BROKEN
            raise
        self._watched.baseline(snapshot)
        with self._lock:
            self._change(Cause.ANSWERED)
            self._calm_s = time.monotonic()
            self._why = ""
        self.listener()
        return snapshot.place_mm

    def _ready_at_rest(self) -> Snapshot:
        if self._broken or self.guard is None or not self.guard.runs:
            if self._broken:
                self.controller.renew()
            self._renew_guard()  # with the port as it is now, where it was given the former one
            self._broken = False
        self.facts = self.controller.ready()
        snapshot = self.controller.survey()
        if snapshot.moving:
            raise self.controller.fault(MotionFault.ELSEWHERE, "a move that is not of this session")
        return snapshot

    def _renew_guard(self) -> None:
        former_guard, self.guard = self.guard, None
        if former_guard is not None:
            former_guard.close()
        guard = Guard(self.controller, self._patience.silence_s)
        guard.wait()
        self.guard = guard

    # What follows runs in the thread that looks after the others.

    def _watch(self) -> None:
        """Beats for the guard while all live; a stop where one does not."""
        last_s, last_word, silent = time.monotonic(), REST, False
        while not self._closing:
            time.sleep(BEAT_S)
            now_s = time.monotonic()
            gap_s, last_s = now_s - last_s, now_s
            if self._state in MAY_MOVE:
                silent = self._look_after(gap_s, now_s)
                word = HOMING if self.controller.homing else BEAT
                if not silent:
                    self.tell_guard(word)
                    last_word = word
                if self.not_stopped:
                    self.listener()
            elif last_word != REST:
                self.tell_guard(last_word := REST)
            if not self._owner_lives and not self._closing:
                self._revive()

    def _look_after(self, gap_s: float, now_s: float) -> bool:
        """Stops what nobody watches. Returns whether the guard must not hear a beat."""
        silence_s = self._patience.silence_s
        if gap_s > silence_s:
            self.stop(f"the program did not run for {gap_s:.1f} s")
        elif self._state is State.MOVING and now_s - self._face_s > silence_s:
            self.stop(f"the screen did not run for {now_s - self._face_s:.1f} s")
        elif self._state is State.MOVING and self.guard and not self.guard.watches:
            self._interrupt(_guard_gone())
        hung = now_s - self._owner_s > silence_s or not self._owner_lives
        if hung:
            self._interrupt(_of_program(f"no sign of it for {now_s - self._owner_s:.1f} s"))
        return hung

    @property
    def _owner_lives(self) -> bool:
        return self.owner is not None and self.owner.is_alive()

    def _revive(self) -> None:
        """The thread is dead: another one takes over, and stops the machine."""
        problem = _of_program("its thread ended")
        self._interrupt(problem)
        if self._job is not None and not self._job.answer.done():
            self._job.answer.set_exception(problem)
        self._broken = not self.controller.handles()
        self._start_owner()

    def tell_guard(self, word: bytes) -> None:
        """A beat, or a word; nothing where there is no guard."""
        if self.guard is not None:
            self.guard.send(word)

    def ask(self, work: Callable[[], Triple]) -> Future[Triple]:
        """Have something done in the thread that owns the controller."""
        job = Job(work)
        self._jobs.put(job)
        if self._closing or not self._owner_lives:
            self._answer_nobody()
        return job.answer

    def _answer_nobody(self) -> None:
        """Whoever still waits gets a fault."""
        with contextlib.suppress(queue.Empty):
            while True:
                job = self._jobs.get_nowait()
                job.answer.set_exception(self.controller.fault(MotionFault.LOST, "closed"))


def _guard_gone() -> ControllerFault:
    value, requirement = "no sign of life", "a guard that answers: without it nothing moves"
    return ControllerFault(MotionFault.PROGRAM, "guard beside the program", value, requirement)


def _of_program(problem: object) -> ControllerFault:
    return ControllerFault(MotionFault.PROGRAM, "thread of the controller", f"{problem!r}")
