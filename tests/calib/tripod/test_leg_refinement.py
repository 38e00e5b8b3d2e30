"""Postures moved off the grid, against rows worked out from the readings' own derivatives."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from calib.arrays import FloatArray, IntArray, conditions
from calib.design.criteria import Aim, Criterion
from calib.design.exchange import Candidates, choose
from calib.design.refinement import judged
from calib.errors import NotIdentifiable
from calib.tripod.geometry import Geometry
from calib.tripod.leg_refinement import move_off_grid
from calib.tripod.pipeline import derivatives
from calib.tripod.pool import LegPool, leg_pool, levels_mm
from tests.conftest import LONG, first_quick

NOISE_MM = 0.02
METRIC = np.diag([1.0, 2.0, 1.5, 0.5, 1.0, 1.0])
GRID = leg_pool(Geometry())


def aim_of(criterion: Criterion) -> Aim:
    return Aim(criterion, tuple(range(6)), METRIC)


def chosen_of(criterion: Criterion, count: int = 12, *, repeats: bool = False) -> tuple[int, ...]:
    pool = Candidates(GRID.rows / NOISE_MM)
    return choose(pool, count, aim_of(criterion), starts=2, repeats=repeats).chosen


def figure(pool: LegPool, criterion: Criterion) -> float:
    return judged(pool.rows / NOISE_MM, aim_of(criterion))


def better(moved: LegPool, grid: LegPool, criterion: Criterion) -> float:
    """The gain of the moved postures, more than 0 where they are better."""
    return gain(criterion, figure(grid, criterion), figure(moved, criterion))


def by_readings(pool: LegPool, criterion: Criterion) -> float:
    """The criterion from two readings of each posture, less the mean of each mounting."""
    legs, axes, levels, stations = [], [], [], []
    for leg, level, station in zip(pool.leg, pool.displacement_mm, pool.station, strict=True):
        for axis in (axis for axis in range(3) if axis != leg):
            legs.append(int(leg))
            axes.append(axis)
            levels.append(float(level))
            stations.append(float(station))
    plan = conditions(legs, axes, levels, station=stations)
    rows = derivatives(Geometry(), np.zeros(6), plan) / NOISE_MM
    for mount in range(plan.mount_count):
        rows[plan.mount == mount] -= rows[plan.mount == mount].mean(axis=0)
    sigma = np.linalg.svd(rows, compute_uv=False)
    covariance = np.linalg.inv(rows.T @ rows)
    values = {
        Criterion.DETERMINANT: float(np.prod(sigma) ** (1 / 6)),
        Criterion.AVERAGE_VARIANCE: float(np.trace(covariance)) / 6.0,
        Criterion.SMALLEST_SINGULAR_VALUE: float(sigma[-1]),
        Criterion.CONDITION: float(sigma[0] / sigma[-1]),
        Criterion.NOISE_AMPLIFICATION: float(sigma[-1] ** 2 / sigma[0]),
        Criterion.TOOL_VARIANCE: float(np.trace(METRIC @ covariance)),
    }
    return values[criterion]


def gain(criterion: Criterion, before: float, after: float) -> float:
    """Logarithm of the ratio, turned so that more is better."""
    return float(np.log(after / before)) * (1 if criterion.larger_is_better else -1)


@pytest.mark.parametrize("criterion", first_quick(list(Criterion)))
def test_moving_helps_and_the_figure_is_of_the_rounded_postures(criterion: Criterion) -> None:
    subset = chosen_of(criterion)
    grid = GRID.take(np.array(subset))
    moved = move_off_grid(GRID, subset, NOISE_MM, aim_of(criterion))
    assert figure(grid, criterion) == pytest.approx(by_readings(grid, criterion), rel=1e-6)
    assert figure(moved, criterion) == pytest.approx(by_readings(moved, criterion), rel=1e-6)
    assert better(moved, grid, criterion) > 1e-3
    tenths, hundredths = 10 * moved.displacement_mm, 100 * moved.station
    assert tenths == pytest.approx(np.round(tenths), abs=1e-9)
    assert hundredths == pytest.approx(np.round(hundredths), abs=1e-9)


@pytest.mark.parametrize("criterion", [Criterion.DETERMINANT, Criterion.TOOL_VARIANCE])
def test_no_other_dial_in_the_cell_is_better(criterion: Criterion) -> None:
    """Every displacement tried by itself every millimetre of its cell."""
    subset = chosen_of(criterion, 9)
    pool = move_off_grid(GRID, subset, NOISE_MM, aim_of(criterion))
    value, grid = figure(pool, criterion), GRID.displacement_mm[list(subset)]
    for k, off_mm in product(range(9), range(-4, 5)):
        level = grid[k] + off_mm
        if -100.0 <= level <= 60.0:
            displacement_mm = pool.displacement_mm.copy()
            displacement_mm[k] = level
            neighbour = pool.moved(displacement_mm, pool.station)
            assert gain(criterion, value, by_readings(neighbour, criterion)) < 1e-5


@pytest.mark.parametrize("criterion", first_quick(list(Criterion)))
@pytest.mark.parametrize("seed", first_quick(range(3)))
def test_random_sets_get_better_stay_distinct_and_inside(criterion: Criterion, seed: int) -> None:
    subset = random_set(seed)
    geometry = Geometry()
    pool = move_off_grid(GRID, subset, NOISE_MM, aim_of(criterion))
    assert better(pool, GRID.take(np.array(subset)), criterion) >= 0.0
    assert pool.displacement_mm.min() >= geometry.travel_min_mm
    assert pool.displacement_mm.max() <= geometry.travel_max_mm
    assert (np.abs(pool.displacement_mm - GRID.displacement_mm[subset]) <= 5.0).all()
    assert (np.abs(pool.station - GRID.station[subset]) <= 0.075).all()
    assert 0.2 <= pool.station.min() <= pool.station.max() <= 0.8
    assert len(set(visits(pool))) == len(subset)
    assert all(len(set(pool.station[pool.place == place])) == 1 for place in np.unique(pool.place))
    on_limit = np.isin(pool.displacement_mm, (-100.0, 60.0))
    assert (pool.approach[on_limit] == np.sign(pool.displacement_mm[on_limit])).all()


def random_set(seed: int) -> IntArray:
    """Two mountings on each leg with four postures each."""
    generator = np.random.default_rng(seed)
    stations = generator.choice([0.2, 0.35, 0.5, 0.65, 0.8], 2, replace=False)
    sets = [
        generator.choice(
            np.flatnonzero((GRID.leg == leg) & (GRID.station == station)), 4, replace=False
        )
        for leg, station in product(range(3), stations)
    ]
    return np.concatenate(sets)


def visits(pool: LegPool) -> list[tuple[float, ...]]:
    arrays: list[FloatArray | IntArray] = [
        pool.leg,
        pool.station,
        pool.displacement_mm,
        pool.approach,
    ]
    return [tuple(float(v) for v in row) for row in zip(*arrays, strict=True)]


def test_repeats_stay_repeats() -> None:
    subset = chosen_of(Criterion.DETERMINANT, 18, repeats=True)
    moved = move_off_grid(GRID, subset, NOISE_MM, aim_of(Criterion.DETERMINANT))
    assert len(set(subset)) < 18
    assert len(set(visits(moved))) == len(set(subset))
    assert better(moved, GRID.take(np.array(subset)), Criterion.DETERMINANT) > 0.0


def test_legs_that_are_treated_alike_stay_so() -> None:
    first_leg = [GRID.index(0, level, 0.35) for level in (-100.0, -20.0, 0.0, 60.0)]
    chosen = [
        GRID.index(leg, float(GRID.displacement_mm[k]), 0.35) for leg in range(3) for k in first_leg
    ]
    moved = move_off_grid(GRID, chosen, NOISE_MM, aim_of(Criterion.CONDITION))
    assert better(moved, GRID.take(np.array(chosen)), Criterion.CONDITION) > 0.0
    by_leg = [sorted(v[1:] for v in visits(moved) if v[0] == leg) for leg in range(3)]
    assert by_leg[0] == by_leg[1] == by_leg[2]


def test_equal_arguments_give_equal_postures() -> None:
    subset = random_set(5)
    first, second = (
        move_off_grid(GRID, subset, NOISE_MM, aim_of(Criterion.TOOL_VARIANCE)) for _ in range(2)
    )
    assert visits(first) == visits(second)
    assert figure(first, Criterion.TOOL_VARIANCE) == figure(second, Criterion.TOOL_VARIANCE)


def test_limits_that_are_no_tenths_are_kept() -> None:
    geometry = Geometry(travel_max_mm=60.04, travel_min_mm=-99.97)
    grid = leg_pool(geometry)
    pool = Candidates(grid.rows / NOISE_MM)
    aim = aim_of(Criterion.DETERMINANT)
    subset = choose(pool, 9, aim, starts=2).chosen
    moved = move_off_grid(grid, subset, NOISE_MM, aim)
    assert better(moved, grid.take(np.array(subset)), Criterion.DETERMINANT) > 0.0
    assert {float(mm) for mm in moved.displacement_mm} >= {60.04, -99.97}


@LONG
def test_a_travel_too_short_for_tenths_keeps_postures_distinct() -> None:
    geometry = Geometry(travel_max_mm=0.4, travel_min_mm=-0.4)
    grid = leg_pool(geometry)
    subset = np.flatnonzero(np.isin(grid.station, (0.2, 0.8)) & (grid.approach > 0))
    aim = aim_of(Criterion.AVERAGE_VARIANCE)
    moved = move_off_grid(grid, subset, NOISE_MM, aim)
    assert len(set(visits(moved))) == len(subset)
    assert better(moved, grid.take(subset), Criterion.AVERAGE_VARIANCE) >= 0.0


def test_zero_takes_the_place_of_what_is_next_to_it() -> None:
    levels = levels_mm(Geometry(travel_max_mm=60.04, travel_min_mm=-99.97))
    assert levels[0] == -99.97
    assert levels[-1] == 60.04
    assert 0.0 in levels
    assert np.diff(levels).min() > 9.0


def test_a_set_that_cannot_see_everything_is_refused() -> None:
    subset = [GRID.index(leg, level, 0.5) for leg in range(3) for level in (-100.0, 60.0)]
    with pytest.raises(NotIdentifiable, match="of 6 combinations"):
        move_off_grid(GRID, subset, NOISE_MM, aim_of(Criterion.DETERMINANT))
