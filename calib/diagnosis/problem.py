"""Sessions and candidates as one whitened linear problem.

Every reading is divided by its noise. Zeros of set-ups, tilts of planes under them and joint
offsets of each session are projected out:
offsets are what a calibration is for, however far they are off. Leg lengths, which all sessions
share, are random effects as large as their tolerance: what they may do counts as noise, no more.
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

from calib.arrays import (
    DEPENDENT,
    NEW_DIRECTION,
    FloatArray,
    IntArray,
    Observations,
    bases_of,
    basis_of,
    incidence,
    lengths,
    numbered,
    onto,
    squares_in,
    stacks,
    tilts,
    without,
    without_means,
    without_zeros,
)
from calib.diagnosis.selection import KNOWN, Spread
from calib.identify.fit import prior_fit
from calib.noise.reading import (
    BORROWED,
    IndicatorFigures,
    Noise,
    may_be_pooled,
    reading_noise,
    reading_weights,
    visits,
)
from calib.stats import variance_ratio_p_value
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.movements import with_first_movements
from calib.tripod.pipeline import Model

VISIBLE = 1e-6
"""Least size of a candidate's column, in noise units for an unremarkable parameter."""

SHOWS = 1.0
"""Offsets are free in directions in which a tolerance of them makes more than this of the noise;
in others they cannot matter, and may not absorb what they would need metres for."""


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

    @property
    def noise(self) -> Noise | None:
        """Of its readings, None where none is known."""
        return reading_noise(visits(self.observed), self.indicator)

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

    ``residual_mm`` ``(n,)`` is measured minus predicted without zeros by the parameters of
    ``case.model``, linear in them at the fitted ``model``; ``weight`` ``(n,)`` in 1/mm², ``base``
    ``(n, 6)`` the derivatives by the base parameters, mm per tolerance.
    """

    case: Case
    noise: Noise | None
    weight: FloatArray
    model: Model
    residual_mm: FloatArray
    base: FloatArray

    @classmethod
    def of(
        cls, case: Case, noise: Noise | None, weight: FloatArray, near_mm: FloatArray | None = None
    ) -> FittedSession:
        """Fit the base parameters, from ``near_mm`` ``(6,)`` or from those of the model.

        Raises NotIdentifiable where the legs cannot meet.
        """
        observed = case.observed
        fit = prior_fit(case.model, observed, weight, case.tolerance_mm, near_mm=near_mm)
        model = case.model.with_parameters(fit.parameters_mm)
        off = (fit.parameters_mm - case.model.parameters_mm) / case.tolerance_mm
        base = fit.design * case.tolerance_mm
        residual_mm = observed.value_mm - model.readings(observed) + base @ off
        return cls(case, noise, weight, model, residual_mm, base)

    @property
    def observed(self) -> Observations:
        """Its visits."""
        return self.case.observed

    def adopting(self, effects: tuple[EffectInstance, ...]) -> FittedSession:
        """The same readings with more effects in the model. Raises NotIdentifiable."""
        model = self.case.model.with_effects((*self.case.model.effects, *effects))
        near_mm = np.array(self.model.parameters_mm)
        return self.of(replace(self.case, model=model), self.noise, self.weight, near_mm)

    @property
    def set_ups(self) -> FloatArray:
        """Columns ``(n, m)`` of what is free in a set-up: its zero, and the tilt of its plane."""
        observed = self.observed
        if not observed.over_plane.any():
            return incidence(observed.mount)
        leaning = without_means(observed.mount, self.weight, tilts(observed))
        seen = np.abs(leaning).max(axis=0, initial=0.0) > VISIBLE
        return np.hstack([incidence(observed.mount), leaning[:, seen]])

    @cached_property
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
class Whitening:
    """What zeros and base parameters may do, taken away from readings divided by their noise.

    ``free`` ``(n, q)`` is an orthonormal basis of what zeros and offsets do, ``held`` ``(n, h)``
    of what lengths do beside it, and ``kept`` ``(h,)`` the noise there over noise and lengths of
    their tolerance together: I + B P Bᵀ to the power -1/2.
    """

    free: FloatArray
    held: FloatArray
    kept: FloatArray

    @classmethod
    def of(cls, zeros: FloatArray, offsets: FloatArray, held: FloatArray) -> Whitening:
        """From whitened columns, those of base parameters per tolerance."""
        seen = zeros[:, zeros.any(axis=0)]
        seen = seen / lengths(seen)
        if np.abs(seen.T @ seen - np.eye(seen.shape[1])).max(initial=0.0) > DEPENDENT:
            seen = basis_of(seen, DEPENDENT)  # tilts of planes on a part of the readings
        free = np.hstack([seen, basis_of(without(seen, offsets), SHOWS, 1.0)])
        basis, size, _ = np.linalg.svd(without(free, held), full_matrices=False)
        return cls(free, basis, 1.0 / np.hypot(1.0, size))

    def held_back(self, rows: FloatArray, kept: FloatArray | None = None) -> FloatArray:
        """Rows ``(n,)`` or ``(..., n, k)`` with less of what lengths do, ``kept`` of it."""
        share = (self.kept if kept is None else kept) - 1.0
        return np.asarray(rows + (self.held * share) @ (self.held.T @ rows))

    def __call__(self, rows: FloatArray) -> FloatArray:
        """Rows ``(n,)`` or ``(..., n, k)`` as they count."""
        return self.held_back(without(self.free, rows))

    @property
    def seen_alone(self) -> FloatArray:
        """Square ``(n,)`` of what is left of each single row."""
        taken = (1.0 - self.kept**2) * self.held**2
        return np.asarray(1.0 - (self.free**2).sum(axis=1) - taken.sum(axis=1))

    def blocks(self, columns: Sequence[FloatArray]) -> list[FloatArray]:
        """Orthonormal basis ``(n, r)`` of what is left of each of these columns ``(n, k)``."""
        found: dict[int, FloatArray] = {}
        for alike, stacked in stacks(columns):
            free = without(self.free, _of_unit_length(stacked))
            free = bases_of(free, NEW_DIRECTION, 1.0)
            bases = bases_of(self.held_back(free), DEPENDENT)
            for k, basis in zip(alike, bases, strict=True):
                found[k] = basis[:, basis.any(axis=0)]
        return [found[k] for k in range(len(columns))]


def _of_unit_length(columns: FloatArray) -> FloatArray:
    """Columns ``(..., n, k)``, zero where they are not `VISIBLE`."""
    size = np.sqrt((columns**2).sum(axis=-2, keepdims=True))
    return np.where(size > VISIBLE, columns / np.maximum(size, VISIBLE), 0.0)


@dataclass(frozen=True, eq=False)
class Problem:
    """Several fitted sessions side by side: they share effects and lengths, not offsets and zeros.

    ``residual`` ``(n,)`` is what the parameters of the machine file leave, ``y`` ``(n,)`` the same
    whitened. ``zeros`` ``(n, m)``, ``offsets`` ``(n, 3 s)`` and ``bars`` ``(n, 3)`` are the columns
    of the base, those of parameters per tolerance; like everything else they are divided by the
    noise. ``noise_df`` belongs to the noise that was divided by, 0 where none is
    known.
    """

    fitted_sessions: tuple[FittedSession, ...]
    residual: FloatArray
    y: FloatArray
    root_weight: FloatArray
    zeros: FloatArray
    offsets: FloatArray
    bars: FloatArray
    whitening: Whitening
    noise_df: float
    mount: IntArray

    @classmethod
    def of(
        cls,
        fitted_sessions: Sequence[FittedSession],
        known: tuple[FloatArray, FloatArray] | None = None,
    ) -> Problem:
        """Stack the sessions; ``known`` is what others tell of the lengths (`bars_seen`)."""
        root = np.sqrt(np.concatenate([one.weight for one in fitted_sessions]))
        residual = root * np.concatenate([one.residual_mm for one in fitted_sessions])
        zeros = root[:, None] * block_diag(*(one.set_ups for one in fitted_sessions))
        offsets = root[:, None] * block_diag(*(one.base[:, :3] for one in fitted_sessions))
        bars = root[:, None] * np.vstack([one.base[:, 3:] for one in fitted_sessions])
        if known:
            mean, covariance_root = known
            residual, bars = residual - bars @ mean, bars @ covariance_root
        whitening = Whitening.of(zeros, offsets, bars)
        freedom = [one.noise.degrees_of_freedom if one.noise else 0.0 for one in fitted_sessions]
        starts = np.cumsum([0, *(one.observed.mount_count for one in fitted_sessions)])
        mounts = [one.observed.mount + k for one, k in zip(fitted_sessions, starts, strict=False)]
        return cls(
            tuple(fitted_sessions),
            residual,
            whitening(residual),
            root,
            zeros,
            offsets,
            bars,
            whitening,
            float(sum(freedom)) if all(freedom) else 0.0,
            np.concatenate(mounts),
        )

    def adopting(self, effects: tuple[EffectInstance, ...]) -> Problem:
        """The same sessions with more effects in their models. Raises NotIdentifiable."""
        return self.of([one.adopting(effects) for one in self.fitted_sessions])

    def as_if_linear(self, y: FloatArray) -> Problem:
        """The same with residuals ``(n,)`` as a machine without curvature would leave them."""
        more = self.whitening.held_back(y - self.y, 1.0 / self.whitening.kept)
        return replace(self, y=y, residual=self.residual + more)

    def explained_by(self, columns_mm: FloatArray) -> tuple[float, int]:
        """What many columns ``(n, k)`` in mm explain of ``y``, and in how many directions.

        By their products, which is quicker than `blocks`.
        """
        free = without(self.whitening.free, _of_unit_length(self.root_weight[:, None] * columns_mm))
        square, axes = np.linalg.eigh(free.T @ free)
        seen = square > NEW_DIRECTION**2
        white = self.whitening.held_back(free @ (axes[:, seen] / np.sqrt(square[seen])))
        along = white.T @ self.y
        return float(along @ np.linalg.solve(white.T @ white, along)), len(along)

    def blocks(self, columns_mm: Sequence[FloatArray]) -> list[FloatArray]:
        """Orthonormal bases ``(n, r)`` of columns ``(n, k)`` in mm, whitened."""
        return self.whitening.blocks([self.root_weight[:, None] * one for one in columns_mm])

    def free(self, columns_mm: FloatArray) -> FloatArray:
        """Columns ``(n,)`` or ``(..., n, k)`` in mm, whitened."""
        root = self.root_weight if columns_mm.ndim == 1 else self.root_weight[:, None]
        return self.whitening(root * columns_mm)

    def mm(self, y: FloatArray) -> FloatArray:
        """What is left of readings ``(n,)``, mm, the lengths fitted within their tolerance."""
        return np.asarray(self.whitening.held_back(y) / self.root_weight)

    def bars_seen(self) -> tuple[FloatArray, FloatArray]:
        """What these sessions tell of the lengths that they share, in tolerances.

        Mean ``(3,)`` and a root ``(3, 3)`` of the covariance.
        """
        free = without(self.whitening.free, self.bars)
        covariance = np.linalg.inv(free.T @ free + np.eye(free.shape[1]))
        return covariance @ (free.T @ self.residual), np.linalg.cholesky(covariance)

    @cached_property
    def structure(self) -> FloatArray:
        """Basis ``(n, e)`` of all that is not scatter of repeats: cells, cycles of mountings."""
        return np.asarray(block_diag(*(one.structure for one in self.fitted_sessions)))

    def conditions(self, name: str) -> NDArray[Any]:
        """One array of the conditions of all sessions ``(n,)``."""
        return np.concatenate([getattr(one.observed, name) for one in self.fitted_sessions])

    @property
    def structure_df(self) -> int:
        """Directions that are no scatter of repeats, less offsets and zeros."""
        return int(max(self.structure.shape[1] - self.whitening.free.shape[1], 0))

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
        return math.sqrt(float((self.mm(inside) ** 2).mean()))

    def gap_p_value(self, gap: float, df: int) -> float:
        """Chance of a gap at least this large from noise alone; 1 where nothing is free."""
        if df <= 0 or self.noise_df <= 0.0:
            return 1.0
        return variance_ratio_p_value(gap / df, df, self.noise_df)
