"""What an identification gives: parameters, how far they can be trusted, and what is left."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import Annotated, Literal

import numpy as np

from calib.arrays import FloatArray, Observations, largest, set_up_unknowns, without_zeros
from calib.design.identifiability import Direction
from calib.noise.reading import Noise
from calib.quantity import Quantity, rows
from calib.stats import coverage_factor, variance_ratio_p_value
from calib.tripod.differences import Differences
from calib.tripod.geometry import PARAMETER_NAMES
from calib.tripod.pipeline import Model

Subset = Literal["joint-offsets", "leg-lengths", "both", "with-tolerances"]
Method = Literal["linear", "exact"]
Weights = Literal["equal", "covariance"]

SUBSETS: dict[Subset, tuple[int, ...]] = {
    "joint-offsets": (0, 1, 2),
    "leg-lengths": (3, 4, 5),
    "both": (0, 1, 2, 3, 4, 5),
    "with-tolerances": (0, 1, 2, 3, 4, 5),
}


BELIEVED = 3.0
"""Tolerances, each a standard deviation, by which a part may be off before something is wrong."""

LACK_OF_FIT_LEVEL = 0.01
"""Chance from which down the model is said to leave more than the noise."""


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


@dataclass(frozen=True)
class Estimate:
    """A value that was identified, in its unit; the expanded uncertainty is for 95 %."""

    value: Annotated[float, Quantity("value", "", "measured", 0, "true less believed")]
    standard_uncertainty: Annotated[float, Quantity(words="parts outside the set as stated")]
    expanded_uncertainty: Annotated[
        float,
        Quantity("± U (95 %)", "", "uncertainty", 0, "for 95 %, parts outside the set as stated"),
    ]
    coverage_factor: Annotated[float, Quantity(words="expanded over standard uncertainty")]
    unit: Annotated[str, Quantity("unit", words="unit of value and uncertainties")]


@dataclass(frozen=True)
class Parameter(Estimate):
    """An identified parameter; the expanded uncertainty is for 95 %."""

    unit: Annotated[Literal["mm"], Quantity("unit", words="unit of value and uncertainties")] = "mm"


@dataclass(frozen=True)
class TabledEstimate(Estimate):
    """An estimate, and what parts outside the set add to its uncertainty."""

    expanded_uncertainty: Annotated[
        float,
        Quantity("parts as stated", "", "uncertainty", 0, "for 95 %, parts outside as stated"),
    ]
    expanded_with_tolerances: Annotated[
        float,
        Quantity("± U (95 %)", "", "uncertainty", 0, "parts outside the set within tolerances"),
    ]


@dataclass(frozen=True)
class Difference:
    """A reading less that at another posture, and what the solution predicts of it, mm."""

    value: Annotated[
        float,
        Quantity(
            "measured",
            "mm",
            "measured",
            3,
            "mean of the readings there less the mean at the other posture",
        ),
    ]
    standard_uncertainty: Annotated[
        float,
        Quantity("u", "mm", "uncertainty", 3, "standard uncertainty of the measured difference"),
    ]
    predicted: Annotated[
        float, Quantity("predicted", "mm", "measured", 3, "what the parameters predict")
    ]
    residual: Annotated[float, Quantity("residual", "mm", "measured", 3, "measured less predicted")]


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
    ``tolerance_mm`` ``(6,)`` how far they may be off.
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
    sizes: tuple[FittedSize, ...]
    outside: FloatArray
    tolerance_mm: FloatArray

    @property
    def parameters(self) -> dict[str, Parameter]:
        """Parameters by name."""
        uncertain = (self.uncertainty_mm, self.expanded_mm, self.coverage_factors)
        return rows(Parameter, self.names, self.values_mm, *uncertain)

    @property
    def effect_sizes(self) -> dict[str, Estimate]:
        """Sizes of the model's effects, by name."""
        return {
            size.name: Estimate(
                size.value,
                size.standard_uncertainty,
                size.coverage_factor * size.standard_uncertainty,
                size.coverage_factor,
                size.unit,
            )
            for size in self.sizes
        }

    @property
    def estimates(self) -> dict[str, TabledEstimate]:
        """Parameters, and sizes, to whose uncertainty parts outside the set add nothing."""
        by_name = {**self.parameters, **self.effect_sizes}
        expanded = [estimate.expanded_uncertainty for estimate in by_name.values()]
        expanded[: len(self.names)] = self.expanded_with_tolerances_mm.tolist()
        return {
            name: TabledEstimate(**asdict(estimate), expanded_with_tolerances=mm)
            for (name, estimate), mm in zip(by_name.items(), expanded, strict=True)
        }

    @property
    def tabulated(self) -> dict[str, Difference]:
        """The differences of the papers, up to twelve, by name."""
        measured, u = self.differences, self.difference_uncertainty_mm
        columns = (measured.value_mm, u, self.predicted_mm, self.left_mm)
        by_name = rows(Difference, measured.names, *columns)
        return {
            name: by_name[name] for name in (measured.names[k] for k in measured.published_rows)
        }

    @property
    def expanded_with_tolerances_mm(self) -> FloatArray:
        """Expanded uncertainties (95 %) ``(k,)`` with all outside the set off within tolerances."""
        return np.asarray(np.hypot(self.expanded_mm, self._off_mm(self.outside)))

    @property
    def uncertainty_with_tolerances_mm(self) -> FloatArray:
        """Standard uncertainties ``(k,)`` behind `expanded_with_tolerances_mm`."""
        off_mm = self._off_mm(self.outside) / coverage_factor(math.inf)
        return np.asarray(np.hypot(self.uncertainty_mm, off_mm))

    @property
    def expanded_of_difference_mm(self) -> FloatArray | None:
        """Expanded uncertainty of d_rho - d_L ``(3,)``; None where d_rho is known as well."""
        if self.subset != "joint-offsets":
            return None
        apart = self.outside + np.eye(len(PARAMETER_NAMES))[3:]
        expanded_mm = np.asarray(np.hypot(self.expanded_mm, self._off_mm(apart)))
        return expanded_mm if (expanded_mm < 0.5 * self.expanded_with_tolerances_mm).all() else None

    def _off_mm(self, outside: FloatArray) -> FloatArray:
        """What parts outside the set, off within tolerances, make of the parameters (95 %)."""
        off_mm = np.linalg.norm(outside * self.tolerance_mm, axis=1)
        return np.asarray(coverage_factor(math.inf) * off_mm)

    @property
    def budget_mm(self) -> dict[str, FloatArray]:
        """What each source gives to `expanded_with_tolerances_mm` ``(k,)``, mm (95 %).

        They add up as squares, the rule of GUM 5.1.2 for sources that know nothing of each other.
        """
        tolerances_mm2, rounding = self.held_mm2.diagonal(), self.rounding_mm2.diagonal()
        scatter = np.maximum(self.covariance_mm2.diagonal() - tolerances_mm2 - rounding, 0.0)
        factors = self.coverage_factors
        tolerances = np.hypot(
            factors * np.sqrt(np.maximum(tolerances_mm2, 0.0)), self._off_mm(self.outside)
        )
        return {
            "scatter of repeats": factors * np.sqrt(scatter),
            "steps of the display": factors * np.sqrt(rounding),
            "parts within tolerance": np.asarray(tolerances),
        }

    @property
    def noise_expanded_mm(self) -> FloatArray:
        """Expanded uncertainties ``(k,)`` from noise alone, without parts within tolerance, mm."""
        noise_mm2 = self.covariance_mm2.diagonal() - self.held_mm2.diagonal()
        return np.asarray(self.coverage_factors * np.sqrt(np.maximum(noise_mm2, 0.0)))

    @property
    def beyond_tolerance(self) -> tuple[tuple[str, float, float], ...]:
        """Parameters surely more than `BELIEVED` tolerances off: name, value and tolerance, mm."""
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
    def correlation(self) -> FloatArray | None:
        """Correlation coefficients ``(k, k)`` of the parameters; None where one is exact."""
        u = self.uncertainty_mm
        return self.covariance_mm2 / np.outer(u, u) if u.all() else None

    @property
    def strongest_correlation(self) -> tuple[float, str, str] | None:
        """Correlation of the two parameters known least independently; None without two."""
        if self.correlation is None or len(self.names) < 2:
            return None
        first, second = np.triu_indices(len(self.names), 1)
        pairs = self.correlation[first, second]
        at = largest(np.abs(pairs))
        return float(pairs[at]), self.names[first[at]], self.names[second[at]]

    @property
    def spread(self) -> float:
        """Factor on the variance of the noise where the model leaves more than that; at least 1."""
        return max(1.0, self.lack_of_fit.statistic) if self.lack_of_fit else 1.0

    @property
    def inflation(self) -> float:
        """Factor on the standard deviation where what is left is taken as noise."""
        return math.sqrt(self.spread)

    def inflated_mm2(self, factor: float) -> FloatArray:
        """Covariance ``(k, k)`` in mm² with so many times the variance of the noise."""
        return np.asarray(factor * (self.covariance_mm2 - self.held_mm2) + self.held_mm2)

    @property
    def lack_of_fit_factor(self) -> float:
        """Coverage factor (95 %) with what the model leaves, and its freedom, as noise."""
        if not self.lack_of_fit or self.spread == 1.0:
            return self.coverage_factor
        return coverage_factor(self.lack_of_fit.degrees_of_freedom)

    @property
    def inflated_expanded_mm(self) -> FloatArray:
        """Expanded uncertainties (95 %) ``(k,)`` with what the model leaves as noise, mm."""
        inflated = np.sqrt(self.inflated_mm2(self.spread).diagonal())
        return np.maximum(self.expanded_mm, self.lack_of_fit_factor * inflated)


