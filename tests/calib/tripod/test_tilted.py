"""Legs of drives that are not square, against bars and lines solved in the test."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq, fsolve

from calib.arrays import FloatArray, conditions
from calib.tripod.geometry import Geometry
from calib.tripod.pipeline import simulate
from tests.tripods import TRIPODS

PARAMETERS_MM = np.array([0.8, -0.5, 0.6, 0.09, -0.07, 0.05])


def tool_at(geometry: Geometry, joints_mm: FloatArray, wanted_mm: FloatArray) -> FloatArray:
    """Where bars of their true lengths meet, by the solver of scipy."""
    lengths = np.array(geometry.leg_length_mm) + PARAMETERS_MM[3:]

    def left(tool_mm: FloatArray) -> list[float]:
        return [
            float(np.linalg.norm(tool_mm + end - at - along * np.array(way)) - length)
            for end, at, way, along, length in zip(
                np.array(geometry.platform_mm),
                np.array(geometry.origin_mm),
                geometry.direction,
                joints_mm,
                lengths,
                strict=True,
            )
        ]

    return np.asarray(fsolve(left, wanted_mm, xtol=1e-13))


def joints_at(geometry: Geometry, tool_mm: FloatArray) -> FloatArray:
    """Where nominal carriages are, by bisection ahead of the platform."""
    tools = []
    for end, at, way, length in zip(
        np.array(geometry.platform_mm),
        np.array(geometry.origin_mm),
        np.array(geometry.direction),
        geometry.leg_length_mm,
        strict=True,
    ):
        nearest = float((tool_mm + end - at) @ way)

        def off(
            mm: float, end: FloatArray = end, at: FloatArray = at, way: FloatArray = way
        ) -> float:
            return float(np.linalg.norm(tool_mm + end - at - mm * way))

        tools.append(
            brentq(lambda mm, length=length: off(mm) - length, nearest, nearest + 2.0 * length)
        )
    return np.array(tools)


@pytest.mark.parametrize("name", [name for name, tripod in TRIPODS.items() if tripod.reads_legs])
def test_a_reading_is_where_the_bar_crosses_the_line_of_the_indicator(name: str) -> None:
    """Set up at Zero, square to the drive, in the plane of both; the tool goes along the drive.

    Where no Zero has all bars along their drives, it is on the drive's line, nearest to the middle;
    parallel drives lead across each other from line to line.
    """
    geometry, station = TRIPODS[name], 0.3
    for leg in range(3):
        way = np.array(geometry.direction[leg])
        lines = np.array(geometry.origin_mm) - np.array(geometry.platform_mm)
        start = 0.0 * way if geometry.common_zero else lines[leg] - (lines[leg] @ way) * way
        levels = (-80.0, -20.0, 30.0, 60.0) if geometry.common_zero else (10.0, 30.0, 60.0)

        def bar(
            level: float, leg: int = leg, start: FloatArray = start
        ) -> tuple[FloatArray, FloatArray]:
            target = start + level * np.array(geometry.direction[leg])
            joints = joints_at(geometry, target) + PARAMETERS_MM[:3]
            foot = np.array(geometry.origin_mm[leg]) + joints[leg] * np.array(
                geometry.direction[leg]
            )
            return tool_at(geometry, joints, target) + geometry.platform_mm[leg], foot

        tool_end, foot = bar(0.0)
        stands = tool_end + station * (foot - tool_end)
        for axis in {0, 1, 2} - {leg}:
            second = np.array(geometry.direction[axis])
            if np.linalg.norm(np.cross(way, second)) < 1e-9:
                second = np.subtract(geometry.origin_mm[axis], geometry.origin_mm[leg])
            across = np.cross(np.cross(way, second), way)
            across = across / np.linalg.norm(across)
            for level in levels:
                tool_end, foot = bar(level)
                share = ((stands - tool_end) @ way) / ((foot - tool_end) @ way)
                reading = float((tool_end + share * (foot - tool_end) - stands) @ across)
                plan = conditions([leg], [axis], [level], station=station)
                computed = simulate(geometry, PARAMETERS_MM, plan)[0]
                assert computed == pytest.approx(reading, abs=1e-9), (leg, axis, level)
