"""Readings of a simulated machine: the pipeline, an arbitrary zero, scatter and rounding."""

from __future__ import annotations

import numpy as np

from calib.observations import Conditions, FloatArray
from calib.orthoglide.model import Model

ZERO_SPREAD_MM = 0.5
"""Standard deviation of where an operator leaves the zero of a freshly mounted indicator."""


def measure(
    model: Model,
    taken: Conditions,
    *,
    scatter_mm: float,
    resolution_mm: float,
    generator: np.random.Generator,
) -> FloatArray:
    """Readings ``(n_readings,)`` in mm as indicators would show them.

    ``scatter_mm`` is the standard deviation of each re-approach, ``resolution_mm`` the step of the
    display (0 for none).
    """
    zeros = generator.normal(scale=ZERO_SPREAD_MM, size=taken.mount_count)
    values = model.readings(taken) + zeros[taken.mount]
    values = values + generator.normal(scale=1.0, size=len(taken)) * scatter_mm
    return round_to(values, resolution_mm)


def round_to(values_mm: FloatArray, resolution_mm: float) -> FloatArray:
    """Values rounded to the nearest step of the display; unchanged for a step of 0."""
    return np.round(values_mm / resolution_mm) * resolution_mm if resolution_mm > 0 else values_mm
