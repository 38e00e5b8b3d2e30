"""Which parameters to identify: the set with the smallest expected error at the tool."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from calib.errors import NotIdentifiable
from calib.identify import identify
from calib.noise import IndicatorFigures
from calib.observations import FloatArray, Observations
from calib.orthoglide.geometry import Geometry
from calib.orthoglide.kinematics import inverse, tool_jacobians
from calib.orthoglide.model import Model
from calib.solution import SUBSETS, Method, Solution, Subset, Weights

CLEARLY_BETTER = 0.9
"""Another set must promise less than this share of the joint offsets' tool error."""


@dataclass(frozen=True, eq=False)
class SubsetChoice:
    """The recommended subset, why, and the solution of every subset that the data determine.

    ``tool_error_mm`` is the expected r.m.s. error of the tool over the workspace for each;
    ``refused`` holds the reason for every subset that the data do not determine.
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
) -> SubsetChoice:
    """Identify all subsets and compare variance plus squared bias at the tool.

    Bias of a smaller set is what the full set would change at the tool, less what chance alone
    would change; noise is the larger of the reading noise and what the full set leaves. Effects
    outside the six parameters are not in these figures. Raises NotIdentifiable where not even one
    subset is determined.
    """
    solutions: dict[Subset, Solution] = {}
    refused: dict[Subset, NotIdentifiable] = {}
    for subset in SUBSETS:
        try:
            solutions[subset] = identify(
                model, observed, subset, method, weights=weights, indicator=indicator
            )
        except NotIdentifiable as problem:
            refused[subset] = problem
    if not solutions:
        raise refused["joint-offsets"]
    errors = {subset: _tool_error(solutions, subset) for subset in solutions}
    best = min(errors, key=lambda subset: errors[subset])
    if errors[best] > CLEARLY_BETTER * errors.get("joint-offsets", math.inf):
        best = "joint-offsets"
    return SubsetChoice(best, _reasons(best, errors, refused), solutions, errors, refused)


def _tool_error(solutions: dict[Subset, Solution], subset: Subset) -> float:
    """Expected r.m.s. tool error of a subset over the workspace, mm."""
    solution, full = solutions[subset], solutions.get("both")
    spread = _spread(full or solution)
    jacobian = workspace_jacobian(solution.model.geometry)
    columns = list(SUBSETS[subset])
    variance = _mean_square(jacobian[:, :, columns], spread * solution.covariance_mm2)
    if full is None or subset == "both":
        return float(np.sqrt(variance))
    shift = np.array(full.model.parameters_mm) - np.array(solution.model.parameters_mm)
    moved = float(((jacobian @ shift) ** 2).sum(axis=1).mean())
    chance = _mean_square(jacobian, spread * full.covariance_mm2) - variance
    return float(np.sqrt(variance + max(moved - max(chance, 0.0), 0.0)))


def _spread(solution: Solution) -> float:
    """Factor on the covariance where the model leaves more than the noise."""
    return max(1.0, solution.lack_of_fit.statistic) if solution.lack_of_fit else 1.0


def _mean_square(jacobian: FloatArray, covariance_mm2: FloatArray) -> float:
    return float(np.einsum("pij,jk,pik->p", jacobian, covariance_mm2, jacobian).mean())


def workspace_jacobian(geometry: Geometry, points_per_axis: int = 5) -> FloatArray:
    """Tool derivatives ``(n_points, 3, 6)`` on a grid over the cube of the joint limits."""
    axis = np.linspace(geometry.travel_min_mm, geometry.travel_max_mm, points_per_axis)
    tool = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    length = geometry.leg_length_mm
    return np.concatenate(tool_jacobians(tool, inverse(tool, length), length), axis=2)


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
