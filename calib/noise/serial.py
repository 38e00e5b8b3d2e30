"""Errors of repeats that follow each other: their correlation, and what that adds to variances.

The errors of consecutive visits of a mounting are an autoregressive process of first order:
correlated by rho from one visit to the next, by rho^k over k visits. A law of time that is fitted
to them finds a drift where there is none. A drift that runs steadily through all repeats of a
mounting is no correlation: what may drift is taken out before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from calib.arrays import (
    NEW_DIRECTION,
    FloatArray,
    IntArray,
    Observations,
    basis_of,
    incidence,
    lengths,
    numbered,
    without_means,
)
from calib.noise.repeats import arithmetic_mm2

RHOS = np.linspace(0.0, 0.95, 20)
"""Correlations that are weighed. Errors that turn back from visit to visit have no mechanism."""

INDEPENDENT = 0.5
"""Prior weight of repeats that are independent; the other half is spread evenly."""

LEAST_FREEDOM = 2
"""Repeats that remain beside cells and law: one alone follows nothing."""

FORGOTTEN = 1e-3
"""A correlation over so many visits that it is less counts as none."""


@dataclass(frozen=True, eq=False)
class SerialCorrelation:
    """Correlations ``(g,)`` from one visit to the next, and their weights ``(g,)``, which sum to 1.

    A session has few cycles, so no single figure is taken: variances are averages over all of them.
    """

    rhos: FloatArray
    weights: FloatArray

    @property
    def rho(self) -> float:
        """The expected correlation, shrunk towards none."""
        return float(self.weights @ self.rhos)

    @property
    def standard_uncertainty(self) -> float:
        """Of the correlation."""
        return float(np.sqrt(self.weights @ (self.rhos - self.rho) ** 2))

    def over_visits(self, count: int) -> FloatArray:
        """Expected correlation ``(count,)`` of errors 0, 1, 2 … visits apart."""
        return np.asarray(self.weights @ self.rhos[:, None] ** np.arange(count))

    def correlated(self, observed: Observations, columns: FloatArray) -> FloatArray:
        """The expected correlation matrix of all errors times columns ``(n_readings, k)``.

        ``observed`` are visits in the order taken; errors of different mountings are independent.
        The matrix itself is never made.
        """
        found = columns.copy()
        for rows in observed.mountings:
            each, apart = columns[rows], self.over_visits(len(rows))
            total = each.copy()
            for k in range(1, int(np.count_nonzero(apart > FORGOTTEN))):
                total[k:] += apart[k] * each[:-k]
                total[:-k] += apart[k] * each[k:]
            found[rows] = total
        return found

    def variance_factor(self, observed: Observations, columns: FloatArray) -> float:
        """Variance along orthonormal columns ``(n_readings, k)`` over that of independent errors.

        The column of a law of time gives that of its rate; zeros and all else that is fitted
        beside it must be projected out of it. The mean over the columns.
        """
        if not columns.shape[1]:
            return 1.0
        variances = (columns * self.correlated(observed, columns)).sum(axis=0)
        return float(variances.mean())

    def shown_share(self, observed: Observations, structure: FloatArray) -> float:
        """Share of the variance of a reading that the scatter of repeats shows.

        ``structure`` ``(n_readings, e)`` is an orthonormal basis of what is no scatter: cells, and
        cycles where a drift between them is removed. Errors that follow each other are alike in it,
        so a noise taken from repeats is too small by this share; every factor here, divided by it,
        counts in that noise.
        """
        free = len(observed) - structure.shape[1]
        if free <= 0:
            return 1.0
        taken = float((structure * self.correlated(observed, structure)).sum())
        return float((len(observed) - taken) / free)

    def cell_mean_factors(self, observed: Observations) -> FloatArray:
        """Variance of the mean of each cell ``(n_cells,)`` over that of independent errors.

        Means of different cells of a mounting are correlated, too: see `correlated`.
        """
        cells = np.sqrt(observed.averaged)[:, None] * incidence(observed.cell)
        cells = cells / lengths(cells)
        return np.asarray((cells * self.correlated(observed, cells)).sum(axis=0))


INDEPENDENT_REPEATS = SerialCorrelation(np.zeros(1), np.ones(1))
"""Where nothing tells of a correlation."""


def serial_correlation(
    observed: Observations, weight: FloatArray, beside: FloatArray | None = None
) -> SerialCorrelation:
    """The correlation of the repeats among visits, beside laws that drift, all mountings together.

    ``weight`` ``(n_readings,)`` is that of the readings in 1/mm². ``beside`` ``(n_readings, k)``
    are columns of what may drift; None: every mounting steadily, by itself. Without repeats
    nothing speaks for a correlation.
    """
    laws = steady_drifts(observed) if beside is None else beside
    return serial_correlations(observed, weight, [laws])[0]


def serial_correlations(
    observed: Observations, weight: FloatArray, laws: Sequence[FloatArray]
) -> list[SerialCorrelation]:
    """`serial_correlation` beside each of several laws ``(n_readings, k)``.

    Restricted likelihood: the means of cells and the law are taken out, and their degrees of
    freedom with them, so that few cycles do not bias it.
    """
    root, cell = np.sqrt(weight), observed.cell
    whole = [root[:, None] * one for one in laws]
    beside = [_beside_cells(one / lengths(one), root, cell) for one in whole]
    columns = [basis_of(one, NEW_DIRECTION, 1.0) for one in beside]
    value = _beside_cells((root * observed.value_mm)[:, None], root, cell)
    repeats = len(observed) - len(np.unique(cell))
    if float((value**2).sum()) <= arithmetic_mm2(observed) * float(weight.max()) * repeats:
        return [INDEPENDENT_REPEATS] * len(laws)
    products, log_determinants = _whitened(observed, root, np.hstack([value, *columns]))
    ends = np.cumsum([1, *(one.shape[1] for one in columns)])
    found = []
    for start, end in pairwise(ends.tolist()):
        inside = products[:, start:end, start:end]
        across = products[:, start:end, :1]
        explained = (across * np.linalg.solve(inside, across)).sum(axis=(1, 2))
        square = products[:, 0, 0] - explained
        log_determinant = log_determinants + np.linalg.slogdet(inside).logabsdet
        free = repeats - (end - start)
        if free < LEAST_FREEDOM or not (square > 0.0).all():
            found.append(INDEPENDENT_REPEATS)
            continue
        found.append(_weighed(-0.5 * (log_determinant + free * np.log(square))))
    return found


def steady_drifts(observed: Observations) -> FloatArray:
    """Columns ``(n_readings, n_mountings)``: the number of the visit, mounting by mounting."""
    columns = np.zeros((len(observed), observed.mount_count))
    for mount, rows in enumerate(observed.mountings):
        columns[rows, mount] = np.arange(len(rows))
    return columns


def _weighed(log_likelihood: FloatArray) -> SerialCorrelation:
    prior = np.full(len(RHOS), (1.0 - INDEPENDENT) / (len(RHOS) - 1))
    prior[0] = INDEPENDENT
    weights = prior * np.exp(log_likelihood - log_likelihood.max())
    return SerialCorrelation(RHOS, weights / weights.sum())


def _beside_cells(columns: FloatArray, root: FloatArray, cell: IntArray) -> FloatArray:
    """Weighed columns ``(n, k)`` less the mean of each cell."""
    return root[:, None] * without_means(cell, root**2, columns / root[:, None])


def _whitened(
    observed: Observations, root: FloatArray, columns: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Products ``(g, k, k)`` of columns ``(n, k)`` made independent, the cells taken out.

    With the logarithm ``(g,)`` of the determinants of the errors and of the cells. The differences
    x_k - rho x_(k-1) over the root of 1 - rho² are independent, the first value is by itself.
    """
    count = columns.shape[1]
    products, log_determinants = np.zeros((len(RHOS), count, count)), np.zeros(len(RHOS))
    rho = RHOS[:, None, None]
    for rows in observed.mountings:
        cells = root[rows, None] * incidence(numbered(observed.cell[rows]))
        each = np.hstack([columns[rows], cells / lengths(cells)])
        now, before = each[1:], each[:-1]
        both = now.T @ before
        square = (now.T @ now - rho * (both + both.T) + rho**2 * (before.T @ before)) / (1 - rho**2)
        square += np.outer(each[0], each[0])
        inside, across = square[:, count:, count:], square[:, count:, :count]
        taken = across.transpose(0, 2, 1) @ np.linalg.solve(inside, across)
        products += square[:, :count, :count] - taken
        log_determinants += (len(rows) - 1) * np.log(1.0 - RHOS**2)
        log_determinants += np.linalg.slogdet(inside).logabsdet
    return products, log_determinants
