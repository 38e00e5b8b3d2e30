"""Exchange and refinement against brute force, recomputed determinants and plain numpy."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.arrays import FloatArray, IntArray
from calib.design.criteria import Aim, Criterion, value_of, wanted_information
from calib.design.exchange import Candidates, choose, swap_ratios
from calib.design.refinement import (
    OF_ENDS,
    Pull,
    cost_by_rows,
    refine,
)
from calib.errors import CalibrationError, NotIdentifiable
from tests.conftest import LONG

ALL = list(Criterion)


def random_rows(seed: int, n: int, r: int, k: int) -> FloatArray:
    return np.random.default_rng(seed).normal(size=(n, r, k))


def metric_of(k: int) -> FloatArray:
    half = np.random.default_rng(99).normal(size=(k, k))
    return np.asarray(half @ half.T)


def by_definition(rows: FloatArray, criterion: Criterion, metric: FloatArray) -> float:
    """From the singular values and the pseudoinverse of the stacked rows, no nuisance."""
    flat = rows.reshape(-1, rows.shape[-1])
    sigma = [float(value) for value in np.linalg.svd(flat, compute_uv=False)]
    covariance = np.linalg.pinv(flat) @ np.linalg.pinv(flat).T
    values = {
        Criterion.DETERMINANT: math.prod(sigma) ** (1 / len(sigma)),
        Criterion.AVERAGE_VARIANCE: float(np.trace(covariance)) / len(sigma),
        Criterion.SMALLEST_SINGULAR_VALUE: float(sigma[-1]),
        Criterion.CONDITION: float(np.linalg.cond(flat)),
        Criterion.NOISE_AMPLIFICATION: float(sigma[-1] ** 2 / sigma[0]),
        Criterion.TOOL_VARIANCE: float(np.trace(metric @ covariance)),
    }
    return float(values[criterion])


def better(first: float, second: float, criterion: Criterion) -> bool:
    return first >= second if criterion.larger_is_better else first <= second


@pytest.mark.parametrize("criterion", ALL)
@pytest.mark.parametrize("seed", range(5))
def test_criteria_are_those_of_their_definitions(criterion: Criterion, seed: int) -> None:
    rows, metric = random_rows(seed, 7, 2, 4), metric_of(4)
    flat = rows.reshape(-1, 4)
    value = value_of(flat.T @ flat, Aim(criterion, None, metric))
    assert value == pytest.approx(by_definition(rows, criterion, metric), rel=1e-10)


def test_nuisance_is_fitted_too() -> None:
    """The covariance of the wanted ones is the corner of the whole inverse."""
    flat = random_rows(3, 12, 1, 6)[:, 0]
    remaining = wanted_information(flat.T @ flat, Aim(wanted=(1, 3, 4)))
    corner = np.linalg.inv(flat.T @ flat)[np.ix_([1, 3, 4], [1, 3, 4])]
    assert np.linalg.inv(remaining) == pytest.approx(corner, rel=1e-9)


@settings(deadline=None, max_examples=60)
@given(
    seed=st.integers(0, 10_000),
    r=st.integers(1, 3),
    k=st.integers(1, 5),
    extra=st.integers(1, 4),
)
def test_swap_formula_is_the_recomputed_determinant(seed: int, r: int, k: int, extra: int) -> None:
    rows = random_rows(seed, 9, r, k)
    subset = np.random.default_rng(seed).choice(9, min(k + extra, 9), replace=False)
    pool = Candidates(rows)

    def information(rows_chosen: IntArray) -> FloatArray:
        return pool.information(rows_chosen) + np.eye(k)  # else some swaps leave next to nothing

    before = information(subset)
    ratios = swap_ratios(rows, subset, np.asarray(np.linalg.inv(before)))
    for incoming, place in itertools.product(range(9), range(len(subset))):
        changed = subset.copy()
        changed[place] = incoming
        expected = np.linalg.det(information(changed)) / np.linalg.det(before)
        assert ratios[incoming, place] == pytest.approx(expected, rel=1e-7, abs=1e-9)


@LONG
@pytest.mark.parametrize("criterion", ALL)
@pytest.mark.parametrize("seed", range(4))
def test_exchange_finds_the_best_of_all_subsets(criterion: Criterion, seed: int) -> None:
    rows, metric = random_rows(seed, 9, 1, 3), metric_of(3)
    selection = choose(Candidates(rows), 5, Aim(criterion, None, metric), seed=seed, starts=30)
    values = [
        by_definition(rows[list(subset)], criterion, metric)
        for subset in itertools.combinations(range(9), 5)
    ]
    best = max(values) if criterion.larger_is_better else min(values)
    assert selection.value == pytest.approx(best, rel=1e-9)
    assert selection.value == pytest.approx(
        by_definition(rows[list(selection.chosen)], criterion, metric), rel=1e-9
    )


@pytest.mark.parametrize("seed", range(3))
def test_exchange_with_nuisance_finds_the_best_of_all_subsets(seed: int) -> None:
    """Two mountings with a zero each: the zeros must be paid for."""
    rows = np.zeros((10, 1, 4))
    rows[:, 0, :2] = random_rows(seed, 10, 1, 2)[:, 0]
    rows[:5, 0, 2] = rows[5:, 0, 3] = 1.0
    aim = Aim(wanted=(0, 1))
    selection = choose(Candidates(rows), 5, aim, seed=1, starts=30)
    values = []
    for subset in itertools.combinations(range(10), 5):
        centred = [
            part[:, 0, :2] - part[:, 0, :2].mean(axis=0)
            for part in (rows[[k for k in subset if k < 5]], rows[[k for k in subset if k >= 5]])
            if len(part)
        ]
        sigma = np.linalg.svd(np.vstack(centred), compute_uv=False)
        values.append(math.sqrt(math.prod(sigma)))
    assert selection.value == pytest.approx(max(values), rel=1e-6)


@pytest.mark.parametrize("criterion", ALL)
@pytest.mark.parametrize("r", [1, 2])
def test_never_worse_than_any_start(criterion: Criterion, r: int) -> None:
    rows, metric = random_rows(8, 40, r, 4), metric_of(4)
    aim = Aim(criterion, None, metric)
    selection = choose(Candidates(rows), 8, aim, seed=5, starts=6)
    for generator in np.random.default_rng(5).spawn(6):
        start = generator.choice(40, 8, replace=False)
        assert better(selection.value, by_definition(rows[start], criterion, metric), criterion)
    assert selection.start_value is not None
    assert better(selection.value, selection.start_value, criterion)
    assert selection.exchanges > 0


def test_more_starts_never_make_it_worse() -> None:
    pool = Candidates(random_rows(2, 200, 1, 6))
    values = [choose(pool, 9, seed=3, starts=starts).value for starts in (1, 2, 4, 8, 16)]
    assert values == sorted(values)


def test_a_start_of_the_callers_own_is_never_spoilt() -> None:
    pool = Candidates(random_rows(2, 100, 1, 5))
    best = choose(pool, 7, seed=1, starts=40)
    again = choose(pool, 7, seed=9, starts=1, begin_with=[np.array(best.chosen)])
    assert again.value >= best.value * (1 - 1e-12)


def test_candidates_are_distinct_unless_repeats_are_asked_for() -> None:
    rows = np.concatenate([3.0 * np.eye(2)[:, None], random_rows(0, 20, 1, 2) / 50.0])
    assert len(set(choose(Candidates(rows), 8, starts=4).chosen)) == 8
    repeated = choose(Candidates(rows), 8, starts=4, repeats=True)
    assert repeated.chosen == (0, 0, 0, 0, 1, 1, 1, 1)


def test_one_seed_gives_one_result() -> None:
    pool = Candidates(random_rows(4, 60, 2, 5))
    assert choose(pool, 6, seed=7, starts=3) == choose(pool, 6, seed=7, starts=3)


@pytest.mark.parametrize(
    ("count", "rank"), [(1, 3), (2, 3), (5, 2)], ids=["one", "two", "dependent"]
)
def test_sets_that_cannot_see_everything_are_refused(count: int, rank: int) -> None:
    rows = random_rows(1, 12, 1, 3)
    rows[:, :, rank:] = rows[:, :, :1]
    with pytest.raises(NotIdentifiable, match="of 3 combinations"):
        choose(Candidates(rows), count)


@pytest.mark.parametrize(("count", "starts"), [(0, 1), (13, 1), (3, 0)])
def test_impossible_counts_are_refused(count: int, starts: int) -> None:
    with pytest.raises(CalibrationError, match="of 12 candidates"):
        choose(Candidates(random_rows(1, 12, 1, 3)), count, starts=starts)


def test_wrong_input_is_refused() -> None:
    with pytest.raises(CalibrationError, match="rows of the candidates"):
        Candidates(np.full((3, 1, 2), np.nan))
    with pytest.raises(CalibrationError, match="metric"):
        choose(Candidates(random_rows(1, 5, 1, 2)), 3, Aim(Criterion.TOOL_VARIANCE))
    with pytest.raises(CalibrationError, match="wanted parameters"):
        choose(Candidates(random_rows(1, 5, 1, 2)), 3, Aim(wanted=(0, 2)))


@pytest.mark.parametrize("criterion", ALL)
@pytest.mark.parametrize("parameters", [None, (0, 1, 3)])
def test_slope_of_the_cost_is_that_of_differences(
    criterion: Criterion, parameters: tuple[int, ...] | None
) -> None:
    k = 4 if parameters is None else 3
    aim = Aim(criterion, parameters, metric_of(k))
    rows = random_rows(6, 9, 1, 4)
    cost, slope = cost_by_rows(rows, aim)
    value = value_of(rows[:, 0].T @ rows[:, 0], aim)
    assert cost == pytest.approx(math.log(value) * (-1 if criterion.larger_is_better else 1))
    step = 1e-6 * random_rows(7, 9, 1, 4)
    ahead, behind = (cost_by_rows(rows + s * step, aim)[0] for s in (1, -1))
    assert float((slope * step).sum()) == pytest.approx((ahead - behind) / 2, rel=1e-4)


@pytest.mark.parametrize("criterion", OF_ENDS)
def test_smoothed_criteria_come_near_and_have_slopes(criterion: Criterion) -> None:
    rows, aim = random_rows(6, 9, 1, 4), Aim(criterion)
    hard = cost_by_rows(rows, aim)[0]
    costs = [cost_by_rows(rows, aim, power)[0] for power in (8.0, 64.0, 4096.0)]
    assert sorted(costs, reverse=True) == costs
    assert costs[0] > hard
    assert costs[-1] == pytest.approx(hard, abs=1e-6)
    step = 1e-6 * random_rows(7, 9, 1, 4)
    slope = cost_by_rows(rows, aim, 8.0)[1]
    ahead, behind = (cost_by_rows(rows + s * step, aim, 8.0)[0] for s in (1, -1))
    assert float((slope * step).sum()) == pytest.approx((ahead - behind) / 2, rel=1e-4)


@pytest.mark.parametrize("weakness", [1.0, 1e-6], ids=["by information", "by rows"])
@pytest.mark.parametrize("criterion", [c for c in ALL if c is not Criterion.TOOL_VARIANCE])
def test_slope_by_the_rows_is_that_of_differences(criterion: Criterion, weakness: float) -> None:
    """The second set is so weak that its information has too few digits."""
    aim, rows = Aim(criterion), random_rows(8, 9, 2, 4)
    rows[..., 3] = rows[..., 2] + weakness * rows[..., 3]
    step = 1e-6 * weakness * random_rows(9, 9, 2, 4)
    cost, slope = cost_by_rows(rows, aim, 16.0)
    ahead, behind = (cost_by_rows(rows + s * step, aim, 16.0)[0] for s in (1, -1))
    assert float((slope * step).sum()) == pytest.approx((ahead - behind) / 2, rel=1e-3)
    if criterion not in OF_ENDS:
        value = by_definition(rows, criterion, metric_of(4))
        assert cost == pytest.approx(
            math.log(value) * (-1 if criterion.larger_is_better else 1), rel=1e-6
        )


def parabola(points: FloatArray) -> tuple[FloatArray, Pull]:
    """A quadratic through points of [-1, 1]: rows (1, x, x²), and their pull."""
    x = points[:, :1]
    rows = np.stack([np.ones_like(x), x, x**2], axis=-1)
    slopes = np.stack([np.zeros_like(x), np.ones_like(x), 2 * x], axis=-1)
    return rows, lambda weights: np.asarray((weights * slopes).sum(axis=-1))


def test_refinement_finds_the_known_optimum_of_a_parabola() -> None:
    """D-optimum of a quadratic on [-1, 1]: the ends and the middle (Fedorov 1972)."""
    start = np.array([[-0.8], [0.3], [0.5]])
    refinement = refine(parabola, start, np.array([-1.0]), np.array([1.0]))
    assert refinement.coordinates[:, 0] == pytest.approx([-1.0, 0.0, 1.0], abs=1e-5)
    assert refinement.on_bound == 2
    assert refinement.value > refinement.start_value


@pytest.mark.parametrize("criterion", ALL)
def test_refinement_is_never_worse_and_stays_in_the_box(criterion: Criterion) -> None:
    low, high = np.array([-1.0]), np.array([1.0])
    start = np.random.default_rng(4).uniform(-0.9, 0.9, (6, 1))
    refinement = refine(parabola, start, low, high, Aim(criterion, None, metric_of(3)))
    assert better(refinement.value, refinement.start_value, criterion)
    assert ((low <= refinement.coordinates) & (refinement.coordinates <= high)).all()


def test_refinement_refuses_a_start_outside() -> None:
    with pytest.raises(CalibrationError, match="outside its box"):
        refine(parabola, np.array([[2.0], [0.0], [1.0]]), np.array([-1.0]), np.array([1.0]))


def test_measurements_that_see_nothing_are_not_chosen_for_their_condition() -> None:
    """What keeps matrices regular has the best of condition numbers, 1."""
    rows = np.zeros((6, 1, 2))
    rows[2:, 0] = [[1.0, 0.2], [1.0, 0.3], [0.9, 0.6], [1.0, 0.1]]
    aim = Aim(Criterion.CONDITION)
    choice = choose(Candidates(rows), 2, aim, starts=1, begin_with=[np.array([0, 1])])
    pairs = itertools.combinations(range(2, 6), 2)
    assert choice.chosen == min(pairs, key=lambda pair: float(np.linalg.cond(rows[list(pair), 0])))
