"""Printers with three towers whose every part is off: what is left after a calibration by contacts.

A simulation of its own, from the geometry: switches, bars, where towers stand and lean, what a step
means, how the plate lies. Peers are what firmware fits, by least squares on the same contacts: six
factors (switches, one radius, two angles), and nine (the bars' length and the plate's tilt, too).

`python -m tests.blind.beside_firmware` has all rows.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from protocols.machine import Machine, machine_text
from protocols.printers.tower_printer import Contact, TowerPrinter
from tests.app.cli import glidecal
from tests.app.exports.upright_towers import TURN_MM, comments, klipper, outward, rms

FloatArray = NDArray[np.float64]
Firmware = Callable[[FloatArray], FloatArray]

BAR, RADIUS, STOP = 250.0, 124.0, 300.0
ANGLES = np.array([210.0, 330.0, 90.0])
SCATTER_MM = 0.005
CYCLES = 3
RINGS = [(0.0, 0.0)] + [
    (round(r * math.cos(a), 3), round(r * math.sin(a), 3))
    for r in (30.0, 55.0, 80.0)
    for a in math.pi / 2 + math.tau / 6 * np.arange(6)
]
GRID = [
    np.array([x, y, z])
    for x in np.linspace(-40.0, 40.0, 5)
    for y in np.linspace(-40.0, 40.0, 5)
    for z in np.linspace(15.0, 105.0, 4)
]
"""Middles of 5 × 5 × 4 cells of 100 × 100 × 120 mm."""


@dataclass(frozen=True, eq=False)
class Parts:
    """What is off, each ``(3,)`` for towers x, y, z; ``plate`` is its slope in x and y, rad."""

    switch_mm: FloatArray
    bar_mm: FloatArray
    out_mm: FloatArray
    round_mm: FloatArray
    lean_out: FloatArray  # rad, with the height over the plate
    lean_round: FloatArray
    scale: FloatArray  # mm/mm
    plate: FloatArray

    @classmethod
    def perfect(cls) -> Parts:
        return cls(*(np.zeros(2 if field.name == "plate" else 3) for field in fields(cls)))

    def feet(self, below_mm: FloatArray) -> FloatArray:
        """Joints of the carriages ``(3, 3)``, these so far ``(3,)`` below their switches."""
        raised = STOP + math.sqrt(BAR**2 - RADIUS**2)
        height = raised + self.switch_mm - (1.0 + self.scale) * below_mm
        out = outward(ANGLES)
        across = np.stack([-out[:, 1], out[:, 0]], axis=1)
        foot = (RADIUS + self.out_mm + self.lean_out * height)[:, None] * out
        foot = foot + (self.round_mm + self.lean_round * height)[:, None] * across
        return np.column_stack([foot, height])

    def tool(self, below_mm: FloatArray) -> FloatArray:
        """Where three spheres meet; Newton."""
        feet, bar = self.feet(below_mm), BAR + self.bar_mm
        place = np.array([0.0, 0.0, feet[:, 2].mean() - 217.0])
        for _ in range(30):
            way = place - feet
            place = place - np.linalg.solve(2.0 * way, (way**2).sum(axis=1) - bar**2)
        return place

    def met(self, firmware: Firmware, across: tuple[float, float]) -> FloatArray:
        """Where the firmware is as the tool meets the plate."""
        place = np.array([*across, 0.0])
        for _ in range(12):
            tool = self.tool(firmware(place))
            place[2] -= tool[2] - self.plate @ tool[:2]
        return place


class WithTool(Protocol):
    """A printer: where its tool is, from where it is below a perfect one."""

    def tool(self, below_mm: FloatArray) -> FloatArray: ...


class Hidden(WithTool, Protocol):
    """A printer that also knows where the firmware is as something meets the plate."""

    def met(self, firmware: Firmware, across: tuple[float, float]) -> FloatArray: ...


Cases = Mapping[str, Callable[[np.random.Generator], Parts]]
PERFECT = Parts.perfect()


def _switches(random: np.random.Generator) -> Parts:
    return replace(PERFECT, switch_mm=random.normal(scale=0.3, size=3))


def _placed(random: np.random.Generator) -> Parts:
    radius = random.choice([-1.0, 1.0]) * random.uniform(0.3, 0.6, 3)
    turned = math.radians(0.2) * RADIUS
    around = turned * np.array([*random.uniform(-1.0, 1.0, 2), 0.0])
    return replace(_switches(random), out_mm=radius, round_mm=around)


def _everything(random: np.random.Generator) -> Parts:
    placed = _placed(random)
    return replace(
        placed,
        bar_mm=0.3 + random.uniform(-0.25, 0.25, 3),
        out_mm=placed.out_mm + random.normal(scale=0.1, size=3),
        lean_out=random.normal(scale=1e-3, size=3),
        lean_round=random.normal(scale=1e-3, size=3),
        plate=random.normal(scale=1e-3, size=2),
    )


CASES: Cases = {
    "switches": _switches,
    "switches, radius, angles": _placed,
    "and arms +0.5": lambda r: replace(_placed(r), bar_mm=np.full(3, 0.5)),
    "arms ±0.25 each": lambda r: replace(PERFECT, bar_mm=0.25 * r.choice([-1.0, 1.0], 3)),
    "towers lean 2 mrad": lambda r: replace(
        _switches(r),
        lean_out=2e-3 * r.uniform(-1.0, 1.0, 3),
        lean_round=2e-3 * r.uniform(-1.0, 1.0, 3),
    ),
    "plate 3 mrad askew": lambda r: replace(_switches(r), plate=3e-3 * r.choice([-1.0, 1.0], 2)),
    "one belt 0.5 %": lambda r: replace(
        _switches(r), scale=np.roll([5e-3, 0.0, 0.0], r.integers(3))
    ),
    "all but the belt": _everything,
}
"""The eight of the comparison beside firmware; signs and sizes by chance."""


def any_printer(random: np.random.Generator) -> Parts:
    """Each part off as parts of printers are, normal."""
    return Parts(
        random.normal(scale=0.4, size=3),
        random.normal(scale=0.3) + random.normal(scale=0.1, size=3),
        random.normal(scale=0.3) + random.normal(scale=0.2, size=3),
        random.normal(scale=0.3, size=3),
        random.normal(scale=1e-3, size=3),
        random.normal(scale=1e-3, size=3),
        random.normal(scale=0.7e-3, size=3),
        np.zeros(2),
    )


def carriages(place: FloatArray, bars: FloatArray, feet: FloatArray) -> FloatArray:
    return np.asarray(place[2] + np.sqrt(bars**2 - ((place[:2] - feet) ** 2).sum(axis=1)))


def firmware(stops: FloatArray, radius: float, angles: FloatArray, bar: float) -> Firmware:
    trip = stops + math.sqrt(bar**2 - radius**2)
    bars, feet = np.full(3, bar), radius * outward(angles)
    return lambda place: trip - carriages(place, bars, feet)


BELIEVED = firmware(np.full(3, STOP), RADIUS, ANGLES, BAR)


def contacts(
    parts: Hidden,
    random: np.random.Generator,
    places: Sequence[tuple[float, float]] = RINGS,
    cycles: int = CYCLES,
) -> list[FloatArray]:
    met = [parts.met(BELIEVED, across) for across in places]
    up = np.array([0.0, 0.0, SCATTER_MM])
    return [place + up * random.normal() for _ in range(cycles) for place in met]


def fitted(
    points: list[FloatArray],
    factors: int,
    stops_mm: Sequence[float] = (STOP,) * 3,
    *,
    radius_mm: float = RADIUS,
    angles_deg: FloatArray = ANGLES,
    bar_mm: float = BAR,
) -> Firmware:
    """The peers' least squares: a machine with which all contacts are at height 0."""
    controller = firmware(np.array(stops_mm), radius_mm, angles_deg, bar_mm)
    below = np.array([controller(place) for place in points])

    def values(v: FloatArray) -> tuple[FloatArray, float, FloatArray, float]:
        angles = angles_deg + np.array([v[4], v[5], 0.0])
        return stops_mm + v[:3], radius_mm + v[3], angles, bar_mm + (v[6] if factors == 9 else 0.0)

    def heights(v: FloatArray) -> FloatArray:
        stops, radius, angles, bar = values(v)
        joints = np.zeros((len(below), 3, 3))
        joints[..., :2] = radius * outward(angles)
        joints[..., 2] = stops + math.sqrt(bar**2 - radius**2) - below
        place = np.array(points)
        for _ in range(8):
            way = place[:, None] - joints
            residual = (way**2).sum(axis=2) - bar**2
            place = place - np.linalg.solve(2.0 * way, residual[..., None])[..., 0]
        tilt = v[7:] if factors == 9 else np.zeros(2)
        return np.asarray(place[:, 2] - place[:, :2] @ tilt)

    solution = least_squares(heights, np.zeros(factors), x_scale="jac")
    return firmware(*values(solution.x))


