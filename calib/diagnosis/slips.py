"""A stand that moved once, told from drift and from a single wild reading."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.observations import FloatArray, IntArray, Observations

CLEAR = 60.0
"""The square sum must fall by so many noise variances."""

BETTER = 0.5
"""A step must leave less than this share of what drift or one wild reading leaves."""


@dataclass(frozen=True, eq=False)
class Slip:
    """Readings of one mounting from a row on are shifted; ``corrected`` has them put back."""

    rows: IntArray
    shift_mm: float
    uncertainty_mm: float
    corrected: Observations


def find_slip(observed: Observations) -> Slip | None:
    """The clearest slip, or None. Judged by repeats alone, so no model and no effect matters."""
    noise = _robust_variance(observed)
    if noise is None:
        return None
    best: tuple[float, Slip] | None = None
    for mount in range(observed.mount_count):
        rows = np.flatnonzero(observed.mount == mount)
        found = _in_mounting(observed, rows, noise)
        if found and (best is None or found[0] > best[0]):
            best = found
    return best[1] if best else None


def _in_mounting(observed: Observations, rows: IntArray, noise: float) -> tuple[float, Slip] | None:
    cells = _cell_basis(observed, rows)
    value = observed.value_mm[rows] - cells @ (cells.T @ observed.value_mm[rows])
    total = float(value @ value)
    order = np.asarray(np.arange(len(rows)), dtype=np.float64)
    steps = [
        (k, *_explained(value, cells, np.where(order >= k, 1.0, 0.0)))
        for k in range(2, len(rows) - 1)
    ]
    if not steps:
        return None
    k, gain, shift, share = max(steps, key=lambda one: one[1])
    drift = _explained(value, cells, order)[0]
    wild = max(
        _explained(value, cells, np.where(order == j, 1.0, 0.0))[0] for j in range(len(rows))
    )
    left = max(total - gain, noise)
    if gain < CLEAR * noise or left > BETTER * min(total - drift, total - wild):
        return None
    moved = rows[k:]
    corrected = observed.value_mm.copy()
    corrected[moved] -= shift
    slip = Slip(moved, shift, float(np.sqrt(noise / share)), replace(observed, value_mm=corrected))
    return gain, slip


def _explained(
    value: FloatArray, cells: FloatArray, column: FloatArray
) -> tuple[float, float, float]:
    """What a column explains beside the cells, its coefficient, its square sum beside them."""
    rest = column - cells @ (cells.T @ column)
    share = float(rest @ rest)
    if share < 1e-9:
        return 0.0, 0.0, 1.0
    slope = float(rest @ value) / share
    return slope**2 * share, slope, share


def _cell_basis(observed: Observations, rows: IntArray) -> FloatArray:
    keys = np.stack([observed.displacement_mm[rows], observed.approach[rows]])
    cell = np.unique(keys, axis=1, return_inverse=True)[1].ravel()
    columns = np.eye(cell.max() + 1)[cell]
    return np.asarray(columns / np.sqrt(columns.sum(axis=0)))


def _robust_variance(observed: Observations) -> float | None:
    """Median over the mountings of the variance within cells, mm²; None without repeats."""
    found = []
    for mount in range(observed.mount_count):
        rows = np.flatnonzero(observed.mount == mount)
        cells = _cell_basis(observed, rows)
        free = len(rows) - cells.shape[1]
        if free > 0:
            left = observed.value_mm[rows] - cells @ (cells.T @ observed.value_mm[rows])
            found.append(float(left @ left) / free)
    return max(float(np.median(found)), 1e-8) if found else None
