"""Models that share a base, before and after further readings, all at once.

In each model everything is linear about its own solution. So its covariance after the readings is
known beforehand, and so is where its mean goes if another model is true.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import block_diag  # scipy.linalg would take 0.04 s more to import

from calib.arrays import FloatArray
from calib.posterior.tool_errors import InField, ModelColumns, Squares


@dataclass(frozen=True, eq=False)
class ExpectedReadings:
    """Expected means of cells ``(n,)`` of set-ups, in standard deviations, without their zeros.

    ``columns`` ``(n, f)`` are derivatives by the tool's field, ``own`` ``(n, k)`` errors of each
    posture's own per mm, ``loose`` ``(n, l)`` what differences of joint offsets do within theirs.
    ``followed`` are expected means and columns of the models that have their own.
    """

    expected: FloatArray
    columns: FloatArray
    own: FloatArray
    loose: FloatArray
    followed: tuple[tuple[FloatArray, FloatArray], ...]

    @classmethod
    def together(cls, parts: Sequence[ExpectedReadings]) -> ExpectedReadings:
        """Several set-ups one after the other."""
        if len(parts) == 1:
            return parts[0]
        return cls(
            np.concatenate([part.expected for part in parts]),
            np.vstack([part.columns for part in parts]),
            block_diag([part.own for part in parts]).toarray(),
            np.vstack([part.loose for part in parts]),
            tuple(
                (
                    np.concatenate([e for e, _ in followed_models]),
                    np.vstack([c for _, c in followed_models]),
                )
                for followed_models in zip(*(part.followed for part in parts), strict=True)
            ),
        )


class Group:
    """Models ``rows`` of a forecast that share a base, their sizes side by side.

    Each has ``columns`` of the root ``sizes`` ``(f, R)``, ``base`` ``(f, b)`` is the root that they
    share, ``away`` ``(f, M)`` their means less where readings are linear about. ``tool_base``,
    ``tool_sizes`` and ``tool_mean`` are the same in what stands for the tool ``(2q, ...)``: what it
    does, then what is entered. Something else is of ``size_mm`` in each posture.
    """

    def __init__(
        self,
        rows: Sequence[int],
        fields: Sequence[InField],
        size_mm: float,
        about: FloatArray,
        tool: FloatArray,
    ) -> None:
        """Models in the tool's field, linear ``about`` ``(f,)``; ``tool`` is ``(2q, f)``."""
        roots = [field.root / field.inflated for field in fields]
        mean = np.column_stack([field.mean for field in fields])
        self.rows, self.size_mm = np.array(rows, dtype=np.intp), size_mm
        self.columns = ModelColumns([root.shape[1] for root in roots])
        self.base, self.sizes = fields[0].base_root, np.hstack(roots)
        self.away = mean - about[:, None]
        self.inflated = np.array([field.inflated for field in fields])
        self.tool_base, self.tool_sizes = tool @ self.base, tool @ self.sizes
        self.tool_mean = tool @ mean


