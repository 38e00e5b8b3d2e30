"""Largest and smallest of computed numbers, the same on every processor.

Legs, axes and stations of a symmetrical machine give equal numbers but for rounding, and rounding
differs between processors. Numbers alike within rounding share a rank, and the first one counts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeVar

import numpy as np

from calib.observations import FloatArray, IntArray

One = TypeVar("One")

ROUNDING = 1e-9
"""Relative difference that is rounding: kernels differ by 1e-16 in one operation, by up to 1e-10
where matrices of condition 1e6 are solved. No figure shown to people has nine digits."""


def ranks(values: FloatArray, unit: float = 0.0) -> IntArray:
    """Rank of each of ``(n,)``, 0 for the largest; those alike within rounding share one.

    Numbers that may cancel to nothing, such as logarithms, need the ``unit`` that is one of them:
    what rounding leaves is judged beside it.
    """
    order = np.argsort(-values, kind="stable")
    sorted_down = values[order]
    above, below = sorted_down[:-1], sorted_down[1:]
    size = np.maximum(np.maximum(np.abs(above), np.abs(below)), unit)
    with np.errstate(invalid="ignore"):
        apart = np.where(np.isfinite(size), above - below > ROUNDING * size, above != below)
    found = np.empty(len(values), dtype=np.intp)
    found[order] = np.concatenate([[0], np.cumsum(apart)])[: len(values)]
    return found


def largest(values: FloatArray, unit: float = 0.0) -> int:
    """Index of the largest of any shape, flattened; the first of those alike."""
    most = float(values.max())
    least = most - ROUNDING * max(abs(most), unit) if np.isfinite(most) else most
    return int((values >= least).argmax())


def descending(things: Iterable[One], size: Callable[[One], float], unit: float = 0.0) -> list[One]:
    """The things by size, the largest first; those alike stay in the order in which they came."""
    found = list(things)
    order = np.argsort(ranks(np.array([size(one) for one in found]), unit), kind="stable")
    return [found[k] for k in order]
