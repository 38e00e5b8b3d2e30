"""Least squares with one free zero for each mounting: the linear forms and the exact one."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from calib.arrays import (
    EXACT_BLIND,
    TOOL,
    Conditions,
    FloatArray,
    Observations,
    without_zeros,
)
from calib.errors import NotIdentifiable, UnreachablePosture
from calib.newton import Optimum, minimise
from calib.tripod.differences import Differences, reading_matrix
from calib.tripod.geometry import PARAMETER_NAMES
from calib.tripod.pipeline import (
    COMPLEX_STEP_MM,
    Model,
    readings_and_derivatives,
    simulate,
)
from calib.tripod.plain import plain_design

if TYPE_CHECKING:  # the catalogue comes with it, which a fit without effects does not need
    from calib.tripod.effects.effect import EffectInstance

SMALL_STEP_MM = 1e-9
MOST_STEPS = 50

ROUNDING_STEP = 1e-4
"""In tolerances: no step of this size matters."""

NO_TOLERANCE_MM = 0.01
"""In place of the tolerance of a parameter that has none."""


@dataclass(frozen=True)
class Size:
    """A value of the model's effects that is fitted beside the parameters, in its own unit.

    ``at`` are number of the effect in the model and of the value in it: places may share one.
    ``tolerance`` is a size that nobody would remark on.
    """

    name: str
    unit: str
    tolerance: float
    at: tuple[tuple[int, int], ...]

    def value(self, model: Model) -> float:
        """What the model says."""
        effect, number = self.at[0]
        return float(np.real(cast("EffectInstance", model.effects[effect]).values[number]))


@dataclass(frozen=True, eq=False)
class Fit:
    """The model with the free parameters fitted, and how the readings made them.

    ``design`` ``(n_readings, k)`` holds the derivatives of the readings by what is free, sizes of
    effects behind parameters, ``predicted_mm`` ``(n_readings,)`` the readings without zeros by the
    same form of the model, and ``estimator`` ``(k, n_readings)`` what a change of each reading does
    to each of them.
    """

    model: Model
    design: FloatArray
    predicted_mm: FloatArray
    estimator: FloatArray

    @property
    def parameters_mm(self) -> FloatArray:
        """All six parameters ``(6,)``, mm."""
        return np.array(self.model.parameters_mm)


def plane_tilts_mrad(model: Model, observations: Observations) -> list[tuple[int, float]]:
    """First row of each mounting over a plane, and how far the plane leans along the leg there."""
    residual_mm = observations.value_mm - model.readings(observations)
    tilts_mrad = []
    for rows in observations.mountings:
        along = observations.along_mm[rows]
        if not np.isnan(along).any() and np.ptp(along) > 0.0:
            slope = np.polynomial.Polynomial.fit(along, residual_mm[rows], 1).convert().coef[-1]
            tilts_mrad.append((int(rows[0]), 1e3 * float(slope)))
    return tilts_mrad


def papers_fit(
    model: Model, observations: Observations, free: tuple[int, ...], measured: Differences
) -> Fit:
    """Pseudoinverse of system (11) of papers/000: every difference counts alike."""
    design = reading_matrix(model.geometry, observations)[:, list(free)]
    inverse = np.linalg.pinv(measured.combine @ design)
    estimator = (measured.combine.T @ inverse.T).T
    return _linear(model, observations, free, design, np.asarray(estimator))


def weighted_fit(
    model: Model, observations: Observations, free: tuple[int, ...], weight: FloatArray
) -> Fit:
    """Linear fit of readings with free zeros: system (11) weighted by covariance (14)."""
    design = reading_matrix(model.geometry, observations)[:, list(free)]
    return _linear(model, observations, free, design, _estimator(observations, weight, design))


def _linear(
    model: Model,
    observations: Observations,
    free: tuple[int, ...],
    design: FloatArray,
    estimator: FloatArray,
) -> Fit:
    nominal = model.readings(observations)
    step = estimator @ (observations.value_mm - nominal)
    parameters = np.array(model.parameters_mm)
    parameters[list(free)] += step
    return Fit(model.with_parameters(parameters), design, nominal + design @ step, estimator)


def _estimator(observations: Observations, weight: FloatArray, design: FloatArray) -> FloatArray:
    """The weighted least squares estimate as a linear map of the readings ``(k, n_readings)``."""
    centred = without_zeros(observations, weight, design)
    root = np.sqrt(weight)
    return np.asarray(np.linalg.pinv(root[:, None] * centred, rcond=EXACT_BLIND) * root)


def exact_fit(
    model: Model,
    observations: Observations,
    free: tuple[int, ...],
    weight: FloatArray,
    sizes: tuple[Size, ...] = (),
    begin: Model | None = None,
) -> Fit:
    """Nonlinear weighted least squares on raw readings through the exact pipeline.

    ``sizes`` of the model's effects are fitted with the parameters, from values of ``begin`` on.
    Raises NotIdentifiable where the legs cannot meet or no optimum is found.
    """
    if model.effects:
        spread = np.full(len(free) + len(sizes), np.inf)
        fitted = _at_rest(model, observations, free, weight, sizes, spread, begin).model
    else:
        optimum = PlainFit(model, observations, free, weight).solve(observations.value_mm[:, None])
        if not optimum.converged[0]:
            raise _no_optimum("no optimum within reach", observations)
        fitted = _moved_to(model, free, (), optimum.values[:, 0])
    with within_reach(observations):
        predicted, design = _predicted(fitted, observations, free, sizes)
    return Fit(fitted, design, predicted, _estimator(observations, weight, design))


def prior_fit(
    model: Model,
    observations: Observations,
    weight: FloatArray,
    tolerance_mm: FloatArray,
    sizes: tuple[Size, ...] = (),
    begin: Model | None = None,
) -> Fit:
    """All six parameters, each held to the model's value by its tolerance ``(6,)``, mm.

    The tolerance of a part is the standard deviation of a normal prior (Bayes; ridge regression
    with a weight for each parameter), so directions that the readings do not see stay where the
    parts' tolerances put them. Sizes of effects are free. Raises NotIdentifiable as `exact_fit`.
    """
    free = tuple(range(len(PARAMETER_NAMES)))
    tolerance = np.concatenate([tolerance_mm, np.full(len(sizes), np.inf)])
    return _at_rest(model, observations, free, weight, sizes, tolerance, begin)


def _at_rest(
    model: Model,
    observations: Observations,
    free: tuple[int, ...],
    weight: FloatArray,
    sizes: tuple[Size, ...],
    tolerance: FloatArray,
    begin: Model | None = None,
) -> Fit:
    """Gauss and Newton's steps until nothing moves; values have tolerances ``(k,)``, some none.

    They begin at the values of ``begin``, else at those of the model, which tolerances are about.
    """
    precision = np.diag(tolerance**-2.0)
    base = _values_of(model, free, sizes)
    values = base if begin is None else _values_of(begin, free, sizes)
    within = tolerance[: len(free)]
    least = np.where(np.isfinite(within), within, NO_TOLERANCE_MM)
    least = np.append(least, [size.tolerance for size in sizes])
    with within_reach(observations):
        evaluate = _evaluator(model, observations, free, sizes)
    for _ in range(MOST_STEPS):
        with within_reach(observations):
            predicted, design = evaluate(values)
        centred = without_zeros(observations, weight, design)
        pull = centred.T * weight
        with within_reach(observations):
            inverse = np.linalg.inv(pull @ centred + precision)
        estimator = np.asarray(inverse @ pull)
        step = estimator @ (observations.value_mm - predicted) + inverse @ precision @ (
            base - values
        )
        values = values + step
        # with very little noise, rounding goes on along what only the tolerances hold
        if float(np.abs(step).max()) < SMALL_STEP_MM:
            break
    else:
        if not (np.abs(step) < ROUNDING_STEP * least).all():
            raise _no_optimum(f"no rest after {MOST_STEPS} steps", observations)
    return Fit(_moved_to(model, free, sizes, values), design, predicted, estimator)


def _values_of(model: Model, free: Sequence[int], sizes: Sequence[Size]) -> FloatArray:
    """Free parameters, then sizes ``(k,)``."""
    base = np.array(model.parameters_mm)[list(free)]
    return np.concatenate([base, [size.value(model) for size in sizes]])


def _moved_to(
    model: Model, free: Sequence[int], sizes: Sequence[Size], values: Sequence[Any] | FloatArray
) -> Model:
    """The model with these free parameters and sizes ``(k,)``, which may be complex in sizes."""
    parameters = np.array(model.parameters_mm)
    parameters[list(free)] = np.real(values[: len(free)])
    effects = list(model.effects)
    for size, value in zip(sizes, values[len(free) :], strict=True):
        for effect, number in size.at:
            effects[effect] = cast("EffectInstance", effects[effect]).with_value(number, value)
    return replace(model.with_parameters(parameters), effects=tuple(effects))


def _evaluator(
    model: Model, observations: Observations, free: Sequence[int], sizes: Sequence[Size]
) -> Callable[[FloatArray], tuple[FloatArray, FloatArray]]:
    """`_predicted` for values ``(k,)``; in closed form, each posture once, where no effect acts."""

    def simulated(values: FloatArray) -> tuple[FloatArray, FloatArray]:
        return _predicted(_moved_to(model, free, sizes, values), observations, free, sizes)

    if model.effects:
        return simulated
    first, place = np.unique(observations.posture, return_index=True, return_inverse=True)[1:]
    closed = plain_design(model.geometry, observations.take(first))

    def plain(values: FloatArray) -> tuple[FloatArray, FloatArray]:
        with np.errstate(invalid="ignore"):
            predicted, slope = closed.readings_and_derivatives(values[:, None])
        if not np.isfinite(predicted).all():  # the simulation tells where
            return simulated(values)
        return predicted[place, 0], slope[:, place, 0].T

    return plain


def design_of(
    model: Model, observations: Conditions, free: Sequence[int], sizes: Sequence[Size]
) -> FloatArray:
    """Derivatives ``(n_readings, k)`` by free parameters and sizes, by the complex step."""
    return _predicted(model, observations, free, sizes)[1]


def _predicted(
    model: Model, observations: Conditions, free: Sequence[int], sizes: Sequence[Size]
) -> tuple[FloatArray, FloatArray]:
    """Readings ``(n_readings,)`` and `design_of`."""
    machine = model.geometry, model.parameters_mm, observations
    predicted, base = readings_and_derivatives(*machine, model.effects)
    columns = [base[:, list(free)]]
    for size in sizes:
        further = _moved_to(model, (), (size,), [size.value(model) + 1j * COMPLEX_STEP_MM])
        stepped = simulate(*machine, further.effects)
        columns.append(stepped.imag[:, None] / COMPLEX_STEP_MM)
    return predicted, np.hstack(columns)


@contextmanager
def within_reach(observations: Observations) -> Iterator[None]:
    """Where the legs cannot meet, or nothing shows a value, there is no optimum."""
    try:
        yield
    except UnreachablePosture as problem:
        raise _no_optimum("only machines whose legs cannot meet", observations) from problem
    except np.linalg.LinAlgError as problem:
        raise _no_optimum(str(problem), observations) from problem


def _no_optimum(reason: str, observations: Observations) -> NotIdentifiable:
    return NotIdentifiable(
        "exact identification",
        reason,
        "readings that some machine near the nominal one could give",
        f"Look for a wrong reading or unit, {_furthest_words(observations)}.",
    )


def _furthest_words(observations: Observations) -> str:
    """The reading that is furthest from the median of its mounting."""
    off_mm = np.zeros(len(observations))
    for rows in observations.mountings:
        off_mm[rows] = observations.value_mm[rows] - np.median(observations.value_mm[rows])
    row = int(np.abs(off_mm).argmax())
    axis = "XYZ"[observations.axis[row]]
    place = "the tool" if observations.leg[row] == TOOL else f"leg {'XYZ'[observations.leg[row]]}"
    return (
        f"first at {place} along {axis}, {observations.posture_words(row)}: "
        f"{observations.value_mm[row]:g} mm"
    )


class PlainFit:
    """A design prepared once, for any number of sessions measured alike.

    ``average`` ``(n_places, n_readings)`` makes the means, ``whiten`` ``(n_places, n_places)``
    takes out the zeros and scales to unit variance. ``curvature`` ``(n_places, k, k)`` are second
    derivatives at the model, ``first_step`` ``(k, n_places)`` is the linear solution.
    """

    def __init__(
        self, model: Model, observations: Observations, free: tuple[int, ...], weight: FloatArray
    ) -> None:
        """Prepare for readings taken like these, with weights ``(n_readings,)``."""
        place = observations.posture
        first = np.unique(place, return_index=True)[1]
        total = np.asarray(np.bincount(place, weight), dtype=np.float64)
        self.average = np.zeros((len(first), len(observations)))
        self.average[place, np.arange(len(observations))] = weight / total[place]
        places = observations.take(first)
        self.design = plain_design(model.geometry, places)
        centred = without_zeros(places, total, np.eye(len(total)))
        self.whiten = np.asarray(np.sqrt(total)[:, None] * centred)
        self.base = np.array(model.parameters_mm)[:, None]
        self.free = np.array(free, dtype=np.intp)
        predicted, slope = self.design.readings_and_derivatives(self.base)
        steps = self.base + 1j * COMPLEX_STEP_MM * np.eye(6)[:, self.free]
        bend = self.design.readings_and_derivatives(steps)[1][self.free].imag / COMPLEX_STEP_MM
        self.curvature = np.einsum("mn,inj->mij", self.whiten, bend)
        inverse = np.linalg.pinv(self.whiten @ slope[self.free, :, 0].T, rcond=EXACT_BLIND)
        self.first_step = np.asarray(inverse, dtype=np.float64)
        self.predicted = self.whiten @ predicted

    def solve(self, value_mm: FloatArray) -> Optimum:
        """Best free parameters of sessions with readings ``(n_readings, b)``, mm."""
        measured = self.whiten @ (self.average @ value_mm)

        def evaluate(
            values: FloatArray, problem: NDArray[np.intp]
        ) -> tuple[FloatArray, FloatArray]:
            parameters = np.repeat(self.base, values.shape[1], axis=1)
            parameters[self.free] = values
            with np.errstate(invalid="ignore"):  # out of reach: NaN, and the step is refused
                predicted, slope = self.design.readings_and_derivatives(parameters)
            if len(self.free) < len(slope):
                slope = slope[self.free]
            return measured[:, problem] - self.whiten @ predicted, np.matmul(self.whiten, slope)

        start = self.first_step @ (measured - self.predicted)
        bent = np.einsum("nij,ib,jb->nb", self.curvature, start, start)
        start = start - self.first_step @ (0.5 * bent) + self.base[self.free]
        return minimise(evaluate, start, self.curvature)
