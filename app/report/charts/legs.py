"""A picture of each leg and axis: readings over the displacement, and below what a fit leaves.

Whoever measured a circle with a ballbar reads its picture before any number. This is that of a leg:
play is a split, a tilt a slope, a screw a wave, a bow a parabola. All pictures of a session have
the same two scales.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from app.evaluating.solution import SessionSolution
from app.report.charts.charts import Chart, Point, Series, Stroke, StrokeStyle, points_of, series_of
from calib.arrays import LEG_NAMES, TOOL
from calib.tripod.curves import LegCurve

UM_PER_MM = 1000.0

NOISE_ROOM = 4.0
"""Standard deviations of a reading for which there is room: noise does not fill a picture."""

UP, DOWN, FIRST, OTHER = ">", "<", "o", "x"
NAMES = {UP: "towards +", DOWN: "towards −", FIRST: "first", OTHER: "reading"}


@dataclass(frozen=True)
class LegFigure:
    """``readings`` in mm with the fit, and below them what is ``left`` in µm.

    ``left`` is drawn so many times larger, ``enlarged``. The history has its charts in such a pair.
    """

    title: str
    short_title: str
    readings: Chart
    left: Chart
    enlarged: float = 1.0

    @property
    def charts(self) -> tuple[Chart, Chart]:
        """Both charts, from top to bottom."""
        return self.readings, self.left


def leg_figures(result: SessionSolution) -> tuple[LegFigure, ...]:
    """One for each leg, axis and station; the fit is that of `SessionSolution.curves`."""
    curves = result.curves
    several = len({curve.station for curve in curves if not curve.over_plane}) > 1
    readings = [_readings(curve) for curve in curves]
    figures_left = [_residual_chart(curve) for curve in curves]
    noise = result.solution.noise  # of residuals it is what the pictures show
    noise_known = noise.source != "residuals"
    noise_um = NOISE_ROOM * UM_PER_MM * noise.standard_deviation_mm if noise_known else 0.0
    readings, figures_left = _on_one_scale(readings), _on_one_scale(figures_left, noise_um)
    figures = []
    for curve, above, below in zip(curves, readings, figures_left, strict=True):
        title, short_title = leg_words(curve, several=several)
        enlarged = UM_PER_MM * _height(above) / _height(below)
        residual_chart = replace(below, title=f"{left_by(result)}, {scale_words(enlarged)}")
        figures.append(
            LegFigure(title, short_title, replace(above, title=title), residual_chart, enlarged)
        )
    return tuple(figures)


def scale_words(enlarged: float) -> str:
    """The scale of what is left beside that of the readings above it."""
    if enlarged < 1.0:
        return f"at {enlarged:.2g} of the scale above"
    return f"{enlarged:.3g} times enlarged"


def left_by(result: SessionSolution) -> str:
    """What was fitted, in words."""
    adopted = result.solution.model.effects
    return "left by the model with its effects" if adopted else "left by offsets and lengths"


def leg_words(curve: LegCurve, *, several: bool) -> tuple[str, str]:
    """Which bar was read, in which direction; where on it, if ``several`` stations were.

    Then the same where there is little room.
    """
    axis = LEG_NAMES[curve.axis].upper()
    if curve.leg == TOOL:
        return f"Tool against the plate, along {axis}", f"Tool along {axis}"
    leg = f"Leg {LEG_NAMES[curve.leg].upper()}"
    station, short_station = "", ""
    if several:
        station = f", at {curve.station:g} of the bar"
        short_station = f", station {curve.station:g}"
    label = f"{leg}, measured along {axis}{station}"
    if curve.over_plane:
        label = f"{leg} over the plane, along {axis}"
    return label, f"{leg} along {axis}{short_station}"


def _readings(curve: LegCurve) -> Chart:
    lines = tuple(Stroke(StrokeStyle.THIN, points_of(line)) for line in curve.model_mm)
    return Chart("", "", "mm", _series(curve, curve.value_mm.tolist()), strokes=lines)


def _residual_chart(curve: LegCurve) -> Chart:
    """The way through the readings in time is a thin line, which shows what comes and goes."""
    left_um = (UM_PER_MM * curve.left_mm).tolist()
    at_mm, mounts = curve.at_mm.tolist(), curve.mount.tolist()
    ways: dict[int, list[Point]] = {}
    for mount, at, residual_um in zip(mounts, at_mm, left_um, strict=True):
        ways.setdefault(mount, []).append((at, residual_um))
    lines = tuple(Stroke(StrokeStyle.DOTTED, tuple(points)) for points in ways.values())
    series = tuple(replace(part, name="") for part in _series(curve, left_um))  # named above
    label = "displacement, mm"
    if curve.leg == TOOL:
        label = "number of the position"
    elif curve.over_plane:
        label = "place along the leg, mm"
    return Chart("", label, "µm", series, strokes=lines)


def _series(curve: LegCurve, values: Sequence[float]) -> tuple[Series, ...]:
    """Points by the direction from which they were reached; the first of each mounting apart."""
    first = set(curve.first.tolist())
    points: dict[str, list[Point]] = {UP: [], DOWN: [], OTHER: [], FIRST: []}
    rows = zip(curve.at_mm.tolist(), values, curve.approach.tolist(), strict=True)
    for row, (at, value, approach) in enumerate(rows):
        mark = FIRST if row in first else UP if approach > 0 else DOWN if approach < 0 else OTHER
        points[mark].append((at, value))
    return tuple(series_of(NAMES[mark], at, mark) for mark, at in points.items() if at)


def _on_one_scale(charts: Sequence[Chart], least: float = 0.0) -> list[Chart]:
    """Scales that hold what all of them show, and at least so much on both sides."""
    values = [-least, least, *(y for chart in charts for _, y in chart.points())]
    return [replace(chart, room=(min(values), max(values))) for chart in charts]


def _height(chart: Chart) -> float:
    ticks = chart.y_ticks()
    return ticks[-1] - ticks[0]
