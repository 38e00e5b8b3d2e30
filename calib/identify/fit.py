"""Least squares with one free zero for each mounting: the linear forms and the exact one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.errors import NotIdentifiable, UnreachablePosture
from calib.linalg import EXACT_BLIND, without_means
from calib.newton import Evaluate, Optimum, minimise
from calib.observations import FloatArray, IntArray, Observations
from calib.tripod.differences import Differences, reading_matrix
from calib.tripod.pipeline import Model, derivatives, simulate
from calib.tripod.plain import PlainDesign, plain_design

TOLERANCE = 1e-14
SMALL_STEP_MM = 1e-9
MOST_STEPS = 50

ROUNDING_STEP = 1e-4
"""In tolerances: no step of this size matters."""


@dataclass(frozen=True, eq=False)
class Fit:
    """Parameters ``(6,)`` in mm with the free ones fitted, and how the readings made them.

    ``design`` ``(n_readings, k)`` holds the derivatives of the readings by the free parameters,
    ``predicted_mm`` ``(n_readings,)`` the readings without zeros by the same form of the model, and
    ``estimator`` ``(k, n_readings)`` what a change of each reading does to each free parameter.
    """

    parameters_mm: FloatArray
    design: FloatArray
    predicted_mm: FloatArray
    estimator: FloatArray


def without_zeros(observed: Observations, weight: FloatArray, rows: FloatArray) -> FloatArray:
    """Subtract from each mounting its weighted mean; ``rows`` is ``(n_readings, ...)``.

    The best zero of a mounting is the weighted mean of what the model leaves, so removing the mean
    from residuals and design fits all zeros at once.
    """
    return without_means(observed.mount, weight, rows)


def papers_fit(
    model: Model, observed: Observations, free: tuple[int, ...], measured: Differences
) -> Fit:
    """Pseudoinverse of system (11) of papers/000: every difference counts alike."""
    design = reading_matrix(model.geometry, observed)[:, list(free)]
    inverse = np.linalg.pinv(measured.combine @ design)
    estimator = (measured.combine.T @ inverse.T).T
    return _linear(model, observed, free, design, np.asarray(estimator))


def weighted_fit(
    model: Model, observed: Observations, free: tuple[int, ...], weight: FloatArray
) -> Fit:
    """Linear fit of readings with free zeros: system (11) weighted by covariance (14)."""
    design = reading_matrix(model.geometry, observed)[:, list(free)]
    return _linear(model, observed, free, design, _estimator(observed, weight, design))


def _linear(
    model: Model,
    observed: Observations,
    free: tuple[int, ...],
    design: FloatArray,
    estimator: FloatArray,
) -> Fit:
    nominal = model.readings(observed)
    step = estimator @ (observed.value_mm - nominal)
    parameters = np.array(model.parameters_mm)
    parameters[list(free)] += step
    return Fit(parameters, design, nominal + design @ step, estimator)


def _estimator(observed: Observations, weight: FloatArray, design: FloatArray) -> FloatArray:
    """The weighted least squares estimate as a linear map of the readings ``(k, n_readings)``."""
    centred = without_zeros(observed, weight, design)
    root = np.sqrt(weight)
    return np.asarray(np.linalg.pinv(root[:, None] * centred, rcond=EXACT_BLIND) * root)


def exact_fit(
    model: Model, observed: Observations, free: tuple[int, ...], weight: FloatArray
) -> Fit:
    """Nonlinear weighted least squares on raw readings through the exact pipeline.

    Raises NotIdentifiable where the legs cannot meet or no optimum is found.
    """
    if model.effects:
        values = _fit_with_effects(model, observed, free, weight)
    else:
        optimum = PlainFit.of(model, observed, free, weight).solve(observed.value_mm[:, None])
        if not optimum.converged[0]:
            raise _no_optimum("no optimum within reach")
        values = optimum.values[:, 0]
    parameters = np.array(model.parameters_mm)
    parameters[list(free)] = values
    try:
        design = derivatives(model.geometry, parameters, observed, model.effects)[:, list(free)]
        fitted = model.with_parameters(parameters).readings(observed)
    except UnreachablePosture as problem:
        raise _no_optimum(str(problem)) from problem
    return Fit(parameters, design, fitted, _estimator(observed, weight, design))


def prior_fit(
    model: Model, observed: Observations, weight: FloatArray, tolerance_mm: FloatArray
) -> Fit:
    """All six parameters, each held to the model's value by its tolerance ``(6,)``, mm.

    The tolerance of a part is the standard deviation of a normal prior (Bayes; ridge regression
    with a weight for each parameter), so directions that the readings do not see stay where the
    parts' tolerances put them. Raises NotIdentifiable as `exact_fit`.
    """
    base = np.array(model.parameters_mm)
    precision = np.diag(tolerance_mm**-2.0)
    parameters = base.copy()
    for _ in range(MOST_STEPS):
        try:
            design = derivatives(model.geometry, parameters, observed, model.effects)
            fitted = model.with_parameters(parameters).readings(observed)
        except UnreachablePosture as problem:
            raise _no_optimum(str(problem)) from problem
        centred = without_zeros(observed, weight, design)
        pull = centred.T * weight
        inverse = np.linalg.inv(pull @ centred + precision)
        estimator = np.asarray(inverse @ pull)
        step = estimator @ (observed.value_mm - fitted) + inverse @ precision @ (base - parameters)
        parameters = parameters + step
        if float(np.abs(step).max()) < SMALL_STEP_MM:
            return Fit(parameters, design, fitted, estimator)
    # with very little noise, rounding goes on along what only the tolerances hold
    if (np.abs(step) < ROUNDING_STEP * tolerance_mm).all():
        return Fit(parameters, design, fitted, estimator)
    raise _no_optimum(f"no rest after {MOST_STEPS} steps")


def _fit_with_effects(
    model: Model, observed: Observations, free: tuple[int, ...], weight: FloatArray
) -> NDArray[np.float64]:
    """Free parameters ``(k,)`` through the stages, by scipy's trust region."""
    from scipy.optimize import least_squares  # 0.1 s to import: only where used

    index = list(free)
    root_weight = np.sqrt(weight)
    base = np.array(model.parameters_mm)

    def parameters(values: FloatArray) -> FloatArray:
        full = base.copy()
        full[index] = values
        return full

    def residual(values: NDArray[np.float64]) -> FloatArray:
        try:
            predicted = simulate(model.geometry, parameters(values), observed, model.effects)
        except UnreachablePosture:
            return np.full(len(observed), np.nan)  # the trust region then takes a shorter step
        return root_weight * without_zeros(observed, weight, observed.value_mm - predicted)

    def jacobian(values: NDArray[np.float64]) -> FloatArray:
        columns = derivatives(model.geometry, parameters(values), observed, model.effects)
        return -root_weight[:, None] * without_zeros(observed, weight, columns[:, index])

    start = weighted_fit(model, observed, free, weight).parameters_mm[index]
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
    return np.asarray(found.x)


