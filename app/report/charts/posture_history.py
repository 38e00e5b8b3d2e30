"""What the platform was off by over the sessions of a machine."""

from __future__ import annotations

from dataclasses import replace

from app.evaluating.history import History
from app.evaluating.posture_history import PostureHistory
from app.report.charts.charts import Chart, series_of
from app.report.charts.legs import LegFigure
from app.report.charts.results import control_charts


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
