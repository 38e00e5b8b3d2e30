"""What a name is worth at postures that neither its size nor the parameters were fitted to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.arrays import FloatArray, IntArray
from calib.hexaslide.diagnosis import FEWEST_SPARE, Names, WeighedCauses
from calib.posterior.gaussian import About

PARTS = 5
"""Of the postures: each is left out once, as `solve` keeps a fifth of them out."""


@dataclass(frozen=True)
class LeftOutGap:
    """R.m.s. of what is missed of postures that are left out, in standard deviations of the noise:
    without and with names whose size the other postures tell.
    """

    before: float
    after: float


def left_out_gap(models: WeighedCauses, names: Names) -> LeftOutGap | None:
    """Every ``PARTS``-th posture left out in turn; ``models`` are those that have the names.

    Adopted effects are fitted on both sides. None where the others are too few.
    """
    rows = np.arange(len(models.whitened)).reshape(len(models.readings.sliders), -1)
    if len(rows) < PARTS or models.spare - rows[::PARTS].size < FEWEST_SPARE:
        return None
    best = models.entries[0]
    widths = [len(models.selection.columns[k]) for k in best.members]
    scaled = models.columns(best) * models.selection.columns_of(best.key)[1]
    of_model = np.repeat([k in models.free.members for k in best.members], widths)
    is_named = [(models.causes[k].id, models.causes[k].where) in names for k in best.members]
    of_names = np.repeat(is_named, widths)
    squares = np.zeros(2)
    for part in range(PARTS):
        out = rows[part::PARTS].ravel()
        for number, columns in enumerate((of_model, of_model | of_names)):
            errors = _missed(models, scaled[:, columns], out)
            squares[number] += errors @ errors
    before, after = (models.noise_times * np.sqrt(squares / len(models.whitened))).tolist()
    return LeftOutGap(before, after)


def _missed(models: WeighedCauses, columns: FloatArray, out: IntArray) -> FloatArray:
    """What is missed of rows ``out`` by parameters and ``columns`` ``(n, r)`` fitted to others."""
    base = np.hstack([models.base, columns])
    expected = np.concatenate([models.expected, np.zeros(columns.shape[1])])
    inside = np.setdiff1d(np.arange(len(base)), out)
    about = About.of(base[inside], models.whitened[inside], expected)
    return np.asarray(models.whitened[out] - base[out] @ (about.inverse @ about.along))
