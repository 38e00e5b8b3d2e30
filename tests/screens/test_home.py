"""Home, picking and comparing sessions, preparing one: by keys alone."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from textual.pilot import Pilot
from textual.widgets import Input, OptionList, Select, Static

from app.commands.demo import run_headless
from app.exports import FILE_NAMES
from app.measuring.plan import QUICK_INTERVAL_S
from app.screens.check import CheckScreen, DryRunScreen
from app.screens.history import CompareScreen
from app.screens.home import HomeScreen
from app.screens.interface import ChoiceDialog, Glidecal, HelpDialog
from app.screens.prepare import PrepareScreen
from app.screens.replay import ReplayScreen
from app.screens.result import ResultScreen
from protocols.journal import Journal
from tests.conftest import LONG
from tests.protocols.test_journal import reading
from tests.recorded import opened as planned
from tests.screens.driving import SIZE, fill_in, quick_plan, said, text, until

BEFORE, AFTER = "before [mm].jsonl", "after [ttyUSB0].jsonl"


@pytest.fixture
def folder(tmp_path: Path, samples: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two published sessions and a damaged one under names that look like markup."""
    place = tmp_path / "sessions [mm]"
    place.mkdir()
    shutil.copy(samples / "experiment_2_twelve.jsonl", place / BEFORE)
    shutil.copy(samples / "experiment_3_twelve.jsonl", place / AFTER)
    shutil.copy(samples / "damaged.jsonl", place / "damaged [x].jsonl")
    monkeypatch.chdir(place)
    return place


def options(interface: Glidecal) -> list[str]:
    """The lines of a list, without the numbers that choose some of them."""
    entries = interface.screen.query_one(OptionList).options
    return [re.sub(r"^(\d| )  ", "", str(option.prompt)) for option in entries]


async def choose(pilot: Pilot[str], interface: Glidecal, beginning: str) -> None:
    """Arrow keys to the first line that begins so, and Enter."""
    listed = interface.screen.query_one(OptionList)
    position = next(k for k, words in enumerate(options(interface)) if words.startswith(beginning))
    await pilot.press("home", *["down"] * position)
    assert listed.highlighted == position
    await pilot.press("enter")


async def shown(pilot: Pilot[str], interface: Glidecal, screen: type[object]) -> None:
    await until(pilot, screen.__name__, lambda: isinstance(interface.screen, screen))
    await pilot.pause()


async def test_list_of_what_can_be_done(folder: Path) -> None:
    (folder / "measured.jsonl").write_text('{\n "schema": "glidecal.hexaslide-measurements/1"\n}\n')
    interface = Glidecal(HomeScreen())
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await pilot.pause()
        listed = options(interface)
        assert listed[0].startswith("New session")
        assert [words.split()[0] for words in listed[2:6]] == [
            "Result",
            "Replay",
            "Compare",
            "Export",
        ]
        assert f"{BEFORE}\n    18 readings, closed" in listed
        assert "damaged [x].jsonl\n    unreadable" in listed
        assert not any(words.startswith("measured.jsonl") for words in listed), "no session"
        assert interface.screen.query_one(OptionList).highlighted == 0
        await choose(pilot, interface, "damaged")
        await pilot.pause()
        assert "session damaged [x].jsonl, line" in said(interface)
        assert isinstance(interface.screen, HomeScreen)
        await pilot.press("f1")
        await shown(pilot, interface, HelpDialog)
        content = interface.screen.query_one(Static).content
        assert str(content).count("Demonstration") == 1, "once, though its list has the focus"
        assert "{" not in str(content)
        await pilot.press("escape", "f10")
    assert interface.return_code == 0


async def test_a_session_left_before_its_first_reading_is_not_offered_first(folder: Path) -> None:
    for name, readings in (("left.jsonl", []), ("begun.jsonl", [reading(1)])):
        journal = Journal.create(folder / name, planned())
        journal.append(*readings)
        journal.close()
    interface = Glidecal(HomeScreen())
    async with interface.run_test(size=SIZE) as pilot:
        await pilot.pause()
        listed = options(interface)
        assert [words.split()[1] for words in listed if words[:8] == "Continue"] == ["begun.jsonl"]
        await choose(pilot, interface, "left.jsonl")
        await shown(pilot, interface, ChoiceDialog)
        assert "Continue measuring" in options(interface)[0]
        await pilot.press("escape", "f10")


