"""What simpler methods say about the same sessions: best R², stepwise BIC, STLSQ, LARS lasso.

Each sees the table, the bench's own machine and all candidates, and names ids.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tests.blind.effects import Candidate, candidates
from tests.blind.forward import FloatArray, Hidden, Rows, readings
from tests.blind.signatures import BASE, Columns

ROUNDS = 4
MOST_NAMES = 4
THRESHOLD = 3.0  # of the noise, in normalised columns
BASELINES = ("best R²", "stepwise BIC", "STLSQ", "LassoLarsIC")


class Problem:
    """Residual and candidate columns after the base machine is fitted to the table."""

    def __init__(self, rows: Rows, values_mm: FloatArray) -> None:
        columns = _fitted(rows, values_mm)
        reading_mm = readings(rows, columns.hidden)
        self.residual = columns.left_over(values_mm - reading_mm)
        self.candidates: Sequence[Candidate] = candidates()
        self.spans = [columns.span(c) for c in self.candidates]
        self.fixed = columns.base.shape[1]
        self.noise_mm = _pure_error(rows, values_mm)
        self.ids, self.columns = self._single_columns(columns)

    def _single_columns(self, columns: Columns) -> tuple[list[str], FloatArray]:
        """Every candidate of one place, column by column, normalised."""
        ids, basis = [], []
        for candidate in self.candidates:
            if candidate.where == "all" and candidate.id not in ("gravity_sag", "thermal_drift"):
                continue
            for column in columns.left_over(columns.raw(candidate)).T:
                size = float(np.linalg.norm(column))
                if size > 1e-9:
                    ids.append(candidate.id)
                    basis.append(column / size)
        return ids, np.column_stack(basis)


def _fitted(rows: Rows, values_mm: FloatArray) -> Columns:
    """Base parameters by Gauss and Newton."""
    hidden = Hidden()
    for _ in range(ROUNDS):
        columns = Columns(rows, hidden)
        misfit = values_mm - readings(rows, hidden)
        change = np.linalg.lstsq(columns.base, misfit, rcond=None)[0]
        hidden = hidden.plus([(e, float(c)) for e, c in zip(BASE, change, strict=False)])
    return Columns(rows, hidden)


def _pure_error(rows: Rows, values_mm: FloatArray) -> float:
    """Scatter of repeats of one posture and mounting."""
    keys = np.column_stack([rows.mount, rows.displacement_mm])
    _, cell = np.unique(keys, axis=0, return_inverse=True)
    cell = cell.ravel()
    means = np.bincount(cell, values_mm) / np.bincount(cell)
    freedom = max(1, len(rows) - len(means))
    return float(np.sqrt(np.sum((values_mm - means[cell]) ** 2) / freedom))


def named_by_all(rows: Rows, values_mm: FloatArray) -> dict[str, list[str]]:
    """Ids that each baseline names."""
    problem = Problem(rows, values_mm)
    answers = (best_r2(problem), stepwise_bic(problem), stlsq(problem), lasso_bic(problem))
    return {name: sorted(ids) for name, ids in zip(BASELINES, answers, strict=True)}


def best_r2(problem: Problem) -> set[str]:
    """The candidate that explains most; it always names."""
    gains = [float(np.sum((span.T @ problem.residual) ** 2)) for span in problem.spans]
    return {problem.candidates[int(np.argmax(gains))].id}


def stepwise_bic(problem: Problem) -> set[str]:
    """Candidates added one at a time as long as BIC falls."""
    subset: list[int] = []
    least = _bic(problem, subset)
    while len(subset) < MOST_NAMES:
        scores = {k: _bic(problem, [*subset, k]) for k in range(len(problem.spans))}
        best = min(scores, key=scores.__getitem__)
        if scores[best] >= least - 1e-9:
            break
        subset, least = [*subset, best], scores[best]
    return {problem.candidates[k].id for k in subset}


def _bic(problem: Problem, subset: list[int]) -> float:
    n = len(problem.residual)
    squares, used = float(np.sum(problem.residual**2)), 0
    if subset:
        design = np.column_stack([problem.spans[k] for k in subset])
        answer, _, rank, _ = np.linalg.lstsq(design, problem.residual, rcond=1e-6)
        squares, used = float(np.sum((problem.residual - design @ answer) ** 2)), int(rank)
    return float(n * np.log(squares / n) + np.log(n) * (problem.fixed + used))


def stlsq(problem: Problem) -> set[str]:
    """Sequentially thresholded least squares on normalised columns."""
    alive = np.arange(len(problem.ids))
    for _ in range(20):
        design = problem.columns[:, alive]
        answer = np.linalg.lstsq(design, problem.residual, rcond=1e-6)[0]
        large = alive[np.abs(answer) > THRESHOLD * problem.noise_mm]
        if len(large) == len(alive) or not len(large):
            alive = large
            break
        alive = large
    return {problem.ids[k] for k in alive}


def lasso_bic(problem: Problem) -> set[str]:
    """The point of the lasso path with the least BIC, at the noise of the repeats."""
    n = len(problem.residual)
    best, ids = np.inf, set[str]()
    for weights in lars_path(problem.columns, problem.residual):
        squares = float(np.sum((problem.residual - problem.columns @ weights) ** 2))
        active = np.flatnonzero(weights)
        score = squares / problem.noise_mm**2 + np.log(n) * len(active)
        if score < best:
            best, ids = score, {problem.ids[k] for k in active}
    return ids


def lars_path(columns: FloatArray, values: FloatArray, most_steps: int = 30) -> list[FloatArray]:
    """Knots of the lasso path by least angle regression with drops; columns of unit length."""
    weights = np.zeros(columns.shape[1])
    path, active = [weights.copy()], [int(np.argmax(np.abs(columns.T @ values)))]
    for _ in range(most_steps):
        pull = columns.T @ (values - columns @ weights)
        level = float(np.abs(pull[active]).max())
        signs = np.sign(pull[active])
        inner = columns[:, active]
        gram = inner.T @ inner
        if level < 1e-12 or np.linalg.cond(gram) > 1e8:
            break
        direction = np.linalg.solve(gram, signs)
        step, joins = _until_join(pull, columns.T @ (inner @ direction), level, active)
        crossing = np.where(direction * weights[active] < 0, -weights[active] / direction, np.inf)
        first = int(np.argmin(crossing))
        drop = crossing[first] < step
        weights[active] += min(step, float(crossing[first])) * direction
        if drop:
            weights[active.pop(first)] = 0.0
        path.append(weights.copy())
        if not drop:
            if joins is None:
                break
            active.append(joins)
    return path


def _until_join(
    pull: FloatArray, change: FloatArray, level: float, active: list[int]
) -> tuple[float, int | None]:
    """How far to go until another column pulls as much, and which; ``level`` is the whole way."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ways = np.stack([(level - pull) / (1 - change), (level + pull) / (1 + change)])
    ways = np.where(np.isfinite(ways) & (ways > 1e-12), ways, np.inf)
    ways[:, active] = np.inf
    smallest = ways.min(axis=0)
    nearest = int(np.argmin(smallest))
    return (float(smallest[nearest]), nearest) if smallest[nearest] < level else (level, None)
