"""The pipeline without effects, written out with its derivatives, for many machines at once.

`calib.orthoglide.pipeline` stays the one forward simulation; this is its closed form where no
effect acts, and tests hold the two together. The last axis ``b`` of every array counts machines.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.observations import Conditions, FloatArray, IntArray
from calib.orthoglide.geometry import Geometry
from calib.orthoglide.pipeline import command


@dataclass(frozen=True, eq=False)
class PlainDesign:
    """The postures of some readings, each once; the last posture is Zero.

    ``command_mm`` ``(3, n_postures, 1)``; ``tool_along`` and ``tool_across`` ``(n_readings,)`` are
    places of a reading's leg and axis coordinate in a flat ``(3 * n_postures)`` array, the ``zero``
    ones those at Zero.
    """

    geometry: Geometry
    command_mm: FloatArray
    leg: IntArray
    axis: IntArray
    along: IntArray
    across: IntArray
    zero_along: IntArray
    zero_across: IntArray
    weight: FloatArray

    @classmethod
    def of(cls, geometry: Geometry, taken: Conditions) -> PlainDesign:
        """The design of these readings. Raises UnreachablePosture."""
        commands = np.vstack([command(geometry, taken), np.full((1, 3), geometry.leg_length_mm)])
        postures, index = np.unique(commands, axis=0, return_inverse=True)
        index = index.ravel()
        count = len(postures)
        return cls(
            geometry=geometry,
            command_mm=np.ascontiguousarray(postures.T[:, :, None]),
            leg=taken.leg,
            axis=taken.axis,
            along=taken.leg * count + index[:-1],
            across=taken.axis * count + index[:-1],
            zero_along=taken.leg * count + index[-1],
            zero_across=taken.axis * count + index[-1],
            weight=(1.0 - taken.station)[:, None],
        )

    def readings(self, parameters_mm: FloatArray) -> FloatArray:
        """Readings ``(n_readings, b)`` in mm for parameters ``(6, b)`` in mm, NaN out of reach."""
        carriage, tool, _ = self._tool(parameters_mm)
        return self._readings(carriage, tool)[0]

    def readings_and_derivatives(self, parameters_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Readings ``(n_readings, b)`` and their derivatives ``(6, n_readings, b)``, mm per mm."""
        carriage, tool, inverse = self._tool(parameters_mm)
        value, lever, reach, tool_across = self._readings(carriage, tool)
        by_tool = self._tool_derivatives(parameters_mm, carriage, tool, inverse)
        flat = by_tool.reshape(6, -1, by_tool.shape[-1])
        share = lever / reach
        slope = tool_across / reach
        weight = self.weight
        rows = np.arange(len(self.leg))
        gradient = share * flat[:, self.across] - weight * flat[:, self.zero_across]
        gradient += slope * (share * flat[:, self.along] - weight * flat[:, self.zero_along])
        gradient[self.leg, rows] += slope * (weight - share)
        return value, gradient

    def _tool(self, parameters_mm: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Carriages, tool positions and 1/carriage, ``(3, n_postures, b)`` each.

        Equation (4) of papers/000 in the form of `calib.orthoglide.kinematics.direct`.
        """
        carriage = self.command_mm + parameters_mm[:3, None, :]
        inverse = 1.0 / carriage
        excess = carriage * carriage
        excess -= ((self.geometry.leg_length_mm + parameters_mm[3:]) ** 2)[:, None, :]
        ratio = excess * inverse
        a = (inverse * inverse).sum(axis=0)
        b = (ratio * inverse).sum(axis=0) - 2.0
        c = (ratio * ratio).sum(axis=0)
        square = c / (np.sqrt(b * b - a * c) - b)
        return carriage, 0.5 * (ratio + square * inverse), inverse

    def _readings(
        self, carriage: FloatArray, tool: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Readings, lever from the touched point to the foot, length along the leg, height."""
        machines = tool.shape[-1]
        flat_tool, flat_carriage = tool.reshape(-1, machines), carriage.reshape(-1, machines)
        foot = flat_carriage[self.along]
        tool_across = flat_tool[self.across]
        foot_zero, tool_zero = flat_carriage[self.zero_along], flat_tool[self.zero_along]
        lever = foot - foot_zero + self.weight * (foot_zero - tool_zero)
        reach = foot - flat_tool[self.along]
        value = tool_across * lever / reach - self.weight * flat_tool[self.zero_across]
        return value, lever, reach, tool_across

    def _tool_derivatives(
        self,
        parameters_mm: FloatArray,
        carriage: FloatArray,
        tool: FloatArray,
        inverse: FloatArray,
    ) -> FloatArray:
        """Derivatives of the tool ``(6, 3, n_postures, b)``; papers/000 (5) to (9).

        Row l of the matrix of (5) is ``p - q_l e_l``: a diagonal and one column, so its inverse is
        written down (Sherman and Morrison).
        """
        turn = tool * inverse
        turn /= 1.0 - turn.sum(axis=0)
        gain = -inverse[None] * turn[:, None]
        index = np.arange(3)
        gain[index, index] -= inverse
        lengths = (self.geometry.leg_length_mm + parameters_mm[3:])[:, None, None, :]
        return np.concatenate([(tool - carriage)[:, None] * gain, lengths * gain])
