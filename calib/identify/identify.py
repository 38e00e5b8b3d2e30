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
from functools import partial
from typing import Self

import numpy as np
from scipy.sparse import csr_array

from calib.arrays import (
    DEPENDENT,
    FloatArray,
    Observations,
    basis_of,
    set_up_unknowns,
    without,
    without_zeros,
)
from calib.design.identifiability import (
    Identifiability,
    Sensitivity,
    analyse,
    refuse_unseen,
)
from calib.errors import NotIdentifiable
from calib.identify.fit import (
    Fit,
    Size,
    design_of,
    exact_fit,
    papers_fit,
    prior_fit,
    weighted_fit,
)
from calib.identify.solution import (
    SUBSETS,
    FittedSize,
    Method,
    Solution,
    Subset,
    Weights,
    lack_of_fit,
)
from calib.noise.reading import (
    IndicatorFigures,
    IndicatorNoise,
    Noise,
    reading_noise,
    reading_weights,
    visit_means,
)
from calib.noise.repeats import Repeats
from calib.stats import coverage_factors
from calib.tripod.differences import MORE_PLACES, Differences, differences, few_contacts
from calib.tripod.geometry import PARAMETER_NAMES
from calib.tripod.movements import with_first_movements
from calib.tripod.pipeline import Model, derivatives
from calib.tripod.planning import sensitivity_of_readings

NOTICED = 50.0
"""Tolerances: so large an effect would be seen without measuring, as offsets of 5 mm would."""


@dataclass(frozen=True, eq=False)
class IdentificationCase:
    """What readings tell before any set of parameters is chosen; ``noise`` None: nothing of it.

    ``sizes`` of the model's effects are free with every set. The indicator's figures serve as noise
    where there are no repeats.
    """

    model: Model
    visits: Observations
    measured: Differences
    noise: Noise | None
    sizes: tuple[Size, ...]

    @classmethod
    def of(
        cls,
        model: Model,
        observations: Observations,
        indicator: IndicatorFigures,
        sizes: tuple[Size, ...] = (),
    ) -> Self:
        """Raises NotIdentifiable where no mounting has two postures."""
        visits = visit_means(observations)
        if sizes or model.effects:  # play may be among them
            visits = with_first_movements(model.geometry, visits)
        measured = differences(model.geometry, visits)
        return cls(model, visits, measured, reading_noise(visits, indicator), sizes)


def identify(
    case: IdentificationCase,
    subset: Subset,
    method: Method = "exact",
    weights: Weights = "equal",
    *,
    tolerance_mm: FloatArray,
) -> Solution:
    """Identify the parameters of a subset; the others keep the model's values.

    Sizes of the model's effects are fitted with them, by the exact method only; ``weights`` matters
    for the linear method only. Parts may be off by ``tolerance_mm`` ``(6,)``, each a standard
    deviation. The subset ``with-tolerances`` takes the exact method and always determines
    everything; its covariance holds the tolerances too. Raises NotIdentifiable where the readings
    do not determine the subset.
    """
    free = SUBSETS[subset]
    model, visits, measured, noise = case.model, case.visits, case.measured, case.noise
    weight = reading_weights(visits, noise)
    within_tolerances = subset == "with-tolerances"
    if within_tolerances and noise is None:
        raise NotIdentifiable(
            "the set 'with-tolerances'", "no noise to weigh them with", "both of them"
        )
    within_mm = tolerance_mm if within_tolerances else None
    efficient = _efficient_fit(case, subset, method, weight, tolerance_mm)
    papers = method == "linear" and weights == "equal" and not within_tolerances
    fit = papers_fit(model, visits, free, measured) if papers else efficient
    _refuse_impossible(model, fit)
    if noise is None:
        noise = _noise_from_residuals(visits, efficient)
        weight = reading_weights(visits, noise)
    spread = propagate(fit.estimator, visits, noise)
    if within_mm is not None:
        tolerance = np.concatenate([within_mm, np.full(len(case.sizes), np.inf)])
        spread = spread.with_prior(visits, weight, fit.design, tolerance)
    nominal_mm = measured.of(model.readings(visits))
    predicted = measured.of(fit.predicted_mm)
    k, coverage = len(free), coverage_factors(spread.degrees_of_freedom)
    independent = len(visits) - set_up_unknowns(visits)
    if method == "linear":  # differences of contacts of a mounting add up to nothing
        independent = len(measured) - len(np.unique(visits.mount[visits.contact]))
    sight = _identifiability(case, weight, free, noise, within_mm, efficient.design)
    return Solution(
        model=fit.model,
        subset=subset,
        method=method,
        weights="equal" if papers else "covariance",
        names=tuple(PARAMETER_NAMES[k] for k in free),
        values_mm=fit.parameters_mm[list(free)],
        covariance_mm2=spread.covariance_mm2[:k, :k],
        held_mm2=spread.held_mm2[:k, :k],
        rounding_mm2=spread.rounding_mm2[:k, :k],
        coverage_factors=coverage[:k],
        sizes=tuple(
            FittedSize(size.name, size.unit, size.value(fit.model), float(u), float(factor))
            for size, u, factor in zip(
                case.sizes, spread.uncertainty_mm[k:], coverage[k:], strict=True
            )
        ),
        differences=measured,
        difference_uncertainty_mm=uncertainties(measured.combine, visits, noise),
        predicted_mm=predicted,
        rms_before_mm=_rms(measured.value_mm - nominal_mm),
        rms_after_mm=_rms(measured.value_mm - predicted),
        degrees_of_freedom=independent - fit.design.shape[1],
        noise=noise,
        lack_of_fit=lack_of_fit(
            visits,
            visits.value_mm - efficient.predicted_mm,
            float(np.trace(efficient.estimator @ efficient.design)),
            noise,
        ),
        condition_number=float(np.linalg.cond(measured.combine @ fit.design)),
        weak_directions=sight.weak,
        residual_mm=without_zeros(visits, weight, visits.value_mm - fit.predicted_mm),
        outside=_of_others(fit, visits, free),
        tolerance_mm=tolerance_mm,
    )


