"""The step of a display, found in the values that it showed.

A display shows multiples of its step, however many digits a table has for them. Values that lie on
a coarser lattice than the one in which they are written down are evidence for a step: each
different value lies there by chance once in (step / written step) times.
"""

from __future__ import annotations

import math

import numpy as np

from calib.arrays import FloatArray

INCH_MM = 25.4

MM_STEPS = tuple(digit * 10.0**power for power in range(-1, -6, -1) for digit in (5.0, 2.0, 1.0))
INCH_STEPS = tuple(INCH_MM * step / 10.0 for step in MM_STEPS)
STEPS_MM = tuple(sorted((*MM_STEPS, *INCH_STEPS), reverse=True))
"""Steps that displays have, the coarsest first: 1, 2 and 5 in decimal places of mm and of inches,
these a place finer, as they are built."""

CHANCE = 1e-4
"""That values without a step lie on one of all these lattices: the evidence rule."""

FINEST_WRITTEN_MM = 1e-6
"""In what readings are written down where no decimal tells: a nanometre, finer than any display."""

LEAST_RATIO = 1.9
"""A step that is hardly coarser than what is written is that."""

ROUNDED = 0.5 + 1e-6
"""Of a written step: so far rounding puts a value beside its lattice."""


def display_step_mm(value_mm: FloatArray, written_mm: float | None) -> float | None:
    """The coarsest step of a display on which all values ``(n,)`` lie beyond chance, mm.

    ``written_mm`` is the step in which they are written down, None where nothing tells it. None
    where no step is coarser than that. Equal values are one piece of evidence, zero is none.
    """
    step_written_mm = written_mm or FINEST_WRITTEN_MM
    different = np.unique(np.round(np.abs(value_mm) / step_written_mm))
    count = len(different[different > 0.0])
    for step_mm in STEPS_MM:
        ratio = step_mm / step_written_mm
        if ratio < LEAST_RATIO or not count:
            return None
        if count * math.log(ratio) < math.log(len(STEPS_MM) / CHANCE):
            continue
        if float(np.abs(value_mm - step_mm * np.round(value_mm / step_mm)).max()) <= (
            ROUNDED * step_written_mm
        ):
            return step_mm
    return None
