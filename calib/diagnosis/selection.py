"""Which effects: all sets of one, two and three candidates, weighed; a set of models, no winner.

The weight of a model is a Bayes factor against no effect with a prior width fitted to each model
(local empirical Bayes, Liang et al. 2008). Every model is judged by the same readings, so what it
leaves counts as well as what it explains. Every further cause pays for what it was chosen
from, whether it is a further effect or the same one elsewhere with another value.

Against chance, a score is the logarithm of the local p-value, so candidates of one and of six
parameters compete fairly. The global p-value counts how often the best score of pure noise is as
good, all candidates drawn jointly (look-elsewhere effect).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import chdtrc, fdtrc

from calib.arrays import (
    DEPENDENT,
    NEW_DIRECTION,
    FloatArray,
    IntArray,
    descending,
    squares_in,
    union,
)
from calib.diagnosis.policy import POLICY

PAIRS_AMONG = 24
TRIPLES_AMONG = 10
LEAST_LEFT = 1e-9  # of the whole: a fit without residuals would be infinitely likely
LEAST_LOG = -690.0
"""Smaller logarithms of weights and p-values are all alike: their numbers would be no floats."""

SEED = 20081
DRAWS = 1999  # p-values down to 1 in 2000, a tenth of `POLICY.naming_level`
GRID = 400
LOG_UNIT = 1e3
"""Log weights are differences of numbers so large, or more; see `calib.arrays`."""


@dataclass(frozen=True)
class WeighedModel:
    """A model: indices of its candidates, and what it explains."""

    members: tuple[int, ...]
    explained: float
    log_weight: float


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


def evidence(explained: float, rank: int, spread: Spread) -> float:
    """Evidence for a model of this rank; Liang et al. (2008), equation 5 and their fitted g.

    With S explained of T, f degrees of freedom and F = (S/r) / ((T - S)/(f - r)), 1 + g = F:
    log B = (f - r)/2 ln F - f/2 ln(1 + g (1 - S/T)); with a known noise (S - r)/2 - r/2 ln(S/r).
    """
    return float(evidences(np.array([explained]), np.array([rank]), spread)[0])


def evidences(explained: FloatArray, rank: IntArray, spread: Spread) -> FloatArray:
    """`evidence` of several models ``(k,)``."""
    size = np.maximum(rank, 1)
    if math.isinf(spread.freedom):
        more = (rank > 0) & (explained > rank)
        ratio = np.where(more, explained / size, 1.0)
        return np.asarray(np.where(more, 0.5 * (explained - rank - rank * np.log(ratio)), 0.0))
    rest, free = (
        np.maximum(spread.total - explained, LEAST_LEFT * spread.total),
        spread.freedom - rank,
    )
    more = (rank > 0) & (free > 0) & (explained * free > rank * rest)
    ratio = np.where(more, explained * free / (size * rest), 1.0)
    shrunk = 1.0 + (ratio - 1.0) * rest / spread.total
    return np.asarray(0.5 * (free * np.log(ratio) - spread.freedom * np.log(shrunk)))


@dataclass(frozen=True, eq=False)
class CandidateSearch:
    """Candidates as orthonormal blocks ``(n, r)`` and the vector ``(n,)`` they have to explain.

    With what each costs ``(J,)``.
    """

    y: FloatArray
    blocks: Sequence[FloatArray]
    spread: Spread
    log_priors: FloatArray

    def by_causes(self, causes: Sequence[int], most: int) -> Iterator[list[WeighedModel]]:
        """Models of one cause, of two, and so on; worked out only when they are asked for.

        ``causes`` tell how many things are wrong at once where each candidate is true. Pairs hold
        one of the most promising candidates, triples one of the best pairs.
        """
        known = list(self.singles)
        bases: list[tuple[int, ...]] = []
        for count in range(1, most + 1):
            if count == 2:
                bases = [(k,) for k in self._promising()]
            elif count == 3:
                pairs = [m for m in known if len(m.members) == 2]
                bases = [m.members for m in heaviest_first(pairs)[:TRIPLES_AMONG]]
            larger = {model.members: model for base in bases for model in self.larger(base)}
            known += [larger[members] for members in sorted(larger)]
            yield [m for m in known if sum(causes[k] for k in m.members) == count]

    def basis(self, members: Sequence[int]) -> FloatArray:
        """Orthonormal basis ``(n, r)`` of candidates together."""
        nothing = np.zeros((len(self.y), 0))
        return union([self.blocks[k] for k in members]) if members else nothing

    @cached_property
    def singles(self) -> list[WeighedModel]:
        """Every candidate alone."""
        return sorted(self.larger(()), key=lambda one: one.members)

    def weighed(self, members: tuple[int, ...]) -> WeighedModel:
        """These candidates together."""
        members = tuple(sorted(members))
        basis = self.basis(members)
        explained = squares_in(basis, self.y)
        weight = evidence(explained, basis.shape[1], self.spread)
        return WeighedModel(members, explained, weight - float(self.log_priors[[*members]].sum()))

    def larger(self, base: Sequence[int]) -> list[WeighedModel]:
        """These candidates with every other one, all at once."""
        known = self.basis(base)
        inside = known.T @ self.y
        found: dict[int, WeighedModel] = {}
        total, prior = float(inside @ inside), float(self.log_priors[list(base)].sum())
        for alike, stacked, along in self._stacks:
            shape = known.shape[1], *along.shape
            shared = (known.T @ stacked).reshape(shape).transpose(1, 0, 2)
            left = np.eye(along.shape[1]) - shared.transpose(0, 2, 1) @ shared
            size, axes = np.linalg.eigh(left)
            rest = (along - inside @ shared)[:, None]
            seen = size > NEW_DIRECTION**2
            squares = (rest @ axes)[:, 0] ** 2 / np.where(seen, size, 1.0)
            explained = total + np.where(seen, squares, 0.0).sum(axis=1)
            rank = known.shape[1] + seen.sum(axis=1)
            weight = evidences(explained, rank, self.spread) - (prior + self.log_priors[alike])
            each = zip(alike.tolist(), explained.tolist(), weight.tolist(), strict=True)
            for k, square, log_weight in each:
                if k not in base:
                    found[k] = WeighedModel(tuple(sorted((*base, k))), square, log_weight)
        return list(found.values())

    @cached_property
    def _stacks(self) -> list[tuple[IntArray, FloatArray, FloatArray]]:
        """Candidates of each rank: which, side by side, and what each takes up of the vector."""
        found = []
        ranks = np.array([block.shape[1] for block in self.blocks])
        for rank in np.unique(ranks):
            alike = np.flatnonzero(ranks == rank)
            side_by_side = np.hstack([self.blocks[k] for k in alike.tolist()])
            along = side_by_side.T @ self.y
            found.append((alike, side_by_side, along.reshape(len(alike), rank)))
        return found

    def _promising(self) -> list[int]:
        """Best alone, and best beside the best one."""
        alone = [m.members[0] for m in heaviest_first(self.singles)]
        beside = heaviest_first(self.larger(alone[:1]))[: PAIRS_AMONG // 2]
        others = [next(k for k in m.members if k != alone[0]) for m in beside]
        return list(dict.fromkeys(alone[:PAIRS_AMONG] + others))


def foremost(models: Sequence[WeighedModel]) -> WeighedModel:
    """The model of most weight; of those that are one and the same, that with fewest members."""
    return heaviest_first(sorted(models, key=lambda m: len(m.members)))[0]


def heaviest_first(models: Sequence[WeighedModel]) -> list[WeighedModel]:
    """Models by their weight; of those that are one and the same the earlier candidate first."""
    return descending(models, lambda m: m.log_weight, LOG_UNIT)


def credible_set(models: Sequence[WeighedModel]) -> list[WeighedModel]:
    """The smallest set of models that holds 95 % of the weight, best first."""
    ordered = heaviest_first(models)
    behind = np.array([m.log_weight - ordered[0].log_weight for m in ordered])
    weights = np.exp(np.maximum(behind, LEAST_LOG))
    together = np.cumsum(weights / weights.sum())
    return ordered[: int(np.count_nonzero(together < POLICY.credible_share)) + 1]


def contained(inner: FloatArray, outer: FloatArray) -> float:
    """Share of one block's directions that another can imitate: 1 is never to be told apart."""
    if not inner.shape[1]:
        return 1.0
    return squares_in(outer, inner) / int(inner.shape[1])


