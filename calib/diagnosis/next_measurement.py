"""What to measure next, as a sentence and as a procedure that can be run.

Measurements that may be added: where, at which displacements, and what is changed before.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np

from calib.arrays import (
    BASE_SQUARES,
    LEG_NAMES,
    NEW_DIRECTION,
    TINY,
    TOOL,
    Conditions,
    FloatArray,
    conditions,
    descending,
    without,
    without_means,
)
from calib.diagnosis.attribution import Attribution
from calib.diagnosis.policy import POLICY
from calib.diagnosis.problem import Problem
from calib.diagnosis.results import Named, NextMeasurement, Verdict
from calib.diagnosis.selection import LOG_UNIT
from calib.posterior.measurements import USUAL_PACE, levels_within
from calib.tripod.effects.candidates import Candidate, candidates
from calib.tripod.effects.effect import EffectParameter
from calib.tripod.geometry import Geometry
from calib.tripod.pipeline import Model, derivatives

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

MOST_COMPARED = 6
LEAST_WEIGHT = 0.1
"""Weight that the least likely name still has beside the best one."""

APART = 1.0
"""Names that no option separates by so many noise variances are one thing in other words."""
MATTERS_OF_LOAD = "gravity_sag"

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

CYCLES = 3


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
        self._of_name: dict[Named, list[int]] = {}
        for k in range(len(self._candidates)):
            self._of_name.setdefault(attribution.named(k), []).append(k)

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
            np.maximum(np.exp(weights - weights.max()), LEAST_WEIGHT),
            [self._explanation(k, (self._member,)) for k in self._given],
            load_tells=any(self._candidates[k].id == MATTERS_OF_LOAD for k in tried),
        )
        return _proposal(added, [self._attribution.named(each[0]) for each in variants], apart)

    def _likeliest(self) -> list[Named]:
        """Rivals, the best first."""
        rivals = self._attribution.rivals[self._member]
        best = {name: max(self._weight[k] for k in self._of_name[name]) for name in rivals}
        return descending(rivals, best.__getitem__, LOG_UNIT)[: MOST_COMPARED - 1]

    def _variants(self, name: Named) -> list[int]:
        """Candidates of a name that fit about as well as its best, as screws of other leads."""
        found = [
            k for k in self._of_name[name] if self._candidates[k].shares and k not in self._given
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
    if most < APART:
        return None
    verb, bar = "helps to decide", APART
    if most >= POLICY.decisive:
        verb, bar = "decides", POLICY.decisive
    told = [0]
    for k in range(1, len(names)):
        if all(apart[k, other] >= bar for other in told):
            told.append(k)
    words = [f"{names[k].id} ({names[k].where})" for k in told]
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
            if levels := levels_within(geometry, places, parts, clear_mm):
                yield Added(legs, stations, levels, preparation)


@dataclass(frozen=True)
class Preparation:
    """What is changed before measuring: offsets entered in the controller, mm, and the load."""

    entered_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    load: float = 1.0

    @property
    def words(self) -> str:
        """An instruction, empty where nothing is changed."""
        said = [
            f"add {change:+g} mm to the entered joint offset of {leg.upper()}"
            for leg, change in zip(LEG_NAMES, self.entered_mm, strict=True)
            if change
        ]
        if self.load != 1.0:
            said.append(
                f"load the tool to {self.load:g} times its weight and note load = {self.load:g} "
                "in the machine file"
            )
        return " and ".join(said)

    def model(self, model: Model) -> Model:
        """The machine as it is then."""
        parameters = np.array(model.parameters_mm)
        parameters[:3] -= self.entered_mm
        return replace(
            model.with_parameters(parameters), geometry=replace(model.geometry, load=self.load)
        )


@dataclass(frozen=True)
class Added:
    """An added measurement: legs, stations, displacements from Zero, what is changed before."""

    legs: tuple[str, ...]
    stations: tuple[float, ...]
    levels_mm: tuple[float, ...]
    preparation: Preparation = Preparation()

    @property
    def words(self) -> str:
        """In short."""
        levels = ", ".join(f"{level:+g}" if level else "Zero" for level in self.levels_mm)
        legs = "leg " if len(self.legs) == 1 else "legs "
        places = " and ".join(f"{station:.0%}" for station in self.stations)
        before = f"{self.preparation.words}; then " if self.preparation.words else ""
        return (
            f"{before}{legs}{', '.join(self.legs).upper()}, {places} from the tool end: "
            f"Zero, {levels} mm"
        )

    @property
    def steps(self) -> int:
        """How many postures are visited."""
        return len(self.legs) * len(self.stations) * (CYCLES * (len(self.levels_mm) + 1) + 1)


def added_conditions(levels: Sequence[tuple[float, tuple[float, ...]]]) -> Conditions:
    """Readings on all legs for each station and its displacements, each with mountings of its own.

    Zero before every cycle and last, both axes.
    """
    rows: list[tuple[float, ...]] = []
    places = [(leg, axis) for leg in range(3) for axis in range(3) if axis != leg]
    mountings = [(station, of_it, place) for station, of_it in levels for place in places]
    for mount, (station, of_it, place) in enumerate(mountings):
        path = [0.0, *of_it] * CYCLES + [0.0]
        approach = [0.0, *np.sign(np.diff(path))]
        for k, level in enumerate(path):
            cycle = k // (len(of_it) + 1) + 1
            rows.append((*place, level, station, mount, approach[k], k, cycle))
    leg, axis, displacement, stations, mounting, approaches, step, cycles = np.array(rows).T
    legs, axes, mounts = (of.astype(np.intp).tolist() for of in (leg, axis, mounting))
    made = conditions(legs, axes, displacement.tolist(), station=stations.tolist(), mount=mounts)
    return replace(
        made,
        approach=approaches,
        time_s=USUAL_PACE.seconds_per_step * step,
        cycle=cycles.astype(np.intp),
    )


@dataclass(frozen=True, eq=False)
class Explanation:
    """A candidate with the values ``(r,)`` found so far."""

    candidate: Candidate
    values: FloatArray


Name = Sequence[Explanation]
"""What goes by one name: one explanation, or several such as screws of different leads."""


class Judge:
    """Products of all columns on the old readings, and what options add to them.

    ``given`` are effects that stay whatever is decided.
    """

    def __init__(
        self, problem: Problem, names: Sequence[Name], given: Sequence[Explanation] = ()
    ) -> None:
        self._names = len(names)
        self._all = [*(one for name in names for one in name), *given]
        owners = [k for k, name in enumerate(names) for _ in name]
        self._mine = [np.flatnonzero(np.equal(owners, k)) for k in range(len(names))]
        ends = np.cumsum([len(one.values) for one in self._all]).tolist()
        self._spans = [
            np.arange(end - len(one.values), end) for end, one in zip(ends, self._all, strict=True)
        ]
        self._given = self._spans[len(owners) :]
        self._values = np.zeros((ends[-1], len(self._all)))
        for k, (span, one) in enumerate(zip(self._spans, self._all, strict=True)):
            self._values[span, k] = one.values
        rows = [self._columns(one.model, one.observed) for one in problem.fitted_sessions]
        old = np.hstack([problem.root_weight[:, None] * np.vstack(rows), problem.bars])
        rest = without(problem.whitening.free, old)
        self._tolerance_mm = problem.fitted_sessions[-1].case.tolerance_mm
        self._noise_mm = problem.noise_mm
        self._raw = (old**2).sum(axis=0)[: ends[-1]]
        held = np.diag(np.arange(len(rest.T)) >= ends[-1])  # the lengths, by their tolerance
        self._old = rest.T @ rest + held

    def separations(self, model: Model, options: Sequence[Added]) -> FloatArray:
        """How far each pair of names is apart ``(options, names, names)``, noise variances.

        ``model`` is the machine as it is when the options are measured.
        """
        parts = self._parts(model, options)
        whole = np.stack(
            [
                sum(parts[s, one.levels_mm, leg] for s in one.stations for leg in one.legs)
                for one in options
            ]
        )
        width = len(self._old)
        across, base = whole[:, :width, width:], whole[:, width:, width:]
        scale = np.sqrt(np.maximum(np.einsum("okk->ok", base), TINY))
        across, base = across / scale[:, None], base / (scale[:, :, None] * scale[:, None])
        inside = np.linalg.pinv(base, rcond=BASE_SQUARES, hermitian=True)
        added = whole[:, :width, :width] - across @ inside @ np.swapaxes(across, 1, 2)
        both, count = self._old + added, len(self._raw)
        bars = np.linalg.solve(both[:, count:, count:], both[:, count:, :count])
        left = both[:, :count, :count] - both[:, :count, count:] @ bars
        size = np.sqrt(np.maximum(self._raw + np.einsum("okk->ok", whole)[:, :count], TINY))
        left = self._left(left / (size[:, :, None] * size[:, None]), size)
        found = np.zeros((len(options), self._names, self._names))
        for a, b in combinations(range(self._names), 2):
            some = left[:, self._mine[a]][:, :, self._mine[b]].min(axis=(1, 2))
            others = left[:, self._mine[b]][:, :, self._mine[a]].min(axis=(1, 2))
            found[:, a, b] = found[:, b, a] = np.minimum(some, others)
        return found

    def _left(self, products: FloatArray, size: FloatArray) -> FloatArray:
        """What each explanation leaves of each other one ``(options, other, true)``."""
        scaled = size[:, :, None] * self._values
        seen = products @ scaled
        whole = np.einsum("oke,oke->oe", scaled, seen)
        left = np.zeros((len(products), len(self._all), len(self._all)))
        for k, span in enumerate(self._spans):
            hidden = np.concatenate([span, *self._given])
            block = products[:, hidden][:, :, hidden]
            inside = np.linalg.pinv(block, rcond=NEW_DIRECTION**2, hermitian=True)
            explained = np.einsum("ohe,ohg,oge->oe", seen[:, hidden], inside, seen[:, hidden])
            left[:, k] = np.maximum(whole - explained, 0.0)
        return left

    def _columns(self, model: Model, taken: Conditions) -> FloatArray:
        """Columns of every explanation side by side; zero where one does not show."""
        effects = list(dict.fromkeys(one.candidate.shares[0].effect for one in self._all))
        seen = {_key(one): one.columns for one in candidates(model, taken, effects)}
        columns = []
        for one in self._all:
            nothing = np.zeros((len(taken), len(one.values)))
            columns.append(seen.get(_key(one.candidate), nothing))
        return np.hstack(columns)

    def _parts(
        self, model: Model, options: Sequence[Added]
    ) -> dict[tuple[float, tuple[float, ...], str], FloatArray]:
        """Products of what is sought, lengths and offsets, zeros projected out, at every place.

        By station, displacements and leg.
        """
        keys = list(dict.fromkeys((s, one.levels_mm) for one in options for s in one.stations))
        taken = added_conditions(keys)
        base = derivatives(model.geometry, model.parameters_mm, taken, model.effects)
        base = (base * self._tolerance_mm)[:, [3, 4, 5, 0, 1, 2]]  # lengths are those of before
        columns = np.hstack([self._columns(model, taken), base]) / self._noise_mm
        columns = without_means(taken.mount, np.ones(len(taken)), columns)
        legs = [(*key, leg) for key in keys for leg in LEG_NAMES]  # of two mountings each
        each = ((place, columns[taken.mount // 2 == k]) for k, place in enumerate(legs))
        return {place: rows.T @ rows for place, rows in each}


def _key(one: Candidate) -> tuple[str, str, str, tuple[EffectParameter, ...]]:
    return one.id, one.where, one.arrangement, one.parameters
