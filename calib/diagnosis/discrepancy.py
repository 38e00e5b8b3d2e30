"""What is left without a name, as an unnamed law: what it depends on, where, and how much.

Every place (a mounting, a leg with both indicators, all of them) with up to three bases is fitted
to what the named effects leave; the one of most evidence is kept if it is more than chance
among all that were tried (Bonferroni, F against what it leaves itself). The law is a description:
its uncertainty is inflated by what it leaves.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from calib.arrays import LEG_NAMES, NEW_DIRECTION, FloatArray, IntArray, descending, lengths
from calib.diagnosis.gap import left_out_postures, on_other_sessions
from calib.diagnosis.model_selection import ModelSelection
from calib.diagnosis.policy import POLICY
from calib.diagnosis.problem import FittedSession, Problem
from calib.diagnosis.results import Finding, HeldOutGap, ModelDiscrepancy, Value
from calib.diagnosis.selection import LOG_UNIT, Spread, evidence
from calib.stats import variance_ratio_p_value
from calib.tripod.effects.candidates import stacked_columns
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.effects.empirical import BASES, Empirical, empirical_words
from calib.tripod.pipeline import Stage

NOT_WITH = 0.05
"""Chance above which something is said not to matter."""

HELD_OUT_AMONG = 30
OTHER_CAUSES = ("up_less_down", "per_hour", "per_kelvin")


@dataclass(frozen=True)
class _Unnamed:
    """One law: its terms by number, and what it explains of the gap with so many directions."""

    where: str
    places: tuple[str, ...]
    bases: tuple[str, ...]
    terms: tuple[int, ...]
    explained: float
    rank: int


class _Rest:
    """What the kept effects leave, and every basis at every mounting as a term.

    ``y`` ``(n,)`` is whitened, its gap and degrees of freedom beside it. ``terms`` numbers places
    with bases; ``columns`` ``(n, K)`` are in mm per unit, ``free`` the same whitened, nuisance
    projected out, divided by ``size``. What is kept stays as it is adopted, so the law has to do
    with what is left.
    """

    def __init__(self, selection: ModelSelection, members: tuple[int, ...]) -> None:
        self.problem = problem = selection.problem
        self.y = selection.residual(members)
        gap = selection.gap(members)
        self.gap, self.freedom = gap.chi_square, gap.degrees_of_freedom
        self.spread = Spread(self.gap, float(self.freedom))  # what the law leaves is noise, too
        sessions = [(one.model, one.observed) for one in problem.fitted_sessions]
        stacked = stacked_columns(sessions, [Empirical((name,)) for name in BASES])
        every = {
            (place, name): column
            for name, of_it in zip(BASES, stacked, strict=True)
            for place, column in of_it.items()
        }
        blocks = problem.blocks([*every.values()])
        shown = [key for key, block in zip(every, blocks, strict=True) if block.shape[1]]
        self.terms = {key: k for k, key in enumerate(shown)}
        nothing = np.zeros((len(problem.y), 0))
        self.columns = np.hstack([nothing, *(every[key] for key in shown)])
        self.size = lengths(problem.root_weight[:, None] * self.columns)
        self.free = problem.free(self.columns / self.size)
        self._products, self._across = self.free.T @ self.free, self.free.T @ self.y

    def explained(self, terms: Sequence[int]) -> tuple[float, int]:
        """What these terms explain of the gap, and in how many directions."""
        some = list(terms)
        size, axes = np.linalg.eigh(self._products[np.ix_(some, some)])
        seen = size > NEW_DIRECTION**2
        parts = (axes[:, seen].T @ self._across[some]) ** 2 / size[seen]
        return min(float(parts.sum()), self.gap), int(seen.sum())

    def p_value(self, unnamed: _Unnamed, before: float = 0.0, taken: int = 0) -> float:
        """Of so much more explained than ``before``, against what is left then."""
        rank, free = unnamed.rank - taken, self.freedom - unnamed.rank
        if rank <= 0 or free < 1:
            return 1.0
        ratio = (unnamed.explained - before) / rank / (self.spread.left(unnamed.explained) / free)
        return variance_ratio_p_value(max(ratio, 0.0), rank, free)

    def unnamed_effects(self) -> Iterator[_Unnamed]:
        """Every place with one to three bases of one stage that leave enough to judge with."""
        for stage in (Stage.READING, Stage.ACTUATOR):
            names = [name for name in BASES if BASES[name].stage == stage]
            places = list(dict.fromkeys(place for place, name in self.terms if name in names))
            wheres = list(_wheres(places))
            for count in range(1, POLICY.most_causes + 1):
                for bases in combinations(names, count):
                    for where, here in wheres:
                        wanted = [(place, name) for place in here for name in bases]
                        if all(each in self.terms for each in wanted):
                            terms = tuple(self.terms[each] for each in wanted)
                            unnamed = _Unnamed(where, here, bases, terms, *self.explained(terms))
                            if unnamed.rank and self.freedom - unnamed.rank >= POLICY.room:
                                yield unnamed


def _wheres(places: Sequence[str]) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Each place, each leg with both indicators, all legs."""
    yield from ((place, (place,)) for place in places)
    legs = {leg: tuple(p for p in places if p[0] == leg) for leg in LEG_NAMES}
    yield from ((leg, here) for leg, here in legs.items() if len(here) > 1)
    reached = [leg for leg, here in legs.items() if here]
    if len(reached) > 1:
        yield ",".join(reached), tuple(places)