class UpdatedGroup:
    """A group with the covariance after readings: the base, beside it the sizes.

    ``shown`` ``(n, b)`` is what the base does to the readings made ``white`` ``(n, n)``, ``sizes``
    ``(n, R)`` what those of each model do; ``roots`` ``(m, r, r)`` of blocks are those of the
    covariance of sizes, ``seen`` ``(n, R)`` these in the readings. ``lower`` is the inverse of
    ``white``; ``expected`` ``(n, M)`` are the readings if a model is true, ``room`` ``(M,)`` the
    logs of the roots of determinants.
    """

    def __init__(self, group: Group, readings: ExpectedReadings, followed: Sequence[int]) -> None:
        self.group = group
        of_base = readings.columns @ group.base
        noise = np.hstack([readings.loose, group.size_mm * readings.own])
        square = np.eye(len(of_base)) + of_base @ of_base.T + noise @ noise.T
        self.lower = np.linalg.cholesky(square)
        self.white = np.linalg.inv(self.lower)
        sizes = readings.columns @ group.sizes
        self.expected = readings.expected[:, None] + readings.columns @ group.away
        for number, (means, columns) in zip(followed, readings.followed, strict=True):
            for j in np.flatnonzero(group.rows == number).tolist():
                places = group.columns.owner == j
                sizes[:, places] = columns @ group.sizes[:, places]
                self.expected[:, j] = means
        self.shown, self.sizes = self.white @ of_base, self.white @ sizes
        self.seen, self.roots = np.zeros_like(self.sizes), list[FloatArray]()
        self.room = np.full(len(group.rows), float(np.log(self.lower.diagonal()).sum()))
        for block in group.columns.blocks:
            inside = np.moveaxis(self.sizes[:, block], 1, 0)
            inner = np.swapaxes(inside, 1, 2) @ inside + np.eye(block.shape[1])
            root = np.swapaxes(np.linalg.inv(np.linalg.cholesky(inner)), 1, 2)
            self.roots.append(root)
            self.seen[:, block] = np.moveaxis(inside @ root, 0, 1)
            logs = np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)
            self.room[group.columns.owner[block[:, 0]]] -= logs

    @cached_property
    def gain(self) -> FloatArray:
        """How far a departure of the readings, made white, moves means at the tool ``(2q, n)``."""
        return np.asarray(self.group.tool_base @ self.shown.T)

    @cached_property
    def tool(self) -> FloatArray:
        """Roots of the covariance of sizes ``(2q, R)`` at the tool, beside that of the base."""
        moved = self.group.tool_sizes - self.gain @ self.sizes
        tool = np.zeros_like(moved)
        for block, root in zip(self.group.columns.blocks, self.roots, strict=True):
            tool[:, block] = np.moveaxis(np.moveaxis(moved[:, block], 1, 0) @ root, 0, 1)
        return tool

    def means(self, readings: FloatArray) -> FloatArray:
        """Means at the tool ``(2q, M)`` where these are the readings ``(n,)``."""
        departure = self.white @ (readings[:, None] - self.expected)
        along = (self.seen * departure[:, self.group.columns.owner]).sum(axis=0)
        of_sizes = self.group.columns.sums(self.tool * along)
        return np.asarray(self.group.tool_mean + self.gain @ departure + of_sizes)

    def squares(self, readings: FloatArray) -> FloatArray:
        """What each model leaves ``(h, M)`` of readings ``(n, h)``, in noise variances."""
        departure = np.tensordot(self.white, readings[:, :, None] - self.expected[:, None], axes=1)
        along = np.einsum("nr,nhr->hr", self.seen, departure[:, :, self.group.columns.owner])
        inside = self.group.columns.sums(along**2)
        return np.asarray(((departure**2).sum(axis=0) - inside) / self.group.inflated**2)

    def log_factor(self, true: UpdatedGroup, j: int) -> FloatArray:
        """Expected log Bayes factor ``(M,)`` of model j, which is ``true``, over each."""
        sizes, inside = true.sizes[:, true.group.columns.owner == j], self.seen
        if true is not self:  # else white and lower are inverse
            root = self.white @ true.lower
            sizes, inside = root @ sizes, root.T @ inside
            wide = float((root**2).sum()) - len(root)
        else:
            wide = 0.0
        covered = self.group.columns.sums(
            (inside**2).sum(axis=0) + ((sizes.T @ self.seen) ** 2).sum(axis=0)
        )
        gain = wide + float((sizes**2).sum()) - covered
        square = self.squares(true.expected[:, [j]])[0]
        return np.asarray(0.5 * (gain + square) + self.room - true.room[j])

    @cached_property
    def squares_at_tool(self) -> Squares:
        """Mean squares at the tool, where means do not matter."""
        group, q = self.group, len(self.group.tool_base) // 2
        tool_base, gained = group.tool_base[:q], self.gain[:q]
        base = tool_base @ tool_base.T - gained @ gained.T
        return Squares(base, self.tool[:q], group.columns, group.inflated)
