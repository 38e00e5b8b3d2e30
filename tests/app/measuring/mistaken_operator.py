"""An operator who makes one mistake in a session, and answers truly what he is asked.

He knows what he can see when he is asked: where the machine is now, the sign and the unit that an
indicator shows now, and, where he noticed it, that the stand was touched. He does not know what was
wrong earlier. ``python -m tests.app.measuring.mistaken_operator 60`` prints what became of them.
"""

from __future__ import annotations

import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from app.measuring.doubts import Doubt, TakenStep
from app.measuring.session import GuidedSession
from drivers.profile import IndicatorReading
from protocols.procedure import Step
from tests.app.measuring.simulated_operator import (
    LEVELS,
    SCATTER_MM,
    Bench,
    BenchGauge,
    opened_on,
)

Kind = Literal["none", "posture", "leg", "sign", "unit", "sign, stays", "unit, stays", "touched"]
KINDS: tuple[Kind, ...] = (
    "posture", "leg", "sign", "unit", "sign, stays", "unit, stays", "touched",
)  # fmt: skip
RIGHT_MM = 0.1
"""Twice what is never questioned: less may be left in readings that count."""

GOOD_MM = 0.05
"""A reading so near to the truth is not to be accused: the procedures' repeat limit."""

MOST_QUESTIONS = 60


@dataclass
class MistakenBench(Bench):
    """A bench on which something is wrong now."""

    turned: int | None = None
    inch: int | None = None

    def show(self, number: int) -> IndicatorReading:
        right = super().show(number)
        sign = -1.0 if self.turned == number else 1.0
        scale = 25.4 if self.inch == number else 1.0
        digits = round(sign * right.value_mm / scale / self.digit_mm)
        return replace(right, value_mm=digits * self.digit_mm)

    def arrive_wrongly(self, step: Step, kind: Kind) -> None:
        """At another posture of this leg, or as far along another leg's axis."""
        wrong = step
        if kind == "posture":
            levels = [at for at in LEVELS if at != step.displacement_mm]
            wrong = replace(step, displacement_mm=float(self.chance.choice(levels)))
        self.move(wrong)
        if kind == "leg":
            zero = replace(step, displacement_mm=0.0)
            self.arrive(zero)
            self.shown_mm[int(self.chance.integers(2))] += 0.5 * step.displacement_mm
        self.from_mm = list(self.shown_mm)


@dataclass
class Outcome:
    """What became of one session."""

    seed: int
    kind: Kind
    step: int
    complete: bool = False
    left_mm: float = 0.0  # the most that a counting reading is wrong
    good: int = 0  # steps taken rightly
    accused: int = 0  # those of them that a question named alone
    needless: int = 0  # questions with nothing wrong at all
    questions: Counter[str] = field(default_factory=Counter)

    @property
    def right(self) -> bool:
        return self.complete and self.left_mm <= RIGHT_MM


