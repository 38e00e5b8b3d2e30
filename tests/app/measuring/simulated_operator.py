"""An operator who forgets to move, at a machine of its own, in simulated time.

What the indicators show comes from `tests.blind.forward`, which shares nothing with the prediction.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from app.measuring.doubts import Doubt, TakenStep
from app.measuring.gauges import Gauge, Motion
from app.measuring.session import GuidedSession, Indicators
from drivers.profile import IndicatorReading, Outcome, Query
from drivers.profiles.mitutoyo_01a import MITUTOYO_01A
from protocols.clock import SessionClock
from protocols.expectation import Movement
from protocols.journal import Journal
from protocols.machine import Instrument, Machine
from protocols.procedure import Step, leg_number, load_procedure
from protocols.record import read_record
from protocols.session import Opened
from tests.blind.forward import Hidden, Rows, readings

PACE_S = 0.2
SCATTER_MM = 0.002
DRIFT_MM_S = 0.001
LEVELS = (0.0, 60.0, -100.0)
Table = dict[tuple[str, str, float], float]
"""Leg, axis and displacement → what an indicator there shows, mm, without its zero."""


def hidden(chance: np.random.Generator, offset_mm: float, length_mm: float) -> Hidden:
    """A machine with offsets and lengths of these tolerances, and with more than those."""
    amounts = Hidden().amounts
    amounts["offset"] = chance.normal(scale=offset_mm, size=3)
    amounts["length"] = chance.normal(scale=length_mm, size=3)
    amounts["lean"] = chance.normal(scale=2e-4 * offset_mm, size=(3, 3))
    amounts["scale"] = chance.normal(scale=2e-4 * offset_mm, size=3)
    return Hidden(amounts)


def table(machine: Hidden) -> Table:
    """Every reading of the procedures that go to Zero, Max and Min."""
    keys = [(leg, axis, at) for leg in "xyz" for axis in "xyz" if axis != leg for at in LEVELS]
    n = len(keys)
    rows = Rows(
        leg=np.array([leg_number(leg) for leg, _, _ in keys]),
        axis=np.array([leg_number(axis) for _, axis, _ in keys]),
        displacement_mm=np.array([at for _, _, at in keys]),
        station=np.full(n, 0.5),
        time_s=np.zeros(n),
        cycle=np.ones(n, dtype=np.intp),
        visit=np.arange(n),
        mount=np.zeros(n, dtype=np.intp),
        moved=np.zeros((n, 3)),
    )
    return dict(zip(keys, readings(rows, machine).tolist(), strict=True))


@dataclass
class Bench:
    """The machine, the stand and the clock: what each indicator shows at any moment."""

    chance: np.random.Generator
    truth: Table
    digit_mm: float
    flicker: tuple[int, int]
    now_s: float = 1000.0
    at: Step | None = None
    shown_mm: list[float] = field(default_factory=lambda: [0.0, 0.0])
    from_mm: list[float] = field(default_factory=lambda: [0.0, 0.0])
    zero_mm: list[float] = field(default_factory=lambda: [0.0, 0.0])
    rate_mm_s: list[float] = field(default_factory=lambda: [0.0, 0.0])
    moving_s: tuple[float, float] = (0.0, 0.0)
    bump: tuple[float, float, float] = (0.0, 1.0, 0.0)

    def set_up(self, step: Step) -> None:
        """The stand at a new place: other zeros, another drift; the machine at Zero."""
        self.rate_mm_s = [float(r) * DRIFT_MM_S for r in self.chance.choice([-1, 1], 2)]
        self.zero_mm = [
            float(self.chance.normal(0, 0.5)) - rate * self.now_s for rate in self.rate_mm_s
        ]
        self.arrive(step)
        self.from_mm, self.moving_s = list(self.shown_mm), (self.now_s, self.now_s)

    def arrive(self, step: Step) -> None:
        self.at = step
        self.shown_mm = [
            self.truth[step.leg, axis, step.displacement_mm] + self.chance.normal(0, SCATTER_MM)
            for axis in step.axes
        ]

    def move(self, step: Step) -> float:
        """Begin to move there; returns how long it takes."""
        way_mm = abs(step.displacement_mm - (self.at.displacement_mm if self.at else 0.0))
        takes_s = way_mm / self.chance.uniform(20.0, 100.0)
        self.from_mm = list(self.shown_mm)
        self.arrive(step)
        self.moving_s = (self.now_s, self.now_s + takes_s)
        return float(takes_s)

    def knock(self) -> None:
        """Somebody bumps into the table: readings swing and come back."""
        size_mm = self.chance.choice([-1, 1]) * self.chance.uniform(0.01, 0.3)
        self.bump = (self.now_s, float(self.chance.uniform(0.1, 0.4)), float(size_mm))

    def show(self, number: int) -> IndicatorReading:
        start_s, end_s = self.moving_s
        part = 1.0 if self.now_s >= end_s else (self.now_s - start_s) / (end_s - start_s)
        value = self.from_mm[number] + part * (self.shown_mm[number] - self.from_mm[number])
        value += self.zero_mm[number] + self.rate_mm_s[number] * self.now_s
        began_s, decay_s, size_mm = self.bump
        since_s = self.now_s - began_s
        swing = math.exp(-since_s / decay_s) * math.cos(40.0 * since_s)
        value += size_mm * swing * (1.0 if number else 0.6)
        digits = round(value / self.digit_mm) + int(
            self.chance.integers(0, self.flicker[number] + 1)
        )
        return IndicatorReading(
            f"{digits}", digits * self.digit_mm, self.digit_mm, unit_assumed=True
        )


class BenchGauge(Gauge):
    """A gauge whose line is the bench."""

    def __init__(self, bench: Bench, number: int) -> None:
        super().__init__(
            MITUTOYO_01A, "", Query(), interval_s=PACE_S, window_s=1.0, tolerance_mm=0.004
        )
        self._bench, self._number = bench, number

    def listen(self) -> None:
        self.hear(self._bench.show(self._number))

    def ask(self) -> Future[Outcome]:
        future = Future[Outcome]()
        future.set_result(self._bench.show(self._number))
        return future


@dataclass
class Tally:
    """How often what happened."""

    steps: int = 0
    forgotten: int = 0  # takes without a move where one was to be seen
    stored: int = 0  # those of them that count without a question
    on_his_word: int = 0  # takes by the key, not asked, where no move was to be seen
    noted: int = 0  # remarks on takes whose move nothing showed
    honest: int = 0
    asked: int = 0  # honest takes that were questioned
    refused: int = 0  # honest ones that the automatic did not take, though a move was to be seen
    left_to_key: int = 0  # and where none was to be seen


class Operator:
    """Measures one whole session by hand, forgetting to move now and then, or automatically."""

    def __init__(self, bench: Bench, guided: GuidedSession, tally: Tally) -> None:
        self.bench, self.guided, self.tally = bench, guided, tally
        self.chance = bench.chance
        self.taken_s = bench.now_s

    def wait(self, seconds: float) -> None:
        """Time passes, the indicators are heard."""
        until_s = self.bench.now_s + seconds
        while self.bench.now_s < until_s:
            self.bench.now_s += PACE_S
            for gauge in self.guided.gauges:
                assert isinstance(gauge, BenchGauge)
                gauge.listen()

    def stable(self) -> bool:
        return all(gauge.live().motion is Motion.STABLE for gauge in self.guided.gauges)

    def lift_spindles(self) -> None:
        """As a stand is taken to another leg: both zeros may be as before, but not the way."""
        for gauge in self.guided.gauges:
            for far_mm in (5.0, -5.0):
                far = IndicatorReading("", far_mm, self.bench.digit_mm, unit_assumed=True)
                gauge.hear(far)

    def until_stable(self) -> None:
        for _ in range(100):
            self.wait(PACE_S)
            if self.stable():
                return

    def visible(self, step: Step) -> bool:
        """Whether the way to a step shows beyond flicker, drift since the last take and noise."""
        assert self.bench.at is not None
        drift_mm = DRIFT_MM_S * (self.bench.now_s - self.taken_s)
        return any(
            abs(
                self.bench.truth[step.leg, axis, step.displacement_mm]
                - self.bench.truth[step.leg, axis, self.bench.at.displacement_mm]
            )
            > (2 * flicker + 1) * self.bench.digit_mm + 5.0 * 2.0**0.5 * SCATTER_MM + drift_mm
            for axis, flicker in zip(step.axes, self.bench.flicker, strict=True)
        )

    def take(self) -> TakenStep:
        taken_step = self.guided.take()
        assert taken_step is not None
        assert not taken_step.faults
        return taken_step

    def measure(self, *, automatic: bool) -> None:
        while (step := self.guided.step()) is not None:
            self.tally.steps += 1
            self.guided.go()
            if self.guided.session.is_new_place(step):
                self.bench.set_up(step)
                self.lift_spindles()
                self.wait(2.0)
                assert self.take().doubt is None
                self.taken_s = self.bench.now_s
            elif automatic:
                self.automatically(step)
            else:
                self.by_hand(step)

    def by_hand(self, step: Step) -> None:
        while self.chance.random() < 0.3:
            self.wait(float(self.chance.uniform(0.2, 30.0)))
            if self.chance.random() < 0.3:
                self.bench.knock()
            self.until_stable()
            is_visible = self.visible(step)
            doubt = self.counted(self.take())
            self.tally.on_his_word += not is_visible and doubt is None
            self.tally.forgotten += is_visible
            self.tally.stored += is_visible and doubt is None
            if doubt is None:
                self.bench.move(step)  # as the record has it now
                self.wait(5.0)
                return
        self.wait(float(self.chance.uniform(1.0, 5.0)))
        self.wait(self.bench.move(step))
        self.wait(float(self.chance.uniform(1.2, 10.0)))
        self.honest_take()

    def counted(self, taken_step: TakenStep) -> Doubt | None:
        """What is doubted of these readings; where it is an earlier step he keeps all."""
        if taken_step.doubt is not Doubt.ODD:
            return taken_step.doubt
        self.guided.keep(taken_step, "it is right")
        return None

    def honest_take(self) -> bool:
        """Whether it was taken without a question; else it is kept."""
        taken_step = self.take()
        self.tally.honest += 1
        self.taken_s = self.bench.now_s
        if taken_step.doubt:
            self.tally.asked += 1
            self.guided.keep(taken_step, "it is right")
        return taken_step.doubt is None

    def looked(self, step: Step) -> bool:
        """What the screen does in automatic mode, after each news."""
        return self.stable() and self.guided.moved() is Movement.CONFIRMED

    def automatically(self, step: Step) -> None:
        idle_until_s = self.bench.now_s + self.chance.uniform(0.5, 25.0)
        is_visible = self.visible(step)
        self.tally.forgotten += is_visible
        while self.bench.now_s < idle_until_s:
            self.wait(PACE_S)
            if self.chance.random() < 0.01:
                self.bench.knock()
            if self.looked(step):
                doubt = self.counted(self.take())
                self.tally.stored += is_visible and doubt is None
                if doubt is None:
                    return
        is_visible = self.visible(step)
        self.wait(self.bench.move(step))
        for _ in range(int(6.0 / PACE_S)):
            self.wait(PACE_S)
            if self.looked(step):
                self.honest_take()
                return
        self.tally.refused += is_visible
        self.tally.left_to_key += not is_visible
        self.tally.on_his_word += self.honest_take() and not is_visible


@contextmanager
def opened_on(
    folder: Path,
    name: str,
    chance: np.random.Generator,
    patch: pytest.MonkeyPatch,
    kind: type[Bench] = Bench,
    *,
    calibrated: bool = False,
) -> Iterator[tuple[Bench, GuidedSession]]:
    """A session that was begun on a machine of its own; it is finished in the end."""
    size_mm = (0.01, 0.005) if calibrated else (2.0, 0.1)
    bench = kind(
        chance,
        table(hidden(chance, *size_mm)),
        float(chance.choice([0.001, 0.0001, 0.0005])),
        (int(chance.integers(0, 4)), int(chance.integers(0, 4))),
    )
    machine = Machine(entered_offsets_mm=(1.0, -1.0, 0.5) if calibrated else (0.0, 0.0, 0.0))
    procedure = load_procedure("zero-max-min", machine.geometry())
    instruments = (Instrument(profile="mitutoyo-01a"), Instrument(profile="mitutoyo-01a"))
    opened = Opened(
        program="test",
        origin="measured",
        machine=machine,
        procedure=procedure,
        instruments=instruments,
    )
    patch.setattr("app.measuring.gauges.time", SimpleNamespace(monotonic=lambda: bench.now_s))
    begun = datetime(2026, 1, 1, tzinfo=UTC)
    journal = Journal.create(folder / f"{name}.jsonl", opened)
    clock = SessionClock(
        journal.events, lambda: bench.now_s, lambda: begun + timedelta(seconds=bench.now_s)
    )
    gauges = tuple(BenchGauge(bench, number) for number in range(2))
    with GuidedSession(journal, Indicators(gauges), clock) as guided:
        yield bench, guided
        guided.finish()


@contextmanager
def session(folder: Path, seed: int, patch: pytest.MonkeyPatch, tally: Tally) -> Iterator[Operator]:
    """One session on a machine of its own; every fifth was calibrated before."""
    chance = np.random.default_rng(seed)
    with opened_on(folder, str(seed), chance, patch, calibrated=seed % 5 == 4) as (bench, guided):
        yield Operator(bench, guided, tally)
    events = read_record(guided.path).events
    tally.noted += sum(e.event == "noted" and "operator's word" in e.text for e in events)
