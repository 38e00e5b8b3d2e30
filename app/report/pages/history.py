"""The history of a folder as a page: for each machine its sessions, control charts, events."""

from __future__ import annotations

from datetime import datetime

from rich.table import Table

from app.evaluating.history import History, MachineHistory
from app.report.charts.results import control_charts
from app.report.pages.contents import CalibrationReport, Picture, Section
from app.report.pages.figures import legs_svg
from app.report.text import history as texts
from app.version import program

CAPTION = (
    "Change of each joint offset, with the mean and the limits (three standard deviations, by "
    "moving ranges) of each phase. Upright lines: what the records tell was changed. Crosses: "
    "changed beyond uncertainty and limits, or a Western Electric rule. Below: the tool error."
)


def history_page(found: History, now: datetime) -> CalibrationReport:
    """Files that cannot be used first, then a section for each machine."""
    return CalibrationReport(
        machine=found.folder.absolute().name,
        decision="",
        sentences=[text for _, text in found.problems],
        sections=[_section(one, now) for one in found.machines],
        program=program(),
        title="History",
        signed=False,
    )


def _section(one: MachineHistory, now: datetime) -> Section:
    table, notes = texts.sessions_table(one)
    figures = control_charts(one)
    pictures = [Picture(legs_svg(figures[k : k + 2]), CAPTION) for k in range(0, len(figures), 2)]
    heading = f"{one.machine}{texts.ORIGIN_WORDS[one.origin]}"
    parts: list[str | Table | Picture] = [
        texts.machine_sentence(one, now),
        *texts.drift_lines(one),
        *pictures,
        table,
        texts.BELOW_TABLE,
        *notes,
    ]
    return Section(heading, parts)