class TruthfulOperator:
    """Measures a session with one mistake, from its step on."""

    def __init__(self, bench: MistakenBench, guided: GuidedSession, outcome: Outcome) -> None:
        self.bench, self.guided, self.outcome = bench, guided, outcome
        self.notices = bool(bench.chance.integers(2))  # whether he noticed that he touched it
        self.to_tell = False
        self.wrong_now = False  # the machine is not where it should be
        self.made = outcome.kind == "none"
        self.zeros_mm: dict[tuple[str, str], float] = {}  # of each mounting when it began
        self.errors_mm: dict[int, float] = {}  # of each reading, from the truth and that zero
        self.mixed: set[str] = set()  # mountings whose stand was touched
        self.remeasured: set[int | None] = set()
        self.tried: dict[int, list[float]] = {}  # what he read at a step when asked for it

    def listen(self, seconds: float) -> None:
        for _ in range(8):
            self.bench.now_s += seconds / 8
            for gauge in self.guided.gauges:
                assert isinstance(gauge, BenchGauge)
                gauge.listen()

    def measure(self) -> None:
        question_count = 0
        while (step := self.guided.step()) is not None and question_count < MOST_QUESTIONS:
            self.guided.go()
            self.approach(step)
            taken_step = self.take(step)
            while taken_step.doubt and question_count < MOST_QUESTIONS:
                question_count += 1
                following = self.answer(taken_step)
                if following is None:
                    break
                taken_step = following
        self.judge()

    def approach(self, step: Step) -> None:
        """Set up or move, rightly but for the one mistake."""
        new = not self.guided.session.mountings or self.guided.session.is_new_place(step)
        if new:
            self.bench.turned = self.bench.inch = None  # he sets the indicators up anew
            self.bench.set_up(step)
        due = not self.made and step.number >= self.outcome.step and not new
        kind = self.outcome.kind
        if due and kind in ("posture", "leg") and (kind == "posture" or step.displacement_mm):
            self.bench.arrive_wrongly(step, kind)
            self.made = self.wrong_now = True
        elif not new:
            self.bench.move(step)
        self.listen(float(self.bench.chance.uniform(6.0, 25.0)))
        if due and kind not in ("posture", "leg"):
            self.spoil(kind)
            self.made = True
        self.listen(1.5)

    def spoil(self, kind: Kind) -> None:
        number = int(self.bench.chance.integers(2))
        if kind.startswith("sign"):
            self.bench.turned = number
        elif kind.startswith("unit"):
            self.bench.inch = number
        elif kind == "touched":
            for k in (number, *([1 - number] if self.bench.chance.integers(2) else [])):
                size_mm = self.bench.chance.choice([-1, 1]) * self.bench.chance.uniform(0.1, 0.5)
                self.bench.zero_mm[k] += float(size_mm)
            self.to_tell = self.notices
            self.mixed |= set(self.guided.session.mountings[-1].mounts.values())

    def take(self, step: Step) -> TakenStep:
        taken_step = self.guided.take()
        assert taken_step is not None
        assert not taken_step.faults
        good = True
        for number, reading in enumerate(taken_step.readings):
            right_mm = self.bench.truth[step.leg, reading.axis, step.displacement_mm]
            rate_mm_s = self.bench.rate_mm_s[number]
            zero_mm = self.zeros_mm.setdefault(
                (reading.mount, reading.axis), self.bench.zero_mm[number]
            )
            drifted_mm = zero_mm + rate_mm_s * self.bench.now_s
            self.errors_mm[reading.reading] = reading.value_mm - right_mm - drifted_mm
            good &= abs(self.errors_mm[reading.reading]) <= GOOD_MM
        self.outcome.good += good
        if "stays" not in self.outcome.kind:  # seen and set back by himself
            self.bench.turned = self.bench.inch = None
        return taken_step

    def count(self, taken_step: TakenStep) -> None:
        """Whom the question names, and whether rightly."""
        assert taken_step.doubt
        self.outcome.questions[taken_step.doubt.name] += 1
        if any(r.mount in self.mixed for r in taken_step.readings):
            return  # with two zeros in one mounting some are always apart
        is_pair = taken_step.earlier and taken_step.doubt is not Doubt.ODD
        named = [taken_step.questioned, *([taken_step.earlier] if is_pair else [])]
        good = [all(abs(self.errors_mm[r.reading]) <= GOOD_MM for r in step) for step in named]
        self.outcome.accused += len(named) == 1 and good[0]
        self.outcome.needless += all(good)

    def answer(self, taken_step: TakenStep) -> TakenStep | None:
        """What he does; the readings that came of it where he takes the same step again."""
        self.count(taken_step)
        bench, guided, step = self.bench, self.guided, taken_step.step
        wrong = self.wrong_now or bench.turned is not None or bench.inch is not None
        values_mm = [r.value_mm for r in taken_step.readings]
        before, self.tried[step.number] = self.tried.get(step.number), values_mm
        again = before is not None and np.allclose(before, values_mm, atol=0.03)
        if taken_step.doubt is Doubt.ODD:
            guided.measure_earlier(taken_step, "measured again")
            return None
        if wrong:
            bench.turned = bench.inch = None
            self.wrong_now = False
            self.tried.pop(step.number)
            return self.once_more(step)
        if self.to_tell:  # he remembers that he touched it
            self.to_tell = False
            guided.remount_since("the stand moved")
            return self.once_more(step) if guided.step() == step else None
        return self.answer_about_earlier(taken_step, again=again)

    def answer_about_earlier(self, taken_step: TakenStep, *, again: bool) -> TakenStep | None:
        """What he does where all is right now; ``again``: the same was read before."""
        guided, earlier = self.guided, {r.step for r in taken_step.earlier}
        if taken_step.doubt in (Doubt.REPEATS, Doubt.UNCHANGED) or (
            again and earlier - self.remeasured
        ):
            self.remeasured |= earlier
            # nothing is wrong now, so it was then
            guided.measure_earlier(taken_step, "measured again")
        elif not again and taken_step.doubt is Doubt.BEYOND:
            return self.once_more(taken_step.step)
        elif (
            taken_step.doubt is Doubt.BEYOND
            and not taken_step.earlier
            and self.was_read(taken_step)
        ):
            guided.remount_since("the stand moved")  # it repeats itself, and not those before
            following = guided.step()
            return self.once_more(taken_step.step) if following == taken_step.step else None
        else:
            guided.keep(taken_step, "it is right")
        return None

    def was_read(self, taken_step: TakenStep) -> bool:
        """Whether this posture was read before on the same mounting."""
        return any(
            (r.mount, r.displacement_mm)
            == (taken_step.readings[0].mount, taken_step.step.displacement_mm)
            for r in self.guided.session.readings
        )

    def once_more(self, step: Step) -> TakenStep:
        """Leave the posture, come back, take again."""
        self.bench.move(step)
        self.listen(float(self.bench.chance.uniform(6.0, 15.0)))
        return self.take(step)

    def judge(self) -> None:
        session = self.guided.session
        groups: dict[tuple[str, str], list[float]] = {}
        for r in session.readings:
            groups.setdefault((r.mount, r.axis), []).append(self.errors_mm[r.reading])
        self.outcome.left_mm = max(float(np.ptp(group)) for group in groups.values())
        self.outcome.complete = session.complete


