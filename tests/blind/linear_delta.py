"""A linear delta of its own for the blind bench: written from its geometry, sharing nothing.

Upright towers around the middle, bars from carriages to an effector that stays level. What an
indicator at the tool shows against a flat plate, with hidden effects under the names that the
program gives them. Lengths mm, angles rad, times s.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Three = tuple[float, float, float]

BAR, RADIUS = 250.0, 157.0 - 33.0
ANGLES = np.radians([210.0, 330.0, 90.0])
OUTWARD = np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1)
SECONDS = 12.0
NONE: Three = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Hidden:
    """What the controller does not know, for towers X, Y, Z."""

    offset_mm: Three = NONE
    length_mm: Three = NONE
    scale: Three = NONE  # mm/mm of travel from Zero
    lost_mm: Three = NONE  # the carriage stays up by so much after going down
    out_mm: Three = NONE  # the tower is further from the middle
    lean_xy: float = 0.0  # rad, towers X and Y together, half each
    drift_mm_s: float = 0.0
    gain: float = 0.0


def commanded(place: FloatArray) -> FloatArray:
    """Heights of the carriages ``(3,)`` that a perfect machine would need."""
    across = ((place[:2] - RADIUS * OUTWARD) ** 2).sum(axis=1)
    return np.asarray(place[2] + np.sqrt(BAR**2 - across))


def tool(hidden: Hidden, place: FloatArray, moved: FloatArray) -> FloatArray:
    """Where the tool is: Newton's method on the three bars, from where it should be."""
    command = commanded(place)
    travel = command - commanded(np.zeros(3))
    height = command + hidden.offset_mm + np.array(hidden.scale) * travel
    height = height + np.array(hidden.lost_mm) * (moved < 0)
    foot = np.column_stack([(RADIUS + np.array(hidden.out_mm))[:, None] * OUTWARD, height])
    apart = OUTWARD[1] - OUTWARD[0]
    lean = hidden.lean_xy / 2.0 * apart / np.linalg.norm(apart)
    foot[0, :2] += lean * height[0]
    foot[1, :2] -= lean * height[1]
    position = place.copy()
    for _ in range(20):
        bars = position - foot
        residual = (bars**2).sum(axis=1) - (BAR + np.array(hidden.length_mm)) ** 2
        position = position - np.linalg.solve(2.0 * bars, residual)
    return position


def places(cycles: int = 3, heights: tuple[float, ...] = (0.0,)) -> list[tuple[int, FloatArray]]:
    """Cycle and place: the middle and three rings in each cycle, the middle at the end."""
    one_cycle = [np.array([0.0, 0.0, h]) for h in heights]
    for height in heights:
        for radius in (30.0, 55.0, 80.0):
            for k in range(6):
                angle = math.tau * (0.25 + k / 6.0)
                x, y = radius * math.cos(angle), radius * math.sin(angle)
                one_cycle.append(np.array([round(x, 3) + 0.0, round(y, 3) + 0.0, height]))
    visits = [(cycle, place) for cycle in range(1, cycles + 1) for place in one_cycle]
    return [*visits, (cycles, np.zeros(3))]


def table(hidden: Hidden, seed: int, scatter_mm: float = 0.002) -> str:
    """A table to import, as a display with steps of 1 µm shows it."""
    generator = np.random.default_rng(seed)
    zero = float(generator.normal(scale=0.3)) - tool(hidden, np.zeros(3), np.zeros(3))[2]
    lines, moved, before = ["x_mm,y_mm,z_mm,value_mm,cycle,time_s"], np.zeros(3), None
    for number, (cycle, place) in enumerate(places()):
        if before is not None:
            step = commanded(place) - before
            moved = np.where(np.abs(step) > 1e-6, np.sign(step), moved)
        before = commanded(place)
        reading = (tool(hidden, place, moved)[2] + zero) * (1.0 + hidden.gain)
        reading += hidden.drift_mm_s * SECONDS * number + generator.normal(scale=scatter_mm)
        x, y, z = place
        lines.append(f"{x:.3f},{y:.3f},{z:.3f},{reading:.3f},{cycle},{SECONDS * number:.1f}")
    return "\n".join(lines) + "\n"


def touched(hidden: Hidden, across: FloatArray, height_mm: float = 0.0) -> FloatArray:
    """Where the controller is, over ``(2,)``, as the tool is so high, mm: to rounding.

    Sent a millimetre lower the tool goes lower by that but for some thousandths.
    """
    place, down = np.array([*across, height_mm]), -np.ones(3)
    for _ in range(8):
        place[2] -= tool(hidden, place, down)[2] - height_mm
    assert abs(tool(hidden, place, down)[2] - height_mm) < 1e-9
    return place


def contacts(
    hidden: Hidden, seed: int, scatter_mm: float = 0.005, decimals: int = 4, cycles: int = 3
) -> str:
    """A table of contacts with the plate: where the controller was as the tool met it."""
    generator = np.random.default_rng(seed)
    lines = ["x_mm,y_mm,z_mm,height_mm,cycle"]
    heights = {place[:2].tobytes(): touched(hidden, place[:2]) for _, place in places(1)}
    for cycle, place in places(cycles):
        x, y, z = heights[place[:2].tobytes()]
        z += generator.normal(scale=scatter_mm)
        lines.append(f"{x:.3f},{y:.3f},{z:.{decimals}f},0,{cycle}")
    return "\n".join(lines) + "\n"
