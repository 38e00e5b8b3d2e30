"""From readings to joint offsets and leg lengths.

Three ways, told apart by ``method`` and ``weights``:

- ``linear``, ``equal``: the papers' pseudoinverse of system (11), which treats the differences as
  if each had noise of its own; its covariance is equation (12) with (14).
- ``linear``, ``covariance``: the same system weighted with (14), the best linear estimate.
- ``exact``: nonlinear least squares on raw readings with one zero for each mounting; the weighting
  by (14) is then implied, and missing zeros, repeats and extra displacements need no special care.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from calib.design.identifiability import Identifiability, analyse, refuse_unseen
from calib.errors import NotIdentifiable
from calib.identify.fit import Fit, exact_fit, papers_fit, prior_fit, weighted_fit, without_zeros
from calib.identify.propagation import Propagation, propagate, uncertainties
from calib.identify.solution import SUBSETS, Method, Solution, Subset, Weights, lack_of_fit
from calib.noise.reading import (
    IndicatorFigures,
    IndicatorNoise,
    Noise,
    reading_noise,
    reading_weights,
    visits,
)
from calib.observations import FloatArray, Observations
from calib.stats import coverage_factor
from calib.tripod.differences import Differences, differences
from calib.tripod.geometry import PARAMETER_NAMES
from calib.tripod.pipeline import Model
from calib.tripod.sensitivity import sensitivity_of_readings


def identify(
    model: Model,
    observed: Observations,
    subset: Subset = "both",
    method: Method = "exact",
    *,
    weights: Weights = "equal",
    indicator: IndicatorFigures | None = None,
    tolerance_mm: FloatArray | None = None,
) -> Solution:
    """Identify the parameters of a subset; the others keep the model's values.

    ``weights`` matters for the linear method only. The indicator's figures serve as noise where
    there are no repeats. The subset ``with-tolerances`` needs ``tolerance_mm`` ``(6,)``, takes the
    exact method and always determines everything; its covariance holds the tolerances too. Raises
    NotIdentifiable where the readings do not determine the subset.
    """
    told = Told.of(model, observed, indicator or IndicatorFigures())
    return identify_from(told, subset, method, weights=weights, tolerance_mm=tolerance_mm)


@dataclass(frozen=True, eq=False)
class Told:
    """What readings tell before any set of parameters is chosen; ``noise`` None: nothing of it."""

    model: Model
    visited: Observations
    measured: Differences
    noise: Noise | None

    @classmethod
    def of(cls, model: Model, observed: Observations, indicator: IndicatorFigures) -> Self:
        """Raises NotIdentifiable where no mounting has two postures."""
        visited = visits(observed)
        measured = differences(model.geometry, visited)
        return cls(model, visited, measured, reading_noise(visited, indicator))


def identify_from(
    told: Told,
    subset: Subset,
    method: Method,
    *,
    weights: Weights,
    tolerance_mm: FloatArray | None,
) -> Solution:
    """As `identify`, of what was worked out once for all sets."""
    free = SUBSETS[subset]
    model, visited, measured, noise = told.model, told.visited, told.measured, told.noise
    weight = reading_weights(visited, noise)
    efficient = _efficient_fit(model, visited, subset, method, noise, tolerance_mm)
    held = subset == "with-tolerances"
    papers = method == "linear" and weights == "equal" and not held
    fit = papers_fit(model, visited, free, measured) if papers else efficient
    _refuse_impossible(model, fit)
    if noise is None:
        noise = _noise_from_residuals(visited, efficient)
        weight = reading_weights(visited, noise)
    spread = propagate(fit.estimator, visited, noise)
    if held and tolerance_mm is not None:
        spread = spread.with_prior(visited, weight, fit.design, tolerance_mm)
    before = measured.combine @ model.readings(visited)
    predicted = measured.combine @ fit.predicted_mm
    system = measured.combine @ fit.design
    return Solution(
        model=model.with_parameters(fit.parameters_mm),
        subset=subset,
        method=method,
        weights="equal" if papers else "covariance",
        names=tuple(PARAMETER_NAMES[k] for k in free),
        values_mm=fit.parameters_mm[list(free)],
        covariance_mm2=spread.covariance_mm2,
        held_mm2=spread.held_mm2,
        coverage_factors=_coverage(spread),
        differences=measured,
        difference_uncertainty_mm=uncertainties(measured.combine, visited, noise),
        predicted_mm=predicted,
        rms_before_mm=_rms(measured.value_mm - before),
        rms_after_mm=_rms(measured.value_mm - predicted),
        degrees_of_freedom=(
            len(measured) if method == "linear" else len(visited) - visited.mount_count
        )
        - len(free),
        noise=noise,
        lack_of_fit=lack_of_fit(
            visited,
            visited.value_mm - efficient.predicted_mm,
            float(np.trace(efficient.estimator @ efficient.design)),
            noise,
        ),
        condition_number=float(np.linalg.cond(system)),
        weak_directions=_seen(
            model, visited, weight, efficient, free, noise, tolerance_mm if held else None
        ).weak,
        residual_mm=without_zeros(visited, weight, visited.value_mm - fit.predicted_mm),
    )


def _efficient_fit(
    model: Model,
    visited: Observations,
    subset: Subset,
    method: Method,
    noise: Noise | None,
    tolerance_mm: FloatArray | None,
) -> Fit:
    """The best estimate of its kind, refused where some combination is not seen."""
    free, weight = SUBSETS[subset], reading_weights(visited, noise)
    if subset == "with-tolerances":
        if tolerance_mm is None or noise is None:
            found = "no tolerances" if tolerance_mm is None else "no noise to weigh them with"
            raise NotIdentifiable("the set 'with-tolerances'", found, "both of them")
        return prior_fit(model, visited, weight, tolerance_mm)
    linear = weighted_fit(model, visited, free, weight)
    refuse_unseen(_seen(model, visited, weight, linear, free, noise), subset)
    if method == "linear":
        return linear
    exact = exact_fit(model, visited, free, weight)
    refuse_unseen(_seen(model, visited, weight, exact, free, noise), subset)
    return exact


def _seen(
    model: Model,
    visited: Observations,
    weight: FloatArray,
    fit: Fit,
    free: tuple[int, ...],
    noise: Noise | None,
    tolerance_mm: FloatArray | None = None,
) -> Identifiability:
    """What the readings see; with tolerances ``(k,)`` these count as measurements beside them."""
    seen = sensitivity_of_readings(
        model.geometry, visited, weight, fit.design, free, noise_known=noise is not None
    )
    if tolerance_mm is not None:
        rows = np.vstack([seen.jacobian, np.diag(1.0 / tolerance_mm)])
        seen = replace(seen, jacobian=rows)
    return analyse(seen)


def _coverage(spread: Propagation) -> FloatArray:
    """Factor for 95 % of each parameter; Student's t with its own degrees of freedom."""
    return np.array([coverage_factor(float(nu)) for nu in spread.degrees_of_freedom])


