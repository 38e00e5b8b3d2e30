"""From readings to joint offsets and leg lengths.

Three ways, told apart by ``method`` and ``weights``:

- ``linear``, ``equal``: the papers' pseudoinverse of system (11), which treats the differences as
  if each had noise of its own; its covariance is equation (12) with (14).
- ``linear``, ``covariance``: the same system weighted with (14), the best linear estimate.
- ``exact``: nonlinear least squares on raw readings with one zero for each mounting; the weighting
  by (14) is then implied, and missing zeros, repeats and extra displacements need no special care.
"""

from __future__ import annotations

import math

import numpy as np

from calib.distributions import coverage_factor, variance_ratio_p_value
from calib.errors import NotIdentifiable
from calib.fit import Fit, exact_fit, papers_fit, weighted_fit
from calib.identifiability import refuse_unseen, weak_directions
from calib.noise import IndicatorFigures, Noise, cells, reading_noise, visits
from calib.observations import FloatArray, Observations
from calib.orthoglide.differences import Differences, differences
from calib.orthoglide.geometry import PARAMETER_NAMES
from calib.orthoglide.model import Model
from calib.solution import SUBSETS, LackOfFit, Method, Solution, Subset, Weights


def identify(
    model: Model,
    observed: Observations,
    subset: Subset = "both",
    method: Method = "exact",
    *,
    weights: Weights = "equal",
    indicator: IndicatorFigures | None = None,
) -> Solution:
    """Identify the parameters of a subset; the others keep the model's values.

    ``weights`` matters for the linear method only. The indicator's figures serve as noise where
    there are no repeats. Raises NotIdentifiable where the readings do not determine the subset.
    """
    free = SUBSETS[subset]
    visited = visits(observed)
    measured = differences(model.geometry, visited)
    noise = reading_noise(visited, indicator or IndicatorFigures())
    efficient = weighted_fit(model, visited, free)
    refuse_unseen(efficient.information(visited), noise, free, subset)
    if method == "exact":
        efficient = exact_fit(model, visited, free)
        refuse_unseen(efficient.information(visited), noise, free, subset)
    papers = method == "linear" and weights == "equal"
    fit = papers_fit(model, visited, free, measured) if papers else efficient
    _refuse_impossible(model, fit)
    noise = noise or _noise_from_residuals(visited, efficient)
    covariance = _covariance(visited, fit, measured, noise, papers=papers)
    before = measured.combine @ model.readings(visited)
    predicted = measured.combine @ fit.predicted_mm
    return Solution(
        model=model.with_parameters(fit.parameters_mm),
        subset=subset,
        method=method,
        weights="equal" if papers else "covariance",
        names=tuple(PARAMETER_NAMES[k] for k in free),
        values_mm=fit.parameters_mm[list(free)],
        covariance_mm2=covariance,
        coverage_factor=coverage_factor(noise.degrees_of_freedom),
        differences=measured,
        difference_uncertainty_mm=noise.standard_deviation_mm
        * measured.unit_uncertainty(visited.averaged),
        predicted_mm=predicted,
        rms_before_mm=_rms(measured.value_mm - before),
        rms_after_mm=_rms(measured.value_mm - predicted),
        degrees_of_freedom=(
            len(measured) if method == "linear" else len(visited) - visited.mount_count
        )
        - len(free),
        noise=noise,
        lack_of_fit=_lack_of_fit(visited, efficient, noise),
        condition_number=float(np.linalg.cond(measured.combine @ fit.design)),
        weak_directions=weak_directions(covariance, free),
        residual_mm=fit.left_over(visited),
    )


def _refuse_impossible(model: Model, fit: Fit) -> None:
    """A parameter as long as a leg belongs to no machine of this kind."""
    worst = float(np.abs(fit.parameters_mm).max())
    if not worst < model.geometry.leg_length_mm:
        raise NotIdentifiable(
            "identified parameters",
            f"a value of {worst:.3g} mm",
            f"less than the leg length {model.geometry.leg_length_mm:g} mm",
            "Look for a wrong reading or unit.",
        )


def _covariance(
    visited: Observations, fit: Fit, measured: Differences, noise: Noise, *, papers: bool
) -> FloatArray:
    """Covariance ``(k, k)`` in mm²: the inverse information, or equation (12) with (14)."""
    variance = noise.standard_deviation_mm**2
    if not papers:
        return np.asarray(variance * np.linalg.inv(fit.information(visited)))
    system = measured.combine @ fit.design
    estimator = (measured.combine.T @ np.linalg.pinv(system).T).T
    return np.asarray(variance * (estimator / visited.averaged) @ estimator.T)


def _noise_from_residuals(visited: Observations, efficient: Fit) -> Noise:
    remaining = len(visited) - visited.mount_count - efficient.design.shape[1]
    if remaining <= 0:
        raise NotIdentifiable(
            "noise of the readings",
            f"{len(visited)} readings without repeats, no degree of freedom left",
            "repeats, or the indicator's resolution and repeatability",
            "Import the table again with --resolution and --repeatability.",
        )
    total = float((visited.averaged * efficient.left_over(visited) ** 2).sum())
    return Noise(math.sqrt(total / remaining), float(remaining), "residuals")


def _lack_of_fit(visited: Observations, efficient: Fit, noise: Noise) -> LackOfFit | None:
    """Mean square of the cell means about the best fit, over the noise variance.

    Always from the efficient fit: the papers' estimate leaves more by construction. None where
    nothing is free or the noise itself came from what the fit leaves.
    """
    grouped = cells(visited)
    free = grouped.count - visited.mount_count - efficient.design.shape[1]
    if noise.source == "residuals" or free <= 0:
        return None
    total = float((visited.averaged * efficient.left_over(visited) ** 2).sum())
    left = max(total - grouped.pure_error_mm2, 0.0)
    statistic = left / free / noise.standard_deviation_mm**2
    p_value = variance_ratio_p_value(statistic, free, noise.degrees_of_freedom)
    return LackOfFit(statistic, free, p_value)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))
