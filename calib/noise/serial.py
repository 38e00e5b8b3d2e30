"""Errors of repeats that follow each other.

The errors of consecutive visits of a mounting are an autoregressive process of first order:
correlated by rho from one visit to the next, by rho^k over k visits. A law of time that is fitted
to them finds a drift where there is none, and the mean of a cell is known less well than its
repeats let expect. A drift that runs steadily through a mounting is no correlation.
"""

from __future__ import annotations

import numpy as np

from calib.arrays import (
    FloatArray,
    IntArray,
    Observations,
    basis_by_products,
    incidence,
    lengths,
    numbered,
)
from calib.noise.repeats import arithmetic_mm2

RHOS = np.linspace(0.0, 0.95, 20)
"""Correlations that are weighed. Errors that turn back from visit to visit have no mechanism."""

INDEPENDENT = 0.5
"""Prior weight of repeats that are independent; the other half is spread evenly."""

LEAST_FREEDOM = 2
"""Repeats that remain beside cells and drifts: one alone follows nothing."""


LEAST_RHO = 0.1
"""So much is expected of independent repeats, too; it changes no variance by more than a tenth."""


def independent(rho: float, columns: FloatArray) -> FloatArray:
    """Columns ``(n_visits, k)`` of one mounting, whose errors rho correlates, made independent.

    The differences x_k - rho x_(k-1) over the root of 1 - rho²; the first is by itself.
    """
    if rho == 0.0:
        return columns
    differences = (columns[1:] - rho * columns[:-1]) / np.sqrt(1.0 - rho**2)
    return np.concatenate([columns[:1], differences])


def serial_correlation(
    observations: Observations, cell: IntArray, variance_mm2: FloatArray
) -> float:
    """The expected correlation from one visit to the next, all mountings together.

    ``cell`` and ``variance_mm2`` ``(n_visits,)`` are those of the visits. Restricted likelihood
    beside the means of cells and a steady drift of each mounting; shrunk towards none, since a
    session has few cycles. 0 below `LEAST_RHO`, and where nothing is repeated.
    """
    root = 1.0 / np.sqrt(variance_mm2)
    squares, log_determinants, free = np.zeros(len(RHOS)), np.zeros(len(RHOS)), 0
    for rows in observations.mountings:
        order = np.linspace(-1.0, 1.0, len(rows))[:, None]
        columns = np.hstack([incidence(numbered(cell[rows])), order])
        whitened = root[rows, None] * columns
        basis = basis_by_products(whitened / lengths(whitened))
        if len(rows) <= basis.shape[1]:
            continue
        free += len(rows) - basis.shape[1]
        square, log_determinant = _beside(basis, root[rows] * observations.value_mm[rows])
        squares += square
        log_determinants += log_determinant
    least = arithmetic_mm2(observations) * float(root.max()) ** 2 * free
    if free < LEAST_FREEDOM or squares.min() <= least:
        return 0.0
    log_likelihood = -0.5 * (log_determinants + free * np.log(squares))
    weights = np.full(len(RHOS), (1.0 - INDEPENDENT) / (len(RHOS) - 1))
    weights[0] = INDEPENDENT
    weights *= np.exp(log_likelihood - log_likelihood.max())
    rho = float(weights @ RHOS / weights.sum())
    return rho if rho > LEAST_RHO else 0.0


def _beside(basis: FloatArray, value: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What a basis ``(n, r)`` leaves of values ``(n,)`` for each correlation, and determinants.

    The logarithms ``(g,)`` of those of the errors and of the basis among them, together.
    """
    columns = np.column_stack([basis, value])
    now, previous = columns[1:], columns[:-1]
    crossed, rho = now.T @ previous, RHOS[:, None, None]
    products = now.T @ now - rho * (crossed + crossed.T) + rho**2 * (previous.T @ previous)
    products = products / (1.0 - rho**2) + np.outer(columns[0], columns[0])
    inside, across = products[:, :-1, :-1], products[:, :-1, -1:]
    explained = (across * np.linalg.solve(inside, across)).sum(axis=(1, 2))
    log_determinants = (len(value) - 1) * np.log(1.0 - RHOS**2)
    log_determinants += np.linalg.slogdet(inside).logabsdet
    return products[:, -1, -1] - explained, log_determinants
