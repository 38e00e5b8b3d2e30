"""What is left without a name, as an unnamed law: what it depends on, where, and how much.

Every place (a mounting, a leg with both indicators, all of them) with up to three bases is fitted
to what the named effects leave; the best by BIC over the cells is kept if it is more than chance
among all that were tried (Bonferroni, F against what it leaves itself). The law is a description:
its uncertainty is enlarged by what it leaves.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.special import fdtrc

from calib.diagnosis.fitting import Fitting
from calib.diagnosis.problem import FittedSession, Problem
from calib.diagnosis.results import Finding, HeldOutGap, ModelDiscrepancy, Value
from calib.diagnosis.scan import gap_p_value
from calib.diagnosis.selection import LOG_UNIT
from calib.diagnosis.verify import left_out_postures, on_other_sessions, structure_rms_mm
from calib.linalg import NEW_DIRECTION, lengths
from calib.observations import LEG_NAMES, FloatArray, IntArray
from calib.ties import descending
from calib.tripod.effects.candidates import stacked_columns
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.effects.empirical import BASES, Empirical, law_words
from calib.tripod.pipeline import Stage

MOST_BASES = 3
LEVEL = 0.005
GAP_LEVEL = 0.01
NOT_WITH = 0.05
"""Chance above which something is said not to matter."""
LEAST_LEFT = 4
"""Degrees of freedom that a law must leave."""
HELD_OUT_AMONG = 30
OTHER_CAUSES = ("up_less_down", "per_hour", "per_kelvin")


@dataclass(frozen=True)
class _Law:
    """One law: its terms by number, and what it explains of the gap with so many directions."""

    where: str
    places: tuple[str, ...]
    bases: tuple[str, ...]
    terms: tuple[int, ...]
    explained: float
    rank: int


@dataclass(frozen=True, eq=False)
class _Rest:
    """What the kept effects leave, and every basis at every mounting as a term.

    ``y`` ``(n,)`` is whitened, its gap and degrees of freedom beside it. ``columns`` ``(n, K)`` are
    in mm per unit, ``free`` the same whitened, nuisance projected out, divided by ``size``;
    ``products`` and ``across`` are those of ``free``. What is kept stays as it is adopted, so the
    law has to do with what is left.
    """

    problem: Problem
    y: FloatArray
    gap: float
    freedom: int
    terms: dict[tuple[str, str], int]
    columns: FloatArray
    size: FloatArray
    free: FloatArray
    products: FloatArray
    across: FloatArray

    @classmethod
    def of(cls, fitting: Fitting, members: tuple[int, ...]) -> _Rest:
        """After these members."""
        problem = fitting.problem
        y = fitting.race.left(members)
        gap, freedom, _ = fitting.race.gap(members)
        terms, columns = _terms(problem)
        size = lengths(problem.root_weight[:, None] * columns)
        free = problem.free(columns / size)
        products, across = free.T @ free, free.T @ y
        return cls(problem, y, gap, freedom, terms, columns, size, free, products, across)

    def explained(self, terms: Sequence[int]) -> tuple[float, int]:
        """What these terms explain of the gap, and in how many directions."""
        some = list(terms)
        size, axes = np.linalg.eigh(self.products[np.ix_(some, some)])
        seen = size > NEW_DIRECTION**2
        parts = (axes[:, seen].T @ self.across[some]) ** 2 / size[seen]
        return min(float(parts.sum()), self.gap), int(seen.sum())

    def left(self, explained: float) -> float:
        """The gap that is left, never nothing."""
        return max(self.gap - explained, 1e-12 * self.gap)

    def chance(self, law: _Law, before: float = 0.0, taken: int = 0) -> float:
        """Of so much more explained than ``before``, against what is left then."""
        rank, free = law.rank - taken, self.freedom - law.rank
        if rank <= 0 or free < 1:
            return 1.0
        ratio = (law.explained - before) / rank / (self.left(law.explained) / free)
        return float(fdtrc(rank, free, max(ratio, 0.0)))


def left_over(
    fitting: Fitting,
    members: tuple[int, ...],
    named: tuple[EffectInstance, ...],
    others: Sequence[FittedSession],
) -> ModelDiscrepancy | None:
    """The law of the whole gap, where it closes it; else of what is left beside what was named."""
    whole = _describe(fitting, (), (), others)
    if whole and (whole.closes or not members):
        return ModelDiscrepancy(whole.finding, whole.held_out, whole=bool(members))
    if not members:
        return None
    rest = _describe(fitting, members, named, others)
    return ModelDiscrepancy(rest.finding, rest.held_out) if rest else None


@dataclass(frozen=True)
class _Described:
    """A law; ``closes`` tells whether what it leaves agrees with the noise."""

    finding: Finding
    held_out: HeldOutGap | None
    closes: bool


def _describe(
    fitting: Fitting,
    members: tuple[int, ...],
    named: tuple[EffectInstance, ...],
    others: Sequence[FittedSession],
) -> _Described | None:
    """The law that what is left follows beside ``named`` effects; None where it follows none.

    ``others`` are sessions for the held-out gap; without them one displacement of one leg is left
    out at a time.
    """
    rest = _Rest.of(fitting, members)
    laws = descending(_laws(rest), lambda law: -_criterion(rest, law), LOG_UNIT)
    p = min(rest.chance(laws[0]) * len(laws), 1.0) if laws else 1.0
    if p > LEVEL:
        return None
    best, finding = laws[0], _finding(rest, laws[0], p)
    columns = [rest.columns[:, list(law.terms)] for law in laws[:HELD_OUT_AMONG]]
    effects = (*named, *finding.effects)
    after = gap_p_value(
        rest.gap - best.explained, rest.freedom - best.rank, fitting.problem.noise_df
    )
    held = _held_out(fitting, members, columns, effects, others)
    return _Described(finding, held, after > GAP_LEVEL)


def _terms(problem: Problem) -> tuple[dict[tuple[str, str], int], FloatArray]:
    """Every basis that varies at every place (place, basis), and its columns in mm per unit."""
    laws = [Empirical((name,)) for name in BASES]
    stacked = stacked_columns([(one.model, one.observed) for one in problem.fitted_sessions], laws)
    terms: dict[tuple[str, str], int] = {}
    columns = [np.zeros((len(problem.y), 0))]
    for name, of_it in zip(BASES, stacked, strict=True):
        for place, column in of_it.items():
            if problem.block(column).shape[1]:
                terms[place, name] = len(terms)
                columns.append(column)
    return terms, np.hstack(columns)


def _laws(rest: _Rest) -> Iterator[_Law]:
    """Every place with one to three bases of one stage that leave enough to judge with."""
    for stage in (Stage.READING, Stage.ACTUATOR):
        names = [name for name in BASES if BASES[name].stage == stage]
        places = list(dict.fromkeys(place for place, name in rest.terms if name in names))
        for count in range(1, MOST_BASES + 1):
            for bases in combinations(names, count):
                for where, here in _wheres(places):
                    law = _law(rest, where, here, bases)
                    if law and law.rank and rest.freedom - law.rank >= LEAST_LEFT:
                        yield law


def _law(rest: _Rest, where: str, places: tuple[str, ...], bases: tuple[str, ...]) -> _Law | None:
    wanted = [(place, name) for place in places for name in bases]
    if any(each not in rest.terms for each in wanted):
        return None
    terms = tuple(rest.terms[each] for each in wanted)
    return _Law(where, places, bases, terms, *rest.explained(terms))


def _wheres(places: Sequence[str]) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Each place, each leg with both indicators, all legs."""
    yield from ((place, (place,)) for place in places)
    legs = {leg: tuple(p for p in places if p[0] == leg) for leg in LEG_NAMES}
    yield from ((leg, here) for leg, here in legs.items() if len(here) > 1)
    reached = [leg for leg, here in legs.items() if here]
    if len(reached) > 1:
        yield ",".join(reached), tuple(places)


