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
from calib.fit import Fit, exact_fit, without_zeros
from calib.identifiability import refuse_unseen, weak_directions
from calib.noise import Noise, cells, reading_noise
from calib.observations import FloatArray, Observations
from calib.orthoglide.differences import Differences, differences
from calib.orthoglide.geometry import PARAMETER_NAMES
from calib.orthoglide.linear import reading_matrix
from calib.orthoglide.model import Model
from calib.solution import SUBSETS, LackOfFit, Method, Solution, Subset, Weights


def identify(
    model: Model,
    observed: Observations,
    subset: Subset = "both",
    method: Method = "exact",
    *,
    weights: Weights = "equal",
    resolution_mm: float | None = None,
    repeatability_mm: float | None = None,
) -> Solution:
    """Identify the parameters of a subset; the others keep the model's values.

    ``weights`` matters for the linear method only. The indicator's stated resolution and
    repeatability (mm) serve as noise where there are no repeats.
    Raises NotIdentifiable where the readings do not determine the subset.
    """
    free = SUBSETS[subset]
    measured = differences(model.geometry, observed)
    before = measured.combine @ model.readings(observed)
    best = _best_linear(model, observed, free)
    linear = best if weights == "covariance" else _papers_fit(model, observed, free, measured)
    noise = reading_noise(observed, resolution_mm, repeatability_mm)
    if method == "exact":
        refuse_unseen(_information(observed, linear.design), noise, free, subset)
        best = exact_fit(model, observed, free, linear.parameters_mm)
    fitted = best if method == "exact" else linear
    after = model.with_parameters(fitted.parameters_mm)
    left_over = without_zeros(observed, observed.value_mm - _predict(model, observed, best, method))
    remaining = _residual_degrees(observed, len(free))
    noise = noise or _noise_from_residuals(observed, left_over, remaining)
    refuse_unseen(_information(observed, fitted.design), noise, free, subset)
    covariance = _covariance(observed, fitted, measured, noise, method, weights)
    predicted = measured.combine @ _predict(model, observed, fitted, method)
    unit_covariance = measured.combine @ (measured.combine / observed.averaged).T
    return Solution(
        model=after,
        subset=subset,
        method=method,
        weights="covariance" if method == "exact" else weights,
        names=tuple(PARAMETER_NAMES[k] for k in free),
        values_mm=fitted.parameters_mm[list(free)],
        covariance_mm2=covariance,
        coverage_factor=coverage_factor(noise.degrees_of_freedom),
        differences=measured,
        difference_uncertainty_mm=noise.standard_deviation_mm * np.sqrt(np.diag(unit_covariance)),
        predicted_mm=predicted,
        rms_before_mm=_rms(measured.value_mm - before),
        rms_after_mm=_rms(measured.value_mm - predicted),
        degrees_of_freedom=remaining if method == "exact" else len(measured) - len(free),
        noise=noise,
        lack_of_fit=_lack_of_fit(observed, left_over, noise, len(free)),
        condition_number=float(np.linalg.cond(measured.combine @ fitted.design)),
        weak_directions=weak_directions(covariance, free),
        residual_mm=left_over,
    )


def _papers_fit(
    model: Model, observed: Observations, free: tuple[int, ...], measured: Differences
) -> Fit:
    """Pseudoinverse of system (11)."""
    design = reading_matrix(model.geometry, observed)[:, list(free)]
    left = measured.value_mm - measured.combine @ model.readings(observed)
    return _stepped(model, free, np.linalg.pinv(measured.combine @ design) @ left, design)


def _best_linear(model: Model, observed: Observations, free: tuple[int, ...]) -> Fit:
    """Weighted linear fit of readings with free zeros: system (11) weighted by (14)."""
    design = reading_matrix(model.geometry, observed)[:, list(free)]
    root_weight = np.sqrt(observed.averaged)
    left = root_weight[:, None] * without_zeros(observed, design)
    right = root_weight * without_zeros(observed, observed.value_mm - model.readings(observed))
    return _stepped(model, free, _least_squares(left, right), design)


def _stepped(model: Model, free: tuple[int, ...], step: FloatArray, design: FloatArray) -> Fit:
    parameters = np.array(model.parameters_mm)
    parameters[list(free)] += step
    return Fit(parameters, design)


def _least_squares(left: FloatArray, right: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.lstsq(left, right, rcond=None)[0], dtype=np.float64)


def _predict(model: Model, observed: Observations, fit: Fit, method: Method) -> FloatArray:
    """Readings that the fit predicts: through the pipeline, or through the linear system."""
    if method == "exact":
        return model.with_parameters(fit.parameters_mm).readings(observed)
    step = fit.parameters_mm - np.array(model.parameters_mm)
    return np.asarray(model.readings(observed) + reading_matrix(model.geometry, observed) @ step)


def _information(observed: Observations, design: FloatArray) -> FloatArray:
    """Information on the free parameters for unit noise ``(k, k)``, zeros fitted."""
    centred = without_zeros(observed, design)
    return np.asarray(centred.T @ (observed.averaged[:, None] * centred))


def _covariance(
    observed: Observations,
    fit: Fit,
    measured: Differences,
    noise: Noise,
    method: Method,
    weights: Weights,
) -> FloatArray:
    """Covariance ``(k, k)`` in mm²: equation (12) with (14), or the inverse information."""
    variance = noise.standard_deviation_mm**2
    if method == "exact" or weights == "covariance":
        return np.asarray(variance * np.linalg.inv(_information(observed, fit.design)))
    estimator = np.linalg.pinv(measured.combine @ fit.design) @ measured.combine
    return np.asarray(variance * (estimator / observed.averaged) @ estimator.T)


def _residual_degrees(observed: Observations, parameter_count: int) -> int:
    return len(observed) - observed.mount_count - parameter_count


def _noise_from_residuals(observed: Observations, left_over: FloatArray, remaining: int) -> Noise:
    if remaining <= 0:
        raise NotIdentifiable(
            "noise of the readings",
            f"{len(observed)} readings without repeats, no degree of freedom left",
            "repeats, or the indicator's resolution and repeatability",
            "Import the table again with --resolution and --repeatability.",
        )
    total = float((observed.averaged * left_over**2).sum())
    return Noise(math.sqrt(total / remaining), float(remaining), "residuals")


def _lack_of_fit(
    observed: Observations, left_over: FloatArray, noise: Noise, parameter_count: int
) -> LackOfFit | None:
    """Mean square of the cell means about the model, over the noise; None if nothing is free."""
    grouped = cells(observed)
    free = len(grouped) - observed.mount_count - parameter_count
    if noise.source == "residuals" or free <= 0 or not noise.standard_deviation_mm > 0.0:
        return None
    left = float((observed.averaged * left_over**2).sum()) - grouped.pure_error_mm2
    statistic = max(left, 0.0) / free / noise.standard_deviation_mm**2
    p_value = variance_ratio_p_value(statistic, free, noise.degrees_of_freedom)
    return LackOfFit(statistic, free, p_value)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))
