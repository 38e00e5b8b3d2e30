"""Postures moved in their box until the criterion is best. Knows no machine."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from calib.arrays import ROUNDING, FloatArray, svd_of_all
from calib.design.criteria import Aim, Criterion, nuisance_fitted, value_of, values_of
from calib.errors import CalibrationError

Pull = Callable[[FloatArray], FloatArray]
"""From a number's derivatives by the rows ``(p, r, k)`` to those by coordinates ``(p, d)``."""

RowsAndPull = Callable[[FloatArray], tuple[FloatArray, Pull]]
"""From coordinates ``(p, d)`` to rows ``(p, r, k)`` and how derivatives are pulled back."""

ON_BOUND = 1e-6
"""Share of the box's width within which a coordinate stands on its bound."""

MOST_STEPS = 300

OF_ENDS = (
    Criterion.CONDITION,
    Criterion.SMALLEST_SINGULAR_VALUE,
    Criterion.NOISE_AMPLIFICATION,
)
"""Criteria of the largest and the smallest singular value alone."""

WALL = 30.0
"""Logarithm of a criterion that nothing reaches: of what cannot be. Larger ones shorten the next
step so much that the search stops.
"""

FAINT = 1e-9
"""Relative eigenvalue of the information above which it has digits enough; it is quicker to take
apart than the rows.
"""


@dataclass(frozen=True, eq=False)
class RefinedPostures:
    """Coordinates ``(p, d)`` with the value before and after; never worse than before.

    ``on_bound`` counts the coordinates that are on a bound of the box.
    """

    coordinates: FloatArray
    value: float
    start_value: float
    on_bound: int


def refine(
    rows_at: RowsAndPull,
    start: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    aim: Aim | None = None,
    *,
    sharpness: Sequence[float] = (),
    penalty: Callable[[FloatArray], tuple[float, FloatArray]] | None = None,
    progress: Callable[[int, int], object] = lambda _count, _parts: None,
) -> RefinedPostures:
    """Improve postures ``(p, d)`` inside the box ``(d,)`` to ``(d,)`` by L-BFGS-B.

    ``rows_at`` is a smooth map of the machine.
    ``sharpness`` are powers, rising, with which criteria of single singular values are made smooth
    in stages: where it depends on the largest singular value alone, a search without them gets
    stuck. ``penalty`` is added to the logarithm of the criterion, with its derivatives by the
    coordinates. Where ``rows_at`` refuses coordinates on the way, the search turns back. Stages are
    reported to ``progress``. Raises CalibrationError for a start outside the box,
    NotIdentifiable where the start does not see all wanted parameters.
    """
    from scipy.optimize import minimize  # 0.1 s to import: only where used

    aim, width = aim or Aim(), upper - lower
    if not (width > 0.0).all() or not ((lower <= start) & (start <= upper)).all():
        raise CalibrationError(
            "postures to refine", "a coordinate outside its box", "bounds with lower < upper"
        )
    judged_start = judged(rows_at(start)[0], aim)

    def unfolded(unit: FloatArray) -> FloatArray:
        return np.asarray(np.clip(lower + unit.reshape(start.shape) * width, lower, upper))

    def cost(unit: FloatArray, power: float) -> tuple[float, FloatArray]:
        coordinates = unfolded(unit)
        try:
            rows, pull = rows_at(coordinates)
            extra_cost, slopes = (0.0, 0.0) if penalty is None else penalty(coordinates)
        except CalibrationError:
            return WALL, np.zeros(unit.size)
        value, by_rows = cost_by_rows(rows, aim, power)
        return value + extra_cost, ((pull(by_rows) + slopes) * width).ravel()

    unit = ((start - lower) / width).ravel()
    powers = sharpness if sharpness and aim.criterion in OF_ENDS else [math.inf]
    for stage, power in enumerate(powers, start=1):
        unit = minimize(
            cost,
            unit,
            args=(power,),
            jac=True,
            method="L-BFGS-B",
            bounds=[(0.0, 1.0)] * len(unit),
            options={"maxiter": MOST_STEPS, "ftol": 1e-13, "gtol": 1e-9},
        ).x
        progress(stage, len(powers))
    moved = unfolded(unit)
    judged_here = judged(rows_at(moved)[0], aim)
    if not aim.criterion.better(judged_here, judged_start):
        moved, judged_here = start, judged_start
    return RefinedPostures(moved, judged_here, judged_start, count_on_bound(moved, lower, upper))


