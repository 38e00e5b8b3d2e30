"""What repeats tell: their scatter freed of drift, and readings that do not belong."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.distributions import two_sided_p_value
from calib.observations import FloatArray, IntArray, Observations

WILD_LEVEL = 0.01
"""Chance that one of all readings is called wild although none is (Bonferroni)."""


@dataclass(frozen=True)
class WildReading:
    """A reading that does not fit its own repeats: its row, its distance in standard deviations."""

    row: int
    studentised: float
    p_value: float


@dataclass(frozen=True, eq=False)
class Repeats:
    """Readings of one mounting in one posture, approached from one side, should agree.

    From each mounting the means of its cells and of its cycles are removed, so that drift from
    cycle to cycle does not pose as noise. ``bases`` holds for each mounting its rows and an
    orthonormal basis of what is removed; ``leverage`` ``(n_readings,)`` is the share of a reading
    that it takes away; ``degrees_of_freedom`` ``(n_indicators,)`` counts what is left.
    """

    observed: Observations
    bases: tuple[tuple[IntArray, FloatArray], ...]
    leverage: FloatArray
    degrees_of_freedom: FloatArray

    @classmethod
    def of(cls, visited: Observations) -> Repeats:
        """The repeats among readings of `calib.noise.visits`."""
        bases: list[tuple[IntArray, FloatArray]] = []
        leverage = np.zeros(len(visited))
        free = np.zeros(visited.indicator_count)
        order = np.argsort(visited.mount, kind="stable")
        for rows in np.split(order, np.flatnonzero(np.diff(visited.mount[order])) + 1):
            basis = _removed(visited, rows)
            bases.append((rows, basis))
            leverage[rows] = (basis * basis).sum(axis=1)
            np.add.at(free, visited.indicator[rows], 1.0 - leverage[rows])
        return cls(visited, tuple(bases), leverage, np.round(free, 9))

    def scatter(self, value_mm: FloatArray) -> FloatArray:
        """What repeats leave of values ``(n_readings, b)``, weighted; same shape, mm."""
        left = np.sqrt(self.observed.averaged)[:, None] * value_mm
        for rows, basis in self.bases:
            left[rows] -= basis @ (basis.T @ left[rows])
        return left

    def sums_of_squares(self, value_mm: FloatArray) -> FloatArray:
        """Sums of squares ``(n_indicators, b)`` in mm² for values ``(n_readings, b)``."""
        squares = self.scatter(value_mm) ** 2
        total = np.zeros((self.observed.indicator_count, squares.shape[1]))
        np.add.at(total, self.observed.indicator, squares)
        return total


def _removed(visited: Observations, rows: IntArray) -> FloatArray:
    """Orthonormal basis ``(n_rows, rank)`` of cell means and cycle means, weighted."""
    keys = np.stack([visited.displacement_mm[rows], visited.approach[rows]])
    cell = np.unique(keys, axis=1, return_inverse=True)[1].ravel()
    cycle = np.unique(visited.cycle[rows], return_inverse=True)[1]
    columns = np.hstack([np.eye(cell.max() + 1)[cell], np.eye(cycle.max() + 1)[cycle][:, 1:]])
    weighted = np.sqrt(visited.averaged[rows])[:, None] * columns
    basis, singular, _ = np.linalg.svd(weighted, full_matrices=False)
    return np.asarray(basis[:, singular > 1e-9 * singular[0]])


def wild_readings(repeats: Repeats, floor_mm2: float) -> tuple[WildReading, ...]:
    """Readings whose externally studentised residual in their own cell is too large to be chance.

    Student's t with one degree of freedom less, Bonferroni over all readings. ``floor_mm2`` is the
    least variance that a reading can have: the rounding of its display.
    """
    left = repeats.scatter(repeats.observed.value_mm[:, None])[:, 0]
    free = float(repeats.degrees_of_freedom.sum())
    open_share = 1.0 - repeats.leverage
    judged = np.flatnonzero(open_share > 1e-6)
    if free <= 1.0 or not len(judged):
        return ()
    own = left[judged] ** 2 / open_share[judged]
    others = np.maximum((float((left**2).sum()) - own) / (free - 1.0), floor_mm2)
    distance = np.sqrt(own / np.maximum(others, np.finfo(np.float64).tiny))
    found = []
    for row, t in zip(judged, np.sign(left[judged]) * distance, strict=True):
        p = min(1.0, two_sided_p_value(float(t), free - 1.0) * len(judged))
        if p < WILD_LEVEL:
            found.append(WildReading(int(row), float(t), p))
    return tuple(found)
