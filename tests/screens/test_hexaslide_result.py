"""Sessions of postures on screens: opened from home, looked at, written, served."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from textual.pilot import Pilot
from textual.widgets import OptionList, TabbedContent

from app.evaluating.hexaslide import posture_result
from app.machines.registry import LOOKS
from app.report.schema.hexaslide import HexaSlideCalibrationReport
from app.report.text.hexaslide_result import glance_text, next_text
from app.screens.hexaslide_result import HexaSlideResultScreen
from app.screens.home import HomeScreen, ReplayChoiceScreen
from app.screens.interface import ChoiceDialog, Glidecal
from tests.app.posture_sessions import posture_session
from tests.conftest import LONG
from tests.screens.driving import SIZE, history_shown, looked, rows, said, text, until
from tests.screens.test_serving_reports import listed

PAGES = ("result", "details", "left", "diagnosis", "readings")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    folder = tmp_path_factory.mktemp("recorded")
    return posture_session(folder / "s.jsonl", "position", 12).read_bytes()


@pytest.fixture
def session(recorded: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    path = tmp_path / "a [b].jsonl"
    path.write_bytes(recorded)
    monkeypatch.chdir(tmp_path)
    return path


async def chosen(pilot: Pilot[str], interface: Glidecal, name: str) -> None:
    """A choice of a list, by its id or, in a dialog, its answer."""
    choices = interface.screen.query_one(OptionList)
    choices.highlighted = [option.id for option in choices.options].index(name)
    await pilot.press("enter")


@LONG
async def test_home_opens_a_session_of_postures(session: Path) -> None:
    interface = Glidecal(HomeScreen(), looks=LOOKS)
    async with interface.run_test(size=SIZE) as pilot:
        await pilot.pause()
        assert any("24 readings, closed" in row for row in rows(interface.screen))
        await chosen(pilot, interface, f"session {session.name}")
        await until(pilot, "choices", lambda: isinstance(interface.screen, ChoiceDialog))
        await pilot.press("enter")
        screen = await looked(pilot, interface, HexaSlideResultScreen)
        assert "AGREES." in text(interface, "#result-text")
        assert "FAIL: the platform is off by" in text(interface, "#result-text")
        for number, page in enumerate(PAGES, start=1):
            await pilot.press(f"{number}")
            await until(pilot, page, lambda page=page: active(screen) == page)
        assert "46" not in text(interface, "#details-text").split("Condition")[0].split()
        assert text(interface, "#readings-text").count("\n") >= 24
        await pilot.press("escape")
        await until(pilot, "home", lambda: isinstance(interface.screen, HomeScreen))
        await pilot.press("f10")


def active(screen: HexaSlideResultScreen) -> str:
    return screen.query_one(TabbedContent).active


async def test_the_machine_and_the_report_are_written(session: Path) -> None:
    interface = Glidecal(HexaSlideResultScreen(session))
    async with interface.run_test(size=SIZE) as pilot:
        await looked(pilot, interface, HexaSlideResultScreen)
        assert "Next: E writes the calibrated machine" in text(interface, "#result-text")
        await pilot.press("e")
        folder = session.with_suffix("")
        await until(pilot, "written", lambda: "Written to" in said(interface))
        assert sorted(path.name for path in folder.iterdir()) == [
            "calib.hal",
            "hexaslidekins.comp",
            "machine.toml",
        ]
        shown = text(interface, "#result-text")
        assert "E writes" not in shown  # what was done is not the next thing
        assert f"Next: enter the calibrated machine from {folder.name}" in shown
        assert "49 parameters are entered: a [b] has them as files" in shown
        await pilot.press("r")
        await until(pilot, "choices", lambda: isinstance(interface.screen, ChoiceDialog))
        await pilot.press("enter")
        await until(pilot, "report", lambda: "Report written" in said(interface))
        assert session.with_suffix(".html").stat().st_size > 50_000
        await pilot.press("f10")


@pytest.mark.parametrize("tolerance_mm", [None, 0.1])
def test_bars_stand_against_the_tolerance_where_one_is_stated(
    session: Path, tolerance_mm: float | None
) -> None:
    result = posture_result(session)
    source = result.calibration.source
    machine = source.machine.model_copy(update={"platform_tolerance_mm": tolerance_mm})
    source = source.model_copy(update={"machine": machine})
    solved = replace(result.calibration, source=source)
    page = glance_text(replace(result, calibration=solved), 76, read_only=False)
    lines, words = page.splitlines(), " ".join(page.split())
    now, after = (line for line in lines if line.startswith(("now ", "after ")))
    assert len(now) <= 76
    assert now.count("█") > after.count("█")
    assert ("│ tolerance 0.1 mm" in page) == (tolerance_mm is not None)
    assert "tolerance none" not in page
    assert ("NOT JUDGED" in page) == (tolerance_mm is None)
    assert ("State platform_tolerance_mm in the machine file" in words) == (tolerance_mm is None)


def test_a_machine_that_is_not_better_is_not_entered(session: Path) -> None:
    document = HexaSlideCalibrationReport.of(posture_result(session).calibration)
    now_mm = document.platform.now_rms_mm
    platform = document.platform.model_copy(update={"bound_rms_mm": now_mm})
    worse = document.model_copy(update={"platform": platform})
    assert "change nothing in the controller" in next_text(worse, "")
    assert "enter" not in next_text(worse, "folder")


async def test_keys_are_those_of_the_other_result(session: Path) -> None:
    interface = Glidecal(HexaSlideResultScreen(session))
    async with interface.run_test(size=SIZE) as pilot:
        screen = await looked(pilot, interface, HexaSlideResultScreen)
        await pilot.press("d")
        await until(pilot, "diagnosis", lambda: active(screen) == "diagnosis")
        await pilot.press("escape")
        await until(pilot, "home", lambda: isinstance(interface.screen, HomeScreen))
        await pilot.press("f10")


async def test_who_only_looks_writes_nothing(session: Path) -> None:
    folder = session.parent
    interface = Glidecal(ReplayChoiceScreen([folder]), looks=LOOKS, read_only=True)
    async with interface.run_test(size=SIZE) as pilot:
        await pilot.pause()
        await pilot.press("enter")
        assert "hexaslide-h60, simulated: 1 session" in await history_shown(pilot, interface)
        await pilot.press("escape")
        await until(pilot, "list", lambda: isinstance(interface.screen, ReplayChoiceScreen))
        await pilot.press("down", "enter")
        screen = await looked(pilot, interface, HexaSlideResultScreen)
        assert active(screen) == "readings"
        await pilot.press("e", "r")
        await pilot.pause()
        assert "only shows sessions" in said(interface)
        assert [path.name for path in folder.iterdir()] == [session.name]
        await pilot.press("f10")


async def test_too_few_postures_are_said(recorded: bytes, tmp_path: Path) -> None:
    (path := tmp_path / "few.jsonl").write_bytes(b"\n".join(recorded.split(b"\n")[:9]) + b"\n")
    interface = Glidecal(HexaSlideResultScreen(path))
    async with interface.run_test(size=SIZE) as pilot:
        await looked(pilot, interface, HexaSlideResultScreen)
        assert "This session gives no machine" in text(interface, "#result-text")
        assert "16 or more" in " ".join(text(interface, "#result-text").split())
        await pilot.press("e")
        await pilot.pause()
        assert "gives no machine" in said(interface)
        await pilot.press("f10")


@LONG
async def test_the_browser_gets_report_and_history(session: Path) -> None:
    async with listed(session.parent) as (client, addresses):
        page = await (await client.get(addresses[session.name])).text()
        assert "Calibration report" in page
        assert "NOT IDENTIFIABLE" in page
        history = await (await client.get(addresses["History of this folder"])).text()
        assert "hexaslide-h60, simulated: 1 session" in history
        index = await (await client.get("/reports")).text()
        assert "</a></td><td>24 readings, closed</td><td>hexaslide-h60, simulated</td>" in index
