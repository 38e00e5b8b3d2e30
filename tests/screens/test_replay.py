"""Replaying on the screen, driven by keys alone."""

from __future__ import annotations

from pathlib import Path

import pytest
from textual.pilot import Pilot
from textual.widgets import Log

from app.measuring.playback import PlaybackState
from app.report.text.replay import reading_lines
from app.screens.home import HomeScreen, ReplayChoiceScreen
from app.screens.interface import Glidecal, HelpDialog, TextDialog
from app.screens.replay import ReplayScreen
from app.screens.result import ResultScreen
from app.screens.session_view import GaugeDisplay
from protocols.record import read_record
from protocols.session import fold
from tests.conftest import LONG
from tests.recorded import REASON, story, write
from tests.screens.driving import SIZE, numbers, said, text, until


@pytest.fixture
def record_path(tmp_path: Path) -> Path:
    return write(tmp_path / "told.jsonl", story(), close=True)


def replay(interface: Glidecal) -> ReplayScreen:
    screen = interface.screen
    assert isinstance(screen, ReplayScreen)
    return screen


async def begin(pilot: Pilot[str], interface: Glidecal) -> ReplayScreen:
    await until(pilot, "the picture", lambda: "step" in text(interface, "#progress"))
    return replay(interface)


async def test_the_picture_of_measuring_moves_by_keys(record_path: Path) -> None:
    interface = Glidecal(ReplayScreen(record_path))
    async with interface.run_test(size=SIZE) as pilot:
        await begin(pilot, interface)
        assert text(interface, "#progress") == "replay · told.jsonl   step 1 of 30 · ×5 · PAUSED"
        assert text(interface, "#said") == "Begun 2026-03-01 08:00 UTC by Ida, measured."
        assert "First, at Zero: indicators on leg X along Y (1) and Z (2)" in text(
            interface, "#step"
        )
        assert numbers(interface.screen) == ["------", "------"]
        await pilot.press("right", "right", "right")
        assert "LEG X   MAX   cycle 1 of 3" in text(interface, "#step")
        assert "G53 G0 X60.000 Y0.000 Z0.000" in text(interface, "#step")
        assert numbers(interface.screen) == ["+0.200", "-0.200"]
        titles = [display.border_title for display in interface.screen.query(GaugeDisplay)]
        assert titles == ["1 mitutoyo-01a along Y, mm", "2 mitutoyo-01a along Z, mm"]
        assert text(interface, "#steps").splitlines()[:2] == ["+   1 X ZERO 1", ">   2 X MAX 1"]
        assert text(interface, "#said") == "Taken, step 2: Y +0.2000 mm, Z -0.2000 mm"
        assert "+0.100" in text(interface, "#table")
        await pilot.press("right")
        assert text(interface, "#said") == "Note: the stand slipped [red]here[/]"
        await pilot.press("right", "right")
        assert "no answer (received 'E[1]')" in text(interface, "#said")
        assert numbers(interface.screen) == ["+0.200", "------"]
        await pilot.press("left")
        assert text(interface, "#said") == f"Superseded readings 3, 4: {REASON}"
        await pilot.press("end")
        assert "END" in text(interface, "#progress")
        await pilot.press("home")
        assert replay(interface).playback.position == 1
        await pilot.press("f10")
    assert interface.return_code == 0


async def test_the_list_of_steps_is_on_the_screen(record_path: Path) -> None:
    for size in ((80, 24), (120, 40)):
        interface = Glidecal(ReplayScreen(record_path))
        async with interface.run_test(size=size) as pilot:
            await begin(pilot, interface)
            await pilot.pause()
            region = interface.screen.query_one("#steps").region
            assert region.right <= size[0]
            assert region.width == 20
            for place in ("#said", "#table"):
                place_region = interface.screen.query_one(place).region
                assert place_region.bottom < size[1]
                assert place_region.height > 0
            await pilot.press("f10")


async def test_play_pause_and_speed(record_path: Path) -> None:
    interface = Glidecal(ReplayScreen(record_path))
    async with interface.run_test(size=SIZE) as pilot:
        screen = await begin(pilot, interface)
        await pilot.press("up", "plus")
        assert "×20" in text(interface, "#progress")
        await pilot.press("down", "minus", "minus")
        assert "×2 " in text(interface, "#progress")
        await pilot.press("space")
        assert "PLAYING" in text(interface, "#progress")
        await pilot.press("space")
        assert "PAUSED" in text(interface, "#progress")
        await pilot.press(*["up"] * 9)
        assert "×100 · PAUSED" in text(interface, "#progress")
        await pilot.press("space")
        await until(pilot, "the end", lambda: screen.playback.state is PlaybackState.END)
        await until(pilot, "said", lambda: "END" in text(interface, "#progress"))
        assert text(interface, "#said") == "Closed with 8 readings, not complete."
        assert screen.playback.session == fold(read_record(record_path).events)
        await pilot.press("f10")


