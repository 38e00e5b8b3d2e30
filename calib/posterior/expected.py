"""What a procedure will tell before it is measured, and the bound at the tool after it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import starmap
from typing import Annotated

import numpy as np

from calib.arrays import BLIND, FloatArray, svd_of_all
from calib.noise.reading import IndicatorFigures, visit_means
from calib.posterior.cells import SessionCase
from calib.posterior.correction import correction
from calib.posterior.models import Posterior
from calib.posterior.posterior import posterior
from calib.quantity import Quantity
from calib.stats import coverage_factor
from calib.tripod.geometry import PARAMETER_NAMES
from calib.tripod.pipeline import Model
from calib.tripod.planning import TripodPlanning


def _to_expect(label: str, text: str) -> Quantity:
    return Quantity(label, "", "uncertainty", 3, text, "not determined")


@dataclass(frozen=True)
class ExpectedParameter:
    """Expanded uncertainty (95 %) to expect of a parameter; null where readings do not tell it.

    papers/000 (12)-(14).
    """

    name: Annotated[
        str, Quantity("± (95 %), mm, to expect", words="the parameter that will be identified")
    ]
    alone_mm: Annotated[float | None, _to_expect("its kind alone", "offsets, or lengths, alone")]
    all_mm: Annotated[float | None, _to_expect("all six", "all six free")]
    held_mm: Annotated[
        float,
        _to_expect("within tolerances", "all six, within the tolerances of the machine file"),
    ]


@dataclass(frozen=True)
class ExpectedResult:
    """What a procedure will tell, before it is measured, if its readings show nothing new.

    ``bound_mm`` is of the tool with joint offsets entered, touched off; the ``worst`` name and
    place is behind most of it, None where that is no effect.
    """

    parameters: tuple[ExpectedParameter, ...]
    bound_mm: float
    worst: tuple[str, str] | None


def expected_of(planning: TripodPlanning, tolerance_mm: FloatArray) -> ExpectedResult:
    """Uncertainties and the bound at the tool for the noise of the indicator at hand."""
    jacobian = planning.examine().sensitivity.jacobian
    alone = np.concatenate([_half_widths(jacobian[:, :3]), _half_widths(jacobian[:, 3:])])
    half_widths = _half_widths(jacobian)
    # in units of the tolerances, so that a small one beside a large one is no lost direction
    within = tolerance_mm * _half_widths(np.vstack([jacobian * tolerance_mm, np.eye(6)]))
    figures = [[mm if math.isfinite(mm) else None for mm in part] for part in (alone, half_widths)]
    columns = PARAMETER_NAMES, *figures, within.tolist()
    prior = posterior([_nothing_new(planning, tolerance_mm)])
    offsets = correction(prior, "offsets")
    parameters = tuple(starmap(ExpectedParameter, zip(*columns, strict=True)))
    worst = _worst(prior, offsets.off.values)
    return ExpectedResult(parameters, offsets.off.bound_in("touched-off"), worst)


def _nothing_new(planning: TripodPlanning, tolerance_mm: FloatArray) -> SessionCase:
    """Readings of the nominal machine: one of each cell, as sure as all of them are."""
    model, visits = Model(planning.geometry), visit_means(planning.planned)
    _, first, number = np.unique(visits.cell, return_index=True, return_inverse=True)
    expected = replace(visits, value_mm=model.readings(visits)).take(first)
    together = np.bincount(number, visits.averaged).astype(np.float64)
    figures = IndicatorFigures(repeatability_mm=planning.noise.standard_deviation_mm)
    return SessionCase(model, replace(expected, averaged=together), figures, tolerance_mm)


def _worst(prior: Posterior, values: FloatArray) -> tuple[str, str] | None:
    """The name and place of the largest share of the expected square."""
    shares: dict[tuple[str, str] | None, float] = {}
    distances = prior.tool_errors["touched-off"].distances(values).tolist()
    for model, (weight, square, _) in zip(prior.models, distances, strict=True):
        names: list[tuple[str, str] | None] = [
            (prior.components[k].id, prior.components[k].where) for k in model.members
        ]
        for name in names or [None]:
            shares[name] = shares.get(name, 0.0) + weight * square
    return max(shares, key=shares.__getitem__)


def _half_widths(rows: FloatArray) -> FloatArray:
    """Expanded uncertainties ``(k,)`` from whitened rows ``(n, k)``; infinite where not seen."""
    _, singular, vectors = svd_of_all(rows)
    if singular[-1] <= BLIND * singular[0]:
        return np.full(rows.shape[1], np.inf)
    return np.asarray(coverage_factor(math.inf) * np.linalg.norm(vectors.T / singular, axis=1))