def _criterion(rest: _Rest, law: _Law) -> float:
    """BIC over the cells."""
    return rest.freedom * math.log(rest.left(law.explained)) + law.rank * math.log(rest.freedom)


def _finding(rest: _Rest, law: _Law, p: float) -> Finding:
    """The law with its values, fitted to what the kept effects leave."""
    terms = list(law.terms)
    free = rest.free[:, terms]
    inverse = np.linalg.pinv(free, rcond=NEW_DIRECTION)
    scaled = inverse @ rest.y
    enlarged = math.sqrt(max(rest.left(law.explained) / (rest.freedom - law.rank), 1.0))
    values = scaled / rest.size[terms]
    spread = enlarged * np.sqrt((inverse**2).sum(axis=1)) / rest.size[terms]
    term, width = Empirical(law.bases), len(law.bases)
    return Finding(
        term.id,
        str(term.kind),
        _words(rest, law),
        law.where,
        tuple(
            Value(_name(law, k), float(value), float(u), term.parameters[k % width].unit)
            for k, (value, u) in enumerate(zip(values, spread, strict=True))
        ),
        p,
        structure_rms_mm(rest.problem, rest.y),
        structure_rms_mm(rest.problem, rest.y - free @ scaled),
        (),
        tuple(
            EffectInstance(term, place, tuple(values[k * width : (k + 1) * width].tolist()))
            for k, place in enumerate(law.places)
        ),
    )


