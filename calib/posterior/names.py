"""What the posterior calls by name: each effect and place with its probability, and the verdict.

Nothing is judged here. A model is read as a claim: which names it holds, and whether a law without
a name acts beside them. All that is told are sums of the weights of claims.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np

from calib.arrays import FloatArray, descending, without_zeros
from calib.errors import CalibrationError
from calib.identify.fit import prior_fit
from calib.posterior.library import ELSE, Component
from calib.posterior.posterior import Posterior, Weighted
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.effects.empirical import EMPIRICAL

Verdict = Literal[
    "agrees", "explained", "ambiguous", "partly-explained", "unexplained", "cannot-tell"
]

MISSING = 0.95
"""Probability that anything is missing, from which on it is told."""

SURE = 0.95
"""Probability of a claim that is made without a rival."""

OPEN = 0.01
"""Of what is missing: claims of so little weight together are no rivals."""

EVEN = 0.5
"""Whether names explain what is missing, or not."""

MOST_CONTENDERS = 20
MOST_RIVALS = 5


@dataclass(frozen=True, order=True)
class Place:
    """An effect's name and where it acts."""

    id: str
    where: str


@dataclass(frozen=True)
class Named:
    """An effect's name and place with the probability that it acts there."""

    id: str
    where: str
    probability: float


@dataclass(frozen=True)
class Value:
    """One parameter of an effect; its uncertainty is that given the name."""

    name: str
    value: float
    standard_uncertainty: float
    unit: str


@dataclass(frozen=True)
class Finding:
    """An effect that is named.

    ``probability`` is that of the name at this place, ``gap_rms_after_mm`` what the readings keep
    with it and those before it adopted; NaN where no machine has these sizes.
    """

    id: str
    kind: str
    title: str
    where: str
    parameters: tuple[Value, ...]
    probability: float
    gap_rms_before_mm: float
    gap_rms_after_mm: float
    indistinguishable_from: tuple[Named, ...] = ()
    effects: tuple[EffectInstance, ...] = field(default=(), repr=False)


@dataclass(frozen=True)
class Contender:
    """An effect and place that may act, and why it is not named."""

    id: str
    where: str
    parameters: tuple[Value, ...]
    probability: float
    reason_rejected: str
    effects: tuple[EffectInstance, ...] = field(default=(), repr=False)


@dataclass(frozen=True)
class Diagnosis:
    """The verdict, and what it was derived from: ``nothing`` is missing, all is ``named``, or not.

    ``names`` are all ids with their probability, wherever they act. ``left_over`` is the likeliest
    law without a name where names do not explain everything.
    """

    verdict: Verdict
    sentence: str
    nothing: float
    named: float
    unnamed: float
    something_else: float
    names: tuple[tuple[str, float], ...]
    effects: tuple[Finding, ...]
    candidates: tuple[Contender, ...]
    left_over: Finding | None
    gap_before_mm: float
    gap_after_mm: float


@dataclass(frozen=True)
class Claim:
    """What a model says: names at places, and whether something without a name acts beside."""

    names: frozenset[Place]
    unnamed: bool

    @property
    def ids(self) -> frozenset[str]:
        """Its names, wherever they act."""
        return frozenset(name.id for name in self.names)


NOTHING = Claim(frozenset(), unnamed=False)


@dataclass(frozen=True)
class Answer:
    """A verdict with the places that it names, each with its rivals, the likeliest first."""

    verdict: Verdict
    rivals: Mapping[Place, tuple[Place, ...]]


