"""The history on a screen: from home and back, with a line where something was changed."""

from __future__ import annotations

import shutil
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from threading import Event

import pytest
from textual.screen import Screen
from textual.widgets import OptionList, TabbedContent, TabPane

from app.evaluating.history import Entry, History, history_of_machine, read_history
from app.evaluating.posture_history import PostureEntry, posture_history
from app.report.charts.characters import chart_text
from app.report.charts.history import control_charts, platform_figure
from app.report.text.history import machine_parts
from app.screens.history import HistoryScreen
from app.screens.home import HomeScreen
from app.screens.interface import Glidecal
from app.screens.plot import ChartPlot
from protocols.journal import write_whole
from protocols.machine import load_machine
from protocols.record import read_record
from protocols.session import Line, Reading
from tests.conftest import LONG, SAMPLES, first_quick
from tests.screens.driving import SIZE, history_shown, rows, text, until

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


async def test_a_large_folder_is_shown_before_all_of_it_is_worked_out(tmp_path: Path) -> None:
    """The screen says how many are left, and adds machines and sessions as they come."""
    whole = thirty_machines()
    parts = [
        replace(
            whole, all_machines=whole.machines[:count], sessions=1020, waiting=1020 - 34 * count
        )
        for count in (0, 1, 30)
    ]
    ready, following = Event(), iter(parts[1:])

    def more() -> History:
        ready.wait(10.0)
        return next(following)

    interface = Glidecal(HistoryScreen(parts[0], more))
    async with interface.run_test(size=SIZE) as pilot:
        await until(pilot, "the screen", lambda: interface.screen.query(OptionList))
        listed = interface.screen.query_one(OptionList)
        left = "1,020 of 1,020 sessions are still worked out"
        await until(pilot, "what is left", lambda: left in text(interface, "#heading"))
        assert listed.option_count == 0
        ready.set()
        await until(pilot, "the others", lambda: listed.option_count == 30)
        assert "worked out" not in text(interface, "#heading")
        assert "WAIT" not in text(interface, "#machines-text")
        assert text(interface, "#history-text").startswith("machine 0: 34 sessions.")
        await pilot.press("escape", "f10")


@LONG
async def test_entered_offsets_are_a_line_in_the_plot(tmp_path: Path) -> None:
    record = read_record(SESSION)
    for month in range(3):
        machine = record.opened.machine
        readings: list[Line] = [  # others each time: the same table is one session
            event.model_copy(update={"value_mm": event.value_mm + 1e-5 * month, "text": f"{month}"})
            for event in record.events
            if isinstance(event, Reading)
        ]
        if month > 1:
            machine = machine.model_copy(update={"entered_offsets_mm": (0.1, 0.0, 0.0)})
        when = record.opened.at + timedelta(days=30 * month)
        opened = record.opened.model_copy(update={"at": when, "machine": machine})
        write_whole(tmp_path / f"{month}.jsonl", opened, readings)
    history = read_history(tmp_path)
    interface = Glidecal(HistoryScreen(history))
    async with interface.run_test(size=SIZE) as pilot:
        await pilot.pause()
        await pilot.press("tab")
        await pilot.pause(0.1)
        screen_rows = rows(interface.screen)
        assert any("joint x, change of the offset (1 of 3)" in row for row in screen_rows)
        # two sides of the frame, and between them the line at day 60
        assert sum(sum(map(row.count, "│┤")) == 3 for row in screen_rows) >= 4
        await pilot.press("minus")
        await pilot.pause(0.1)
        assert any(
            "joint z, change of the offset (3 of 3)" in row for row in rows(interface.screen)
        )
        await pilot.press("f10")


def test_the_heading_says_which_machine_and_where() -> None:
    identity = {"serial_number": "OG-7", "place": "hall 3"}
    entry = Entry(
        began=datetime(2026, 1, 1, tzinfo=UTC),
        machine=load_machine(None).model_copy(update=identity),
        offsets_mm=(0.0, 0.0, 0.0),
        expanded_mm=(0.01, 0.01, 0.01),
    )
    machine = history_of_machine(entry.machine.title, "measured", [(Path("a.jsonl"), entry)])
    words = machine_parts(machine, entry.began)[0]
    assert words.startswith("orthoglide, no. OG-7, hall 3: 1 session. Last calibrated today")
    undated = entry.model_copy(update={"dated": False, "origin": "imported"})
    table = history_of_machine(entry.machine.title, "imported", [(Path("a.jsonl"), undated)])
    assert "Last imported today: a.jsonl" in machine_parts(table, entry.began)[0]


