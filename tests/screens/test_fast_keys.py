"""Keys faster than the screens: none of them crashes, none leaves the screen below."""

from __future__ import annotations

import asyncio
import os
import random
import shutil
import string
from collections.abc import Callable
from pathlib import Path

import pytest
from textual import events
from textual._context import active_message_pump
from textual.css.query import NoMatches
from textual.pilot import Pilot
from textual.screen import Screen
from textual.worker import WorkerFailed

from app.evaluating.comparison import compare_files
from app.evaluating.solution import solve_files
from app.screens.diagnose import DiagnoseScreen
from app.screens.fast_keys import lacks_parts
from app.screens.history import CompareScreen
from app.screens.home import HomeScreen
from app.screens.interface import ChoiceDialog, Glidecal, HelpDialog, TextDialog
from app.screens.prepare import IndicatorScreen, PrepareScreen
from app.screens.replay import ReplayScreen
from app.screens.result import ResultScreen
from tests.conftest import LONG, SAMPLES, first_quick
from tests.screens.driving import PATIENCE_S, SIZE, until

SAMPLE = SAMPLES / "simulated_zero-max-min.jsonl"
PAIR = tuple(SAMPLES / f"experiment_{number}_twelve.jsonl" for number in (2, 3))
KEYS = [
    *("ctrl+p", "enter", "escape") * 3,
    *("up", "down", "left", "right", "tab", "shift+tab", "space", "backspace"),
    *("f1", "f2", "f5", "pageup", "pagedown", "home", "end"),
    *(string.ascii_lowercase + string.digits),
]
MASHED = min(5000, int(os.environ.get("GLIDECAL_FUZZ", "200")))
"""Keys of one seed; a run that quits by them begins again."""


def strike(interface: Glidecal, key: str) -> None:
    """A key as a terminal sends it: nobody waits for what it does."""
    character = {"space": " "}.get(key, key if len(key) == 1 else None)
    interface.post_message(events.Key(key, character))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("GLIDECAL_SETTINGS", str(tmp_path / "settings.toml"))
    shutil.copy(SAMPLE, tmp_path)
    return tmp_path


@LONG
@pytest.mark.parametrize(
    ("served", "seed"), first_quick([(True, 12), (True, 4), (False, 100)], several=True)
)
async def test_mashed_keys(folder: Path, served: bool, seed: int) -> None:
    """The crashes that were found: palette, lists, screens left twice or before they were there."""
    drawn = random.Random(seed)
    keys_left = MASHED
    while keys_left > 0:
        first: Screen[None] = ReplayScreen(SAMPLE) if served else HomeScreen()
        interface = Glidecal(first, read_only=served)
        async with interface.run_test(size=SIZE):  # raises what the screens raise
            while keys_left > 0 and interface.is_running and interface.return_value is None:
                keys_left -= 1
                strike(interface, drawn.choice(KEYS))
                if drawn.random() < 0.3:
                    await asyncio.sleep(0.02 * drawn.random())
            await acted_on(interface)
        assert not interface.return_code


@pytest.mark.parametrize("turns", first_quick(range(6)))
@pytest.mark.parametrize(
    "screen",
    [
        lambda: DiagnoseScreen([SAMPLE]),
        lambda: CompareScreen(compare_files(*PAIR)),
        lambda: ReplayScreen(SAMPLE),
        lambda: ResultScreen(solve_files([SAMPLE]), None, SAMPLE),
        HomeScreen,
        PrepareScreen,
        lambda: IndicatorScreen("First indicator", {}, {}),
        lambda: ChoiceDialog("Which?", [("a", "a")]),
    ],
)
async def test_the_program_ends_while_a_screen_comes(
    folder: Path, screen: Callable[[], Screen[None]], turns: int
) -> None:
    """Its parts come over some turns of the loop; a form lacked them after up to four."""
    interface = Glidecal(HomeScreen())
    async with interface.run_test(size=SIZE) as pilot:  # raises what the screens raise
        await pilot.pause()
        interface.push_screen(screen())
        for _ in range(turns):
            await asyncio.sleep(0)
        interface.exit()
    assert not interface.return_code