def _of_others(fit: Fit, visits: Observations, free: tuple[int, ...]) -> FloatArray:
    """What errors of parameters outside a set do to those in it ``(k, 6)``, mm per mm."""
    model = fit.model
    all_columns = derivatives(model.geometry, model.parameters_mm, visits, model.effects)
    all_columns[:, list(free)] = 0.0
    return np.asarray(fit.estimator[: len(free)] @ all_columns)


def _efficient_fit(
    case: IdentificationCase,
    subset: Subset,
    method: Method,
    weight: FloatArray,
    tolerance_mm: FloatArray,
) -> Fit:
    """The best estimate of its kind, refused where some combination is not seen."""
    model, visits, sizes, free = case.model, case.visits, case.sizes, SUBSETS[subset]
    within_mm = tolerance_mm if subset == "with-tolerances" else None
    sight, begin = partial(_identifiability, case, weight, free, case.noise, within_mm), model
    if sizes:  # no fit can begin with a size that nothing shows
        try:
            sight(design_of(model, visits, free, sizes))
        except NotIdentifiable:  # some act only where the machine is off
            begin = prior_fit(model, visits, weight, tolerance_mm).model
            sight(design_of(begin, visits, free, sizes))
    if within_mm is not None:
        return prior_fit(model, visits, weight, within_mm, sizes, begin)
    advice = MORE_PLACES if few_contacts(visits) else ""
    linear = weighted_fit(model, visits, free, weight)
    refuse_unseen(sight(linear.design), subset, advice)
    if method == "linear":
        return linear
    exact = exact_fit(model, visits, free, weight, sizes, begin)
    refuse_unseen(sight(exact.design), subset, advice)
    return exact


def _identifiability(
    case: IdentificationCase,
    weight: FloatArray,
    free: tuple[int, ...],
    noise: Noise | None,
    tolerance_mm: FloatArray | None,
    design: FloatArray,
) -> Identifiability:
    """What the readings see of the parameters; tolerances ``(k,)`` count as measurements beside.

    Sizes of effects in the ``design`` ``(n_readings, k + n_sizes)`` take their part away. Raises
    NotIdentifiable for a size that is not seen.
    """
    k = len(free)
    rows = np.sqrt(weight)[:, None] * without_zeros(case.visits, weight, design)
    if tolerance_mm is not None:
        rows = np.vstack([rows, np.eye(k, rows.shape[1]) / tolerance_mm[:, None]])
    base, sizes = rows[:, :k], rows[:, k:]
    if sizes.shape[1]:
        _refuse_unseen_sizes(case, without(basis_of(base, DEPENDENT), sizes), noise)
        base = without(basis_of(sizes, DEPENDENT), base)
    noise_known = noise is not None
    sensitivity = sensitivity_of_readings(
        case.model.geometry, case.visits, weight, design[:, :k], free, noise_known=noise_known
    )
    # what was fitted before the noise was known stays fitted: badly known, and named as that
    fitted = noise_known and case.noise is None
    return analyse(
        replace(sensitivity, jacobian=base, unseen=np.inf if fitted else sensitivity.unseen)
    )


def _refuse_unseen_sizes(
    case: IdentificationCase, columns: FloatArray, noise: Noise | None
) -> None:
    """Refuse a model with effects whose sizes these readings do not show, by their names."""
    sizes = case.sizes
    sensitivity = Sensitivity(
        names=tuple(size.name for size in sizes),
        jacobian=columns,
        tolerance=np.array([NOTICED * size.tolerance for size in sizes]),
        noise_known=noise is not None,
    )
    unseen = analyse(sensitivity).unseen
    if unseen:
        combinations = "; ".join(direction.combination for direction in unseen)
        raise NotIdentifiable(
            "effects of the model",
            f"not shown by these readings: {combinations}",
            "sizes that the readings determine",
            "Measure with a procedure that shows them, or remove them: glidecal model --remove.",
        )


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