async def test_compare_by_keys(folder: Path) -> None:
    interface = Glidecal(HomeScreen())
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await pilot.pause()
        await choose(pilot, interface, "Compare")
        await shown(pilot, interface, ChoiceDialog)
        assert "BEFORE" in text(interface, "Static")
        await choose(pilot, interface, "before")
        await until(pilot, "after", lambda: "AFTER" in text(interface, "Static"))
        assert BEFORE not in "".join(options(interface))
        await choose(pilot, interface, "after")
        await shown(pilot, interface, CompareScreen)
        assert f"before: {BEFORE}\nafter:  {AFTER}" in text(interface, "#comparison-text")
        assert "from 0.3230 to 0.1508 mm" in text(interface, "#comparison-text")
        assert not interface.screen.query_one("#comparison .beside").display
        await pilot.press("y")
        assert interface.clipboard == text(interface, "#comparison-text")
        await pilot.press("tab")
        chart = interface.screen.query_one("#plot-chart0")
        await until(pilot, "the plot", lambda: chart.region.area > 0)
        await pilot.press("y")
        assert interface.clipboard.splitlines()[0].strip() == "Differences: leg along axis, mm"
        await pilot.press("tab")
        await pilot.resize_terminal(120, 40)
        beside = interface.screen.query_one("#comparison .beside")
        await until(pilot, "the plot beside", lambda: beside.display)
        await pilot.press("escape")
        await shown(pilot, interface, HomeScreen)
        await pilot.press("f10")


async def test_sessions_with_nothing_in_common_are_refused_in_words(
    folder: Path, samples: Path
) -> None:
    shutil.copy(samples / "experiment_2_six.jsonl", folder / "six.jsonl")
    interface = Glidecal(HomeScreen())
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await pilot.pause()
        await choose(pilot, interface, "six")
        await shown(pilot, interface, ChoiceDialog)
        await pilot.press("4")
        await shown(pilot, interface, ChoiceDialog)
        await choose(pilot, interface, "after")
        await until(pilot, "refusal", lambda: "no difference that both" in said(interface))
        assert isinstance(interface.screen, HomeScreen)
        await pilot.press("f10")