async def test_parts_that_are_missing_while_all_are_there_are_a_fault(folder: Path) -> None:
    interface = Glidecal(HomeScreen())

    async def looked_for_what_is_nowhere() -> None:
        async with interface.run_test(size=SIZE) as pilot:
            await pilot.pause()
            interface.screen.call_later(interface.screen.query_one, "#nowhere")
            await pilot.pause()

    with pytest.raises(NoMatches):
        await looked_for_what_is_nowhere()
    assert interface.return_code == 1


async def test_a_worker_too_may_miss_parts_of_a_screen_that_is_gone(folder: Path) -> None:
    interface, dialog = Glidecal(HomeScreen()), ChoiceDialog("Which?", [("a", "a")])
    problems = NoMatches("none"), WorkerFailed(NoMatches("none")), WorkerFailed(ValueError("other"))

    def lacking() -> list[bool]:
        token = active_message_pump.set(dialog)
        try:
            return [lacks_parts(problem) for problem in problems]
        finally:
            active_message_pump.reset(token)

    async with interface.run_test(size=SIZE) as pilot:
        interface.push_screen(dialog)
        await until(pilot, "the dialog", lambda: dialog.is_current and dialog.is_running)
        assert lacking() == [False, False, False]
        interface.pop_screen()
        await until(pilot, "its end", lambda: not dialog.is_running)
        assert lacking() == [True, True, False]


async def acted_on(interface: Glidecal) -> None:
    """All keys so far: the end of a test takes the screens apart while it still hands on keys.

    No pause of the pilot: it waits for parts of the footer that were made again meanwhile.
    """
    last = asyncio.Event()
    interface.call_later(last.set)
    async with asyncio.timeout(PATIENCE_S):
        while interface.is_running and not last.is_set():
            await asyncio.sleep(0.02)


async def struck(pilot: Pilot[str], interface: Glidecal, *keys: str) -> None:
    for key in keys:
        strike(interface, key)
    await pilot.pause()
    await pilot.pause(0.1)


async def test_page_keys_before_a_list_is_laid_out(folder: Path) -> None:
    interface = Glidecal(HomeScreen())
    async with interface.run_test(size=SIZE) as pilot:
        await until(pilot, "home", lambda: isinstance(interface.screen, HomeScreen))
        for _ in range(3):
            await struck(pilot, interface, "ctrl+p", "down", "pagedown", "pageup", "pagedown")
            await until(pilot, "palette", lambda: isinstance(interface.screen, ChoiceDialog))
            await struck(pilot, interface, "escape", "pagedown", "pageup")
            await until(pilot, "home", lambda: isinstance(interface.screen, HomeScreen))
        assert interface.is_running


@pytest.mark.parametrize(
    "dialog", [TextDialog("Why?", ""), ChoiceDialog("Which?", [("a", "a")]), HelpDialog("So.")]
)
async def test_a_screen_that_is_left_twice_takes_no_other_with_it(
    folder: Path, dialog: Screen[str] | Screen[None]
) -> None:
    interface = Glidecal(ReplayScreen(SAMPLE))
    async with interface.run_test(size=SIZE) as pilot:
        await until(pilot, "replay", lambda: isinstance(interface.screen, ReplayScreen))
        await interface.push_screen(dialog)
        await struck(pilot, interface, *["enter"] * 5)
        assert isinstance(interface.screen, ReplayScreen)
        dialog.dismiss(None)
        await pilot.pause()
        assert isinstance(interface.screen, ReplayScreen)


async def test_one_palette_at_a_time(folder: Path) -> None:
    """Also where a result came over it, and one after the other."""
    interface = Glidecal(ReplayScreen(SAMPLE))
    async with interface.run_test(size=SIZE) as pilot:
        await until(pilot, "replay", lambda: isinstance(interface.screen, ReplayScreen))
        await struck(pilot, interface, *["ctrl+p"] * 3)
        await until(pilot, "palette", lambda: isinstance(interface.screen, ChoiceDialog))
        await interface.push_screen(HelpDialog("over it"))
        await struck(pilot, interface, "ctrl+p")
        palettes = [screen for screen in interface.screen_stack if isinstance(screen, ChoiceDialog)]
        assert len(palettes) == 1
        await struck(pilot, interface, "escape", "escape", "ctrl+p", "escape")
        await pilot.pause(0.2)
        await pilot.press("ctrl+p")
        await until(pilot, "palette", lambda: isinstance(interface.screen, ChoiceDialog))
