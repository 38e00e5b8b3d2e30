"""Least squares with one free zero for each mounting: the linear and the exact form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.errors import NotIdentifiable, UnreachablePosture
from calib.observations import FloatArray, Observations
from calib.orthoglide.model import Model
from calib.orthoglide.pipeline import derivatives, simulate

TOLERANCE = 1e-14


@dataclass(frozen=True, eq=False)
class Fit:
    """Parameters ``(6,)`` with the free ones fitted, and the design at that point.

    ``design`` ``(n_readings, k)`` holds the derivatives of the readings by the free parameters.
    """

    parameters_mm: FloatArray
    design: FloatArray


def without_zeros(observed: Observations, rows: FloatArray) -> FloatArray:
    """Subtract from each mounting its weighted mean; ``rows`` is ``(n_readings, ...)``.

    The best zero of a mounting is the weighted mean of what the model leaves, so removing the mean
    from residuals and design fits all zeros at once.
    """
    total = np.bincount(observed.mount, observed.averaged)
    flat = rows.reshape(len(rows), -1)
    means = np.stack(
        [np.bincount(observed.mount, observed.averaged * column) / total for column in flat.T],
        axis=1,
    )
    return (flat - means[observed.mount]).reshape(rows.shape)


def exact_fit(
    model: Model, observed: Observations, free: tuple[int, ...], start: FloatArray
) -> Fit:
    """Nonlinear weighted least squares on raw readings through the exact pipeline.

    ``start`` ``(6,)`` in mm. Raises NotIdentifiable where scipy finds no optimum.
    """
    from scipy.optimize import least_squares  # 0.1 s to import: only where used

    index = list(free)
    root_weight = np.sqrt(observed.averaged)

    def parameters(values: FloatArray) -> FloatArray:
        full = start.copy()
        full[index] = values
        return full

    def residual(values: NDArray[np.float64]) -> FloatArray:
        try:
            predicted = simulate(model.geometry, parameters(values), observed, model.effects)
        except UnreachablePosture:
            return np.full(len(observed), np.nan)  # the trust region then takes a shorter step
        return root_weight * without_zeros(observed, observed.value_mm - predicted)

    def design(values: NDArray[np.float64]) -> FloatArray:
        columns = derivatives(model.geometry, parameters(values), observed, model.effects)
        return columns[:, index]

    def jacobian(values: NDArray[np.float64]) -> FloatArray:
        return -root_weight[:, None] * without_zeros(observed, design(values))

    found = least_squares(
        residual,
        start[index],
        jac=jacobian,
        x_scale="jac",
        ftol=TOLERANCE,
        xtol=TOLERANCE,
        gtol=TOLERANCE,
    )
    if not found.success:
        raise NotIdentifiable("exact identification", str(found.message), "a fit that converges")
    return Fit(parameters(found.x), design(found.x))
