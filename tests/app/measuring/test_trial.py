"""Which spindle a hand pushed: found, exchanged, of the wrong sign, or nothing at all."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from app.measuring.gauges import HELD_S, Live, Motion, PushResult, SpindleCheck
from drivers.profile import Fault, FaultKind, IndicatorReading
from protocols.machine import Instrument

FIRST = Instrument(profile="sylvac", port="A", axes="yx")
SECOND = Instrument(profile="mitutoyo-01a", port="B", axes="zy")
LOOKS_S = 0.1
WINDOW_S = 1.0


class Bench:
    """Two spindles that somebody pushes, read ten times a second with a flickering last digit."""

    def __init__(self, chance: np.random.Generator) -> None:
        self.chance = chance
        self.now_s = 50.0
        self.at_mm = chance.uniform(-3.0, 3.0, 2)
        self.moved_s = -10.0

    def look(self, trial: SpindleCheck, away_mm: tuple[float, float]) -> bool:
        """One look at indicators that stand so far from rest."""
        self.now_s += LOOKS_S
        if any(away_mm):
            self.moved_s = self.now_s
        moving = self.now_s - self.moved_s < WINDOW_S
        motion = Motion.MOVING if moving else Motion.STABLE
        values_mm = self.at_mm + away_mm + 0.001 * self.chance.integers(0, 4, 2)
        return trial.look(
            [Live(IndicatorReading("", v, 0.001, False), 0.0, motion) for v in values_mm.tolist()]
        )

    def rest(self, trial: SpindleCheck, seconds: float) -> int:
        """How many pushes come to their end meanwhile."""
        return sum(self.look(trial, (0.0, 0.0)) for _ in range(round(seconds / LOOKS_S)))

    def push(self, trial: SpindleCheck, number: int, size_mm: float, crosstalk: float = 0.0) -> int:
        """A push in and out, in some tenths of a second, that moves the other by a share."""
        steps = int(self.chance.integers(3, 15))
        count = 0
        for k in range(1, steps):
            away = size_mm * np.sin(np.pi * k / steps)
            pushes = [crosstalk * away, crosstalk * away]
            pushes[number] = away
            count += self.look(trial, (pushes[0], pushes[1]))
        return count + self.rest(trial, 2.0)


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Bench:
    rig = Bench(np.random.default_rng(4))
    clock = SimpleNamespace(monotonic=lambda: rig.now_s)
    monkeypatch.setattr("app.measuring.gauges.time", clock)
    return rig


def test_pushes_of_every_kind_are_told_apart(bench: Bench) -> None:
    """500 of each; a neighbour that is shaken moves a fifth as far."""
    for _ in range(500):
        trial = SpindleCheck((FIRST, SECOND))
        bench.rest(trial, 0.5)
        sign = float(bench.chance.choice([-1.0, 1.0]))
        size_mm = sign * float(bench.chance.uniform(0.5, 12.0))
        way = "larger" if sign > 0.0 else "smaller"
        wrong = bool(bench.chance.integers(0, 2))
        assert bench.push(trial, int(wrong), size_mm, crosstalk=0.2) == 1
        if wrong:
            assert trial.finding is PushResult.OTHER
            assert not trial.ways
            continue
        assert trial.ways == {0: way}
        assert bench.push(trial, 1, -size_mm) == 1
        assert trial.done
        assert trial.known()[0].pushed_in == way
        assert trial.known()[1].pushed_in != way


def test_flicker_a_touched_table_and_drift_are_no_push(bench: Bench) -> None:
    trial = SpindleCheck((FIRST, SECOND))
    for _ in range(300):
        bench.at_mm += 0.05
        assert bench.rest(trial, 0.3) == 0
        assert bench.push(trial, 0, float(bench.chance.uniform(-0.15, 0.15)), crosstalk=0.9) == 0
    assert trial.finding is PushResult.NOTHING
    assert not trial.ways


def test_two_that_move_together_are_asked_for_one_at_a_time(bench: Bench) -> None:
    trial = SpindleCheck((FIRST, SECOND))
    bench.rest(trial, 0.5)
    assert bench.push(trial, 0, 2.0, crosstalk=0.8) == 1
    assert trial.finding is PushResult.BOTH
    assert not trial.ways


def test_exchanged_ports(bench: Bench) -> None:
    trial = SpindleCheck((FIRST, SECOND))
    bench.rest(trial, 0.5)
    bench.push(trial, 1, 2.0)
    assert trial.finding is PushResult.OTHER
    trial.exchange()
    assert [(instrument.port, instrument.axes) for instrument in trial.instruments] == [
        ("B", "yx"),
        ("A", "zy"),
    ]
    assert (trial.ways, trial.number_due) == ({0: "larger"}, 1)
    bench.push(trial, 1, -2.0)
    assert trial.done
    assert [instrument.pushed_in for instrument in trial.known()] == ["larger", "smaller"]
    assert "ports exchanged; indicator 1 (mitutoyo-01a, B) pushed by hand, read larger" in (
        trial.remark()
    )


def test_a_sign_that_is_not_the_stated_one_is_not_found(bench: Bench) -> None:
    trial = SpindleCheck((FIRST.model_copy(update={"pushed_in": "larger"}), SECOND))
    bench.rest(trial, 0.5)
    bench.push(trial, 0, -2.0)
    assert (trial.finding, trial.last, trial.ways) == (PushResult.SIGN, "smaller", {})
    bench.push(trial, 0, 2.0)
    assert trial.ways == {0: "larger"}


def test_what_is_held_or_mounted_anew_is_no_push(bench: Bench) -> None:
    """A spindle that is held counts when it is let go; what stays away never does."""
    trial = SpindleCheck((FIRST, SECOND))
    bench.rest(trial, 0.5)
    for _ in range(5):
        bench.look(trial, (2.0, 0.0))
    bench.at_mm[0] += 2.0
    assert bench.rest(trial, HELD_S / 2.0) == 0
    bench.at_mm[0] -= 2.0
    for _ in range(3):
        bench.look(trial, (0.5, 0.0))
    assert bench.rest(trial, 2.0) == 1
    assert trial.ways == {0: "larger"}
    bench.at_mm[1] += 3.0
    bench.look(trial, (0.0, 0.1))
    assert bench.rest(trial, 2.0 * HELD_S) == 0
    assert bench.push(trial, 1, 1.0) == 1
    assert trial.done


def test_a_fault_stops_looking_and_nothing_tried_is_said(bench: Bench) -> None:
    trial = SpindleCheck((FIRST,))
    fault = Live(Fault(FaultKind.NO_ANSWER, "", "silent"), 0.0, Motion.FAULT)
    assert not trial.look([fault])
    assert trial.remark() == "before the first reading: indicator 1 (sylvac, A) not pushed by hand"
    assert trial.known() == (FIRST,)
