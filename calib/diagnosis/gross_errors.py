"""Mistakes in the data, tried before any effect: stands that moved, signs, swaps, wrong units.

A set-up shift is told from drift and from a single outlier by repeats of the same approach; no
model and no effect matters there. Where they cannot tell, as between two cycles, all readings of a
posture judge, with one play for each mounting.

Any other hypothesis transforms readings; the base parameters, held by their tolerances, are fitted
to the result. It counts when the likelihood rises by more than chance could among all hypotheses,
when most of the disagreement goes, and when the readings follow the prediction with about the slope
that the mistake would make (-1, 25.4, 1/25.4). Nothing in the record is changed.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from calib.arrays import (
    DEPENDENT,
    LEG_NAMES,
    NEW_DIRECTION,
    TOUCHED_LETTERS,
    FloatArray,
    IntArray,
    Observations,
    basis_of,
    descending,
    incidence,
    largest,
    lengths,
    numbered,
    onto,
    rows_of,
    without,
    without_means,
    without_zeros,
)
from calib.diagnosis.policy import POLICY
from calib.diagnosis.results import Named
from calib.diagnosis.selection import LOG_UNIT
from calib.noise.display import INCH_MM
from calib.noise.reading import LEAST_NOISE_MM
from calib.noise.repeats import Repeats
from calib.tripod.differences import reading_matrix
from calib.tripod.pipeline import Model

LEAST_VARIANCE_MM2 = 1e-8
"""(0.1 µm)²: beside repeats that happen to be equal anything else would be a mistake."""

BETTER = 0.5
"""A shift must leave less than this share of what drift or one outlier leaves."""

LEAST_RATIO = 4.0
"""The disagreement (square sum) must shrink by so much."""

CHANGES = (
    ("gauge_sign", "sign reversed", -1.0),
    ("unit_mixup", "inch recorded as mm", INCH_MM),
    ("unit_mixup", "mm recorded as inch", 1 / INCH_MM),
)
"""Mistakes of an indicator: name, words, and the factor that sets its readings right."""

SLOPE_FACTOR = 2.0
"""The slope of measured on predicted may be off by this: nothing else comes near these slopes."""

KEEP_SCALE = ("gauge_sign", "gauge_swap")
"""Mistakes that leave the scatter of readings as it is, so that likelihoods compare."""


@dataclass(frozen=True, eq=False)
class GrossError:
    """A mistake: its name and place, the rows it touches, and the data as they should be.

    ``corrected`` holds the session without the mistake: transformed readings, or fewer of them.
    ``or_else`` names what else would leave about the same readings.
    """

    id: str
    where: str
    title: str
    rows: IntArray
    corrected: Observations
    or_else: tuple[Named, ...] = ()


def place_of(observed: Observations, rows: IntArray) -> str:
    """Leg (or ``t``, the tool) and axis of the first of these rows, in letters."""
    first = rows[0]
    return TOUCHED_LETTERS[observed.leg[first]] + LEG_NAMES[observed.axis[first]]


def words_of(observed: Observations, row: int) -> str:
    """Posture and cycle of a reading."""
    return f"at {observed.posture_words(row)}, cycle {observed.cycle[row]}"


def find_shift(observed: Observations) -> GrossError | None:
    """The clearest shift of a stand, or None. Judged by repeats alone, without a model."""
    noise = _robust_variance(observed)
    tried = (_clear_step(observed, rows, noise) for rows in observed.mountings if noise)
    best = max((step for step in tried if step), key=lambda step: step[0], default=None)
    if best is None:
        return None
    _, shift_mm, rows = best
    corrected = observed.value_mm.copy()
    corrected[rows] -= shift_mm
    title = (
        f"the stand moved by {shift_mm:+.4f} mm before the reading {words_of(observed, rows[0])}"
    )
    put_back = replace(observed, value_mm=corrected)
    return GrossError("stand_slip", place_of(observed, rows), title, rows, put_back)


def _robust_variance(observed: Observations) -> float:
    """Median over the mountings of the variance within cells, mm²; 0 without repeats."""
    found = []
    for rows in observed.mountings:
        cells = cell_basis(observed, rows)
        free = len(rows) - cells.shape[1]
        if free > 0:
            residual = without(cells, observed.value_mm[rows])
            found.append(float(residual @ residual) / free)
    return max(float(np.median(found)), LEAST_VARIANCE_MM2) if found else 0.0


def _clear_step(
    observed: Observations, rows: IntArray, noise: float
) -> tuple[float, float, IntArray] | None:
    """What a step of one mounting explains, its size in mm and the rows moved; None without any.

    By repeats of one approach; where they cannot tell, by all readings of a posture.
    """
    count = len(rows)
    if count < 4:  # two readings on each side of a step
        return None
    order = np.arange(count, dtype=np.float64)
    for basis_of_repeats in (cell_basis, posture_basis):
        basis = basis_of_repeats(observed, rows)
        value = without(basis, observed.value_mm[rows])
        alone = np.column_stack([value, basis])
        from_row_on = np.cumsum(alone[::-1], axis=0)[::-1]
        slopes, gains = _explained(from_row_on, count - order)
        k = 2 + largest(gains[2:-1])
        gain = float(gains[k])
        if gain < POLICY.shift_variances * noise:
            return None
        outliers = _explained(alone, np.ones(count))[1]
        drift = _explained(order[None] @ alone, order[None] @ order)[1]
        total, beside = float(value @ value), max(float(drift[0]), float(outliers.max()))
        if max(total - gain, noise) <= BETTER * (total - beside):
            return gain, float(slopes[k]), rows[k:]
    return None


def _explained(products: FloatArray, squares: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Coefficients ``(k,)`` of columns given a basis, and what they explain of a value beside it.

    ``products`` ``(k, 1 + r)`` of each with value and basis, ``squares`` ``(k,)`` with itself.
    """
    share = squares - (products[:, 1:] ** 2).sum(axis=1)
    seen = share >= NEW_DIRECTION**2
    slope = np.where(seen, products[:, 0] / np.where(seen, share, 1.0), 0.0)
    return slope, slope**2 * share


