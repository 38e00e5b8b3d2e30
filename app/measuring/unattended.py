"""A session that is measured without a screen, and what stops a machine that nobody attends."""

from __future__ import annotations

import time
from collections.abc import Callable

from app.measuring.doubts import TakenStep
from app.measuring.gauges import Motion
from app.measuring.indicators import adapter_at
from app.measuring.moving import REST_S, MoveProposal, Mover
from app.measuring.session import GuidedSession
from calib.errors import IndicatorError, MotionError, sentence
from drivers.exchange import LATEST
from drivers.motion.states import State
from protocols.procedure import Step

LOOK_S = 0.02
TRIES = 3
"""So often an indicator is asked before the session ends for want of its answer."""


def lost_words(guided: GuidedSession) -> str | None:
    """Which indicator gives no value, and why; a machine that moves is then stopped."""
    mover = guided.mover
    moving = mover is not None and mover.state is State.MOVING
    for number, gauge in enumerate(guided.gauges):
        news = gauge.lost(moving=moving)
        if news is not None:
            fault_words = f"{guided.name_of(number)}: {news}"
            if mover is not None and moving:
                mover.stop(fault_words)
            return fault_words
    return None


def release_lost(guided: GuidedSession) -> None:
    """An indicator that gives no value ends the consent of a machine that rests."""
    mover = guided.mover
    if mover is None or mover.state is not State.CONSENTED or not lost_words(guided):
        return
    if mover.proving or not mover.under_way:
        mover.release()


def measure_all(
    guided: GuidedSession,
    confirm: Callable[[MoveProposal], bool] = lambda _: True,
    tell: Callable[[str], None] = lambda _: None,
    saw: Callable[[str], bool] = lambda _: False,
) -> None:
    """The whole session without a screen; the record is closed.

    Where the machine moves itself ``confirm`` is asked for each consent, and ``saw`` what the
    operator saw of a carriage that is proved. Stops at the first thing
    that is not as it should be, with nothing taken of it; the session can be continued. A simulated
    machine is where it was sent at once, and all of it is kept. Raises MotionError, IndicatorError
    or RecordError.
    """
    mover = guided.mover
    while (step := guided.step()) is not None:
        guided.go()
        if mover is None:
            take_simulated(guided)
            continue
        _go(guided, mover, step, confirm, saw)
        step_taken = _take(guided, step)
        _check(step_taken)
        tell(f"step {step.number} of {len(guided.steps)}")
    guided.finish()


def end_motion(mover: Mover, tell: Callable[[str], None]) -> None:
    """Stop what moves, and ``tell`` at once where it is not seen to rest: closing takes seconds."""
    mover.stop("the session ended", by_operator=True)
    while mover.state in (State.MOVING, State.STOPPING) and not mover.line.not_stopped:
        mover.line.alive()
        time.sleep(LOOK_S)
    if mover.line.not_stopped:
        tell(mover.why)


def home(mover: Mover, tell: Callable[[str], None]) -> None:
    """Home the machine, to which the operator consented; whatever ends the wait stops it.

    Raises MotionError where it cannot be homed.
    """
    homing = mover.home()
    if homing is None:
        return
    try:
        while not homing.done():
            mover.line.alive()
            time.sleep(LOOK_S)
        homing.result()
    except BaseException:
        end_motion(mover, tell)
        raise


def take_simulated(guided: GuidedSession) -> None:
    """The present step of a simulated machine, kept whatever it shows. Raises IndicatorError."""
    step_taken = guided.take()
    if step_taken is not None and step_taken.faults:
        raise IndicatorError("simulated indicator", step_taken.faults[0].words, "a reading")
    if step_taken is not None and step_taken.doubt:
        guided.keep(step_taken, "unattended: kept")


def _go(
    guided: GuidedSession,
    mover: Mover,
    step: Step,
    confirm: Callable[[MoveProposal], bool],
    saw: Callable[[str], bool],
) -> None:
    """Go to a step, with the operator's consent to each way that no earlier one covers."""
    while not mover.is_there(step):
        _wait(guided, mover)
        if mover.is_there(step):
            return
        proof = mover.unproved
        if proof is not None and proof.question:
            guided.note(*mover.answer_proof(yes=saw(proof.question)))
        if proof is not None and proof.wrong:
            raise MotionError("machine, not proved", next_step=proof.wrong)
        if (fault_words := lost_words(guided)) is not None:
            _indicators_back(guided, fault_words)
            continue
        proposal = mover.proposal
        if proposal is None:
            time.sleep(LOOK_S)
            continue
        if not confirm(proposal):
            raise MotionError("consent", "not given", "a consent to each way of the machine")
        if lost_words(guided) is None:  # else it is asked again when all of them answer
            _consent(guided, mover)


