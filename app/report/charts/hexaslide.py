"""The Hexa Slide drawn: the machine from two sides, and where its postures stand in the box."""

from __future__ import annotations

import math
from collections.abc import Sequence

from app.evaluating.hexaslide_calibration import CalibratedMachine
from app.report.charts.charts import Caption, Chart, Drawing, Series, Stroke, StrokeStyle, points_of
from calib.arrays import FloatArray
from calib.hexaslide.drawing import lines_at, outline
from calib.hexaslide.geometry import Box, HexaSlide
from calib.hexaslide.procedures import COMPONENTS
from calib.hexaslide.search import BestPostures
from calib.hexaslide.what_if import CauseAtSize

FRONT, ABOVE = (0, 2), (0, 1)
"""Coordinates across and upwards."""

PROJECTIONS = ((0, 1), (0, 2), (3, 4), (3, 5))
"""Two of places, two of angles."""


def drawn_machine(machine: HexaSlide, posture: FloatArray) -> tuple[Drawing, Drawing]:
    """The machine at a posture ``(6,)`` from the front and from above.

    Rails are drawn as far as the sliders go in the box.
    """
    lines = lines_at(machine, posture)
    strokes = [(StrokeStyle.DOTTED, rail) for rail in lines.rails]
    strokes += [(StrokeStyle.THIN, link) for link in lines.links]
    strokes.append((StrokeStyle.THICK, lines.platform))
    return (
        _seen_from("From the front", FRONT, machine.box, strokes, lines.carriages),
        _seen_from("From above", ABOVE, machine.box, strokes, lines.carriages),
    )


def _seen_from(
    title: str,
    axes: tuple[int, int],
    box: Box,
    strokes: list[tuple[StrokeStyle, FloatArray]],
    carriages: FloatArray,
) -> Drawing:
    """Lines in space ``(n, 3)`` seen along the axis that is left out."""
    axes_seen = list(axes)
    flat = [Stroke(look, points_of(line[:, axes_seen])) for look, line in strokes]
    numbers = enumerate(points_of(carriages[:, axes_seen]), start=1)
    return Drawing(
        title=title,
        x_words=f"{'xyz'[axes[0]]}, m",
        y_words=f"{'xyz'[axes[1]]} in m",
        series=(),
        strokes=(_outline(box, axes), *flat),
        labels=tuple(Caption(f"{chain}", at) for chain, at in numbers),
        even=True,
    )


def drawn_postures(machine: HexaSlide, best: BestPostures | None) -> tuple[Drawing, ...]:
    """The four projections of start and optimum in the box."""
    sets = () if best is None else (("start", best.begin), ("optimum", best.coordinates))
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
        title=f"{COMPONENTS[upwards]} over {COMPONENTS[across]}",
        x_words="",
        y_words=unit,
        series=series,
        strokes=(_outline(box, axes),),
    )


def _outline(box: Box, axes: tuple[int, int]) -> Stroke:
    """Dots on the edges of the box."""
    return Stroke(StrokeStyle.MARKED, points_of(_scale_of(axes)[0] * outline(box, axes)))


def _scale_of(axes: tuple[int, int]) -> tuple[float, str]:
    """Places are shown in metres, angles in degrees."""
    return (1.0, "m") if axes[0] < len("xyz") else (180.0 / math.pi, "°")


def residual_charts(result: CalibratedMachine) -> tuple[Chart, ...]:
    """What the calibrated machine leaves at each posture: lengths in µm and angles in µrad, where
    there are any.
    """
    residuals = result.fit.after
    columns = (1e6 * residuals.values).T.tolist()
    posture_numbers = tuple(map(float, result.numbers))
    charts = []
    for title, unit, angular in (("Lengths left", "µm", False), ("Angles left", "µrad", True)):
        series = tuple(
            Series(name, posture_numbers, tuple(column))
            for name, column, is_angle in zip(
                residuals.names, columns, residuals.angular, strict=True
            )
            if bool(is_angle) is angular
        )
        if series:
            charts.append(Chart(title, "posture", unit, series))
    return tuple(charts)


def left_with(numbers: Sequence[int], without: CauseAtSize, now: CauseAtSize) -> Chart:
    """What is left at each posture without a cause and with it, in deviations of the noise."""
    places = tuple(map(float, numbers))
    series = tuple(
        Series(name, places, tuple(at.by_posture.tolist()))
        for name, at in (("without", without), ("with it", now))
    )
    return Chart("Left, r.m.s.", "posture", "times the noise", series)
