"""What is proposed next, of bounds and distances that are given: against plain definitions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from calib.arrays import FloatArray, IntArray
from calib.posterior.measurements import FurtherMeasurement, MeasurementPreparation
from calib.posterior.mixture import ExpectedReadings
from calib.posterior.planning import Planner

BOUND_MM = 0.2
NOW_MM = 0.1
"""The forecast follows half of it."""


def reading(number: int) -> ExpectedReadings:
    """Of a candidate, recognised by its number."""
    nothing = np.zeros((1, 0))
    return ExpectedReadings(np.array([float(number)]), nothing, nothing, nothing, ())


@dataclass
class GivenForecast:
    """Bounds are exp(-gain) of now: each direction ``c`` gains at most ``most[c]``, later less.

    ``share`` ``(k, c)`` is what candidate k shows of it; ``distances`` ``(k, m, m)`` are noise
    variances between models.
    """

    most: FloatArray
    share: FloatArray
    distances: FloatArray
    weight: FloatArray
    now_mm: float = NOW_MM

    @property
    def numbers(self) -> IntArray:
        return np.arange(len(self.weight), dtype=np.intp)

    def readings(self, set_ups: Sequence[int], *_: object) -> list[ExpectedReadings]:
        return [reading(number) for number in set_ups]

    def gain(self, numbers: Sequence[int]) -> float:
        share = self.share[list(numbers)].sum(axis=0)
        return float(self.most @ (1.0 - np.exp(-share)))

    def after_mm(self, readings: ExpectedReadings) -> float:
        return self.now_mm * math.exp(-self.gain(readings.expected.astype(int).tolist()))

    def apart(
        self, candidates: Sequence[ExpectedReadings], models: Sequence[int]
    ) -> list[FloatArray]:
        return [
            np.asarray(self.distances[int(readings.expected[0])][np.ix_(models, models)])
            for readings in candidates
        ]


class GivenPlanner(Planner):
    """With a forecast that is given."""

    given: GivenForecast

    @property
    def forecast(self) -> Any:  # noqa: ANN401
        return self.given


def planner(
    minutes: Sequence[float],
    forecast: GivenForecast | None = None,
    posterior: object = None,
    prepared: Sequence[int] = (),
) -> GivenPlanner:
    """Candidates of these minutes; some after something was changed."""
    loaded = MeasurementPreparation(load=2.0)
    possible = tuple(
        FurtherMeasurement(
            (cast(Any, number),),
            time,
            ("x",),
            preparation=loaded if number in prepared else MeasurementPreparation(),
        )
        for number, time in enumerate(minutes)
    )
    off = SimpleNamespace(bound_mm={"aligned": BOUND_MM}, values=np.zeros(1))
    correction = SimpleNamespace(frame="aligned", off=off)
    made = GivenPlanner(cast(Any, posterior), cast(Any, correction), possible)
    if forecast:
        object.__setattr__(made, "given", forecast)
    return made


def named(
    weights: Sequence[float],
    names: Sequence[str],
    distances: Any = None,  # noqa: ANN401
) -> tuple[GivenForecast, object]:
    """Models of these weights, each of a named component."""
    components = [SimpleNamespace(id=name, where="x") for name in names]
    models = [SimpleNamespace(members=(k,), weight=weight) for k, weight in enumerate(weights)]
    nothing = np.zeros((0, 0))
    forecast = GivenForecast(np.zeros(0), nothing, np.asarray(distances), np.asarray(weights))
    return forecast, SimpleNamespace(components=components, models=models)


def plainly(forecast: GivenForecast, minutes: Sequence[float]) -> list[tuple[int, float]]:
    """One after the other, all tried each time: the largest log gain for its time, of a tenth."""
    subset: list[int] = []
    bounds: list[tuple[int, float]] = []
    while len(bounds) < 6:
        before = forecast.gain(subset)
        gains = [forecast.gain([*subset, k]) - before for k in range(len(minutes))]
        worth = [k for k, gain in enumerate(gains) if math.exp(-gain) < 0.9]
        if not worth:
            break
        best = max(worth, key=lambda k: gains[k] / minutes[k])
        subset.append(best)
        bounds.append((best, BOUND_MM * math.exp(-forecast.gain(subset))))
    return bounds


def test_set_ups_in_turn_are_those_of_trying_all_each_time() -> None:
    generator = np.random.default_rng(5)
    counts = set()
    for _ in range(200):
        count, directions = int(generator.integers(2, 9)), int(generator.integers(1, 5))
        most = generator.uniform(0.1, 1.2, directions)
        share = generator.exponential(0.5, (count, directions))
        minutes = generator.uniform(2.0, 20.0, count).tolist()
        forecast = GivenForecast(most, share, np.zeros(0), np.zeros(0))
        reach, expected = planner(minutes, forecast).reach, plainly(forecast, minutes)
        assert [step.bound_mm for step in reach.further] == pytest.approx(
            [bound_mm for _, bound_mm in expected]
        )
        spent = np.cumsum([minutes[number] for number, _ in expected])
        assert [step.minutes for step in reach.further] == pytest.approx(spent.tolist())
        assert reach.bound_mm == BOUND_MM
        assert reach.is_last == (len(expected) < 6)
        counts.add(len(expected))
    assert counts >= {0, 1, 2, 3, 6}


def test_what_is_worth_it_is_preferred_to_what_gains_more_a_minute() -> None:
    """A quick set-up that lowers the bound by 5 % only is never the next one."""
    share = np.array([[0.05], [0.4]])
    forecast = GivenForecast(np.array([1.0]), share, np.zeros(0), np.zeros(0))
    reach = planner([0.1, 60.0], forecast).reach
    assert [step.minutes for step in reach.further] == [60.0 * n for n in (1, 2, 3)]


def test_proposals_are_sorted_by_what_a_minute_gains() -> None:
    share = np.array([[0.1], [0.6], [0.3]])
    forecast = GivenForecast(np.array([0.5]), share, np.zeros(0), np.zeros(0))
    plan = planner([1.0, 30.0, 2.0], forecast)
    after_mm = [BOUND_MM * math.exp(-0.5 * (1.0 - math.exp(-s))) for s in (0.1, 0.6, 0.3)]
    gains = [(BOUND_MM - mm) / time for mm, time in zip(after_mm, (1.0, 30.0, 2.0), strict=True)]
    order = [2, 0, 1]
    assert [gains[k] for k in order] == sorted(gains, reverse=True)
    assert [p.bound_mm for p in plan.proposals] == pytest.approx([after_mm[k] for k in order])
    assert [p.gain_mm_per_minute for p in plan.proposals] == pytest.approx(
        [gains[k] for k in order]
    )
    assert plan.more_helps  # to 0.80 of it
    little = GivenForecast(np.array([0.1]), np.array([[9.0]]), np.zeros(0), np.zeros(0))
    less = planner([1.0], little)
    assert not less.more_helps  # to 0.905


FAR = [[0.0, 40.0, 30.0], [40.0, 0.0, 20.0], [30.0, 20.0, 0.0]]


def test_the_shortest_measurement_that_separates_nearly_as_well_as_the_best() -> None:
    """60 noise variances are enough, so many more are no better; 97 % of the best are enough."""
    weights, names = (0.5, 0.3, 0.2), ("a", "b", "c")
    best = np.array(FAR)
    forecast, posterior = named(weights, names, [best, 0.975 * best, 0.965 * best])
    separation = planner([30.0, 20.0, 10.0], forecast, posterior).separation
    assert separation is not None
    assert separation.candidate.minutes == 20.0
    assert separation.apart == pytest.approx(0.975 * 40.0)
    assert separation.names == ((("a", "x"),), (("b", "x"),))  # 30 and 40 decide, not 20
    forecast, posterior = named(weights, names, [10.0 * best, 100.0 * best])
    same = planner([11.0, 10.0], forecast, posterior).separation
    assert same is not None
    assert same.candidate.minutes == 10.0
    changed = planner([11.0, 10.0], forecast, posterior, prepared=[1]).separation
    assert changed is not None
    assert changed.candidate.minutes == 11.0  # nothing to change before it


def test_names_that_are_one_in_other_words_are_not_separated() -> None:
    """Below 25 noise variances a measurement helps; names nearer than 1 are the same name."""
    near = [[0.0, 0.9, 20.0], [0.9, 0.0, 15.0], [20.0, 15.0, 0.0]]
    forecast, posterior = named((0.5, 0.3, 0.2), ("a", "b", "c"), [near])
    separation = planner([5.0], forecast, posterior).separation
    assert separation is not None
    assert separation.names == ((("a", "x"),), (("c", "x"),))
    assert separation.apart == 20.0
    assert "it helps to decide between a (x) and c (x)" in separation.words
    forecast, posterior = named((0.6, 0.4), ("a", "b"), [[[0.0, 0.9], [0.9, 0.0]]])
    assert planner([5.0], forecast, posterior).separation is None
    forecast, posterior = named((0.6, 0.4), ("a", "b"), [[[0.0, 25.0], [25.0, 0.0]]])
    decides = planner([5.0], forecast, posterior).separation
    assert decides is not None
    assert "it decides between a (x) and b (x)" in decides.words
    laws = (), (("straightness_fourth", "yx"),)  # nobody can look this id up
    words = replace(decides, names=laws).words
    assert words.endswith("it decides between no effect and an unnamed effect (yx)")


def test_names_are_as_near_as_their_nearest_models_either_being_true() -> None:
    weights, names = (0.5, 0.1, 0.04, 0.36), ("a", "a", "a", "b")
    distances = np.full((4, 4), 50.0)
    distances[3, 1] = 7.0  # the second model of a, if b is true
    distances[2, 3] = 2.0  # the third has less than a tenth of the first: it is not looked at
    forecast, posterior = named(weights, names, [distances])
    separation = planner([5.0], forecast, posterior).separation
    assert separation is not None
    assert separation.apart == 7.0


@pytest.mark.parametrize(
    ("weights", "separated"),
    [
        ((0.95, 0.05), 0),  # decided
        ((0.94, 0.06), 2),
        ((0.6, 0.394, 0.0059), 2),  # the third has less than 1 % of the first
        ((0.6, 0.393, 0.0061), 3),
    ],
)
def test_a_name_is_open_beside_the_likeliest(weights: tuple[float, ...], separated: int) -> None:
    count = len(weights)
    distances = np.full((count, count), 50.0)
    forecast, posterior = named(weights, "abc"[:count], [distances])
    separation = planner([5.0], forecast, posterior).separation
    assert (len(separation.names) if separation else 0) == separated


def test_what_is_weighed_is_the_separation_of_likely_names() -> None:
    """By pairs, each with the product of their probabilities: against this sum."""
    generator = np.random.default_rng(8)
    for _ in range(50):
        count = int(generator.integers(2, 5))
        weights = generator.dirichlet(np.full(count, 3.0))
        if weights.max() >= 0.95 or weights.min() < 0.01:
            continue
        order = np.argsort(-weights)
        apart = generator.exponential(30.0, (6, count, count))
        apart = apart + np.swapaxes(apart, 1, 2)
        apart[:, np.arange(count), np.arange(count)] = 0.0
        minutes = generator.permutation(6) + 1.0
        pairs = list(combinations(range(count), 2))
        score = [sum(min(a[i, j], 60.0) * weights[i] * weights[j] for i, j in pairs) for a in apart]
        nearly = [k for k in range(6) if score[k] >= 0.97 * max(score)]
        forecast, posterior = named(
            weights[order].tolist(), "abcd"[:count], apart[:, order][:, :, order]
        )
        separation = planner(minutes.tolist(), forecast, posterior).separation
        assert separation is not None
        assert separation.candidate.minutes == min(minutes[k] for k in nearly)


@dataclass
class GivenErrors:
    """Squares at the tool: three shifts, three turns, and what legs see, 9e-4 mm²."""

    square_mm2: tuple[float, ...]

    def without(self, columns: Sequence[int]) -> GivenErrors:
        gone = {k % 6 for k in columns}
        return GivenErrors(tuple(0.0 if k in gone else s for k, s in enumerate(self.square_mm2)))

    def bound_mm(self, _: FloatArray) -> float:
        return math.sqrt(9e-4 + sum(self.square_mm2))

    @property
    def seen(self) -> GivenErrors:
        return GivenErrors(())


@pytest.mark.parametrize(
    ("square_mm2", "instrument", "after_mm2"),
    [
        ((0.0, 0.0, 0.0, 1e-4, 1e-4, 9e-4), "square", 11e-4),
        ((1e-4, 0.0, 0.0, 6e-4, 5e-4, 9e-4), "plate", 19e-4),
        ((5e-4, 5e-4, 5e-4, 1e-4, 0.0, 9e-4), "ball", 19e-4),
        ((2e-4, 2e-4, 2e-4, 1e-4, 0.0, 1e-4), "", 0.0),  # legs see more than half
    ],
)
def test_the_instrument_is_the_one_that_shows_most_of_what_legs_do_not(
    square_mm2: tuple[float, ...], instrument: str, after_mm2: float
) -> None:
    errors = {"aligned": GivenErrors(square_mm2)}
    bounding = SimpleNamespace(tool_errors=errors)
    outside = planner([], posterior=SimpleNamespace(for_bounds=bounding)).outside
    assert (outside.instrument if outside else "") == instrument
    if outside:
        unseen = sum(square_mm2)
        assert outside.share == pytest.approx(unseen / (unseen + 9e-4))
        assert outside.bound_mm == pytest.approx(math.sqrt(after_mm2))
