"""The history of a folder as a page: for each machine its sessions, control charts, events."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

from rich.table import Table

from app.evaluating.history import History, MachineHistory
from app.evaluating.posture_history import PostureHistory
from app.report.charts.posture_history import platform_chart
from app.report.charts.results import control_charts
from app.report.pages.figures import legs_svg, svg_of
from app.report.pages.two_pages import Picture, Section
from app.report.text import history as texts
from app.version import program

CAPTION = (
    "Change of each joint offset, with the mean and the limits (three standard deviations, by "
    "moving ranges) of each phase. Upright lines: what the records tell was changed. Crosses: "
    "changed beyond uncertainty and limits, or a Western Electric rule. Below: the tool error."
)
PLATFORM_CAPTION = (
    "What the platform was off by, r.m.s. over the box, as it was found, and the bound (95 %) with "
    "the machine that the session gives."
)


@dataclass(frozen=True)
class HistoryPage:
    """Sentences on files that cannot be used, and a section for each machine of a folder."""

    folder: str
    sentences: Sequence[str]
    sections: Sequence[Section]
    program: str

    @property
    def title(self) -> str:
        """Of the page."""
        return f"History: {self.folder}"

    @property
    def identification(self) -> str:
        """Of each printed page."""
        return self.title


def history_page(history: History, now: datetime) -> HistoryPage:
    """Files that cannot be used first, then a section for each machine."""
    return HistoryPage(
        folder=history.folder.absolute().name,
        sentences=[text for _, text in history.problems],
        sections=[
            *(_section(machine, now) for machine in history.machines),
            *(_posture_section(machine, now) for machine in history.of_postures),
        ],
        program=program(),
    )


def _posture_section(machine: PostureHistory, now: datetime) -> Section:
    table, notes = texts.posture_sessions_table(machine)
    heading = f"{machine.machine}{texts.ORIGIN_WORDS[machine.origin]}"
    picture = Picture(svg_of(platform_chart(machine)), PLATFORM_CAPTION)
    sentence = texts.posture_machine_sentence(machine, now)
    return Section(heading, [sentence, picture, table, texts.BELOW_POSTURES, *notes])


def _section(machine: MachineHistory, now: datetime) -> Section:
    table, notes = texts.sessions_table(machine)
    figures = control_charts(machine)
    pictures = [Picture(legs_svg(figures[k : k + 2]), CAPTION) for k in range(0, len(figures), 2)]
    heading = f"{texts.title_of(machine)}{texts.ORIGIN_WORDS[machine.origin]}"
    parts: list[str | Table | Picture] = [
        texts.machine_sentence(machine, now),
        *texts.drift_lines(machine),
        *pictures,
        table,
        texts.BELOW_TABLE,
        *notes,
    ]
    return Section(heading, parts)