def _noise_from_residuals(visits: Observations, efficient: Fit) -> Noise:
    """The noise that explains what the model leaves of the means of the postures."""
    places = int(visits.posture.max()) + 1
    fitted = set_up_unknowns(visits) + efficient.design.shape[1]
    remaining = len(visits) - fitted
    if remaining <= 0 or places < fitted:
        raise NotIdentifiable(
            "noise of the readings",
            f"{len(visits)} readings without repeats, no degree of freedom left",
            "repeats, or the indicator's resolution and repeatability",
            "Import the table again with --resolution and --repeatability.",
        )
    residual_mm = without_zeros(visits, visits.averaged, visits.value_mm - efficient.predicted_mm)
    variance = float((visits.averaged * residual_mm**2).sum()) / remaining
    indicator_noise = IndicatorNoise(variance, 0.0, float(remaining))
    repeats = Repeats.of(visits).degrees_of_freedom.sum() > 0.0  # then they all agree
    indicators = (indicator_noise,) * visits.indicator_count
    return Noise(indicators, "residuals", repeated="equal" if repeats else "nothing")


def _rms(values_mm: FloatArray) -> float:
    return float(np.sqrt(np.mean(values_mm**2)))


@dataclass(frozen=True, eq=False)
class Propagation:
    """Covariance ``(k, k)`` in mm² and the degrees of freedom ``(k,)`` of each variance.

    ``held_mm2`` ``(k, k)`` is the part of the covariance that is not noise of the readings but what
    the tolerances of a prior leave open; ``rounding_mm2`` ``(k, k)`` is the part that steps of the
    display give to all repeats of a posture.
    """

    covariance_mm2: FloatArray
    degrees_of_freedom: FloatArray
    held_mm2: FloatArray
    rounding_mm2: FloatArray

    @property
    def uncertainty_mm(self) -> FloatArray:
        """Standard uncertainties ``(k,)``, mm."""
        return np.sqrt(self.covariance_mm2.diagonal())

    def with_prior(
        self,
        observations: Observations,
        weight: FloatArray,
        design: FloatArray,
        tolerance_mm: FloatArray,
    ) -> Propagation:
        """The covariance with what tolerances ``(k,)`` leave open: that of Bayes' estimate."""
        centred = without_zeros(observations, weight, design)
        information = (centred.T * weight) @ centred
        posterior = np.asarray(np.linalg.inv(information + np.diag(tolerance_mm**-2.0)))
        share = self.covariance_mm2.diagonal() / posterior.diagonal()
        with np.errstate(divide="ignore"):
            degrees = np.asarray(self.degrees_of_freedom / share**2)
        held_mm2 = posterior - self.covariance_mm2
        return Propagation(posterior, degrees, held_mm2, self.rounding_mm2)


def propagate(estimator: FloatArray, observations: Observations, noise: Noise) -> Propagation:
    """Law of propagation (GUM 5.2) for a linear map ``(k, n_readings)`` of the readings.

    Each reading has a scatter of its own; rounding that is locked is common to the readings of a
    posture. Degrees of freedom after Welch and Satterthwaite (GUM G.4.1), one contribution for each
    indicator, one in all where they are pooled.
    """
    repeatability_mm2 = noise.repeatability_mm2(observations)
    covariance = (estimator * repeatability_mm2) @ estimator.T
    together = np.asarray((_at_places(observations, noise).T @ estimator.T).T)
    shared = together @ together.T
    covariance = covariance + shared
    variance, squares = covariance.diagonal(), estimator**2 * repeatability_mm2
    group = noise.estimates[observations.indicator]
    spread = np.zeros_like(variance)
    for number in np.unique(group).tolist():
        contribution = squares[:, group == number].sum(axis=1)
        spread += contribution**2 / noise.indicators[number].degrees_of_freedom
    with np.errstate(divide="ignore"):
        degrees = np.asarray(np.where(spread > 0.0, variance**2 / spread, np.inf))
    return Propagation(covariance, degrees, np.zeros_like(covariance), shared)


def uncertainties(combine: csr_array, observations: Observations, noise: Noise) -> FloatArray:
    """Standard uncertainties ``(k,)`` for a sparse map ``(k, n_readings)``, mm; no covariances."""
    variance_mm2 = combine.multiply(combine) @ noise.repeatability_mm2(observations)
    together = combine @ _at_places(observations, noise)
    shared = together.multiply(together).sum(axis=1)
    return np.sqrt(
        np.asarray(variance_mm2, dtype=np.float64) + np.asarray(shared, dtype=np.float64)
    )


def _at_places(observations: Observations, noise: Noise) -> csr_array:
    """What each reading shares with its posture ``(n_readings, n_places)``, mm."""
    place = observations.posture
    rows = np.arange(len(place))
    return csr_array(
        (np.sqrt(noise.quantisation_mm2(observations)), (rows, place)),
        shape=(len(place), int(place.max()) + 1),
    )
