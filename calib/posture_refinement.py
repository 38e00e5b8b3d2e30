"""Postures moved in their box until the criterion is best. Knows no machine."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from calib.criteria import Aim, Criterion, value_of, values_of
from calib.errors import CalibrationError
from calib.observations import FloatArray

RowsAndSlopes = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""From coordinates ``(p, d)`` to rows ``(p, r, k)`` and their derivatives ``(p, r, k, d)``."""

ON_BOUND = 1e-6
"""Share of the box's width within which a coordinate stands on its bound."""

MOST_STEPS = 300

LEAST_SINGULAR = 1e-13
"""Relative singular value below which rows are blind but for rounding."""

REGULAR = 1e-13
"""Relative information that keeps a search regular on its way through blind sets."""


@dataclass(frozen=True, eq=False)
class Refined:
    """Coordinates ``(p, d)`` with the value before and after; never worse than before.

    ``on_bound`` counts the coordinates that stand on a bound of the box.
    """

    coordinates: FloatArray
    value: float
    start_value: float
    on_bound: int


def refine(
    rows_at: RowsAndSlopes,
    start: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    aim: Aim | None = None,
    *,
    fixed: FloatArray | None = None,
    sharpness: Sequence[float] = (),
) -> Refined:
    """Improve postures ``(p, d)`` inside the box ``(d,)`` to ``(d,)`` by L-BFGS-B.

    ``rows_at`` is a smooth map of the machine; ``fixed`` ``(k, k)`` as for the exchange.
    ``sharpness`` are powers, rising, with which the condition number is made smooth in stages:
    where it depends on the largest singular value alone, a search without them gets stuck. Raises
    CalibrationError for a start outside the box, NotIdentifiable where the start does not see all
    wanted parameters.
    """
    from scipy.optimize import minimize  # 0.1 s to import: only where used

    aim, width = aim or Aim(), upper - lower
    if not (width > 0.0).all() or not ((lower <= start) & (start <= upper)).all():
        raise CalibrationError(
            "postures to refine", "a coordinate outside its box", "bounds with lower < upper"
        )

    def unfolded(unit: FloatArray) -> FloatArray:
        return np.asarray(np.clip(lower + unit.reshape(start.shape) * width, lower, upper))

    def cost(unit: FloatArray, power: float) -> tuple[float, FloatArray]:
        rows, slopes = rows_at(unfolded(unit))
        if _plain(aim, fixed):
            value, pulled = _cost_by_singular_values(rows, aim, power)
        else:
            information = _information(rows, fixed)
            value, by_information = cost_and_slope(information, aim, power)
            pulled = rows @ by_information
        gradient = 2.0 * np.einsum("prk,prkd->pd", pulled, slopes) * width
        return value, gradient.ravel()

    unit = ((start - lower) / width).ravel()
    stages = [*sharpness, math.inf] if aim.criterion is Criterion.CONDITION else [math.inf]
    for power in stages:
        found = minimize(
            cost,
            unit,
            args=(power,),
            jac=True,
            method="L-BFGS-B",
            bounds=[(0.0, 1.0)] * start.size,
            options={"maxiter": MOST_STEPS, "ftol": 1e-13, "gtol": 1e-9},
        )
        unit = np.asarray(found.x)
    before = _judged(rows_at(start)[0], aim, fixed)
    moved = unfolded(unit)
    after = _judged(rows_at(moved)[0], aim, fixed)
    if (after <= before) if aim.criterion.larger_is_better else (after >= before):
        moved, after = start, before
    share = (moved - lower) / width
    on_bound = int(((share < ON_BOUND) | (share > 1.0 - ON_BOUND)).sum())
    return Refined(moved, after, before, on_bound)


def _plain(aim: Aim, fixed: FloatArray | None) -> bool:
    """Whether the rows alone decide, so that their squares need not be formed."""
    return fixed is None and aim.wanted is None and aim.criterion is not Criterion.TOOL_VARIANCE


def _judged(rows: FloatArray, aim: Aim, fixed: FloatArray | None) -> float:
    """The criterion; from singular values where it can be, which keeps twice the digits."""
    if not _plain(aim, fixed):
        return value_of(_information(rows, fixed), aim)
    flat = rows.reshape(-1, rows.shape[-1])
    size = np.linalg.norm(flat, axis=0)
    scaled = np.linalg.svd(flat / np.where(size > 0.0, size, 1.0), compute_uv=False)
    if len(flat) < flat.shape[1] or scaled[-1] <= LEAST_SINGULAR * scaled[0]:
        return value_of(_information(rows, fixed), aim)
    singular = np.linalg.svd(flat, compute_uv=False)
    return float(values_of(np.diag(singular**-2)[None], aim)[0])


