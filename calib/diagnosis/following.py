"""The added measurement that separates what fits equally well (T-optimality).

Options are judged by what each explanation, taken for true, leaves of the others on old and new
readings together (Atkinson and Fedorov 1975). The added session has base parameters and zeros of
its own, as in the diagnosis; both projections and all products are sums over the sessions.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from calib.diagnosis.additions import Added, Preparation
from calib.diagnosis.problem import Problem
from calib.diagnosis.separating import Explanation, Judge, Name
from calib.observations import LEG_NAMES, FloatArray
from calib.orthoglide.geometry import Geometry

STATION_SETS = ((0.5,), (0.3,), (0.7,), (0.3, 0.7))
LEVELS = (0.25, 0.55, 0.85, 1.0)
BOTH_SIDES = (0.4, 1.0, 0.4, -0.4, -1.0, -0.4)
UNEVEN = (0.35, 1.0, 0.7, 0.35, 0.0, -0.37, -0.7, -1.0, -0.7, -0.37)
SHIFT_MM = 5.0
"""A joint offset is changed by so much where readings must become larger; levels keep clear of the
joint limits by as much."""
LOAD = 2.0
"""The tool with a mass as heavy as itself."""

ENOUGH = 25.0
"""Expected separation in noise variances that settles a pair."""
GOAL = 60.0
"""What is aimed at: values are known by estimate only, and noise takes its part."""
NEARLY = 0.97
"""A shorter measurement is preferred when it reaches so much of the best."""


def best_addition(
    problem: Problem,
    names: Sequence[Name],
    weights: FloatArray,
    beside: Sequence[Explanation] = (),
    *,
    load_tells: bool = False,
) -> tuple[Added, FloatArray]:
    """The added measurement that separates these names best, and how far each pair.

    A pair counts by the product of its ``weights`` ``(len(names),)``; ``beside`` are effects that
    stay whatever is decided. Separations ``(len(names), len(names))``
    are in noise variances. What needs no change of the machine comes first; the tool is loaded
    (with ``load_tells``) or offsets are shifted only where nothing else reaches `GOAL`.
    """
    judge = Judge(problem, names, beside)
    found: list[tuple[Added, FloatArray]] = []
    scores: list[float] = []
    for preparations in _preparations(problem, load_tells=load_tells):
        for preparation in preparations:
            model = preparation.model(problem.sittings[-1].model)
            some = list(options(model.geometry, preparation))
            found += zip(some, judge.separations(model, some), strict=True)
        scores = [_score(separations, weights) for _, separations in found]
        if max(scores) >= (1.0 - 1e-9) * _score(GOAL * np.ones((len(names),) * 2), weights):
            break
    return _shortest_of_the_best(found, scores)


def _preparations(problem: Problem, *, load_tells: bool) -> Iterator[tuple[Preparation, ...]]:
    """From the easiest to the most laborious."""
    yield (Preparation(),)
    if load_tells:
        yield (Preparation(load=LOAD),)
    offsets = problem.sittings[-1].model.parameters_mm[:3]
    shifts = -SHIFT_MM * np.where(np.array(offsets) < 0.0, -1.0, 1.0) * np.eye(3)
    both = [a + sign * b for a, b in combinations(shifts, 2) for sign in (1.0, -1.0)]
    for changes in (shifts, both):
        yield tuple(Preparation((x, y, z)) for x, y, z in (0.0 + np.array(changes)).tolist())


def _score(separations: FloatArray, weights: FloatArray) -> float:
    counted = np.minimum(separations, GOAL) * np.outer(weights, weights)
    return float(np.triu(counted, 1).sum())


def _shortest_of_the_best(
    found: Sequence[tuple[Added, FloatArray]], scores: Sequence[float]
) -> tuple[Added, FloatArray]:
    good = [one for one, s in zip(found, scores, strict=True) if s >= NEARLY * max(scores)]
    return min(good, key=lambda one: (bool(one[0].preparation.words), one[0].steps))


def level_sets(geometry: Geometry, clear_mm: float) -> tuple[tuple[float, ...], ...]:
    """Displacements that are considered: one side, both sides, uneven ones from both sides."""
    high, low = geometry.travel_max_mm - clear_mm, geometry.travel_min_mm + clear_mm

    def scaled(parts: Sequence[float]) -> tuple[float, ...]:
        return tuple(float(round(high * p if p > 0.0 else -low * p)) for p in parts)

    return tuple(scaled(parts) for parts in (LEVELS, [-p for p in LEVELS], BOTH_SIDES, UNEVEN))


def options(geometry: Geometry, preparation: Preparation) -> Iterator[Added]:
    """Every measurement that is considered with this preparation."""
    clear_mm = max(abs(change) for change in preparation.entered_mm)
    for levels in level_sets(geometry, clear_mm):
        for stations in STATION_SETS:
            for leg in LEG_NAMES:
                yield Added((leg,), stations, levels, preparation)
            if len(stations) == 1:
                yield Added(LEG_NAMES, stations, levels, preparation)