@LONG
async def test_list_of_readings_with_superseded_ones(record_path: Path) -> None:
    interface = Glidecal(ReplayScreen(record_path))
    async with interface.run_test(size=SIZE) as pilot:
        screen = await begin(pilot, interface)
        listing = screen.query_one("#taken", Log)
        assert listing.region.height == 0
        await pilot.press("t", "right", "right", "right")
        await pilot.pause()
        assert listing.region.height >= 6
        assert list(listing.lines[:5]) == reading_lines(screen.playback.session)
        assert not any("superseded" in line for line in listing.lines)
        await pilot.press("end")
        assert f"     superseded: {REASON}" in listing.lines
        await pilot.press("home")
        assert [line for line in listing.lines if line] == reading_lines(screen.playback.session)
        await pilot.press("escape")
        await pilot.pause()
        assert listing.region.height == 0, "the list first"
        await pilot.press("escape")
        await until(pilot, "home", lambda: isinstance(interface.screen, HomeScreen))
        await pilot.press("f10")


async def test_pages_of_a_long_list(samples: Path) -> None:
    interface = Glidecal(ReplayScreen(samples / "simulated_sweep.jsonl"))
    async with interface.run_test(size=SIZE) as pilot:
        screen = await begin(pilot, interface)
        await pilot.press("t", "end")
        listing = screen.query_one("#taken", Log)
        await until(pilot, "the last lines", lambda: listing.scroll_y > 100)
        bottom = listing.scroll_y
        await pilot.press("pageup")
        await until(pilot, "a page up", lambda: listing.scroll_y < bottom)
        await pilot.press("pagedown")
        await until(pilot, "a page down", lambda: listing.scroll_y == bottom)
        await pilot.press("f10")


async def test_jump(record_path: Path) -> None:
    interface = Glidecal(ReplayScreen(record_path))
    async with interface.run_test(size=SIZE) as pilot:
        await begin(pilot, interface)
        for typed, place, words in (
            ("4", "step 4 of 30", "Taken, step 4"),
            ("77", "step 4 of 30", "step: found 77. Allowed: 1 … 30"),
            ("[b]", "step 4 of 30", "step: found '[b]'. Allowed: a whole number"),
            ("1", "step 1 of 30", "Taken, step 1"),
        ):
            await pilot.press("j")
            await until(pilot, "a dialog", lambda: isinstance(interface.screen, TextDialog))
            await pilot.press(*typed, "enter")
            await until(pilot, "back", lambda: isinstance(interface.screen, ReplayScreen))
            assert place in text(interface, "#progress")
            assert text(interface, "#said").startswith(words)
        await pilot.press("j")
        await until(pilot, "a dialog", lambda: isinstance(interface.screen, TextDialog))
        await pilot.press("escape")
        await until(pilot, "back", lambda: isinstance(interface.screen, ReplayScreen))
        assert "step 1 of 30" in text(interface, "#progress")
        await pilot.press("f10")


async def test_copy_tells_how_many_lines(record_path: Path) -> None:
    interface = Glidecal(ReplayScreen(record_path))
    async with interface.run_test(size=SIZE) as pilot:
        screen = await begin(pilot, interface)
        await pilot.press("end", "y")
        lines = reading_lines(screen.playback.session)
        assert interface.clipboard.splitlines() == lines
        assert said(interface).startswith(f"{len(lines)} lines copied")
        assert len(lines) == 1 + 8 + 2
        await pilot.press("f10")


async def test_plot_and_help(record_path: Path) -> None:
    interface = Glidecal(ReplayScreen(record_path))
    async with interface.run_test(size=SIZE) as pilot:
        screen = await begin(pilot, interface)
        chart = screen.query_one("#chart")
        await pilot.press("end", "v")
        await until(pilot, "the plot", lambda: chart.region.height > 0)
        await pilot.press("v")
        await until(pilot, "no plot", lambda: chart.region.height == 0)
        await pilot.press("f1")
        await until(pilot, "help", lambda: isinstance(interface.screen, HelpDialog))
        await pilot.press("escape", "f10")
    assert interface.return_code == 0