def _consent(guided: GuidedSession, mover: Mover) -> None:
    # for a consent to be taken: longer than the dead time after a stop or an arrival
    end_s = time.monotonic() + 5.0
    while not mover.consent():  # not within the dead time after the last arrival
        if time.monotonic() > end_s:
            raise MotionError("motion", mover.why or mover.state, "a machine that is ready")
        _wait(guided, mover)
        time.sleep(LOOK_S)


def _wait(guided: GuidedSession, mover: Mover) -> None:
    """Wait until the machine rests. Raises MotionError for what stopped it.

    Only a silent indicator that answers again is over by itself.
    """
    silences = set[str | None]()
    while True:
        mover.line.alive()
        guided.note(*mover.watch())
        silences.add(lost_words(guided))
        if mover.proving:
            release_lost(guided)
        state = mover.state
        if state is State.HELD and mover.why in silences:
            _indicators_back(guided, mover.why)
            mover.answer().result()
            return
        if mover.interrupted or state is State.STOPPED:
            if (proof := mover.unproved) and proof.wrong:
                raise MotionError("machine, not proved", next_step=proof.wrong)
            next_step = "Continue with: glidecal run --continue"
            raise MotionError("motion", mover.why, next_step=next_step)
        if not mover.under_way and state is not State.STOPPING:
            return
        time.sleep(LOOK_S)


def _indicators_back(guided: GuidedSession, fault_words: str) -> None:
    """Return when every indicator answers again, each asked so often, at the adapter that it had.

    Raises IndicatorError.
    """
    slowest_s = max(gauge.profile.timeout_s for gauge in guided.gauges)
    # after an answer that is missed its exchange is silent, lest an old one be taken for a new one
    end_s = time.monotonic() + TRIES * (LATEST + 1.0) * slowest_s
    while lost_words(guided) is not None:
        if time.monotonic() > end_s:
            raise IndicatorError("motion", fault_words, "a reading")
        time.sleep(LOOK_S)
    for number, gauge in enumerate(guided.gauges):
        adapter = adapter_at(gauge.port) if gauge.adapter else ""
        if adapter != gauge.adapter:
            name, device = guided.name_of(number), f"adapter {adapter or 'unknown'} at its port"
            next_step = "Plug the cables in as they were, then: glidecal run --continue"
            raise IndicatorError(name, device, f"adapter {gauge.adapter}, as before", next_step)


def _take(guided: GuidedSession, step: Step) -> TakenStep:
    """The readings of a step; an indicator that answers late is asked again."""
    for tries_left in reversed(range(TRIES)):
        _at_rest(guided, step)
        step_taken = guided.take()
        if step_taken is not None and not (step_taken.faults and tries_left):
            return step_taken
    raise MotionError(f"step {step.number}", "a closed session", "an open one")


def _at_rest(guided: GuidedSession, step: Step) -> None:
    """Wait until the indicators of a step rest. Raises IndicatorError."""
    end_s = time.monotonic() + REST_S
    while time.monotonic() < end_s:
        if (fault_words := lost_words(guided)) is not None:
            _indicators_back(guided, fault_words)
        if all(guided.gauges[k].live().motion is Motion.STABLE for k in step.indicators):
            return
        time.sleep(LOOK_S)
    raise IndicatorError("indicator", f"moving for {REST_S:g} s", "readings at rest")


def _check(step_taken: TakenStep) -> None:
    if step_taken.faults:
        raise IndicatorError(
            f"step {step_taken.step.number}", sentence(step_taken.faults[0].words), ""
        )
    if step_taken.doubt:
        number = step_taken.questioned[0].step
        problem = f"readings {step_taken.doubt}"
        next_step = "They are not used. Look at stand and indicators, then continue the session."
        raise IndicatorError(f"step {number}", problem, "readings as expected", next_step)