def _refuse_impossible(model: Model, fit: Fit) -> None:
    """A parameter as long as a leg belongs to no machine of this kind."""
    worst = float(np.abs(fit.parameters_mm).max())
    shortest = min(model.geometry.leg_length_mm)
    if not worst < shortest:
        raise NotIdentifiable(
            "identified parameters",
            f"a value of {worst:.3g} mm",
            f"less than the leg length {shortest:g} mm",
            "Look for a wrong reading or unit.",
        )


def _noise_from_residuals(visited: Observations, efficient: Fit) -> Noise:
    """The noise that explains what the model leaves of the means of the postures."""
    places = int(visited.posture.max()) + 1
    remaining = len(visited) - visited.mount_count - efficient.design.shape[1]
    if remaining <= 0 or places - visited.mount_count < efficient.design.shape[1]:
        raise NotIdentifiable(
            "noise of the readings",
            f"{len(visited)} readings without repeats, no degree of freedom left",
            "repeats, or the indicator's resolution and repeatability",
            "Import the table again with --resolution and --repeatability.",
        )
    left = without_zeros(visited, visited.averaged, visited.value_mm - efficient.predicted_mm)
    variance = float((visited.averaged * left**2).sum()) / remaining
    one = IndicatorNoise(variance, 0.0, float(remaining))
    return Noise((one,) * visited.indicator_count, "residuals")


def _rms(values_mm: FloatArray) -> float:
    return float(np.sqrt(np.mean(values_mm**2)))
