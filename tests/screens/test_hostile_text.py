"""Text of strangers on screens: nothing of it reaches the terminal as a control character."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from textual.pilot import Pilot
from textual.screen import Screen
from textual.widgets import DataTable, Label, Static

from app.screens.home import HomeScreen
from app.screens.interface import Glidecal
from app.screens.replay import ReplayScreen
from calib.printable import HIDDEN
from tests.app.commands.hostile_files import ESCAPES, chained
from tests.conftest import SAMPLES
from tests.screens.driving import SIZE, strips, text, until


def hostile_record(folder: Path) -> Path:
    """A simulated session whose every name is hostile, its digests right."""
    source = (SAMPLES / "simulated_zero-max-min.jsonl").read_text()
    events = [json.loads(line) for line in source.splitlines()]
    opened = events[0] | {"operator": ESCAPES, "remarks": [ESCAPES]}
    opened["machine"]["name"] = opened["procedure"]["title"] = ESCAPES
    for event in events:
        if event["event"] == "reading":
            event["mount"] += ESCAPES
    path = folder / f"s{ESCAPES}.jsonl"
    path.write_bytes(chained([opened, *events[1:]]))
    return path


def shown(screen: Screen[Any]) -> str:
    """Everything that is sent to the terminal of this screen, without its styles."""
    sent = strips(screen)
    assert all(strip.cell_length == SIZE[0] for strip in sent)
    return "\n".join(segment.text for strip in sent for segment in strip)


async def assert_clean(pilot: Pilot[str], interface: Glidecal) -> None:
    await pilot.pause()
    raw = shown(interface.screen)
    assert raw.strip()
    assert set(HIDDEN.findall(raw)) <= {"\n"}


async def test_a_hostile_record_is_replayed(tmp_path: Path) -> None:
    interface = Glidecal(ReplayScreen(hostile_record(tmp_path)))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await until(pilot, "the picture", lambda: "step" in text(interface, "#progress"))
        await assert_clean(pilot, interface)
        for key in ("right", "right", "right", "e", "end", "f1"):
            await pilot.press(key)
            await assert_clean(pilot, interface)


async def test_a_hostile_record_is_listed_at_home(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hostile_record(tmp_path)
    monkeypatch.chdir(tmp_path)
    interface = Glidecal(HomeScreen())
    async with interface.run_test(size=SIZE) as pilot:
        await until(pilot, "the list", lambda: "owned" in shown(interface.screen))
        await assert_clean(pilot, interface)


async def test_every_kind_of_widget_is_filtered() -> None:
    """The filter is of the interface: no screen and no widget can forget it."""
    screen: Screen[None] = Screen()
    interface = Glidecal(screen)
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        table: DataTable[str] = DataTable()
        framed = Static(ESCAPES, markup=False)
        framed.styles.border = ("round", "white")
        framed.border_title = ESCAPES.replace("[", "")
        await screen.mount(framed, Label(ESCAPES, markup=False), table)
        table.add_column("x")
        table.add_row(ESCAPES.replace("[", ""))
        interface.notify(ESCAPES, markup=False)
        await assert_clean(pilot, interface)
        assert "owned" in shown(screen)