def _no_optimum(found: str) -> NotIdentifiable:
    return NotIdentifiable(
        "exact identification",
        found,
        "readings that some machine near the nominal one could give",
        "Look for a wrong reading or unit; `glidecal solve` with --subset joint-offsets or"
        " --method linear may still answer.",
    )


COMPLEX_STEP_MM = 1e-30


@dataclass(frozen=True, eq=False)
class PlainFit:
    """A design prepared once, for any number of sessions measured alike.

    ``average`` ``(n_places, n_readings)`` makes the means, ``whiten`` ``(n_places, n_places)``
    takes out the zeros and scales to unit variance. ``curvature`` ``(n_places, k, k)`` are second
    derivatives at the model, ``first_step`` ``(k, n_places)`` is the linear solution.
    """

    design: PlainDesign
    base: FloatArray
    free: IntArray
    average: FloatArray
    whiten: FloatArray
    curvature: FloatArray
    first_step: FloatArray
    predicted: FloatArray

    @classmethod
    def of(
        cls, model: Model, observed: Observations, free: tuple[int, ...], weight: FloatArray
    ) -> PlainFit:
        """Prepare for readings taken like these, with weights ``(n_readings,)``."""
        place = observed.posture
        first = np.unique(place, return_index=True)[1]
        total = np.asarray(np.bincount(place, weight), dtype=np.float64)
        average = np.zeros((len(first), len(observed)))
        average[place, np.arange(len(observed))] = weight / total[place]
        places = observed.take(first)
        design = plain_design(model.geometry, places)
        centred = without_means(places.mount, total, np.eye(len(total)))
        whiten = np.asarray(np.sqrt(total)[:, None] * centred)
        base = np.array(model.parameters_mm)[:, None]
        index = np.array(free, dtype=np.intp)
        predicted, slope = design.readings_and_derivatives(base)
        steps = base + 1j * COMPLEX_STEP_MM * np.eye(6)[:, index]
        bend = design.readings_and_derivatives(steps)[1][index].imag / COMPLEX_STEP_MM
        curvature = np.einsum("mn,inj->mij", whiten, bend)
        inverse = np.linalg.pinv(whiten @ slope[index, :, 0].T, rcond=EXACT_BLIND)
        first_step = np.asarray(inverse, dtype=np.float64)
        return cls(design, base, index, average, whiten, curvature, first_step, whiten @ predicted)

    def solve(self, value_mm: FloatArray) -> Optimum:
        """Best free parameters of sessions with readings ``(n_readings, b)``, mm."""
        return self.solve_means(self.average @ value_mm)

    def solve_means(self, mean_mm: FloatArray) -> Optimum:
        """The same from the means ``(n_places, b)`` of `average`."""
        measured = self.whiten @ mean_mm
        start = self.first_step @ (measured - self.predicted)
        bent = np.einsum("nij,ib,jb->nb", self.curvature, start, start)
        start = start - self.first_step @ (0.5 * bent) + self.base[self.free]
        return minimise(self._evaluate(measured), start, self.curvature)

    def full(self, values: FloatArray) -> FloatArray:
        """All six parameters ``(6, b)`` for free ones ``(k, b)``."""
        full = np.repeat(self.base, values.shape[1], axis=1)
        full[self.free] = values
        return full

    def _evaluate(self, measured: FloatArray) -> Evaluate:
        def evaluate(
            values: FloatArray, problem: NDArray[np.intp]
        ) -> tuple[FloatArray, FloatArray]:
            with np.errstate(invalid="ignore"):  # out of reach: NaN, and the step is refused
                predicted, slope = self.design.readings_and_derivatives(self.full(values))
            if len(self.free) < len(slope):
                slope = slope[self.free]
            return measured[:, problem] - self.whiten @ predicted, np.matmul(self.whiten, slope)

        return evaluate