def lack_of_fit(
    visits: Observations, left_mm: FloatArray, parameter_count: float, noise: Noise
) -> LackOfFit | None:
    """Mean square of what the best fit leaves of the cell means, over their noise variance.

    ``left_mm`` ``(n_readings,)`` is measured minus predicted, zeros not yet taken out.
    ``parameter_count`` is the trace of what a fit makes of readings: less than the number of
    parameters where tolerances hold them (Hastie, Tibshirani, Friedman, section 7.6). None where
    nothing is free or the noise itself came from what the fit leaves.
    """
    first, cell = np.unique(visits.cell, return_index=True, return_inverse=True)[1:]
    free = round(len(first) - set_up_unknowns(visits) - parameter_count, 6)
    if noise.source == "residuals" or free <= 0.0:
        return None
    together = np.bincount(cell, visits.averaged).astype(np.float64)
    mean = np.bincount(cell, visits.averaged * left_mm) / together
    means = replace(visits.take(first), averaged=together)
    weight = 1.0 / (noise.repeatability_mm2(means) + noise.quantisation_mm2(means))
    residual_mm = without_zeros(means, weight, mean)
    statistic = float((weight * residual_mm**2).sum()) / free
    p_value = variance_ratio_p_value(statistic, free, noise.degrees_of_freedom)
    return LackOfFit(statistic, free, p_value)
