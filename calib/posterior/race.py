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

import numpy as np

from calib.arrays import FloatArray, IntArray

SCALES = (1.0, 4.0, 16.0, 64.0)
"""Of an unremarkable size: the standard deviations that a size may have."""

LOG_SCALES = np.log([0.4, 0.3, 0.2, 0.1])
"""Their prior: larger ones are rarer, none is impossible."""

LOG_CAUSES = np.log([0.45, 0.40, 0.12, 0.03])
"""Prior of 0, 1, 2 and 3 components."""

BESIDE = 14
"""Components that are tried with every other; of pairs `BESIDE_PAIRS`."""
BESIDE_PAIRS = 8
CLOSEST = 8
"""Components that leave least, whatever they cost: two wide ones may be needed together."""

LIGHTEST = 1e-4
"""Models of less weight change nothing."""


@dataclass(frozen=True)
class Entry:
    """A model of the race: its components, the scale of each, and its log weight."""

    members: tuple[int, ...]
    scales: tuple[float, ...]
    log_weight: float


@dataclass(frozen=True, eq=False)
class Products:
    """C'C ``(k, k)`` and C'y ``(k,)`` of columns in units; what is explained, and its room.

    ``square`` is y'y. Beside a model, all that its components can do is gone from them.
    """

    inner: FloatArray
    along: FloatArray
    square: float
    room: float = 0.0

    def beside(self, index: IntArray, scale: float) -> Products:
        """With these columns, of this scale, in the model."""
        block = np.eye(len(index)) + scale**2 * self.inner[np.ix_(index, index)]
        root = np.linalg.cholesky(block)
        shown = scale * np.linalg.solve(root, self.inner[index])
        along = scale * np.linalg.solve(root, self.along[index])
        return Products(
            self.inner - shown.T @ shown,
            self.along - shown.T @ along,
            self.square - float(along @ along),
            self.room - float(np.log(root.diagonal()).sum()),
        )


@dataclass(frozen=True, eq=False)
class Race:
    """What runs: columns ``columns[k]`` of component k, its log prior, and what tells the noise.

    ``excess`` is the square sum of readings that disagree with their repeats.
    """

    products: Products
    columns: Sequence[IntArray]
    log_prior: FloatArray
    free: int
    freedom: float
    excess: float = 0.0

    def log_evidence(self, square: FloatArray, room: FloatArray) -> FloatArray:
        """Of what is left and the room of models, ``(...)``."""
        if math.isinf(self.freedom):
            return np.asarray(room - 0.5 * (self.excess + square))
        left = np.maximum(self.freedom + self.excess + square, 1e-9)
        return np.asarray(room - 0.5 * (self.freedom + self.free) * np.log(left))

    def _one_more(self, products: Products) -> tuple[FloatArray, FloatArray]:
        """What is left and the room ``(scales, components)`` of each beside a model."""
        square = np.empty((len(SCALES), len(self.columns)))
        room = np.empty_like(square)
        widths = np.array([len(one) for one in self.columns])
        for width in np.unique(widths):
            members = np.flatnonzero(widths == width)
            index = np.array([self.columns[k] for k in members.tolist()])
            if width == 1:
                sizes = np.maximum(products.inner[index[:, 0], index[:, 0]], 0.0)[:, None]
                along = products.along[index]
            else:
                blocks = products.inner[index[:, :, None], index[:, None, :]]
                sizes, axes = np.linalg.eigh(blocks)
                sizes = np.maximum(sizes, 0.0)
                along = (axes * products.along[index][:, :, None]).sum(axis=1)
            for row, scale in enumerate(SCALES):
                wide = 1.0 + scale**2 * sizes
                square[row, members] = products.square - (scale**2 * along**2 / wide).sum(axis=1)
                room[row, members] = products.room - 0.5 * np.log(wide).sum(axis=1)
        return square, room

    def run(self) -> list[Entry]:
        """Every model that counts, the heaviest first."""
        weights: dict[tuple[tuple[int, float], ...], float] = {}
        plain = self.products
        nothing = self.log_evidence(np.array(plain.square), np.array(plain.room))
        weights[()] = float(LOG_CAUSES[0] + nothing)
        closest: list[tuple[tuple[int, float], ...]] = []
        starts: list[tuple[tuple[tuple[int, float], ...], Products]] = [((), plain)]
        for causes, most in ((1, BESIDE), (2, BESIDE_PAIRS), (3, 0)):
            added: dict[tuple[tuple[int, float], ...], float] = {}
            for members, products in starts:
                square, room = self._one_more(products)
                log = self.log_evidence(square, room) + LOG_SCALES[:, None] + self.log_prior
                log += LOG_CAUSES[causes] + sum(self._cost(*one) for one in members)
                if causes == 1:
                    order = np.argsort(square.min(axis=0), kind="stable")[:CLOSEST]
                    closest = [((int(k), SCALES[int(log[:, k].argmax())]),) for k in order]
                best = float(log.max())
                for row, k in np.argwhere(log > best - 14.0):
                    if any(k == member for member, _ in members):
                        continue
                    key = tuple(sorted((*members, (int(k), SCALES[row]))))
                    added[key] = max(float(log[row, k]), added.get(key, -math.inf))
            weights |= added
            if not most:
                break
            heaviest = sorted(added, key=lambda key: -added[key])[: 4 * most]
            if causes == 1:  # what leaves least: one of two that are wide and needed together
                heaviest += closest
            sets: dict[tuple[int, ...], tuple[tuple[int, float], ...]] = {}
            for key in heaviest:  # each set of components once, at its best scales
                sets.setdefault(tuple(k for k, _ in key), key)
            starts = []
            for key in list(sets.values())[: most + CLOSEST]:
                products = plain
                for k, scale in key:
                    products = products.beside(self.columns[k], scale)
                starts.append((key, products))
        log = np.array(list(weights.values()))
        share = np.exp(log - log.max())
        share /= share.sum()
        entries = [
            Entry(tuple(k for k, _ in key), tuple(s for _, s in key), w)
            for (key, w), part in zip(weights.items(), share, strict=True)
            if part > LIGHTEST
        ]
        return sorted(entries, key=lambda entry: -entry.log_weight)

    def _cost(self, member: int, scale: float) -> float:
        return float(self.log_prior[member] + LOG_SCALES[SCALES.index(scale)])
