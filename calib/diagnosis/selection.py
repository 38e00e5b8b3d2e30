"""Which effects: all sets of one, two and three candidates, weighed; a set of models, no winner.

The weight of a model is a Bayes factor against no effect with a prior width fitted to each model
(local empirical Bayes, Liang et al. 2008). Every model is judged by the same readings, so what it
leaves counts as well as what it explains. Every further cause pays for what it was chosen
from, whether it is a further effect or the same one elsewhere with another value.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from calib.linalg import NEW_DIRECTION, squares_in, union
from calib.observations import FloatArray
from calib.ties import descending

SET_SHARE = 0.95
PAIRS_AMONG = 24
TRIPLES_AMONG = 10
LEAST_LEFT = 1e-9
ALIKE = 0.98
LOG_UNIT = 1e3
"""Log weights are differences of numbers so large, or more; see `calib.ties`."""


@dataclass(frozen=True)
class WeighedModel:
    """A model: indices of its candidates, what it explains, its rank and posterior share."""

    members: tuple[int, ...]
    explained: float
    rank: int
    log_weight: float
    share: float = 0.0


@dataclass(frozen=True)
class Spread:
    """Squares that tell the variance of the noise: scatter of repeats and the whole gap.

    ``total`` is in units of the noise that repeats show, ``freedom`` its degrees of freedom; both
    are infinite where the noise is known.
    """

    total: float
    freedom: float

    def left(self, explained: float) -> float:
        """What remains when so much is explained, never nothing."""
        return max(self.total - explained, LEAST_LEFT * self.total)

    def log_ratio(self, more: float, less: float) -> float:
        """Log likelihood by which a model that explains ``more`` is better than one of ``less``."""
        if math.isinf(self.freedom):
            return 0.5 * (more - less)
        return 0.5 * self.freedom * math.log(self.left(less) / self.left(more))


KNOWN = Spread(math.inf, math.inf)


def log_bayes_factor(explained: float, rank: int, spread: Spread) -> float:
    """Evidence for a model of this rank; Liang et al. (2008), equation 5 and their fitted g.

    With S explained of T, f degrees of freedom and F = (S/r) / ((T - S)/(f - r)), 1 + g = F:
    log B = (f - r)/2 ln F - f/2 ln(1 + g (1 - S/T)); with a known noise (S - r)/2 - r/2 ln(S/r).
    """
    if math.isinf(spread.freedom):
        if rank == 0 or explained <= rank:
            return 0.0
        return 0.5 * (explained - rank) - 0.5 * rank * math.log(explained / rank)
    rest, free = spread.left(explained), spread.freedom - rank
    if rank == 0 or free <= 0 or explained * free <= rank * rest:
        return 0.0
    ratio = explained * free / (rank * rest)
    shrunk = 1.0 + (ratio - 1.0) * rest / spread.total
    return 0.5 * free * math.log(ratio) - 0.5 * spread.freedom * math.log(shrunk)


@dataclass(frozen=True, eq=False)
class Search:
    """Candidates as orthonormal blocks ``(n, r)`` and the vector ``(n,)`` they have to explain."""

    y: FloatArray
    blocks: tuple[FloatArray, ...]
    spread: Spread
    log_priors: FloatArray
    """What each candidate costs, see `calib.diagnosis.hypotheses.log_priors` ``(J,)``."""

    causes: tuple[int, ...]
    """How many things are wrong at once where a candidate is true."""

    def by_causes(self, singles: Sequence[WeighedModel], most: int) -> Iterator[list[WeighedModel]]:
        """Models of one cause, of two, and so on; worked out only when they are asked for."""
        yield [m for m in singles if self.count(m) == 1]
        known = list(singles)
        for count in range(2, most + 1):
            known += self.pairs(singles) if count == 2 else self.triples(known)
            yield [m for m in known if self.count(m) == count]

    def count(self, model: WeighedModel) -> int:
        """Causes of all members together."""
        return sum(self.causes[k] for k in model.members)

    def singles(self) -> list[WeighedModel]:
        """Every candidate alone."""
        return [self.weigh((k,)) for k in range(len(self.blocks))]

    def pairs(self, singles: Sequence[WeighedModel]) -> list[WeighedModel]:
        """Every candidate beside each of the most promising ones."""
        first = self._promising(singles, PAIRS_AMONG)
        return self._all_beside([(k,) for k in first])

    def triples(self, pairs: Sequence[WeighedModel]) -> list[WeighedModel]:
        """Every candidate beside the best pairs."""
        two = [m for m in pairs if len(m.members) == 2]
        best = heaviest_first(two)[:TRIPLES_AMONG]
        return self._all_beside([m.members for m in best])

    def _all_beside(self, bases: Sequence[tuple[int, ...]]) -> list[WeighedModel]:
        """Every candidate beside each of these, every model once."""
        found = {model.members: model for base in bases for model in self.beside(base)}
        return [found[members] for members in sorted(found)]

    def beside(self, base: tuple[int, ...]) -> list[WeighedModel]:
        """Every other candidate beside these ones: what `weigh` gives, all at once."""
        known = union([self.blocks[k] for k in base]) if base else self.y[:, None][:, :0]
        inside = known.T @ self.y
        found = []
        others = [k for k in range(len(self.blocks)) if k not in base]
        for width in sorted({self.blocks[k].shape[1] for k in others}):
            alike = [k for k in others if self.blocks[k].shape[1] == width]
            explained, rank = self._added(alike, known, inside)
            for k, more, directions in zip(alike, explained, rank, strict=True):
                total = float(inside @ inside) + float(more)
                found.append(self._weighed((*base, k), total, known.shape[1] + int(directions)))
        return found

    def _added(
        self, alike: Sequence[int], known: FloatArray, inside: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Squares and directions ``(k,)`` that blocks of one width add to a basis ``(n, r)``."""
        stacked = np.stack([self.blocks[k] for k in alike])
        shared = known.T @ stacked
        left = np.eye(stacked.shape[2]) - shared.transpose(0, 2, 1) @ shared
        size, axes = np.linalg.eigh(left)
        along = (stacked.transpose(0, 2, 1) @ self.y - shared.transpose(0, 2, 1) @ inside)[:, None]
        seen = size > NEW_DIRECTION**2
        squares = (along @ axes)[:, 0] ** 2 / np.where(seen, size, 1.0)
        return np.where(seen, squares, 0.0).sum(axis=1), seen.sum(axis=1)

    def _promising(self, singles: Sequence[WeighedModel], count: int) -> list[int]:
        """Best alone, and best beside the best one."""
        alone = heaviest_first(singles)
        lead = alone[0].members[0]
        beside = heaviest_first(self.beside((lead,)))
        others = [next(k for k in m.members if k != lead) for m in beside[: count // 2]]
        return list(dict.fromkeys([m.members[0] for m in alone[:count]] + others))

    def weigh(self, members: tuple[int, ...]) -> WeighedModel:
        """One model of these candidates."""
        basis = union([self.blocks[k] for k in members])
        return self._weighed(members, squares_in(basis, self.y), basis.shape[1])

    def _weighed(self, members: tuple[int, ...], explained: float, rank: int) -> WeighedModel:
        members = tuple(sorted(members))
        log_prior = float(self.log_priors[list(members)].sum())
        weight = log_bayes_factor(explained, rank, self.spread) - log_prior
        return WeighedModel(members, explained, rank, weight)


def foremost(models: Sequence[WeighedModel]) -> WeighedModel:
    """The model of most weight; of those that are one and the same, that with fewest members."""
    return heaviest_first(sorted(models, key=lambda m: len(m.members)))[0]


def heaviest_first(models: Sequence[WeighedModel]) -> list[WeighedModel]:
    """Models by their weight; of those that are one and the same the earlier candidate first."""
    return descending(models, lambda m: m.log_weight, LOG_UNIT)


def credible_set(models: Sequence[WeighedModel]) -> list[WeighedModel]:
    """The smallest set of models that holds 95 % of the weight, best first, with their shares."""
    ordered = heaviest_first(models)
    top = ordered[0].log_weight
    weights = [math.exp(max(m.log_weight - top, -700.0)) for m in ordered]
    total = sum(weights)
    kept, held = [], 0.0
    for model, weight in zip(ordered, weights, strict=True):
        share = weight / total
        kept.append(
            WeighedModel(model.members, model.explained, model.rank, model.log_weight, share)
        )
        held += share
        if held >= SET_SHARE:
            break
    return kept


def contained(inner: FloatArray, outer: FloatArray) -> float:
    """Share of one block's directions that another can imitate: 1 is never to be told apart."""
    if not inner.shape[1]:
        return 1.0
    return squares_in(outer, inner) / int(inner.shape[1])