def _cost_by_singular_values(rows: FloatArray, aim: Aim, power: float) -> tuple[float, FloatArray]:
    """As `cost_and_slope`, with the rows ``(p, r, k)`` already multiplied by the slope."""
    flat = rows.reshape(-1, rows.shape[-1])
    missing = max(flat.shape[1] - len(flat), 0)
    padded = np.vstack([flat, np.zeros((missing, flat.shape[1]))])
    left, singular, turned = np.linalg.svd(padded, full_matrices=False)
    singular = np.maximum(singular, LEAST_SINGULAR * max(float(singular[0]), 1e-150))
    value, by_log = _log_cost(singular**-2, turned.T, aim)
    if power < math.inf:
        value, by_log = _smooth_condition(-2.0 * np.log(singular), power)
    pulled = -(left[: len(flat)] * (by_log / singular)) @ turned
    return value, np.asarray(pulled.reshape(rows.shape))


def _information(rows: FloatArray, fixed: FloatArray | None) -> FloatArray:
    flat = rows.reshape(-1, rows.shape[-1])
    own = flat.T @ flat
    return np.asarray(own if fixed is None else own + fixed)


def cost_and_slope(
    information: FloatArray, aim: Aim, power: float = math.inf
) -> tuple[float, FloatArray]:
    """Logarithm of the criterion, smaller is better, and its derivative ``(k, k)``.

    ``d cost = tr(slope · d information)``. At equal singular values the derivative of one of them
    is taken; L-BFGS-B lives with that. A finite ``power`` smooths the condition number.
    """
    count = len(information)
    keep, drop = aim.columns(count), aim.nuisance(count)
    largest = max(float(information.diagonal().max()), 1e-300)
    regular = information + REGULAR * largest * np.eye(count)
    lift = _lift(regular, keep, drop)
    left = lift.T @ regular @ lift
    variance, turned = np.linalg.eigh(np.linalg.inv(left))
    value, by_log = _log_cost(variance, turned, aim)
    if power < math.inf:
        value, by_log = _smooth_condition(np.log(variance), power)
    # d log(eigenvalue of the inverse) = -eigenvalue · vᵀ d(information) v
    slope = -(turned * (by_log * variance)) @ turned.T
    if aim.criterion is Criterion.TOOL_VARIANCE and aim.metric is not None:
        covariance = (turned * variance) @ turned.T
        total = float(np.trace(aim.metric @ covariance))
        slope = -covariance @ aim.metric @ covariance / total
    return value, np.asarray(lift @ slope @ lift.T)


def _smooth_condition(logs: FloatArray, power: float) -> tuple[float, FloatArray]:
    """``log(|σ|_p |1/σ|_p)`` in place of ``log(σ_1 / σ_L)``, and its derivatives ``(k,)``."""
    value, by_log = 0.0, np.zeros(len(logs))
    for sign in (0.5, -0.5):
        scaled = sign * power * logs
        parts = np.exp(scaled - scaled.max())
        value += (float(scaled.max()) + math.log(float(parts.sum()))) / power
        by_log += sign * parts / parts.sum()
    return value, by_log


def _lift(information: FloatArray, keep: list[int], drop: list[int]) -> FloatArray:
    """``(k, k_wanted)``: the wanted parameters with the best nuisance for each."""
    lift = np.zeros((len(information), len(keep)))
    lift[keep, np.arange(len(keep))] = 1.0
    if drop:
        inverse = np.linalg.pinv(information[np.ix_(drop, drop)], rcond=1e-12, hermitian=True)
        lift[drop] = -inverse @ information[np.ix_(drop, keep)]
    return lift


def _log_cost(variance: FloatArray, turned: FloatArray, aim: Aim) -> tuple[float, FloatArray]:
    """Cost and its derivatives ``(k,)`` by the logarithms of the eigenvalues, ascending."""
    logs, by_log = np.log(variance), np.zeros(len(variance))
    kind = aim.criterion
    if kind is Criterion.DETERMINANT:
        by_log[:] = 0.5 / len(variance)
    elif kind is Criterion.AVERAGE_VARIANCE:
        total = float(variance.sum())
        return math.log(total / len(variance)), variance / total
    elif kind is Criterion.TOOL_VARIANCE and aim.metric is not None:
        tool = (turned * (aim.metric @ turned)).sum(axis=0) * variance
        return math.log(float(tool.sum())), by_log
    else:
        by_log[-1] = 1.0 if kind is Criterion.NOISE_AMPLIFICATION else 0.5
        if kind is not Criterion.SMALLEST_SINGULAR_VALUE:
            by_log[0] = -0.5
    return float(by_log @ logs), by_log
