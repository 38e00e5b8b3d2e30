"""How far off the tool is over the workspace under weighted models, and what 95 % of them keep."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.arrays import FloatArray
from calib.posterior.tool import RIGID
from calib.stats import root_quantile


@dataclass(frozen=True, eq=False)
class InField:
    """A model in the tool's field: mean ``(f,)`` and covariance, in two parts.

    That of the base ``(f, f)``, which many models share, with its root ``(f, b)``, and a root
    ``(f, k)`` of the rest; the first two times the square of ``inflated`` and itself. Beside it the
    mean square of errors that have no law, ``unplaced_mm2``: the tool is taken to have as much.
    """

    weight: float
    mean: FloatArray
    base: FloatArray
    base_root: FloatArray
    inflated: float
    root: FloatArray
    unplaced_mm2: float = 0.0

    def variance(self, at: int) -> float:
        """Variance of one value of the field."""
        return self.inflated**2 * float(self.base[at, at]) + float((self.root[at] ** 2).sum())


KEPT = 0.975
"""Part of the posterior that keeps a bound of 95 %: with 0.95 it covered 86 % of shapes outside the
catalogue. The other half of the risk is that of laws that
no model has, and of effects that these readings hardly show."""

STILL = 1e-14
"""Of the largest square: a direction that moves the tool less is one of rounding."""

UNPLACED_FREEDOM = 12.0
"""Degrees of freedom of an error without a law over the workspace, smooth along the travel."""


class ModelColumns:
    """Whose are so many columns of each model, side by side.

    Column k is of model ``owner[k]``; ``blocks`` are the columns ``(m, r)`` of models of r sizes.
    """

    def __init__(self, counts: Sequence[int]) -> None:
        self.models = len(counts)
        self.owner = np.repeat(np.arange(self.models), counts)
        width, firsts = np.array(counts, dtype=np.intp), np.cumsum([0, *counts])[:-1]
        self._with_columns = np.flatnonzero(width)
        self._firsts = firsts[self._with_columns]
        self.blocks = [
            firsts[width == r][:, None] + np.arange(r) for r in np.unique(width).tolist() if r
        ]

    def sums(self, values: FloatArray) -> FloatArray:
        """Sums of columns ``(..., R)`` for each model ``(..., M)``."""
        sums = np.zeros((*values.shape[:-1], self.models))
        if len(self._firsts):
            sums[..., self._with_columns] = np.add.reduceat(values, self._firsts, axis=-1)
        return sums


@dataclass(frozen=True, eq=False)
class Squares:
    """Mean squares under models that share a base, whose covariance is ``base`` ``(q, q)``.

    Beside it each model has ``columns`` of ``roots`` ``(q, R)``; both are times the square of
    ``inflated`` ``(M,)``.
    """

    base: FloatArray
    roots: FloatArray
    columns: ModelColumns
    inflated: FloatArray

    @cached_property
    def _spread(self) -> tuple[FloatArray, FloatArray]:
        """Mean and half the variance ``(M,)`` of the square about the means."""
        inner = np.zeros(self.columns.models)
        for block in self.columns.blocks:
            roots = np.moveaxis(self.roots[:, block], 1, 0)
            products = np.swapaxes(roots, 1, 2) @ roots
            inner[self.columns.owner[block[:, 0]]] = (products**2).sum(axis=(1, 2))
        size = float(np.trace(self.base)) + self.columns.sums((self.roots**2).sum(axis=0))
        through = self.columns.sums((self.roots * (self.base @ self.roots)).sum(axis=0))
        square = float((self.base**2).sum()) + 2.0 * through + inner
        return self.inflated**2 * size, self.inflated**4 * square

    def moments(self, off: FloatArray) -> FloatArray:
        """Mean and variance ``(M, 2)`` of the mean square where means are ``off`` ``(q, M)``."""
        size, square = self._spread
        along = (off * (self.base @ off)).sum(axis=0)
        along += self.columns.sums((self.roots * off[:, self.columns.owner]).sum(axis=0) ** 2)
        variance = 2.0 * square + 4.0 * self.inflated**2 * along
        return np.column_stack([size + (off**2).sum(axis=0), variance])


class ToolErrors:
    """Mean squares of the tool's error over the workspace, under every model of a posterior.

    ``metric`` ``(f, f)`` is that of the tool's field, in a frame; ``weight`` ``(M,)`` are those of
    the models.
    """

    def __init__(self, models: Sequence[InField], metric: FloatArray) -> None:
        self.models, self.metric = models, metric
        self.weight = np.array([model.weight for model in models])
        self._unplaced_mm2 = np.array([model.unplaced_mm2 for model in models])
        self._of_base: dict[int, list[int]] = {}
        for k, model in enumerate(models):
            self._of_base.setdefault(id(model.base), []).append(k)

    def without(self, columns: Sequence[int]) -> ToolErrors:
        """The errors where these columns of the field are known."""
        metric = self.metric.copy()
        metric[list(columns)] = metric[:, list(columns)] = 0.0
        return ToolErrors(self.models, metric)

    @cached_property
    def seen(self) -> ToolErrors:
        """The errors where shifts and turns of the whole machine are known: no leg shows these."""
        return self.without(range(-RIGID, 0))

    @cached_property
    def _metric_root(self) -> FloatArray:
        """A root ``(q, f)`` of the metric: of ``q`` directions that move the tool."""
        square, axes = np.linalg.eigh(self.metric)
        moves = square > STILL * square[-1]
        return np.asarray(np.sqrt(square[moves])[:, None] * axes[:, moves].T)

    @cached_property
    def _mean(self) -> FloatArray:
        """Means along these directions ``(q, M)``."""
        return np.asarray(self._metric_root @ np.column_stack([m.mean for m in self.models]))

    @cached_property
    def _squares(self) -> list[tuple[list[int], Squares]]:
        """Models of each base, and their mean squares along these directions."""
        squares, metric_root = [], self._metric_root
        for alike in self._of_base.values():
            models = [self.models[k] for k in alike]
            roots = [model.root / model.inflated for model in models]
            base = metric_root @ models[0].base @ metric_root.T
            columns = ModelColumns([root.shape[1] for root in roots])
            inflated = np.array([model.inflated for model in models])
            squares.append(
                (alike, Squares(base, metric_root @ np.hstack(roots), columns, inflated))
            )
        return squares

    def _off(self, values: FloatArray) -> FloatArray:
        """How far each mean is from these values, along these directions ``(q, M)``."""
        return np.asarray(self._mean - (self._metric_root @ values)[:, None])

    def expected(self, values: FloatArray) -> FloatArray:
        """Squares ``(M,)`` of what is expected under each with these values entered."""
        return np.asarray((self._off(values) ** 2).sum(axis=0))

    def distances(self, values: FloatArray) -> FloatArray:
        """Each model ``(M, 3)`` with these values entered: its weight, then mean and variance of
        the mean square of the tool's error, mm² and mm⁴.
        """
        off = self._off(values)
        moments = np.empty((len(self.models), 2))
        for alike, squares in self._squares:
            moments[alike] = squares.moments(off[:, alike])
        moments[:, 0] += self._unplaced_mm2
        moments[:, 1] += 2.0 * self._unplaced_mm2**2 / UNPLACED_FREEDOM
        return np.column_stack([self.weight, moments])

    def moment(self, values: FloatArray) -> FloatArray:
        """Expected products ``(f, f)`` of what is left in the field with these values entered."""
        off = np.column_stack([model.mean - values for model in self.models])
        moment = (off * self.weight) @ off.T
        for alike in self._of_base.values():
            inflation = sum(self.models[k].weight * self.models[k].inflated ** 2 for k in alike)
            moment += inflation * self.models[alike[0]].base
        for model in self.models:
            moment += model.weight * model.root @ model.root.T
        return np.asarray(moment)

    @property
    def unplaced_mm2(self) -> float:
        """Expected mean square of errors that have no law."""
        return float(self.weight @ self._unplaced_mm2)

    def expected_mm(self, values: FloatArray) -> float:
        """Root of the expected mean square."""
        weight, mean, _ = self.distances(values).T
        return math.sqrt(float(weight @ mean))

    def bound_mm(self, values: FloatArray) -> float:
        """What a machine keeps 95 times in 100 with these values entered (`KEPT`)."""
        weight, mean, variance = self.distances(values).T
        return root_quantile(weight, mean, variance, KEPT)
