"""Configurations of printers written from the documented formulas, with contacts of a true machine.

The machine and its firmware are those of the exports' tests, which share nothing with the program:
`Hidden.tool` finds where three spheres meet, `BELIEVED` how far below its switch a carriage goes.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from tests.app.exports.test_towers import (
    ANGLES,
    BAR,
    BELIEVED,
    ENDSTOPS,
    RADIUS,
    FloatArray,
    Hidden,
)
from tests.blind.linear_delta import places

STEP_MM = 0.0125
MOTOR = "rotation_distance: 40\nmicrosteps: 16\n"
PRINTER = f"""\
[mcu]
serial: /dev/somewhere
[printer]
kinematics: delta
max_velocity: 300
delta_radius: {RADIUS}  # measured
print_radius: 100
"""
OLD_ARM = 249.0
"""What stands above the saved block, which wins."""


@cache
def touched_at(hidden: Hidden, x: float, y: float, height_mm: float = 0.0) -> FloatArray:
    """Where the firmware believes to be as the tool is so high over the plate: by bisection."""
    low, high = -8.0, 8.0
    for _ in range(50):
        middle = (low + high) / 2.0
        place = np.array([x, y, height_mm + middle])
        above = hidden.tool(BELIEVED(place))[2] > height_mm
        low, high = (low, middle) if above else (middle, high)
    return np.array([x, y, height_mm + (low + high) / 2.0])


def rings(count: int = 19) -> list[tuple[float, float]]:
    """Places across the plate, the middle first."""
    return [(float(place[0]), float(place[1])) for _, place in places(1)[:count]]


def stable(hidden: Hidden, x: float, y: float, height_mm: float = 0.0) -> list[float]:
    """Steps below the switches, whole ones as motors make them, in that contact."""
    steps = BELIEVED(touched_at(hidden, x, y, height_mm)) / STEP_MM
    return [float(round(step)) for step in steps]


def steppers(arm_mm: float = BAR, motor: str = MOTOR) -> str:
    return "".join(
        f"[stepper_{name}]\n{motor}position_endstop: {stop}\narm_length: {arm_mm}\nangle: {angle}\n"
        for name, stop, angle in zip("abc", ENDSTOPS, ANGLES.tolist(), strict=True)
    )


PERFECT = Hidden()
NOW = f"[printer]\nkinematics: delta\ndelta_radius: {RADIUS}\n" + steppers(motor="")
"""What the controller holds, for whoever reads the formulas from a configuration."""

SAVED_HEAD = """
#*# <---------------------- SAVE_CONFIG ---------------------->
#*# DO NOT EDIT THIS BLOCK OR BELOW. The contents are auto-generated.
#*#
"""


def saved(lines: Sequence[str]) -> str:
    return SAVED_HEAD + "".join(f"#*# {line}".rstrip() + "\n" for line in lines)


def height_lines(hidden: Hidden, count: int = 19) -> list[str]:
    lines = ["[delta_calibrate]"]
    for number, (x, y) in enumerate(rings(count)):
        steps = ",".join(f"{step:.3f}" for step in stable(hidden, x, y))
        lines += [f"height{number} = 0.0", f"height{number}_pos = {steps}"]
    return lines


def arms_saved(arm_mm: float = BAR) -> list[str]:
    return [line for name in "abc" for line in (f"[stepper_{name}]", f"arm_length = {arm_mm:.6f}")]


def printer_cfg(hidden: Hidden, count: int = 19, more: Sequence[str] = ()) -> str:
    """A ``printer.cfg`` with arms that the saved block replaces, and its heights."""
    block = [*arms_saved(), *height_lines(hidden, count), *more]
    return PRINTER + steppers(OLD_ARM) + "[delta_calibrate]\nradius: 80\n" + saved(block)
