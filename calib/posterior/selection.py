"""Models of none, one, two and three components, weighed by their evidence in closed form.

With base parameters marginalised, readings are y = C β + noise, β normal with standard deviation
``scale`` times ``unit``. All that is needed of n rows are the products C'C and C'y. The evidence of
one component more, beside those of a model, takes its own eigenvalues only. Noise known with ν
degrees of freedom makes the evidence a Student's t: -(ν + n)/2 log(ν + Q), Q what is left.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement, product
from typing import TYPE_CHECKING

import numpy as np

from calib.arrays import FloatArray, IntArray

if TYPE_CHECKING:  # its library is of tripods, and a selection of any machine
    from calib.posterior.library import Component

SCALES = (1.0, 4.0, 16.0, 64.0)
"""Of an unremarkable size: the standard deviations that a size may have."""

LOG_SCALES = np.log([0.4, 0.3, 0.2, 0.1])
"""Their prior: larger ones are rarer, none is impossible."""

ADOPTED = 4.0
"""Unremarkable sizes, or as many as its model states if these are more: by so much an adopted
effect may have changed."""

CAUSES = (0.45, 0.42, 0.115, 0.015)
"""Prior of 0, 1, 2 and 3 components: each further one a quarter as likely, and less, for any three
fit nearly any shape."""

NARROW = 12
"""Columns of a component, up to which it is tried beside every other."""

PAIRS = 160
"""Pairs that are weighed at all scales, the most promising of all."""

TRIPLES_FROM = 12
"""Pairs beside which every third component is tried."""

FAR_BEHIND = 12.0
"""Log weight behind the best of as many components: lighter than `LIGHTEST`, not looked at."""

LIGHTEST = 1e-4
"""Models of less weight change no value; all together they may have a few percent."""


Key = tuple[tuple[int, float], ...]
"""Components of a model, each with its scale."""


def log_causes(acting: int) -> FloatArray:
    """Log prior ``(4,)`` of 0 to 3 components beside ``acting`` ones that were adopted.

    Of a machine of which so many are known to act a further one is as likely as it was beside them
    when they were named; beyond three the last ratio goes on.
    """
    beyond = CAUSES[-1] * (CAUSES[-1] / CAUSES[-2]) ** np.arange(1, len(CAUSES))
    first = min(acting, len(CAUSES) - 1)
    return np.asarray(np.log(np.concatenate([CAUSES, beyond])[first : first + len(CAUSES)]))


@dataclass(frozen=True)
class ModelEntry:
    """A model that is weighed: its components with the scale of each, and its log weight."""

    key: Key
    log_weight: float

    @property
    def members(self) -> tuple[int, ...]:
        """The components of the entry."""
        return tuple(k for k, _ in self.key)


@dataclass(frozen=True, eq=False)
class Products:
    """C'C ``(k, k)`` and C'y ``(k,)`` of columns in units; ``square`` is y'y."""

    inner: FloatArray
    along: FloatArray
    square: float

    @classmethod
    def of(cls, columns: FloatArray, rows: FloatArray) -> Products:
        """The products of columns ``(n, k)`` and readings ``(n,)``."""
        return cls(columns.T @ columns, columns.T @ rows, float(rows @ rows))


