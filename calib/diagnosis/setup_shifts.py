"""A stand that moved once, told from drift and from a single wild reading.

Repeats of the same approach judge first; no model and no effect matters there. Where they cannot
tell, as between two cycles, all readings of a posture judge, with one play for each mounting.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.linalg import DEPENDENT, NEW_DIRECTION, basis_of, incidence, lengths, onto, without
from calib.observations import FloatArray, IntArray, Observations, numbered
from calib.ties import descending

CLEAR = 60.0
"""The square sum must fall by so many noise variances."""

BETTER = 0.5
"""A step must leave less than this share of what drift or one wild reading leaves."""


@dataclass(frozen=True, eq=False)
class SetupShift:
    """Readings of one mounting from a row on are shifted; ``corrected`` has them put back."""

    rows: IntArray
    shift_mm: float
    uncertainty_mm: float
    corrected: Observations


def find_slip(observed: Observations) -> SetupShift | None:
    """The clearest slip, or None. Judged by repeats alone, without a model."""
    noise = _robust_variance(observed)
    if noise is None:
        return None
    best: tuple[float, SetupShift] | None = None
    for rows in observed.mountings:
        found = _in_mounting(observed, rows, noise)
        if found and (best is None or found[0] > best[0]):
            best = found
    return best[1] if best else None


def _in_mounting(
    observed: Observations, rows: IntArray, noise: float
) -> tuple[float, SetupShift] | None:
    close = _step(observed, rows, cell_basis(observed, rows), noise)
    if close is None or close.gain < CLEAR * noise:
        return None
    wide = None if close.clear else _step(observed, rows, posture_basis(observed, rows), noise)
    step = wide or close
    if step.gain < CLEAR * noise or not step.clear:
        return None
    moved = rows[step.first :]
    corrected = observed.value_mm.copy()
    corrected[moved] -= step.shift_mm
    uncertainty = float(np.sqrt(noise / step.share))
    return step.gain, SetupShift(
        moved, step.shift_mm, uncertainty, replace(observed, value_mm=corrected)
    )


@dataclass(frozen=True)
class _Step:
    """The best step of one mounting: its first row, what it explains, and whether nothing else

    does as well: ``share`` is its square sum beside the repeats.
    """

    first: int
    gain: float
    shift_mm: float
    share: float
    clear: bool


def _step(observed: Observations, rows: IntArray, basis: FloatArray, noise: float) -> _Step | None:
    value = without(basis, observed.value_mm[rows])
    total = float(value @ value)
    order = np.arange(len(rows))
    steps = [
        (k, *_explained(value, basis, np.where(order >= k, 1.0, 0.0)))
        for k in range(2, len(rows) - 1)
    ]
    if not steps:
        return None
    k, gain, shift, share = descending(steps, lambda one: one[1])[0]
    drift = _explained(value, basis, order.astype(np.float64))[0]
    wild = max(_explained(value, basis, np.where(order == j, 1.0, 0.0))[0] for j in order)
    left = max(total - gain, noise)
    return _Step(k, gain, shift, share, left <= BETTER * (total - max(drift, wild)))


def level_basis(observed: Observations, rows: IntArray) -> FloatArray:
    """Orthonormal: one column for each posture, whatever the approach."""
    levels = incidence(numbered(observed.level[rows]))
    return levels / lengths(levels)


def _explained(
    value: FloatArray, cells: FloatArray, column: FloatArray
) -> tuple[float, float, float]:
    """What a column explains beside the cells, its coefficient, its square sum beside them."""
    rest = without(cells, column)
    share = float(rest @ rest)
    if share < NEW_DIRECTION**2:
        return 0.0, 0.0, 1.0
    slope = float(rest @ value) / share
    return slope**2 * share, slope, share


def cell_basis(observed: Observations, rows: IntArray) -> FloatArray:
    """Orthonormal: one column for each posture and approach."""
    cells = incidence(numbered(observed.cell[rows]))
    return cells / lengths(cells)


def posture_basis(observed: Observations, rows: IntArray) -> FloatArray:
    """Postures, whatever the approach, and what a play of a carriage adds between approaches.

    An unknown approach counts as that of most repeats of its posture.
    """
    levels = level_basis(observed, rows)
    approach = observed.approach[rows]
    usual = np.sign(onto(levels, approach).round(9))
    play = np.where(approach == 0.0, usual, approach)
    plays = observed.movement[rows] if observed.movement.any() else play[:, None]
    return basis_of(np.column_stack([levels, plays]), DEPENDENT)


def _robust_variance(observed: Observations) -> float | None:
    """Median over the mountings of the variance within cells, mm²; None without repeats."""
    found = []
    for rows in observed.mountings:
        cells = cell_basis(observed, rows)
        free = len(rows) - cells.shape[1]
        if free > 0:
            left = without(cells, observed.value_mm[rows])
            found.append(float(left @ left) / free)
    return max(float(np.median(found)), 1e-8) if found else None
