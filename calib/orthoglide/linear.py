"""System (11) of papers/000, for any leg length, displacement and touching station."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from calib.observations import TOOL, Conditions, FloatArray
from calib.orthoglide.geometry import PARAMETER_NAMES, Geometry
from calib.orthoglide.pipeline import derivatives


def coefficients(
    geometry: Geometry, displacement_mm: ArrayLike, station: ArrayLike = 0.5
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Coefficients a, b, c of papers/000 equation (11); shapes broadcast, no unit.

    ``sin(alpha) = displacement / L``. The paper touches the middle of the leg, station 0.5; for a
    station s the weight of the tool end is ``w = 1 - s`` in place of 0.5.
    """
    sine = np.asarray(displacement_mm, dtype=np.float64) / geometry.leg_length_mm[0]
    cosine = np.sqrt(1.0 - sine**2)
    weight = 1.0 - np.asarray(station, dtype=np.float64)
    a = sine
    b = (weight + sine) * sine / cosine
    c = (weight + sine) / cosine - weight
    return a, b, c


def reading_matrix(geometry: Geometry, taken: Conditions) -> FloatArray:
    """Derivatives of the readings by d_rho and d_L at the nominal machine, ``(n_readings, 6)``.

    A reading along axis j on leg i: ``b d_rho_i + a d_rho_j - b d_L_i - c d_L_j``. A row at Zero
    is zero; a difference of readings is the difference of rows, so system (11) is
    ``Differences.combine @ reading_matrix``. First order: the exact model departs from it by
    several micrometres at offsets of 2 mm. Other tripods and readings of the tool have no such
    form: there it is the derivative of the pipeline.
    """
    if not geometry.of_papers or TOOL in taken.leg:
        return derivatives(geometry, np.zeros(len(PARAMETER_NAMES)), taken)
    a, b, c = coefficients(geometry, taken.displacement_mm, taken.station)
    rows = np.arange(len(taken))
    matrix = np.zeros((len(taken), 6))
    matrix[rows, taken.leg] = b
    matrix[rows, taken.axis] = a
    matrix[rows, 3 + taken.leg] = -b
    matrix[rows, 3 + taken.axis] = -c
    return matrix