def scores(
    squares: FloatArray,
    ranks: Sequence[int],
    noise_df: float | None,
    structure_df: int,
    total: FloatArray,
) -> FloatArray:
    """Log p-values ``(J, draws)`` of explained squares ``(J, draws)`` for blocks of these ranks.

    Compared with the noise of repeats, of which ``noise_df`` are the degrees of freedom, infinite
    for a stated instrument, and the variance 1. None: compared with what a candidate leaves of
    ``structure_df`` degrees of freedom, ``total`` ``(draws,)`` being the square sum of everything.
    """
    found = np.empty_like(squares)
    for rank in sorted(set(ranks)):
        rows = np.equal(ranks, rank)
        ratio, rest = squares[rows] / rank, noise_df
        if rest is None:
            rest = float(max(structure_df - rank, 1))
            ratio = ratio / (np.maximum(total - squares[rows], 1e-300) / rest)
        found[rows] = _log_tail(ratio, rank, rest)
    return found


def _log_tail(ratio: FloatArray, rank: int, rest: float) -> FloatArray:
    """Log of the upper tail of the variance ratio, by interpolation in log ratio."""
    grid = np.geomspace(1e-6, 1e7, GRID)
    tail = chdtrc(rank, grid * rank) if math.isinf(rest) else fdtrc(rank, rest, grid)
    with np.errstate(divide="ignore"):
        logs = np.maximum(np.log(tail), LEAST_LOG)
    seen = logs > LEAST_LOG
    x = np.log(np.maximum(ratio, 1e-6))
    found = np.interp(x, np.log(grid[seen]), logs[seen])
    end = math.log(grid[seen][-1])
    # beyond the grid the tail falls as its leading term does
    slope = -0.5 * rank * np.exp(x) if math.isinf(rest) else -0.5 * rest * x
    at_end = -0.5 * rank * math.exp(end) if math.isinf(rest) else -0.5 * rest * end
    return np.where(x > end, logs[seen][-1] + slope - at_end, found)