def cell_basis(observed: Observations, rows: IntArray) -> FloatArray:
    """Orthonormal: one column for each posture and approach."""
    cells = incidence(numbered(observed.cell[rows]))
    return cells / lengths(cells)


def level_basis(observed: Observations, rows: IntArray) -> FloatArray:
    """Orthonormal: one column for each posture, whatever the approach."""
    levels = incidence(numbered(observed.level[rows]))
    return levels / lengths(levels)


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


@dataclass(frozen=True)
class Suspicion:
    """A mistake that makes the readings likelier by more than chance among all that were tried.

    ``clear``: most of the disagreement goes, and the slope fits. ``log_tried`` is the log prior of
    having been chosen among all.
    """

    error: GrossError
    clear: bool
    log_tried: float

    @property
    def proven(self) -> bool:
        """Nothing else turns readings by a factor of 25.4; a swap could be an effect, too."""
        return self.clear and self.error.id == "unit_mixup"


def suspicions(
    model: Model, observed: Observations, tolerance_mm: FloatArray
) -> tuple[Suspicion, ...]:
    """Mistakes that one may suspect, likeliest first: at most three, or one that is proven.

    One at a time can be found: look again in the corrected readings.
    """
    fit = _BaseFit(model, observed, tolerance_mm)
    tried = list(_hypotheses(observed))
    log_tried = math.log(max(len(tried), 1))
    values = [observed.value_mm, *(error.corrected.value_mm for error, _, _ in tried)]
    before, *every = fit.square_sums(np.column_stack(values)).tolist()
    found: list[tuple[float, Suspicion]] = []
    for (error, slope, log_scale), after in zip(tried, every, strict=True):
        gain = 0.5 * len(observed) * math.log(before / after) + log_scale
        shrinks = before * math.exp(2.0 * log_scale / len(observed)) / after
        clear = shrinks > LEAST_RATIO and fit.slope_fits(error, slope)
        if gain > log_tried + math.log(POLICY.odds):
            found.append((gain, Suspicion(error, clear, log_tried)))
    ordered = [one for _, one in descending(found, lambda each: each[0], LOG_UNIT)]
    if ordered and ordered[0].proven:
        return (ordered[0],)
    return tuple(one for one in ordered if one.error.id in KEEP_SCALE)[: POLICY.most_causes]


def _hypotheses(observed: Observations) -> Iterator[tuple[GrossError, float, float]]:
    """Mistakes, the slope that each would make, and the log of the scale that it takes away."""
    moved = np.abs(without_means(observed.mount, observed.averaged, observed.value_mm))
    for where, rows in _groups(observed):
        if moved[rows].max() < LEAST_NOISE_MM:  # a factor would change zeros of mountings only
            continue
        for name, words, factor in CHANGES:
            value = observed.value_mm.copy()
            value[rows] *= factor
            corrected = replace(observed, value_mm=value)
            log_scale = len(rows) * math.log(abs(factor))
            yield GrossError(name, where, words, rows, corrected), 1 / factor, log_scale
    for error in _swaps(observed):
        yield error, 1.0, 0.0


