"""The Orthoglide's side of `calib.identifiability`: its parameters, readings and tool."""

from __future__ import annotations

import numpy as np

from calib.fit import without_zeros
from calib.identifiability import Sensitivity
from calib.observations import FloatArray, Observations
from calib.orthoglide.geometry import PARAMETER_NAMES, TOLERANCE_MM, Geometry
from calib.orthoglide.workspace import workspace_jacobian


def sensitivity_of_readings(
    geometry: Geometry,
    observed: Observations,
    weight: FloatArray,
    design: FloatArray,
    free: tuple[int, ...],
    *,
    noise_known: bool,
) -> Sensitivity:
    """Readings with a free zero for each mounting; ``design`` ``(n_readings, k)``.

    ``weight`` ``(n_readings,)`` in 1/mm² holds the noise, or none where it is not known.
    """
    jacobian = np.sqrt(weight)[:, None] * without_zeros(observed, weight, design)
    tool = workspace_jacobian(geometry)[:, :, list(free)]
    return Sensitivity(
        names=tuple(PARAMETER_NAMES[k] for k in free),
        units=("mm",) * len(free),
        jacobian=jacobian,
        tolerance=np.full(len(free), TOLERANCE_MM),
        cost=tool.reshape(-1, len(free)),
        points=len(tool),
        noise_known=noise_known,
    )
