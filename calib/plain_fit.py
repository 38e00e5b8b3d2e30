"""Exact identification of many sessions at once, for a machine without effects.

Readings of one mounting in one posture are predicted alike, so their weighted means are all that
the fit needs: sixty readings become eighteen. The zeros drop out with the mean of each mounting.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.linalg import EXACT_BLIND, without_means
from calib.newton import Evaluate, Optimum, minimise
from calib.observations import FloatArray, IntArray, Observations
from calib.orthoglide.model import Model
from calib.orthoglide.plain import PlainDesign, plain_design

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
