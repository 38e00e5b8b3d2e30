"""The model of one machine: an immutable value."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.errors import CalibrationError
from calib.observations import Conditions, FloatArray
from calib.orthoglide.geometry import PARAMETER_NAMES, Geometry
from calib.orthoglide.pipeline import Effect, simulate


@dataclass(frozen=True)
class Model:
    """Nominal geometry, identified parameters (mm, order of `PARAMETER_NAMES`) and effects."""

    geometry: Geometry = Geometry()
    parameters_mm: tuple[float, ...] = (0.0,) * len(PARAMETER_NAMES)
    effects: tuple[Effect, ...] = ()

    def __post_init__(self) -> None:
        if len(self.parameters_mm) != len(PARAMETER_NAMES) or not np.all(
            np.isfinite(self.parameters_mm)
        ):
            raise CalibrationError(
                "parameters of the model",
                str(self.parameters_mm),
                f"{len(PARAMETER_NAMES)} finite numbers: {', '.join(PARAMETER_NAMES)}",
            )

    def readings(self, taken: Conditions) -> FloatArray:
        """Simulated readings ``(n_readings,)`` in mm, without the zeros of the mountings."""
        return np.asarray(simulate(self.geometry, self.parameters_mm, taken, self.effects))

    def with_effects(self, effects: tuple[Effect, ...]) -> Model:
        """The same model with other effects."""
        return replace(self, effects=effects)

    def with_parameters(self, parameters_mm: FloatArray) -> Model:
        """The same model with other parameters ``(6,)``, mm."""
        return replace(self, parameters_mm=tuple(float(v) for v in parameters_mm))
