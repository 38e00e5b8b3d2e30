"""A session that is measured without a screen, and what stops a machine that nobody attends."""

from __future__ import annotations

import time
from collections.abc import Callable

from app.measuring.gauges import Motion
from app.measuring.moving import UNATTENDED, Mover, Moving
from app.measuring.session import GuidedSession, TakenStep
from calib.errors import IndicatorError, MotionError, sentence
from protocols.procedure import Step

LOOK_S = 0.02
REST_S = 90.0
"""Longer than any window, 60 s: indicators that do not come to rest within it never do."""


def lost_words(guided: GuidedSession) -> str | None:
    """Which indicator gives no value, and why; a machine that nobody attends is then stopped."""
    for number, gauge in enumerate(guided.gauges):
        words = gauge.lost()
        if words is not None:
            lost = f"{guided.name_of(number)}: {words}"
            if guided.mover is not None and guided.mover.state in UNATTENDED:
                guided.mover.stop(lost)
            return lost
    return None


def measure_all(
    guided: GuidedSession,
    confirm: Callable[[Step], bool] = lambda _: True,
    tell: Callable[[str], None] = lambda _: None,
) -> None:
    """The whole session without a screen; the record is closed.

    Where the machine moves itself ``confirm`` is asked before each set-up. Stops at the first thing
    that is not as it should be, with nothing taken of it; the session can be continued. A simulated
    machine is where it was sent at once, and all of it is kept. Raises MotionError, IndicatorError
    or RecordError.
    """
    mover = guided.mover
    while (step := guided.step()) is not None:
        guided.go()
        if mover is None:
            _take_simulated(guided)
            continue
        if _arrived(guided, mover) is Moving.SET_UP:
            if not confirm(step):
                raise MotionError("set-up", "not confirmed", "a set-up that stands")
            mover.confirm()
            _arrived(guided, mover)
        _at_rest(guided, step)
        taken = guided.take()
        assert taken is not None
        _check(taken)
        tell(f"step {step.number} of {len(guided.steps)}")
    guided.finish()


def _take_simulated(guided: GuidedSession) -> None:
    taken = guided.take()
    if taken is not None and taken.faults:
        raise IndicatorError("simulated indicator", taken.faults[0].words, "a reading")
    if taken is not None and taken.doubt:
        guided.keep(taken, "unattended: kept")


def _arrived(guided: GuidedSession, mover: Mover) -> Moving:
    while (state := mover.state) is Moving.UNDER_WAY:
        lost_words(guided)
        time.sleep(LOOK_S)
    if state is Moving.STOPPED:
        raise MotionError("motion", mover.why, next_step="Continue with: glidecal run --continue")
    return state


def _at_rest(guided: GuidedSession, step: Step) -> None:
    end_s = time.monotonic() + REST_S
    while True:
        lost = lost_words(guided)
        if lost is not None:
            raise IndicatorError("motion", lost, "a reading")
        if all(guided.gauges[k].live().motion is Motion.STABLE for k in step.indicators):
            return
        if time.monotonic() > end_s:
            raise IndicatorError("indicator", f"moving for {REST_S:g} s", "readings at rest")
        time.sleep(LOOK_S)


def _check(taken: TakenStep) -> None:
    if taken.faults:
        raise IndicatorError(f"step {taken.step.number}", sentence(taken.faults[0].words), "")
    if taken.doubt:
        found = f"readings {taken.doubt}"
        next_step = "They do not count. Look at stand and indicators, then continue the session."
        raise IndicatorError(f"step {taken.step.number}", found, "readings as expected", next_step)