def _name(law: _Law, k: int) -> str:
    """Of the k-th value: its basis, with the place where there are several."""
    place, basis = law.places[k // len(law.bases)], law.bases[k % len(law.bases)]
    return f"{basis}_{place}" if len(law.places) > 1 else basis


def _words(rest: _Rest, law: _Law) -> str:
    """``it grows with the cube of displacement at both indicators of leg X, not with time``."""
    words = f"it grows {law_words(law.bases)} {_place_words(law)}"
    others = " or ".join(BASES[name].words for name in _untouched(rest, law))
    return words + (f", not {others}" if others else "")


def _place_words(law: _Law) -> str:
    several = "," in law.where
    if BASES[law.bases[0]].stage == Stage.ACTUATOR:
        return (
            "of every carriage, differently at each"
            if several
            else f"of carriage {law.where.upper()}"
        )
    if several:
        return "at every indicator, differently at each"
    place = law.where.upper()
    if len(place) > 1:
        return f"at the indicator along {place[1]} of leg {place[0]}"
    return f"at both indicators of leg {place}"


def _untouched(rest: _Rest, law: _Law) -> Iterator[str]:
    """What else could matter on these legs and does not."""
    legs = {place[0] for place in law.places}
    for name in OTHER_CAUSES:
        more = [k for (place, of_it), k in rest.terms.items() if of_it == name and place[0] in legs]
        if name in law.bases or not more:
            continue
        wider = replace(law, terms=(*law.terms, *more))
        explained, rank = rest.explained(wider.terms)
        wider = replace(wider, explained=explained, rank=rank)
        if rest.chance(wider, law.explained, law.rank) > NOT_WITH:
            yield name


def _held_out(
    fitting: Fitting,
    members: tuple[int, ...],
    laws: Sequence[FloatArray],
    effects: tuple[EffectInstance, ...],
    others: Sequence[FittedSession],
) -> HeldOutGap | None:
    """The gap that the choice of the law did not see."""
    tolerance = fitting.cases[0].tolerance_mm
    if others:
        return on_other_sessions(others, effects, tolerance)
    known = [fitting.entries[k].columns for k in members]
    columns = [np.hstack([*known, law]) for law in laws]
    groups = _one_displacement(fitting.problem)
    found = left_out_postures(fitting.problem, columns, 1, tolerance, groups)
    how = "one displacement of one leg left out at a time, the law chosen anew each time"
    return replace(found, how=how) if found else None


def _one_displacement(problem: Problem) -> list[IntArray]:
    """Rows of each displacement of each leg but Zero: a law may be asked between what it saw."""
    names = ("leg", "displacement_mm", "position_mm")
    keys = np.column_stack([problem.conditions(name) for name in names])
    places = dict.fromkeys(map(tuple, keys.tolist()))
    return [np.flatnonzero((keys == place).all(axis=1)) for place in places if any(place[1:])]
