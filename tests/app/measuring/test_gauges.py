"""What an indicator tells a screen, and what changes nothing there."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from app.measuring.gauges import SLOT_S, SLOTS, Gauge, Motion, Trace
from drivers.profile import Fault, FaultKind, IndicatorReading, Outcome, Query
from drivers.profiles.mitutoyo_01a import MITUTOYO_01A

TOLERANCE_MM = 0.004
INTERVAL_S = 0.05
WINDOW_S = 0.3


def reading(value_mm: float) -> IndicatorReading:
    return IndicatorReading(f"{value_mm}", value_mm, 0.001, False)


class Told:
    """An indicator whose port is never opened: `hear` speaks in its place and counts the news."""

    def __init__(self, window_s: float = WINDOW_S) -> None:
        self.gauge = Gauge(
            MITUTOYO_01A,
            "nowhere",
            Query(),
            interval_s=INTERVAL_S,
            window_s=window_s,
            tolerance_mm=TOLERANCE_MM,
        )
        self.now_s = 100.0
        self.news = 0
        self.gauge.on_news = self._count

    def _count(self) -> None:
        self.news += 1

    def hear(self, *outcomes: Outcome) -> int:
        """How often these outcomes were told, one after the other."""
        before = self.news
        for outcome in outcomes:
            self.now_s += INTERVAL_S
            self.gauge.hear(outcome)
        return self.news - before

    def motion(self) -> Motion:
        return self.gauge.live().motion


@pytest.fixture
def indicator(monkeypatch: pytest.MonkeyPatch) -> Told:
    return in_its_time(Told(), monkeypatch)


def in_its_time(indicator: Told, monkeypatch: pytest.MonkeyPatch) -> Told:
    """In a time that passes with what is heard."""
    clock = SimpleNamespace(monotonic=lambda: indicator.now_s)
    monkeypatch.setattr("app.measuring.gauges.time", clock)
    return indicator


@pytest.fixture
def at_rest(indicator: Told) -> Told:
    indicator.hear(*[reading(0.5)] * 10)
    assert indicator.motion() is Motion.STABLE
    return indicator


def test_every_other_digit_is_told_at_once(at_rest: Told) -> None:
    assert at_rest.hear(reading(0.501), reading(0.5), reading(0.501)) == 3


def test_what_stands_still_is_told_no_more(at_rest: Told) -> None:
    assert at_rest.hear(reading(0.5), reading(0.5)) == 0
    at_rest.gauge.restart_window()
    assert at_rest.hear(reading(0.5)) == 1, "when it is stable again is news"


def test_everything_is_told_until_it_is_seen_to_be_stable(indicator: Told) -> None:
    assert indicator.hear(*[reading(0.5)] * 10) == 10
    assert indicator.motion() is Motion.STABLE
    assert indicator.hear(reading(0.5)) == 0


def test_what_was_silent_is_told(at_rest: Told) -> None:
    at_rest.now_s += 2.0
    assert at_rest.motion() is Motion.STALE
    assert at_rest.hear(reading(0.5)) == 1


def test_a_silence_is_missed_sooner_while_the_machine_moves(at_rest: Told) -> None:
    at_rest.now_s += 0.3
    assert at_rest.gauge.lost(moving=True) is None
    at_rest.now_s += 0.1
    assert at_rest.gauge.lost(moving=True) == "silent for 0.4 s"
    assert at_rest.gauge.lost() is None


def test_a_fault_another_one_and_its_end_are_told(at_rest: Told) -> None:
    silent, gone = Fault(FaultKind.NO_ANSWER, "", "no"), Fault(FaultKind.DISCONNECTED, "", "gone")
    assert at_rest.hear(silent) == 1
    assert at_rest.motion() is Motion.FAULT
    assert at_rest.hear(silent) == 0
    assert at_rest.hear(gone, reading(0.5)) == 2


def test_a_button_is_told_and_remembered_once(at_rest: Told) -> None:
    before = at_rest.news
    at_rest.gauge.press(reading(0.5))
    assert at_rest.news == before + 1
    assert at_rest.gauge.button_pressed()
    assert not at_rest.gauge.button_pressed()


def test_a_press_is_of_the_step_that_it_was_meant_for(at_rest: Told) -> None:
    at_rest.gauge.press(reading(0.5))
    at_rest.gauge.restart_window()
    assert not at_rest.gauge.button_pressed()


def test_only_the_window_tells_stable_from_moving(indicator: Told) -> None:
    indicator.hear(reading(0.9), *[reading(0.5)] * 5)
    assert indicator.motion() is Motion.MOVING
    indicator.hear(reading(0.502), reading(0.5), reading(0.502))
    assert indicator.motion() is Motion.STABLE


def test_two_readings_that_come_at_once_after_a_gap_are_no_rest(indicator: Told) -> None:
    """A busy computer heard nothing of the way; the spindle is still on it."""
    indicator.hear(*[reading(0.1)] * 3)
    indicator.now_s += 2.0 * WINDOW_S
    indicator.hear(reading(0.898), reading(0.9))
    assert indicator.motion() is Motion.MOVING
    indicator.hear(*[reading(0.91)] * 10)
    assert indicator.motion() is Motion.STABLE


@pytest.mark.parametrize("window_s", [1.0, 60.0])
def test_a_window_is_heard_whole_however_long(
    window_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    indicator = in_its_time(Told(window_s), monkeypatch)
    count = round(window_s / INTERVAL_S)
    indicator.hear(reading(0.9), *[reading(0.5)] * (count - 1))
    assert indicator.motion() is Motion.MOVING
    indicator.hear(*[reading(0.5)] * 3)
    assert indicator.motion() is Motion.STABLE
    indicator.hear(*[reading(0.5)] * count, reading(0.9))
    assert indicator.motion() is Motion.MOVING


def test_the_band_of_rest_is_a_digit_and_twice_the_flicker_at_rest(indicator: Told) -> None:
    indicator.hear(*[reading(0.5)] * 10)
    assert indicator.motion() is Motion.STABLE
    assert indicator.gauge.rest_mm == pytest.approx(0.001)
    indicator.hear(reading(0.9), reading(0.3))
    assert indicator.motion() is Motion.MOVING
    assert indicator.gauge.rest_mm == pytest.approx(0.001), "a move is no flicker"
    indicator.hear(*[reading(0.3), reading(0.302)] * 5)
    assert indicator.motion() is Motion.STABLE
    indicator.gauge.restart_window()
    assert indicator.gauge.rest_mm == pytest.approx(0.001 + 2 * 0.002)


def test_the_trace_holds_the_last_20_s_with_the_band_of_rest(indicator: Told) -> None:
    indicator.now_s = 100.0 - INTERVAL_S / 2.0  # no reading falls on the edge of a moment
    per_moment = round(SLOT_S / INTERVAL_S)
    indicator.hear(*(reading(float(k)) for k in range(3 * SLOTS * per_moment)))
    trace = indicator.gauge.live().trace()
    assert len(trace.moments) == SLOTS
    assert [ago for ago, _, _ in trace.moments] == list(range(SLOTS - 1, -1, -1))
    lows, highs = [low for _, low, _ in trace.moments], [high for _, _, high in trace.moments]
    assert lows == [float(per_moment * (2 * SLOTS + k)) for k in range(SLOTS)]
    assert [high - low for low, high in zip(lows, highs, strict=True)] == [per_moment - 1] * SLOTS
    indicator.hear(*[reading(0.5), reading(0.502)] * 10)
    assert indicator.gauge.live().trace().band_mm == pytest.approx((0.499, 0.503))
    indicator.hear(reading(0.51))
    assert indicator.motion() is Motion.MOVING
    indicator.gauge.restart_window()
    assert indicator.gauge.live().trace().moments, "the next step does not clear it"
    indicator.now_s += 3.0 * SLOT_S
    assert indicator.gauge.live().trace().moments[-1][0] == 3, "nothing heard for so long"
    indicator.now_s += 20.0
    assert indicator.gauge.live().trace() == Trace()


def test_an_indicator_that_never_answered_is_missed(indicator: Told) -> None:
    assert indicator.gauge.lost(moving=True) == indicator.gauge.lost() == "no answer yet"
    indicator.hear(reading(1.0))
    assert indicator.gauge.lost() is None
