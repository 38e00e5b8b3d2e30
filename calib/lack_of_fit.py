"""Does the model explain the means of the postures within the noise of the repeats?"""

from __future__ import annotations

import numpy as np

from calib.distributions import variance_ratio_p_value
from calib.linalg import without_means
from calib.noise import Noise
from calib.observations import FloatArray, Observations
from calib.solution import LackOfFit

LACK_OF_FIT_LEVEL = 0.01
"""Chance from which down the model is said to leave more than the noise."""


def lack_of_fit(
    visited: Observations, left_mm: FloatArray, parameter_count: float, noise: Noise
) -> LackOfFit | None:
    """Mean square of what the best fit leaves of the cell means, over their noise variance.

    ``left_mm`` ``(n_readings,)`` is measured minus predicted, zeros not yet taken out.
    ``parameter_count`` is the trace of what a fit makes of readings: less than the number of
    parameters where tolerances hold them (Hastie, Tibshirani, Friedman, section 7.6). None where
    nothing is free or the noise itself came from what the fit leaves.
    """
    first, cell = np.unique(visited.cell, return_index=True, return_inverse=True)[1:]
    free = round(len(first) - visited.mount_count - parameter_count, 6)
    if noise.source == "residuals" or free <= 0.0:
        return None
    together = np.bincount(cell, visited.averaged)
    mean = np.bincount(cell, visited.averaged * left_mm) / together
    mount, indicator = visited.mount[first], visited.indicator[first]
    shown = np.array([one.shown_mm2 for one in noise.indicators])[indicator]
    locked = np.array([one.locked_mm2 for one in noise.indicators])[indicator]
    weight = 1.0 / (shown / together + locked)
    statistic = float((weight * without_means(mount, weight, mean) ** 2).sum()) / free
    p_value = variance_ratio_p_value(statistic, free, noise.degrees_of_freedom)
    return LackOfFit(statistic, free, p_value)
