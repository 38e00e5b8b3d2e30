"""The history on a screen: from home and back, with a line where something was changed."""

from __future__ import annotations

import shutil
from datetime import timedelta
from pathlib import Path

import pytest
from textual.widgets import OptionList

from app.evaluating.history import read_history
from app.screens.history import HistoryScreen
from app.screens.home import HomeScreen
from app.screens.start import Glidecal
from protocols.journal import write_whole
from protocols.record import read_record
from protocols.session import Line, Reading
from tests.conftest import SAMPLES
from tests.screens.driving import SIZE, history_shown, rows, until

SESSION = SAMPLES / "experiment_2_twelve.jsonl"


async def test_home_leads_to_the_history_and_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copy(SESSION, tmp_path / "a [b].jsonl")
    monkeypatch.chdir(tmp_path)
    interface = Glidecal(HomeScreen())
    async with interface.run_test(size=SIZE) as pilot:
        await pilot.pause()
        choices = interface.screen.query_one(OptionList)
        choices.highlighted = [option.id for option in choices.options].index("history")
        await pilot.press("enter")
        assert "a [b].jsonl" in await history_shown(pilot, interface)
        await pilot.press("escape")
        await until(pilot, "home", lambda: isinstance(interface.screen, HomeScreen))
        await pilot.press("f10")


async def test_entered_offsets_are_a_line_in_the_plot(tmp_path: Path) -> None:
    record = read_record(SESSION)
    readings: list[Line] = [one for one in record.events if isinstance(one, Reading)]
    for month in range(3):
        machine = record.opened.machine
        if month > 1:
            machine = machine.model_copy(update={"entered_offsets_mm": (0.1, 0.0, 0.0)})
        when = record.opened.at + timedelta(days=30 * month)
        opened = record.opened.model_copy(update={"at": when, "machine": machine})
        write_whole(tmp_path / f"{month}.jsonl", opened, readings)
    found = read_history(tmp_path)
    interface = Glidecal(HistoryScreen(found))
    async with interface.run_test(size=SIZE) as pilot:
        await pilot.pause()
        await pilot.press("tab")
        await pilot.pause(0.1)
        shown = rows(interface.screen)
        assert any("joint x, change of the offset (1 of 3)" in row for row in shown)
        # two sides of the frame, and between them the line at day 60
        assert sum(row.count("│") == 3 for row in shown) >= 4
        await pilot.press("minus")
        await pilot.pause(0.1)
        assert any(
            "joint z, change of the offset (3 of 3)" in row for row in rows(interface.screen)
        )
        await pilot.press("f10")
