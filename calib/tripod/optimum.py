"""Optimum postures of a machine with three drives, chosen from its pool, within minutes."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.arrays import FloatArray, descending
from calib.design.criteria import Aim, Criterion, value_of, wanted_information
from calib.design.exchange import Choice, choose
from calib.errors import ImpossibleRequest, NotIdentifiable
from calib.tripod.planning import Coordinates, Orders, TripodPlanning, TripodPool


@dataclass(frozen=True)
class Figures:
    """One set of postures judged: None where it does not see all parameters."""

    value: float | None
    condition_number: float | None
    smallest_singular_value: float | None
    tool_mm: float | None
    minutes: float
    count: int


@dataclass(frozen=True, eq=False)
class ChosenPostures:
    """Optimum postures beside the procedure that they were asked for.

    ``grid_value`` is the criterion before the postures were moved off the grid; None where they
    were not to be moved.
    """

    machine: str
    procedure: str
    criterion: Criterion
    before: Figures
    after: Figures
    grid_value: float | None
    start_condition_number: float | None
    postures: tuple[Coordinates, ...]
    coordinates_on_bound: int
    seconds: float
    starts: int
    seed: int
    exchanges: int
    noise_words: str
    orders: Orders


def optimum_postures(
    machine: TripodPlanning,
    count: int,
    *,
    criterion: Criterion = Criterion.DETERMINANT,
    budget_min: float | None = None,
    seed: int = 0,
    starts: int = 8,
    repeats: bool = False,
    common: bool = False,
    refine: bool = True,
) -> ChosenPostures:
    """The best set of ``count`` postures that fits into the budget.

    ``common`` allows only sets that treat equal parts of the machine alike: one procedure file.
    With ``refine`` the chosen ones are then moved off the grid, as far as they stay distinct.

    Raises ImpossibleRequest for a count or budget that cannot be, NotIdentifiable where so few
    postures cannot determine the parameters.
    """
    examined, pool, metric = machine.examine(), machine.pool(), machine.metric()
    _check_count(count, len(pool.candidates.rows), repeats=repeats)
    aim = Aim(criterion, pool.wanted, metric)
    begin = time.perf_counter()
    search = _Search(count, aim, seed, starts, repeats=repeats, common=common)
    pool, found = _within_budget(pool, search, budget_min)
    chosen = found.chosen
    if refine:
        pool, chosen = _moved(pool, chosen, aim, budget_min)
    seconds = time.perf_counter() - begin
    whitened = examined.sensitivity.jacobian
    information = pool.candidates.information(np.array(chosen, dtype=np.intp))
    remaining = wanted_information(information, aim)
    plain = Aim(criterion, None, metric)
    return ChosenPostures(
        machine=machine.name,
        procedure=examined.procedure,
        criterion=criterion,
        before=_figures(whitened.T @ whitened, plain, examined.minutes, examined.posture_count),
        after=_figures(remaining, plain, pool.minutes(chosen), count),
        grid_value=found.value if refine else None,
        start_condition_number=found.start_condition_number,
        postures=pool.coordinates(chosen),
        coordinates_on_bound=pool.on_bound(chosen),
        seconds=seconds,
        starts=starts,
        seed=seed,
        exchanges=found.exchanges,
        noise_words=examined.noise_words,
        orders=pool.orders(chosen),
    )


@dataclass(frozen=True)
class _Search:
    """How to choose from any pool."""

    count: int
    aim: Aim
    seed: int
    starts: int
    repeats: bool
    common: bool

    def best_of(self, pool: TripodPool) -> Choice:
        """Raises ImpossibleRequest where no common set has this size."""
        symmetric = pool.symmetric(self.count, self.aim, self.seed)
        if not self.common:
            return choose(
                pool.candidates,
                self.count,
                self.aim,
                seed=self.seed,
                starts=self.starts,
                repeats=self.repeats,
                begin_with=[np.array(one.chosen, dtype=np.intp) for one in symmetric],
            )
        if not symmetric:
            raise ImpossibleRequest(
                "--count",
                f"{self.count} with --common",
                "a multiple of the number of legs that determines the parameters",
            )
        sign = 1.0 if self.aim.criterion.larger_is_better else -1.0
        return descending(symmetric, lambda one: sign * one.value)[0]


def _within_budget(
    pool: TripodPool, search: _Search, budget_min: float | None
) -> tuple[TripodPool, Choice]:
    """Set-ups are given up, the least used first, until the time is enough."""
    found = search.best_of(pool)
    while budget_min is not None and (needed := pool.minutes(found.chosen)) > budget_min:
        kept = pool.reduced(found.chosen)
        if kept is None or (len(kept) < search.count and not search.repeats):
            raise _too_little_time(budget_min, needed, search.count)
        pool = pool.take(kept)
        try:
            found = search.best_of(pool)
        except NotIdentifiable as problem:
            raise _too_little_time(budget_min, needed, search.count) from problem
    return pool, found


def _moved(
    pool: TripodPool, chosen: Sequence[int], aim: Aim, budget_min: float | None
) -> tuple[TripodPool, tuple[int, ...]]:
    """Off the grid, unless the way there would turn more often than there is time for."""
    moved = pool.moved(chosen, aim)
    every = tuple(range(len(chosen)))
    if budget_min is not None and moved.minutes(every) > budget_min:
        return pool, tuple(chosen)
    return moved, every


def _too_little_time(budget_min: float, needed_min: float, count: int) -> ImpossibleRequest:
    return ImpossibleRequest(
        "--budget",
        f"{budget_min:g} min",
        f"about {needed_min:.0f} min for {count} postures",
        "Ask for fewer postures or give more time.",
    )


def _check_count(count: int, size: int, *, repeats: bool) -> None:
    if count < 1 or (count > size and not repeats):
        raise ImpossibleRequest(
            "--count", f"{count}", f"1 to {size}, the number of candidates", "Or add --repeats."
        )


def _figures(information: FloatArray, aim: Aim, minutes: float, count: int) -> Figures:
    def judged(criterion: Criterion) -> float | None:
        try:
            return value_of(information, Aim(criterion, None, aim.metric))
        except NotIdentifiable:
            return None

    variance = judged(Criterion.TOOL_VARIANCE)
    return Figures(
        value=judged(aim.criterion),
        condition_number=judged(Criterion.CONDITION),
        smallest_singular_value=judged(Criterion.SMALLEST_SINGULAR_VALUE),
        tool_mm=None if variance is None else variance**0.5,
        minutes=minutes,
        count=count,
    )
