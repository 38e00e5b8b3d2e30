"""Does the picture of a leg name its effect? Nearest picture of another machine, and nothing else.

Of each machine only the points are taken that the picture shows of what is left: where, how high,
with which mark. ``python -m tests.blind.shapes`` prints the table of docs/read-your-machine.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter

from app.report.charts.charts import Chart
from calib.arrays import FloatArray
from studies.shapes import SHAPES, Shape, pictures_of

DISTINCT = (
    *("backlash", "gauge_hysteresis", "actuator_cyclic", "straightness_cubic", "leg_bow"),
    *("axis_squareness", "leg_taper", "joint_clearance", "thermal_drift"),
    *("first_take", "stand_slip", "posture_off"),
)
"""The others look like one of these; docs/read-your-machine.md says which."""

MARKS = "><o"
CELLS = 24
BLUR = 1.2
"""Cells of a picture, and how far, as a standard deviation, a point may lie beside another."""


@dataclass(frozen=True)
class Machine:
    """How another machine differs: size by a factor, offsets and noise by the seed, the leg."""

    factor: float
    seed: int
    scatter_mm: float
    turns: int


MACHINES = (
    Machine(0.6, 11, 0.0015, 1),
    Machine(1.6, 12, 0.002, 2),
    Machine(-1.0, 13, 0.001, 1),
    Machine(0.5, 14, 0.001, 2),
    Machine(2.0, 15, 0.003, 1),
    Machine(-0.7, 16, 0.0015, 0),
)


def dots(chart: Chart, sign: float = 1.0) -> FloatArray:
    """Points of a chart ``(marks, cells, cells)``, as wide and high as they reach, blurred.

    Each mark has the length 1, or 0 where no point has it.
    """
    points = np.array(list(_marked(chart)))
    place, height, mark = points[:, 0], sign * points[:, 1], points[:, 2].astype(int)
    across = (place - place.min()) / np.ptp(place)
    up = 0.5 + 0.5 * height / np.abs(height).max()
    cells = np.zeros((len(MARKS), CELLS, CELLS))
    at = np.round((CELLS - 1) * np.array([across, up])).astype(int)
    np.add.at(cells, (mark, *at), 1.0)
    blurred = np.array([gaussian_filter(cell, BLUR) for cell in cells])
    length = np.sqrt((blurred**2).sum(axis=(1, 2), keepdims=True))
    return np.asarray(blurred / np.where(length > 0.0, length, 1.0))


def _marked(chart: Chart) -> list[tuple[float, float, int]]:
    return [
        (x, y, MARKS.index(series.mark))
        for series in chart.series
        for x, y in zip(series.x, series.y, strict=True)
    ]


def nearest(picture: FloatArray, shapes: dict[str, FloatArray]) -> str:
    """The name of the picture that covers most of it, whichever of both sides is up."""
    alike = {
        name: max(float((picture * side).sum()) for side in sides) for name, sides in shapes.items()
    }
    return max(alike, key=alike.__getitem__)


def of_machine(shape: Shape, machine: Machine) -> Chart:
    """What is left at the leg of such a machine that has most of it."""
    for _ in range(machine.turns):
        shape = shape.turned()
    return pictures_of(shape, machine.factor, machine.seed, machine.scatter_mm)[0].left


def confusion() -> dict[str, list[str]]:
    """For each effect the names that the pictures of the machines were given."""
    shapes = [shape for shape in SHAPES if shape.id in DISTINCT]
    catalogue = {shape.id: pictures_of(shape)[0].left for shape in shapes}
    references = {
        name: np.array([dots(chart, sign) for sign in (1.0, -1.0)])
        for name, chart in catalogue.items()
    }
    return {
        shape.id: [nearest(dots(of_machine(shape, machine)), references) for machine in MACHINES]
        for shape in shapes
    }


def table(names: dict[str, list[str]]) -> str:
    """A column for each machine, a row for each effect that another picture names once."""
    columns = (
        f"size × {machine.factor:g}, ± {1000.0 * machine.scatter_mm:g} µm" for machine in MACHINES
    )
    lines = [f"| effect | {' | '.join(columns)} |", "|---" * (1 + len(MACHINES)) + "|"]
    for effect, answers in names.items():
        if set(answers) != {effect}:
            cells = ("✓" if name == effect else f"{name}" for name in answers)
            lines.append(f"| `{effect}` | {' | '.join(cells)} |")
    right = [
        sum(nearest_names[k] == effect for effect, nearest_names in names.items())
        for k in range(len(MACHINES))
    ]
    lines.append(f"| of {len(names)} | {' | '.join(map(str, right))} |")
    return "\n".join(lines)


if __name__ == "__main__":
    print(table(confusion()))