@dataclass(frozen=True, eq=False)
class ModelSelection:
    """Components to select from: columns ``columns[k]`` of each, log priors, what tells the noise.

    ``log_prior`` ``(k,)`` is spread over the scales, or has a row for each, ``(scales, k)``.
    ``excess`` is the square sum of readings that disagree with their repeats, ``acting`` the number
    of adopted effects.
    """

    products: Products
    columns: Sequence[IntArray]
    log_prior: FloatArray
    free: int
    freedom: float
    excess: float = 0.0
    acting: int = 0

    @cached_property
    def _log_causes(self) -> FloatArray:
        return log_causes(self.acting)

    @cached_property
    def _log_prior(self) -> FloatArray:
        """Log prior of each component at each scale ``(scales, k)``."""
        return np.asarray(LOG_SCALES[:, None] + self.log_prior)

    def log_evidence(self, square: FloatArray, room: FloatArray) -> FloatArray:
        """Log evidence from what is left and the room of models, ``(...)``."""
        if math.isinf(self.freedom):
            return np.asarray(room - 0.5 * (self.excess + square))
        remainder = np.maximum(self.freedom + self.excess + square, 1e-9)
        return np.asarray(room - 0.5 * (self.freedom + self.free) * np.log(remainder))

    def columns_of(self, key: Key) -> tuple[IntArray, FloatArray]:
        """The columns ``(r,)`` of a model, and the scale of each."""
        index = np.concatenate([np.zeros(0, np.intp), *(self.columns[k] for k, _ in key)])
        return index, np.repeat([scale for _, scale in key], [len(self.columns[k]) for k, _ in key])

    def explained_by(
        self, key: Key, columns: slice = slice(None)
    ) -> tuple[FloatArray, FloatArray, float]:
        """What a model takes over of C'C and C'y: ``shown`` ``(r, k)``, ``along`` ``(r,)``, room.

        For others the products are C'C - ``shown``' ``shown``, of these ``columns``, C'y -
        ``shown``' ``along``, y'y - ``along``' ``along``, and the log determinant is in the room.
        """
        index, scale = self.columns_of(key)
        inner, along = self.products.inner[index], self.products.along[index]
        root = np.linalg.cholesky(np.eye(len(index)) + scale[:, None] * inner[:, index] * scale)
        products = np.column_stack([inner[:, columns], along])
        explained = np.linalg.solve(root, scale[:, None] * products)
        return explained[:, :-1], explained[:, -1], -float(np.log(root.diagonal()).sum())

    def _cost(self, key: Key, further: int = 0) -> float:
        """Log prior of a model, of ``further`` components but for their own."""
        costs = (self._log_prior[SCALES.index(scale), k] for k, scale in key)
        return float(self._log_causes[len(key) + further] + sum(costs))

    def entry(self, key: Key) -> ModelEntry:
        """One model, weighed alone."""
        _, along, room = self.explained_by(key, slice(0))
        square = np.array(self.products.square - float(along @ along))
        return ModelEntry(key, float(self.log_evidence(square, np.array(room))) + self._cost(key))

    def best_singles(
        self, along: FloatArray, square: FloatArray, components: Sequence[int]
    ) -> FloatArray:
        """Log weights ``(m,)`` of the best of these components alone for other readings.

        Their products with columns are ``along`` ``(k, m)``, with themselves ``square`` ``(m,)``.
        """
        best = np.full(len(square), -math.inf)
        for members, index, blocks in self._blocks:
            is_among = np.isin(members, components)
            if not is_among.any():
                continue
            sizes, axes = np.linalg.eigh(blocks[is_among])
            turned = np.swapaxes(axes, 1, 2) @ along[index[is_among]]
            size = np.maximum(sizes, 0.0)
            for scale, log_prior in zip(SCALES, self._log_prior, strict=True):
                wide = 1.0 + scale**2 * size
                remainder = square - (scale**2 * turned**2 / wide[:, :, None]).sum(axis=1)
                room = -0.5 * np.log(wide).sum(axis=1)
                log = self.log_evidence(remainder, room[:, None])
                log = log + log_prior[members[is_among]][:, None]
                best = np.maximum(best, log.max(axis=0))
        return np.asarray(best + self._log_causes[1])

    @cached_property
    def _blocks(self) -> list[tuple[IntArray, IntArray, FloatArray]]:
        """Components ``(m,)`` of each width, their columns ``(m, w)``, and C'C ``(m, w, w)``."""
        widths = np.array([len(columns) for columns in self.columns])
        blocks = []
        for width in np.unique(widths):
            members = np.flatnonzero(widths == width)
            index = np.array([self.columns[int(k)] for k in members])
            blocks.append((members, index, self.products.inner[index[:, :, None], index[:, None]]))
        return blocks

    def one_more(self, key: Key = ()) -> tuple[FloatArray, FloatArray]:
        """What is left and the room ``(scales, components)`` of each beside a model."""
        products, explained, room_of_model = self.explained_by(key)
        along = self.products.along - explained @ products
        remainder = self.products.square - float(explained @ explained)
        square = np.empty((len(SCALES), len(self.columns)))
        room = np.empty_like(square)
        scales = np.array(SCALES)[:, None, None, None]
        for members, index, inner in self._blocks:
            overlap = products[:, index]
            blocks = inner - np.einsum("rmi,rmj->mij", overlap, overlap)
            root = np.linalg.cholesky(np.eye(index.shape[1]) + scales**2 * blocks)
            own_along = np.linalg.solve(root, scales * along[index][:, :, None])
            square[:, members] = remainder - (own_along**2).sum(axis=(2, 3))
            room[:, members] = -np.log(np.diagonal(root, axis1=2, axis2=3)).sum(axis=2)
        return square, room_of_model + room

    def log_weights(self, key: Key = ()) -> FloatArray:
        """Log weights ``(scales, components)`` of a model with one component more than these."""
        log = self.log_evidence(*self.one_more(key)) + self._log_prior + self._cost(key, 1)
        log[:, [member for member, _ in key]] = -math.inf
        return log

    def entries(self, lightest: float = LIGHTEST) -> list[ModelEntry]:
        """Every model of more weight than the ``lightest``, the heaviest first.

        All pairs are tried; of triples those that hold one of the heaviest pairs.
        """
        weights: dict[Key, float] = {(): self.entry(()).log_weight}
        weights |= self._beside([()], weights[()])
        wide = [k for k, columns in enumerate(self.columns) if len(columns) > NARROW]
        pairs = self._pairs()
        starts: list[Key] = [((k, scale),) for k in wide for scale in SCALES]
        for key, log in self._beside(starts, max(pairs.values(), default=-math.inf)).items():
            pairs[key] = max(log, pairs.get(key, -math.inf))
        heaviest: dict[tuple[int, ...], Key] = {}
        for key in sorted(pairs, key=lambda key: -pairs[key]):
            heaviest.setdefault(tuple(k for k, _ in key), key)
        weights |= pairs
        best = max(weights.values())
        weights |= self._beside(list(heaviest.values())[:TRIPLES_FROM], best)
        logs = np.array(list(weights.values()))
        share = np.exp(logs - logs.max())
        share /= share.sum()
        entries = [
            ModelEntry(key, log)
            for (key, log), part in zip(weights.items(), share, strict=True)
            if part > lightest
        ]
        return sorted(entries, key=lambda entry: -entry.log_weight)

    def _beside(self, starts: Sequence[Key], best: float) -> dict[Key, float]:
        """Log weights of models of one component more than these; none far behind the ``best``."""
        log_of_starts = []
        for members in starts:
            log = self.log_weights(members)
            best = max(best, float(log.max()))
            log_of_starts.append(log)
        return {
            tuple(sorted((*members, (k, SCALES[row])))): float(log[row, k])
            for members, log in zip(starts, log_of_starts, strict=True)
            for row, k in np.argwhere(log > best - FAR_BEHIND).tolist()
        }

    def _pairs(self) -> dict[Key, float]:
        """Log weights of pairs of narrow components.

        Every pair is weighed at the scales that its own sizes suggest, the best at all scales.
        """
        narrow = [
            (members, index) for members, index, _ in self._blocks if index.shape[1] <= NARROW
        ]
        grids = []
        for (first, first_index), (second, second_index) in combinations_with_replacement(
            narrow, 2
        ):
            i, j = (
                np.triu_indices(len(first), 1)
                if first is second
                else np.indices((len(first), len(second))).reshape(2, -1)
            )
            pairs = np.column_stack([first[i], second[j]])
            index = np.hstack([first_index[i], second_index[j]])
            widths = first_index.shape[1], second_index.shape[1]
            sizes = self._sizes(index, widths, np.full(pairs.shape, len(SCALES) - 1))
            scale = np.rint(np.log(sizes) / math.log(SCALES[1]))
            scale = np.clip(scale, 0, len(SCALES) - 1).astype(np.intp)
            grids.append((pairs, index, widths, self._log_weights(pairs, index, widths, scale)))
        logs = np.concatenate([np.zeros(0), *(log for *_, log in grids)])
        if not len(logs):
            return {}
        is_best = logs > logs.max() - FAR_BEHIND
        is_best[np.argsort(-logs, kind="stable")[PAIRS:]] = False  # all may weigh the same
        weights: dict[Key, float] = {}
        scale_pairs = np.array([*product(range(len(SCALES)), repeat=2)])
        ends = np.cumsum([len(log) for *_, log in grids])
        for (pairs, index, widths, _), among in zip(
            grids, np.split(is_best, ends[:-1]), strict=True
        ):
            best = np.repeat(np.flatnonzero(among), len(scale_pairs))
            scale = np.resize(scale_pairs, (len(best), 2))
            values = self._log_weights(pairs[best], index[best], widths, scale)
            weighed = zip(pairs[best].tolist(), scale.tolist(), values.tolist(), strict=True)
            for (k, j), (a, b), value in weighed:
                weights[tuple(sorted(((k, SCALES[a]), (j, SCALES[b]))))] = value
        return weights

    def _scaled(
        self, index: IntArray, widths: tuple[int, int], scale: IntArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Scale of each column, and the products ``(n, d, d)`` and ``(n, d)`` in such units."""
        of_column = np.repeat(np.array(SCALES)[scale], widths, axis=1)
        inner = self.products.inner[index[:, :, None], index[:, None, :]]
        inner = np.eye(index.shape[1]) + of_column[:, :, None] * inner * of_column[:, None, :]
        return of_column, inner, of_column * self.products.along[index]

    def _sizes(self, index: IntArray, widths: tuple[int, int], scale: IntArray) -> FloatArray:
        """R.m.s. of the sizes of both components ``(n, 2)``, in units."""
        of_column, inner, along = self._scaled(index, widths, scale)
        square = (of_column * np.linalg.solve(inner, along[:, :, None])[:, :, 0]) ** 2
        middle = widths[0]
        parts = square[:, :middle].mean(axis=1), square[:, middle:].mean(axis=1)
        return np.asarray(np.sqrt(np.maximum(np.stack(parts, axis=1), 1e-12)))

    def _log_weights(
        self, pairs: IntArray, index: IntArray, widths: tuple[int, int], scale: IntArray
    ) -> FloatArray:
        """Log weights ``(n,)`` of pairs ``(n, 2)`` at these scales ``(n, 2)``."""
        _, inner, along = self._scaled(index, widths, scale)
        root = np.linalg.cholesky(inner)
        explained = np.linalg.solve(root, along[:, :, None])[:, :, 0]
        room = -np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)
        square = self.products.square - (explained**2).sum(axis=1)
        prior = self._log_prior[scale, pairs].sum(axis=1)
        return np.asarray(self.log_evidence(square, room) + prior + self._log_causes[2])


def log_prior_odds(key: Key, components: Sequence[Component], acting: int) -> float:
    """Log prior of a model with these components at these scales, less that of one without any.

    Of effects that were adopted there are ``acting``.
    """
    log_prior = sum(components[k].log_prior + LOG_SCALES[SCALES.index(scale)] for k, scale in key)
    causes = log_causes(acting)
    return float(causes[len(key)] - causes[0] + log_prior)