def _groups(observed: Observations) -> Iterable[tuple[str, IntArray]]:
    """Rows that one mistake may touch: a mounting, an indicator, everything."""
    places = [*observed.mountings, *rows_of(numbered(observed.leg, observed.axis))]
    groups = [(place_of(observed, rows), rows) for rows in places]
    groups.append(("all", np.arange(len(observed))))
    indicators = enumerate(rows_of(observed.indicator), start=1)
    groups += [(f"indicator {number}", rows) for number, rows in indicators]
    found: dict[tuple[int, ...], tuple[str, IntArray]] = {}
    for where, rows in groups:
        found.setdefault(tuple(rows.tolist()), (where, rows))
    return found.values()


def _swaps(observed: Observations) -> Iterator[GrossError]:
    """The two indicators of a leg exchanged, everywhere or at one of its several stations."""
    for leg in range(3):
        of_leg = np.flatnonzero((observed.leg == leg) & ~observed.over_plane)
        stations = np.unique(observed.station[of_leg]).tolist()
        tried = [(of_leg, "indicators exchanged")]
        for station in stations if len(stations) > 1 else ():
            there = of_leg[observed.station[of_leg] == station]
            tried.append((there, f"indicators exchanged at station {station:g}"))
        axes = [axis for axis in range(3) if axis != leg]
        for there, words in tried:
            first, second = (there[observed.axis[there] == axis] for axis in axes)
            levels = [observed.displacement_mm[rows] for rows in (first, second)]
            if len(first) and np.array_equal(*levels):
                value = observed.value_mm.copy()
                value[first], value[second] = observed.value_mm[second], observed.value_mm[first]
                rows = np.concatenate([first, second])
                corrected = replace(observed, value_mm=value)
                yield GrossError("gauge_swap", LEG_NAMES[leg], words, rows, corrected)


class _BaseFit:
    """Base parameters, held by their tolerances, and zeros: linear, equal weights."""

    def __init__(self, model: Model, observed: Observations, tolerance_mm: FloatArray) -> None:
        self._observed = observed
        self._nominal = model.readings(observed)
        self._design = self._centred(reading_matrix(model.geometry, observed))
        self._tolerance = tolerance_mm
        repeats = Repeats.of(observed)
        square = repeats.scatter(observed.value_mm[:, None])[:, 0] ** 2
        squares = np.bincount(observed.mount, square)
        free = np.bincount(observed.mount, 1.0 - repeats.leverage)
        judged = free > 0.5
        # the middle variance of the mountings, mm²: one in wrong units must not count
        middle = float(np.median(squares[judged] / free[judged])) if judged.any() else 0.0
        self._floor = max(middle, 1e-10)

    def _centred(self, rows: FloatArray) -> FloatArray:
        return without_zeros(self._observed, self._observed.averaged, rows)

    def _solved(self, residual: FloatArray, rows: IntArray | slice) -> FloatArray:
        """Parameters ``(6,)`` or ``(6, k)`` from these rows; the scatter weighs the tolerances."""
        design = self._design[rows]
        hold = np.diag(self._floor / self._tolerance**2)
        return np.asarray(np.linalg.solve(design.T @ design + hold, design.T @ residual[rows]))

    def square_sums(self, value_mm: FloatArray) -> FloatArray:
        """What the fit leaves ``(k,)``, tolerances included, mm², of values ``(n, k)``."""
        residual = self._centred(value_mm - self._nominal[:, None])
        x = self._solved(residual, slice(None))
        rest = residual - self._design @ x
        hold = ((x / self._tolerance[:, None]) ** 2).sum(axis=0) + 1.0
        return np.asarray((rest**2).sum(axis=0) + self._floor * hold)

    def slope_fits(self, error: GrossError, slope: float) -> bool:
        """Whether the raw readings follow what the other rows predict with the right slope."""
        observed = self._observed
        others = np.setdiff1d(np.arange(len(observed)), error.rows)
        if len(np.unique(observed.mount[others])) < 2 or error.id == "gauge_swap":
            return True
        x = self._solved(self._centred(observed.value_mm - self._nominal), others)
        predicted = (self._centred(self._nominal) + self._design @ x)[error.rows]
        measured = self._centred(observed.value_mm)[error.rows]
        size = float(predicted @ predicted)
        if size < POLICY.decisive * self._floor:
            return False
        found = float(predicted @ measured) / size
        return 1.0 / SLOPE_FACTOR <= found / slope <= SLOPE_FACTOR
