"""What identification gives: frozen results and what follows from them at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from calib.distributions import coverage_factor
from calib.noise import Noise
from calib.observations import FloatArray
from calib.orthoglide.differences import Differences
from calib.orthoglide.model import Model

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
class Direction:
    """A combination of parameters, its standard uncertainty, and what that does at the tool.

    In mm; infinite where the combination is not seen. Both belong to the combination as written.
    ``against`` is the same two parameters with the other sign, and its standard uncertainty.
    """

    combination: str
    standard_uncertainty_mm: float
    tool_mm: float
    against: tuple[str, float] | None = None


@dataclass(frozen=True, eq=False)
class Solution:
    """Identified parameters of one subset with everything needed to trust them or not.

    ``names``, ``values_mm`` and ``coverage_factors`` (95 %) have k entries, ``covariance_mm2`` is
    ``(k, k)``, of which ``held_mm2`` is what tolerances leave open.
    ``predicted_mm`` and ``difference_uncertainty_mm`` belong to ``differences``,
    ``(n_differences,)`` each.
    Uncertainties carry the noise of the readings; they do not carry what the model leaves out.
    """

    model: Model
    subset: Subset
    method: Method
    weights: Weights
    names: tuple[str, ...]
    values_mm: FloatArray
    covariance_mm2: FloatArray
    held_mm2: FloatArray
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

    @property
    def coverage_factor(self) -> float:
        """The largest of the coverage factors."""
        return float(self.coverage_factors.max())

    @property
    def uncertainty_mm(self) -> FloatArray:
        """Standard uncertainties ``(k,)``, mm."""
        return np.sqrt(self.covariance_mm2.diagonal())

    @property
    def expanded_mm(self) -> FloatArray:
        """Expanded uncertainties for 95 % ``(k,)``, mm."""
        return self.coverage_factors * self.uncertainty_mm

    @property
    def spread(self) -> float:
        """Factor on the variance of the noise where the model leaves more than that; at least 1."""
        return max(1.0, self.lack_of_fit.statistic) if self.lack_of_fit else 1.0

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