@dataclass(frozen=True, eq=False)
class Claims:
    """Weights of claims, which sum to one, and what is known of places by their components."""

    weights: Mapping[Claim, float]
    reach: Mapping[Place, tuple[frozenset[str], bool]]

    @classmethod
    def of(
        cls, components: Sequence[Component], models: Iterable[tuple[tuple[int, ...], float]]
    ) -> Claims:
        """Models by their members and weights, read as claims."""
        weights: dict[Claim, float] = {}
        for members, weight in models:
            names = frozenset(place_of(components[k]) for k in members if components[k].named)
            claim = Claim(names, any(not components[k].named for k in members))
            weights[claim] = weights.get(claim, 0.0) + weight
        reach: dict[Place, tuple[frozenset[str], bool]] = {}
        for one in components:
            touched = frozenset(s.place for s in one.candidate.shares) if one.candidate else ()
            own = one.candidate is not None and one.candidate.arrangement in ("one", "each")
            reach[place_of(one)] = frozenset(touched), own
        return cls(weights, reach)

    def probability(self, holds: Callable[[Claim], bool]) -> float:
        """That what is true is such a claim."""
        return math.fsum(weight for claim, weight in self.weights.items() if holds(claim))

    @cached_property
    def nothing(self) -> float:
        """That the model without any effect is true."""
        return self.weights.get(NOTHING, 0.0)

    @cached_property
    def unnamed(self) -> float:
        """That something without a name acts, alone or beside names."""
        return self.probability(lambda claim: claim.unnamed)

    @cached_property
    def named(self) -> float:
        """That something is missing and names explain all of it."""
        return self.probability(lambda claim: bool(claim.names) and not claim.unnamed)

    @cached_property
    def ids(self) -> dict[str, float]:
        """Probability of each name, wherever it acts; the likeliest first."""
        names = sorted({name for claim in self.weights for name in claim.ids})
        each = [(name, self.probability(lambda claim, n=name: n in claim.ids)) for name in names]
        return dict(descending(each, lambda one: one[1]))

    @cached_property
    def places(self) -> dict[Place, float]:
        """Probability of each name at each place; the likeliest first."""
        names = sorted({name for claim in self.weights for name in claim.names})
        each = [(name, self.probability(lambda claim, n=name: n in claim.names)) for name in names]
        return dict(descending(each, lambda one: one[1]))

    def one_in_other(self, first: Place, second: Place) -> bool:
        """Whether an effect at one place with values of its own contains it at the other."""
        if first.id != second.id:
            return False
        (one, one_free), (two, two_free) = self.reach[first], self.reach[second]
        return first == second or (two_free and one <= two) or (one_free and two <= one)

    def holds(self, claim: Claim, name: Place) -> bool:
        """Whether a claim has this name, at this place or at one that contains it."""
        return any(self.one_in_other(name, other) for other in claim.names)

    def answer(self) -> Answer:
        """What is told."""
        if 1.0 - self.nothing < MISSING:
            return Answer("agrees" if self.nothing >= EVEN else "cannot-tell", {})
        missing = 1.0 - self.nothing
        if self.named < (1.0 - SURE) * missing:
            head = tuple(name for name, p in self.places.items() if p >= SURE * missing)
            word: Verdict = "partly-explained" if head else "unexplained"
            return Answer(word, dict.fromkeys(head, ()))
        head = self._heaviest()
        rivals = {name: self._rivals_of(name, head) for name in head}
        whole = self.probability(
            lambda claim: not claim.unnamed and all(self.holds(claim, name) for name in head)
        )
        sure = whole >= SURE * missing and not any(rivals.values())
        return Answer("explained" if sure else "ambiguous", rivals)

    def _heaviest(self) -> tuple[Place, ...]:
        """The likeliest set of names that explains everything, at its likeliest places."""
        sets: dict[frozenset[str], dict[frozenset[Place], float]] = {}
        for claim, weight in self.weights.items():
            if claim.names and not claim.unnamed:
                sets.setdefault(claim.ids, {})[claim.names] = weight
        named = sorted(sets.values(), key=lambda places: min(map(sorted, places)))
        chosen = descending(named, lambda places: math.fsum(places.values()))[0]
        places = descending(sorted(chosen, key=sorted), chosen.__getitem__)[0]
        return tuple(name for name in self.places if name in places)

    @cached_property
    def _open(self) -> list[Claim]:
        """The smallest set of claims that holds all but `OPEN` of what is missing."""
        missing = [claim for claim in self.weights if claim != NOTHING]
        missing.sort(key=lambda claim: (claim.unnamed, sorted(claim.names)))
        ordered = descending(missing, self.weights.__getitem__)
        together = np.cumsum([self.weights[claim] for claim in ordered])
        last = int(np.count_nonzero(together < (1.0 - OPEN) * (1.0 - self.nothing)))
        return ordered[: last + 1]

    def _rivals_of(self, name: Place, head: Sequence[Place]) -> tuple[Place, ...]:
        """What else open claims have where they lack a name, the likeliest first."""
        found: dict[Place, None] = {}
        for claim in self._open:
            if self.holds(claim, name):
                continue
            others = [
                other
                for other in claim.names
                if not any(self.one_in_other(one, other) for one in head)
            ]
            if claim.unnamed and not others:
                others = [Place(EMPIRICAL, name.where)]
            found |= dict.fromkeys(sorted(others))
        return tuple(found)


def place_of(component: Component) -> Place:
    """Name and place of a component."""
    return Place(component.id, component.where)


def diagnosis_of(posterior: Posterior) -> Diagnosis:
    """What a mechanic is told of these sessions."""
    return _Report(posterior).make()


@dataclass(frozen=True, eq=False)
class _Report:
    posterior: Posterior

    @cached_property
    def claims(self) -> Claims:
        models = [(model.members, model.weight) for model in self.posterior.models]
        return Claims.of(self.posterior.components, models)

    def make(self) -> Diagnosis:
        claims, answer = self.claims, self.claims.answer()
        findings, gap = [], self._gap_mm(())
        before, adopted = gap, []
        for name, rivals in answer.rivals.items():
            finding = self._finding(name, self._versions(name), gap)
            adopted += list(finding.effects)
            after = self._gap_mm(tuple(adopted))
            findings.append(_with(finding, self._named(rivals), after))
            gap = after
        left_over = self._left_over(gap) if answer.verdict in WITH_MORE else None
        return Diagnosis(
            verdict=answer.verdict,
            sentence=sentence(answer.verdict, findings, left_over),
            nothing=claims.nothing,
            named=claims.named,
            unnamed=claims.unnamed,
            something_else=self.posterior.probability(ELSE),
            names=tuple(claims.ids.items()),
            effects=tuple(findings),
            candidates=self._contenders(answer),
            left_over=left_over,
            gap_before_mm=before,
            gap_after_mm=gap,
        )

    def _named(self, rivals: Sequence[Place]) -> tuple[Named, ...]:
        unnamed = self.claims.unnamed
        return tuple(
            Named(one.id, one.where, self.claims.places.get(one, unnamed)) for one in rivals
        )
