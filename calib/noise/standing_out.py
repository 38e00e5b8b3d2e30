"""Readings and indicators that stand out, by their rows; none of them is left out for it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from calib.noise.reading import Noise
from calib.observations import IntArray, Observations
from calib.ties import descending


@dataclass(frozen=True)
class LoudIndicator:
    """An indicator that scatters more than the quietest: its first row and its scatter, mm.

    ``mounting`` is False where it was used in more than one mounting; ``number`` counts from 1.
    """

    row: int
    mounting: bool
    number: int
    scatter_mm: float


def loud_indicators(observed: Observations, noise: Noise) -> list[LoudIndicator]:
    """Indicators with an estimate of their own, the loudest first."""
    quiet = noise.quiet_mm2
    found = []
    for k, one in enumerate(noise.indicators):
        if one.variance_mm2 > quiet:
            rows = np.flatnonzero(observed.indicator == k)
            single = len(np.unique(observed.mount[rows])) == 1
            scatter = math.sqrt(one.variance_mm2)
            found.append(LoudIndicator(int(rows[0]), single, k + 1, scatter))
    return descending(found, lambda one: one.scatter_mm)


def lost_rows(observed: Observations) -> list[IntArray]:
    """Rows of each mounting of a single posture: without another one they say nothing."""
    return [rows for rows in observed.mountings if len(np.unique(observed.level[rows])) == 1]
