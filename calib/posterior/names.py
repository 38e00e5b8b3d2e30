"""What the posterior calls by name: each effect and place with its probability, and the verdict.

Nothing is judged here. A model is read as a claim: which names it holds, and whether a law without
a name acts beside them. All that is told are sums of the weights of claims.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, TypeVar

import numpy as np

from calib.arrays import FloatArray, descending, without_zeros
from calib.errors import CalibrationError
from calib.identify.fit import prior_fit
from calib.posterior.library import ELSE, Component
from calib.posterior.posterior import Posterior
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.effects.empirical import EMPIRICAL

Verdict = Literal[
    "agrees", "explained", "ambiguous", "partly-explained", "unexplained", "cannot-tell"
]

Key = TypeVar("Key", str, "Place")

MISSING = 0.98
"""Probability that anything is missing, from which on it is told: of sound sessions one in 50 may
come so far, and these are few among all."""

SURE = 0.95
"""Probability of a claim that is made without a rival, or that names do not explain everything."""

OPEN = 0.01
"""Claims that lack a name and have together so little weight of what is missing are no rivals: the
truth is to be in the set 99 times of 100."""

EVEN = 0.5
"""Probability from which on the simpler is told: nothing is missing, nothing acts beside a name."""

WITH_MORE = ("ambiguous", "partly-explained", "unexplained")
"""Verdicts beside which a law without a name is of interest."""

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
        return self._likeliest_first(names, lambda claim: claim.ids)

    @cached_property
    def places(self) -> dict[Place, float]:
        """Probability of each name at each place; the likeliest first."""
        names = sorted({name for claim in self.weights for name in claim.names})
        return self._likeliest_first(names, lambda claim: claim.names)

    def _likeliest_first(
        self, names: Sequence[Key], names_of: Callable[[Claim], frozenset[Key]]
    ) -> dict[Key, float]:
        """Names with the weight of all claims that have them."""
        found = {
            name: math.fsum(w for claim, w in self.weights.items() if name in names_of(claim))
            for name in names
        }
        return dict(descending(found.items(), lambda item: item[1]))

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
        held = self.probability(lambda claim: all(self.holds(claim, name) for name in head))
        alone = self.probability(
            lambda claim: (
                not claim.unnamed
                and all(self.holds(claim, name) for name in head)
                and all(any(self.one_in_other(one, name) for name in head) for one in claim.names)
            )
        )
        sure = held >= SURE * missing and alone >= EVEN * held and not any(rivals.values())
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
    def _folded(self) -> dict[Claim, float]:
        """Weights of claims that something is missing, without those that only add to a heavier.

        What is added and not needed counts for that claim.
        """
        every = [claim for claim in self.weights if claim != NOTHING]
        every.sort(key=lambda claim: (len(claim.names), claim.unnamed, sorted(claim.names)))
        found: dict[Claim, float] = {}
        for claim in every:
            within = [
                other
                for other in found
                if other.names <= claim.names
                and other.unnamed <= claim.unnamed
                and self.weights[other] > self.weights[claim]
            ]
            onto = descending(within, self.weights.__getitem__)[0] if within else claim
            found[onto] = found.get(onto, 0.0) + self.weights[claim]
        return found

    def _rivals_of(self, name: Place, head: Sequence[Place]) -> tuple[Place, ...]:
        """What claims without a name have in its place, the likeliest first; the rest is `OPEN`."""
        folded = self._folded
        lacking = [claim for claim in folded if not self.holds(claim, name)]
        left = math.fsum(folded[claim] for claim in lacking)
        found: dict[Place, None] = {}
        for claim in descending(lacking, folded.__getitem__):
            if left <= OPEN * (1.0 - self.nothing):
                break
            left -= folded[claim]
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
        findings: list[Finding] = []
        adopted: tuple[EffectInstance, ...] = ()
        before = after = self._gap_mm(())
        for place in answer.rivals:
            finding = self._finding(self._likeliest(place), adopted, after)
            rivals = tuple(self._named(one) for one in answer.rivals[place])
            findings.append(replace(finding, indistinguishable_from=rivals))
            adopted, after = (*adopted, *finding.effects), finding.gap_rms_after_mm
        left_over = None
        if claims.unnamed >= EVEN * (1.0 - claims.nothing) and answer.verdict in WITH_MORE:
            left_over = self._left_over(adopted, after)
        return Diagnosis(
            verdict=answer.verdict,
            sentence=sentence(answer.verdict, findings, left_over),
            nothing=claims.nothing,
            named=claims.named,
            unnamed=claims.unnamed,
            something_else=self.posterior.probability(ELSE),
            names=tuple(claims.ids.items()),
            effects=tuple(findings),
            candidates=tuple(self._contenders(answer)),
            left_over=left_over,
            gap_before_mm=before,
            gap_after_mm=after,
        )

    def _named(self, place: Place) -> Named:
        """A rival with its probability; what has no name acts anywhere."""
        probability = self.claims.places.get(place, self.claims.unnamed)
        return Named(place.id, place.where, probability)

    def _weight_of(self, number: int) -> float:
        return math.fsum(m.weight for m in self.posterior.models if number in m.members)

    def _likeliest(self, place: Place) -> int:
        """The component of a name at a place; of several, such as screws of two leads, the best."""
        every = enumerate(self.posterior.components)
        numbers = [k for k, one in every if one.candidate and place_of(one) == place]
        return descending(numbers, self._weight_of)[0]

    def _sizes(self, number: int) -> tuple[FloatArray, FloatArray]:
        """Expected values ``(r,)`` and their standard deviations, given that this acts."""
        components = self.posterior.components
        weights, means, squares = [], [], []
        for model in self.posterior.models:
            if number not in model.members:
                continue
            widths = [len(components[k].unit) for k in model.members]
            first = len(model.mean) - sum(widths[model.members.index(number) :])
            mine = slice(first, first + len(components[number].unit))
            weights.append(model.weight)
            means.append(model.mean[mine])
            squares.append(model.mean[mine] ** 2 + model.covariance.diagonal()[mine])
        share = np.array(weights) / math.fsum(weights)
        mean = share @ np.array(means)
        return mean, np.sqrt(np.maximum(share @ np.array(squares) - mean**2, 0.0))

    def _values(self, number: int) -> tuple[tuple[Value, ...], tuple[EffectInstance, ...]]:
        """Parameters of a component, and the effects of their expected values."""
        candidate = self.posterior.components[number].candidate
        if candidate is None:
            return (), ()
        mean, deviation = self._sizes(number)
        each = zip(candidate.parameters, mean.tolist(), deviation.tolist(), strict=True)
        parameters = tuple(Value(p.name, value, u, p.unit) for p, value, u in each)
        return parameters, candidate.effects(mean)

    def _finding(
        self, number: int, adopted: tuple[EffectInstance, ...], before_mm: float
    ) -> Finding:
        """A component beside what is adopted."""
        one = self.posterior.components[number]
        parameters, effects = self._values(number)
        after_mm = self._gap_mm((*adopted, *effects)) if effects else before_mm
        kind, title = (one.candidate.kind, one.candidate.title) if one.candidate else (ELSE, ELSE)
        probability = self.claims.places.get(place_of(one), self._weight_of(number))
        what = one.id, str(kind), title, one.where
        return Finding(*what, parameters, probability, before_mm, after_mm, (), effects)

    def _left_over(self, adopted: tuple[EffectInstance, ...], before_mm: float) -> Finding | None:
        """The likeliest law without a name."""
        weights: dict[int, float] = {}
        for model in self.posterior.models:
            for k in model.members:
                if self.posterior.components[k].kind == "nameless":
                    weights[k] = weights.get(k, 0.0) + model.weight
        if not weights:
            return None
        number = descending(sorted(weights), weights.__getitem__)[0]
        return self._finding(number, adopted, before_mm)

    def _contenders(self, answer: Answer) -> Iterator[Contender]:
        """Places that may act and are not named, the likeliest first."""
        rivals = {one for some in answer.rivals.values() for one in some}
        others = [place for place in self.claims.places if place not in answer.rivals]
        for place in others[:MOST_CONTENDERS]:
            parameters, effects = self._values(self._likeliest(place))
            if place in rivals:
                reason = "fits about as well"
            elif answer.rivals:
                reason = "another effect explains it better"
            else:
                reason = "no better than chance among so many candidates"
            probability = self.claims.places[place]
            yield Contender(place.id, place.where, parameters, probability, reason, effects)

    def _gap_mm(self, effects: tuple[EffectInstance, ...]) -> float:
        """R.m.s. of what means of cells keep once parameters are fitted; NaN where they cannot."""
        total = count = 0.0
        for cells in self.posterior.sessions:
            model, means, weight = cells.case.model, cells.means, 1.0 / cells.variance_mm2
            acting = model.with_effects((*model.effects, *effects))
            try:
                fit = prior_fit(acting, means, weight, cells.case.spread_mm)
            except CalibrationError:
                return math.nan
            off = means.value_mm - fit.model.readings(means)
            total += float((means.averaged * without_zeros(means, weight, off) ** 2).sum())
            count += float(means.averaged.sum())
        return math.sqrt(total / count)


def sentence(verdict: Verdict, findings: Sequence[Finding], left_over: Finding | None) -> str:
    """The verdict for a machinist."""
    names = " and ".join(f"{one.title} ({one.where})" for one in findings)
    others = sorted({rival.id for one in findings for rival in one.indistinguishable_from})
    rivals = ["an unnamed effect" if one == EMPIRICAL else one for one in others]
    if len(rivals) > MOST_RIVALS:
        rivals = [*rivals[: MOST_RIVALS - 1], f"{len(rivals) - MOST_RIVALS + 1} others"]
    instead = (
        f", or instead {', '.join(rivals)}. These readings cannot decide."
        if rivals
        else ". More may be missing beside it; these readings cannot decide."
    )
    rest = f": {left_over.title} ({left_over.where})" if left_over else ""
    return {
        "agrees": "The model explains the readings within their noise; nothing is missing.",
        "explained": f"What was missing is: {names}.",
        "ambiguous": f"Something is missing: {names}{instead}",
        "partly-explained": f"Part of what is missing: {names}. The rest has no name{rest}.",
        "unexplained": f"Something is missing. No known effect explains it{rest}.",
        "cannot-tell": "The readings cannot tell whether anything is missing.",
    }[verdict]
