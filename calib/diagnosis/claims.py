"""What the models of a posterior claim, and the verdict: sums of the weights of claims.

Nothing is judged here. A model is read as a claim: which names it holds, mistakes of the readings
among them, and whether a law without a name acts beside them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np

from calib.arrays import TOOL, descending
from calib.diagnosis.results import EffectName, Verdict
from calib.diagnosis.thresholds import AGREED, EVEN, MISSING, OPEN, SURE
from calib.posterior.gaussian import About
from calib.posterior.library import Component
from calib.posterior.models import Posterior, WeightedModel
from calib.posterior.selection import log_prior_odds
from calib.tripod.effects.empirical import EMPIRICAL

Key = TypeVar("Key", str, EffectName)

NAMES = ("named", "beside", "mistake")
"""Kinds of components that have a name for a mechanic."""

UNSEEN = 2.0
"""Standard deviations of noise by which a model, at the sizes that it expects, changes all readings
together, beside what lengths and offsets of their tolerances do, from which on readings of the tool
show it. A plate shows little of a machine: play that is always taken up one way, say, is as likely
after any readings as before, and such laws together kept a fifth of sound machines from agreeing.
"""


@dataclass(frozen=True)
class Claim:
    """What a model says: names at places, and whether something without a name acts beside."""

    names: frozenset[EffectName]
    unnamed: bool

    @property
    def ids(self) -> frozenset[str]:
        """Names of the claim, wherever they act."""
        return frozenset(name.id for name in self.names)


NOTHING = Claim(frozenset(), unnamed=False)


def _visible_sizes(posterior: Posterior) -> list[float]:
    """By how much an unremarkable size of each component changes readings, in their noise.

    Beside the base with its tolerances. Readings of legs show what they show, infinitely; so do
    those put right in another way, of which the rows are not known.
    """
    sizes = [math.inf] * len(posterior.components)
    if any((cells.means.leg != TOOL).any() for cells in posterior.sessions):
        return sizes
    rows = posterior.linear.rows
    about = About.of(rows.base * rows.spread, rows.residual, np.zeros(rows.base.shape[1]))
    remainder = about.left_by(posterior.linear.columns)
    for k, index in enumerate(posterior.linear.index):
        sizes[k] = float(np.linalg.norm(remainder[:, index], 2)) if len(index) else 0.0
    return sizes


WITHIN = 2.0
"""Tolerances, which are standard deviations: a parameter of geometry off by more is wrong."""


def _beyond_tolerance(posterior: Posterior, model: WeightedModel) -> list[int]:
    """The components of a model but for parameters of geometry within their tolerances.

    A machine whose drives lie as such drives do is as stated, whichever way a model has it.
    """
    tolerances = posterior.sessions[-1].with_free_lines.case.named_beyond
    beyond = []
    for k, places in model.places(posterior.components).items():
        shares = posterior.components[k].shares
        within = bool(shares) and all(
            abs(model.mean[places.start + value]) <= WITHIN * tolerances.get(share.effect, 0.0)
            for share in shares
            for value in share.values
        )
        beyond += [] if within else [k]
    return beyond


@dataclass(frozen=True)
class NamedVerdict:
    """A verdict with the places that it names, each with its rivals, the likeliest first."""

    verdict: Verdict
    rivals: Mapping[EffectName, tuple[EffectName, ...]]


@dataclass(frozen=True, eq=False)
class Claims:
    """Weights of claims, which sum to one, and what is known of places by their components.

    ``reach`` are the places that a component touches, and whether it has values of its own there.
    """

    weights: Mapping[Claim, float]
    reach: Mapping[EffectName, tuple[frozenset[str], bool]]

    @classmethod
    def of(cls, posterior: Posterior) -> Claims:
        """The claims of all models.

        One that readings of the tool cannot show tells nothing of whether anything is missing, so
        far as it is no likelier beside the model without any effect than it was before them.
        """
        components, shown_by = posterior.components, _visible_sizes(posterior)
        plain = math.fsum(m.weight for m in posterior.models if not m.members and not m.mistakes)
        weights: dict[Claim, float] = {NOTHING: 0.0}
        acting = posterior.sessions[-1].case.acting
        for model in posterior.models:
            shown = math.hypot(*(scale * shown_by[k] for k, scale in model.key))
            if not model.mistakes and shown < UNSEEN:
                odds = math.exp(log_prior_odds(model.key, components, acting))
                as_before = min(model.weight, odds * plain)
                weights[NOTHING] += as_before
                model = replace(model, weight=model.weight - as_before)
                if not model.weight:
                    continue
            members = [components[k] for k in _beyond_tolerance(posterior, model)]
            names = {name_of(member) for member in members if member.kind in NAMES}
            names |= {EffectName(mistake.id, mistake.where) for mistake in model.mistakes}
            claim = Claim(frozenset(names), any(m.kind not in NAMES for m in members))
            weights[claim] = weights.get(claim, 0.0) + model.weight
        reach: dict[EffectName, tuple[frozenset[str], bool]] = {}
        for component in components:
            candidate = component.candidate
            has_values = candidate is not None and candidate.arrangement in ("one", "each")
            reach[name_of(component)] = frozenset(s.place for s in component.shares), has_values
        return cls(weights, reach)

    def probability(self, holds: Callable[[Claim], bool]) -> float:
        """The probability that what is true is such a claim; rounding may sum to more than one."""
        return min(1.0, math.fsum(w for claim, w in self.weights.items() if holds(claim)))

    @cached_property
    def nothing(self) -> float:
        """The probability that the model without any effect is true."""
        return self.weights.get(NOTHING, 0.0)

    @cached_property
    def missing(self) -> float:
        """The probability that anything is missing."""
        return self.probability(lambda claim: claim != NOTHING)

    @cached_property
    def unnamed(self) -> float:
        """The probability that something without a name acts, alone or beside names."""
        return self.probability(lambda claim: claim.unnamed)

    @cached_property
    def named(self) -> float:
        """The probability that something is missing and names explain all of it."""
        return self.probability(lambda claim: bool(claim.names) and not claim.unnamed)

    @cached_property
    def places(self) -> dict[EffectName, float]:
        """Probability of each name at each place; the likeliest first."""
        return self._shares(lambda claim: claim.names)

    @cached_property
    def ids(self) -> dict[str, float]:
        """Probability of each name, wherever it acts; the likeliest first."""
        return self._shares(lambda claim: claim.ids)

    def _shares(self, parts: Callable[[Claim], Collection[Key]]) -> dict[Key, float]:
        """Probability of each part of claims; the likeliest first."""
        shares: dict[Key, float] = {}
        for claim, weight in self.weights.items():
            for part in parts(claim):
                shares[part] = min(1.0, shares.get(part, 0.0) + weight)
        return dict(descending(sorted(shares.items()), lambda item: item[1]))

    def one_in_other(self, first: EffectName, second: EffectName) -> bool:
        """Whether an effect at one place with values of its own contains it at the other."""
        if first == second:
            return True
        if first.id != second.id or not {first, second} <= self.reach.keys():
            return False
        (places, free), (places_of_second, second_free) = self.reach[first], self.reach[second]
        return (second_free and places <= places_of_second) or (free and places_of_second <= places)

    def holds(self, claim: Claim, name: EffectName) -> bool:
        """Whether a claim has this name, at this place or at one that contains it."""
        return any(self.one_in_other(name, name_of_claim) for name_of_claim in claim.names)

    def answer(self) -> NamedVerdict:
        """The verdict."""
        missing = self.missing
        if missing < MISSING:
            return NamedVerdict("agrees" if self.nothing >= AGREED else "cannot-tell", {})
        if self.named < (1.0 - SURE) * missing:
            head = tuple(name for name, p in self.places.items() if p >= SURE * missing)
            word: Verdict = "partly-explained" if head else "unexplained"
            return NamedVerdict(word, dict.fromkeys(head, ()))
        head = self._heaviest()
        rivals = {name: self._rivals_of(name, head) for name in head}
        with_all = self.probability(lambda claim: all(self.holds(claim, name) for name in head))
        alone = self.probability(
            lambda claim: (
                not claim.unnamed
                and all(self.holds(claim, name) for name in head)
                and all(any(self.one_in_other(n, name) for name in head) for n in claim.names)
            )
        )
        sure = with_all >= SURE * missing and alone >= EVEN * with_all and not any(rivals.values())
        return NamedVerdict("explained" if sure else "ambiguous", rivals)

    def _heaviest(self) -> tuple[EffectName, ...]:
        """The likeliest set of names that explains everything, at its likeliest places."""
        sets: dict[frozenset[str], dict[frozenset[EffectName], float]] = {}
        for claim, weight in self.weights.items():
            if claim.names and not claim.unnamed:
                sets.setdefault(claim.ids, {})[claim.names] = weight
        by_name = sorted(sets.values(), key=lambda places: min(map(sorted, places)))
        heaviest = descending(by_name, lambda places: math.fsum(places.values()))[0]
        names = descending(sorted(heaviest, key=sorted), heaviest.__getitem__)[0]
        return tuple(name for name in self.places if name in names)

    @cached_property
    def _folded(self) -> dict[Claim, float]:
        """Weights of claims that something is missing, without those that only add to a heavier.

        What is added and not needed counts for that claim.
        """
        claims = [claim for claim in self.weights if claim != NOTHING]
        claims.sort(key=lambda claim: (len(claim.names), claim.unnamed, sorted(claim.names)))
        folded: dict[Claim, float] = {}
        for claim in claims:
            within = [
                lighter
                for lighter in folded
                if lighter.names <= claim.names
                and lighter.unnamed <= claim.unnamed
                and self.weights[lighter] > self.weights[claim]
            ]
            onto = descending(within, self.weights.__getitem__)[0] if within else claim
            folded[onto] = folded.get(onto, 0.0) + self.weights[claim]
        return folded

    def _rivals_of(self, name: EffectName, head: Sequence[EffectName]) -> tuple[EffectName, ...]:
        """What claims without a name have in its place, the likeliest first; the rest is `OPEN`."""
        folded = self._folded
        lacking = [claim for claim in folded if not self.holds(claim, name)]
        open_weight = math.fsum(folded[claim] for claim in lacking)
        rivals: dict[EffectName, None] = {}
        for claim in descending(lacking, folded.__getitem__):
            if open_weight <= OPEN * self.missing:
                break
            open_weight -= folded[claim]
            rival_names = [
                rival
                for rival in claim.names
                if not any(self.one_in_other(other_name, rival) for other_name in head)
            ]
            if claim.unnamed and not rival_names:
                rival_names = [EffectName(EMPIRICAL, name.where)]
            rivals |= dict.fromkeys(sorted(rival_names))
        return tuple(rivals)


def conditional(posterior: Posterior, names: Collection[EffectName]) -> Posterior | None:
    """The posterior if these names are true, each at its place or at one that contains it.

    Laws without a name count as names here. None where no model has all of them.
    """
    claims = Claims.of(posterior)

    def has_all(members: Sequence[int]) -> bool:
        present = {name_of(posterior.components[k]) for k in members}
        return all(
            any(claims.one_in_other(name, name_of_model) for name_of_model in present)
            for name in names
        )

    models = [model for model in posterior.models if has_all(model.members)]
    if not models:
        return None
    total = math.fsum(model.weight for model in models)
    weighted = tuple(replace(model, weight=model.weight / total) for model in models)
    return replace(posterior, models=weighted)


def name_of(component: Component) -> EffectName:
    """Name and place of a component."""
    return EffectName(component.id, component.where)
