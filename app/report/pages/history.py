"""The history of a folder as a page: for each machine its sessions, control charts, events."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime

from rich.table import Table

from app.evaluating.history import History, MachineHistory
from app.evaluating.posture_history import PostureHistory
from app.report.charts.history import control_charts, platform_chart
from app.report.charts.legs import LegFigure
from app.report.pages.figures import legs_svg, svg_of
from app.report.pages.two_pages import Picture, PrintedPage, Section
from app.report.text import history as texts

CAPTION = (
    "Change of each joint offset, with the mean and the limits (three standard deviations, by "
    "moving ranges) of each phase."
)
EVENTS = " Upright lines: what the records tell was changed."
CROSSES = " Crosses: changed beyond uncertainty and limits, or a Western Electric rule."
BELOW = " Below: what the tool was off by at most, as it was found{}."
TOLERANCE = "; dotted: the tolerance"
PLATFORM_CAPTION = (
    "What the platform was off by, r.m.s. over the box, as it was found, and the bound (95 %) with "
    "the machine that the session gives. Frames that a session does not show are laid over."
)


def history_page(history: History, now: datetime) -> PrintedPage:
    """Files that cannot be used first, a table of several machines, a section for each."""
    several, title = len(history.all_machines) > 1, f"History: {history.folder.absolute().name}"
    return PrintedPage(
        title=title,
        identification=title,
        sentences=[*texts.waiting_sentences(history), *(text for _, text in history.problems)],
        sections=[
            Section("Machines", [texts.machines_table(history)] if several else []),
            *(_section(past, now) for past in history.all_machines),
        ],
    )


def _section(past: MachineHistory | PostureHistory, now: datetime) -> Section:
    sentence, drifts, table, sentence_below, notes = texts.machine_parts(past, now)
    if isinstance(past, PostureHistory):
        picture = Picture(svg_of(platform_chart(past)), PLATFORM_CAPTION)
    else:
        joints = [_narrow(joint) for joint in control_charts(past)]
        picture = Picture(legs_svg(joints), _caption(past))
    parts: list[str | Table | Picture] = [sentence, *drifts, picture, table, sentence_below, *notes]
    return Section(texts.title_of(past), parts)


def _narrow(joint: LegFigure) -> LegFigure:
    """The figure with short titles, for three beside each other; machine and tolerance are around
    them.
    """
    readings = replace(joint.readings, title=joint.short_title)
    return replace(joint, readings=readings, left=replace(joint.left, title="Tool error"))


def _caption(machine: MachineHistory) -> str:
    """Caption of what is on the charts, and of nothing else."""
    changed = any(
        bool(joint.chart.changed.any()) or any(joint.chart.signals) for joint in machine.joints
    )
    tolerance = machine.last.machine.tool_tolerance_mm is not None
    return "".join(
        [
            CAPTION,
            EVENTS if any(point.event for point in machine.points) else "",
            CROSSES if changed else "",
            BELOW.format(TOLERANCE if tolerance else ""),
        ]
    )
