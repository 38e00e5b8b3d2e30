"""What to measure next, as a sentence and as a procedure that can be run."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations, product

import numpy as np

from calib.arrays import LEG_NAMES, TOOL, FloatArray, descending
from calib.diagnosis.attribution import Attribution
from calib.diagnosis.policy import POLICY
from calib.diagnosis.problem import Problem
from calib.diagnosis.results import Named, NextMeasurement, Verdict
from calib.diagnosis.selection import LOG_UNIT
from calib.diagnosis.separating import Added, Explanation, Judge, Name, Preparation
from calib.tripod.geometry import Geometry

REPEATS_FIRST = NextMeasurement(
    "without repeats and without a stated noise nothing can be judged: measure every posture at "
    "least twice, leaving it in between",
    "zero-max-min",
    0.0,
)
MORE_PLACES = NextMeasurement(
    "more displacements and a second touching point, for more degrees of freedom",
    "two-station",
    0.0,
)

MORE_POSITIONS = NextMeasurement(
    "more positions against the plate and a second height, for more degrees of freedom",
    "plate-rings",
    0.0,
)

MOST_NAMES = 6
LEAST_SHARE = 0.1
"""Weight that the least likely name still has beside the best one."""

SHOWS = 1.0
"""Names that no option separates by so many noise variances are one thing in other words."""
MATTERS_OF_LOAD = "gravity_sag"


def propose(verdict: Verdict, attribution: Attribution) -> NextMeasurement | None:
    """The measurement that separates the strongest effect that stayed ambiguous, if any does."""
    problem = attribution.problem
    of_tool = any(TOOL in one.observed.leg for one in problem.fitted_sessions)
    if verdict == "cannot-tell" and problem.noise_df <= 0.0:
        return replace(REPEATS_FIRST, protocol="plate-rings") if of_tool else REPEATS_FIRST
    if verdict not in ("ambiguous", "cannot-tell"):
        return None
    if of_tool:
        return MORE_POSITIONS
    doubtful = [k for k in attribution.by_evidence() if attribution.rivals[k]]
    if not doubtful:
        return MORE_PLACES
    proposals = (_Pairing(attribution, k).proposal() for k in doubtful)
    return next((one for one in proposals if one), None)


class _Pairing:
    """One effect that was kept, and the names that fit as well in its place."""

    def __init__(self, attribution: Attribution, member: int) -> None:
        self._attribution, self._member = attribution, member
        self._candidates = attribution.candidates
        members = attribution.outcome.members
        self._given = tuple(k for k in members if k != member and self._candidates[k].shares)
        singles = attribution.outcome.singles
        self._weight = {m.members[0]: m.log_weight for m in singles}

    def proposal(self) -> NextMeasurement | None:
        """What separates them; None where nothing does, or where a name is a lone reading."""
        named = self._attribution.named(self._member)
        variants = [self._variants(name) for name in (named, *self._likeliest())]
        variants = [each for each in variants if each]
        geometry = self._attribution.problem.fitted_sessions[-1].model.geometry
        if next(options(geometry, Preparation()), None) is None:
            return None
        if len(variants) < 2 or named != self._attribution.named(variants[0][0]):
            return None
        tried = (*self._given, *(k for each in variants for k in each))
        weights = np.array([max(self._weight[k] for k in each) for each in variants])
        added, apart = best_addition(
            self._attribution.problem,
            [[self._explanation(k, self._given) for k in each] for each in variants],
            np.maximum(np.exp(weights - weights.max()), LEAST_SHARE),
            [self._explanation(k, (self._member,)) for k in self._given],
            load_tells=any(self._candidates[k].id == MATTERS_OF_LOAD for k in tried),
        )
        return _proposal(added, [self._attribution.named(each[0]) for each in variants], apart)

    def _likeliest(self) -> list[Named]:
        """Rivals, the best first."""
        rivals = self._attribution.rivals[self._member]
        best = {name: max(self._weight[k] for k in self._of_name(name)) for name in rivals}
        return descending(rivals, best.__getitem__, LOG_UNIT)[: MOST_NAMES - 1]

    def _of_name(self, name: Named) -> list[int]:
        return [k for k in range(len(self._candidates)) if self._attribution.named(k) == name]

    def _variants(self, name: Named) -> list[int]:
        """Candidates of a name that fit about as well as its best, as screws of other leads."""
        found = [
            k for k in self._of_name(name) if self._candidates[k].shares and k not in self._given
        ]
        found = descending(found, self._weight.__getitem__, LOG_UNIT)
        best = self._weight[found[0]] if found else 0.0
        near = [
            k
            for k in found
            if k == self._member or self._weight[k] > best - 0.5 * POLICY.told_apart
        ]
        return sorted(near, key=lambda k: k != self._member)[: POLICY.most_causes]

    def _explanation(self, k: int, given: tuple[int, ...]) -> Explanation:
        """A candidate with the values that it has given the effects that are kept."""
        parameters = self._attribution.selection.values((k, *given))[k][0]
        return Explanation(self._candidates[k], np.array([v.value for v in parameters]))


def _proposal(added: Added, names: Sequence[Named], apart: FloatArray) -> NextMeasurement | None:
    """What the measurement does, said of the names that it really separates."""
    most = float(apart[0, 1:].max())
    if most < SHOWS:
        return None
    bar = POLICY.decisive if most >= POLICY.decisive else SHOWS
    told = [0]
    for k in range(1, len(names)):
        if all(apart[k, other] >= bar for other in told):
            told.append(k)
    words = [f"{names[k].id} ({names[k].where})" for k in told]
    verb = "decides" if bar == POLICY.decisive else "helps to decide"
    return NextMeasurement(
        f"{added.words}; it {verb} between {', '.join(words[:-1])} and {words[-1]}",
        _procedure_text(added),
        min(float(apart[a, b]) for a, b in combinations(told, 2)),
        tuple(names[k] for k in told),
        added.preparation.entered_mm,
        added.preparation.load,
    )


def _procedure_text(added: Added) -> str:
    levels = ", ".join(['"zero"', *(f"{level:.1f}" for level in added.levels_mm)])
    legs = ", ".join(f'"{leg}"' for leg in added.legs)
    words = added.preparation.words
    return (
        'schema = "glidecal.procedure/1"\n'
        f'name = "next-{"".join(added.legs)}"\n'
        'title = "The measurement that separates what stayed ambiguous"\n'
        + (f'description = "First {words}."\n' if words else "")
        + f"legs = [{legs}]\n"
        f"stations = [{', '.join(map(str, added.stations))}]\n"
        "cycles = 3\n"
        f"levels = [{levels}]\n"
    )


STATION_SETS = ((0.5,), (0.3,), (0.7,), (0.3, 0.7))
LEVEL_SETS = (
    (0.25, 0.55, 0.85, 1.0),
    (-0.25, -0.55, -0.85, -1.0),
    (0.4, 1.0, 0.4, -0.4, -1.0, -0.4),
    (0.35, 1.0, 0.7, 0.35, 0.0, -0.37, -0.7, -1.0, -0.7, -0.37),
)
"""Displacements as parts of the travel: one side, both sides, uneven ones from both sides."""

SHIFT_MM = 5.0
"""A joint offset is changed by so much where readings must become larger; levels keep clear of the
joint limits by as much."""
LOAD = 2.0
"""The tool with a mass as heavy as itself."""

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
            model = preparation.model(problem.fitted_sessions[-1].model)
            some = list(options(model.geometry, preparation))
            if some:
                found += zip(some, judge.separations(model, some), strict=True)
        scores = [_score(separations, weights) for _, separations in found]
        if max(scores) >= (1.0 - 1e-9) * _score(GOAL * np.ones((len(names),) * 2), weights):
            break
    good = [one for one, s in zip(found, scores, strict=True) if s >= NEARLY * max(scores)]
    return min(good, key=lambda one: (bool(one[0].preparation.words), one[0].steps))


def _preparations(problem: Problem, *, load_tells: bool) -> Iterator[tuple[Preparation, ...]]:
    """From the easiest to the most laborious."""
    yield (Preparation(),)
    if load_tells:
        yield (Preparation(load=LOAD),)
    offsets = problem.fitted_sessions[-1].model.parameters_mm[:3]
    shifts = -SHIFT_MM * np.where(np.array(offsets) < 0.0, -1.0, 1.0) * np.eye(3)
    both = [a + sign * b for a, b in combinations(shifts, 2) for sign in (1.0, -1.0)]
    for changes in (shifts, both):
        yield tuple(Preparation((x, y, z)) for x, y, z in (0.0 + np.array(changes)).tolist())


def _score(separations: FloatArray, weights: FloatArray) -> float:
    counted = np.minimum(separations, GOAL) * np.outer(weights, weights)
    return float(np.triu(counted, 1).sum())


def options(geometry: Geometry, preparation: Preparation) -> Iterator[Added]:
    """Every measurement that is considered with this preparation, as far as bars are usable."""
    clear_mm = max(abs(change) for change in preparation.entered_mm)
    for parts, stations in product(LEVEL_SETS, STATION_SETS):
        for legs in [(leg,) for leg in LEG_NAMES] + [LEG_NAMES] * (len(stations) == 1):
            places = product(map(LEG_NAMES.index, legs), stations)
            lows, highs = zip(*(geometry.span_mm(*place) for place in places), strict=True)
            low, high = math.ceil(max(lows) + clear_mm), math.floor(min(highs) - clear_mm)
            if low < 0 < high:
                levels = tuple(float(round(high * p if p > 0.0 else -low * p)) for p in parts)
                yield Added(legs, stations, levels, preparation)
