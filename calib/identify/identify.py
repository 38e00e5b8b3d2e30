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
from dataclasses import dataclass, field, replace
from typing import Literal, Self

import numpy as np

from calib.arrays import (
    DEPENDENT,
    FloatArray,
    Observations,
    basis_of,
    largest,
    set_up_unknowns,
    without,
    without_zeros,
)
from calib.design.identifiability import (
    Direction,
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
from calib.identify.propagation import Propagation, propagate, uncertainties
from calib.noise.reading import (
    IndicatorFigures,
    IndicatorNoise,
    Noise,
    reading_noise,
    reading_weights,
    visits,
)
from calib.stats import coverage_factor, variance_ratio_p_value
from calib.tripod.differences import Differences, differences
from calib.tripod.geometry import PARAMETER_NAMES
from calib.tripod.movements import with_first_movements
from calib.tripod.pipeline import Model, derivatives
from calib.tripod.sensitivity import sensitivity_of_readings

Subset = Literal["joint-offsets", "leg-lengths", "both", "with-tolerances"]
Method = Literal["linear", "exact"]
Weights = Literal["equal", "covariance"]

SUBSETS: dict[Subset, tuple[int, ...]] = {
    "joint-offsets": (0, 1, 2),
    "leg-lengths": (3, 4, 5),
    "both": (0, 1, 2, 3, 4, 5),
    "with-tolerances": (0, 1, 2, 3, 4, 5),
}


@dataclass(frozen=True)
class LackOfFit:
    """Ratio of what the model leaves to the noise (variances), and the chance of one as large."""

    statistic: float
    degrees_of_freedom: float
    p_value: float


@dataclass(frozen=True)
class FittedSize:
    """A size of an effect that was fitted with the parameters, in its own unit."""

    name: str
    unit: str
    value: float
    standard_uncertainty: float
    coverage_factor: float


@dataclass(frozen=True, eq=False)
class Solution:
    """Identified parameters of one subset with everything needed to trust them or not.

    ``names``, ``values_mm`` and ``coverage_factors`` (95 %) have k entries, ``covariance_mm2`` is
    ``(k, k)``, of which ``held_mm2`` is what tolerances leave open; what effects fitted with them,
    ``sizes``, leave open is in it, and ``rounding_mm2``, what steps of the display give to all
    repeats alike.
    ``predicted_mm`` and ``difference_uncertainty_mm`` belong to ``differences``,
    ``(n_differences,)`` each.
    Uncertainties carry the noise of the readings; they do not carry what the model leaves out.
    ``outside`` ``(k, 6)`` is what an error of each parameter outside the set does to these, and
    ``tolerance_mm`` ``(6,)`` how far they may be off, None where nobody stated it.
    """

    model: Model
    subset: Subset
    method: Method
    weights: Weights
    names: tuple[str, ...]
    values_mm: FloatArray
    covariance_mm2: FloatArray
    held_mm2: FloatArray
    rounding_mm2: FloatArray
    coverage_factors: FloatArray
    differences: Differences
    difference_uncertainty_mm: FloatArray
    predicted_mm: FloatArray
    rms_before_mm: float
    rms_after_mm: float
    degrees_of_freedom: int
    noise: Noise
    lack_of_fit: LackOfFit | None
    condition_number: float
    weak_directions: tuple[Direction, ...]
    residual_mm: FloatArray
    sizes: tuple[FittedSize, ...] = ()
    outside: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    tolerance_mm: FloatArray | None = None

    @property
    def expanded_with_tolerances_mm(self) -> FloatArray:
        """Expanded uncertainties (95 %) ``(k,)`` with all outside the set off within tolerances."""
        return self._with_tolerances(self.outside)

    @property
    def expanded_of_difference_mm(self) -> FloatArray | None:
        """The same of d_rho - d_L ``(3,)`` where the readings tell little of d_rho but that."""
        if self.subset != "joint-offsets" or self.tolerance_mm is None:
            return None
        apart = self.outside + np.eye(len(PARAMETER_NAMES))[3:]
        found = self._with_tolerances(apart)
        return found if (found < 0.5 * self.expanded_with_tolerances_mm).all() else None

    def _with_tolerances(self, outside: FloatArray) -> FloatArray:
        return np.asarray(np.hypot(self.expanded_mm, self._off_mm(outside)))

    def _off_mm(self, outside: FloatArray) -> FloatArray:
        """What parts outside the set, off within tolerances, make of the parameters (95 %)."""
        if self.tolerance_mm is None:
            return np.zeros_like(self.expanded_mm)
        off = coverage_factor(math.inf) * np.linalg.norm(outside * self.tolerance_mm, axis=1)
        return np.asarray(off)

    @property
    def budget_mm(self) -> dict[str, FloatArray]:
        """What each source gives to `expanded_with_tolerances_mm` ``(k,)``, mm (95 %).

        They add up as squares, the rule of GUM 5.1.2 for sources that know nothing of each other.
        """
        held, rounding = self.held_mm2.diagonal(), self.rounding_mm2.diagonal()
        scatter = np.maximum(self.covariance_mm2.diagonal() - held - rounding, 0.0)
        factors = self.coverage_factors
        tolerances = np.hypot(factors * np.sqrt(np.maximum(held, 0.0)), self._off_mm(self.outside))
        return {
            "scatter of repeats": factors * np.sqrt(scatter),
            "steps of the display": factors * np.sqrt(rounding),
            "parts within tolerance": np.asarray(tolerances),
        }

    @property
    def beyond_tolerance(self) -> tuple[tuple[str, float, float], ...]:
        """Parameters surely more than `BELIEVED` tolerances off: name, value and tolerance, mm."""
        if self.tolerance_mm is None:
            return ()
        tolerance = self.tolerance_mm[list(SUBSETS[self.subset])]
        beyond = np.abs(self.values_mm) - self.expanded_mm > BELIEVED * tolerance
        rows = zip(self.names, self.values_mm.tolist(), tolerance.tolist(), beyond, strict=True)
        return tuple((name, value, within) for name, value, within, off in rows if off)

    @property
    def lacks_fit(self) -> bool:
        """Whether the model leaves more than noise: something is missing from it."""
        return self.lack_of_fit is not None and self.lack_of_fit.p_value < LACK_OF_FIT_LEVEL

    @property
    def coverage_factor(self) -> float:
        """The largest of the coverage factors."""
        return float(self.coverage_factors.max())

    @property
    def left_mm(self) -> FloatArray:
        """What is left of each difference ``(n_differences,)``, mm."""
        return np.asarray(self.differences.value_mm - self.predicted_mm)

    @property
    def uncertainty_mm(self) -> FloatArray:
        """Standard uncertainties ``(k,)``, mm."""
        return np.sqrt(self.covariance_mm2.diagonal())

    @property
    def expanded_mm(self) -> FloatArray:
        """Expanded uncertainties for 95 % ``(k,)``, mm."""
        return self.coverage_factors * self.uncertainty_mm

    @property
    def strongest_correlation(self) -> tuple[float, str, str] | None:
        """That of the two parameters known least independently; None where there are no two."""
        u = self.uncertainty_mm
        if len(u) < 2 or not u.all():
            return None
        first, second = np.triu_indices(len(u), 1)
        pairs = (self.covariance_mm2 / np.outer(u, u))[first, second]
        at = largest(np.abs(pairs))
        return float(pairs[at]), self.names[first[at]], self.names[second[at]]

    @property
    def spread(self) -> float:
        """Factor on the variance of the noise where the model leaves more than that; at least 1."""
        return max(1.0, self.lack_of_fit.statistic) if self.lack_of_fit else 1.0

    @property
    def enlarged(self) -> float:
        """The same factor on its standard deviation."""
        return math.sqrt(self.spread)

    def enlarged_mm2(self, factor: float) -> FloatArray:
        """Covariance ``(k, k)`` in mm² with so many times the variance of the noise."""
        return np.asarray(factor * (self.covariance_mm2 - self.held_mm2) + self.held_mm2)

    @property
    def left_over_factor(self) -> float:
        """Coverage factor (95 %) with what the model leaves, and its freedom, as noise."""
        if not self.lack_of_fit or self.spread == 1.0:
            return self.coverage_factor
        return coverage_factor(self.lack_of_fit.degrees_of_freedom)

    @property
    def enlarged_expanded_mm(self) -> FloatArray:
        """Expanded uncertainties (95 %) ``(k,)`` with what the model leaves as noise, mm."""
        enlarged = np.sqrt(self.enlarged_mm2(self.spread).diagonal())
        return np.maximum(self.expanded_mm, self.left_over_factor * enlarged)

    def without_common(self) -> Solution:
        """The joint offsets less what they share: a plate does not show that."""
        shared = np.array([name in PARAMETER_NAMES[:3] for name in self.names], dtype=np.float64)
        take = np.eye(len(shared)) - np.outer(shared, shared) / max(1.0, shared.sum())
        return replace(
            self,
            values_mm=take @ self.values_mm,
            covariance_mm2=take @ self.covariance_mm2 @ take,
            held_mm2=take @ self.held_mm2 @ take,
            rounding_mm2=take @ self.rounding_mm2 @ take,
        )


BELIEVED = 3.0
"""Tolerances, each a standard deviation, by which a part may be off before something is wrong."""

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
    free = round(len(first) - set_up_unknowns(visited) - parameter_count, 6)
    if noise.source == "residuals" or free <= 0.0:
        return None
    together = np.bincount(cell, visited.averaged)
    mean = np.bincount(cell, visited.averaged * left_mm) / together
    indicator = visited.indicator[first]
    shown = np.array([one.repeatability_mm2 for one in noise.indicators])[indicator]
    locked = np.array([one.quantisation_mm2 for one in noise.indicators])[indicator]
    weight = 1.0 / (shown / together + locked)
    left = without_zeros(visited.take(first), weight, mean)
    statistic = float((weight * left**2).sum()) / free
    p_value = variance_ratio_p_value(statistic, free, noise.degrees_of_freedom)
    return LackOfFit(statistic, free, p_value)


NOTICED = 50.0
"""Tolerances: so large an effect would be seen without measuring, as offsets of 5 mm would."""


def identify(
    model: Model,
    observed: Observations,
    subset: Subset = "both",
    method: Method = "exact",
    *,
    weights: Weights = "equal",
    indicator: IndicatorFigures | None = None,
    tolerance_mm: FloatArray | None = None,
    sizes: tuple[Size, ...] = (),
) -> Solution:
    """Identify the parameters of a subset; the others keep the model's values.

    ``sizes`` of the model's effects are fitted with them, by the exact method only.

    ``weights`` matters for the linear method only. The indicator's figures serve as noise where
    there are no repeats. The subset ``with-tolerances`` needs ``tolerance_mm`` ``(6,)``, takes the
    exact method and always determines everything; its covariance holds the tolerances too. Raises
    NotIdentifiable where the readings do not determine the subset.
    """
    told = Told.of(model, observed, indicator or IndicatorFigures(), sizes)
    return identify_from(told, subset, method, weights=weights, tolerance_mm=tolerance_mm)


@dataclass(frozen=True, eq=False)
class Told:
    """What readings tell before any set of parameters is chosen; ``noise`` None: nothing of it.

    ``sizes`` of the model's effects are free with every set.
    """

    model: Model
    visited: Observations
    measured: Differences
    noise: Noise | None
    sizes: tuple[Size, ...]

    @classmethod
    def of(
        cls,
        model: Model,
        observed: Observations,
        indicator: IndicatorFigures,
        sizes: tuple[Size, ...] = (),
    ) -> Self:
        """Raises NotIdentifiable where no mounting has two postures."""
        visited = visits(observed)
        if sizes or model.effects:  # play may be among them
            visited = with_first_movements(visited)
        measured = differences(model.geometry, visited)
        return cls(model, visited, measured, reading_noise(visited, indicator), sizes)


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
    efficient = _efficient_fit(told, subset, method, tolerance_mm)
    held = subset == "with-tolerances"
    papers = method == "linear" and weights == "equal" and not held
    fit = papers_fit(model, visited, free, measured) if papers else efficient
    _refuse_impossible(model, fit)
    if noise is None:
        noise = _noise_from_residuals(visited, efficient)
        weight = reading_weights(visited, noise)
    spread = propagate(fit.estimator, visited, noise)
    if held and tolerance_mm is not None:
        unbounded = np.full(len(told.sizes), np.inf)
        tolerance = np.concatenate([tolerance_mm, unbounded])
        spread = spread.with_prior(visited, weight, fit.design, tolerance)
    before = measured.combine @ model.readings(visited)
    predicted = measured.combine @ fit.predicted_mm
    k = len(free)
    system = measured.combine @ fit.design
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
        coverage_factors=_coverage(spread)[:k],
        sizes=_fitted(told.sizes, fit.model, spread),
        differences=measured,
        difference_uncertainty_mm=uncertainties(measured.combine, visited, noise),
        predicted_mm=predicted,
        rms_before_mm=_rms(measured.value_mm - before),
        rms_after_mm=_rms(measured.value_mm - predicted),
        degrees_of_freedom=(
            len(measured) if method == "linear" else len(visited) - set_up_unknowns(visited)
        )
        - fit.design.shape[1],
        noise=noise,
        lack_of_fit=lack_of_fit(
            visited,
            visited.value_mm - efficient.predicted_mm,
            float(np.trace(efficient.estimator @ efficient.design)),
            noise,
        ),
        condition_number=float(np.linalg.cond(system)),
        weak_directions=_seen(
            told, weight, efficient.design, free, noise, tolerance_mm if held else None
        ).weak,
        residual_mm=without_zeros(visited, weight, visited.value_mm - fit.predicted_mm),
        outside=_of_others(fit, visited, free),
        tolerance_mm=tolerance_mm,
    )


