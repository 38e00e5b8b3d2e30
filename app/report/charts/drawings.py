"""Line drawings, apart from any screen."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from app.report.charts.charts import Chart

Point = tuple[float, float]
Limits = tuple[float, float]

CELL_HEIGHT = 2.0
"""A cell of a terminal is about twice as high as it is wide."""

MARGIN = 0.04
"""Room around what is drawn, as a share of it."""


class StrokeStyle(StrEnum):
    """How a stroke is drawn, told apart without colour."""

    DOTTED = "dotted"
    THIN = "thin"
    THICK = "thick"
    MARKED = "marked"
    BEADED = "beaded"


@dataclass(frozen=True)
class Stroke:
    """A line through points."""

    style: StrokeStyle
    points: tuple[Point, ...]


@dataclass(frozen=True)
class Caption:
    """Letters at a place."""

    words: str
    at: Point


@dataclass(frozen=True)
class Drawing(Chart):
    """Strokes under the points of a chart; ``even`` keeps lengths alike in both directions.

    Without being ``scaled`` it is a picture: no frame, no numbers.
    """

    strokes: tuple[Stroke, ...] = ()
    labels: tuple[Caption, ...] = ()
    even: bool = False
    scaled: bool = True

    def limits(self, columns: int, rows: int) -> tuple[Limits, Limits]:
        """Ends of both axes in a place of so many cells; none is taken for one."""
        columns, rows = max(1, columns), max(1, rows)
        points = [point for stroke in self.strokes for point in stroke.points]
        points += [p for one in self.series for p in zip(one.x, one.y, strict=True)]
        horizontal = _ends([x for x, _ in points])
        vertical = _ends([y for _, y in points])
        if not self.even:
            return horizontal, vertical
        cell = max(
            (horizontal[1] - horizontal[0]) / columns,
            (vertical[1] - vertical[0]) / (CELL_HEIGHT * rows),
        )
        return _around(horizontal, cell * columns), _around(vertical, cell * CELL_HEIGHT * rows)


def _ends(values: Sequence[float]) -> Limits:
    lower, upper = min(values), max(values)
    room = MARGIN * (upper - lower)
    return lower - room, upper + room


def _around(ends: Limits, span: float) -> Limits:
    middle = (ends[0] + ends[1]) / 2.0
    return middle - span / 2.0, middle + span / 2.0


def ticks_within(limits: Limits, most: int) -> tuple[float, ...]:
    """Round numbers between two ends, at most so many."""
    span = limits[1] - limits[0]
    decade = 10.0 ** math.floor(math.log10(span / max(1, most)))
    for step in (factor * decade for factor in (1.0, 2.0, 5.0, 10.0, 20.0, 50.0)):
        first, last = math.ceil(limits[0] / step), math.floor(limits[1] / step)
        if last - first < most:
            return tuple(k * step for k in range(first, last + 1))
    return ()
