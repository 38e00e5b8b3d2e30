"""What repeats tell: their scatter freed of drift, and readings that do not belong."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc, stdtr

from calib.arrays import (
    NEW_DIRECTION,
    TIE,
    FloatArray,
    IntArray,
    Observations,
    basis_by_products,
    incidence,
    largest,
    numbered,
    squares_in,
    without,
    without_means,
)
from calib.stats import variance_ratio_p_value

OUTLIER_LEVEL = 0.01
"""Chance that one of all readings is called an outlier although none is (Bonferroni)."""

UNEQUAL_LEVEL = 0.02
"""Chance, on either side, that an indicator like the others is judged by itself alone."""

DISAGREES = 13.0
"""Standard deviations of a reading from which on repeats disagree: of Student's t with 3 degrees of
freedom one session of 60 in thirty has such a reading."""

MEDIAN_OF_NORMAL = 0.6745
"""Of the size of a normal error, in its standard deviation."""

ROUNDING = 8 * float(np.finfo(np.float64).eps)
"""Relative scatter that floating point arithmetic alone makes of equal values."""

MOST_CYCLES = 200
"""Cycles of a mounting up to which each has a mean of its own; of more a steady rate is enough, and
a basis of thousands would take minutes."""

TINY = 1e-30
"""A square that no scatter is below, mm²."""


@dataclass(frozen=True)
class Outlier:
    """A reading that does not fit its own repeats: its row, its distance in standard deviations."""

    row: int
    studentised: float
    p_value: float


@dataclass(frozen=True, eq=False)
class Repeats:
    """Readings of one mounting in one posture, approached from one side, should agree.

    From each mounting the means of its cells and of its cycles are removed, so that drift from
    cycle to cycle does not pose as noise. ``cell`` ``(n_readings,)`` numbers the cells; ``cycles``
    holds for each mounting its rows and an orthonormal basis of its cycles beside its cells;
    ``leverage`` ``(n_readings,)`` is the share of a reading that both take away;
    ``degrees_of_freedom`` ``(n_indicators,)`` counts what is left.
    """

    observations: Observations
    cell: IntArray
    cycles: tuple[tuple[IntArray, FloatArray], ...]
    leverage: FloatArray
    degrees_of_freedom: FloatArray

    @classmethod
    def of(
        cls, visits: Observations, apart: Sequence[int] = (), *, steady: bool = False
    ) -> Repeats:
        """The repeats among readings of `calib.noise.reading.visits`.

        Rows that stand ``apart`` are repeats of nothing. Where a drift is ``steady``, or cycles are
        more than `MOST_CYCLES`, a rate of each mounting is removed in place of its cycles.
        """
        cell = set_apart(visits.cell, apart)
        leverage = visits.averaged / np.bincount(cell, visits.averaged)[cell]
        cycles: list[tuple[IntArray, FloatArray]] = []
        for rows in visits.mountings:
            many_cycles = len(np.unique(visits.cycle[rows])) > MOST_CYCLES
            drift = _rate if steady or many_cycles else _cycles
            basis = _beside_cells(visits, rows, cell[rows], drift(visits, rows))
            cycles.append((rows, basis))
            leverage[rows] += (basis * basis).sum(axis=1)
        free = np.bincount(visits.indicator, 1.0 - leverage, visits.indicator_count)
        return cls(visits, cell, tuple(cycles), leverage, np.round(free, 9))

    @property
    def standard_deviation_mm(self) -> float | None:
        """Standard deviation of a single value, all indicators pooled, mm; None without repeats."""
        free = float(self.degrees_of_freedom.sum())
        square = float(self.sums_of_squares(self.observations.value_mm).sum())
        return math.sqrt(square / free) if free else None

    def scatter(self, value_mm: FloatArray) -> FloatArray:
        """What repeats leave of values ``(n_readings, ...)``, weighted; same shape, mm."""
        departure_mm = _without_cells(self.observations.averaged, self.cell, value_mm)
        for rows, basis in self.cycles:
            departure_mm[rows] = without(basis, departure_mm[rows])
        return departure_mm

    def sums_of_squares(self, value_mm: FloatArray) -> FloatArray:
        """Sums of squares ``(n_indicators, ...)`` in mm² for values ``(n_readings, ...)``."""
        squares = self.scatter(value_mm) ** 2
        total = np.zeros((self.observations.indicator_count, *squares.shape[1:]))
        np.add.at(total, self.observations.indicator, squares)
        return total


def _without_cells(weight: FloatArray, cell: IntArray, value: FloatArray) -> FloatArray:
    """Values ``(n, ...)`` minus the weighted means of their cells, times the root of the weight."""
    return np.asarray((without_means(cell, weight, value).T * np.sqrt(weight)).T)


def _cycles(visits: Observations, rows: IntArray) -> FloatArray:
    """Columns ``(n_rows, k)``, one for each cycle of a mounting but the first."""
    return incidence(numbered(visits.cycle[rows]))[:, 1:]


def _rate(visits: Observations, rows: IntArray) -> FloatArray:
    """A column ``(n_rows, 1)`` of the time, of the order where no time is known."""
    time_s = visits.time_s[rows]
    timed = np.isfinite(time_s).all() and np.ptp(time_s) > 0.0
    clock = time_s - time_s[0] if timed else np.arange(len(rows), dtype=np.float64)
    return np.asarray(clock / max(float(np.ptp(clock)), 1.0))[:, None]


def _beside_cells(
    visits: Observations, rows: IntArray, cell: IntArray, columns: FloatArray
) -> FloatArray:
    """Orthonormal basis ``(n_rows, rank)`` of columns of a mounting, cell means taken out."""
    if not columns.any():
        return np.zeros((len(rows), 0))
    return basis_by_products(_without_cells(visits.averaged[rows], numbered(cell), columns))


def disagreeing(repeats: Repeats, floor_mm2: float) -> list[int]:
    """Rows of readings that disagree with their repeats beyond any tail.

    One after the other, the furthest first; of two that disagree with each other alone both are.
    The measure is the typical difference of repeats of the mounting, or of all mountings where that
    is larger: half of them may be wrong before it is, and what drifts from cycle to cycle is in it.
    ``floor_mm2`` is the rounding of the display; where that is zero and most repeats agree exactly,
    nothing tells what is far.
    """
    observations, cell = repeats.observations, repeats.cell
    typical = typical_mm2(repeats)
    if typical is None or max(floor_mm2, float(typical.max())) <= arithmetic_mm2(observations):
        return []
    far = DISAGREES**2 * np.maximum(typical, floor_mm2)[observations.mount]
    apart: list[int] = []
    while True:
        share = _off_their_cells(observations, cell) ** 2 / far
        worst = largest(share)
        if share[worst] <= 1.0:
            return apart
        alike = np.flatnonzero((cell == cell[worst]) & (share >= (1.0 - TIE) * share[worst]))
        apart += alike.tolist()
        cell = set_apart(cell, alike)


def set_apart(cell: IntArray, rows: Sequence[int] | IntArray) -> IntArray:
    """The cells ``(n,)`` with each of these rows in one of its own."""
    if not len(rows):
        return cell
    parted = cell.copy()
    parted[list(rows)] = int(cell.max()) + 1 + np.arange(len(rows))
    return numbered(parted)


def _off_their_cells(observations: Observations, cell: IntArray) -> FloatArray:
    """How far each reading ``(n,)`` is from its repeats, mm; 0 where it has none."""
    open_share = 1.0 - observations.averaged / np.bincount(cell, observations.averaged)[cell]
    judged = open_share > NEW_DIRECTION**2
    departure_mm = _without_cells(observations.averaged, cell, observations.value_mm)
    return np.where(judged, departure_mm / np.sqrt(np.where(judged, open_share, 1.0)), 0.0)


def typical_mm2(repeats: Repeats) -> FloatArray | None:
    """Variance of a value by the median difference of repeats ``(n_mountings,)``, None without any.

    Each repeat is compared with the next of its cell, the last with the first. At least that of the
    middle mounting.
    """
    observations = repeats.observations
    order = np.argsort(repeats.cell, kind="stable")
    following = np.empty_like(order)
    starts = np.concatenate([[0], np.flatnonzero(np.diff(repeats.cell[order])) + 1])
    sizes = np.diff([*starts, len(order)])
    following[:-1] = order[1:]
    following[starts + sizes - 1] = order[starts]
    once = np.repeat(sizes > 2, sizes)  # of two the way there and back is one difference
    once[starts[sizes == 2]] = True
    here, next_rows = order[once], following[once]
    if not len(here):
        return None
    weight = 1.0 / observations.averaged[here] + 1.0 / observations.averaged[next_rows]
    apart = np.abs(observations.value_mm[here] - observations.value_mm[next_rows]) / np.sqrt(weight)
    mount = observations.mount[here]
    typical = np.full(observations.mount_count, np.nan)
    for number in np.unique(mount):
        typical[number] = np.median(apart[mount == number])
    middle = float(np.nanmedian(typical))
    return np.asarray((np.fmax(typical, middle) / MEDIAN_OF_NORMAL) ** 2)


def arithmetic_mm2(observations: Observations) -> float:
    """Less than this is floating point arithmetic, not scatter."""
    return (ROUNDING * float(np.abs(observations.value_mm).max(initial=0.0))) ** 2


def outlying_readings(repeats: Repeats, floor_mm2: float) -> tuple[Outlier, ...]:
    """Readings whose externally studentised residual in their own cell is too large to be chance.

    Student's t with one degree of freedom less, Bonferroni over all readings. The scatter is that
    of all repeats where the reading's own indicator, the reading left out, scatters like the
    others, else that of its own indicator. ``floor_mm2`` is the least variance that a reading can
    have: the rounding of its display.
    """
    value_mm = repeats.observations.value_mm
    departure_mm = repeats.scatter(value_mm)
    free = float(repeats.degrees_of_freedom.sum())
    open_share = 1.0 - repeats.leverage
    judged = np.flatnonzero(open_share > NEW_DIRECTION**2)
    if free <= 1.0 or not len(judged):
        return ()
    square = departure_mm[judged] ** 2 / open_share[judged]
    squares, indicator = repeats.sums_of_squares(value_mm), repeats.observations.indicator[judged]
    variance, nu = _others(squares, repeats.degrees_of_freedom, indicator, square)
    t = np.sign(departure_mm[judged]) * np.sqrt(square / np.maximum(variance, max(floor_mm2, TINY)))
    p = np.minimum(2.0 * stdtr(nu, -np.abs(t)) * len(judged), 1.0)
    outlying = p < OUTLIER_LEVEL
    columns = (column[outlying].tolist() for column in (judged, t, p))
    return tuple(Outlier(*outlier) for outlier in zip(*columns, strict=True))


def cycle_drift(repeats: Repeats, floor_mm2: float) -> float | None:
    """How far readings drift from cycle to cycle, r.m.s. in mm; None where chance may do that.

    Mean square of the cycles, cells taken out, against that of the repeats (variance ratio). What
    drifts within a cycle is not seen here and goes into the differences.
    """
    observations = repeats.observations
    departure_mm = _without_cells(observations.averaged, repeats.cell, observations.value_mm)
    square = sum(squares_in(basis, departure_mm[rows]) for rows, basis in repeats.cycles)
    rank = float(sum(basis.shape[1] for _, basis in repeats.cycles))
    free = float(repeats.degrees_of_freedom.sum())
    if not rank or free <= 0.0:
        return None
    scatter = float(repeats.sums_of_squares(observations.value_mm).sum()) / free
    scatter = max(scatter, floor_mm2, TINY)
    between = square / rank
    if variance_ratio_p_value(between / scatter, rank, free) >= OUTLIER_LEVEL:
        return None
    share = observations.averaged / np.bincount(repeats.cell, observations.averaged)[repeats.cell]
    per_cycle = float((observations.averaged * (1.0 - share)).sum()) / rank
    return math.sqrt((between - scatter) / per_cycle)


def _others(
    squares: FloatArray, free: FloatArray, indicator: IntArray, square: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Variance to judge each reading by, without its own ``square``, and its degrees of freedom.

    ``indicator`` and ``square`` ``(k,)`` are those of the readings.
    """
    total, nu_total = float(squares.sum()), float(free.sum())
    own_square, nu_own = np.maximum(squares[indicator] - square, 0.0), free[indicator] - 1.0
    other_square, nu_others = total - squares[indicator], nu_total - free[indicator]
    comparable = (nu_own > 0.0) & (nu_others > 0.0)
    nu_alone = np.where(comparable, nu_own, 1.0)
    alone = own_square / nu_alone
    nu_beside = np.where(comparable, nu_others, 1.0)
    noisier = fdtrc(nu_alone, nu_beside, alone / np.maximum(other_square / nu_beside, TINY))
    unequal = comparable & (np.minimum(noisier, 1.0 - noisier) < UNEQUAL_LEVEL)
    pooled = np.maximum(total - square, 0.0) / (nu_total - 1.0)
    return np.where(unequal, alone, pooled), np.where(unequal, nu_own, nu_total - 1.0)
