"""What may be called by name: rivals, look-alikes, evidence, and the verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.diagnosis.hypotheses import Hypothesis
from calib.diagnosis.model_selection import LEVEL, MOST_EFFECTS, ModelSelection, Outcome
from calib.diagnosis.problem import Problem
from calib.diagnosis.results import Named, Verdict
from calib.diagnosis.selection import ALIKE, WeighedModel, contained, log_bayes_factor
from calib.linalg import NEW_DIRECTION, incidence, rank_of, squares_in, union
from calib.observations import FloatArray, numbered
from calib.ties import descending

LEAST_EVIDENCE = 25.0
"""No single name below this non-centrality (explained squares less their freedom)."""

LEAST_FREEDOM = 10
SEEN = NEW_DIRECTION**2
"""A reading that the fit follows anyway tells nothing."""

ROOM = 4
"""Degrees of freedom that the whole catalogue must leave, or an unknown effect could not show."""

MOST_NAMES = 2
"""More different names at once are not claimed."""

FAR_TOGETHER = 10.0
"""Log weight that members may lose for sizes that only each other's sizes call for."""

CANNOT_TELL = 9.0
"""Noise variances that a rival must leave more than the name kept. Two that are apart by D change
places by this much, D being normal with variance 4 D, at most once in 700 times."""


