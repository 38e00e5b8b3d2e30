"""Scores of candidates, and the chance that the best of all of them is chance.

``score`` is the logarithm of the local p-value, so candidates of one and of six parameters compete
fairly. The global p-value counts how often the best score of pure noise is as good, all candidates
drawn jointly (look-elsewhere effect); (1 + count) / (1 + draws).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, fdtrc

from calib.linalg import DEPENDENT
from calib.observations import FloatArray

DRAWS = 1999
GRID = 400
LEAST_LOG = -690.0
"""Logarithms of p-values end here; smaller ones are all alike."""


@dataclass(frozen=True)
class Reference:
    """What a score is compared with: the noise of repeats, or what the cells leave.

    ``noise_df`` are its degrees of freedom, infinite for a stated instrument. With ``by_cells`` the
    noise is judged from what a candidate leaves of ``structure_df`` degrees of freedom.
    """

    noise_df: float
    structure_df: int
    by_cells: bool = False


def scores(
    squares: FloatArray, ranks: Sequence[int], reference: Reference, total: FloatArray
) -> FloatArray:
    """Log p-values ``(J, draws)`` of explained squares ``(J, draws)`` for blocks of these ranks.

    ``total`` ``(draws,)`` is the square sum of everything, for a reference by cells; for one by
    noise the squares are already divided by its variance.
    """
    found = np.empty_like(squares)
    for rank in sorted(set(ranks)):
        rows = [k for k, r in enumerate(ranks) if r == rank]
        if reference.by_cells:
            rest = max(reference.structure_df - rank, 1)
            ratio = (squares[rows] / rank) / (np.maximum(total - squares[rows], 1e-300) / rest)
            found[rows] = _log_tail(ratio, rank, float(rest))
        else:
            found[rows] = _log_tail(squares[rows] / rank, rank, reference.noise_df)
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
    beyond = x > math.log(grid[seen][-1])
    slope = -0.5 * rank * np.exp(x) if math.isinf(rest) else -0.5 * rest * x
    end = math.log(grid[seen][-1])
    at_end = -0.5 * rank * math.exp(end) if math.isinf(rest) else -0.5 * rest * end
    return np.where(beyond, logs[seen][-1] + slope - at_end, found)


@dataclass(frozen=True, eq=False)
class Null:
    """Best scores of pure noise, for one set of candidates."""

    best: FloatArray

    def p_value(self, score: float) -> float:
        """Chance of a best score at least this good."""
        return float((1 + np.count_nonzero(self.best <= score)) / (1 + len(self.best)))


def null_scores(
    blocks: Sequence[FloatArray], reference: Reference, seed: int, deviation: FloatArray
) -> Null:
    """Draw the best score of pure noise for these orthonormal blocks ``(n, r)``.

    ``deviation`` ``(n,)`` is the standard deviation of the noise of each row. Readings are drawn,
    not what noise puts into the blocks: which axes these have is up to rounding.
    """
    generator = np.random.default_rng(seed)
    together = deviation[:, None] * np.hstack(blocks)
    variance, axes = np.linalg.eigh(together.T @ together)
    seen = variance > DEPENDENT * variance[-1]
    parts = together.T @ generator.normal(size=(len(together), DRAWS))
    draws = (axes[:, seen] / np.sqrt(variance[seen])).T @ parts
    ranks, squares = _largest(parts, [block.shape[1] for block in blocks])
    rest = max(reference.structure_df - len(draws), 0)
    total = (draws**2).sum(axis=0) + (generator.chisquare(rest, DRAWS) if rest else 0.0)
    if not reference.by_cells and math.isfinite(reference.noise_df):
        squares = squares / (generator.chisquare(reference.noise_df, DRAWS) / reference.noise_df)
    return Null(scores(squares, ranks, reference, total).min(axis=0))


def _largest(parts: FloatArray, widths: Sequence[int]) -> tuple[list[int], FloatArray]:
    """Ranks, and the largest square sum among the blocks of each ``(ranks, draws)``.

    At one rank the largest has the best score.
    """
    starts = np.cumsum([0, *widths[:-1]])
    squares = np.add.reduceat(parts**2, starts, axis=0)
    ranks = sorted(set(widths))
    return ranks, np.array([squares[np.equal(widths, r)].max(axis=0) for r in ranks])


def gap_p_value(gap: float, df: int, noise_df: float) -> float:
    """Chance of a gap at least this large from noise alone; 1 where nothing is free."""
    if df <= 0 or noise_df <= 0.0:
        return 1.0
    if math.isinf(noise_df):
        return float(chdtrc(df, gap))
    return float(fdtrc(df, noise_df, gap / df))
