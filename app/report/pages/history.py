"""The history of a folder as a page: for each machine its sessions, control charts, events."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

from rich.table import Table

from app.evaluating.history import History, MachineHistory
from app.report.charts.results import control_charts
from app.report.pages.figures import legs_svg
from app.report.pages.two_pages import Picture, Section
from app.report.text import history as texts
from app.version import program

CAPTION = (
    "Change of each joint offset, with the mean and the limits (three standard deviations, by "
    "moving ranges) of each phase. Upright lines: what the records tell was changed. Crosses: "
    "changed beyond uncertainty and limits, or a Western Electric rule. Below: the tool error."
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
        sections=[_section(machine, now) for machine in history.machines],
        program=program(),
    )


def _section(machine: MachineHistory, now: datetime) -> Section:
    table, notes = texts.sessions_table(machine)
    figures = control_charts(machine)
    pictures = [Picture(legs_svg(figures[k : k + 2]), CAPTION) for k in range(0, len(figures), 2)]
    heading = f"{machine.machine}{texts.ORIGIN_WORDS[machine.origin]}"
    parts: list[str | Table | Picture] = [
        texts.machine_sentence(machine, now),
        *texts.drift_lines(machine),
        *pictures,
        table,
        texts.BELOW_TABLE,
        *notes,
    ]
    return Section(heading, parts)