@LONG
async def test_a_verification_proposes_its_partner(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    run_headless(replace(quick_plan(tmp_path), interval_s=QUICK_INTERVAL_S))
    (verify,) = tmp_path.glob("*_verify.jsonl")
    interface = Glidecal(HomeScreen())
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await pilot.pause()
        await choose(pilot, interface, "Compare")
        await shown(pilot, interface, ChoiceDialog)
        await choose(pilot, interface, verify.name)
        await shown(pilot, interface, ChoiceDialog)
        await pilot.press("1")
        await shown(pilot, interface, CompareScreen)
        assert f"after:  {verify.name}" in text(interface, "#comparison-text")
        assert "Remark" not in text(interface, "#comparison-text")
        await pilot.press("escape")
        await shown(pilot, interface, HomeScreen)
        await choose(pilot, interface, verify.name.replace("_verify", ""))
        await shown(pilot, interface, ChoiceDialog)
        await pilot.press("4")
        await shown(pilot, interface, ChoiceDialog)
        listed = interface.screen.query_one(OptionList)
        assert listed.highlighted_option is not None
        assert verify.name in str(listed.highlighted_option.prompt)
        await pilot.press("escape", "f10")


@LONG
async def test_export_writes_what_the_result_screen_writes(folder: Path) -> None:
    interface = Glidecal(HomeScreen())
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await pilot.pause()
        await choose(pilot, interface, "Export")
        await shown(pilot, interface, ChoiceDialog)
        await choose(pilot, interface, "before")
        folder_written = folder / "before [mm]"
        await shown(pilot, interface, ResultScreen)
        await until(
            pilot, "written", lambda: f"Written to {folder_written.name}" in said(interface)
        )
        page = " ".join(text(interface, "#result-text").split())
        assert "WARNING: the present HOME_OFFSET is not stated" in page, "stays until it is read"
        assert "Next: enter the values in the controller" in page
        await pilot.press("escape")
        await shown(pilot, interface, HomeScreen)
        names = {path.name for path in folder_written.iterdir()}
        assert names >= set(FILE_NAMES.values()) | {"calib_joint0.inc"}
        (folder_written / "offsets.csv").write_text("mine", encoding="utf-8")
        await choose(pilot, interface, "Export")
        await shown(pilot, interface, ChoiceDialog)
        await choose(pilot, interface, "before")
        await shown(pilot, interface, ChoiceDialog)
        assert (folder_written / "offsets.csv").read_text(encoding="utf-8") == "mine"
        await pilot.press("2")
        await until(pilot, "replaced", lambda: (folder_written / "offsets.csv").stat().st_size > 4)
        await pilot.press("f10")


@LONG
@pytest.mark.parametrize(
    ("beginning", "screen"), [("Result", ResultScreen), ("Replay", ReplayScreen)]
)
async def test_result_and_replay_of_a_picked_session(
    folder: Path, beginning: str, screen: type[object]
) -> None:
    interface = Glidecal(HomeScreen())
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await pilot.pause()
        await choose(pilot, interface, beginning)
        await shown(pilot, interface, ChoiceDialog)
        await choose(pilot, interface, "damaged")
        await pilot.pause()
        assert "line" in text(interface, "Static")
        assert isinstance(interface.screen, ChoiceDialog)
        await choose(pilot, interface, "before")
        await shown(pilot, interface, screen)
        await pilot.press("f10")
    assert interface.return_code == 0


async def test_a_session_elsewhere_by_its_path(
    tmp_path: Path, samples: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    monkeypatch.chdir(empty)
    interface = Glidecal(HomeScreen())
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await pilot.pause()
        await choose(pilot, interface, "Result")
        await shown(pilot, interface, ChoiceDialog)
        assert "No session files" in text(interface, "Static")
        await pilot.press("enter", *"none [x].jsonl", "enter")
        await until(pilot, "reason", lambda: "session none [x].jsonl" in text(interface, "Static"))
        await pilot.press("enter")
        interface.screen.query_one(Input).value = str(samples / "experiment_2_twelve.jsonl")
        await pilot.press("enter")
        await shown(pilot, interface, ResultScreen)
        await pilot.press("f10")


async def test_new_sessions_are_listed_after_coming_back(folder: Path, samples: Path) -> None:
    interface = Glidecal(HomeScreen())
    async with interface.run_test(size=SIZE) as pilot:
        await pilot.pause()
        await choose(pilot, interface, "New session")
        await shown(pilot, interface, PrepareScreen)
        shutil.copy(samples / "experiment_2_six.jsonl", folder / "later.jsonl")
        await pilot.press("escape")
        await shown(pilot, interface, HomeScreen)
        assert any(words.startswith("later.jsonl") for words in options(interface))
        await pilot.press("f10")


async def test_where_nothing_may_be_written_nothing_of_it_is_offered(folder: Path) -> None:
    interface = Glidecal(HomeScreen(), read_only=True)
    async with interface.run_test(size=SIZE) as pilot:
        await pilot.pause()
        assert [words.split()[0] for words in options(interface)[:3]] == [
            "Result",
            "Replay",
            "Compare",
        ]
        await choose(pilot, interface, "before")
        await shown(pilot, interface, ChoiceDialog)
        assert not any("Export" in words for words in options(interface))
        await pilot.press("escape", "f10")


@LONG
async def test_prepare_dry_run_and_random_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    interface = Glidecal(HomeScreen())
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await pilot.press("enter")
        await shown(pilot, interface, PrepareScreen)
        assert "30 steps with 2 indicators, about 10 minutes" in text(interface, "#summary")
        await pilot.press("f1")
        await shown(pilot, interface, HelpDialog)
        await pilot.press("escape", "f2")
        await shown(pilot, interface, DryRunScreen)
        assert "G53 G0 X60.000" in text(interface, "#dry-run-text")
        folder_written = text(interface, "#dry-run-text")
        await until(pilot, "expected", lambda: "to expect" in text(interface, "#expected-text"))
        await pilot.press("escape")
        interface.screen.query_one("#random", Input).focus()
        await pilot.press("7")
        await pilot.pause()
        assert "seed 7" in text(interface, "#summary")
        await pilot.press("f2")
        await shown(pilot, interface, DryRunScreen)
        assert text(interface, "#dry-run-text") != folder_written
        await pilot.press("escape")
        interface.screen.query_one("#procedure", Select).value = "sweep"
        await pilot.pause()
        assert "order of this procedure is its purpose" in text(interface, "#summary")
        await pilot.press("x")
        await pilot.pause()
        assert "random order seed: found '7x'" in text(interface, "#summary")
        await pilot.press("f2")
        await pilot.pause()
        assert isinstance(interface.screen, PrepareScreen)
        assert "found '7x'" in said(interface)
        await pilot.press("f10")
    assert not list(tmp_path.iterdir())


async def test_a_port_that_looks_like_markup(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    interface = Glidecal(HomeScreen())
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await pilot.press("enter")
        await shown(pilot, interface, PrepareScreen)
        await fill_in(pilot, interface, "indicator1", port="[/dev/ttyUSB0]", profile="mitutoyo-01a")
        assert "at [/dev/ttyUSB0] (not plugged in)" in text(interface, "#indicator1")
        assert "60 steps with 1 indicator" in text(interface, "#summary")
        await pilot.press("f5")
        await shown(pilot, interface, CheckScreen)
        await until(pilot, "refusal", lambda: "[/dev/ttyUSB0]" in text(interface, "#words"))
        await pilot.press("escape")
        await shown(pilot, interface, PrepareScreen)
        interface.screen.query_one("#machine", Input).value = "none [mm].toml"
        await pilot.press("f5")
        await until(pilot, "words", lambda: "none [mm].toml" in said(interface))
        await pilot.press("f10")
