"""What contacts can tell of a printer at most: linear estimates to first order, many printers.

Beside one plate: the same with a block of known height, with distances between marks, with both.
Six and nine factors are what firmware fits, by least squares. The two estimates with tolerances
know the printer's parts as `glidecal import` states them, and the same with lines and travels of
the towers as stated. What firmware has no value for, others follow. R.m.s. error of the tool from
its place at Zero, and in brackets with a turn about the vertical free, which no contact shows.

    python -m tests.blind.plates [--count 100]
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import numpy as np

from tests.blind.printers import (
    BELIEVED,
    CASES,
    GRID,
    RINGS,
    SCATTER_MM,
    TURN,
    FloatArray,
    Parts,
    any_printer,
)

SIZES = [2 if field.name == "plate" else 3 for field in fields(Parts)]
STEPS = np.repeat([1e-3] * 4 + [1e-5] * 4, SIZES)
CYCLES = 3
BLOCK_MM, BLOCK_WITHIN_MM = 60.0, 60.0
MARKS_MM, DISTANCE_MM = 60.0, 0.02
"""How far from the middle marks are, and the standard deviation of a distance between two."""

TOLERANCE = np.repeat([1.0, 0.4, 0.4, 0.4, 1e-3, 1e-3, 1e-3, 1e-4], SIZES)
ALIKE = 0.8
"""Correlation of how far towers stand from the middle, and of their bars."""

HELD = np.repeat([True, True, True, True, False, False, True, False], SIZES)
STATED = np.repeat([True, True, True, True, False, False, False, True], SIZES)
Shown = Callable[[Parts], FloatArray]


def parts_of(values: FloatArray) -> Parts:
    return Parts(*np.split(values, np.cumsum(SIZES)[:-1]))


def values_of(parts: Parts) -> FloatArray:
    return np.concatenate([getattr(parts, field.name) for field in fields(Parts)])


def slopes(display: Shown) -> FloatArray:
    """Derivatives by all parts, by differences."""
    steps = np.diag(STEPS)
    rows = [(display(parts_of(step)) - display(parts_of(-step))) / 2.0 for step in steps]
    return np.asarray(np.array(rows).T / STEPS)


def heights(over_mm: float, within_mm: float) -> Shown:
    """Where the firmware believes to be as the tool is so high over the plate."""
    places = [across for across in RINGS if math.hypot(*across) <= within_mm]

    def met(parts: Parts, across: tuple[float, float]) -> float:
        place = np.array([*across, over_mm])
        for _ in range(6):
            tool = parts.tool(BELIEVED(place))
            place[2] -= tool[2] - parts.plate @ tool[:2] - over_mm
        return float(place[2])

    return lambda parts: np.array([met(parts, across) for across in places])


def distances(parts: Parts) -> FloatArray:
    ends = [
        MARKS_MM * np.array([math.cos(angle), math.sin(angle), 0.0])
        for angle in math.pi / 6 * np.arange(6)
    ]
    marks = [(parts.tool(BELIEVED(end)), parts.tool(BELIEVED(-end))) for end in ends]
    return np.array([np.linalg.norm(first - second) for first, second in marks])


def tool(parts: Parts) -> FloatArray:
    zero = parts.tool(BELIEVED(np.zeros(3)))
    return np.concatenate([parts.tool(BELIEVED(place)) - place - zero for place in GRID])


def factors(count: int) -> FloatArray:
    """What firmware fits: switches, a radius, two angles; the bars' length, the plate's tilt."""
    columns = np.zeros((sum(SIZES), 9))
    columns[:3, :3] = np.eye(3)
    columns[6:9, 3] = columns[9, 4] = columns[10, 5] = columns[3:6, 6] = 1.0
    columns[-2:, 7:] = np.eye(2)
    return columns[:, :count]


DRAWN = 3000
"""Printers of a law, whose mean squares and products stand for it."""


def prior_of(make: Callable[[np.random.Generator], Parts]) -> FloatArray:
    """Mean products of all parts ``(k, k)`` of printers of one law."""
    random = np.random.default_rng(99)
    drawn = np.array([values_of(make(random)) for _ in range(DRAWN)])
    return np.asarray(drawn.T @ drawn / DRAWN)


def follower(moved: FloatArray) -> FloatArray:
    """What entries that firmware has are, so that they move the tool as all parts do."""
    follow = np.zeros((len(TOLERANCE), len(TOLERANCE)))
    scaled = moved[:, HELD] * TOLERANCE[HELD]
    follow[HELD] = TOLERANCE[HELD, None] * (np.linalg.pinv(scaled, rcond=1e-7) @ moved)
    return follow


@dataclass(frozen=True, eq=False)
class Knowing:
    """Who knows the laws that printers may follow, and how likely each is: the least that is left.

    Linear estimates of each law, weighed by how likely it makes the contacts.
    """

    priors: Sequence[FloatArray]
    rows: FloatArray
    moved: FloatArray

    def left_mm(self, parts: Parts, height_mm: FloatArray) -> FloatArray:
        """Error of the tool ``(n, 3)`` over the grid after contacts at these heights ``(n,)``."""
        noise = SCATTER_MM**2 / CYCLES * np.eye(len(self.rows))
        logs, means = [], []
        for prior in self.priors:
            inner = self.rows @ prior @ self.rows.T + noise
            result = np.linalg.solve(inner, height_mm)
            logs.append(-0.5 * (height_mm @ result + np.linalg.slogdet(inner)[1]))
            means.append(prior @ self.rows.T @ result)
        weight = np.exp(np.array(logs) - max(logs))
        entered = follower(self.moved) @ (weight @ np.array(means)) / weight.sum()
        return np.asarray((self.moved @ (values_of(parts) - entered)).reshape(-1, 3))


def estimates(rows: FloatArray, deviation: FloatArray) -> list[tuple[FloatArray, bool]]:
    """Maps from what is shown to parts, and whether other entries follow what has none."""
    maps = []
    for count in (6, 9):
        factors_of_count = factors(count)
        inverse = np.linalg.pinv(rows @ factors_of_count / deviation[:, None])
        maps.append((factors_of_count @ (inverse / deviation), False))
    prior = np.diag(TOLERANCE**2)
    for alike in (slice(3, 6), slice(6, 9)):
        prior[alike, alike] *= np.eye(3)
        prior[alike, alike] += TOLERANCE[alike][0] ** 2 * ALIKE * (1.0 - np.eye(3))
    for free in (np.ones(len(prior)), STATED.astype(float)):
        covariance = prior * free * free[:, None]
        inner = rows @ covariance @ rows.T + np.diag(deviation**2)
        maps.append((covariance @ rows.T @ np.linalg.inv(inner), True))
    return maps


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, default=100)
    count = parser.parse_args().count
    plate, block = slopes(heights(0.0, math.inf)), slopes(heights(BLOCK_MM, BLOCK_WITHIN_MM))
    apart, moved = slopes(distances), slopes(tool)
    contact = SCATTER_MM / math.sqrt(CYCLES)
    noise = {id(plate): contact, id(block): contact, id(apart): DISTANCE_MM}
    follow = follower(moved)
    print("| hidden | shown | six factors | nine | with tolerances | lines as stated |")
    cases = {**CASES, "any": any_printer}
    for name, make in cases.items():
        for title, designs in {
            "plate": [plate],
            "plate, block": [plate, block],
            "plate, distances": [plate, apart],
            "all": [plate, block, apart],
        }.items():
            rows = np.vstack(designs)
            deviation = np.concatenate(
                [np.full(len(design), noise[id(design)]) for design in designs]
            )
            cells = []
            for estimate, follows in estimates(rows, deviation):
                random = np.random.default_rng(5)
                squares = []
                for _ in range(count):
                    hidden = values_of(make(random))
                    readings = rows @ hidden + deviation * random.normal(size=len(rows))
                    entered = estimate @ readings
                    off = moved @ (hidden - (follow @ entered if follows else entered * HELD))
                    squares.append([off @ off, off @ off - (TURN @ off) ** 2])
                zero, turned = np.sqrt(np.mean(squares, axis=0) / len(GRID))
                cells.append(f"{zero:.4f} ({turned:.4f})")
            print(f"| {name} | {title} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
