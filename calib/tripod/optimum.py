"""Optimum postures of a machine with three drives, chosen from its pool, within minutes."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from calib.arrays import LEG_NAMES, FloatArray, IntArray, descending, numbered
from calib.design.criteria import Aim, Criterion, value_or_none, wanted_information
from calib.design.exchange import Candidates, ChosenCandidates, choose
from calib.errors import ImpossibleRequest, NotIdentifiable
from calib.tripod.geometry import Pair
from calib.tripod.leg_refinement import move_off_grid
from calib.tripod.planning import TripodPlanning, tool_metric
from calib.tripod.pool import FREE, PARAMETERS, STATIONS, LegPool, leg_pool, turning_mm

Coordinates = dict[str, float | str]
"""One posture: names with their unit, such as ``displacement_mm``."""

Visit = tuple[float, int]
"""A displacement, and the sign of the movement that leads there."""

Orders = dict[tuple[int, float], list[float]]
"""Displacements in mm to visit for each mounting (leg, station)."""


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

    Raises ImpossibleRequest for a count or budget that cannot be or where the tool is read, and
    NotIdentifiable where so few postures cannot determine the parameters.
    """
    examined, metric = machine.examine(), tool_metric(machine.geometry)
    if machine.of_tool:
        raise ImpossibleRequest(
            f"optimum postures with {machine.procedure}",
            "readings against a plate or plane alone",
            "a procedure that reads legs from Zero",
        )
    pool = leg_pool(machine.geometry)
    aim = Aim(criterion, FREE, metric)
    begin = time.perf_counter()
    search = _Search(machine, count, aim, seed, starts, repeats=repeats, common=common)
    search.check_count(pool)
    pool, best = search.within(pool, budget_min)
    subset: Sequence[int] = best.chosen
    if refine:
        noise_mm = machine.noise.standard_deviation_mm
        moved, numbers = move_off_grid(pool, subset, noise_mm, aim), range(len(subset))
        # unless the way there would turn more often than there is time for
        if budget_min is None or not search.minutes(moved, numbers) > budget_min:
            pool, subset = moved, numbers
    seconds = time.perf_counter() - begin
    whitened = examined.sensitivity.jacobian
    information = search.candidates(pool).information(np.array(subset, dtype=np.intp))
    remaining = wanted_information(information, aim)
    plain = Aim(criterion, None, metric)
    return ChosenPostures(
        machine=machine.name,
        procedure=examined.procedure,
        criterion=criterion,
        before=_figures(whitened.T @ whitened, plain, examined.minutes, examined.posture_count),
        after=_figures(remaining, plain, search.minutes(pool, subset), count),
        grid_value=best.value if refine else None,
        start_condition_number=best.start_condition_number,
        postures=tuple(_coordinates(pool, subset)),
        coordinates_on_bound=_on_bound(pool, subset),
        seconds=seconds,
        starts=starts,
        seed=seed,
        exchanges=best.exchanges,
        noise_words=examined.noise_words,
        orders=_orders(pool, subset),
    )


@dataclass(frozen=True, eq=False)
class _Search:
    """How to choose from any pool."""

    machine: TripodPlanning
    count: int
    aim: Aim
    seed: int
    starts: int
    repeats: bool
    common: bool

    def candidates(self, pool: LegPool) -> Candidates:
        """Rows divided by the noise of a reading; columns of unused zeros left out."""
        rows = pool.rows / self.machine.noise.standard_deviation_mm
        is_seen = np.asarray(np.abs(rows).max(axis=(0, 1)) > 0.0)
        is_seen[:PARAMETERS] = True
        return Candidates(np.ascontiguousarray(rows[:, :, is_seen]))

    def check_count(self, pool: LegPool) -> None:
        """Raises ImpossibleRequest for more postures than there are, or too few for any choice."""
        # a step gives two readings, and the first one of a mounting shows its zeros alone
        candidates, places = self.candidates(pool), np.unique(pool.place)
        informations = (
            candidates.information(np.flatnonzero(pool.place == place)) for place in places
        )
        alone = any(value_or_none(info, self.aim) is not None for info in informations)
        least = PARAMETERS // 2 + (1 if alone else 2)  # mountings, where none sees everything
        most_words = "" if self.repeats else f", to {len(pool)}, the number of candidates"
        if self.count < least or (self.count > len(pool) and not self.repeats):
            raise ImpossibleRequest(
                "--count",
                f"{self.count}",
                f"{least}, the fewest that can determine {PARAMETERS} parameters{most_words}",
                "" if self.count < least else "Or add --repeats.",
            )

    def minutes(self, pool: LegPool, subset: Sequence[int]) -> float:
        """Steps, with those where the way turns, and set-up of each mounting."""
        orders = _orders(pool, subset)
        return self.machine.minutes(sum(map(len, orders.values())), len(orders))

    def within(self, pool: LegPool, budget_min: float | None) -> tuple[LegPool, ChosenCandidates]:
        """Set-ups are given up, the least used first, until the time is enough."""
        best = self.best_of(pool)
        while budget_min is not None:
            needed_min = self.minutes(pool, best.chosen)
            if not needed_min > budget_min:
                break
            too_little = ImpossibleRequest(
                "--budget",
                f"{budget_min:g} min",
                f"about {needed_min:.0f} min for {self.count} postures",
                "Ask for fewer postures or give more time.",
            )
            places, counts = np.unique(pool.place[list(best.chosen)], return_counts=True)
            pool_rows = np.flatnonzero(np.isin(pool.place, np.delete(places, counts.argmin())))
            if len(places) < 2 or (len(pool_rows) < self.count and not self.repeats):
                raise too_little
            pool = pool.take(pool_rows)
            try:
                best = self.best_of(pool)
            except NotIdentifiable as problem:
                raise too_little from problem
        return pool, best

    def best_of(self, pool: LegPool) -> ChosenCandidates:
        """Raises ImpossibleRequest where no common set has this size."""
        candidates = self.candidates(pool)
        symmetric = list(self._symmetric(pool, candidates.rows))
        if not self.common:
            return choose(
                candidates,
                self.count,
                self.aim,
                seed=self.seed,
                starts=self.starts,
                repeats=self.repeats,
                begin_with=[np.array(choice.chosen, dtype=np.intp) for choice in symmetric],
            )
        if not symmetric:
            raise ImpossibleRequest(
                "--count",
                f"{self.count} with --common",
                "a multiple of the number of legs that determines the parameters",
            )
        sign = 1.0 if self.aim.criterion.larger_is_better else -1.0
        return descending(symmetric, lambda choice: sign * choice.value)[0]

    def _symmetric(self, pool: LegPool, rows: FloatArray) -> Iterator[ChosenCandidates]:
        """Displacements common to all legs, at each station alone.

        Single swaps rarely empty a mounting, so these serve as starts, too.
        """
        legs = np.unique(pool.leg)
        count_of_leg, remainder = divmod(self.count, len(legs))
        if remainder:
            return
        for station in np.unique(pool.station):
            together = _visits_of_all(pool, legs, station)
            if count_of_leg <= len(together):
                merged = Candidates(rows[together].reshape(len(together), -1, rows.shape[2]))
                try:
                    best = choose(merged, count_of_leg, self.aim, seed=self.seed, starts=2)
                except NotIdentifiable:
                    continue
                yield replace(best, chosen=tuple(together[list(best.chosen)].ravel().tolist()))


