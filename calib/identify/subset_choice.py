"""The sets of parameters that the papers identify, side by side: views, none of them chosen."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from calib.arrays import FloatArray, Observations
from calib.errors import NotIdentifiable
from calib.identify.accuracy import tool_map
from calib.identify.fit import Size
from calib.identify.identify import Told, identify
from calib.identify.solution import SUBSETS, Method, Solution, Subset, Weights
from calib.noise.reading import IndicatorFigures
from calib.tripod.geometry import PARAMETER_NAMES
from calib.tripod.pipeline import Model
from calib.tripod.workspace import PLANES, PlaneMap, workspace_jacobian

MAP_POINTS = 5
"""Along each side of a map of the tool's error."""

USUAL: tuple[Subset, ...] = ("joint-offsets", "with-tolerances", "both", "leg-lengths")
"""The set that is shown where none is asked for: the first that the readings determine."""

NEAREST: tuple[Subset, ...] = ("with-tolerances", "both", "joint-offsets", "leg-lengths")
"""The set nearest to the machine: held by tolerances, where it can be."""


@dataclass(frozen=True, eq=False)
class SubsetChoice:
    """The solution of every subset that the data determine.

    ``refused`` holds the reason for every subset that the data do not determine.
    """

    solutions: dict[Subset, Solution]
    refused: dict[Subset, NotIdentifiable]

    @property
    def usual(self) -> Subset:
        """The set that is shown where none is asked for."""
        return next(subset for subset in USUAL if subset in self.solutions)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why sets are missing."""
        return tuple(f"{subset} left out: {one.found}" for subset, one in self.refused.items())

    @property
    def fitted(self) -> Solution:
        """The solution nearest to the machine."""
        return next(self.solutions[subset] for subset in NEAREST if subset in self.solutions)

    def tool_maps(self, subset: Subset) -> tuple[PlaneMap, ...]:
        """Expected error of the tool with a subset entered, on the three planes through Zero."""
        geometry = self.solutions[subset].model.geometry
        left = left_after(self.solutions, subset)
        return tuple(tool_map(geometry, *left, plane, MAP_POINTS) for plane in PLANES)


def choose_subset(
    model: Model,
    observed: Observations,
    method: Method = "exact",
    *,
    weights: Weights = "equal",
    indicator: IndicatorFigures | None = None,
    tolerance_mm: FloatArray,
    sizes: tuple[Size, ...] = (),
) -> SubsetChoice:
    """Identify all subsets.

    ``sizes`` of the model's effects are fitted with each of them. Raises NotIdentifiable where not
    even one subset is determined.
    """
    told = Told.of(model, observed, indicator or IndicatorFigures(), sizes)
    solutions: dict[Subset, Solution] = {}
    refused: dict[Subset, NotIdentifiable] = {}
    for subset in SUBSETS:
        try:
            solutions[subset] = identify(told, subset, method, weights, tolerance_mm=tolerance_mm)
        except NotIdentifiable as problem:
            refused[subset] = problem
    if not solutions:
        raise refused["joint-offsets"]
    return SubsetChoice(solutions, refused)


def left_after(solutions: dict[Subset, Solution], subset: Subset) -> tuple[FloatArray, FloatArray]:
    """What the parameters are off by with a subset entered: bias ``(6,)``, covariance ``(6, 6)``.

    The bias is what the full set would still change, made smaller until its mean square at the
    tool is the part that chance does not explain; none where the full set is not determined. Where
    not even joint offsets are, the parameters held by tolerances say what is left.
    """
    solution, full = solutions[subset], solutions.get("both")
    factor = (full or solution).spread
    held = solutions.get("with-tolerances")
    if held is not None and not {"both", "joint-offsets"} & solutions.keys():
        # a plain set alone would take what it leaves out for perfect
        shift = np.array(held.model.parameters_mm) - np.array(solution.model.parameters_mm)
        return shift, full_covariance(held, held.spread)
    covariance = full_covariance(solution, factor)
    if full is None or subset == "both":
        return np.zeros(len(PARAMETER_NAMES)), covariance
    shift = np.array(full.model.parameters_mm) - np.array(solution.model.parameters_mm)
    jacobian = workspace_jacobian(solution.model.geometry)
    moved = float(((jacobian @ shift) ** 2).sum(axis=1).mean())
    differing = full_covariance(full, factor) - covariance
    chance = float(np.einsum("pij,jk,pik->p", jacobian, differing, jacobian).mean())
    real = max(moved - max(chance, 0.0), 0.0)
    return shift * math.sqrt(real / moved if moved > 0.0 else 0.0), covariance


def full_covariance(solution: Solution, factor: float = 1.0) -> FloatArray:
    """Covariance ``(6, 6)`` in mm² with zeros for parameters that were not identified.

    With a factor, the variance of the noise counts so many times.
    """
    index = list(SUBSETS[solution.subset])
    covariance = np.zeros((len(PARAMETER_NAMES),) * 2)
    covariance[np.ix_(index, index)] = solution.inflated_mm2(factor)
    return covariance
