"""How much a single reading scatters, and how well that is known."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from calib.observations import IntArray, Observations

NoiseSource = Literal["repeats", "instrument", "residuals"]

ROUNDING = 8 * float(np.finfo(np.float64).eps)
"""Relative scatter that floating point arithmetic alone makes of equal values."""

LEAST_NOISE_MM = 1e-9
"""Less than this is arithmetic, not measurement."""


@dataclass(frozen=True)
class Noise:
    """Standard deviation of one single reading (mm), its degrees of freedom and its origin.

    Degrees of freedom are infinite for a stated instrument: taken as known (GUM 4.3, type B).
    """

    standard_deviation_mm: float
    degrees_of_freedom: float
    source: NoiseSource


@dataclass(frozen=True)
class IndicatorFigures:
    """What is stated or seen of the indicators, in mm; None where nothing is known.

    ``repeatability_mm`` is a standard deviation. ``step_mm`` is the step in which the readings are
    written down; it tells when repeats are too equal to mean anything.
    """

    resolution_mm: float | None = None
    repeatability_mm: float | None = None
    step_mm: float | None = None

    def noise(self) -> Noise | None:
        """Noise of a single reading from resolution and repeatability, None where not stated.

        Rounding to a step r adds a standard deviation of ``r / sqrt(12)`` (GUM F.2.2.1).
        """
        if not self.resolution_mm and not self.repeatability_mm:
            return None
        rounding = (self.resolution_mm or 0.0) / math.sqrt(12.0)
        total = math.hypot(self.repeatability_mm or 0.0, rounding)
        return Noise(total, math.inf, "instrument") if total > LEAST_NOISE_MM else None


@dataclass(frozen=True, eq=False)
class Cells:
    """Readings of one mounting in one posture, approached from one side, form a cell.

    All readings of a cell should be equal. ``index`` ``(n_readings,)`` numbers the cells;
    ``pure_error_mm2`` is the weighted sum of squares within all of them, with
    ``degrees_of_freedom`` free values.
    """

    index: IntArray
    count: int
    pure_error_mm2: float
    degrees_of_freedom: int


def cells(observed: Observations) -> Cells:
    """Group the readings by mounting, displacement and direction of approach."""
    keys = np.stack(
        [observed.mount.astype(np.float64), observed.displacement_mm, observed.approach]
    )
    index = np.unique(keys, axis=1, return_inverse=True)[1].ravel().astype(np.intp)
    weight = np.bincount(index, observed.averaged)
    mean = np.bincount(index, observed.averaged * observed.value_mm) / weight
    scatter = observed.averaged * (observed.value_mm - mean[index]) ** 2
    return Cells(index, len(mean), float(scatter.sum()), len(observed) - len(mean))


def visits(observed: Observations) -> Observations:
    """Average what was read in place: readings of a mounting with no motion between them.

    Such repeats share the error of their approach, so they count as one reading, not as several.
    """
    visit = np.zeros(len(observed), dtype=np.intp)
    last: dict[int, tuple[float, int]] = {}
    count = 0
    for row, (mount, displacement) in enumerate(
        zip(observed.mount, observed.displacement_mm, strict=True)
    ):
        before = last.get(int(mount))
        if before is None or before[0] != displacement:
            before = (float(displacement), count)
            count += 1
        last[int(mount)] = before
        visit[row] = before[1]
    if count == len(observed):
        return observed
    first = np.unique(visit, return_index=True)[1]
    weight = np.bincount(visit, observed.averaged)
    mean = np.bincount(visit, observed.averaged * observed.value_mm) / weight
    return replace(
        observed.take(first), value_mm=mean, averaged=weight / np.bincount(visit).astype(np.float64)
    )


def reading_noise(visited: Observations, indicator: IndicatorFigures) -> Noise | None:
    """Noise from repeats where there are any, else from the stated instrument, else None.

    Repeats pool the scatter within cells of `visits`. Repeats that agree better than the indicator
    can show say nothing; then its resolution rules.
    """
    grouped = cells(visited)
    if grouped.degrees_of_freedom == 0:
        return indicator.noise()
    scatter = math.sqrt(grouped.pure_error_mm2 / grouped.degrees_of_freedom)
    step = max(indicator.resolution_mm or 0.0, indicator.step_mm or 0.0)
    rounding = ROUNDING * float(np.abs(visited.value_mm).max())
    if scatter > max(step / math.sqrt(12.0), rounding):
        return Noise(scatter, float(grouped.degrees_of_freedom), "repeats")
    if indicator.noise() is None and step > 0.0:
        return IndicatorFigures(resolution_mm=step).noise()
    return indicator.noise()
