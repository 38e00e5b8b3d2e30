"""Sessions and candidates as one whitened linear problem.

Every reading is divided by its noise; base parameters and zeros of each session are projected out.
What remains of a candidate effect is an orthonormal block; what remains of the readings is a
vector whose squares are chi-squared where nothing is missing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from calib.diagnosis.selection import KNOWN, Spread
from calib.identify.fit import prior_fit, without_zeros
from calib.linalg import (
    DEPENDENT,
    basis_of,
    incidence,
    lengths,
    new_directions,
    squares_in,
    without,
)
from calib.noise.reading import (
    BORROWED,
    IndicatorFigures,
    Noise,
    may_be_pooled,
    reading_noise,
    reading_weights,
    visits,
)
from calib.observations import FloatArray, IntArray, Observations, numbered
from calib.tripod.pipeline import Model, derivatives

VISIBLE = 1e-6
"""Least size of a candidate's column, in noise units for an unremarkable parameter."""


@dataclass(frozen=True, eq=False)
class FittedSession:
    """One session ready for diagnosis: its visits, its noise, and the model fitted to it.

    ``left_mm`` ``(n,)`` is measured minus predicted without zeros, ``weight`` ``(n,)`` in 1/mm²,
    ``held_to_mm`` ``(6,)`` the base parameters where the tolerances have their middle.
    """

    observed: Observations
    model: Model
    noise: Noise | None
    weight: FloatArray
    left_mm: FloatArray
    base: FloatArray
    held_to_mm: FloatArray

    @classmethod
    def of(
        cls,
        model: Model,
        observed: Observations,
        indicator: IndicatorFigures,
        tolerance_mm: FloatArray,
    ) -> FittedSession:
        """Fit the base parameters, held by their tolerances, as the place to linearise at.

        Raises NotIdentifiable where the legs cannot meet.
        """
        visited = visits(observed)
        noise = reading_noise(visited, indicator)
        weight = reading_weights(visited, noise)
        if noise is None:
            weight = weight / _rough_variance(visited)
        return cls._fitted(model, visited, noise, weight, tolerance_mm)

    def again(self, model: Model, tolerance_mm: FloatArray) -> FittedSession:
        """The same readings with another model. Raises NotIdentifiable."""
        return self._fitted(model, self.observed, self.noise, self.weight, tolerance_mm)

    @classmethod
    def _fitted(
        cls,
        model: Model,
        visited: Observations,
        noise: Noise | None,
        weight: FloatArray,
        tolerance_mm: FloatArray,
    ) -> FittedSession:
        fit = prior_fit(model, visited, weight, tolerance_mm)
        fitted = model.with_parameters(fit.parameters_mm)
        base = derivatives(model.geometry, fit.parameters_mm, visited, model.effects)
        left = visited.value_mm - fitted.readings(visited)
        return cls(visited, fitted, noise, weight, left, base, np.array(model.parameters_mm))


def _rough_variance(visited: Observations) -> float:
    """A variance to weigh the tolerances with where no noise is known, mm²."""
    centred = without_zeros(visited, visited.averaged, visited.value_mm)
    return max(1e-4 * float((centred**2).mean()), 1e-8)