def _of_others(fit: Fit, visited: Observations, free: tuple[int, ...]) -> FloatArray:
    """What errors of parameters outside a set do to those in it ``(k, 6)``, mm per mm."""
    model = fit.model
    every = derivatives(model.geometry, model.parameters_mm, visited, model.effects)
    every[:, list(free)] = 0.0
    return np.asarray(fit.estimator[: len(free)] @ every)


def _efficient_fit(
    told: Told, subset: Subset, method: Method, tolerance_mm: FloatArray | None
) -> Fit:
    """The best estimate of its kind, refused where some combination is not seen."""
    model, visited, noise, sizes = told.model, told.visited, told.noise, told.sizes
    free, weight = SUBSETS[subset], reading_weights(visited, noise)
    held = subset == "with-tolerances"
    if held and (tolerance_mm is None or noise is None):
        found = "no tolerances" if tolerance_mm is None else "no noise to weigh them with"
        raise NotIdentifiable("the set 'with-tolerances'", found, "both of them")
    if sizes:  # no fit can begin with a size that nothing shows
        start = design_of(model, visited, free, sizes)
        _seen(told, weight, start, free, noise, tolerance_mm if held else None)
    if held and tolerance_mm is not None:
        return prior_fit(model, visited, weight, tolerance_mm, sizes)
    linear = weighted_fit(model, visited, free, weight)
    refuse_unseen(_seen(told, weight, linear.design, free, noise), subset)
    if method == "linear":
        return linear
    exact = exact_fit(model, visited, free, weight, sizes)
    refuse_unseen(_seen(told, weight, exact.design, free, noise), subset)
    return exact


