"""Which parameters to identify: the set with the smallest expected error at the tool."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from calib.accuracy import ToolError, tool_error
from calib.errors import NotIdentifiable
from calib.identify import identify
from calib.noise import IndicatorFigures
from calib.observations import FloatArray, Observations
from calib.orthoglide.geometry import PARAMETER_NAMES, Geometry
from calib.orthoglide.model import Model
from calib.orthoglide.workspace import workspace_jacobian
from calib.solution import SUBSETS, Method, Solution, Subset, Weights

CLEARLY_BETTER = 0.9
"""Another set must promise less than this share of the joint offsets' tool error."""


@dataclass(frozen=True, eq=False)
class SubsetChoice:
    """The recommended subset, why, and the solution of every subset that the data determine.

    ``tool_error_mm`` is the expected r.m.s. error of the tool over the workspace for each, and for
    ``with-tolerances`` where the tolerances of the parts are stated. ``refused`` holds the reason
    for every subset that the data do not determine.
    """

    recommended: Subset
    reasons: tuple[str, ...]
    solutions: dict[Subset, Solution]
    tool_error_mm: dict[Subset, float]
    refused: dict[Subset, NotIdentifiable]


def choose_subset(
    model: Model,
    observed: Observations,
    method: Method = "exact",
    *,
    weights: Weights = "equal",
    indicator: IndicatorFigures | None = None,
    tolerance_mm: FloatArray | None = None,
) -> SubsetChoice:
    """Identify all subsets and compare variance plus squared bias at the tool.

    Bias of a smaller set is what the full set would change at the tool, less what chance alone
    would change; noise is the larger of the reading noise and what the full set leaves. Effects
    outside the six parameters are not in these figures. Raises NotIdentifiable where not even one
    subset is determined.
    """
    solutions: dict[Subset, Solution] = {}
    refused: dict[Subset, NotIdentifiable] = {}
    wanted = [s for s in SUBSETS if s != "with-tolerances" or tolerance_mm is not None]
    for subset in wanted:
        try:
            solutions[subset] = identify(
                model,
                observed,
                subset,
                method,
                weights=weights,
                indicator=indicator,
                tolerance_mm=tolerance_mm,
            )
        except NotIdentifiable as problem:
            refused[subset] = problem
    if not solutions:
        raise refused["joint-offsets"]
    errors = {subset: _expected(solutions, subset) for subset in solutions}
    best = min(errors, key=lambda subset: errors[subset])
    if errors[best] > CLEARLY_BETTER * errors.get("joint-offsets", math.inf):
        best = "joint-offsets"
    return SubsetChoice(
        best,
        _reasons(best, errors, refused),
        solutions,
        errors,
        refused,
    )


def error_before(solution: Solution, model: Model) -> ToolError:
    """The tool's error with the values that the controller holds, as far as this solution tells."""
    shift = np.array(solution.model.parameters_mm) - np.array(model.parameters_mm)
    return _tool_error(solution, shift, fitted=False)


def error_after(solution: Solution) -> ToolError:
    """The tool's error once the values of this solution are entered: what noise alone leaves."""
    return _tool_error(solution, np.zeros(len(PARAMETER_NAMES)), fitted=True)


def _tool_error(solution: Solution, shift: FloatArray, *, fitted: bool) -> ToolError:
    """Before, the shift itself is known with the covariance and the tool is off by the shift."""
    covariance = spread(solution) * full_covariance(solution)
    found = tool_error(solution.model.geometry, shift, covariance)
    if fitted:
        return found
    exact = tool_error(solution.model.geometry, shift, np.zeros_like(covariance))
    return ToolError(exact.rms_mm, found.standard_uncertainty_mm, exact.worst_mm)


def full_covariance(solution: Solution) -> FloatArray:
    """Covariance ``(6, 6)`` in mm² with zeros for parameters that were not identified."""
    index = list(SUBSETS[solution.subset])
    covariance = np.zeros((len(PARAMETER_NAMES),) * 2)
    covariance[np.ix_(index, index)] = solution.covariance_mm2
    return covariance


def spread(solution: Solution) -> float:
    """Factor on the covariance where the model leaves more than the noise."""
    return max(1.0, solution.lack_of_fit.statistic) if solution.lack_of_fit else 1.0


def _expected(solutions: dict[Subset, Solution], subset: Subset) -> float:
    """Expected r.m.s. tool error of a subset over the workspace, mm."""
    solution, full = solutions[subset], solutions.get("both")
    factor = spread(full) if full else max(spread(one) for one in solutions.values())
    geometry = solution.model.geometry
    variance = _mean_square(geometry, factor * full_covariance(solution))
    if full is None or subset in ("both", "with-tolerances"):
        return math.sqrt(variance)
    shift = np.array(full.model.parameters_mm) - np.array(solution.model.parameters_mm)
    moved = float(((workspace_jacobian(geometry) @ shift) ** 2).sum(axis=1).mean())
    chance = _mean_square(geometry, factor * full.covariance_mm2) - variance
    return math.sqrt(variance + max(moved - max(chance, 0.0), 0.0))


def _mean_square(geometry: Geometry, covariance_mm2: FloatArray) -> float:
    jacobian = workspace_jacobian(geometry)
    return float(np.einsum("pij,jk,pik->p", jacobian, covariance_mm2, jacobian).mean())


def _reasons(
    best: Subset, errors: dict[Subset, float], refused: dict[Subset, NotIdentifiable]
) -> tuple[str, ...]:
    promised = ", ".join(f"{subset} {error:.3f} mm" for subset, error in errors.items())
    reasons = [f"expected tool error over the workspace: {promised}"]
    if best == "joint-offsets" and min(errors.values()) < errors[best]:
        reasons.append("no other set is clearly better, and any controller can hold joint offsets")
    reasons += [f"{subset} left out: {problem.found}" for subset, problem in refused.items()]
    if "both" in refused:
        reasons.append("what the smaller sets miss of the other parameters cannot be assessed")
    return tuple(reasons)
