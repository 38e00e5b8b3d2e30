"""The diagnosis screen: its pages, refusals, the ways in and out."""

from __future__ import annotations

import re
from pathlib import Path
from threading import Event

import pytest
from textual.widgets import OptionList, TabbedContent

from app.screens.diagnose import DiagnoseScreen
from app.screens.home import HomeScreen
from app.screens.interface import ChoiceDialog, Glidecal, HelpDialog
from app.screens.plot import ChartPlot
from app.screens.result import ResultScreen
from calib.errors import RecordError
from tests.conftest import LONG, first_quick
from tests.screens.diagnosing import diagnosed, drawn, verdict
from tests.screens.driving import SIZE, said, text, until


@LONG
async def test_pages_by_keys(bowed: Path) -> None:
    interface = Glidecal(DiagnoseScreen([bowed]))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        screen = await diagnosed(pilot, interface)
        assert text(interface, "#heading") == "bow [x].jsonl   against: nominal machine"
        assert verdict(interface).startswith("EXPLAINED. What was missing is: ")
        assert re.search(r"leg_bow \(xy\), machine", verdict(interface))
        assert re.search(r"gap 0\.\d{4} → 0\.\d{4} mm", verdict(interface))
        assert "Held out (one side" in verdict(interface)
        bound = r"Tool over the workspace, .*: at most 0\.\d+ mm now\. With joint offsets"
        assert re.search(bound, " ".join(verdict(interface).split()))
        tabs = screen.query_one(TabbedContent)
        pages = []
        for key in ("2", "3", "4", "1", "right", "tab", "left", "shift+tab"):
            await pilot.press(key)
            await pilot.pause()
            pages.append(tabs.active)
        assert pages == [
            *("where", "candidates", "change", "verdict"),
            *("where", "candidates", "where", "verdict"),
        ]
        assert "▲▲" in text(interface, "#where-text")
        assert "Where the gap lies" in text(interface, "#where-text")
        ranked = text(interface, "#candidates-text")
        assert re.search(r"leg_bow +xy +(> )?0\.\d\d +0\.\d{4} +\d+% +named", ranked)
        assert "no other effect looks like leg_bow (xy)" in ranked
        await pilot.press("4")
        await until(pilot, "chart", lambda: "+ after" in drawn(interface))
        assert "X along Y" in drawn(interface)
        assert "after adopting what was" in text(interface, "#change-text")
        await pilot.press("y")
        assert interface.clipboard == text(interface, "#change-text")
        await pilot.press("f1")
        await until(pilot, "help", lambda: isinstance(interface.screen, HelpDialog))
        await pilot.press("escape", "f10")
    assert interface.return_code == 0


async def test_a_session_that_cannot_be_diagnosed(samples: Path) -> None:
    interface = Glidecal(DiagnoseScreen([samples / "damaged.jsonl"]))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        screen = await diagnosed(pilot, interface)
        assert screen.diagnosed is None
        assert verdict(interface).startswith("This cannot be diagnosed.")
        assert "line 9" in verdict(interface)
        for page in ("where", "candidates", "change"):
            assert text(interface, f"#{page}-text") == verdict(interface)
        assert not screen.query_one("#change-chart0").display
        for key in "any":
            interface.notify("")
            await pilot.press(key)
            await pilot.pause()
            assert said(interface).count("There is no diagnosis") == 1
        await pilot.press("f10")
    assert interface.return_code == 0


async def test_leaving_while_it_looks(bowed: Path) -> None:
    interface = Glidecal(HomeScreen())
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await interface.push_screen(DiagnoseScreen([bowed]))
        assert verdict(interface).startswith("Looking for what is missing")
        await pilot.press("a")
        await until(pilot, "words", lambda: "not ready yet" in said(interface))
        await pilot.press("escape")
        await until(pilot, "home", lambda: isinstance(interface.screen, HomeScreen))
        await interface.workers.wait_for_complete()
        await pilot.press("f10")
    assert interface.return_code == 0


@LONG
async def test_from_home_and_from_the_result(bowed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(bowed.parent)
    interface = Glidecal(HomeScreen())
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await pilot.pause()
        listed = interface.screen.query_one(OptionList)
        ids = [str(option.id) for option in listed.options]
        await pilot.press("home", *["down"] * ids.index("diagnose"), "enter")
        await pilot.pause()
        await pilot.press("home", "enter")
        screen = await diagnosed(pilot, interface)
        assert [path.name for path in screen.adopting.paths] == [bowed.name]
        await pilot.press("escape")
        await until(pilot, "home", lambda: isinstance(interface.screen, HomeScreen))
        steps = ids.index(f"session {bowed.name}")
        await pilot.press("home", *["down"] * steps, "enter")
        await until(pilot, "choice", lambda: isinstance(interface.screen, ChoiceDialog))
        await pilot.press("1")
        await until(pilot, "result", lambda: isinstance(interface.screen, ResultScreen))
        await pilot.press("d")
        screen = await diagnosed(pilot, interface)
        assert verdict(interface).startswith("EXPLAINED.")
        await pilot.press("escape")
        await until(pilot, "result", lambda: isinstance(interface.screen, ResultScreen))
        await pilot.press("f10")


async def test_a_result_is_worked_out_once_however_long_its_key_is_held(
    bowed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ended, begun = Event(), list[object]()

    def solved(*paths: object, **_: object) -> ResultScreen:
        begun.append(paths)
        ended.wait()
        raise RecordError("session", "no result", "one")

    monkeypatch.setattr("app.screens.result.result_of", solved)
    interface = Glidecal(DiagnoseScreen([bowed]))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await diagnosed(pilot, interface)
        await pilot.press(*"lllll")
        assert len(begun) == 1
        ended.set()
        await until(pilot, "why not", lambda: "no result" in said(interface))
        await pilot.press("l")
        await until(pilot, "another one", lambda: len(begun) == 2)
        await pilot.press("f10")


async def test_the_small_choice_of_a_session(bowed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(bowed.parent)
    interface = Glidecal(HomeScreen(), read_only=True)
    async with interface.run_test(size=SIZE) as pilot:
        await pilot.pause()
        await pilot.press("end", "enter")
        await until(pilot, "choice", lambda: isinstance(interface.screen, ChoiceDialog))
        listed = [str(o.prompt) for o in interface.screen.query_one(OptionList).options]
        await pilot.press(next(o for o in listed if o.endswith("Diagnose"))[0])
        await diagnosed(pilot, interface)
        assert verdict(interface).startswith("EXPLAINED.")
        await pilot.press("f10")


@LONG
@pytest.mark.parametrize("size", first_quick([SIZE, (120, 40)]))
async def test_no_line_is_cut_off(doubtful: Path, size: tuple[int, int]) -> None:
    interface = Glidecal(DiagnoseScreen([doubtful]))
    async with interface.run_test(size=size) as pilot:
        screen = await diagnosed(pilot, interface)
        for page in ("verdict", "where", "candidates", "change"):
            lines = text(interface, f"#{page}-text").splitlines()
            assert max(map(len, lines)) <= 76
        await pilot.press("4")
        await until(pilot, "chart", lambda: "displacement from left" in drawn(interface))
        chart = screen.query_one("#change-chart0", ChartPlot)
        assert chart.size.height > size[1] / 2
        assert "x noise   o before   + after adopting" in drawn(interface)
        await pilot.press("f10")
