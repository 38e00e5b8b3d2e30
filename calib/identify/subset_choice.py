"""The sets of parameters that the papers identify, side by side: views, none of them chosen."""

from __future__ import annotations

from dataclasses import dataclass

from calib.arrays import FloatArray, Observations
from calib.errors import NotIdentifiable
from calib.identify.fit import Size
from calib.identify.identify import IdentificationCase, identify
from calib.identify.solution import SUBSETS, Method, Solution, Subset, Weights
from calib.noise.reading import IndicatorFigures
from calib.tripod.pipeline import Model

USUAL: tuple[Subset, ...] = ("joint-offsets", "with-tolerances", "both", "leg-lengths")
"""The set that is shown where none is asked for: the first that the readings determine."""


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
        return tuple(
            f"{subset} left out: {problem.found}" for subset, problem in self.refused.items()
        )


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
    case = IdentificationCase.of(model, observed, indicator or IndicatorFigures(), sizes)
    solutions: dict[Subset, Solution] = {}
    refused: dict[Subset, NotIdentifiable] = {}
    for subset in SUBSETS:
        try:
            solutions[subset] = identify(case, subset, method, weights, tolerance_mm=tolerance_mm)
        except NotIdentifiable as problem:
            refused[subset] = problem.with_traceback(None)  # its frames hold all arrays
    if not solutions:
        raise refused["joint-offsets"]
    return SubsetChoice(solutions, refused)


def usual_solution(
    model: Model, observed: Observations, *, indicator: IndicatorFigures, tolerance_mm: FloatArray
) -> Solution:
    """The usual set of `choose_subset`, by the exact method; the sets behind it are not identified.

    Raises NotIdentifiable alike.
    """
    case = IdentificationCase.of(model, observed, indicator)
    refused: list[NotIdentifiable] = []
    for subset in USUAL:
        try:
            return identify(case, subset, tolerance_mm=tolerance_mm)
        except NotIdentifiable as problem:
            refused.append(problem)
    raise refused[0]
