"""The tail areas and quantiles that are needed, without the start-up cost of scipy.stats."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import chdtrc, fdtrc, gammainc, ndtr, ndtri, stdtrit

from calib.arrays import FloatArray

COVERAGE = 0.95

EXACT = 1e-7
"""Relative: a quantile of mean squares is worked out to so much."""

LEAST_MEAN = 1e-150
"""A mean square that is none; its square is still a number."""

UNLIKELY = 0.001
"""Chance of what a fit leaves below which something else acts, whatever is likeliest: repeats that
did not leave their posture tell too little noise."""


def coverage_factor(degrees_of_freedom: float) -> float:
    """Factor k for a two-sided 95 % interval: Student's t, GUM G.3.2; normal if infinite."""
    return float(coverage_factors(np.array(degrees_of_freedom)))


def variance_ratio_p_value(ratio: float, numerator_df: float, denominator_df: float) -> float:
    """Chance of a variance ratio at least this large; denominator known if its df is infinite."""
    if math.isinf(denominator_df):
        return float(chdtrc(numerator_df, ratio * numerator_df))
    return float(fdtrc(numerator_df, denominator_df, ratio))


def coverage_factors(degrees_of_freedom: FloatArray) -> FloatArray:
    """`coverage_factor` of many degrees of freedom at once, same shape."""
    upper = (1.0 + COVERAGE) / 2.0
    normal = np.isinf(degrees_of_freedom)
    student = stdtrit(np.where(normal, 1.0, degrees_of_freedom), upper)
    return np.asarray(np.where(normal, ndtri(upper), student))


def mixture_uncertainties(
    weight: FloatArray, off: FloatArray, variance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Standard and expanded uncertainties ``(k,)`` of values by weighted normal models.

    ``weight`` ``(n,)`` sums to 1; ``off`` ``(n, k)`` are the models' means from the stated values,
    ``variance`` ``(n, k)`` theirs. The expanded one is half of the interval about the stated value
    that holds 95 %: of a mixture its ratio to the standard one may be any.
    """
    variance = np.maximum(variance, 1e-18)
    standard = np.sqrt(weight @ (variance + off**2))
    low, high, deviation = np.zeros(off.shape[1]), 30.0 * standard, np.sqrt(variance)
    for _ in range(60):
        half = (low + high) / 2.0
        inside = weight @ (ndtr((half - off) / deviation) - ndtr((-half - off) / deviation))
        low, high = np.where(inside < COVERAGE, half, low), np.where(inside < COVERAGE, high, half)
    return standard, np.asarray(high)


def mixture_moments(
    weight: FloatArray, means: FloatArray, variances: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Mean and standard deviation ``(...)`` of a mixture ``(n, ...)``, weights ``(n,)`` of sum 1.

    About the mean: a difference of squares may be negative by rounding.
    """
    mean = np.asarray(np.tensordot(weight, means, 1))
    return mean, np.sqrt(np.tensordot(weight, variances + (means - mean) ** 2, 1))


def root_quantile(
    weight: FloatArray, mean: FloatArray, variance: FloatArray, share: float
) -> float:
    """What so large a ``share`` of the roots of mean squares keeps, by weighted models ``(n,)``.

    In each the mean square, a sum of squares of normal values, has a gamma distribution with its
    ``mean`` and ``variance`` (Satterthwaite 1946). No single one has the long tail of a mixture.
    """
    mean = np.maximum(mean, LEAST_MEAN)
    variance = np.maximum(variance, 1e-12 * mean**2)
    shape, scale = mean**2 / variance, variance / mean
    low, high = 0.0, float((mean + 20.0 * np.sqrt(variance)).max())
    while high - low > EXACT * high:
        middle = (low + high) / 2.0
        below = float((weight * gammainc(shape, middle / scale)).sum() / weight.sum())
        low, high = (middle, high) if below < share else (low, middle)
    return math.sqrt(high)


def normal_scores(values: FloatArray) -> FloatArray:
    """Quantiles ``(n,)`` of the standard normal that the ranks of values have (Blom, 1958)."""
    rank = np.empty(len(values))
    rank[np.argsort(values, kind="stable")] = np.arange(1, len(values) + 1)
    return np.asarray(ndtri((rank - 0.375) / (len(values) + 0.25)))