def errors(parts: WithTool, run: Firmware) -> FloatArray:
    """Tool less where it was sent, less the same in the middle of the plate ``(n, 3)``."""
    zero = parts.tool(run(np.zeros(3)))
    return np.array([parts.tool(run(place)) - place for place in GRID]) - zero


def machine() -> Machine:
    """As `glidecal import` makes it of a configuration; errors are judged over the grid."""
    printer = TowerPrinter(
        "printer",
        "printer",
        (BAR,) * 3,
        (RADIUS,) * 3,
        (STOP,) * 3,
        rotation_distance_mm=(TURN_MM,) * 3,
    )
    around = tuple(Contact((x, y, 0.0), "") for x, y in RINGS)
    box = ((-50.0, -50.0, 0.0), (50.0, 50.0, 120.0))
    return printer.machine(around).model_copy(update={"workspace_mm": box})


@dataclass(frozen=True)
class Result:
    """R.m.s. errors of the tool from its place at Zero, mm.

    Those ``turned`` ``(4,)`` are before, six, nine and ours with a turn about the vertical free.
    ``touched`` is ours where a shift is free, which is what the bound is of; ``height`` how far the
    plate is missed at Zero.
    """

    before: float
    six: float
    nine: float
    ours: float
    turned: FloatArray
    touched: float
    bound: float
    height: float