def null_scores(
    blocks: Sequence[FloatArray],
    noise_df: float | None,
    structure_df: int,
    deviation: FloatArray,
) -> FloatArray:
    """Best scores of pure noise ``(draws,)`` for these orthonormal blocks ``(n, r)``.

    ``deviation`` ``(n,)`` is the standard deviation of the noise of each row. Readings are drawn,
    not what noise puts into the blocks: which axes these have is up to rounding.
    """
    generator = np.random.default_rng(SEED)
    together = deviation[:, None] * np.hstack(blocks)
    parts = together.T @ generator.normal(size=(len(together), DRAWS))
    widths = np.array([block.shape[1] for block in blocks])
    ranks = np.unique(widths).tolist()  # at one rank the largest has the best score
    owner = np.repeat(widths, widths)
    squares = np.array(
        [(parts[owner == r].reshape(-1, r, DRAWS) ** 2).sum(axis=1).max(axis=0) for r in ranks]
    )
    products = together.T @ together
    variance = np.linalg.eigvalsh(products)
    seen = variance > DEPENDENT * variance[-1]
    rest = max(structure_df - int(seen.sum()), 0)
    total = np.asarray(generator.chisquare(rest, DRAWS) if rest else np.zeros(DRAWS))
    if noise_df is None:
        variance, axes = np.linalg.eigh(products)
        draws = (axes[:, seen] / np.sqrt(variance[seen])).T @ parts
        total = total + (draws**2).sum(axis=0)
    elif math.isfinite(noise_df):
        squares = squares / (generator.chisquare(noise_df, DRAWS) / noise_df)
    return np.asarray(scores(squares, ranks, noise_df, structure_df, total).min(axis=0))


def global_p_value(score: float, null: FloatArray) -> float:
    """Chance of a best score at least this good, from those of pure noise ``(draws,)``."""
    return float((1 + np.count_nonzero(null <= score)) / (1 + len(null)))