def discrepancy(
    selection: ModelSelection,
    members: tuple[int, ...],
    named: tuple[EffectInstance, ...],
    others: Sequence[FittedSession],
) -> ModelDiscrepancy | None:
    """The law of the whole gap, where it closes it; else of what is left beside what was named.

    ``others`` are sessions for the held-out gap; without them one displacement of one leg is left
    out at a time. None where the residuals follow no law.
    """
    whole, closes = _described(selection, (), (), others)
    if whole and (closes or not members):
        return replace(whole, whole=bool(members))
    return _described(selection, members, named, others)[0] if members else None


def _described(
    selection: ModelSelection,
    members: tuple[int, ...],
    named: tuple[EffectInstance, ...],
    others: Sequence[FittedSession],
) -> tuple[ModelDiscrepancy | None, bool]:
    """The law that the residuals follow beside named effects, and whether it closes the gap."""
    rest = _Rest(selection, members)
    unnamed_effects = descending(
        rest.unnamed_effects(), lambda one: evidence(one.explained, one.rank, rest.spread), LOG_UNIT
    )
    if not unnamed_effects:
        return None, False
    best, problem = unnamed_effects[0], selection.problem
    p = min(rest.p_value(best) * len(unnamed_effects), 1.0)  # Bonferroni
    if p > POLICY.naming_level:
        return None, False
    finding = _finding(rest, best, p)
    if others:
        held = on_other_sessions(problem, others, (*named, *finding.effects))
    else:
        known = [selection.candidates[k].columns for k in members]
        columns = [
            np.hstack([*known, rest.columns[:, list(unnamed.terms)]])
            for unnamed in unnamed_effects[:HELD_OUT_AMONG]
        ]
        held = _held_out(problem, columns)
    after = problem.gap_p_value(rest.gap - best.explained, rest.freedom - best.rank)
    return ModelDiscrepancy(finding, held), after > POLICY.agreement_level


def _held_out(problem: Problem, columns: Sequence[FloatArray]) -> HeldOutGap | None:
    """Each displacement of each leg but Zero left out: a law may be asked between what it saw."""
    names = ("leg", "displacement_mm", "position_mm")
    keys = np.column_stack([problem.conditions(name) for name in names])
    places = dict.fromkeys(map(tuple, keys.tolist()))
    groups: list[IntArray] = [
        np.flatnonzero((keys == place).all(axis=1)) for place in places if any(place[1:])
    ]
    found = left_out_postures(problem, columns, 1, groups)
    how = "one displacement of one leg left out at a time, the pattern chosen again each time"
    return replace(found, how=how) if found else None


def _finding(rest: _Rest, unnamed: _Unnamed, p: float) -> Finding:
    """The law with its values, fitted to what the kept effects leave."""
    terms = list(unnamed.terms)
    free, size = rest.free[:, terms], rest.size[terms]
    inverse = np.linalg.pinv(free, rcond=NEW_DIRECTION)
    scaled = inverse @ rest.y
    inflated = math.sqrt(
        max(rest.spread.left(unnamed.explained) / (rest.freedom - unnamed.rank), 1.0)
    )
    values = scaled / size
    spread = inflated * np.sqrt((inverse**2).sum(axis=1)) / size
    effect, width = Empirical(unnamed.bases), len(unnamed.bases)
    parameters = []
    for k, (value, u) in enumerate(zip(values, spread, strict=True)):
        place, basis = unnamed.places[k // width], unnamed.bases[k % width]
        name = f"{basis}_{place}" if len(unnamed.places) > 1 else basis
        parameters.append(Value(name, float(value), float(u), effect.parameters[k % width].unit))
    return Finding(
        effect.id,
        str(effect.kind),
        _words(rest, unnamed),
        unnamed.where,
        tuple(parameters),
        p,
        rest.problem.gap_rms_mm(rest.y),
        rest.problem.gap_rms_mm(rest.y - free @ scaled),
        (),
        tuple(
            EffectInstance(effect, place, tuple(values[k * width : (k + 1) * width].tolist()))
            for k, place in enumerate(unnamed.places)
        ),
    )


def _words(rest: _Rest, unnamed: _Unnamed) -> str:
    """``it grows with the cube of displacement at both indicators of leg X, not with time``."""
    place = unnamed.where.upper()
    if BASES[unnamed.bases[0]].stage == Stage.ACTUATOR:
        where = "every carriage, differently at each" if "," in place else f"carriage {place}"
        where = f"of {where}"
    elif "," in place:
        where = "at every indicator, differently at each"
    elif len(place) > 1:
        where = f"at the indicator along {place[1]} of leg {place[0]}"
    else:
        where = f"at both indicators of leg {place}"
    others = " or ".join(BASES[name].words for name in _untouched(rest, unnamed))
    return f"it grows {empirical_words(unnamed.bases)} {where}" + (
        f", not {others}" if others else ""
    )


def _untouched(rest: _Rest, unnamed: _Unnamed) -> Iterator[str]:
    """What else could matter on these legs and does not."""
    legs = {place[0] for place in unnamed.places}
    for name in OTHER_CAUSES:
        more = [k for (place, of_it), k in rest.terms.items() if of_it == name and place[0] in legs]
        if name in unnamed.bases or not more:
            continue
        terms = (*unnamed.terms, *more)
        explained, rank = rest.explained(terms)
        wider = replace(unnamed, terms=terms, explained=explained, rank=rank)
        if rest.p_value(wider, unnamed.explained, unnamed.rank) > NOT_WITH:
            yield name