ROUND_MM = np.concatenate([[-y, x, 0.0] for x, y, _ in GRID])
TURN = ROUND_MM / np.linalg.norm(ROUND_MM)
"""Of unit length over the grid: a turn about the vertical, which no contact shows."""


def turn_free(error_mm: FloatArray) -> float:
    """R.m.s. of errors ``(n, 3)`` over the grid, a turn about the vertical free."""
    square = (error_mm**2).sum() - float(TURN @ error_mm.ravel()) ** 2
    return math.sqrt(max(square, 0.0) / len(error_mm))


def calibrated(
    parts: Hidden,
    random: np.random.Generator,
    folder: Path,
    stated: Machine | None = None,
    places: Sequence[tuple[float, float]] = RINGS,
    cycles: int = CYCLES,
) -> Result:
    """One printer through `import`, `export` and the firmware's formulas; ``stated`` of it."""
    contacts_mm = contacts(parts, random, places, cycles)
    rows = [
        f"{x:.4f},{y:.4f},{z:.5f},0,{k // len(places) + 1}"
        for k, (x, y, z) in enumerate(contacts_mm)
    ]
    table, machine_file, session, out = (
        folder / name for name in ("t.csv", "m.toml", "s.jsonl", "out.cfg")
    )
    session.unlink(missing_ok=True)
    table.write_text("\n".join(["x_mm,y_mm,z_mm,height_mm,cycle", *rows]) + "\n")
    machine_file.write_text(machine_text(stated or machine(), []), encoding="utf-8")
    for words in (
        ("import", table, "-o", session, "--machine", machine_file),
        ("export", session, "--format", "klipper", "-o", out, "--force"),
    ):
        started = glidecal(*words)
        assert started.status == 0, started.err
    text = out.read_text(encoding="utf-8")
    (stated_mm,) = re.findall(
        r"at most ([\d.]+) mm with these values, for a touched-off", comments(text)
    )
    ours = klipper(text)
    zero = parts.tool(ours(np.zeros(3)))[2] - parts.tool(BELIEVED(np.zeros(3)))[2]
    errors_mm = [
        errors(parts, run)
        for run in (BELIEVED, fitted(contacts_mm, 6), fitted(contacts_mm, 9), ours)
    ]
    touched = rms(errors_mm[-1] - errors_mm[-1].mean(axis=0))
    turned = np.array([turn_free(error) for error in errors_mm])
    before, six, nine, after = map(rms, errors_mm)
    return Result(before, six, nine, after, turned, touched, float(stated_mm), abs(zero))
