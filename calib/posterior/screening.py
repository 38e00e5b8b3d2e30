"""What other values of the same rows would leave beside the plain model: cheap, and linear."""

from __future__ import annotations

import math

import numpy as np

from calib.arrays import FloatArray, incidence, tilts, without
from calib.errors import NotIdentifiable
from calib.identify.fit import design_of
from calib.noise.repeats import Repeats, typical_mm2
from calib.posterior.cells import BASE, Cells

LOOSE = 6.0
"""Variance of repeats over that of their usual difference; with heavy tails it is 2 to 3."""


class Screen:
    """Visits of one session about its plain model: what is left of other values of its rows.

    ``basis`` ``(n + p, r)`` are zeros, base parameters and columns beside them, with what is
    expected of these as ``p`` rows; all visits have the middle variance of the indicators.
    ``left`` ``(n + p,)`` of the values as they are written has the sum of squares ``square``.
    ``elsewhere`` are sum of squares and degrees of freedom of other sessions: one noise is theirs.
    """

    def __init__(
        self,
        cells: Cells,
        columns: FloatArray | None = None,
        root: FloatArray | None = None,
        elsewhere: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        """Beside columns ``(n_cells, r)``, None: none.

        ``root`` ``(n,)`` are standard deviations, mm, None: those of `even_mm`.
        """
        visits, cell = cells.visits, cells.cell
        self.cells, self.elsewhere = cells, elsewhere
        self.root = even_mm(cells) if root is None else root
        columns = np.zeros((len(cells.means), 0)) if columns is None else columns
        try:
            model = cells.model
        except NotIdentifiable:  # where labels are too wrong for a fit, the model of the session
            model = cells.case.model
        base_root, count = cells.case.base_root, BASE + columns.shape[1]
        derivatives = design_of(model, cells.means, range(BASE), ()) @ base_root
        zeros = np.hstack([incidence(visits.mount), tilts(visits)])
        columns_of_visits = np.hstack([zeros, derivatives[cell], columns[cell]])
        below = np.hstack([np.zeros((count, zeros.shape[1])), np.eye(count)])
        rows = np.vstack([columns_of_visits / self.root[:, None], below])
        self.basis = np.linalg.qr(rows)[0]
        self.expected = np.zeros(count)
        departure = np.array(cells.case.model.parameters_mm) - model.parameters_mm
        self.expected[:BASE] = np.linalg.solve(base_root, departure)
        self.freedom = len(visits) - zeros.shape[1] - 3.0
        self.predicted_mm = model.readings(cells.means)[cell]
        self.left = self.left_of(visits.value_mm[:, None])[:, 0]
        self.square = float(self.left @ self.left)

    def left_of(self, value_mm: FloatArray) -> FloatArray:
        """What is left ``(n + p, k)`` of values ``(n, k)``."""
        rows = (value_mm - self.predicted_mm[:, None]) / self.root[:, None]
        rows = np.vstack([rows, np.tile(self.expected[:, None], rows.shape[1])])
        return without(self.basis, rows)

    def log_likelihood(self, square: FloatArray | float, fewer: int = 0) -> FloatArray:
        """Log likelihood of what is left, so many directions fewer, but for what is the same for
        all.
        """
        if math.isinf(self.cells.freedom):
            return np.asarray(-0.5 * np.asarray(square))
        elsewhere_square, free = self.elsewhere
        half = max(self.freedom + free - fewer, 1.0) / 2.0  # of fewer readings than unknowns
        total = np.maximum(square, 1e-9) + elsewhere_square
        return np.asarray(math.lgamma(half) - half * np.log(total / 2.0))


def even_mm(cells: Cells) -> FloatArray:
    """Standard deviation of each visit ``(n,)``, that of the middle indicator: no other unit.

    Where a stand moved, its repeats scatter; then what most repeats differ by is nearer the truth.
    """
    if cells.noise is None:
        return np.sqrt(cells.scatter_mm2)
    middle = float(np.median([indicator.variance_mm2 for indicator in cells.noise.indicators]))
    typical = typical_mm2(Repeats.of(cells.visits, steady=True))
    if typical is not None:
        least = max(float(typical.min()), cells.case.indicator.display_mm**2 / 12.0)
        middle = least if middle > LOOSE * least else middle
    return np.sqrt(np.maximum(middle / cells.visits.averaged, 1e-10))
