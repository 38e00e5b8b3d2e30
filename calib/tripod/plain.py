"""The pipeline without effects, written out with its derivatives, for many machines at once.

`calib.tripod.pipeline` stays the one forward simulation; these are its closed forms where no
effect acts, and tests hold them together: one for any tripod, and the faster one of papers/000
where its equations hold. The last axis ``b`` of arrays handed over counts machines.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from calib.arrays import TOOL, Conditions, FloatArray, IntArray
from calib.tripod.geometry import Geometry, inverse, tool_jacobians, trilaterate
from calib.tripod.pipeline import command, measuring_directions, zero_rows


class PlainDesign(Protocol):
    """The readings of a session as functions of the parameters of many machines."""

    def readings(self, parameters_mm: FloatArray) -> FloatArray:
        """Readings ``(n_readings, b)`` in mm for parameters ``(6, b)`` in mm, NaN out of reach."""

    def readings_and_derivatives(self, parameters_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Readings ``(n_readings, b)`` and their derivatives ``(6, n_readings, b)``, mm per mm.

        Complex numbers pass, for second derivatives.
        """


def plain_design(geometry: Geometry, conditions: Conditions) -> PlainDesign:
    """The design of these readings. Raises UnreachablePosture."""
    if geometry.of_papers and TOOL not in conditions.leg and not conditions.over_plane.any():
        return PapersDesign.of(geometry, conditions)
    return TripodDesign.of(geometry, conditions)