def test_one_day_has_an_axis_of_whole_days(tmp_path: Path) -> None:
    """Of one session, too: no thousandth of a day."""
    shutil.copy(SESSION, tmp_path)
    (machine,) = read_history(tmp_path).machines
    for figure in control_charts(machine):
        for chart in figure.charts:
            labels = chart_text(chart, 12).splitlines()[-2].split()
            assert labels == ["0", "1", "2", "3", "4", "5", "6"]


def thirty_machines() -> History:
    """A thousand sessions of thirty machines, without files."""
    machine, began = load_machine(None), datetime(2024, 1, 1, tzinfo=UTC)
    machines = []
    for number in range(30):
        named = machine.model_copy(update={"name": f"machine {number}"})
        entries = [
            Entry(
                began=began + timedelta(days=20 * k),
                machine=named,
                offsets_mm=(0.001 * (k % 3), 0.0003 * k, 0.0),
                expanded_mm=(0.01, 0.01, 0.01),
                bound_before_mm=0.1,
            )
            for k in range(1000 // 30 + 1)
        ]
        files = [(Path(f"{number}-{k}.jsonl"), entry) for k, entry in enumerate(entries)]
        machines.append(history_of_machine(named.name, "measured", files))
    return History(Path(), tuple(machines), ())


@pytest.mark.parametrize("size", first_quick([SIZE, (40, 20)]))
async def test_a_machine_of_thirty_is_chosen(size: tuple[int, int]) -> None:
    """A list of machines first; Enter shows the sessions of one, and its three charts alone."""
    interface = Glidecal(HistoryScreen(thirty_machines()))
    async with interface.run_test(size=size) as pilot:
        await pilot.pause()
        screen = interface.screen
        assert [pane.id for pane in screen.query(TabPane)] == ["machines", "history", "charts"]
        machines = screen.query_one(OptionList)
        assert machines.option_count == 30
        assert "machine 0: 34 sessions, last 2025-10-22" in str(machines.options[0].prompt)
        assert machines.has_focus
        await pilot.press(*["down"] * 11, "enter")
        await until(pilot, "sessions", lambda: page(screen) == "history")
        words = " ".join(text(interface, "#history-text").split())
        assert words.startswith("machine 11: 34 sessions.")
        assert words.count("sessions. Last calibrated") == 1
        assert words.count("Drift of joint y: +0.5 ± 0.") == 1
        assert "Drift of joint z" not in words, "nothing moves there"
        assert "Rule 4, eight in a row on one side, joint y: first in session" in words
        assert words.count("eight in a row") == 1, "one sentence, whatever the number of sessions"
        await pilot.press("minus")
        await pilot.pause()
        title = str(screen.query(ChartPlot).first().render()).splitlines()[0]
        assert "machine 11, joint z" in title, "where there is little room, too"
        assert ("(3 of 3)" in title) == (size == SIZE)
        await pilot.press("1")
        await until(pilot, "machines", lambda: page(screen) == "machines" and machines.has_focus)
        await pilot.press("escape", "f10")


def page(screen: Screen[object]) -> str:
    """The page that is shown."""
    return screen.query_one(TabbedContent).active


async def test_a_machine_of_postures_has_charts() -> None:
    """What the platform was off by in each session, and below it what it keeps."""
    began = datetime(2026, 1, 1, tzinfo=UTC)
    entries = [
        (
            Path(f"{k}.jsonl"),
            PostureEntry(
                began=began + timedelta(days=30 * k),
                name="six",
                machine={},
                now_mm=0.2 + 0.1 * k,
                bound_mm=None if k == 1 else 0.05,
            ),
        )
        for k in range(3)
    ]
    history = History(Path(), (posture_history("six", "measured", entries),), ())
    interface = Glidecal(HistoryScreen(history))
    async with interface.run_test(size=SIZE) as pilot:
        await pilot.pause()
        await pilot.press("plus")
        await pilot.pause(0.1)
        screen_rows = rows(interface.screen)
        assert any("six, error of the platform as found (1 of 1)" in row for row in screen_rows)
        assert any("at most, with the machine of the session" in row for row in screen_rows)
        await pilot.press("f10")


def test_without_a_bound_there_is_no_point_of_it() -> None:
    entry = PostureEntry(began=datetime(2026, 1, 1, tzinfo=UTC), name="six", machine={}, now_mm=0.2)
    figure = platform_figure(posture_history("six", "measured", [(Path("0.jsonl"), entry)]))
    assert not figure.left.series
    assert figure.left.y_ticks()
