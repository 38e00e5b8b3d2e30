"""What may be called by name: rivals, look-alikes, evidence, and the verdict."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.arrays import NEW_DIRECTION, descending, squares_in
from calib.diagnosis.hypotheses import LENGTHS, causes_of, is_known
from calib.diagnosis.model_selection import ModelSelection, Outcome
from calib.diagnosis.policy import POLICY
from calib.diagnosis.problem import Problem
from calib.diagnosis.results import Named, Verdict
from calib.diagnosis.selection import contained, heaviest_first
from calib.tripod.effects.candidates import Candidate
from calib.tripod.effects.effect import Kind

LEAST_OPEN = NEW_DIRECTION**2
"""A reading that the fit follows anyway tells nothing."""

MOST_NAMES = 2
"""More different names at once are not claimed."""


@dataclass(frozen=True, eq=False)
class Attribution:
    """Names for the members of the model that was kept."""

    selection: ModelSelection
    outcome: Outcome

    @property
    def problem(self) -> Problem:
        """What was diagnosed."""
        return self.selection.problem

    @property
    def candidates(self) -> Sequence[Candidate]:
        """All that might have been kept."""
        return self.selection.candidates

    def without_nameless(self) -> Attribution:
        """A power of travel that was kept is no name.

        The best of the set that has names only takes its place; else what it explains is left.
        """
        nameless = {k for k, one in enumerate(self.candidates) if one.kind == Kind.EMPIRICAL}
        kept = self.outcome.kept
        if kept is None or nameless.isdisjoint(kept.members):
            return self
        named = [one for one in self.outcome.models if nameless.isdisjoint(one.members)]
        if named:
            kept = heaviest_first(named)[0]
        else:
            members = tuple(k for k in kept.members if k not in nameless)
            explained = squares_in(self.selection.search.basis(members), self.problem.y)
            kept = replace(kept, members=members, explained=explained) if members else None
        adequate = self.selection.leaves_no_gap(kept.members if kept else ())
        return replace(self, outcome=replace(self.outcome, kept=kept, adequate=adequate))

    def verdict(self, *, mistakes_found: bool) -> Verdict:
        """One of the six words."""
        problem, outcome = self.problem, self.outcome
        least = POLICY.least_freedom if outcome.kept else POLICY.room
        if problem.structure_df < least or problem.noise_df <= 0.0:
            return "cannot-tell"
        if outcome.kept:
            if not outcome.adequate:
                return "partly-explained"
            return "ambiguous" if any(self.rivals.values()) or self.doubt else "explained"
        closed = self.selection.leaves_no_gap(())
        if mistakes_found:
            return "explained" if closed else "partly-explained"
        return "agrees" if closed else "unexplained"

    @cached_property
    def doubt(self) -> str:
        """Why what was kept is not claimed though no other name fits; empty where it is."""
        return next(self._doubts(), "") if self.outcome.members else ""

    def _doubts(self) -> Iterator[str]:
        kept, members = self.outcome.kept, self.outcome.members
        effects = [k for k in members if is_known(self.candidates[k])]
        if any(self.evidence(k) < POLICY.decisive for k in members):
            yield "the evidence is weak"
        if any(self.without_any_one(k) < POLICY.decisive for k in effects):
            yield "the evidence depends on a single reading"
        own = self.selection.own_errors("level")
        if kept and effects and kept.log_weight < own + POLICY.beyond:
            yield "an unknown error at each posture would explain nearly as much"
        if len(members) > 1 and any(self.candidates[k].id == LENGTHS for k in members):
            yield "it contradicts the tolerance of the bars: measure their lengths"
        if self._is_series():
            yield "so many terms together fit nearly any shape"
        if self.selection.far_together(members) > POLICY.beyond:
            yield "such sizes are not plausible and cancel each other"

    def evidence(self, member: int) -> float:
        """Non-centrality of one member given the others."""
        (block,), y = self.selection.beside(self._others(member), [member])
        return squares_in(block, y) - float(block.shape[1])

    def _others(self, member: int) -> tuple[int, ...]:
        return tuple(k for k in self.outcome.members if k != member)

    def without_any_one(self, member: int) -> float:
        """The least evidence that remains for one member when any one reading is left out."""
        others = self._others(member)
        (block,), y = self.selection.beside(others, [member])
        whitening = self.problem.whitening
        known = whitening.held_back(self.selection.search.basis(others))
        free = whitening.seen_alone - (known**2).sum(axis=1)
        rows = np.flatnonzero(free > LEAST_OPEN)
        own = whitening.held_back(block)[rows] / np.sqrt(free[rows])[:, None]
        off = whitening.held_back(y)[rows] / np.sqrt(free[rows])
        rest = block.T @ y - own * off[:, None]
        open_share = np.maximum(1.0 - (own**2).sum(axis=1), LEAST_OPEN)
        remains = (rest**2).sum(axis=1) + (own * rest).sum(axis=1) ** 2 / open_share
        return float(remains.min(initial=np.inf)) - float(block.shape[1])

    def _is_series(self) -> bool:
        """Whether the members look like the terms of a series, which fits any shape.

        One screw has one lead, and of all triples of the catalogue some fit nearly everything.
        """
        members = [self.candidates[k] for k in self.outcome.members]
        named = [(one.id, one.where) for one in members]
        names = {name for name, _ in named}
        causes = sum(map(causes_of, members))
        many = len(names) > MOST_NAMES or (len(names) > 1 and causes > POLICY.most_causes)
        return many or len(set(named)) < len(named)

    def named(self, k: int) -> Named:
        """Name and place of a candidate."""
        return Named(self.candidates[k].id, self.candidates[k].where)

    @cached_property
    def rivals(self) -> dict[int, tuple[Named, ...]]:
        """For each member the names that fit as well in its place."""
        return {member: self._rivals_of(member) for member in self.outcome.members}

    def _rivals_of(self, member: int) -> tuple[Named, ...]:
        """From the 95 % set, and look-alikes."""
        members = self.outcome.members
        own, several = self._causes(members), causes_of(self.candidates[member]) > 1
        found = []
        for model in self.outcome.models:
            causes = self._causes(model.members)
            as_simple = causes == own or (causes < own and several)
            if member not in model.members and as_simple:
                others = (k for k in model.members if k not in members)
                found += [k for k in others if not self._same_on_other_places(member, k)]
        found += self._look_alikes(member)
        names = dict.fromkeys(self.named(k) for k in found)
        names.pop(self.named(member), None)
        return tuple(names)

    def _causes(self, members: Sequence[int]) -> int:
        return sum(causes_of(self.candidates[k]) for k in members)

    def _same_on_other_places(self, member: int, other: int) -> bool:
        """The same effect on more or fewer of the same places is no rival of itself."""
        first, second = self.candidates[member], self.candidates[other]
        if first.id != second.id:
            return False
        one, two = self.selection.blocks[member], self.selection.blocks[other]
        nested = max(contained(one, two), contained(two, one)) > POLICY.alike
        return nested or first.where == second.where

    def _look_alikes(self, member: int) -> list[int]:
        """Candidates of no higher rank that fit these readings as well, likely or not.

        Two indicators that err are two causes, and still what they do may be what one bar does.
        """
        kept, blocks, others = self.outcome.kept, self.selection.blocks, self._others(member)
        assert kept is not None
        found = []
        for model in self.selection.search.larger(others):
            (k,) = set(model.members) - set(others)
            left_more = 2.0 * self.problem.spread.log_ratio(kept.explained, model.explained)
            narrow = k != member and blocks[k].shape[1] <= blocks[member].shape[1]
            if narrow and left_more < POLICY.told_apart:
                found.append(k)
        return [k for k in sorted(found) if not self._same_on_other_places(member, k)]

    def by_evidence(self) -> tuple[int, ...]:
        """Members of the model, the strongest first."""
        return tuple(descending(self.outcome.members, self.evidence))
