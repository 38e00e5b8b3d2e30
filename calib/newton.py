"""Many small nonlinear least squares problems at once: Newton steps, damped where needed.

The last axis ``b`` of every array counts the problems; there is no loop over them. Residuals are
whitened and freed of nuisance parameters by the caller.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.arrays import FloatArray

Evaluate = Callable[[FloatArray, NDArray[np.intp]], tuple[FloatArray, FloatArray]]
"""Values ``(k, b)`` and the numbers ``(b,)`` of their problems → residuals, ``(n, b)``, measured
minus model, and the derivatives of the model, ``(k, n, b)``."""

LEFT_MM = 1e-11
"""Steps end when what they would still add, judged by how fast they shrink, is less."""

MOST_STEPS = 60
ROUNDING = 1e-8
TINY = 1e-24
"""Sums of squares that differ by less (relative, absolute) are equal but for arithmetic."""

FIRST_DAMPING = 1e-3


@dataclass(frozen=True, eq=False)
class Optimum:
    """Best values ``(k, b)``, sums of squares ``(b,)``, and which problems converged ``(b,)``.

    ``residual`` ``(n, b)`` and ``jacobian`` ``(k, n, b)`` belong to the last point evaluated, less
    than a last Newton step away.
    """

    values: FloatArray
    square_sum: FloatArray
    converged: NDArray[np.bool_]
    residual: FloatArray
    jacobian: FloatArray


@dataclass
class _State:
    """The problems still moving."""

    problem: NDArray[np.intp]
    values: FloatArray
    residual: FloatArray
    jacobian: FloatArray
    square_sum: FloatArray
    damping: FloatArray
    last_step: FloatArray

    def keep(self, rows: NDArray[np.bool_]) -> None:
        for name, array in vars(self).items():
            setattr(self, name, array[..., rows])


def minimise(evaluate: Evaluate, start: FloatArray, curvature: FloatArray) -> Optimum:
    """Minimise the sums of squares from ``start`` ``(k, b)``.

    ``curvature`` ``(n, k, k)`` are second derivatives of the model near the solution. With them the
    steps are Newton's, which matters where residuals are large against weak directions; they need
    not be exact, the optimum does not depend on them. A step that makes things worse, or leaves
    what can be evaluated (NaN), is not taken; damping (Levenberg and Marquardt) shortens the next.
    """
    count = start.shape[1]
    numbers = np.arange(count)
    residual, jacobian = evaluate(start, numbers)
    far = np.full(count, np.inf)
    state = _State(numbers, start, residual, jacobian, _squares(residual), np.zeros(count), far)
    optimum = Optimum(
        start.copy(),
        state.square_sum.copy(),
        np.zeros(count, dtype=np.bool_),
        residual.copy(),
        jacobian.copy(),
    )
    for _ in range(MOST_STEPS):
        step = _step(state, curvature)
        small = _nothing_left(state, np.abs(step).max(axis=0))
        if small.any():
            rows = state.problem[small]
            optimum.values[:, rows] = state.values[:, small] + step[:, small]
            optimum.square_sum[rows] = state.square_sum[small]
            optimum.residual[:, rows] = state.residual[:, small]
            optimum.jacobian[:, :, rows] = state.jacobian[:, :, small]
            optimum.converged[rows] = True
            state.keep(~small)
            step = step[:, ~small]
        if not len(state.problem):
            break
        _advance(evaluate, state, step)
    return optimum


def _nothing_left(state: _State, size: FloatArray) -> NDArray[np.bool_]:
    """Whether a full step of this size ``(b,)`` is the last one worth taking."""
    shrink = np.where(np.isinf(state.last_step), 1.0, np.minimum(size / state.last_step, 1.0))
    state.last_step = size
    return np.asarray((state.damping == 0.0) & (size * shrink <= LEFT_MM))


def _advance(evaluate: Evaluate, state: _State, step: FloatArray) -> None:
    """Take the steps that improve; damp the others."""
    trial = state.values + step
    residual, jacobian = evaluate(trial, state.problem)
    square_sum = _squares(residual)
    better = square_sum <= state.square_sum * (1.0 + ROUNDING) + TINY
    if better.all():
        state.values, state.residual, state.jacobian = trial, residual, jacobian
        state.square_sum = square_sum
    else:
        for name, fresh in (("values", trial), ("residual", residual), ("jacobian", jacobian)):
            getattr(state, name)[..., better] = fresh[..., better]
        state.square_sum = np.where(better, square_sum, state.square_sum)
    if state.damping.any() or not better.all():
        eased = np.where(state.damping > FIRST_DAMPING, state.damping / 10.0, 0.0)
        raised = np.maximum(state.damping * 10.0, FIRST_DAMPING)
        state.damping = np.where(better, eased, raised)


def _step(state: _State, curvature: FloatArray) -> FloatArray:
    """Newton's step ``(k, b)``; Gauss and Newton's where the full matrix is not positive."""
    normal, gradient = normal_equations(state.residual, state.jacobian)
    damped = normal
    if state.damping.any():
        damped, index = normal.copy(), np.arange(len(normal))
        damped[index, index] *= 1.0 + state.damping
    bend = np.tensordot(curvature, state.residual, axes=(0, 0))
    step, positive = solve_positive(damped - bend, gradient)
    if not positive.all():
        plain = solve_positive(damped, gradient)[0]
        step = np.where(positive, step, plain)
    return step


def normal_equations(residual: FloatArray, jacobian: FloatArray) -> tuple[FloatArray, FloatArray]:
    """``J^T J`` ``(k, k, b)`` and ``J^T r`` ``(k, b)``."""
    if jacobian.shape[2] == 1:
        rows = jacobian[:, :, 0]
        return (rows @ rows.T)[:, :, None], rows @ residual
    return (
        np.einsum("inb,jnb->ijb", jacobian, jacobian),
        np.einsum("inb,nb->ib", jacobian, residual),
    )


def solve_positive(matrix: FloatArray, right: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Solutions ``(k, b)`` for symmetric ``(k, k, b)``, and where the matrix is positive ``(b,)``.

    Cholesky's method, written over the last axis; what is not positive gives numbers without
    meaning, never an error.
    """
    if matrix.shape[2] == 1:
        return _solve_one(matrix[:, :, 0], right)
    size = len(matrix)
    lower = np.empty_like(matrix)
    forward = np.empty_like(right)
    positive = np.ones(right.shape[1], dtype=np.bool_)
    for j in range(size):
        row = lower[j, :j]
        pivot = matrix[j, j] - (row * row).sum(axis=0)
        positive &= pivot > 0.0
        root = np.sqrt(np.abs(pivot) + (pivot == 0.0))
        lower[j, j] = root
        forward[j] = (right[j] - (row * forward[:j]).sum(axis=0)) / root
        for i in range(j + 1, size):
            lower[i, j] = (matrix[i, j] - (lower[i, :j] * row).sum(axis=0)) / root
    solution = np.empty_like(right)
    for j in range(size - 1, -1, -1):
        below = (lower[j + 1 :, j] * solution[j + 1 :]).sum(axis=0)
        solution[j] = (forward[j] - below) / lower[j, j]
    return solution, positive


def _solve_one(matrix: FloatArray, right: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    try:
        lower = np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        solution = np.linalg.lstsq(matrix, right, rcond=None)[0]
        return np.asarray(solution, dtype=np.float64), np.zeros(1, dtype=np.bool_)
    solution = np.linalg.solve(lower.T, np.linalg.solve(lower, right))
    return np.asarray(solution, dtype=np.float64), np.ones(1, dtype=np.bool_)


def _squares(residual: FloatArray) -> FloatArray:
    """Sums of squares ``(b,)``; infinite where something could not be evaluated."""
    total = (residual * residual).sum(axis=0)
    return np.where(np.isfinite(total), total, np.inf)
