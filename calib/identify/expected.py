"""What a procedure will tell before it is measured, and the bound at the tool after it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from calib.arrays import BLIND, FloatArray, Observations, svd_of_all
from calib.identify.fit import prior_fit
from calib.identify.tool_bound import ToolBound, claim_of
from calib.noise.reading import Noise, reading_weights, visits
from calib.stats import coverage_factor
from calib.tripod.geometry import PARAMETER_NAMES
from calib.tripod.pipeline import Model
from calib.tripod.planning import TripodPlanning


def bound_of(
    model: Model, observed: Observations, noise: Noise, tolerance_mm: FloatArray
) -> ToolBound:
    """The bound at the tool with what the readings tell of the six parameters entered."""
    visited = visits(observed)
    fitted = prior_fit(model, visited, reading_weights(visited, noise), tolerance_mm).model
    claim = claim_of(fitted, observed, noise, tolerance_mm, model.parameters_mm)[0]
    return claim.bound(claim.expected)


@dataclass(frozen=True)
class ExpectedParameter:
    """Expanded uncertainty (95 %) to expect of a parameter, mm; None where readings do not tell it.

    ``alone_mm`` with the other kind (offsets, lengths) as in the machine file, ``all_mm`` with all
    six free; papers/000 (12)-(14). ``held_mm`` with all six held by their tolerances.
    """

    name: str
    alone_mm: float | None
    all_mm: float | None
    held_mm: float


@dataclass(frozen=True)
class ExpectedResult:
    """What a procedure will tell, before it is measured, if its readings show nothing new."""

    parameters: tuple[ExpectedParameter, ...]
    bound: ToolBound


def expected_of(planned: TripodPlanning, tolerance_mm: FloatArray) -> ExpectedResult:
    """Uncertainties and the bound at the tool for the noise of the indicator at hand."""
    jacobian = planned.examine().sensitivity.jacobian
    alone = np.concatenate([_half_widths(jacobian[:, :3]), _half_widths(jacobian[:, 3:])])
    every = _half_widths(jacobian)
    held = _half_widths(np.vstack([jacobian, np.diag(1.0 / tolerance_mm)]))
    rows = zip(PARAMETER_NAMES, alone.tolist(), every.tolist(), held.tolist(), strict=True)
    model, visited = Model(planned.geometry), visits(planned.planned)
    shown = replace(visited, value_mm=model.readings(visited))
    claim = claim_of(model, shown, planned.noise, tolerance_mm, model.parameters_mm)[0]
    parameters = tuple(
        ExpectedParameter(
            name,
            one if math.isfinite(one) else None,
            six if math.isfinite(six) else None,
            last,
        )
        for name, one, six, last in rows
    )
    return ExpectedResult(parameters, claim.bound(claim.expected))


def _half_widths(rows: FloatArray) -> FloatArray:
    """Expanded uncertainties ``(k,)`` from whitened rows ``(n, k)``; infinite where not seen."""
    _, singular, turned = svd_of_all(rows)
    if singular[-1] <= BLIND * singular[0]:
        return np.full(rows.shape[1], np.inf)
    return np.asarray(coverage_factor(math.inf) * np.linalg.norm(turned.T / singular, axis=1))
