"""The time of a session: by a clock that nobody sets, whatever the computer's clock is set to."""

from __future__ import annotations

import sys
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from app.evaluating.loading import load_sessions
from protocols.clock import AWAY_S, SessionClock, SleepWatch, steady_s
from protocols.documents import LONGEST_S
from protocols.journal import write_whole
from protocols.observations import to_observations
from protocols.session import Continued, Event, Noted, fold
from tests.protocols.test_journal import opened, reading

BEGIN = datetime(2026, 3, 1, 8, 0, tzinfo=UTC)


class Clocks:
    """A steady clock and a wall clock, both moved by hand."""

    def __init__(self) -> None:
        self.now_s = 5000.0
        self.set_s = 0.0

    def steady_s(self) -> float:
        return self.now_s

    def wall(self) -> datetime:
        return BEGIN + timedelta(seconds=self.now_s - 5000.0 + self.set_s)

    def of(self, *events: Event) -> SessionClock:
        return SessionClock(events, self.steady_s, self.wall)


def begun() -> Event:
    return opened().model_copy(update={"at": BEGIN})


@pytest.mark.parametrize("set_s", [-3600.0, 3600.0, -86400.0])
def test_setting_the_clock_changes_no_interval_and_is_told_once(set_s: float) -> None:
    clocks = Clocks()
    clock = clocks.of(begun())
    clocks.now_s += 100.0
    assert (clock.time_s(), clock.jump_s()) == (100.0, 0.0)
    clocks.set_s = set_s
    clocks.now_s += 20.0
    assert clock.time_s() == 120.0
    assert clock.jump_s() == pytest.approx(set_s)
    assert clock.jump_s() == 0.0


def test_a_clock_that_follows_a_time_server_is_not_set() -> None:
    """500 ppm, the most that it is moved, for a day with a look every half hour."""
    clocks = Clocks()
    clock = clocks.of(begun())
    for _ in range(48):
        clocks.now_s += 1800.0
        clocks.set_s += 1800.0 * 500e-6
        assert clock.jump_s() == 0.0
    assert clock.time_s() == 86400.0


@pytest.mark.parametrize(("away_s", "slept_s"), [(AWAY_S - 5.0, 0.0), (AWAY_S + 5.0, AWAY_S + 5.0)])
def test_windows_has_one_clock_and_a_minute_is_sleep(
    away_s: float, slept_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("protocols.clock.sys", SimpleNamespace(platform="win32"))
    watch = SleepWatch()
    awake = time.monotonic
    late = SimpleNamespace(monotonic=lambda: awake() + away_s)
    monkeypatch.setattr("protocols.clock.time", SimpleNamespace(**vars(time) | vars(late)))
    assert watch.slept_s() == pytest.approx(slept_s, abs=1.0)


@pytest.mark.skipif(
    sys.platform == "win32", reason="one clock cannot tell sleep from a busy computer"
)
@pytest.mark.parametrize(("held_up_s", "slept_s"), [(5.0, 0.0), (90.0, 0.0), (0.0, 720.0)])
def test_a_busy_computer_did_not_sleep(
    held_up_s: float, slept_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While a computer sleeps one of its two clocks stands still."""
    watch = SleepWatch()
    awake = time.monotonic
    late = SimpleNamespace(monotonic=lambda: awake() + held_up_s)
    monkeypatch.setattr("protocols.clock.steady_s", lambda: steady_s() + held_up_s + slept_s)
    monkeypatch.setattr("protocols.clock.time", SimpleNamespace(**vars(time) | vars(late)))
    assert watch.slept_s() == pytest.approx(slept_s, abs=1.0)
    assert watch.slept_s() == 0.0


@pytest.mark.parametrize(("paused_s", "counted_s"), [(600.0, 600.0), (-3000.0, 0.0), (1.79e9, 0.0)])
def test_a_break_counts_as_the_wall_clock_says_and_never_back(
    paused_s: float, counted_s: float
) -> None:
    first = reading(1).model_copy(update={"at": BEGIN + timedelta(seconds=90), "time_s": 80.0})
    noted = Noted(text="before", at=first.at + timedelta(seconds=10))
    again = Continued(program="test", at=noted.at + timedelta(seconds=paused_s))
    clocks = Clocks()
    clock = clocks.of(begun(), first, noted, again)
    clocks.now_s += 5.0
    assert clock.time_s() == pytest.approx(80.0 + 10.0 + counted_s + 5.0)


def test_no_time_is_longer_than_a_record_takes() -> None:
    last = reading(1).model_copy(update={"at": BEGIN, "time_s": LONGEST_S})
    clocks = Clocks()
    clock = clocks.of(begun(), last)
    clocks.now_s += 5.0
    assert clock.time_s() == LONGEST_S


def test_times_that_go_back_are_told_and_not_used(tmp_path: Path) -> None:
    """As an older program, or a table, wrote them."""
    readings = [
        reading(n).model_copy(update={"time_s": time_s})
        for n, time_s in enumerate((10.0, 20.0, -3570.0, -3560.0), start=1)
    ]
    path = tmp_path / "s.jsonl"
    write_whole(path, opened(), [*readings])
    sessions, warnings = load_sessions([path])
    assert warnings == [
        "s.jsonl: time_s goes back at reading 3: the clock was set. Its times are not used, so "
        "drift with time cannot be computed."
    ]
    assert np.isnan(to_observations(sessions).time_s).all()
    session = fold([opened(), *readings[:2]])
    assert to_observations([session]).time_s.tolist() == [10.0, 20.0]


@pytest.mark.skipif(not hasattr(time, "tzset"), reason="needs time.tzset")
def test_a_day_is_that_of_the_place(monkeypatch: pytest.MonkeyPatch) -> None:
    """Thirteen hours ahead of UTC it is tomorrow there, on certificates wherever they are made."""
    with monkeypatch.context() as patch:
        patch.setenv("TZ", "THERE-13")
        time.tzset()
        line = Noted(text="measured before breakfast").model_dump_json()
    time.tzset()
    event = Noted.model_validate_json(line)
    assert event.at.utcoffset() == timedelta(hours=13)
    assert event.at.date() == (event.at.astimezone(UTC) + timedelta(hours=13)).date()
    assert abs(datetime.now(UTC) - event.at) < timedelta(minutes=1)