def _seen(
    told: Told,
    weight: FloatArray,
    design: FloatArray,
    free: tuple[int, ...],
    noise: Noise | None,
    tolerance_mm: FloatArray | None = None,
) -> Identifiability:
    """What the readings see of the parameters; tolerances ``(k,)`` count as measurements beside.

    Sizes of effects in the ``design`` ``(n_readings, k + n_sizes)`` take their part away. Raises
    NotIdentifiable for a size that is not seen.
    """
    k = len(free)
    rows = np.sqrt(weight)[:, None] * without_zeros(told.visited, weight, design)
    if tolerance_mm is not None:
        prior = np.zeros((k, rows.shape[1]))
        np.fill_diagonal(prior, 1.0 / tolerance_mm)
        rows = np.vstack([rows, prior])
    base, sizes = rows[:, :k], rows[:, k:]
    if sizes.shape[1]:
        _refuse_unseen_sizes(told, without(basis_of(base, DEPENDENT), sizes), noise)
        base = without(basis_of(sizes, DEPENDENT), base)
    known = noise is not None
    seen = sensitivity_of_readings(
        told.model.geometry, told.visited, weight, design[:, :k], free, noise_known=known
    )
    # what was fitted before the noise was known stays fitted: badly known, and named as that
    fitted = known and told.noise is None
    return analyse(replace(seen, jacobian=base, unseen=np.inf if fitted else seen.unseen))


