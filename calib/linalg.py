"""What is done with columns in every room: projections, bases, ranks, means of groups.

A ``basis`` ``(n, r)`` has orthonormal columns. Where a rank is cut depends on what made the
columns, so each cut has its name and its reason here. Cuts of sums of squares are their squares.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calib.observations import FloatArray, IntArray

NEW_DIRECTION = 1e-3
"""Of columns of unit length: what is left of one beside all that is known, from which on it counts
as a direction of its own. An effect shows in less only from a thousand times its noise on."""

DEPENDENT = 1e-9
"""Relative, of columns of groups and derivatives of about one size, or of their products: what
depends on others is left with rounding, some 1e-15, all else with 1e-3 and more."""

EXACT_BLIND = 1e-10
"""Relative singular value below which exact derivatives show nothing; gaps found are 1e9."""

BLIND = 1e-6
"""The same whatever the derivatives: ten times what derivatives wrong by 1e-7 can feign."""

BLIND_IN_SQUARES = 1e-7
"""Root of a relative eigenvalue of scaled information: squares keep half the digits, and rounding
feigns 1e-8."""

BASE_SQUARES = 1e-11
"""Relative eigenvalue of products of the base columns of a short addition. Travels of few levels
show combinations less and less, without a gap; below this, products have few digits left."""

ROUNDING = 1e-13
"""Relative singular value that is nothing but rounding: keeps logarithms and inverses finite."""

TINY = 1e-300


def onto(basis: FloatArray, rows: FloatArray) -> FloatArray:
    """The part of ``(n,)`` or ``(n, k)`` that lies in a basis ``(n, r)``."""
    return np.asarray(basis @ (basis.T @ rows))


def without(basis: FloatArray, rows: FloatArray) -> FloatArray:
    """The part of ``(n,)`` or ``(n, k)`` that a basis ``(n, r)`` leaves."""
    return np.asarray(rows - basis @ (basis.T @ rows))


def squares_in(basis: FloatArray, rows: FloatArray) -> float:
    """Square sum of the part that lies in a basis."""
    return float(((basis.T @ rows) ** 2).sum())


def lengths(columns: FloatArray) -> FloatArray:
    """Lengths ``(k,)`` of columns, fit to divide by."""
    return np.asarray(np.maximum(np.sqrt((columns**2).sum(axis=0)), TINY))


def basis_of(columns: FloatArray, cut: float, scale: float | None = None) -> FloatArray:
    """Basis ``(n, r)`` of columns ``(n, k)``.

    Singular values up to ``cut`` times ``scale`` do not count; the scale is the largest of them
    unless it is given: what the columns were before something was projected out.
    """
    left, singular, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(left[:, _counted(singular, cut, scale)])


def basis_by_products(columns: FloatArray) -> FloatArray:
    """Basis of few columns of many rows, quicker; they have a size of 1 or more, or are nothing."""
    square, axes = np.linalg.eigh(columns.T @ columns)
    seen = square > DEPENDENT * max(float(square[-1]), DEPENDENT)
    return np.asarray(columns @ (axes[:, seen] / np.sqrt(square[seen])))


def rank_of(columns: FloatArray, cut: float, scale: float | None = None) -> int:
    """Rank of columns ``(n, k)``, cut as in `basis_of`."""
    singular = np.asarray(np.linalg.svd(columns, compute_uv=False), dtype=np.float64)
    return int(_counted(singular, cut, scale).sum())


def _counted(singular: FloatArray, cut: float, scale: float | None) -> NDArray[np.bool_]:
    return np.asarray(singular > cut * (singular.max(initial=0.0) if scale is None else scale))


def new_directions(basis: FloatArray, columns: FloatArray) -> FloatArray:
    """Basis of what columns ``(n, k)`` of unit length add to a basis."""
    return basis_of(without(basis, columns), NEW_DIRECTION, 1.0)


def union(blocks: Sequence[FloatArray]) -> FloatArray:
    """Basis ``(n, r)`` of several bases together."""
    basis = blocks[0]
    for block in blocks[1:]:
        basis = np.hstack([basis, new_directions(basis, block)])
    return basis


def null_space(rows: FloatArray) -> FloatArray:
    """Basis ``(k, k - n)`` of what is orthogonal to independent rows ``(n, k)``."""
    return np.asarray(np.linalg.qr(rows.T, mode="complete")[0][:, len(rows) :])


def svd_of_all(rows: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Left ``(n, k)``, values ``(k,)`` and right ``(k, k)`` of ``(n, k)``, however few rows."""
    count = rows.shape[1]
    padded = np.vstack([rows, np.zeros((max(count - len(rows), 0), count))])
    left, singular, right = np.linalg.svd(padded, full_matrices=False)
    return left[: len(rows)], singular, right


def condition(rows: FloatArray, rank: int) -> float:
    """Largest by smallest of the singular values that count, columns as they are."""
    singular = np.linalg.svd(rows, compute_uv=False)
    return float(singular[0] / singular[rank - 1]) if rank else np.inf


def named_inside(
    space: FloatArray, named: Sequence[tuple[str, FloatArray]]
) -> tuple[list[tuple[FloatArray, str]], FloatArray]:
    """Vectors of unit length with names that lie in a space, each a new one; a basis of the rest.

    ``space`` ``(k, r)`` is a basis.
    """
    found, rest = [], space
    for name, vector in named:
        unit = vector / np.linalg.norm(vector)
        inside = onto(rest, unit)
        if np.linalg.norm(without(space, unit)) < BLIND < np.linalg.norm(inside):
            found.append((unit, name))
            inside = inside / np.linalg.norm(inside)
            # the singular values that are left are one and, once, zero
            rest = basis_of(without(inside[:, None], rest), 0.5, 1.0)
    return found, rest


def names_outside(space: FloatArray, names: Sequence[str]) -> tuple[str, ...]:
    """Names of coordinates that have no share in a space ``(k, r)``."""
    share = np.sqrt((space**2).sum(axis=1))
    return tuple(name for name, part in zip(names, share, strict=True) if part < BLIND)


def incidence(group: IntArray) -> FloatArray:
    """One column for each group ``(n, groups)``, 1 in its rows; groups are numbered from 0."""
    return np.asarray(np.eye(int(group.max(initial=-1)) + 1)[group])


def without_means(group: IntArray, weight: FloatArray, rows: FloatArray) -> FloatArray:
    """Subtract from the rows ``(n, ...)`` of each group their mean, weighted by ``(n,)``."""
    total = np.bincount(group, weight)
    flat = rows.reshape(len(rows), -1)
    means = np.stack([np.bincount(group, weight * column) / total for column in flat.T], axis=1)
    return np.asarray((flat - means[group]).reshape(rows.shape))
