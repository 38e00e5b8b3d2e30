"""Sessions as one linear problem of few rows: means of cells, and what their readings do in time.

Readings of one mounting, posture and side have one mean and one variance. What depends on time
differs within a cell; a QR decomposition keeps of that exactly what such columns can show. The
cost of everything after goes with cells.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.arrays import (
    DEPENDENT,
    Conditions,
    FloatArray,
    IntArray,
    Observations,
    basis_of,
    incidence,
    lengths,
    set_up_unknowns,
    tilts,
    without,
    without_means,
    without_zeros,
)
from calib.identify.fit import design_of, prior_fit
from calib.noise.reading import IndicatorFigures, Noise, reading_noise, visits
from calib.noise.repeats import Repeats, disagreeing, set_apart
from calib.noise.serial import independent, serial_correlation
from calib.tripod.effects.candidates import place_columns
from calib.tripod.effects.effect import Effect, Kind
from calib.tripod.geometry import PARAMETER_NAMES
from calib.tripod.pipeline import Model

BASE = len(PARAMETER_NAMES)
LENGTHS = BASE - 3

FINEST_MM = 1e-5
"""No indicator reads better; with less, rounding would be taken for what readings show."""

USUAL = 3.0
"""Standard deviations from its repeats up to which a reading counts in full."""

ROBUST_ROUNDS = 5

Placed = tuple[Effect, str]
"""A law and its place."""


@dataclass(frozen=True, eq=False)
class Case:
    """One session: the model it was measured against, and what is known of machine and indicators.

    ``tolerance_mm`` ``(6,)`` are standard deviations of joint offsets and bar lengths.
    """

    model: Model
    observed: Observations
    indicator: IndicatorFigures
    tolerance_mm: FloatArray


@dataclass(frozen=True, eq=False)
class Cells:
    """One session by its cells: ``means`` of them, with a variance ``(n_cells,)`` of each in mm².

    ``cell`` ``(n_visits,)`` numbers the cell of each visit, ``scatter_mm2`` ``(n_visits,)`` is its
    variance, larger where it lies far from its repeats; ``serial`` correlates each with the next of
    its mounting. Nobody saw how the first reading of a mounting was reached: its approach is not
    known, so it shares no cell. ``noise`` is None where nothing tells it. Visits that stand
    ``apart`` disagree with their repeats: they are no noise, and ``excess`` is what they add to the
    square sum within cells.
    """

    case: Case
    visited: Observations
    cell: IntArray
    means: Observations
    variance_mm2: FloatArray
    scatter_mm2: FloatArray
    noise: Noise | None
    serial: float
    apart: IntArray
    excess: float

    @classmethod
    def of(cls, case: Case) -> Cells:
        """Group the visits of a session."""
        return cls.of_visits(case, visits(case.observed))

    @classmethod
    def of_visits(cls, case: Case, visited: Observations) -> Cells:
        """Group visits, which need not be those of the session as it is written."""
        cell, serial, excess = visited.cell, 0.0, 0.0
        floor_mm2 = case.indicator.display_mm**2 / 12.0
        apart = np.array(disagreeing(Repeats.of(visited), floor_mm2), dtype=np.intp)
        noise = reading_noise(visited, case.indicator, apart.tolist())
        if noise is None:  # equal weights: what the model leaves tells the variance
            centred = without_zeros(visited, visited.averaged, visited.value_mm)
            scatter = max(1e-4 * float((centred**2).mean()), 1e-8) / visited.averaged
        else:
            scatter = np.maximum(noise.repeatability_mm2(visited), FINEST_MM**2)
            alone = set_apart(cell, apart)
            excess = _square_within(cell, scatter, visited.value_mm) - _square_within(
                alone, scatter, visited.value_mm
            )
            serial = serial_correlation(visited, alone, scatter)
            if serial:
                scatter = scatter * _underrated(visited, alone, scatter, serial)
            scatter = scatter / _robust_weights(visited.value_mm, cell, scatter)
        means, variance = _means(visited, cell, scatter, serial)
        shared = noise.quantisation_mm2(means) if noise else 0.0
        variance = np.maximum(variance + shared, FINEST_MM**2)
        return cls(case, visited, cell, means, variance, scatter, noise, serial, apart, excess)

    @property
    def freedom(self) -> float:
        """Degrees of freedom of the noise; 0 where none is known."""
        return self.noise.degrees_of_freedom if self.noise else 0.0

    @cached_property
    def log_constant(self) -> float:
        """Log density of the readings that no model changes: their scales, and repeats that agree.

        With it the evidences of sessions with other labels, or fewer readings, compare.
        """
        scatter = self.scatter_mm2
        zeros = np.bincount(self.visited.mount, 1.0 / scatter)
        repeats = len(self.visited) - len(self.means) - len(self.apart)
        log_scales = np.log(2.0 * np.pi * scatter).sum() + np.log(zeros / (2.0 * np.pi)).sum()
        return -0.5 * float(log_scales + (repeats if self.noise else 0))

    @cached_property
    def model(self) -> Model:
        """Base parameters fitted within their tolerances. Raises NotIdentifiable."""
        case = self.case
        return prior_fit(case.model, self.means, 1.0 / self.variance_mm2, case.tolerance_mm).model

    def whitened(self, rows: FloatArray) -> FloatArray:
        """Rows ``(n_cells, ...)`` made independent, of unit variance, less the best zeros."""
        flat = self._independent(rows.reshape(len(rows), -1))
        return np.asarray(without(self._zeros, flat).reshape(rows.shape))

    def coloured(self, rows: FloatArray) -> FloatArray:
        """The opposite ``(n_cells, k)``, but for what zeros took."""
        if not self.serial:
            return np.asarray(rows * np.sqrt(self.variance_mm2)[:, None])
        columns = np.empty_like(rows)
        for cells, root in self._roots:
            columns[cells] = root @ rows[cells]
        return columns

    @cached_property
    def _zeros(self) -> FloatArray:
        """Basis ``(n_cells, r)`` of zeros of mountings and tilts of planes."""
        columns = np.hstack([incidence(self.means.mount), tilts(self.means)])
        shown = self._independent(columns)
        return basis_of(shown / lengths(shown), DEPENDENT)

    def _independent(self, columns: FloatArray) -> FloatArray:
        if not self.serial:
            return np.asarray(columns / np.sqrt(self.variance_mm2)[:, None])
        whitened = np.empty_like(columns)
        for rows, root in self._roots:
            whitened[rows] = np.linalg.solve(root, columns[rows])
        return whitened

    @cached_property
    def _roots(self) -> list[tuple[IntArray, FloatArray]]:
        """Of each mounting its cells, and the Cholesky root of the covariance of their means."""
        shared = self.noise.quantisation_mm2(self.means) if self.noise else np.zeros(0)
        return [
            (cells, np.linalg.cholesky(inverse @ inverse.T + np.diag(shared[cells])))
            for _, cells, _, inverse in _by_mounting(
                self.visited, self.cell, self.scatter_mm2, self.serial
            )
        ]

    def in_time(self, columns: FloatArray) -> FloatArray:
        """What columns ``(n_visits, k)`` and readings do within cells: rows ``(k, 1 + k)``.

        The readings come first; independent, of unit variance.
        """
        rows = np.column_stack([columns, self.visited.value_mm])
        root = np.sqrt(self.scatter_mm2)[:, None]
        if self.serial:
            mountings = _by_mounting(self.visited, self.cell, self.scatter_mm2, self.serial)
            left = np.vstack(
                [
                    without(basis, independent(self.serial, rows[there] / root[there]))
                    for there, _, basis, _ in mountings
                ]
            )
        else:
            left = without_means(self.cell, 1.0 / self.scatter_mm2, rows) / root
        upper = np.linalg.qr(left, mode="r")[: columns.shape[1]]
        return np.column_stack([upper[:, -1], upper[:, :-1]])


def _by_mounting(
    visited: Observations, cell: IntArray, scatter_mm2: FloatArray, serial: float
) -> Iterator[tuple[IntArray, IntArray, FloatArray, FloatArray]]:
    """Of each mounting its visits, its cells, a basis of these, and the root of their covariance.

    The basis ``(n, c)`` is orthonormal among errors made independent; times the inverse root
    ``(c, c)`` it estimates the means.
    """
    for rows in visited.mountings:
        cells, number = np.unique(cell[rows], return_inverse=True)
        columns = np.eye(len(cells))[number] / np.sqrt(scatter_mm2[rows])[:, None]
        basis, upper = np.linalg.qr(independent(serial, columns))
        yield rows, cells, basis, np.linalg.inv(upper)


def _means(
    visited: Observations, cell: IntArray, scatter_mm2: FloatArray, serial: float
) -> tuple[Observations, FloatArray]:
    """Means of cells by least squares, and their variances ``(n_cells,)``, mm²."""
    rows = np.unique(cell, return_index=True)[1]
    both = np.column_stack([visited.value_mm, visited.time_s])
    if not serial:
        total = np.bincount(cell, 1.0 / scatter_mm2)
        value_mm, time_s = (np.bincount(cell, column / scatter_mm2) / total for column in both.T)
        variance = 1.0 / total
    else:
        value_mm, time_s, variance = (np.empty(len(rows)) for _ in range(3))
        for there, cells, basis, inverse in _by_mounting(visited, cell, scatter_mm2, serial):
            known = both[there] / np.sqrt(scatter_mm2[there])[:, None]
            value_mm[cells], time_s[cells] = (inverse @ (basis.T @ independent(serial, known))).T
            variance[cells] = (inverse**2).sum(axis=1)
    together = np.bincount(cell, visited.averaged).astype(np.float64)
    means = replace(visited.take(rows), value_mm=value_mm, averaged=together, time_s=time_s)
    return means, variance


def _square_within(cell: IntArray, scatter_mm2: FloatArray, value_mm: FloatArray) -> float:
    """Square sum of readings about the means of their cells, over their variances."""
    return float((without_means(cell, 1.0 / scatter_mm2, value_mm) ** 2 / scatter_mm2).sum())


def _underrated(
    visited: Observations, cell: IntArray, scatter_mm2: FloatArray, serial: float
) -> float:
    """Variance of correlated errors over what their repeats show: these follow each other.

    A steady drift of each mounting is no error.
    """
    square, free = 0.0, 0
    for rows, _, basis, _ in _by_mounting(visited, cell, scatter_mm2, serial):
        order = np.linspace(-1.0, 1.0, len(rows))
        both = (
            np.column_stack([order, visited.value_mm[rows]]) / np.sqrt(scatter_mm2[rows])[:, None]
        )
        drift, left = without(basis, independent(serial, both)).T
        along = float(drift @ drift)
        square += float(left @ left) - (float(drift @ left) ** 2 / along if along > 1e-9 else 0.0)
        free += max(len(rows) - basis.shape[1] - 1, 0)
    return square / free if free and square > 0.0 else 1.0


def _robust_weights(value_mm: FloatArray, cell: IntArray, scatter_mm2: FloatArray) -> FloatArray:
    """Weights ``(n_visits,)`` with which what lies far from its repeats does not pull the mean.

    Huber's: 1 up to `USUAL` standard deviations, from there on falling with the distance. A cell of
    few readings, of which one lies far, is known less well.
    """
    weight = np.ones(len(value_mm))
    share = 1.0 - 1.0 / np.bincount(cell)[cell]
    for _ in range(ROBUST_ROUNDS):
        off_mm = without_means(cell, weight / scatter_mm2, value_mm)
        distance = np.abs(off_mm) / np.sqrt(scatter_mm2 * np.maximum(share, 1e-9))
        weight = USUAL / np.maximum(np.where(share > 0.0, distance, 0.0), USUAL)
    return weight


def placed_columns(
    model: Model, taken: Conditions, effects: Sequence[Effect]
) -> dict[Placed, FloatArray]:
    """Derivatives ``(n, k)`` of readings by the values of each law at each place."""
    of_each = place_columns(model, taken, effects)
    return {
        (effect, place): columns
        for effect, places in zip(effects, of_each, strict=True)
        for place, columns in places.items()
    }


def depends_on_time(effect: Effect) -> bool:
    """Whether readings of one cell may differ by it."""
    return effect.kind == Kind.ENVIRONMENT or "per_" in effect.parameters[0].name


@dataclass(frozen=True, eq=False)
class Rows:
    """Readings of all sessions about a model of each, whitened, their zeros free.

    ``residual`` ``(n,)`` is measured less predicted; ``base`` ``(n, b)`` are derivatives by the
    lengths that sessions share, then by the joint offsets of each; ``columns`` ``(n, k)`` those of
    effects. The first ``cells`` rows are means of cells, the others what readings do within them.
    ``value`` ``(b,)`` is where the models have the base parameters, ``prior`` ``(b,)`` where they
    are expected, within ``spread`` ``(b,)``. ``free`` directions are left to readings beside zeros
    and joint offsets; ``freedom`` belongs to the noise. ``excess`` is the square sum of repeats
    that disagree, ``log_constant`` what evidences of other labels differ by as well.
    """

    residual: FloatArray
    base: FloatArray
    columns: FloatArray
    cells: int
    value: FloatArray
    prior: FloatArray
    spread: FloatArray
    free: int
    freedom: float
    excess: float
    log_constant: float


def rows_of(
    sessions: Sequence[Cells],
    models: Sequence[Model],
    placed: Sequence[Mapping[Placed, FloatArray]],
    widths: Mapping[Placed, int],
    *,
    within: bool = True,
) -> Rows:
    """The sessions about these models; ``placed`` are columns of laws in each, zero elsewhere.

    ``widths`` are how many values each law has, in the order of `Rows.columns`; without ``within``
    only the means of cells.
    """
    count = len(sessions)
    width, total = LENGTHS + 3 * count, sum(widths.values())
    starts = dict(zip(widths, np.cumsum([0, *widths.values()]).tolist(), strict=False))
    parts, timed_parts = [], []
    for number, (cells, model, laws) in enumerate(zip(sessions, models, placed, strict=True)):
        means = cells.means
        rows = np.zeros((len(means), 1 + width + total))
        rows[:, 0] = means.value_mm - model.readings(means)
        by_base = design_of(model, means, range(BASE), ())
        rows[:, 1 : 1 + LENGTHS] = by_base[:, 3:]
        first = 1 + LENGTHS + 3 * number
        rows[:, first : first + 3] = by_base[:, :3]
        for law, columns in laws.items():
            at = 1 + width + starts[law]
            rows[:, at : at + columns.shape[1]] = columns
        parts.append(cells.whitened(rows))
        timed = [law for law in laws if depends_on_time(law[0])]
        if within and timed and len(cells.visited) > len(means):
            by_law = placed_columns(model, cells.visited, [law[0] for law in timed])
            shown = cells.in_time(np.hstack([by_law[law] for law in timed]))
            more = np.zeros((len(shown), rows.shape[1]))
            more[:, 0] = shown[:, 0]
            index = [1 + width + starts[law] + k for law in timed for k in range(widths[law])]
            more[:, index] = shown[:, 1:]
            timed_parts.append(more)
    rows = np.vstack([*parts, *timed_parts])

    def base_of(values: Sequence[Sequence[float] | FloatArray]) -> FloatArray:
        return np.array([*values[0][3:], *(v for each in values for v in each[:3])])

    free = len(rows) + sum(len(cells.apart) for cells in sessions)
    free -= sum(set_up_unknowns(cells.means) + 3 for cells in sessions)
    freedom = sum(cells.freedom for cells in sessions)
    return Rows(
        rows[:, 0],
        rows[:, 1 : 1 + width],
        rows[:, 1 + width :],
        sum(map(len, parts)),
        base_of([model.parameters_mm for model in models]),
        base_of([cells.case.model.parameters_mm for cells in sessions]),
        base_of([cells.case.tolerance_mm for cells in sessions]),
        free,
        freedom,
        sum(cells.excess for cells in sessions),
        sum(cells.log_constant for cells in sessions) + _log_of_student(freedom, free),
    )


def _log_of_student(freedom: float, free: int) -> float:
    """What Student's t for so many readings has before the power of their square sum."""
    if not freedom or math.isinf(freedom):
        return 0.0
    whole = (freedom + free) / 2.0
    log_gammas = math.lgamma(whole) - math.lgamma(freedom / 2.0)
    return whole * math.log(freedom) + log_gammas - free / 2.0 * math.log(freedom / 2.0)