@dataclass(frozen=True, eq=False)
class TripodDesign:
    """Any tripod. ``command_mm`` ``(n + z, 3)``, the last rows Zero; the others ``(n, ...)``.

    ``zero`` tells the Zero row of each reading, or the one for all. ``along`` and ``measured`` are
    the directions of the touched leg and of the indicator, ``joint_mm`` leads from the tool to the
    end of the touched bar.
    """

    geometry: Geometry
    taken: Conditions
    command_mm: FloatArray
    zero: IntArray
    along: FloatArray
    measured: FloatArray
    joint_mm: FloatArray

    @classmethod
    def of(cls, geometry: Geometry, conditions: Conditions) -> TripodDesign:
        """The design of these readings. Raises UnreachablePosture."""
        of_tool = (conditions.leg == TOOL)[:, None]
        return cls(
            geometry,
            conditions,
            np.vstack([command(geometry, conditions), inverse(geometry, geometry.leg_zero_mm)]),
            zero_rows(geometry, conditions),
            geometry.directions[conditions.leg],
            measuring_directions(geometry, conditions),
            np.where(of_tool, 0.0, geometry.platform[conditions.leg]),
        )

    def readings(self, parameters_mm: FloatArray) -> FloatArray:
        """See `PlainDesign`."""
        return self._touched(*self._postures(parameters_mm)[:2])[0].T

    def readings_and_derivatives(self, parameters_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See `PlainDesign`."""
        carriage, tool, lengths = self._postures(parameters_mm)
        value, fraction, reach = self._touched(carriage, tool)
        by_tool = np.concatenate(tool_jacobians(self.geometry, tool, carriage, lengths), axis=-1)
        legs, n = self.taken.leg, len(self.taken)
        by_foot = np.zeros((*tool.shape, 6), dtype=tool.dtype)[:, :n]
        of_leg = np.flatnonzero(legs != TOOL)
        by_foot[:, of_leg, :, legs[of_leg]] = self.along[of_leg, None, :]
        here, zero = by_tool[:, :n], by_tool[:, self.zero]
        along, measured = self.along[:, :, None], self.measured[:, :, None]
        station = self.taken.station[:, None]
        end_along, foot_along = (here * along).sum(axis=-2), (by_foot * along).sum(axis=-2)
        point_along = (zero * along).sum(axis=-2) * (1.0 - station) + station * foot_along
        part = fraction[..., None]
        slide = (point_along - end_along - part * (foot_along - end_along)) / reach[..., None]
        bar = self._bar(carriage, tool)
        over = self.taken.over_plane
        slide = np.where(((legs == TOOL) | over)[:, None], 0.0, slide)
        moved = here + part[..., None] * (by_foot - here) + slide[..., None, :] * bar[..., None]
        start = np.where(over[:, None, None], 0.0, zero + station[..., None] * (by_foot - zero))
        gradient = ((moved - start) * measured).sum(axis=-2)
        return value.T, np.moveaxis(gradient, (0, 1, 2), (2, 1, 0))

    def _postures(
        self, parameters_mm: NDArray[Any]
    ) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Carriages and tools ``(b, n + z, 3)``, lengths ``(b, 1, 3)``, mm."""
        carriage = self.command_mm + parameters_mm[:3].T[:, None, :]
        lengths = self.geometry.lengths + parameters_mm[3:].T[:, None, :]
        feet = self.geometry.anchors + self.geometry.directions * carriage[..., None]
        with np.errstate(invalid="ignore", divide="ignore"):
            tool = trilaterate(feet, lengths, self.geometry.side, refuse=False)
        return carriage, tool, lengths

    def _touched(
        self, carriage: NDArray[Any], tool: NDArray[Any]
    ) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Readings, touched fraction of the bar and the bar's length along the leg ``(b, n)``."""
        station = np.where(self.taken.leg == TOOL, 0.0, self.taken.station)
        end = tool[:, : len(self.taken)] + self.joint_mm
        zero = tool[:, self.zero] + self.joint_mm
        bar, bar_zero = self._bar(carriage, tool), self._foot(carriage[:, self.zero]) - zero
        reach = (bar * self.along).sum(axis=-1)
        point_along = ((zero + station[:, None] * bar_zero - end) * self.along).sum(axis=-1)
        over = self.taken.over_plane
        fraction = np.where(
            self.taken.leg == TOOL, 0.0, np.where(over, station, point_along / reach)
        )
        start = np.where(over[:, None], 0.0, zero + station[:, None] * bar_zero)
        moved = end - start + fraction[..., None] * bar
        return (moved * self.measured).sum(axis=-1), fraction, reach

    def _bar(self, carriage: NDArray[Any], tool: NDArray[Any]) -> NDArray[Any]:
        """Ways ``(b, n, 3)`` from the end of the touched bar to its foot."""
        n = len(self.taken)
        return np.asarray(self._foot(carriage[:, :n]) - tool[:, :n] - self.joint_mm)

    def _foot(self, carriage: NDArray[Any]) -> NDArray[Any]:
        """Foot of the touched leg ``(b, n, 3)``."""
        foot_of_leg = np.take_along_axis(
            np.broadcast_to(carriage, (len(carriage), len(self.taken), 3)),
            np.broadcast_to(self.taken.leg[:, None] % 3, (len(carriage), len(self.taken), 1)),
            axis=-1,
        )
        return np.asarray(self.geometry.origins[self.taken.leg] + foot_of_leg * self.along)


@dataclass(frozen=True, eq=False)
class PapersDesign:
    """The Orthoglide of papers/000. Its postures each once; the last posture is Zero.

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
    def of(cls, geometry: Geometry, conditions: Conditions) -> PapersDesign:
        """The design of these readings. Raises UnreachablePosture."""
        commands = np.vstack([command(geometry, conditions), geometry.zero_mm])
        postures, index = np.unique(commands, axis=0, return_inverse=True)
        index = index.ravel()
        count = len(postures)
        return cls(
            geometry=geometry,
            command_mm=np.ascontiguousarray(postures.T[:, :, None]),
            leg=conditions.leg,
            axis=conditions.axis,
            along=conditions.leg * count + index[:-1],
            across=conditions.axis * count + index[:-1],
            zero_along=conditions.leg * count + index[-1],
            zero_across=conditions.axis * count + index[-1],
            weight=(1.0 - conditions.station)[:, None],
        )

    def readings(self, parameters_mm: FloatArray) -> FloatArray:
        """See `PlainDesign`."""
        carriage, tool, _ = self._tool(parameters_mm)
        return self._readings(carriage, tool)[0]

    def readings_and_derivatives(self, parameters_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See `PlainDesign`."""
        carriage, tool, inverse = self._tool(parameters_mm)
        value, lever, reach, tool_across = self._readings(carriage, tool)
        # derivatives of the tool (6, 3, n_postures, b); papers/000 (5) to (9). Row l of the matrix
        # of (5) is p - q_l e_l: a diagonal and one column, so its inverse is written down
        # (Sherman and Morrison)
        turn = tool * inverse
        turn /= 1.0 - turn.sum(axis=0)
        gain = -inverse[None] * turn[:, None]
        index = np.arange(3)
        gain[index, index] -= inverse
        lengths = (self.geometry.lengths[:, None] + parameters_mm[3:])[:, None, None, :]
        by_tool = np.concatenate([(tool - carriage)[:, None] * gain, lengths * gain])
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

        With ``e_i = q_i^2 - L_i^2`` equation (4) of papers/000 reads ``p_i = (e_i + T) / (2 q_i)``,
        ``T = |p|^2``, and T solves ``a T^2 + 2 b T + c = 0`` with ``a = sum 1/q_i^2``,
        ``b = sum e_i/q_i^2 - 2``, ``c = sum e_i^2/q_i^2``. The assembled machine is the minus root
        (the paper prints the plus root, see docs/papers-line-by-line.md); b < 0 there, so nothing
        cancels.
        """
        carriage = self.command_mm + parameters_mm[:3, None, :]
        inverse = 1.0 / carriage
        excess = carriage * carriage
        excess -= ((self.geometry.lengths[:, None] + parameters_mm[3:]) ** 2)[:, None, :]
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
