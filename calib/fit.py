"""Least squares with one free zero for each mounting: the linear forms and the exact one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.errors import NotIdentifiable, UnreachablePosture
from calib.observations import FloatArray, Observations
from calib.orthoglide.differences import Differences
from calib.orthoglide.linear import reading_matrix
from calib.orthoglide.model import Model
from calib.orthoglide.pipeline import derivatives, simulate

TOLERANCE = 1e-14


@dataclass(frozen=True, eq=False)
class Fit:
    """Parameters ``(6,)`` in mm with the free ones fitted.

    ``design`` ``(n_readings, k)`` holds the derivatives of the readings by the free parameters and
    ``predicted_mm`` ``(n_readings,)`` the readings without zeros, by the same form of the model.
    """

    parameters_mm: FloatArray
    design: FloatArray
    predicted_mm: FloatArray

    def information(self, observed: Observations) -> FloatArray:
        """Information on the free parameters for unit noise ``(k, k)``, zeros fitted."""
        centred = without_zeros(observed, self.design)
        return np.asarray(centred.T @ (observed.averaged[:, None] * centred))

    def left_over(self, observed: Observations) -> FloatArray:
        """What the fit leaves of each reading ``(n_readings,)``, zeros fitted, mm."""
        return without_zeros(observed, observed.value_mm - self.predicted_mm)


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


def papers_fit(
    model: Model, observed: Observations, free: tuple[int, ...], measured: Differences
) -> Fit:
    """Pseudoinverse of system (11) of papers/000: every difference counts alike."""
    design = reading_matrix(model.geometry, observed)[:, list(free)]
    left = measured.value_mm - measured.combine @ model.readings(observed)
    return _linear(model, observed, free, np.linalg.pinv(measured.combine @ design) @ left)


def weighted_fit(model: Model, observed: Observations, free: tuple[int, ...]) -> Fit:
    """Linear fit of readings with free zeros: system (11) weighted by covariance (14)."""
    design = reading_matrix(model.geometry, observed)[:, list(free)]
    root_weight = np.sqrt(observed.averaged)
    left = root_weight[:, None] * without_zeros(observed, design)
    right = root_weight * without_zeros(observed, observed.value_mm - model.readings(observed))
    return _linear(model, observed, free, np.asarray(np.linalg.lstsq(left, right, rcond=None)[0]))


def _linear(
    model: Model, observed: Observations, free: tuple[int, ...], step: NDArray[np.floating]
) -> Fit:
    design = reading_matrix(model.geometry, observed)[:, list(free)]
    parameters = np.array(model.parameters_mm)
    parameters[list(free)] += step
    predicted = np.asarray(model.readings(observed) + design @ step, dtype=np.float64)
    return Fit(parameters, design, predicted)


def exact_fit(model: Model, observed: Observations, free: tuple[int, ...]) -> Fit:
    """Nonlinear weighted least squares on raw readings through the exact pipeline.

    Starts from the linear fit, or from the model where that is out of reach. Raises NotIdentifiable
    where the legs cannot meet even there or scipy finds no optimum.
    """
    from scipy.optimize import least_squares  # 0.1 s to import: only where used

    index = list(free)
    root_weight = np.sqrt(observed.averaged)
    base = np.array(model.parameters_mm)

    def parameters(values: FloatArray) -> FloatArray:
        full = base.copy()
        full[index] = values
        return full

    def predicted(values: FloatArray) -> FloatArray:
        return np.asarray(
            simulate(model.geometry, parameters(values), observed, model.effects), dtype=np.float64
        )

    def residual(values: NDArray[np.float64]) -> FloatArray:
        try:
            left = observed.value_mm - predicted(values)
        except UnreachablePosture:
            return np.full(len(observed), np.nan)  # the trust region then takes a shorter step
        return root_weight * without_zeros(observed, left)

    def design(values: NDArray[np.float64]) -> FloatArray:
        columns = derivatives(model.geometry, parameters(values), observed, model.effects)
        return columns[:, index]

    def jacobian(values: NDArray[np.float64]) -> FloatArray:
        return -root_weight[:, None] * without_zeros(observed, design(values))

    start = weighted_fit(model, observed, free).parameters_mm[index]
    if not np.isfinite(residual(start)).all():
        start = base[index]
    try:
        found = least_squares(
            residual,
            start,
            jac=jacobian,
            x_scale="jac",
            ftol=TOLERANCE,
            xtol=TOLERANCE,
            gtol=TOLERANCE,
        )
    except (UnreachablePosture, ValueError) as problem:
        raise _no_optimum(str(problem)) from problem
    if not found.success:
        raise _no_optimum(str(found.message))
    return Fit(parameters(found.x), design(found.x), predicted(found.x))


def _no_optimum(found: str) -> NotIdentifiable:
    return NotIdentifiable(
        "exact identification",
        found,
        "readings that some machine near the nominal one could give",
        "Look for a wrong reading or unit; try --subset joint-offsets or --method linear.",
    )
