"""A machine that is off, readings along a path, and the laws of the catalogue by their ids."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.arrays import Conditions
from calib.tripod.effects import BESIDE_CATALOGUE, CATALOGUE
from calib.tripod.effects.effect import Effect
from tests.builders import postures

OFF = (1.2, -0.7, 0.4, 0.05, -0.02, 0.03)


def walked(levels: tuple[float, ...] = (0, 22, 60, 22, 0, -37, -100, -37, 0)) -> Conditions:
    """Every leg and axis over a path, with directions, times and temperatures."""
    plan = postures(levels, repeats=2)
    rows = np.arange(len(plan)).astype(np.float64)
    moved = np.sign(np.diff(plan.displacement_mm, prepend=0.0))
    moved[np.diff(plan.mount, prepend=-1) != 0] = 0.0
    return replace(plan, approach=moved, time_s=rows * 20.0, temperature_c=21.0 + rows * 0.01)


TAKEN = walked()

EVERY = (*CATALOGUE, *BESIDE_CATALOGUE)


def effect(effect_id: str, parameter: str = "") -> Effect:
    return next(
        law for law in EVERY if law.id == effect_id and parameter in ("", law.parameters[0].name)
    )
