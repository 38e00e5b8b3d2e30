"""Configurations of printers written from the documented formulas, with contacts of a true machine.

The machine and its firmware are those of the exports' tests, which share nothing with the program:
`Hidden.tool` finds where three spheres meet, `BELIEVED` how far below its switch a carriage goes.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from tests.app.exports.upright_towers import (
    ANGLES,
    BAR,
    BELIEVED,
    ENDSTOPS,
    RADIUS,
    FloatArray,
    Hidden,
)
from tests.blind.linear_delta import places
from tests.conftest import ROOT

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
"""What stood there before the firmware saved another one, and made a comment of it."""


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


def superseded() -> str:
    """The steppers as SAVE_CONFIG leaves them above the block that holds their arms."""
    return steppers(OLD_ARM).replace("arm_length", "#arm_length")


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


def height_lines(hidden: Hidden, count: int = 19, height_mm: float = 0.0) -> list[str]:
    lines = ["[delta_calibrate]"]
    for number, (x, y) in enumerate(rings(count)):
        steps = ",".join(f"{step:.3f}" for step in stable(hidden, x, y, height_mm))
        lines += [f"height{number} = {height_mm}", f"height{number}_pos = {steps}"]
    return lines


def arms_saved(arm_mm: float = BAR) -> list[str]:
    return [line for name in "abc" for line in (f"[stepper_{name}]", f"arm_length = {arm_mm:.6f}")]


def printer_cfg(hidden: Hidden, count: int = 19, extra: Sequence[str] = ()) -> str:
    """A ``printer.cfg`` with arms that the saved block replaces, and its heights."""
    block = [*arms_saved(), *height_lines(hidden, count), *extra]
    return PRINTER + superseded() + "[delta_calibrate]\nradius: 80\n" + saved(block)


SAMPLE = ROOT / "sample_sessions" / "printer"
SAMPLE_HIDDEN = Hidden(
    switch_mm=(0.35, -0.25, 0.2), bar_mm=(0.3, -0.2, 0.1), out_mm=(0.0, 0.0, 0.6)
)
"""The printer of the five-minute page: switches, arms, and the foot of one tower are off."""

TRIGGER_MM = 2.5
PROBE = f"[probe]\npin: ^z:P1.24\nz_offset: {TRIGGER_MM}\nspeed: 5\n"


def sample_cfg() -> str:
    """As Klipper's own calibration left it: seven heights, each probed once."""
    block = [*arms_saved(), *height_lines(SAMPLE_HIDDEN, 7, TRIGGER_MM)]
    return PRINTER + PROBE + superseded() + "[delta_calibrate]\nradius: 50\n" + saved(block)


def sample_log() -> str:
    """What the printer answers to the macro of the page, with a scatter of 4 µm."""
    generator = np.random.default_rng(11)
    lines = ["> G28", "ok"]
    for _, place in places(3):
        x, y, z = touched_at(SAMPLE_HIDDEN, float(place[0]), float(place[1]), TRIGGER_MM)
        height_mm = z - TRIGGER_MM + generator.normal(scale=0.004)
        lines.append(f"// probe: at {x:.3f},{y:.3f} bed will contact at z={height_mm:.6f}")
    return "\n".join([*lines, "ok", ""])


if __name__ == "__main__":
    SAMPLE.mkdir(exist_ok=True)
    (SAMPLE / "printer.cfg").write_text(sample_cfg(), encoding="utf-8", newline="\n")
    (SAMPLE / "probe.log").write_text(sample_log(), encoding="utf-8", newline="\n")