async def test_result_and_back(samples: Path) -> None:
    interface = Glidecal(ReplayScreen(samples / "simulated_zero-max-min.jsonl"))
    async with interface.run_test(size=SIZE) as pilot:
        await begin(pilot, interface)
        await pilot.press("right", "l")
        await until(pilot, "a result", lambda: isinstance(interface.screen, ResultScreen))
        await until(pilot, "text", lambda: "d_rho_x" in text(interface, "#details-text"))
        await pilot.press("escape")
        await until(pilot, "back", lambda: isinstance(interface.screen, ReplayScreen))
        assert "step 1 of 30" in text(interface, "#progress")
        await pilot.press("f10")


async def test_no_result_is_said_in_words(tmp_path: Path) -> None:
    empty = write(tmp_path / "empty.jsonl", story()[:1], close=True)
    interface = Glidecal(ReplayScreen(empty))
    async with interface.run_test(size=SIZE) as pilot:
        await begin(pilot, interface)
        await pilot.press("l")
        await until(pilot, "words", lambda: "No result of this" in text(interface, "#said"))
        assert "readings: found none" in text(interface, "#said")
        assert isinstance(interface.screen, ReplayScreen)
        await pilot.press("f10")


async def test_a_table_is_replayed_reading_by_reading(samples: Path) -> None:
    interface = Glidecal(ReplayScreen(samples / "experiment_2_twelve.jsonl"))
    async with interface.run_test(size=(120, 40)) as pilot:
        await until(pilot, "picture", lambda: "reading 1 of 18" in text(interface, "#progress"))
        await pilot.press("right", "right")
        assert "reading 2 of 18" in text(interface, "#progress")
        assert "LEG X   MAX   cycle 1 of 1" in text(interface, "#step")
        assert text(interface, "#steps").splitlines()[:2] == ["+   1 X ZERO 1", ">   2 X MAX 1"]
        assert numbers(interface.screen) == ["+0.08"]
        assert text(interface, "#said") == "Reading 2, leg X at +60.00 mm: Y +0.0800 mm"
        await pilot.press("end")
        assert "reading 18 of 18" in text(interface, "#progress")
        await pilot.press("f10")


async def test_a_torn_record_says_so(samples: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut[1].jsonl"
    cut.write_bytes((samples / "simulated_sweep.jsonl").read_bytes()[:9000])
    interface = Glidecal(ReplayScreen(cut))
    async with interface.run_test(size=SIZE) as pilot:
        await begin(pilot, interface)
        assert "cut[1].jsonl: cut inside line" in text(interface, "#said")
        await pilot.press("right")
        assert "cut inside" not in text(interface, "#said")
        await pilot.press("end")
        assert "cut[1].jsonl: cut inside line" in text(interface, "#said")
        await pilot.press("f10")


async def test_several_sessions_open_a_list(record_path: Path, samples: Path) -> None:
    paths = [record_path, samples / "experiment_1_six.jsonl"]
    interface = Glidecal(ReplayChoiceScreen(paths))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await pilot.press("down", "enter")
        await until(pilot, "a replay", lambda: isinstance(interface.screen, ReplayScreen))
        assert "experiment_1_six.jsonl   reading 1 of 12" in text(interface, "#progress")
        await pilot.press("escape")
        await until(pilot, "list", lambda: isinstance(interface.screen, ReplayChoiceScreen))
        record_path.write_bytes(b"nothing")
        await pilot.press("up", "enter")
        await until(pilot, "words", lambda: bool(said(interface)))
        assert isinstance(interface.screen, ReplayChoiceScreen)
        await pilot.press("f10")


async def test_who_only_looks_has_no_way_back_from_the_first_screen(record_path: Path) -> None:
    interface = Glidecal(ReplayScreen(record_path), read_only=True)
    async with interface.run_test(size=SIZE) as pilot:
        await begin(pilot, interface)
        await pilot.press("escape")
        assert isinstance(interface.screen, ReplayScreen)
        assert interface.is_running
        await pilot.press("f10")


async def test_read_only_reaches_neither_export_nor_verify_nor_home(
    samples: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "s.jsonl"
    path.write_bytes((samples / "simulated_zero-max-min.jsonl").read_bytes())
    before = sorted(tmp_path.rglob("*"))
    interface = Glidecal(ReplayScreen(path), read_only=True)
    async with interface.run_test(size=SIZE) as pilot:
        await begin(pilot, interface)
        await pilot.press("l")
        await until(pilot, "a result", lambda: isinstance(interface.screen, ResultScreen))
        for key in ("e", "v"):
            await pilot.press(key)
            await interface.workers.wait_for_complete()
            await pilot.pause()
            assert isinstance(interface.screen, ResultScreen)
        await pilot.press("h", "escape")
        await until(pilot, "the replay", lambda: isinstance(interface.screen, ReplayScreen))
        assert len(interface.screen_stack) == 2
        await pilot.press("f10")
    assert sorted(tmp_path.rglob("*")) == before
