"""What the step of a display does to repeats: part of the error that they cannot show or reduce.

A reading is the true value plus a scatter of standard deviation sigma, rounded to a step q.
Averaged over where the true value lies within a step, the mean square error is
``sigma^2 + q^2/12``. Of it repeats in one posture show ``f``; the rest, ``B``, is the same in all
of them:

``B = q^2 sum_k exp(-4 pi^2 k^2 sigma^2/q^2) / (2 pi^2 k^2)``, ``f = sigma^2 + q^2/12 - B``

(Fourier series of the rounding error; B is q^2/12 where sigma is 0 and nothing from q/2 up.)
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.special import ndtr

from calib.arrays import FloatArray

RATIO_LIMIT = 1.0
"""From this ratio of scatter to step on B is less than 1e-17 of the step squared."""

GRID_POINTS = 4001
COARSE_POINTS = 201
PLACES = 100
STEPS_AROUND = 8
TERMS = 2000


def quantisation_variance(scatter_mm: FloatArray, step_mm: float) -> FloatArray:
    """The part B of the variance (mm²) that repeats in one posture share; shape of the scatter."""
    if step_mm <= 0.0:
        return np.zeros_like(scatter_mm)
    ratio, bias, _ = _table()
    return np.asarray(step_mm**2 * np.interp(scatter_mm / step_mm, ratio, bias))


def scatter_of_repeatability(repeatability_mm2: float, step_mm: float) -> float:
    """Scatter (mm) of readings before rounding whose repeats show this variance."""
    if step_mm <= 0.0 or repeatability_mm2 >= RATIO_LIMIT * step_mm**2:
        return float(np.sqrt(max(repeatability_mm2 - step_mm**2 / 12.0 * (step_mm > 0.0), 0.0)))
    ratio, _, repeatability = _table()
    return float(step_mm * np.interp(repeatability_mm2 / step_mm**2, repeatability, ratio))


def quantisation_of_repeatability(
    repeatability_mm2: FloatArray, step_mm: float, degrees_of_freedom: float | FloatArray
) -> FloatArray:
    """Estimate of the shared variance (mm²) from the variance that repeats show; same shape.

    B is a convex function of what is shown, so a shown variance that itself scatters would make B
    too large on average: that part, to second order, is taken off.
    """
    if step_mm <= 0.0:
        return np.zeros_like(repeatability_mm2)
    _, bias, repeatability = _table()
    relative = repeatability_mm2 / step_mm**2
    value = np.interp(relative, repeatability, bias, right=0.0)
    excess = np.interp(relative, repeatability, _excess(), right=0.0) / degrees_of_freedom
    return np.asarray(np.clip(value - excess, 0.0, 1.0 / 12.0) * step_mm**2)


@lru_cache(maxsize=1)
def _excess() -> FloatArray:
    """What scatter of the shown variance adds to the shared one, for one degree of freedom."""
    ratio, bias, repeatability = _table()
    bend = np.gradient(np.gradient(bias, repeatability), repeatability)
    coarse = np.linspace(0.0, RATIO_LIMIT, COARSE_POINTS)
    scatter = np.interp(ratio, coarse, [_scatter_of_repeatability(float(r)) for r in coarse])
    return np.asarray(0.5 * bend * scatter)


def _scatter_of_repeatability(ratio: float) -> float:
    """Variance of the shown variance of three rounded repeats, times its 2 degrees of freedom.

    Over all places within a step: mean of the fourth central moment over n, plus the variance of
    the second (the sampling variance of s² for n = 3, and that from place to place).
    """
    place = (np.arange(PLACES) + 0.5)[:, None] / PLACES
    edges = np.arange(-STEPS_AROUND, STEPS_AROUND + 1) + 0.5
    below = ndtr((edges - place) / max(ratio, 1e-6))
    chance = np.diff(below, axis=1)
    value = edges[1:] - 0.5
    mean = (chance * value).sum(axis=1, keepdims=True)
    square = (value - mean) ** 2
    second = (chance * square).sum(axis=1)
    fourth = (chance * square**2).sum(axis=1)
    return 2.0 * float((fourth / 3.0).mean() + second.var())


@lru_cache(maxsize=1)
def _table() -> tuple[FloatArray, FloatArray, FloatArray]:
    """Scatter, quantisation bias and repeatability variance for a step of 1, on a grid."""
    ratio = np.linspace(0.0, RATIO_LIMIT, GRID_POINTS)
    bias = np.zeros(GRID_POINTS)
    for k in range(1, TERMS + 1):
        near = slice(int(1.1 * GRID_POINTS / k))  # beyond it a term is below 1e-20
        bias[near] += np.exp(-4.0 * (np.pi * k * ratio[near]) ** 2) / (2.0 * (np.pi * k) ** 2)
    bias[0] = 1.0 / 12.0
    return ratio, bias, ratio**2 + 1.0 / 12.0 - bias
