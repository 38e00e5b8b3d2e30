"""Printers whose plate is not flat, or whose probe hangs beside the nozzle of a tilting platform.

A simulation of its own: six bars, two for each tower, hold a platform that turns where the two are
unequal. The peers of `tests.blind.printers` take the plate for flat and the platform for level.

    python -m tests.blind.probes [--count 30] [--seed 1]
"""

from __future__ import annotations

import argparse
import math
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from protocols.machine import Machine
from tests.app.exports.upright_towers import outward
from tests.blind.printers import (
    ANGLES,
    BAR,
    CASES,
    Firmware,
    FloatArray,
    Parts,
    any_printer,
    calibrated,
    machine,
)

APART_MM = 50.0
"""Between the two bars of a tower."""

JOINTS_MM = 30.0
"""From the middle of the platform to its joints."""

NOZZLE_MM = 20.0
"""Below the joints of the platform."""

EDGE_MM = 80.0
BESIDE_MM = (22.0, -12.0)


@dataclass(frozen=True, eq=False)
class Probed:
    """A printer with a bowed plate, unequal bars and a probe ``beside_mm`` the nozzle.

    ``bow_mm`` is how much higher the plate is at the edge than in the middle, along x, along y and
    along x = y, where it falls as much along x = -y. ``unequal_mm`` ``(3,)`` is how much longer the
    bar on the anticlockwise side of a tower is than the other one.
    """

    parts: Parts
    bow_mm: FloatArray = field(default_factory=lambda: np.zeros(3))
    beside_mm: tuple[float, float] = (0.0, 0.0)
    unequal_mm: FloatArray = field(default_factory=lambda: np.zeros(3))

    def pose(self, below_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Middle of the platform ``(3,)`` and how it is turned ``(3, 3)``: six lengths, Newton."""
        out = outward(ANGLES)
        out = np.column_stack([out, np.zeros(3)])
        along = np.column_stack([-out[:, 1], out[:, 0], np.zeros(3)])
        sides = np.array([1.0, -1.0])[:, None, None] * 0.5 * APART_MM * along
        joints = (JOINTS_MM * out + sides).reshape(6, 3)
        carriages = (self.parts.feet(below_mm) + JOINTS_MM * out + sides).reshape(6, 3)
        halves = np.array([0.5, -0.5])[:, None] * self.unequal_mm
        lengths = (BAR + self.parts.bar_mm + halves).reshape(6)
        middle, turned = self.parts.tool(below_mm), np.eye(3)
        for _ in range(20):
            arms = joints @ turned.T
            bars = middle + arms - carriages
            size = np.linalg.norm(bars, axis=1)
            way = bars / size[:, None]
            step = np.linalg.solve(np.hstack([way, np.cross(arms, way)]), lengths - size)
            middle = middle + step[:3]
            turned = _turn(step[3:]) @ turned
        return middle, turned

    def tool(self, below_mm: FloatArray) -> FloatArray:
        """The nozzle's tip, from where it is below a level platform."""
        middle, turned = self.pose(below_mm)
        down = np.array([0.0, 0.0, -NOZZLE_MM])
        return np.asarray(middle + turned @ down - down)

    def plate(self, x_mm: float, y_mm: float) -> float:
        x, y = x_mm / EDGE_MM, y_mm / EDGE_MM
        slope = self.parts.plate @ [x_mm, y_mm]
        return float(slope + self.bow_mm @ [x * x, y * y, 2.0 * x * y])

    def met(self, firmware: Firmware, across: tuple[float, float]) -> FloatArray:
        """Where the firmware is as the probe meets the plate."""
        place = np.array([*across, 0.0])
        tip = np.array([*self.beside_mm, -NOZZLE_MM])
        for _ in range(12):
            middle, turned = self.pose(firmware(place))
            x, y, z = middle + turned @ tip
            place[2] -= z + NOZZLE_MM - self.plate(x, y)
        return place


def _turn(angle: FloatArray) -> FloatArray:
    """Rodrigues."""
    size = float(np.linalg.norm(angle))
    if not size:
        return np.eye(3)
    x, y, z = angle / size
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + math.sin(size) * cross + (1.0 - math.cos(size)) * cross @ cross)


Shape = Callable[[np.random.Generator], FloatArray]
BOWED: Mapping[str, Shape] = {
    "flat": lambda _: np.zeros(3),
    "0.1 mm, dome or dish": lambda random: random.choice([-0.1, 0.1]) * np.array([1.0, 1.0, 0.0]),
    "0.1 mm, saddle": lambda random: random.choice([-0.1, 0.1]) * np.array([1.0, -1.0, 0.0]),
    "0.05 mm, any": lambda random: random.normal(scale=[0.05, 0.05, 0.035]),
}
OFF = {name: CASES[name] for name in ("switches", "switches, radius, angles")} | {
    "any": any_printer
}
UNEQUAL_MM = 0.05
"""Standard deviation of how unequal the two bars of a tower are: 1 mrad."""


def stated(*, plate: bool = True, beside_mm: tuple[float, float] | None = None) -> Machine:
    """As `glidecal import` states it, or with the plate flat."""
    bow, tilt = 0.05 * plate, 1.0 * (beside_mm is not None)
    keys = {"plate_bow_tolerance_mm": bow, "platform_tilt_tolerance_mrad": tilt}
    return machine().model_copy(update={**keys, "probe_offset_mm": beside_mm})


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, default=30)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    columns = ["before", "six", "nine", "ours", "touched", "bound", "height"]
    print("| hidden | plate, probe | stated |", " | ".join(columns), "| kept |")
    plates = [(name, shape, (0.0, 0.0), 0.0) for name, shape in BOWED.items()]
    beside = ("probe beside the nozzle, bars unequal", BOWED["flat"], BESIDE_MM, UNEQUAL_MM)
    for off, make in OFF.items():
        for name, shape, beside_mm, unequal_mm in [*plates, beside]:
            probe_mm = beside_mm if any(beside_mm) else None
            without = {"beside_mm": probe_mm} if probe_mm else {}
            for words, machine_file in {
                "nothing": stated(plate=False),
                "tolerances": stated(plate=True, **without),
            }.items():
                results = []
                for k in range(options.count):
                    random = np.random.default_rng([options.seed, k, len(off)])
                    parts = make(random)
                    chance = np.random.default_rng([options.seed, k, 7])
                    hidden = Probed(
                        parts, shape(chance), beside_mm, chance.normal(scale=unequal_mm, size=3)
                    )
                    with tempfile.TemporaryDirectory() as folder:
                        results.append(calibrated(hidden, random, Path(folder), machine_file))
                table = np.array([[getattr(r, column) for column in columns] for r in results])
                within_bound = int((table[:, 4] <= table[:, 5]).sum())
                cells = " | ".join(f"{v:.4f}" for v in np.sqrt((table**2).mean(axis=0)))
                row = f"| {off} | {name} | {words} | {cells} | {within_bound} of {options.count} |"
                print(row, flush=True)


if __name__ == "__main__":
    main()
