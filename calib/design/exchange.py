"""Which measurements to make: exchange over a pool of candidates. Knows no machine.

Fedorov's exchange (1972): from a random set, swap the pair of one chosen and one other candidate
that helps most, until no swap helps; from several seeded starts the best is kept. For the
determinant every pair is judged at once by the swap formula; for the other criteria each chosen
candidate in turn is swapped for the best other one (Cook and Nachtsheim 1980), with the
covariances of all swaps from one small batched solution.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.arrays import FloatArray, IntArray, descending, largest
from calib.clusters import in_parallel
from calib.design.criteria import (
    RIDGE,
    Aim,
    Criterion,
    covariances_after,
    inverse,
    scores,
    value_of,
    value_or_none,
    values_of,
)
from calib.errors import CalibrationError

LEAST_GAIN = 1e-9
"""Relative improvement below which a swap is rounding."""

MOST_EXCHANGES = 1000


@dataclass(frozen=True, eq=False)
class Candidates:
    """What may be measured: ``rows`` ``(n, r, k)``, derivatives divided by the noise.

    The ``r`` rows of a candidate are measured together.
    """

    rows: FloatArray

    def __post_init__(self) -> None:
        if self.rows.ndim != 3 or not self.rows.size or not np.isfinite(self.rows).all():
            raise CalibrationError(
                "rows of the candidates",
                f"shape {self.rows.shape}",
                "finite numbers of shape (candidates, rows of each, parameters)",
            )

    def information(self, subset: IntArray) -> FloatArray:
        """Information ``(k, k)`` of these candidates."""
        rows = self.rows[subset].reshape(-1, self.rows.shape[2])
        return np.asarray(rows.T @ rows)

    def ridge(self) -> FloatArray:
        """Information ``(k,)`` too small to matter, that keeps matrices regular."""
        best = (self.rows**2).sum(axis=1).max(axis=0)
        return RIDGE * np.where(best > 0.0, best, 1.0)


@dataclass(frozen=True)
class ChosenCandidates:
    """The chosen candidates, ascending, and how they were found.

    ``start_value`` and ``start_condition_number`` belong to the start of the best run and are None
    where it did not even see all parameters.
    ``exchanges`` counts the swaps of that run.
    """

    chosen: tuple[int, ...]
    value: float
    start_value: float | None
    start_condition_number: float | None
    exchanges: int


def choose(
    candidates: Candidates,
    count: int,
    aim: Aim | None = None,
    *,
    seed: int = 0,
    starts: int = 8,
    repeats: bool = False,
    begin_with: Sequence[IntArray] = (),
) -> ChosenCandidates:
    """The best ``count`` candidates that exchange finds; each at most once without ``repeats``.

    ``begin_with`` are starts of the caller's own, tried before the random ones; criteria other than
    the determinant start from its choice, too. Equal arguments give equal results on
    one processor; on another, other criteria than the determinant may end at another set. Raises
    CalibrationError for impossible counts and NotIdentifiable where no set of this size sees all
    wanted parameters.
    """
    aim = aim or Aim()
    size = len(candidates.rows)
    if starts < 1 or count < 1 or (count > size and not repeats):
        raise CalibrationError(
            "choice of measurements",
            f"{count} of {size} candidates in {starts} starts",
            "at least one start, and no more measurements than candidates unless repeated",
        )
    search = _Exchanges(candidates, aim, repeats=repeats)
    runs = []
    subsets = [
        generator.choice(size, count, replace=repeats)
        for generator in np.random.default_rng(seed).spawn(starts)
    ]
    if aim.criterion is not Criterion.DETERMINANT:
        # among sets that do not see everything only the determinant knows the way
        leading = _Exchanges(
            candidates, replace(aim, criterion=Criterion.DETERMINANT), repeats=repeats
        )
        subsets.append(leading.improve(subsets[0])[0])
    begins = (*begin_with, *subsets)
    improved = in_parallel(search.improve, begins)
    for start, (subset, exchanges) in zip(begins, improved, strict=True):
        # sets that see next to nothing can have the best of condition numbers
        sees = value_or_none(candidates.information(subset), aim) is not None
        runs.append((sees, search.score(subset), subset, start, exchanges))
    seeing = [run for run in runs if run[0]] or runs
    _, _, subset, start, exchanges = descending(seeing, lambda run: run[1], 1.0)[0]
    return ChosenCandidates(
        chosen=tuple(sorted(int(k) for k in subset)),
        # sorted, for sums in another order round otherwise: equal sets give equal figures
        value=value_of(candidates.information(np.sort(subset)), aim),
        start_value=value_or_none(candidates.information(start), aim),
        start_condition_number=value_or_none(
            candidates.information(start), replace(aim, criterion=Criterion.CONDITION)
        ),
        exchanges=exchanges,
    )


def swap_ratios(rows: FloatArray, subset: IntArray, covariance: FloatArray) -> FloatArray:
    """Factor ``(n, m)`` on the determinant of the information for every swap.

    Entry ``(j, i)``: candidate ``j`` of ``rows`` ``(n, r, k)`` comes in for the chosen candidate
    ``subset[i]``; ``covariance`` ``(k, k)`` is the inverse of the information before. Fedorov's
    ``(1 + d_j)(1 - d_i) + d_ij²``, for several rows the determinant lemma.
    """
    n, r, k = rows.shape
    moved = rows @ covariance
    if r == 1:
        flat, moved = rows[:, 0], moved[:, 0]
        moved_row = np.einsum("nk,nk->n", moved, flat)
        cross = moved @ flat[subset].T
        cross *= cross
        cross += np.multiply.outer(1.0 + moved_row, 1.0 - moved_row[subset])
        return np.asarray(cross)
    moved_row = moved @ np.swapaxes(rows, 1, 2)
    grown = np.eye(r) + moved_row
    mixed = (moved.reshape(n * r, k) @ rows[subset].reshape(-1, k).T).reshape(n, r, -1)
    result = np.linalg.solve(grown, mixed).reshape(n, r, -1, r)
    inner = np.einsum("nams,namt->nmst", mixed.reshape(n, r, -1, r), result)
    inner += np.eye(r) - moved_row[subset]
    return np.asarray(np.linalg.det(grown)[:, None] * np.linalg.det(inner))


class _Exchanges:
    """Exchange from any start; remembers nothing between starts."""

    def __init__(self, candidates: Candidates, aim: Aim, *, repeats: bool) -> None:
        count = candidates.rows.shape[2]
        self.candidates = candidates
        self.aim = aim
        self.repeats = repeats
        self.keep, self.drop = aim.parts(count)
        self.ridge = np.diag(candidates.ridge())
        self.nuisance_rows = np.ascontiguousarray(candidates.rows[:, :, self.drop])

    def improve(self, start: IntArray) -> tuple[IntArray, int]:
        """The set after all swaps that help, and their number."""
        if self.aim.criterion is Criterion.DETERMINANT:
            return self._best_pairs(start.copy())
        return self._one_after_the_other(start.copy())

    def score(self, subset: IntArray) -> float:
        """Logarithm of the criterion, larger is better; ridge included."""
        covariance = inverse(self._information(subset))[np.ix_(self.keep, self.keep)]
        return float(scores(values_of(covariance[None], self.aim), self.aim.criterion)[0])

    def _information(self, subset: IntArray) -> FloatArray:
        return np.asarray(self.candidates.information(subset) + self.ridge)

    def _best_pairs(self, subset: IntArray) -> tuple[IntArray, int]:
        for exchanges in range(MOST_EXCHANGES):
            gain = self._determinant_gains(subset)
            if not self.repeats:
                gain[subset] = -math.inf
            incoming, place = divmod(largest(gain), len(subset))
            if not gain[incoming, place] > 1.0 + LEAST_GAIN:
                return subset, exchanges
            subset[place] = incoming
        return subset, MOST_EXCHANGES

    def _determinant_gains(self, subset: IntArray) -> FloatArray:
        """Factor ``(n, m)`` on the determinant of the Schur complement."""
        information = self._information(subset)
        ratios = swap_ratios(self.candidates.rows, subset, inverse(information))
        if not self.drop:
            return ratios
        corner = inverse(information[np.ix_(self.drop, self.drop)])
        part = swap_ratios(self.nuisance_rows, subset, corner)
        # rounding can turn a vanishing determinant negative; such a swap is never wanted
        return np.where(part > RIDGE**2, ratios / np.where(part > RIDGE**2, part, 1.0), -math.inf)

    def _one_after_the_other(self, subset: IntArray) -> tuple[IntArray, int]:
        exchanges = unhelpful = place = 0
        score = self.score(subset)
        while unhelpful < len(subset) and exchanges < MOST_EXCHANGES:
            scores = self._scores_without(subset, place)
            incoming = largest(scores, 1.0)
            changed = subset.copy()
            changed[place] = incoming
            new_score = self.score(changed) if scores[incoming] > score + LEAST_GAIN else score
            if new_score > score + LEAST_GAIN:
                subset, score = changed, new_score
                exchanges, unhelpful = exchanges + 1, 0
            else:
                unhelpful += 1
            place = (place + 1) % len(subset)
        return subset, exchanges

    def _scores_without(self, subset: IntArray, place: int) -> FloatArray:
        """Score ``(n,)`` with each candidate in this place."""
        rows = self.candidates.rows
        covariance = inverse(self._information(subset))
        out = np.broadcast_to(rows[subset[place]], rows.shape)
        signs = np.repeat([1.0, -1.0], rows.shape[1])
        covariances = covariances_after(covariance, np.hstack([rows, out]), signs, self.keep)
        scored = scores(values_of(covariances, self.aim), self.aim.criterion)
        if not self.repeats:
            scored[subset] = -math.inf
        scored[subset[place]] = -math.inf
        return scored
