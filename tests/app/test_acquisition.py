"""What an indicator has to tell a screen at once, and what can wait."""

from __future__ import annotations

from app.acquisition import Gauge, Live, Motion
from drivers.outcome import Asked, Fault, FaultKind, Outcome, Reading
from drivers.profiles.mitutoyo_01a import MITUTOYO_01A

TOLERANCE_MM = 0.004


def gauge() -> Gauge:
    """An indicator whose port is never opened; `tell` speaks in its place."""
    asked = Asked()
    return Gauge(MITUTOYO_01A, "nowhere", asked, window_s=0.3, tolerance_mm=TOLERANCE_MM)


def reading(value_mm: float, resolution_mm: float = 0.001) -> Reading:
    return Reading(f"{value_mm}", value_mm, resolution_mm, False)


def urgent(shown: Live | None, outcome: Outcome) -> bool:
    """Whether this outcome must be shown at once beside what is shown."""
    one = gauge()
    one._hear(outcome)
    return one.has_news(shown)


def stable(outcome: Outcome) -> Live:
    return Live(outcome, 0.0, Motion.STABLE, ())


def test_a_flickering_last_digit_of_a_stable_indicator_can_wait() -> None:
    assert not urgent(stable(reading(0.5)), reading(0.501))
    assert not urgent(stable(reading(0.5)), reading(0.498))
    assert not urgent(stable(reading(0.5)), reading(0.5))


def test_more_than_a_flicker_cannot_wait() -> None:
    assert urgent(stable(reading(0.5)), reading(0.503))
    assert urgent(stable(reading(0.5, 0.01)), reading(0.52, 0.01)), "further than standing still"


def test_nothing_waits_while_an_indicator_is_not_stable() -> None:
    for motion in (Motion.MOVING, Motion.WAITING, Motion.STALE, Motion.FAULT):
        assert urgent(Live(reading(0.5), 0.0, motion, ()), reading(0.5))
    assert urgent(None, reading(0.5))


def test_a_fault_and_the_end_of_one_cannot_wait() -> None:
    silent = Fault(FaultKind.NO_ANSWER, "", "no answer")
    assert urgent(stable(reading(0.5)), silent)
    assert urgent(stable(silent), reading(0.5))


def test_a_button_cannot_wait_and_news_are_told_once() -> None:
    one = gauge()
    shown = stable(reading(0.5))
    assert not one.has_news(shown), "nothing was heard"
    one._hear(reading(0.5))
    one.press(reading(0.5))
    assert one.has_news(shown)
    assert one.button_pressed()
    assert not one.has_news(None)