def _visits_of_all(pool: LegPool, legs: IntArray, station: float) -> IntArray:
    """Candidates at a station ``(k, legs)``, of displacements that all legs allow."""
    visit = numbered(pool.displacement_mm, pool.approach)
    of_legs = [np.flatnonzero((pool.leg == leg) & (pool.station == station)) for leg in legs]
    common = reduce(np.intersect1d, (visit[rows] for rows in of_legs))
    return np.stack([rows[np.isin(visit[rows], common)] for rows in of_legs], axis=1)


def _coordinates(pool: LegPool, subset: Sequence[int]) -> Iterator[Coordinates]:
    """Leg by leg, station by station, rising displacements."""
    for k in sorted(
        subset,
        key=lambda k: (pool.leg[k], pool.station[k], pool.displacement_mm[k], pool.approach[k]),
    ):
        yield {
            "leg": LEG_NAMES[pool.leg[k]],
            "station": float(pool.station[k]),
            "displacement_mm": float(pool.displacement_mm[k]),
            "approach": "+" if pool.approach[k] > 0 else "-",
        }


def _on_bound(pool: LegPool, subset: Sequence[int]) -> int:
    """Displacements on a joint limit and stations at an end of their range."""
    members, geometry = list(subset), pool.geometry
    limits = (geometry.travel_min_mm, geometry.travel_max_mm)
    ends = (min(STATIONS), max(STATIONS))
    moved = np.isin(pool.displacement_mm[members], limits).sum()
    return int(moved + np.isin(pool.station[members], ends).sum())


def _orders(pool: LegPool, subset: Sequence[int]) -> Orders:
    """Displacements to visit for each mounting (leg, station)."""
    grouped: dict[tuple[int, float], list[Visit]] = {}
    for k in sorted(subset, key=lambda k: pool.place[k]):
        visit = float(pool.displacement_mm[k]), int(pool.approach[k])
        grouped.setdefault(pool.places[pool.place[k]], []).append(visit)
    orders = {}
    for place, visits in grouped.items():
        ends = turning_mm(pool.geometry, *place)
        levels = visiting_order(visits, ends)
        if len(set(levels)) < 2:  # one displacement tells nothing: Zero is read, too
            levels.append(0.0 if levels[0] else ends[1] or ends[0])
        orders[place] = levels
    return orders


def visiting_order(visits: Sequence[Visit], ends_mm: Pair) -> list[float]:
    """Displacements of one mounting such that each visit comes from its own side.

    Repeats are allowed; the tool starts at Zero. Where the way must turn first, the end of the way,
    `turning_mm`, is visited in between and read as well.
    """
    passes: list[list[Visit]] = []  # without repeats, then the second ones of those, and so on
    for visit in visits:
        free = next((walk for walk in passes if visit not in walk), None)
        if free is None:
            free = []
            passes.append(free)
        free.append(visit)
    return min((_walked(passes, ends_mm, up_first=up) for up in (True, False)), key=len)


def _walked(passes: list[list[Visit]], ends_mm: Pair, *, up_first: bool) -> list[float]:
    chain: list[Visit] = []
    for walk in passes:
        up = sorted(visit for visit in walk if visit[1] > 0)
        down = sorted((visit for visit in walk if visit[1] <= 0), reverse=True)
        chain += up + down if up_first else down + up
    position, walked = 0.0, []
    for level, side in chain:
        if (level - position) * side <= 0.0:
            walked.append(ends_mm[0] if side > 0 else ends_mm[1])
        walked.append(level)
        position = level
    return walked


def _figures(information: FloatArray, aim: Aim, minutes: float, count: int) -> Figures:
    def judged(criterion: Criterion) -> float | None:
        return value_or_none(information, Aim(criterion, None, aim.metric))

    variance = judged(Criterion.TOOL_VARIANCE)
    return Figures(
        value=judged(aim.criterion),
        condition_number=judged(Criterion.CONDITION),
        smallest_singular_value=judged(Criterion.SMALLEST_SINGULAR_VALUE),
        tool_mm=None if variance is None else variance**0.5,
        minutes=minutes,
        count=count,
    )
