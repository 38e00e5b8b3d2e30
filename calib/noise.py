"""How much a single reading scatters, and how well that is known."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from calib.observations import FloatArray, IntArray, Observations

NoiseSource = Literal["repeats", "instrument", "residuals"]


@dataclass(frozen=True)
class Noise:
    """Standard deviation of one single reading (mm), its degrees of freedom and its origin.

    Degrees of freedom are infinite for a stated instrument: taken as known (GUM 4.3, type B).
    """

    standard_deviation_mm: float
    degrees_of_freedom: float
    source: NoiseSource


@dataclass(frozen=True, eq=False)
class Cells:
    """Readings of one mounting in one posture form a cell: all of them should be equal.

    ``index`` ``(n_readings,)`` numbers the cells, ``mean_mm`` and ``weight`` have shape
    ``(n_cells,)``; ``pure_error_mm2`` is the weighted sum of squares within all cells and
    ``degrees_of_freedom`` how many free values that sum has.
    """

    index: IntArray
    mean_mm: FloatArray
    weight: FloatArray
    pure_error_mm2: float
    degrees_of_freedom: int

    def __len__(self) -> int:
        return len(self.mean_mm)


def cells(observed: Observations) -> Cells:
    """Group the readings by mounting and displacement."""
    keys = np.stack([observed.mount.astype(np.float64), observed.displacement_mm])
    index = np.unique(keys, axis=1, return_inverse=True)[1].ravel()
    weight = np.bincount(index, observed.averaged)
    mean = np.bincount(index, observed.averaged * observed.value_mm) / weight
    scatter = observed.averaged * (observed.value_mm - mean[index]) ** 2
    return Cells(
        index.astype(np.intp),
        mean,
        weight.astype(np.float64),
        float(scatter.sum()),
        len(observed) - len(mean),
    )


def instrument_noise(resolution_mm: float | None, repeatability_mm: float | None) -> Noise | None:
    """Noise of a stated instrument: repeatability as standard deviation, and the rounding.

    Rounding to a step r adds a uniform error of standard deviation ``r / sqrt(12)`` (GUM F.2.2.1).
    None where nothing was stated.
    """
    if not resolution_mm and not repeatability_mm:
        return None
    total = math.hypot(repeatability_mm or 0.0, (resolution_mm or 0.0) / math.sqrt(12.0))
    return Noise(total, math.inf, "instrument")


def reading_noise(
    observed: Observations,
    resolution_mm: float | None = None,
    repeatability_mm: float | None = None,
) -> Noise | None:
    """Noise from repeats where there are any, else from the stated instrument, else None.

    Repeats pool the scatter within cells. Repeats that agree better than the indicator can resolve
    say nothing; then the resolution rules.
    """
    grouped = cells(observed)
    if grouped.degrees_of_freedom > 0:
        scatter = math.sqrt(grouped.pure_error_mm2 / grouped.degrees_of_freedom)
        if scatter > (resolution_mm or 0.0) / math.sqrt(12.0):
            return Noise(scatter, float(grouped.degrees_of_freedom), "repeats")
    return instrument_noise(resolution_mm, repeatability_mm)
