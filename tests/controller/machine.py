"""A whole machine behind LinuxCNC: what is off, where its tool is, what indicators on legs show.

Geometry written out here; no code of the program takes part.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.controller.running import SimulatedJoint, Stop, run

FloatArray = NDArray[np.float64]

L = 310.25
SWITCH_MM = 345.0
LEVELS = (0.0, 22.0, 60.0, 41.0, 22.0, 0.0, -37.0, -71.0, -100.0, -71.0, -37.0)
"""Of the procedure two-station."""

CYCLES = 2
AT = (*LEVELS * CYCLES, 0.0)
STATIONS = (0.5, 0.35)
SCATTER_MM, STEP_MM = 0.002, 0.001
CHECKED = np.array(
    [
        (0, 0, 0),
        (50, 0, 0),
        (0, 50, 0),
        (0, 0, 50),
        (-90, 0, 0),
        (0, -90, 0),
        (0, 0, -90),
        (40, 40, 0),
        (-60, 30, 20),
        (20, -60, 30),
        (-50, -50, -50),
        (30, 20, -70),
    ]
)


@dataclass(frozen=True)
class Machine:
    """What is off: offsets and lengths in mm, figures of ``rigjoint.comp``, places of drives.

    ``joint`` holds for all three carriages, ``one`` for some of them. ``lean`` ``(3, 3)`` is added
    to the unit vectors of the drives, ``shift_mm`` to their origins.
    """

    offset_mm: Sequence[float] = (0.0, 0.0, 0.0)
    length_mm: Sequence[float] = (0.0, 0.0, 0.0)
    joint: Mapping[str, float] = field(default_factory=dict)
    one: Mapping[int, Mapping[str, float]] = field(default_factory=dict)
    lean: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    shift_mm: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))

    def joints(self) -> list[SimulatedJoint]:
        """The carriages; the motor stands at 0 where a right one would be at L."""
        return [
            SimulatedJoint(
                {
                    **self.figures(k),
                    "mounting": L + offset,
                    "zero": L + offset,
                    "lead": 5.0,
                    "switch_at": SWITCH_MM,
                }
            )
            for k, offset in enumerate(self.offset_mm)
        ]

    def figures(self, joint: int) -> dict[str, float]:
        """What is off about one carriage."""
        return {**self.joint, **self.one.get(joint, {})}

    def feet(self, carriage: Sequence[float]) -> FloatArray:
        """Feet ``(3, 3)`` for true carriages."""
        return np.asarray(self.shift_mm + (np.eye(3) + self.lean) * np.array(carriage)[:, None])

    def tool(self, carriage: Sequence[float]) -> FloatArray:
        """Where three spheres about the feet meet, near the origin; by Newton's method."""
        feet, lengths, tool = self.feet(carriage), L + np.array(self.length_mm), np.zeros(3)
        for _ in range(20):
            way = tool - feet
            off = (way**2).sum(axis=1) - lengths**2
            tool = tool - np.linalg.solve(2.0 * way, off)
        return tool

    def reading(
        self, leg: int, axis: int, station: float, now: Sequence[float], zero: Sequence[float]
    ) -> float:
        """Along an axis, of the point of the bar that keeps its place along the leg's own axis."""
        start, end = self.tool(zero), self.feet(zero)[leg]
        point = start[leg] + station * (end[leg] - start[leg])
        tool, foot = self.tool(now), self.feet(now)[leg]
        part = (point - tool[leg]) / (foot[leg] - tool[leg])
        return float(tool[axis] + part * (foot[axis] - tool[axis]))


def old_home_offset_mm(machine: Machine, joint: int, way: float) -> float:
    """What an uncorrected controller holds: the motor's place at the switch, counted from L."""
    q = SWITCH_MM
    for _ in range(50):
        x, figures = q - L, machine.figures(joint)
        off = machine.offset_mm[joint] + figures.get("scale", 0.0) * x
        off += figures.get("cyclic", 0.0) * np.sin(2 * np.pi * x / 5.0)
        off += figures.get("play", 0.0) * (way < 0)
        q = SWITCH_MM - off
    return float(q)


def homing(home_offset_mm: float, way: float = 1.0) -> dict[str, float | str]:
    """Entries of a joint that homes on its switch, latched upwards or downwards."""
    return {
        "HOME": L,
        "HOME_OFFSET": home_offset_mm,
        "HOME_SEARCH_VEL": 60.0,
        "HOME_LATCH_VEL": 0.3 * way,  # it finds the switch within what it goes in a millisecond
        "MAX_ACCELERATION": 8000,  # runs past the switch by 0.2 mm, by more than corrections
    }


@dataclass(frozen=True)
class Controlled:
    """A machine behind LinuxCNC: entries of each joint, ``calib.hal``, and what it includes."""

    machine: Machine
    entries: Sequence[Mapping[str, float | str]]
    calib_hal: str
    files: Mapping[str, str] = field(default_factory=dict)
    includes: Sequence[str] = ("", "", "")
    zero_set: bool = False

    def measured(self, folder: Path) -> tuple[str, float]:
        """A table of readings for ``glidecal import``, and the tool's error, from one run."""
        legs = [np.eye(3)[leg] * level for leg in range(3) for level in AT]
        stops = self._stops(folder, [*legs, *CHECKED])
        machine, generator = self.machine, np.random.default_rng(3)
        rows = ["leg,axis,displacement_mm,station,cycle,value_mm"]
        for leg in range(3):
            mine = stops[leg * len(AT) : (leg + 1) * len(AT)]
            for station in STATIONS:
                zeros = generator.normal(scale=0.3, size=3)
                for number, (level, stop) in enumerate(zip(AT, mine, strict=True)):
                    for axis in (k for k in range(3) if k != leg):
                        reading = machine.reading(
                            leg, axis, station, stop.carriage, mine[0].carriage
                        )
                        reading += zeros[axis] + generator.normal(scale=SCATTER_MM)
                        cycle = min(number // len(LEVELS) + 1, CYCLES)
                        rows.append(
                            f"{'xyz'[leg]},{'xyz'[axis]},{level},{station},{cycle},"
                            f"{round(reading / STEP_MM) * STEP_MM:.3f}"
                        )
        return "\n".join(rows) + "\n", self._error_mm(stops)

    def checked_mm(self, folder: Path) -> float:
        """The tool's error alone, at places that it comes to as after a session."""
        last = [np.eye(3)[2] * level for level in AT[-2:]]
        return self._error_mm(self._stops(folder, [*last, *CHECKED]))

    def _stops(self, folder: Path, places: Sequence[FloatArray]) -> list[Stop]:
        lines = ["G21 G90 G53 G1 F30000 X{:.4f} Y{:.4f} Z{:.4f}".format(*to) for to in places]
        configuration = self.machine.joints(), self.entries, self.calib_hal, ["home", *lines]
        return run(folder, *configuration, files=self.files, includes=self.includes)[1:]

    def _error_mm(self, stops: Sequence[Stop]) -> float:
        """R.m.s. distance of the tool from where it was sent, over `CHECKED`.

        With ``zero_set`` from where the whole lies on average: readings on legs cannot tell where
        the point is at which axes meet that do not meet, and a workpiece is touched off anyway.
        """
        pairs = zip(stops[-len(CHECKED) :], CHECKED, strict=True)
        off = np.array([self.machine.tool(stop.carriage) - target for stop, target in pairs])
        off = off - off.mean(axis=0) if self.zero_set else off
        return float(np.sqrt((off**2).sum(axis=1).mean()))