def count_on_bound(coordinates: FloatArray, lower: FloatArray, upper: FloatArray) -> int:
    """How many of the coordinates ``(p, d)`` are on a bound of the box."""
    share = (coordinates - lower) / (upper - lower)
    return int(((share < ON_BOUND) | (share > 1.0 - ON_BOUND)).sum())


def cost_by_rows(rows: FloatArray, aim: Aim, power: float = math.inf) -> tuple[float, FloatArray]:
    """Logarithm of the criterion, smaller is better, and its derivatives by rows ``(p, r, k)``.

    At equal singular values the derivative of one of them is taken; L-BFGS-B lives with that. A
    finite ``power`` smooths criteria of single ones.
    """
    information = _information(rows)
    lift = nuisance_fitted(information, aim)
    wanted_rows = rows @ lift
    variance, turned = _variances(wanted_rows, lift.T @ information @ lift)
    value, by_log = _log_cost(variance, turned, aim, power)
    # d log(eigenvalue of the inverse) = -eigenvalue · vᵀ d(information) v
    slope = -(turned * (by_log * variance)) @ turned.T
    if aim.criterion is Criterion.TOOL_VARIANCE and aim.metric is not None:
        covariance = (turned * variance) @ turned.T
        slope = -covariance @ aim.metric @ covariance / np.trace(aim.metric @ covariance)
    return value, 2.0 * wanted_rows @ slope @ lift.T


def _variances(rows: FloatArray, information: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Eigenvalues ``(k,)`` of the covariance, ascending, and its eigenvectors as columns.

    From the information where its eigenvalues have digits, else from the rows themselves.
    """
    eigenvalues, turned = np.linalg.eigh(information)
    if eigenvalues[0] > FAINT * eigenvalues[-1]:
        return 1.0 / eigenvalues[::-1], np.asarray(turned[:, ::-1])
    flat = rows.reshape(-1, rows.shape[-1])
    _, singular, vectors = svd_of_all(flat)
    least = ROUNDING * max(float(singular[0]), 1e-150)  # its inverse square is still a number
    return np.maximum(singular, least) ** -2, np.asarray(vectors.T)


def judged(rows: FloatArray, aim: Aim) -> float:
    """The criterion of rows ``(p, r, k)``; from singular values where it can be, which keeps twice
    the digits. Raises NotIdentifiable where a wanted combination is not seen.
    """
    if aim.wanted is not None or aim.criterion is Criterion.TOOL_VARIANCE:
        return value_of(_information(rows), aim)
    flat = rows.reshape(-1, rows.shape[-1])
    size = np.linalg.norm(flat, axis=0)
    scaled = np.linalg.svd(flat / np.where(size > 0.0, size, 1.0), compute_uv=False)
    if len(flat) < flat.shape[1] or scaled[-1] <= ROUNDING * scaled[0]:
        return value_of(_information(rows), aim)
    singular = np.linalg.svd(flat, compute_uv=False)
    return float(values_of(np.diag(singular**-2)[None], aim)[0])


def _information(rows: FloatArray) -> FloatArray:
    flat = rows.reshape(-1, rows.shape[-1])
    return np.asarray(flat.T @ flat)


def _smooth(logs: FloatArray, by_log: FloatArray, power: float) -> tuple[float, FloatArray]:
    """``log |σ|_p`` in place of ``log σ_1`` and ``-log |1/σ|_p`` in place of ``log σ_L``; the cost
    and its derivatives ``(k,)``. ``by_log`` are those of the cost that uses ``σ_1, σ_L`` alone.
    """
    value, smooth = 0.0, np.zeros(len(logs))
    for end in (0, -1):
        if by_log[end]:
            scaled = math.copysign(0.5 * power, by_log[end]) * logs
            parts = np.exp(scaled - scaled.max())
            weight, total = 2.0 * abs(float(by_log[end])), float(parts.sum())
            value += weight * (float(scaled.max()) + math.log(total)) / power
            smooth += float(by_log[end]) * parts / total
    return value, smooth


def _log_cost(
    variance: FloatArray, turned: FloatArray, aim: Aim, power: float
) -> tuple[float, FloatArray]:
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
        if power < math.inf:
            return _smooth(logs, by_log, power)
    return float(by_log @ logs), by_log