@dataclass(frozen=True, eq=False)
class Problem:
    """Several sittings side by side: effects are shared, base parameters and zeros are not.

    ``left`` ``(n,)`` is what the sittings leave, ``y`` ``(n,)`` the same without base
    parameters and zeros; they and everything else are whitened. ``nuisance`` ``(n, q)`` is an
    orthonormal basis of base parameters and zeros; ``structure`` ``(n, e)`` of all that is not
    scatter of repeats (cells and cycles of each mounting). ``noise_df`` belongs to the noise
    the whitening used, 0 where none is known.
    """

    fitted_sessions: tuple[FittedSession, ...]
    left: FloatArray
    y: FloatArray
    root_weight: FloatArray
    nuisance: FloatArray
    structure: FloatArray
    structure_df: int
    noise_df: float
    mount: IntArray

    @classmethod
    def of(cls, fitted_sessions: Sequence[FittedSession]) -> Problem:
        """Stack the sittings."""
        root = np.concatenate([np.sqrt(one.weight) for one in fitted_sessions])
        left = np.concatenate([one.left_mm for one in fitted_sessions])
        columns = [_zeros_and_base(one) for one in fitted_sessions]
        nuisance = block_diag(*(basis_of(c / lengths(c), DEPENDENT) for c in columns))
        structure = block_diag(*(_structure(one) for one in fitted_sessions))
        residual = without(nuisance, root * left)
        df = structure.shape[1] - nuisance.shape[1]
        mounts, count = [], 0
        for one in fitted_sessions:
            mounts.append(one.observed.mount + count)
            count += one.observed.mount_count
        return cls(
            tuple(fitted_sessions),
            root * left,
            residual,
            root,
            nuisance,
            structure,
            max(df, 0),
            _noise_df(fitted_sessions),
            np.concatenate(mounts),
        )

    def as_if_linear(self, y: FloatArray) -> Problem:
        """The same with what a machine leaves ``(n,)`` that follows its derivatives far enough."""
        return replace(self, y=y, left=self.left + y - self.y)

    def block(self, columns_mm: FloatArray) -> FloatArray:
        """Orthonormal basis ``(n, r)`` of columns ``(n, k)`` in mm, nuisance projected out."""
        white = self.root_weight[:, None] * columns_mm
        size = lengths(white)
        return new_directions(self.nuisance, white[:, size > VISIBLE] / size[size > VISIBLE])

    def free(self, columns_mm: FloatArray) -> FloatArray:
        """Columns ``(n,)`` or ``(n, k)`` in mm, whitened, nuisance projected out."""
        return without(self.nuisance, (self.root_weight * columns_mm.T).T)

    def nuisance_columns(self) -> FloatArray:
        """Zeros and base columns of every session, whitened ``(n, q)``; its base comes last."""
        return np.asarray(block_diag(*(_zeros_and_base(one) for one in self.fitted_sessions)))

    def conditions(self, name: str) -> NDArray[Any]:
        """One array of the conditions of all sittings ``(n,)``."""
        return np.concatenate([getattr(one.observed, name) for one in self.fitted_sessions])

    def has_repeats(self) -> bool:
        """Whether there is scatter of repeats: readings beyond cells and cycles."""
        return bool(len(self.y) > self.structure.shape[1])

    def unevenness(self) -> FloatArray:
        """Standard deviation of each row's noise ``(n,)``, whitened; 1 where mountings agree.

        Indicators differ, and one may scatter more on one stand than on the next.
        """
        scatter = without(self.structure, self.y)
        squares = np.bincount(self.mount, scatter * scatter).astype(np.float64)
        taken = np.bincount(self.mount, (self.structure * self.structure).sum(axis=1))
        free = (np.bincount(self.mount) - taken).astype(np.float64)
        if may_be_pooled(squares, free, 0.0):
            return np.ones(len(self.y))
        middle = squares.sum() / free.sum()
        variance = (squares + BORROWED * middle) / (free + BORROWED)
        return np.asarray(np.sqrt(variance)[self.mount])

    @cached_property
    def spread(self) -> Spread:
        """What tells the variance of the noise."""
        if math.isinf(self.noise_df):
            return KNOWN
        return Spread(self.gap(self.y) + self.noise_df, self.structure_df + self.noise_df)

    def gap(self, residual: FloatArray) -> float:
        """Square sum of a residual ``(n,)`` that is not scatter of repeats."""
        return squares_in(self.structure, residual)


def _noise_df(fitted_sessions: Sequence[FittedSession]) -> float:
    """Degrees of freedom of the noise of all sittings together; 0 where one has none."""
    if any(one.noise is None for one in fitted_sessions):
        return 0.0
    return float(sum(one.noise.degrees_of_freedom for one in fitted_sessions if one.noise))


def _zeros_and_base(one: FittedSession) -> FloatArray:
    columns = np.hstack([incidence(one.observed.mount), one.base])
    return np.asarray(np.sqrt(one.weight)[:, None] * columns)


def _structure(one: FittedSession) -> FloatArray:
    """Basis of cells and cycles of each mounting; without repeats, of everything."""
    observed = one.observed
    root = np.sqrt(one.weight)
    parts = []
    cell = observed.cell
    for rows in observed.mountings:
        cells, cycles = (incidence(numbered(of[rows])) for of in (cell, observed.cycle))
        basis = basis_of(root[rows, None] * np.hstack([cells, cycles[:, 1:]]), DEPENDENT)
        parts.append(np.zeros((len(observed), basis.shape[1])))
        parts[-1][rows] = basis
    return np.hstack(parts)
