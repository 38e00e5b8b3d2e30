"""Mistakes in the data, tried before any effect: turned signs, swapped indicators, wrong units.

A hypothesis transforms readings; the base parameters, held by their tolerances, are fitted to the
result. It counts when the likelihood rises by more than chance could among all hypotheses, when
most of the disagreement goes, and when the readings follow the prediction with just the slope that
the mistake would make (-1, 25.4, 1/25.4). Nothing in the record is changed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from calib.fit import without_zeros
from calib.observations import LEG_NAMES, FloatArray, IntArray, Observations
from calib.orthoglide.linear import reading_matrix
from calib.orthoglide.model import Model
from calib.repeats import Repeats

INCH_MM = 25.4
LEAST_RATIO = 4.0
"""The disagreement (square sum) must shrink by so much."""

SLOPE_TOLERANCE = 0.25
ODDS = 100.0

WILD_DISTANCE = 15.0
"""In standard deviations; far beyond what heavy tails of honest readings reach."""

SAME_VALUE = 4.0
"""A reading belongs to another posture when it is within so many standard deviations of it."""

MOST_WILD = 4


@dataclass(frozen=True, eq=False)
class Blunder:
    """A mistake: its name and place, the rows it touches, and the data as they should be.

    ``corrected`` holds the session without the mistake: transformed readings, or fewer of them.
    """

    id: str
    where: str
    title: str
    rows: IntArray
    corrected: Observations


@dataclass(frozen=True, eq=False)
class _Hypothesis:
    id: str
    where: str
    title: str
    rows: IntArray
    value_mm: FloatArray
    slope: float
    log_scale: float


def find_blunder(model: Model, observed: Observations, tolerance_mm: FloatArray) -> Blunder | None:
    """The one mistake that the readings shout, or None. One at a time: look again afterwards."""
    fit = _BaseFit(model, observed, tolerance_mm)
    tried = list(_hypotheses(observed))
    if not tried:
        return None
    bar = math.log(ODDS * len(tried))
    before = fit.left(observed.value_mm)
    best: tuple[float, _Hypothesis] | None = None
    for one in tried:
        after = fit.left(one.value_mm)
        gain = 0.5 * len(observed) * math.log(before / after) + one.log_scale
        shrinks = before * math.exp(2.0 * one.log_scale / len(observed)) / after
        better = best is None or gain > best[0]
        if gain > bar and shrinks > LEAST_RATIO and better and fit.slope_fits(one):
            best = gain, one
    if best is None:
        return None
    found = best[1]
    return Blunder(
        found.id,
        found.where,
        found.title,
        found.rows,
        replace(observed, value_mm=found.value_mm),
    )


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
    for mount in range(observed.mount_count):
        rows = np.flatnonzero(observed.mount == mount)
        yield _place(observed, rows), rows
        seen.add(tuple(rows))
    for leg in range(3):
        for axis in range(3):
            rows = np.flatnonzero((observed.leg == leg) & (observed.axis == axis))
            if len(rows) and tuple(rows) not in seen:
                yield _place(observed, rows), rows
                seen.add(tuple(rows))
    for indicator in range(observed.indicator_count):
        rows = np.flatnonzero(observed.indicator == indicator)
        if tuple(rows) not in seen and len(rows) < len(observed):
            yield f"indicator {indicator + 1}", rows
    if observed.mount_count > 1:
        yield "all", everything


def _place(observed: Observations, rows: IntArray) -> str:
    first = rows[0]
    return LEG_NAMES[observed.leg[first]] + LEG_NAMES[observed.axis[first]]


def _swaps(observed: Observations) -> Iterator[_Hypothesis]:
    """The two indicators of a leg exchanged: their readings change places, row by row."""
    for leg in range(3):
        axes = [axis for axis in range(3) if axis != leg]
        first, second = (
            np.flatnonzero((observed.leg == leg) & (observed.axis == axis)) for axis in axes
        )
        if len(first) != len(second) or not len(first):
            continue
        if not np.array_equal(observed.displacement_mm[first], observed.displacement_mm[second]):
            continue
        value = observed.value_mm.copy()
        value[first], value[second] = observed.value_mm[second], observed.value_mm[first]
        rows = np.concatenate([first, second])
        yield _Hypothesis("gauge_swap", LEG_NAMES[leg], "indicators exchanged", rows, value, 1, 0.0)


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
        """Square sum that repeats explain: nothing shrinks below it."""
        repeats = Repeats.of(self._observed)
        square = float(repeats.sums_of_squares(self._observed.value_mm[:, None]).sum())
        free = float(repeats.degrees_of_freedom.sum())
        return max(square / max(free, 1.0), 1e-10)

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
        return abs(slope - one.slope) <= SLOPE_TOLERANCE * abs(one.slope)


def set_wild_aside(observed: Observations) -> tuple[Observations, tuple[Blunder, ...]]:
    """Readings far from their repeats are left out, each named: wrong label, or simply wild."""
    found: list[Blunder] = []
    rest = observed
    for _ in range(MOST_WILD):
        row = _wildest(rest)
        if row is None:
            break
        kept = np.delete(np.arange(len(rest)), row)
        where = _place(rest, np.array([row]))
        posture = f"at {rest.displacement_mm[row]:+g} mm, cycle {rest.cycle[row]}"
        belongs = belongs_elsewhere(rest, row)
        title = (
            f"the reading {posture} belongs to {belongs}"
            if belongs is not None
            else f"one wild reading {posture}"
        )
        name = "wild_reading" if belongs is None else "label_error"
        rest = rest.take(kept)
        found.append(Blunder(name, where, title, np.array([row]), rest))
    return rest, tuple(found)


def _wildest(observed: Observations) -> int | None:
    """The row furthest from its own repeats, if it is far beyond all others."""
    repeats = Repeats.of(observed)
    free = float(repeats.degrees_of_freedom.sum())
    share = 1.0 - repeats.leverage
    if free <= 4.0:
        return None
    left = repeats.scatter(observed.value_mm[:, None])[:, 0]
    own = np.where(share > 1e-6, left**2 / np.maximum(share, 1e-6), 0.0)
    row = int(own.argmax())
    others = (float((left**2).sum()) - own[row]) / (free - 1.0)
    floor = (1e-4) ** 2
    return row if own[row] > WILD_DISTANCE**2 * max(others, floor) else None


def belongs_elsewhere(observed: Observations, row: int) -> str | None:
    """The posture of the same mounting, or the other leg, whose readings this one equals."""
    same = np.flatnonzero(observed.mount == observed.mount[row])
    spread = _typical_scatter(observed, row)
    for level in np.unique(observed.displacement_mm[same]):
        if level == observed.displacement_mm[row]:
            continue
        cell = same[observed.displacement_mm[same] == level]
        if abs(observed.value_mm[row] - observed.value_mm[cell].mean()) < SAME_VALUE * spread:
            return f"{level:+g} mm"
    return _other_leg(observed, row, spread)


def _other_leg(observed: Observations, row: int, spread: float) -> str | None:
    """The other leg measured along the same axis, in the same posture, if the value is equal."""
    cell = np.flatnonzero(
        (observed.axis == observed.axis[row])
        & (observed.leg != observed.leg[row])
        & (observed.displacement_mm == observed.displacement_mm[row])
        & (observed.station == observed.station[row])
    )
    for leg in np.unique(observed.leg[cell]):
        mean = observed.value_mm[cell[observed.leg[cell] == leg]].mean()
        if abs(observed.value_mm[row] - mean) < SAME_VALUE * spread:
            return f"leg {LEG_NAMES[leg].upper()}"
    return None


def _typical_scatter(observed: Observations, row: int) -> float:
    rest = observed.take(np.delete(np.arange(len(observed)), row))
    repeats = Repeats.of(rest)
    free = max(float(repeats.degrees_of_freedom.sum()), 1.0)
    square = float(repeats.sums_of_squares(rest.value_mm[:, None]).sum())
    return max(math.sqrt(square / free), 1e-4)
