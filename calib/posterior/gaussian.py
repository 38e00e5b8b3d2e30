"""Normals of linear problems: a base fitted to rows, and a little of every law as their noise."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.arrays import FloatArray, without


@dataclass(frozen=True, eq=False)
class LittleOfAll:
    """A little of every law as a part of the noise: I + L L' in place of I, L ``(n, l)``.

    Its inverse root is symmetric: (I + L L')^-1/2, or I - L g(L'L) L' where laws are fewer than
    rows, with g(x) = (1 - 1/sqrt(1 + x)) / x. A root of the covariance of the laws where all else
    is known, (I + L'L)^-1, is the same with L' in place of L.
    """

    columns: FloatArray

    @cached_property
    def _few(self) -> bool:
        return bool(self.columns.shape[1] < len(self.columns))

    @cached_property
    def _spectrum(self) -> tuple[FloatArray, FloatArray]:
        """Eigenvalues and axes of the smaller of L'L and L L'."""
        smaller = self.columns.T if self._few else self.columns
        square, axes = np.linalg.eigh(smaller @ smaller.T)
        return np.maximum(square, 0.0), axes

    @cached_property
    def _direct(self) -> FloatArray:
        """The inverse root of I and the smaller product."""
        square, axes = self._spectrum
        return np.asarray((axes / np.sqrt(1.0 + square)) @ axes.T)

    @cached_property
    def _inner(self) -> FloatArray:
        """G of the smaller product."""
        square, axes = self._spectrum
        wide = np.sqrt(1.0 + square)
        return np.asarray((axes / (wide * (1.0 + wide))) @ axes.T)

    def whitened(self, rows: FloatArray) -> FloatArray:
        """Rows ``(n, ...)`` with independent noise of unit variance, this little in it."""
        if self._few:
            return np.asarray(rows - self.columns @ (self._inner @ (self.columns.T @ rows)))
        return np.asarray(self._direct @ rows)

    @cached_property
    def seen(self) -> FloatArray:
        """`columns` whitened."""
        return self.whitened(self.columns)

    @cached_property
    def root(self) -> FloatArray:
        """Root ``(l, l)`` of the covariance of the laws, per unit, where all else is known."""
        if self._few:
            return self._direct
        return np.eye(self.columns.shape[1]) - self.columns.T @ (self._inner @ self.columns)

    @cached_property
    def room(self) -> float:
        """Minus half the log determinant of I + L L'."""
        return -0.5 * float(np.log1p(self._spectrum[0]).sum())


@dataclass(frozen=True, eq=False)
class About:
    """A base fitted to rows, tolerances being rows below: no product of derivatives loses digits.

    ``basis`` ``(n + b, b)``, ``inverse`` ``(b, b)`` of its root, the target ``along`` it ``(b,)``
    and what is ``left`` of that ``(n + b,)``.
    """

    basis: FloatArray
    inverse: FloatArray
    along: FloatArray
    left: FloatArray
    room: float

    @classmethod
    def of(
        cls,
        base: FloatArray,
        residual: FloatArray,
        expected: FloatArray,
        whitening: FloatArray | None = None,
    ) -> About:
        """The problem linearised by derivatives ``(n, b)`` per standard deviation.

        Expected values are independent; with ``whitening`` ``(b, b)`` they become so by it.
        """
        whitening = np.eye(base.shape[1]) if whitening is None else whitening
        basis, root = np.linalg.qr(np.vstack([base, whitening]))
        target = np.concatenate([residual, whitening @ expected])
        along = basis.T @ target
        room = float(np.log(whitening.diagonal()).sum() - np.log(np.abs(root.diagonal())).sum())
        return cls(basis, np.linalg.inv(root), along, without(basis, target), room)

    def left_by(self, columns: FloatArray) -> FloatArray:
        """What of columns ``(n, k)`` the base does not do ``(n + b, k)``."""
        remainder = -(self.basis @ (self.basis[: len(columns)].T @ columns))
        remainder[: len(columns)] += columns
        return np.asarray(remainder)
