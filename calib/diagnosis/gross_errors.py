"""Mistakes in the data, tried before any effect: turned signs, swapped indicators, wrong units.

A hypothesis transforms readings; the base parameters, held by their tolerances, are fitted to the
result. It counts when the likelihood rises by more than chance could among all hypotheses, when
most of the disagreement goes, and when the readings follow the prediction with about the slope that
the mistake would make (-1, 25.4, 1/25.4). Nothing in the record is changed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from calib.diagnosis.results import Named
from calib.diagnosis.selection import LOG_UNIT
from calib.identify.fit import without_zeros
from calib.noise.repeats import Repeats
from calib.observations import LEG_NAMES, TOOL, TOUCHED_LETTERS, FloatArray, IntArray, Observations
from calib.ties import descending
from calib.tripod.differences import reading_matrix
from calib.tripod.pipeline import Model

INCH_MM = 25.4
LEAST_RATIO = 4.0
"""The disagreement (square sum) must shrink by so much."""

SLOPE_FACTOR = 2.0
"""The slope of measured on predicted may be off by this: nothing else comes near these slopes."""

ODDS = 100.0
DOUBTFUL_ODDS = 10.0

KEEP_SCALE = ("gauge_sign", "gauge_swap")
"""Mistakes that leave the scatter of readings as it is, so that likelihoods compare."""

MOST_SUSPECTED = 3


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


@dataclass(frozen=True, eq=False)
class _Hypothesis:
    id: str
    where: str
    title: str
    rows: IntArray
    value_mm: FloatArray
    slope: float
    log_scale: float


@dataclass(frozen=True)
class Suspicion:
    """A mistake that makes the readings likelier by more than chance among all that were tried.

    ``clear``: most of the disagreement goes, and the slope fits. ``log_tried`` is the price of
    having been chosen among all.
    """

    blunder: GrossError
    clear: bool
    log_tried: float

    @property
    def log_odds(self) -> float:
        """By so much the readings must be likelier for a mistake to be beyond doubt."""
        return self.log_tried + math.log(ODDS)

    @property
    def log_doubtful_odds(self) -> float:
        """By so much for one that is named beside what does almost as well."""
        return self.log_tried + math.log(DOUBTFUL_ODDS)

    @property
    def proven(self) -> bool:
        """Nothing else turns readings by a factor of 25.4; a swap could be an effect, too."""
        return self.clear and self.blunder.id == "unit_mixup"


def suspect_blunders(
    model: Model, observed: Observations, tolerance_mm: FloatArray
) -> tuple[Suspicion, ...]:
    """Mistakes that one may suspect, likeliest first: at most three, or one that is proven.

    One at a time can be found: look again in the corrected readings.
    """
    fit = _BaseFit(model, observed, tolerance_mm)
    tried = list(_hypotheses(observed))
    log_tried = math.log(max(len(tried), 1))
    before = fit.left(observed.value_mm)
    found: list[tuple[float, Suspicion]] = []
    for one in tried:
        after = fit.left(one.value_mm)
        gain = 0.5 * len(observed) * math.log(before / after) + one.log_scale
        shrinks = before * math.exp(2.0 * one.log_scale / len(observed)) / after
        clear = shrinks > LEAST_RATIO and fit.slope_fits(one)
        suspicion = Suspicion(_named(observed, one), clear, log_tried)
        if gain > suspicion.log_odds:
            found.append((gain, suspicion))
    ordered = [one for _, one in descending(found, lambda each: each[0], LOG_UNIT)]
    if ordered and ordered[0].proven:
        return (ordered[0],)
    return tuple(one for one in ordered if one.blunder.id in KEEP_SCALE)[:MOST_SUSPECTED]


def _named(observed: Observations, found: _Hypothesis) -> GrossError:
    corrected = replace(observed, value_mm=found.value_mm)
    return GrossError(found.id, found.where, found.title, found.rows, corrected)


def _hypotheses(observed: Observations) -> Iterator[_Hypothesis]:
    value = observed.value_mm
    for where, rows in _groups(observed):
        turned = value.copy()
        turned[rows] *= -1.0
        yield _Hypothesis("gauge_sign", where, "counted the wrong way", rows, turned, -1.0, 0.0)
        for factor, words in ((INCH_MM, "inches taken for mm"), (1 / INCH_MM, "mm for inches")):
            scaled = value.copy()
            scaled[rows] *= factor
            log_scale = len(rows) * math.log(factor)
            yield _Hypothesis("unit_mixup", where, words, rows, scaled, 1 / factor, log_scale)
    yield from _swaps(observed)


def _groups(observed: Observations) -> Iterator[tuple[str, IntArray]]:
    """Rows that one mistake may touch: a mounting, an indicator, everything."""
    everything = np.arange(len(observed))
    seen: set[tuple[int, ...]] = set()
    for rows in observed.mountings:
        yield place_of(observed, rows), rows
        seen.add(tuple(rows))
    for leg in (0, 1, 2, TOOL):
        for axis in range(3):
            rows = np.flatnonzero((observed.leg == leg) & (observed.axis == axis))
            if len(rows) and tuple(rows) not in seen:
                yield place_of(observed, rows), rows
                seen.add(tuple(rows))
    for indicator in range(observed.indicator_count):
        rows = np.flatnonzero(observed.indicator == indicator)
        if tuple(rows) not in seen and len(rows) < len(observed):
            yield f"indicator {indicator + 1}", rows
    if observed.mount_count > 1:
        yield "all", everything


def place_of(observed: Observations, rows: IntArray) -> str:
    """Leg (or ``t``, the tool) and axis of the first of these rows, in letters."""
    first = rows[0]
    return TOUCHED_LETTERS[observed.leg[first]] + LEG_NAMES[observed.axis[first]]


def _swaps(observed: Observations) -> Iterator[_Hypothesis]:
    """The two indicators of a leg exchanged: their readings change places, row by row."""
    for leg, there, words in _where_two_stand(observed):
        axes = [axis for axis in range(3) if axis != leg]
        first, second = (there[observed.axis[there] == axis] for axis in axes)
        if len(first) != len(second) or not len(first):
            continue
        if not np.array_equal(observed.displacement_mm[first], observed.displacement_mm[second]):
            continue
        value = observed.value_mm.copy()
        value[first], value[second] = observed.value_mm[second], observed.value_mm[first]
        rows = np.concatenate([first, second])
        yield _Hypothesis("gauge_swap", LEG_NAMES[leg], words, rows, value, 1, 0.0)


def _where_two_stand(observed: Observations) -> Iterator[tuple[int, IntArray, str]]:
    """Each leg, and each of its stations where there are several: rows, and the title."""
    for leg in range(3):
        of_leg = np.flatnonzero(observed.leg == leg)
        yield leg, of_leg, "indicators exchanged"
        stations = np.unique(observed.station[of_leg]).tolist()
        for station in stations if len(stations) > 1 else ():
            at_station = of_leg[observed.station[of_leg] == station]
            yield leg, at_station, f"indicators exchanged at station {station:g}"


class _BaseFit:
    """Base parameters, held by their tolerances, and zeros: linear, equal weights."""

    def __init__(self, model: Model, observed: Observations, tolerance_mm: FloatArray) -> None:
        self._observed = observed
        self._nominal = model.readings(observed)
        design = reading_matrix(model.geometry, observed)
        self._design = without_zeros(observed, observed.averaged, design)
        self._tolerance = tolerance_mm
        self._floor = self._scatter()

    def _scatter(self) -> float:
        """Middle variance of the mountings' repeats, mm²: one in wrong units must not count."""
        repeats = Repeats.of(self._observed)
        square = repeats.scatter(self._observed.value_mm[:, None])[:, 0] ** 2
        squares = np.bincount(self._observed.mount, square)
        free = np.bincount(self._observed.mount, 1.0 - repeats.leverage)
        judged = free > 0.5
        middle = float(np.median(squares[judged] / free[judged])) if judged.any() else 0.0
        return max(middle, 1e-10)

    def solve(self, value_mm: FloatArray, rows: IntArray | slice) -> FloatArray:
        """Parameters ``(6,)`` from these rows, with the scatter as weight of the tolerances."""
        left = without_zeros(self._observed, self._observed.averaged, value_mm - self._nominal)
        design, left = self._design[rows], left[rows]
        hold = np.diag(self._floor / self._tolerance**2)
        return np.asarray(np.linalg.solve(design.T @ design + hold, design.T @ left))

    def left(self, value_mm: FloatArray) -> float:
        """Square sum that the fit leaves, tolerances included, mm²."""
        x = self.solve(value_mm, slice(None))
        left = without_zeros(self._observed, self._observed.averaged, value_mm - self._nominal)
        rest = left - self._design @ x
        hold = self._floor * float(((x / self._tolerance) ** 2).sum())
        return float((rest**2).sum()) + hold + self._floor

    def slope_fits(self, one: _Hypothesis) -> bool:
        """Whether the raw readings follow what the other rows predict with the right slope."""
        observed = self._observed
        others = np.setdiff1d(np.arange(len(observed)), one.rows)
        if len(np.unique(observed.mount[others])) < 2 or one.id == "gauge_swap":
            return True
        x = self.solve(observed.value_mm, others)
        predicted = without_zeros(observed, observed.averaged, self._nominal) + self._design @ x
        measured = without_zeros(observed, observed.averaged, observed.value_mm)
        p, m = predicted[one.rows], measured[one.rows]
        if float(p @ p) < 25.0 * self._floor:
            return False
        slope = float(p @ m) / float(p @ p)
        return 1.0 / SLOPE_FACTOR <= slope / one.slope <= SLOPE_FACTOR
