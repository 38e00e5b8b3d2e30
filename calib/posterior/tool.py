"""The tool over the workspace: what parameters and effects do to it, in three frames.

The error of the tool is linear in parameters and sizes, so every mean square over the workspace is
a quadratic form of them. A frame that is set anyway is projected out: touched off, a shift is free;
aligned, a small turn too; the machine's own is used as it is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import islice
from typing import Literal

import numpy as np

from calib.arrays import LEG_NAMES, FloatArray, without
from calib.posterior.cells import BASE
from calib.tripod.effects.candidates import tool_columns
from calib.tripod.effects.drives import AxisLean, AxisOffset, Backlash
from calib.tripod.effects.effect import Placed
from calib.tripod.geometry import Geometry
from calib.tripod.workspace import tool_jacobian_at, workspace_points

Frame = Literal["touched-off", "aligned", "machine"]
RIGID = 6
"""Shifts and turns of the machine as a whole."""

FRAMES: tuple[Frame, ...] = ("touched-off", "aligned", "machine")
FREE_IN: dict[Frame, int] = {"touched-off": 3, "aligned": RIGID, "machine": 0}
"""How many of these shifts and turns a frame takes up."""


@dataclass(frozen=True, eq=False)
class ToolField:
    """Derivatives of the tool by base parameters and effects at places, over the workspace.

    ``rows`` ``(2 n_points * 3, 6 + k + 6)``: half of the postures are reached with all carriages
    coming up, half down. The last columns are shifts, mm, and turns, rad, of the machine as a
    whole. ``columns`` are the numbers of those of each law at a place, mm per unit.
    """

    geometry: Geometry
    columns: dict[Placed, list[int]]
    rows: FloatArray

    @cached_property
    def metrics(self) -> dict[Frame, FloatArray]:
        """Mean squares ``(6 + k, 6 + k)`` over the workspace in each frame, mm² per unit²."""
        count = len(self.rows) // 3
        return {
            frame: np.asarray(rows.T @ rows / count)
            for frame in FRAMES
            for rows in (without(np.linalg.qr(self._free(frame))[0], self.rows),)
        }

    def _free(self, frame: Frame) -> FloatArray:
        """Columns ``(n, 0, 3 or 6)`` of shifts and turns that a frame takes up."""
        return self.rows[:, -RIGID:][:, : FREE_IN[frame]]

    def rows_at(self, points_mm: FloatArray, frame: Frame) -> FloatArray:
        """Derivatives ``(2, n_points, 3, f)`` at other places, ways up and down.

        Less what the frame takes up over the workspace.
        """
        rows, free = _rows_at(self.geometry, tuple(self.columns), points_mm), self._free(frame)
        free_parts = np.linalg.pinv(free) @ self.rows
        return np.asarray(rows - rows[..., -RIGID:][..., : FREE_IN[frame]] @ free_parts)


@lru_cache(maxsize=8)
def tool_field(geometry: Geometry, placed_laws: tuple[Placed, ...]) -> ToolField:
    """The field of the nominal machine."""
    rows = _rows_at(geometry, placed_laws, workspace_points(geometry))
    numbers = iter(range(BASE, rows.shape[-1]))
    columns = {law: [*islice(numbers, len(law[0].parameters))] for law in placed_laws}
    return ToolField(geometry, columns, rows.reshape(-1, rows.shape[-1]))


def _rows_at(
    geometry: Geometry, placed_laws: tuple[Placed, ...], points_mm: FloatArray
) -> FloatArray:
    """Derivatives ``(2, n_points, 3, f)`` at these places, ways up and down."""
    base = tool_jacobian_at(geometry, points_mm)
    rigid = np.zeros((len(points_mm), 3, RIGID))
    rigid[:, :, :3] = np.eye(3)
    for k in range(3):
        rigid[:, :, 3 + k] = np.cross(np.eye(3)[k], points_mm)
    ways = (tool_columns(geometry, points_mm, placed_laws, way) for way in (1.0, -1.0))
    return np.stack([np.concatenate([base, laws, rigid], axis=2) for laws in ways])


def laws_held(geometry: Geometry) -> list[Placed]:
    """What controllers can hold beside the laws of the library, at every place."""
    across = tuple(geometry.across)
    return [
        *((Backlash(), place) for place in LEG_NAMES),
        *((law, place) for law in (AxisOffset(across), AxisLean(across)) for place in across),
    ]


def mean_square(metric: FloatArray, values: Sequence[float] | FloatArray) -> float:
    """Mean square at the tool of these values ``(6 + k,)``."""
    return max(float(np.asarray(values) @ metric @ np.asarray(values)), 0.0)  # but for rounding


def days_in_tolerance(
    field: ToolField,
    frame: Frame,
    drift_mm: Sequence[float],
    bound_mm: float,
    tolerance_mm: float,
) -> float:
    """How many days what the tool is off by at most stays in tolerance; 0 where it is not now.

    ``drift_mm`` are joints x, y, z per day; the bound grows by no more than their r.m.s. error at
    the tool in the frame. Infinite without drift.
    """
    metric = field.metrics[frame]
    error_mm = np.zeros(len(metric))
    error_mm[: len(drift_mm)] = drift_mm
    growth_mm = math.sqrt(mean_square(metric, error_mm))
    left_mm = max(0.0, tolerance_mm - bound_mm)
    return left_mm / growth_mm if growth_mm else math.inf
