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
    onto,
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
from calib.stats import variance_ratio_p_value
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.movements import with_first_movements
from calib.tripod.pipeline import Model, derivatives

VISIBLE = 1e-6
"""Least size of a candidate's column, in noise units for an unremarkable parameter."""


@dataclass(frozen=True, eq=False)
class Case:
    """One session to diagnose: the model it was measured against and what is known of it."""

    model: Model
    observed: Observations
    indicator: IndicatorFigures
    tolerance_mm: FloatArray

    def with_readings(self, observed: Observations) -> Case:
        """The same session with other readings."""
        return replace(self, observed=observed)

    def fitted(self) -> FittedSession:
        """The base parameters fitted, to linearise there. Raises NotIdentifiable."""
        visited = with_first_movements(visits(self.observed))
        noise = reading_noise(visited, self.indicator)
        weight = reading_weights(visited, noise)
        if noise is None:  # a variance to weigh the tolerances with
            centred = without_zeros(visited, visited.averaged, visited.value_mm)
            weight = weight / max(1e-4 * float((centred**2).mean()), 1e-8)
        return FittedSession.of(self.with_readings(visited), noise, weight)


@dataclass(frozen=True, eq=False)
class FittedSession:
    """One session ready for diagnosis: its visits, its noise, and the model fitted to it.

    ``residual_mm`` ``(n,)`` is measured minus predicted without zeros, ``weight`` ``(n,)`` in
    1/mm², ``base`` ``(n, 6)`` the derivatives by the base parameters.
    """

    case: Case
    noise: Noise | None
    weight: FloatArray
    model: Model
    residual_mm: FloatArray
    base: FloatArray

    @classmethod
    def of(cls, case: Case, noise: Noise | None, weight: FloatArray) -> FittedSession:
        """Fit the base parameters. Raises NotIdentifiable where the legs cannot meet."""
        observed = case.observed
        fit = prior_fit(case.model, observed, weight, case.tolerance_mm)
        model = case.model.with_parameters(fit.parameters_mm)
        base = derivatives(model.geometry, fit.parameters_mm, observed, model.effects)
        return cls(case, noise, weight, model, observed.value_mm - model.readings(observed), base)

    @property
    def observed(self) -> Observations:
        """Its visits."""
        return self.case.observed

    def adopting(self, effects: tuple[EffectInstance, ...]) -> FittedSession:
        """The same readings with more effects in the model. Raises NotIdentifiable."""
        model = self.case.model.with_effects((*self.case.model.effects, *effects))
        return self.of(replace(self.case, model=model), self.noise, self.weight)

    @property
    def nuisance_columns(self) -> FloatArray:
        """Zeros and base columns ``(n, q)``, whitened; the base comes last."""
        columns = np.hstack([incidence(self.observed.mount), self.base])
        return np.asarray(np.sqrt(self.weight)[:, None] * columns)

    @property
    def structure(self) -> FloatArray:
        """Basis ``(n, e)`` of cells and cycles of each mounting; without repeats, of everything."""
        observed, root, cell = self.observed, np.sqrt(self.weight), self.observed.cell
        parts = []
        for rows in observed.mountings:
            cells, cycles = (incidence(numbered(of[rows])) for of in (cell, observed.cycle))
            basis = basis_of(root[rows, None] * np.hstack([cells, cycles[:, 1:]]), DEPENDENT)
            parts.append(np.zeros((len(observed), basis.shape[1])))
            parts[-1][rows] = basis
        return np.hstack(parts)


@dataclass(frozen=True, eq=False)
class Problem:
    """Several fitted sessions side by side: they share effects, not base parameters and zeros.

    ``residual`` ``(n,)`` is what the fits leave, ``y`` ``(n,)`` the same without base parameters
    and zeros; they and everything else are whitened. ``nuisance`` ``(n, q)`` is an orthonormal
    basis of base parameters and zeros; ``structure`` ``(n, e)`` of all that is not scatter of
    repeats (cells and cycles of each mounting). ``noise_df`` belongs to the noise the whitening
    used, 0 where none is known.
    """

    fitted_sessions: tuple[FittedSession, ...]
    residual: FloatArray
    y: FloatArray
    root_weight: FloatArray
    nuisance: FloatArray
    structure: FloatArray
    noise_df: float
    mount: IntArray

    @classmethod
    def of(cls, fitted_sessions: Sequence[FittedSession]) -> Problem:
        """Stack the sessions."""
        root = np.sqrt(np.concatenate([one.weight for one in fitted_sessions]))
        residual = root * np.concatenate([one.residual_mm for one in fitted_sessions])
        columns = [one.nuisance_columns for one in fitted_sessions]
        nuisance = block_diag(*(basis_of(c / lengths(c), DEPENDENT) for c in columns))
        freedom = [one.noise.degrees_of_freedom if one.noise else 0.0 for one in fitted_sessions]
        mounts, count = [], 0
        for one in fitted_sessions:
            mounts.append(one.observed.mount + count)
            count += one.observed.mount_count
        return cls(
            tuple(fitted_sessions),
            residual,
            without(nuisance, residual),
            root,
            nuisance,
            block_diag(*(one.structure for one in fitted_sessions)),
            float(sum(freedom)) if all(freedom) else 0.0,
            np.concatenate(mounts),
        )

    def adopting(self, effects: tuple[EffectInstance, ...]) -> Problem:
        """The same sessions with more effects in their models. Raises NotIdentifiable."""
        return self.of([one.adopting(effects) for one in self.fitted_sessions])

    def as_if_linear(self, y: FloatArray) -> Problem:
        """The same with residuals ``(n,)`` as a machine without curvature would leave them."""
        return replace(self, y=y, residual=self.residual + y - self.y)

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
        return np.asarray(block_diag(*(one.nuisance_columns for one in self.fitted_sessions)))

    def conditions(self, name: str) -> NDArray[Any]:
        """One array of the conditions of all sessions ``(n,)``."""
        return np.concatenate([getattr(one.observed, name) for one in self.fitted_sessions])

    @property
    def structure_df(self) -> int:
        """Directions that are no scatter of repeats, less base parameters and zeros."""
        return int(max(self.structure.shape[1] - self.nuisance.shape[1], 0))

    @property
    def noise_mm(self) -> float:
        """Standard deviation of a reading, mean square over the readings, mm."""
        return float(np.sqrt(np.mean(self.root_weight**-2.0)))

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

    def gap_rms_mm(self, residual: FloatArray | None = None) -> float:
        """The same of ``y`` or another residual ``(n,)`` as r.m.s. over the readings, mm."""
        inside = onto(self.structure, self.y if residual is None else residual)
        return math.sqrt(float(((inside / self.root_weight) ** 2).mean()))

    def gap_p_value(self, gap: float, df: int) -> float:
        """Chance of a gap at least this large from noise alone; 1 where nothing is free."""
        if df <= 0 or self.noise_df <= 0.0:
            return 1.0
        return variance_ratio_p_value(gap / df, df, self.noise_df)
