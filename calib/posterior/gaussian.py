"""Normals of linear problems: a base fitted to rows, and a little of every law as their noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.arrays import FloatArray, without


class LittleOfAll:
    """A little of every law as a part of the noise: I + L L' in place of I, L ``(n, l)``.

    Its inverse root is symmetric: (I + L L')^-1/2, or I - L g(L'L) L' where laws are fewer than
    rows, with g(x) = (1 - 1/sqrt(1 + x)) / x. ``room`` is minus half its log determinant. Where all
    else is known the laws, per unit, have the covariance (I + L'L)^-1; its ``root`` ``(l, l)`` is
    the same with L' in place of L. ``seen`` ``(n, l)`` are the columns whitened.
    """

    def __init__(self, columns: FloatArray) -> None:
        self.columns, self._few = columns, columns.shape[1] < len(columns)
        smaller = columns.T if self._few else columns
        square, axes = np.linalg.eigh(smaller @ smaller.T)
        wide = np.sqrt(1.0 + np.maximum(square, 0.0))
        self._inverse_root = (axes / wide) @ axes.T
        self._inner = (axes / (wide * (1.0 + wide))) @ axes.T
        self.room = -float(np.log(wide).sum())
        self.seen = self.whitened(columns)
        self.root = self._inverse_root
        if not self._few:
            self.root = np.eye(columns.shape[1]) - columns.T @ (self._inner @ columns)

    def whitened(self, rows: FloatArray) -> FloatArray:
        """Rows ``(n, ...)`` with independent noise of unit variance, this little in it."""
        if self._few:
            return np.asarray(rows - self.columns @ (self._inner @ (self.columns.T @ rows)))
        return np.asarray(self._inverse_root @ rows)


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