@dataclass(frozen=True, eq=False)
class Attribution:
    """Names for what the race kept."""

    problem: Problem
    entries: Sequence[Hypothesis]
    race: ModelSelection
    outcome: Outcome

    def verdict(self, blunders_found: bool) -> Verdict:
        """One of the six words."""
        kept = self.outcome.kept
        if kept is None:
            return self._verdict_without_names(blunders_found)
        if self.problem.noise_df <= 0.0 or self.problem.structure_df < LEAST_FREEDOM:
            return "cannot-tell"
        if not self.outcome.adequate:
            return "partly-explained"
        return "ambiguous" if any(self.names(kept).values()) or self.doubt else "explained"

    @cached_property
    def doubt(self) -> str:
        """Why what was kept is not claimed though no other name fits; empty where it is."""
        kept = self.outcome.kept
        if kept is None:
            return ""
        effects = [k for k in kept.members if self.entries[k].kind != "blunder"]
        alone = (self.without_any_one(kept, k) for k in effects)
        reasons = (
            (self._is_weak(kept), "the evidence is weak"),
            (min(alone, default=np.inf) < LEAST_EVIDENCE, "the evidence hangs on a single reading"),
            (not self._room(), "these postures leave no room to see something unknown"),
            (self._is_series(kept), "so many terms together fit nearly any shape"),
            (
                self.race.far_together(kept.members) > FAR_TOGETHER,
                "no workshop has such sizes, which cancel each other",
            ),
        )
        return next((words for holds, words in reasons if holds), "")

    def _is_weak(self, kept: WeighedModel) -> bool:
        return any(self.evidence(kept, k) < LEAST_EVIDENCE for k in kept.members)

    def _verdict_without_names(self, blunders_found: bool) -> Verdict:
        if self.problem.structure_df <= 0 or self.problem.noise_df <= 0.0:
            return "cannot-tell"
        closed = self.outcome.gap_before[2] > LEVEL
        if blunders_found:
            return "explained" if closed else "partly-explained"
        return "agrees" if closed else "unexplained"

    def evidence(self, kept: WeighedModel, member: int) -> float:
        """Non-centrality of one member beside the others."""
        others = tuple(k for k in kept.members if k != member)
        blocks, y = self.race.beside(others)
        block = blocks[member]
        return squares_in(block, y) - float(block.shape[1])

    def without_any_one(self, kept: WeighedModel, member: int) -> float:
        """The least evidence that remains for one member when any one reading is left out."""
        others = tuple(k for k in kept.members if k != member)
        blocks, y = self.race.beside(others)
        block = blocks[member]
        known = [self.problem.nuisance, *(self.race.blocks[k] for k in others)]
        free = 1.0 - (union(known) ** 2).sum(axis=1)
        rows = np.flatnonzero(free > SEEN)
        own = block[rows] / np.sqrt(free[rows])[:, None]
        rest = block.T @ y - own * (y[rows] / np.sqrt(free[rows]))[:, None]
        lost = np.maximum(1.0 - (own**2).sum(axis=1), SEEN)
        left = (rest**2).sum(axis=1) + (own * rest).sum(axis=1) ** 2 / lost
        return float(left.min(initial=np.inf)) - float(block.shape[1])

    def _room(self) -> bool:
        """Whether the catalogue leaves room for an effect that is not in it to show."""
        inside = [
            self.problem.structure.T @ b
            for e, b in zip(self.entries, self.race.blocks, strict=True)
            if e.kind != "blunder"
        ]
        if not inside:
            return self.problem.structure_df >= ROOM
        rank = rank_of(np.hstack(inside), NEW_DIRECTION, 1.0)
        return self.problem.structure_df - rank >= ROOM

    def _is_series(self, kept: WeighedModel) -> bool:
        """Whether the members look like the terms of a series, which fits any shape.

        One screw has one lead, and of all triples of the catalogue some fit nearly everything.
        """
        named = [(self.entries[k].id, self.entries[k].where) for k in kept.members]
        names = {name for name, _ in named}
        causes = sum(self.entries[k].causes for k in kept.members)
        many = len(names) > MOST_NAMES or (len(names) > 1 and causes > MOST_EFFECTS)
        return many or len(set(named)) < len(named)

    def names(self, kept: WeighedModel) -> dict[int, tuple[Named, ...]]:
        """For each member of the best model the other names that fit as well in its place."""
        return {member: self.rivals(kept, member) for member in kept.members}

    def rivals(self, kept: WeighedModel, member: int) -> tuple[Named, ...]:
        """Names that fit as well in its place: from the 95 % set, and look-alikes."""
        own = self.entries[member]
        found: dict[Named, None] = {}
        for model in self.outcome.models:
            if member in model.members or not self._as_simple(model, kept, member):
                continue
            for k in (k for k in model.members if k not in kept.members):
                if not self._same_on_other_places(member, k):
                    found[Named(self.entries[k].id, self.entries[k].where)] = None
        for k in self._look_alikes(kept, member):
            found[Named(self.entries[k].id, self.entries[k].where)] = None
        found.pop(Named(own.id, own.where), None)
        return tuple(found)

    def _as_simple(self, model: WeighedModel, kept: WeighedModel, member: int) -> bool:
        """Whether a model has as many causes; or no more, instead of a name with several."""
        own, other = (sum(self.entries[k].causes for k in m.members) for m in (kept, model))
        return other == own or (other < own and self.entries[member].causes > 1)

    def _same_on_other_places(self, member: int, other: int) -> bool:
        """The same effect on more or fewer of the same places is no rival of itself."""
        if self.entries[member].id != self.entries[other].id:
            return False
        first, second = self.race.blocks[member], self.race.blocks[other]
        nested = max(contained(first, second), contained(second, first)) > ALIKE
        return nested or self.entries[member].where == self.entries[other].where

    def _look_alikes(self, kept: WeighedModel, member: int) -> list[int]:
        """Candidates of no higher rank that fit these readings as well, likely or not.

        Two indicators that err are two causes, and still what they do may be what one bar does.
        """
        own = self.race.blocks[member]
        return [
            k
            for k, block in enumerate(self.race.blocks)
            if k not in kept.members
            and block.shape[1] <= own.shape[1]
            and self._lost(kept, member, k) < CANNOT_TELL
            and not self._same_on_other_places(member, k)
        ]

    def _lost(self, kept: WeighedModel, member: int, other: int) -> float:
        """Noise variances that are left more with another candidate in its place."""
        members = tuple(other if k == member else k for k in kept.members)
        explained = squares_in(self.race.basis(members), self.problem.y)
        return 2.0 * self.problem.spread.log_ratio(kept.explained, explained)

    def by_evidence(self, kept: WeighedModel) -> tuple[int, ...]:
        """Members of the model, the strongest first."""
        return tuple(descending(kept.members, lambda k: self.evidence(kept, k)))


DOUBT = (
    "repeats read without driving away would explain as much as any name: drive away before each, "
    "or take the gap for real and measure more"
)


def repeats_explain_as_much(naming: Attribution) -> bool:
    """Whether the names are weak and postures that vary by themselves do no worse."""
    kept = naming.outcome.kept
    if kept is None or not naming.problem.has_repeats() or not naming.problem.noise_df > 0.0:
        return False
    weak = kept.log_weight < 0.5 * LEAST_EVIDENCE  # as log likelihood
    return weak and evidence_of_postures(naming.problem) > max(kept.log_weight, 0.0)


def evidence_of_postures(problem: Problem) -> float:
    """Log Bayes factor for an error of each posture's own against none."""
    block = problem.block(_postures(problem))
    explained = squares_in(block, problem.y)
    return log_bayes_factor(explained, block.shape[1], problem.spread)


def _postures(problem: Problem) -> FloatArray:
    """One column for each posture and approach of each mounting."""
    return incidence(numbered(problem.mount, problem.conditions("cell")))
