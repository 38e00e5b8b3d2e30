"""Which effects: all sets of one, two and three candidates, weighed; a set of models, no winner.

The weight of a model is a Bayes factor against no effect with a prior width fitted to each model
(local empirical Bayes, Liang et al. 2008): with explained squares S and rank r, in units of the
noise, ``log B = (S - r)/2 - (r/2) log(S/r)`` if S > r, else 0. Every further effect pays for the
number of candidates it was chosen from.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from calib.observations import FloatArray

SET_SHARE = 0.95
PAIRS_AMONG = 24
TRIPLES_AMONG = 10
RANK_TOLERANCE = 1e-3


@dataclass(frozen=True)
class Weighed:
    """A model: indices of its candidates, what it explains, its rank and posterior share."""

    members: tuple[int, ...]
    explained: float
    rank: int
    log_weight: float
    share: float = 0.0


def log_bayes_factor(explained: float, rank: int, noise_df: float) -> float:
    """Evidence for a model of this rank; Student's form where the noise is not known exactly."""
    if rank == 0 or explained <= rank:
        return 0.0
    if math.isinf(noise_df):
        return 0.5 * (explained - rank) - 0.5 * rank * math.log(explained / rank)
    total = noise_df + rank
    likelihood = 0.5 * total * math.log((noise_df + explained) / (noise_df + rank))
    return max(likelihood - 0.5 * rank * math.log(explained / rank), 0.0)


@dataclass(frozen=True, eq=False)
class Search:
    """Candidates as orthonormal blocks ``(n, r)`` and the vector ``(n,)`` they have to explain."""

    y: FloatArray
    blocks: tuple[FloatArray, ...]
    noise_df: float
    implausible: FloatArray
    """Log weight that each candidate loses for the size it would need ``(J,)``."""

    def singles(self) -> list[Weighed]:
        """Every candidate alone."""
        return [self.weigh((k,)) for k in range(len(self.blocks))]

    def pairs(self, singles: Sequence[Weighed]) -> list[Weighed]:
        """Every candidate beside each of the most promising ones."""
        first = self._promising(singles, PAIRS_AMONG)
        found = {tuple(sorted((i, j))) for i in first for j in range(len(self.blocks)) if i != j}
        return [self.weigh(members) for members in sorted(found)]

    def triples(self, pairs: Sequence[Weighed]) -> list[Weighed]:
        """Every candidate beside the best pairs."""
        best = sorted(pairs, key=lambda m: -m.log_weight)[:TRIPLES_AMONG]
        found = {
            tuple(sorted((*m.members, k)))
            for m in best
            for k in range(len(self.blocks))
            if k not in m.members
        }
        return [self.weigh(members) for members in sorted(found)]

    def _promising(self, singles: Sequence[Weighed], count: int) -> list[int]:
        """Best alone, and best beside the best one."""
        alone = sorted(singles, key=lambda m: -m.log_weight)
        lead = alone[0].members[0]
        beside = sorted(
            (self.weigh(tuple(sorted((lead, k)))) for k in range(len(self.blocks)) if k != lead),
            key=lambda m: -m.log_weight,
        )
        others = [next(k for k in m.members if k != lead) for m in beside[: count // 2]]
        return list(dict.fromkeys([m.members[0] for m in alone[:count]] + others))

    def weigh(self, members: tuple[int, ...]) -> Weighed:
        """One model of these candidates."""
        basis = union([self.blocks[k] for k in members])
        explained = float(((basis.T @ self.y) ** 2).sum())
        rank = basis.shape[1]
        price = len(members) * math.log(max(len(self.blocks), 2))
        price += float(self.implausible[list(members)].sum())
        weight = log_bayes_factor(explained, rank, self.noise_df) - price
        return Weighed(members, explained, rank, weight)


def union(blocks: Sequence[FloatArray]) -> FloatArray:
    """Orthonormal basis ``(n, r)`` of all blocks together."""
    basis = blocks[0]
    for block in blocks[1:]:
        rest = block - basis @ (basis.T @ block)
        left, singular, _ = np.linalg.svd(rest, full_matrices=False)
        basis = np.hstack([basis, left[:, singular > RANK_TOLERANCE]])
    return basis


def credible_set(models: Sequence[Weighed]) -> list[Weighed]:
    """The smallest set of models that holds 95 % of the weight, best first, with their shares."""
    ordered = sorted(models, key=lambda m: -m.log_weight)
    top = ordered[0].log_weight
    weights = [math.exp(max(m.log_weight - top, -700.0)) for m in ordered]
    total = sum(weights)
    kept, held = [], 0.0
    for model, weight in zip(ordered, weights, strict=True):
        share = weight / total
        kept.append(Weighed(model.members, model.explained, model.rank, model.log_weight, share))
        held += share
        if held >= SET_SHARE:
            break
    return kept


def contained(inner: FloatArray, outer: FloatArray) -> float:
    """Share of one block's directions that another can imitate: 1 is never to be told apart."""
    if not inner.shape[1]:
        return 1.0
    return float(((outer.T @ inner) ** 2).sum() / inner.shape[1])


def pairs_of(count: int) -> list[tuple[int, int]]:
    """All pairs of indices."""
    return list(combinations(range(count), 2))
