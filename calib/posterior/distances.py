"""Distances between two marks, as a person measured them: a printed object, a gauge block.

They are the one measure from outside. Readings, and contacts still more, leave the common size of
joint offsets and bars nearly free: bars that are all longer, and switches that all trip as much
higher, move the tool up and down hardly otherwise, but make whatever it draws larger.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.arrays import Conditions, FloatArray, tool_conditions
from calib.tripod.effects.candidates import placed_columns
from calib.tripod.effects.effect import Placed
from calib.tripod.pipeline import COMPLEX_STEP_MM, MOVES_THE_TOOL, Model, simulate


@dataclass(frozen=True, eq=False)
class Distances:
    """Each ``value_mm`` ``(n,)`` was measured from one mark to another.

    The tool had been sent to ``first_mm`` and ``second_mm`` ``(n, 3)`` from Zero; the standard
    deviation ``(n,)`` is that of marking and measuring together. No zero is free.
    """

    first_mm: FloatArray
    second_mm: FloatArray
    value_mm: FloatArray
    deviation_mm: FloatArray

    @classmethod
    def none(cls) -> Distances:
        """Nothing measured."""
        return cls(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0))

    def __len__(self) -> int:
        return len(self.value_mm)

    @cached_property
    def _marks(self) -> tuple[Conditions, ...]:
        """The tool at all first and then at all second marks, along each coordinate.

        Nobody saw how it came to them: down, as to a plate. Were the play of drives that contacts
        always take up one way not taken up here, it would explain any wrong distance.
        """
        places = np.vstack([self.first_mm, self.second_mm])
        down = -np.ones_like(places)
        return tuple(replace(tool_conditions(places, axis), movement=down) for axis in range(3))

    def expected_mm(self, model: Model) -> FloatArray:
        """How far the marks ``(n,)`` of a machine are apart. Raises UnreachablePosture."""
        return np.asarray(_length(self._apart(model, np.array(model.parameters_mm))))

    def residual(self, model: Model) -> FloatArray:
        """Measured less expected ``(n,)``, in standard deviations."""
        return np.asarray((self.value_mm - self.expected_mm(model)) / self.deviation_mm)

    def by_base(self, model: Model) -> FloatArray:
        """Derivatives ``(n, 6)`` by the parameters, in standard deviations per mm."""
        stepped = np.array(model.parameters_mm) + 1j * COMPLEX_STEP_MM * np.eye(6)
        derivatives = _length(self._apart(model, stepped)).imag.T / COMPLEX_STEP_MM
        return np.asarray(derivatives / self.deviation_mm[:, None])

    def by_laws(self, model: Model, laws: Iterable[Placed]) -> dict[Placed, FloatArray]:
        """Derivatives ``(n, k)`` by the values of laws at places that move the tool."""
        moving = {law for law in laws if law[0].stage in MOVES_THE_TOOL}
        effects = list(dict.fromkeys(effect for effect, _ in moving))
        apart = self._apart(model, np.array(model.parameters_mm))
        weight = apart / _length(apart)[:, None] / self.deviation_mm[:, None]
        n = len(self)
        columns: dict[Placed, FloatArray] = {}
        for axis, marks in enumerate(self._marks):
            for law, tool in placed_columns(_moving(model), marks, effects, moving).items():
                part = weight[:, axis, None] * (tool[n:] - tool[:n])
                columns[law] = columns.get(law, 0.0) + part
        return columns

    def _apart(self, model: Model, parameters_mm: NDArray[Any]) -> NDArray[Any]:
        """Ways from the first to the second mark ``(..., n, 3)`` for parameters ``(..., 6)``."""
        effects, n = _moving(model).effects, len(self)
        along = [simulate(model.geometry, parameters_mm, t, effects) for t in self._marks]
        tool = np.stack(along, axis=-1)
        return np.asarray(tool[..., n:, :] - tool[..., :n, :])


def _moving(model: Model) -> Model:
    """The model with those effects alone that move the tool: nothing is read."""
    return model.with_effects(
        tuple(effect for effect in model.effects if effect.stage in MOVES_THE_TOOL)
    )


def _length(ways: NDArray[Any]) -> NDArray[Any]:
    """Lengths of ways ``(..., 3)``; complex numbers pass."""
    return np.asarray(np.sqrt((ways * ways).sum(axis=-1)))
