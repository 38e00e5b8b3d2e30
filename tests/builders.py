"""Observations of standard postures for tests."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.observations import Conditions, FloatArray, Observations, conditions, observe
from calib.orthoglide.model import Model

ZERO_MAX_MIN = (0.0, 60.0, -100.0)


def postures(
    levels: Sequence[float] = ZERO_MAX_MIN, *, repeats: int = 1, station: float = 0.5
) -> Conditions:
    """Every leg and axis in every level, repeated."""
    rows = [
        (leg, axis, level)
        for leg in range(3)
        for axis in range(3)
        if axis != leg
        for _ in range(repeats)
        for level in levels
    ]
    legs, axes, displacements = zip(*rows, strict=True)
    return conditions(legs, axes, displacements, station=station)


def observed(
    parameters_mm: Sequence[float],
    taken: Conditions,
    *,
    scatter_mm: float = 0.0,
    seed: int = 0,
) -> Observations:
    """Readings of a machine with these parameters, arbitrary zeros and Gaussian scatter."""
    generator = np.random.default_rng(seed)
    zeros = generator.normal(size=taken.mount_count)
    values: FloatArray = Model(parameters_mm=tuple(parameters_mm)).readings(taken)
    return observe(
        taken, values + zeros[taken.mount] + generator.normal(size=len(taken)) * scatter_mm
    )
