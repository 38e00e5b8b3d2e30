"""Parameters of readings, for tests: all that is stated has a usual value here."""

from __future__ import annotations

import numpy as np

from calib.arrays import FloatArray, Observations
from calib.identify.fit import Size
from calib.identify.identify import IdentificationCase
from calib.identify.identify import identify as identify_told
from calib.identify.solution import Method, Solution, Subset, Weights
from calib.identify.subset_choice import SubsetChoice
from calib.noise.reading import IndicatorFigures
from calib.tripod.geometry import PARAMETER_NAMES, TOLERANCE_MM
from calib.tripod.pipeline import Model

TOLERANCES_MM: FloatArray = np.full(len(PARAMETER_NAMES), TOLERANCE_MM)


def identify(
    model: Model,
    observations: Observations,
    subset: Subset = "both",
    method: Method = "exact",
    *,
    weights: Weights = "equal",
    indicator: IndicatorFigures | None = None,
    tolerance_mm: FloatArray = TOLERANCES_MM,
    sizes: tuple[Size, ...] = (),
) -> Solution:
    case = IdentificationCase.of(model, observations, indicator or IndicatorFigures(), sizes)
    return identify_told(case, subset, method, weights, tolerance_mm=tolerance_mm)


def choose_subset(
    model: Model,
    observations: Observations,
    *,
    indicator: IndicatorFigures | None = None,
    tolerance_mm: FloatArray,
) -> SubsetChoice:
    case = IdentificationCase.of(model, observations, indicator or IndicatorFigures())
    return SubsetChoice(case, tolerance_mm)
