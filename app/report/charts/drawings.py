"""Line drawings for a terminal: strokes, marks and scale, computed apart from any screen."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from app.report.charts.charts import Chart, Series
from calib.hexaslide.drawing import lines_at, outline
from calib.hexaslide.geometry import Box, HexaSlide
from calib.hexaslide.planning import Found
from calib.observations import FloatArray

Point = tuple[float, float]
Limits = tuple[float, float]

CELL_HEIGHT = 2.0
"""A cell of a terminal is about twice as high as it is wide."""

MARGIN = 0.04
"""Room around what is drawn, as a share of it."""


class Look(StrEnum):
    """How a stroke is drawn, told apart without colour."""

    DOTTED = "dotted"
    THIN = "thin"
    THICK = "thick"
    MARKED = "marked"


@dataclass(frozen=True)
class Stroke:
    """A line through points."""

    look: Look
    points: tuple[Point, ...]


@dataclass(frozen=True)
class Label:
    """Letters at a place."""

    words: str
    at: Point


@dataclass(frozen=True)
class Drawing(Chart):
    """Strokes under the points of a chart; ``even`` keeps lengths alike in both directions."""

    strokes: tuple[Stroke, ...] = ()
    labels: tuple[Label, ...] = ()
    even: bool = False

    def limits(self, columns: int, rows: int) -> tuple[Limits, Limits]:
        """Ends of both axes in a place of so many cells."""
        points = [point for stroke in self.strokes for point in stroke.points]
        points += [p for one in self.series for p in zip(one.x, one.y, strict=True)]
        horizontal = _ends([x for x, _ in points])
        vertical = _ends([y for _, y in points])
        if not self.even:
            return horizontal, vertical
        cell = max(
            (horizontal[1] - horizontal[0]) / max(1, columns),
            (vertical[1] - vertical[0]) / (CELL_HEIGHT * max(1, rows)),
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


FRONT, ABOVE = (0, 2), (0, 1)
"""Coordinates across and upwards."""

PROJECTIONS = ((0, 1), (0, 2), (3, 4), (3, 5))
"""Two of places, two of angles."""

COORDINATES = ("x", "y", "z", "theta", "psi", "phi")


def drawn_machine(machine: HexaSlide, posture: FloatArray) -> tuple[Drawing, Drawing]:
    """The machine at a posture ``(6,)`` from the front and from above.

    Rails are drawn as far as the sliders go in the box.
    """
    lines = lines_at(machine, posture)
    strokes = [(Look.DOTTED, rail) for rail in lines.rails]
    strokes += [(Look.THIN, link) for link in lines.links]
    strokes.append((Look.THICK, lines.platform))
    return (
        _seen_from("From the front", FRONT, machine.box, strokes, lines.carriages),
        _seen_from("From above", ABOVE, machine.box, strokes, lines.carriages),
    )


def _seen_from(
    title: str,
    axes: tuple[int, int],
    box: Box,
    strokes: list[tuple[Look, FloatArray]],
    carriages: FloatArray,
) -> Drawing:
    """Lines in space ``(n, 3)`` seen along the axis that is left out."""
    seen = list(axes)
    flat = [Stroke(look, _points(line[:, seen])) for look, line in strokes]
    numbers = enumerate(_points(carriages[:, seen]), start=1)
    return Drawing(
        title=title,
        x_words=f"{'xyz'[axes[0]]}, m",
        y_words=f"{'xyz'[axes[1]]} in m",
        series=(),
        strokes=(_outline(box, axes), *flat),
        labels=tuple(Label(f"{chain}", at) for chain, at in numbers),
        even=True,
    )


def drawn_postures(machine: HexaSlide, found: Found | None) -> tuple[Drawing, ...]:
    """The four projections of start and optimum in the box."""
    sets = (
        () if found is None else (("start", found.best.begin), ("optimum", found.best.coordinates))
    )
    return tuple(_projected(machine.box, axes, sets) for axes in PROJECTIONS)


def _projected(
    box: Box, axes: tuple[int, int], sets: tuple[tuple[str, FloatArray], ...]
) -> Drawing:
    scale, unit = _scale_of(axes)
    across, upwards = axes
    series = tuple(
        Series(name, *(tuple((scale * postures[:, axis]).tolist()) for axis in axes))
        for name, postures in sets
    )
    return Drawing(
        title=f"{COORDINATES[upwards]} over {COORDINATES[across]}",
        x_words="",
        y_words=unit,
        series=series,
        strokes=(_outline(box, axes),),
    )


def _outline(box: Box, axes: tuple[int, int]) -> Stroke:
    """Dots on the edges of the box."""
    return Stroke(Look.MARKED, _points(_scale_of(axes)[0] * outline(box, axes)))


def _scale_of(axes: tuple[int, int]) -> tuple[float, str]:
    """Places are shown in metres, angles in degrees."""
    return (1.0, "m") if axes[0] < len("xyz") else (180.0 / math.pi, "°")


def _points(places: FloatArray) -> tuple[Point, ...]:
    return tuple((x, y) for x, y in places.tolist())
