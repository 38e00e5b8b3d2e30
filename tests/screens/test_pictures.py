"""Screens compared with stored pictures; a changed picture is a decision, not an accident.

To accept changes: GLIDECAL_GOLDEN=write pytest tests/screens/test_pictures.py, then look at them.
Beside every picture stands what must be true of the screen, so that no picture of a crash is kept.
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import pytest
from textual.pilot import Pilot
from textual.screen import Screen
from textual.widgets import Input, OptionList, Static, TabbedContent

from app.evaluating.solution import solve_files
from app.machines.registry import LOOKS
from app.measuring.demo import demo_plan
from app.report.text.questions import question_choices
from app.screens.home import HomeScreen
from app.screens.interface import ChoiceDialog, Glidecal, TextDialog
from app.screens.plot import ChartPlot
from app.screens.prepare import PrepareScreen
from app.screens.replay import ReplayScreen
from app.screens.result import ResultScreen
from app.screens.session_view import GaugeDisplay, LegReviewScreen
from protocols.record import read_record
from protocols.session import fold
from tests.conftest import LONG, ROOT
from tests.screens.driving import QUESTIONED, fill_in, text, until

PICTURES = Path(__file__).parent / "pictures"
NARROW, WIDE = (80, 24), (120, 40)
FONTS = re.compile(r"@font-face \{.*?\}", re.DOTALL)
"""Addresses of the web; studies/pictures.py takes them out too."""

ID = re.compile(r"terminal-\d+")
"""A hash of how rows are cut into segments; nobody sees it."""

DRAWING = ("textual", "rich", "plotext", "textual-plotext")


def other_versions() -> str:
    """Libraries that draw and are not those of constraints.txt: their pictures differ."""
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    stated = dict(line.split("==") for line in lines if "==" in line)
    versions = [f"{name} {version(name)}" for name in DRAWING if version(name) != stated[name]]
    return ", ".join(versions)


pytestmark = pytest.mark.skipif(
    bool(other_versions()), reason=f"pictures were made with other versions than {other_versions()}"
)


async def compare(pilot: Pilot[str], interface: Glidecal, name: str, folder: Path) -> None:
    """The screen against its picture; where they differ the new one is kept beside."""
    for field in interface.screen.query(Input):
        field.cursor_blink = False
    await pilot.pause()
    await pilot.wait_for_scheduled_animations()
    svg = FONTS.sub("", interface.export_screenshot(title="glidecal"))
    assert str(ROOT) not in svg
    assert str(folder) not in svg
    stored = PICTURES / f"{name}.svg"
    if os.environ.get("GLIDECAL_GOLDEN") == "write":
        stored.write_text(svg, encoding="utf-8", newline="\n")
    if ID.sub("", stored.read_text(encoding="utf-8")) != ID.sub("", svg):
        kept_path = folder / f"{name}.svg"
        kept_path.write_text(svg, encoding="utf-8", newline="\n")
        pytest.fail(f"{stored} differs from the screen, which is kept as {kept_path}")


def still(first: Screen[None]) -> Glidecal:
    """A program without animations."""
    interface = Glidecal(first, looks=LOOKS)
    interface.animation_level = "none"
    return interface


def result_screen(path: Path) -> ResultScreen:
    return ResultScreen(solve_files([path]).work_out(), None, path)


def compared_screen(samples: Path, folder: Path) -> ResultScreen:
    """The published experiments 2 and 3, as if measured one after the other."""
    first, second = (samples / f"experiment_{n}_twelve.jsonl" for n in (2, 3))
    plan = demo_plan(folder, "zero-max-min", 1)
    before = solve_files([first])
    return ResultScreen(solve_files([second]).work_out(), replace(plan, before=before), second)


def page_is(interface: Glidecal, name: str) -> Callable[[], bool]:
    return lambda: interface.screen.query_one(TabbedContent).active == name


@LONG
@pytest.mark.parametrize("size", [NARROW, WIDE])
async def test_result(samples: Path, tmp_path: Path, size: tuple[int, int]) -> None:
    interface = still(result_screen(samples / "experiment_2_twelve.jsonl"))
    async with interface.run_test(size=size) as pilot:
        await until(pilot, "text", lambda: "Next: D looks" in text(interface, "#result-text"))
        assert isinstance(interface.screen, ResultScreen)
        assert interface.screen.query_one("#result .beside").display == (size == WIDE)
        await compare(pilot, interface, f"result_{size[0]}", tmp_path)
        await pilot.press("left")
        await until(pilot, "legs", page_is(interface, "legs"))
        await pilot.pause()
        await compare(pilot, interface, f"legs_{size[0]}", tmp_path)
        await pilot.press("left")
        await until(pilot, "plot", page_is(interface, "plot"))
        await pilot.pause()
        assert "X along Z, MIN" in str(
            interface.screen.query_one("#plot-chart0", ChartPlot).render()
        )
        await compare(pilot, interface, f"plot_{size[0]}", tmp_path)


@LONG
@pytest.mark.parametrize("size", [NARROW, WIDE])
async def test_comparison(samples: Path, tmp_path: Path, size: tuple[int, int]) -> None:
    interface = still(compared_screen(samples, tmp_path))
    async with interface.run_test(size=size) as pilot:
        await pilot.press("5")
        await until(pilot, "page", page_is(interface, "before-after"))
        await pilot.pause()
        assert "Leg deviations went from" in text(interface, "#before-after-text")
        assert "o after" in str(
            interface.screen.query_one("#before-after-chart0", ChartPlot).render()
        )
        await compare(pilot, interface, f"comparison_{size[0]}", tmp_path)


async def test_light_theme(samples: Path, tmp_path: Path) -> None:
    interface = Glidecal(result_screen(samples / "experiment_2_twelve.jsonl"), read_only=True)
    interface.animation_level = "none"
    async with interface.run_test(size=WIDE) as pilot:
        interface.theme = "textual-light"
        await pilot.pause()
        assert not interface.current_theme.dark
        assert "WARNING" in text(interface, "#result-text")
        await compare(pilot, interface, "result_light", tmp_path)


async def test_home(samples: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for age, name in enumerate(("experiment_2_twelve", "simulated_zero-max-min")):
        path = Path(shutil.copy(samples / f"{name}.jsonl", tmp_path))
        os.utime(path, (1e9 - age, 1e9 - age))
    interface = still(HomeScreen())
    async with interface.run_test(size=NARROW) as pilot:
        await pilot.pause()
        assert isinstance(interface.screen, HomeScreen)
        assert "What do you want to do?" in text(interface, "#question")
        choices = interface.screen.query_one("#choices", OptionList)
        assert [str(o.id) for o in choices.options if str(o.id).startswith("session")] == [
            "session experiment_2_twelve.jsonl",
            "session simulated_zero-max-min.jsonl",
        ]
        await compare(pilot, interface, "home", tmp_path)


async def test_prepare(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    interface = still(HomeScreen())
    async with interface.run_test(size=NARROW) as pilot:
        await pilot.press("enter")
        await until(pilot, "form", lambda: isinstance(interface.screen, PrepareScreen))
        await fill_in(pilot, interface, "indicator1", port="COM5", profile="mitutoyo-01a")
        await until(pilot, "summary", lambda: "with 1 indicator" in text(interface, "#summary"))
        await compare(pilot, interface, "prepare", tmp_path)


async def test_note(samples: Path, tmp_path: Path) -> None:
    interface = still(result_screen(samples / "experiment_2_twelve.jsonl"))
    async with interface.run_test(size=NARROW) as pilot:
        interface.push_screen(TextDialog("Note for the record.", "what happened"))
        await until(pilot, "a line", lambda: bool(interface.screen.query(Input)))
        assert isinstance(interface.screen, TextDialog)
        await pilot.press(*"slip [x]")
        assert interface.screen.query_one(Input).value == "slip [x]"
        await compare(pilot, interface, "note", tmp_path)


async def test_choice(samples: Path, tmp_path: Path) -> None:
    interface = still(result_screen(samples / "experiment_2_twelve.jsonl"))
    async with interface.run_test(size=NARROW) as pilot:
        question = "Step 4, leg X ZERO:\nalong [Y] +0.2 mm where +0.0 ± 0.05 mm is expected"
        interface.push_screen(ChoiceDialog(question, question_choices(QUESTIONED)))
        await until(pilot, "choices", lambda: bool(interface.screen.query(OptionList)))
        assert isinstance(interface.screen, ChoiceDialog)
        assert interface.screen.query_one(OptionList).highlighted == 0
        assert str(interface.screen.query(Static).first().content) == question
        await compare(pilot, interface, "choice", tmp_path)


async def test_replay(samples: Path, tmp_path: Path) -> None:
    interface = still(ReplayScreen(samples / "simulated_zero-max-min.jsonl"))
    async with interface.run_test(size=WIDE) as pilot:
        await until(pilot, "a replay", lambda: isinstance(interface.screen, ReplayScreen))
        await pilot.press("j", *"8", "enter")
        await until(pilot, "step 8", lambda: "step 8 of" in text(interface, "#progress"))
        displays = interface.screen.query(GaugeDisplay)
        await until(pilot, "trends", lambda: all("m" in "".join(d.strip) for d in displays))
        assert "simulated_zero-max-min.jsonl" in text(interface, "#progress")
        assert "along Y" in str(interface.screen.query_one(ChartPlot).render())
        await compare(pilot, interface, "replay", tmp_path)


@LONG
@pytest.mark.parametrize("size", [NARROW, WIDE])
async def test_review(samples: Path, tmp_path: Path, size: tuple[int, int]) -> None:
    session = fold(read_record(samples / "simulated_zero-max-min.jsonl").events)
    last_of_leg = next(step for step in session.steps() if step.number == 10)
    interface = still(result_screen(samples / "experiment_2_twelve.jsonl"))
    async with interface.run_test(size=size) as pilot:
        interface.push_screen(LegReviewScreen(session, last_of_leg))
        await until(pilot, "a review", lambda: bool(interface.screen.query("#review-text")))
        assert "Leg X is done." in text(interface, "#review-text")
        await pilot.pause()
        chart = interface.screen.query_one(ChartPlot)
        assert chart.display == (size == WIDE)
        await until(pilot, "chart", lambda: size == NARROW or "along Y" in str(chart.render()))
        await compare(pilot, interface, f"review_{size[0]}", tmp_path)