@contextmanager
def _patched() -> Iterator[pytest.MonkeyPatch]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("protocols.files.os.fsync", lambda _: None)
        yield patch


def outcome_of(folder: Path, seed: int, kind: Kind, patch: pytest.MonkeyPatch) -> Outcome:
    """One session with one mistake, in any cycle of any leg."""
    chance = np.random.default_rng([seed, len(kind), 7])
    with opened_on(folder, f"{kind}_{seed}", chance, patch, MistakenBench) as (bench, guided):
        steps = [s for s in guided.steps if s.number > 1]
        step = int(chance.choice([s.number for s in steps]))
        outcome = Outcome(seed, kind, step)
        assert isinstance(bench, MistakenBench)
        TruthfulOperator(bench, guided, outcome).measure()
    return outcome


def outcomes(folder: Path, seeds: range, kinds: tuple[Kind, ...] = KINDS) -> list[Outcome]:
    """So many sessions of each kind."""
    with _patched() as patch:
        return [outcome_of(folder, seed, kind, patch) for kind in kinds for seed in seeds]


def summary(of_all: list[Outcome]) -> str:
    """A line for each kind of mistake: how many end right, how many good readings are accused."""
    lines = [f"{'mistake':<14}{'sessions':>9}{'right':>7}{'good':>7}{'accused':>9}{'needless':>10}"]
    for kind in dict.fromkeys(outcome.kind for outcome in of_all):
        of_kind = [outcome for outcome in of_all if outcome.kind == kind]
        counts = [
            sum(getattr(outcome, name) for outcome in of_kind)
            for name in ("right", "good", "accused")
        ]
        counts.append(sum(outcome.needless for outcome in of_kind))
        right, good, accused, needless = counts
        lines.append(f"{kind:<14}{len(of_kind):>9}{right:>7}{good:>7}{accused:>9}{needless:>10}")
    questions = sum((outcome.questions for outcome in of_all), Counter())
    return "\n".join([*lines, f"questions: {dict(questions)}, scatter {SCATTER_MM} mm"])


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        results = outcomes(Path(place), range(int(sys.argv[1])), ("none", *KINDS))
    print(summary(results))
    for result in results:
        if not result.right:
            print(result)