def _refuse_unseen_sizes(told: Told, columns: FloatArray, noise: Noise | None) -> None:
    """Refuse a model with effects whose sizes these readings do not show, by their names."""
    sizes = told.sizes
    shown = Sensitivity(
        names=tuple(size.name for size in sizes),
        jacobian=columns,
        tolerance=np.array([NOTICED * size.tolerance for size in sizes]),
        noise_known=noise is not None,
    )
    unseen = analyse(shown).unseen
    if unseen:
        raise NotIdentifiable(
            "effects of the model",
            f"not shown by these readings: {'; '.join(one.combination for one in unseen)}",
            "sizes that the readings tell",
            "Measure with a procedure that shows them, or take them out: glidecal model --remove.",
        )


def _fitted(sizes: tuple[Size, ...], model: Model, spread: Propagation) -> tuple[FittedSize, ...]:
    """Sizes as they were found, behind the parameters in the covariance."""
    found = zip(
        sizes,
        spread.uncertainty_mm[len(spread.uncertainty_mm) - len(sizes) :],
        _coverage(spread)[len(spread.uncertainty_mm) - len(sizes) :],
        strict=True,
    )
    return tuple(
        FittedSize(size.name, size.unit, size.value(model), float(u), float(k))
        for size, u, k in found
    )


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
    fitted = set_up_unknowns(visited) + efficient.design.shape[1]
    remaining = len(visited) - fitted
    if remaining <= 0 or places < fitted:
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
