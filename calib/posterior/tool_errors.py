"""How far off the tool is over the workspace under weighted models, and what 95 % of them keep."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
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


@dataclass(frozen=True, eq=False)
class ToolErrors:
    """Mean squares of the tool's error over the workspace, under every model of a posterior.

    ``metric`` ``(f, f)`` is that of the tool's field, in a frame.
    """

    models: Sequence[InField]
    metric: FloatArray

    def without(self, columns: Sequence[int]) -> ToolErrors:
        """The errors where these columns of the field are known."""
        metric = self.metric.copy()
        metric[list(columns)] = metric[:, list(columns)] = 0.0
        return replace(self, metric=metric)

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
    def _weight(self) -> FloatArray:
        return np.array([model.weight for model in self.models])

    @cached_property
    def _mean(self) -> FloatArray:
        """``(n_models, f)``."""
        return np.array([model.mean for model in self.models])

    @cached_property
    def _inflation(self) -> FloatArray:
        """``(n_models,)``."""
        return np.array([model.inflated**2 for model in self.models])

    @cached_property
    def _roots(self) -> FloatArray:
        """Covariance roots of every model ``(n_models, f, k)``, filled up with zeros."""
        widest = max(model.root.shape[1] for model in self.models)
        roots = np.zeros((*self._mean.shape, widest))
        for filled, model in zip(roots, self.models, strict=True):
            filled[:, : model.root.shape[1]] = model.root
        return roots

    @cached_property
    def _alike(self) -> list[list[int]]:
        """Models of each base."""
        alike: dict[int, list[int]] = {}
        for k, model in enumerate(self.models):
            alike.setdefault(id(model.base), []).append(k)
        return list(alike.values())

    @cached_property
    def _tool_means(self) -> FloatArray:
        """Means of every model along the directions that move the tool ``(n_models, q)``."""
        return np.asarray(self._mean @ self._metric_root.T)

    @cached_property
    def _tool_roots(self) -> FloatArray:
        """Covariance roots of every model along these directions ``(n_models, q, k)``."""
        return np.asarray(self._metric_root @ self._roots)

    @cached_property
    def _tool_bases(self) -> list[tuple[list[int], FloatArray]]:
        """Models of each base, and its covariance along these directions ``(q, q)``."""
        root = self._metric_root
        return [(alike, root @ self.models[alike[0]].base @ root.T) for alike in self._alike]

    @cached_property
    def _spread(self) -> FloatArray:
        """Mean and half the variance ``(n_models, 2)`` of the square about each model's mean."""
        size, square, mixed = np.empty((3, len(self.models)))
        roots = self._tool_roots
        for alike, base in self._tool_bases:
            size[alike], square[alike] = np.trace(base), (base**2).sum()
            mixed[alike] = (roots[alike] * (base @ roots[alike])).sum(axis=(1, 2))
        inner = np.swapaxes(roots, 1, 2) @ roots
        unplaced = np.array([model.unplaced_mm2 for model in self.models])
        mean = self._inflation * size + np.trace(inner, axis1=1, axis2=2) + unplaced
        half_variance = (
            self._inflation**2 * square
            + 2.0 * self._inflation * mixed
            + (inner**2).sum(axis=(1, 2))
            + unplaced**2 / UNPLACED_FREEDOM
        )
        return np.column_stack([mean, half_variance])

    def _off(self, values: FloatArray) -> FloatArray:
        """How far each mean is from these values, along these directions ``(n_models, q)``."""
        return np.asarray(self._tool_means - self._metric_root @ values)

    def expected(self, values: FloatArray) -> FloatArray:
        """Squares ``(n_models,)`` of what is expected under each with these values entered."""
        return np.asarray((self._off(values) ** 2).sum(axis=1))

    def distances(self, values: FloatArray) -> FloatArray:
        """Each model ``(n_models, 3)`` with these values entered: its weight, then mean and
        variance of the mean square of the tool's error, mm² and mm⁴.
        """
        off = self._off(values)
        along = np.empty(len(self.models))
        for alike, base in self._tool_bases:
            along[alike] = (off[alike] @ base * off[alike]).sum(axis=1)
        of_root = (off[:, None, :] @ self._tool_roots)[:, 0]
        along = self._inflation * along + (of_root**2).sum(axis=1)
        size = self._spread[:, 0] + (off**2).sum(axis=1)
        variance = 2.0 * self._spread[:, 1] + 4.0 * along
        return np.column_stack([self._weight, size, variance])

    def moment(self, values: FloatArray) -> FloatArray:
        """Expected products ``(f, f)`` of what is left in the field with these values entered."""
        off = self._mean - values
        moment = (off.T * self._weight) @ off
        for alike in self._alike:
            inflation = sum(self.models[k].weight * self.models[k].inflated ** 2 for k in alike)
            moment += inflation * self.models[alike[0]].base
        for model in self.models:
            moment += model.weight * model.root @ model.root.T
        return np.asarray(moment)

    @property
    def unplaced_mm2(self) -> float:
        """Expected mean square of errors that have no law."""
        return math.fsum(model.weight * model.unplaced_mm2 for model in self.models)

    def expected_mm(self, values: FloatArray) -> float:
        """Root of the expected mean square."""
        return math.sqrt(float(self._weight @ (self._spread[:, 0] + self.expected(values))))

    def bound_mm(self, values: FloatArray) -> float:
        """What a machine keeps 95 times in 100 with these values entered (`KEPT`)."""
        weight, mean, variance = self.distances(values).T
        return root_quantile(weight, mean, variance, KEPT)
