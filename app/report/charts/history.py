"""What was measured of a machine over its sessions: joint offsets, or the platform."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

from app.evaluating.history import History, MachineHistory
from app.evaluating.posture_history import PostureHistory
from app.report.charts.charts import Chart, Point, Series, Stroke, StrokeStyle, series_of
from app.report.charts.legs import FIRST, OTHER, LegFigure
from calib.arrays import LEG_NAMES
from calib.control_chart import WatchedQuantity

LEAST_DAYS = (0.0, 6.0)
"""The axis of a history has at least these: sessions of one day stand at its start."""


def control_charts(machine: MachineHistory) -> tuple[LegFigure, ...]:
    """A control chart of each joint offset, and below it what the tool was off by.

    With centre and limits of each phase, and lines where the records tell of a change.
    """
    started_mm = machine.points[0].entry.offsets_mm or ()
    marks = tuple(d for d, point in zip(machine.days, machine.points, strict=True) if point.event)
    tool_um = [1000.0 * point.entry.bound_before_mm for point in machine.points]
    tolerance_mm = machine.last.machine.tool_tolerance_mm
    limit = [
        Stroke(StrokeStyle.DOTTED, tuple((d, 1000.0 * (tolerance_mm or 0.0)) for d in machine.days))
    ]
    tool = Chart(
        f"tool error, at most, as found{'; dotted: tolerance' if tolerance_mm else ''}",
        "days since the first session",
        "µm",
        (series_of("", list(zip(machine.days, tool_um, strict=True)), FIRST),),
        marks=marks,
        strokes=tuple(limit if tolerance_mm else []),
        x_room=LEAST_DAYS,
    )
    figures = []
    for name, watched, start_mm in zip(LEG_NAMES, machine.joints, started_mm, strict=False):
        title = f"{machine.machine}, joint {name}, change of the offset"
        chart = Chart(
            title,
            "",
            "µm",
            _sessions(machine.days, watched),
            marks=marks,
            strokes=tuple(_limits(machine.days, watched, start_mm)),
            x_room=LEAST_DAYS,
        )
        figures.append(LegFigure(title, f"Joint {name}", chart, tool))
    return tuple(figures)


def _sessions(days: Sequence[float], joint: WatchedQuantity) -> tuple[Series, ...]:
    """The change of an offset in each session, those that a limit or a rule marks apart."""
    points: dict[str, list[Point]] = {FIRST: [], OTHER: []}
    changes_um = (1000.0 * joint.change).tolist()
    states = zip(joint.chart.changed, joint.chart.signals, strict=True)
    for day, um, (new, rules) in zip(days, changes_um, states, strict=True):
        points[OTHER if new or rules else FIRST].append((day, um))
    names = {FIRST: "session", OTHER: "changed, or a rule"}
    return tuple(series_of(names[mark], at, mark) for mark, at in points.items() if at)


def _limits(days: Sequence[float], joint: WatchedQuantity, start_mm: float) -> Iterator[Stroke]:
    """The centre and the limits of each phase; a phase of one session has no limits."""
    phases: dict[tuple[float, float], list[float]] = {}
    rows = zip(days, joint.chart.centre.tolist(), joint.chart.limit.tolist(), strict=True)
    for day, centre, limit in rows:
        phases.setdefault((centre, limit), []).append(day)
    for (centre, limit), days_of_phase in phases.items():
        styles = (StrokeStyle.THIN, StrokeStyle.DOTTED, StrokeStyle.DOTTED)
        for style, aside in zip(styles, (0.0, limit, -limit), strict=True):
            um = 1000.0 * (centre - start_mm + aside)
            if not math.isnan(um):
                yield Stroke(style, tuple((day, um) for day in days_of_phase))


def platform_chart(machine: PostureHistory) -> Chart:
    """What the platform was off by in each session, and at most with the machine of it, mm."""
    entries = [(float(k), point.entry) for k, point in enumerate(machine.points, start=1)]
    off = [(k, entry.now_mm) for k, entry in entries if entry.now_mm is not None]
    bound = [(k, entry.bound_mm) for k, entry in entries if entry.bound_mm is not None]
    columns = (("as found", off), ("bound, calibrated", bound))
    series = tuple(series_of(name, points) for name, points in columns if points)
    names = tuple(f"{k:.0f}" for k, _ in entries)
    return Chart("Error of the platform", "", "mm r.m.s.", series, names)


def history_figures(history: History) -> list[LegFigure]:
    """Figures of joint offsets and of platforms, machine by machine."""
    figures = [figure for machine in history.machines for figure in control_charts(machine)]
    return [*figures, *map(platform_figure, history.of_postures)]


def platform_figure(machine: PostureHistory) -> LegFigure:
    """The figure for a screen: as the machine was found, and what each session gave."""
    chart = platform_chart(machine)
    title = f"{machine.machine}, error of the platform as found"
    platform_series, *bound = (replace(series, name="") for series in chart.series)
    return LegFigure(
        title,
        "Platform",
        replace(chart, title=title, series=(platform_series,)),
        replace(chart, title="at most, with the machine of the session", series=tuple(bound)),
    )
