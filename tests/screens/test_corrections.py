"""Readings that disagree, earlier steps, skipping, holding: by keys, state first."""

from __future__ import annotations

from collections.abc import AsyncIterator
from concurrent.futures import Future
from contextlib import asynccontextmanager
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import pytest
from textual.pilot import Pilot
from textual.widgets import Input, OptionList, Static

from app.measuring.gauges import Gauge
from app.screens.check import CheckScreen
from app.screens.home import HomeScreen
from app.screens.interface import ChoiceDialog, Glidecal, HelpDialog, TextDialog
from app.screens.measure import MeasureScreen
from app.screens.plot import ChartPlot
from app.screens.session_view import LegReviewScreen
from drivers.profile import IndicatorReading, Outcome
from protocols.clock import steady_s
from protocols.record import read_record
from protocols.session import Noted, fold
from tests.conftest import LONG, first_quick
from tests.screens.driving import press_for, quick_plan, take, text, to_measuring, until

Driven = tuple[Pilot[str], Glidecal, MeasureScreen]


@asynccontextmanager
async def measuring(folder: Path, size: tuple[int, int] = (80, 24)) -> AsyncIterator[Driven]:
    interface = Glidecal(CheckScreen(quick_plan(folder)))
    async with interface.run_test(size=size, notifications=True) as pilot:
        screen = await to_measuring(pilot, interface)
        yield pilot, interface, screen
        await pilot.press("f10")


def on(screen: MeasureScreen, selector: str) -> str:
    return str(screen.query_one(selector, Static).content)


def notes(screen: MeasureScreen) -> list[str]:
    return [e.text for e in read_record(screen.guided.path).events if isinstance(e, Noted)]


async def take_something_else(
    pilot: Pilot[str], screen: MeasureScreen, monkeypatch: pytest.MonkeyPatch, off_mm: float
) -> None:
    """Take the present step with every indicator off by so much."""
    ask = Gauge.ask

    def wrong(gauge: Gauge) -> Future[Outcome]:
        heard, future = ask(gauge).result(), Future[Outcome]()
        assert isinstance(heard, IndicatorReading)
        future.set_result(replace(heard, value_mm=heard.value_mm + off_mm))
        return future

    with monkeypatch.context() as patched:
        patched.setattr(Gauge, "ask", wrong)
        await take(pilot, screen)


@pytest.mark.parametrize(
    ("key", "message"),
    first_quick(
        [
            ("1", "Not kept. Next is step 4: take it again."),
            ("2", "leave the posture"),
            ("3", "Next is step 1: move there"),
            ("4", "With the new zero steps 2, 3 are measured again, too"),
            ("5", "Step 4 is kept"),
            ("escape", "Not kept. Next is step 4: take it again."),
        ],
        several=True,
    ),
)
async def test_of_two_repeats_that_disagree_either_may_be_wrong(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, key: str, message: str
) -> None:
    async with measuring(tmp_path) as (pilot, interface, screen):
        for _ in range(3):
            await take(pilot, screen)
        await take_something_else(pilot, screen, monkeypatch, 0.2)
        await until(pilot, "a question", lambda: isinstance(interface.screen, ChoiceDialog))
        await until(pilot, "its words", lambda: interface.screen.query(Static))
        question = str(interface.screen.query(Static).first().content)
        assert "Step 4 does not agree with step 1, leg X ZERO, cycle 1:" in question
        assert "Which of these two is wrong?" in question
        rows = [line.split() for line in question.splitlines()[2:4]]
        assert rows[0][:4] == ["step", "1,", "cycle", "1"]
        assert rows[1][:5] == ["step", "4,", "cycle", "2", "(now)"]
        values = {r.reading: f"{r.value_mm:+.4f}" for r in screen.guided.session.all_readings}
        assert [row[-2:] for row in rows] == [[values[1], values[2]], [values[7], values[8]]]
        assert len(screen.guided.session.all_readings) == 8, "on the disk before it is asked"
        assert "cycle 2 of 3" in on(screen, "#step"), "the step in question"
        await pilot.press(key)
        await until(pilot, "an answer", lambda: interface.screen is screen)
        session = screen.guided.session
        is_kept = key == "5"
        done = {"3": {2, 3, 4}, "4": {1}, "5": {1, 2, 3, 4}}.get(key, {1, 2, 3})
        gone = {"3": {1, 2}, "4": {3, 4, 5, 6, 7, 8}, "5": set[int]()}.get(key, {7, 8})
        assert session.done() == done
        assert set(session.superseded) == gone
        assert ("LEG X   MAX" if key in "45" else "LEG X   ZERO") in on(screen, "#step")
        assert len(session.mountings) == (2 if key == "4" else 1)
        assert message in on(screen, "#said")
        if is_kept:
            assert all(why.endswith("mm from step 1: kept") for why in session.restored.values())
        else:
            assert any("mm from step 1" in note for note in notes(screen))
        if key == "3":
            return
        await take(pilot, screen)
        assert max(screen.guided.session.done()) == {"4": 2, "5": 5}.get(key, 4)
        assert ("Y  cycle 2* " in on(screen, "#table")) == is_kept
        assert ("*kept" in on(screen, "#table")) == is_kept


@LONG
async def test_the_third_repeat_settles_which_one_is_odd(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A wrong MAX in cycle 1: the second is kept beside it, the third names the first alone."""
    async with measuring(tmp_path) as (pilot, interface, screen):
        await take(pilot, screen)
        await take_something_else(pilot, screen, monkeypatch, 0.3)
        for _ in range(3):
            await take(pilot, screen)
        await until(pilot, "a question", lambda: isinstance(interface.screen, ChoiceDialog))
        assert "Step 5 does not agree with step 2" in text(interface, "Static")
        await pilot.press("5")
        await until(pilot, "an answer", lambda: interface.screen is screen)
        for _ in range(3):
            await take(pilot, screen)
        await until(pilot, "a question", lambda: isinstance(interface.screen, ChoiceDialog))
        question = text(interface, "Static")
        assert "The odd one is step 2, leg X MAX, cycle 1:" in question
        assert [line.split()[-1] == "odd" for line in question.splitlines()[2:5]] == [
            True,
            False,
            False,
        ]
        assert "Taken and on the disk, step 8" in on(screen, "#said")
        assert screen.guided.session.done() == {1, 3, 4, 5, 6, 7, 8}, "the good ones count"
        await pilot.press("1")
        await until(pilot, "an answer", lambda: interface.screen is screen)
        assert "cycle 1 of 3" in on(screen, "#step")
        assert "LEG X   MAX" in on(screen, "#step")
        await take(pilot, screen)
        assert screen.guided.session.done() == set(range(1, 9))
        assert "LEG X   MIN   cycle 3" in on(screen, "#step")


@LONG
async def test_an_earlier_step_is_repeated_and_taken_back(tmp_path: Path) -> None:
    async with measuring(tmp_path) as (pilot, interface, screen):
        for _ in range(4):
            await take(pilot, screen)
        await pilot.press("b")
        await until(pilot, "a list", lambda: isinstance(interface.screen, ChoiceDialog))
        assert interface.screen.query_one(OptionList).option_count == 4
        await pilot.press("2")
        await until(pilot, "a reason", lambda: isinstance(interface.screen, TextDialog))
        await pilot.press(*"bump [mm]", "enter")
        await until(pilot, "back", lambda: interface.screen is screen)
        assert "bump [mm]" in on(screen, "#said")
        assert screen.guided.session.done() == {1, 3, 4}
        assert set(screen.guided.session.superseded.values()) == {"bump [mm]"}
        assert "LEG X   MAX" in on(screen, "#step")
        await pilot.press("b")
        await until(pilot, "a list", lambda: isinstance(interface.screen, ChoiceDialog))
        entry = str(interface.screen.query_one(OptionList).get_option_at_index(1).prompt)
        assert "superseded: bump [mm]" in entry
        for answer, done in (("1", {1, 3, 4}), ("2", {1, 2, 3, 4})):
            await pilot.press("2")
            await until(pilot, "a question", lambda: "(bump [mm])" in text(interface, "Static"))
            assert screen.guided.session.done() == {1, 3, 4}, "nothing changes before the answer"
            await pilot.press(answer)
            await until(pilot, "back", lambda: interface.screen is screen)
            assert screen.guided.session.done() == done
            if answer == "1":
                await pilot.press("b")
                await until(pilot, "a list", lambda: isinstance(interface.screen, ChoiceDialog))
        assert "are used again" in on(screen, "#said")
        assert screen.guided.session.done() == {1, 2, 3, 4}
        assert screen.guided.session.superseded == {}


@LONG
async def test_skip_one_step_and_the_rest_of_a_leg(tmp_path: Path) -> None:
    async with measuring(tmp_path) as (pilot, interface, screen):
        await take(pilot, screen)
        await pilot.press("s", "1", *"in the way", "enter")
        await until(pilot, "skipped", lambda: screen.guided.session.skipped == {2: "in the way"})
        await until(pilot, "back", lambda: interface.screen is screen)
        assert "LEG X   MIN" in on(screen, "#step")
        await pilot.press("s")
        await until(pilot, "a choice", lambda: isinstance(interface.screen, ChoiceDialog))
        await pilot.press("2")
        await until(pilot, "a reason", lambda: isinstance(interface.screen, TextDialog))
        await pilot.press(*"no room", "enter")
        await until(pilot, "next leg", lambda: "LEG Y   ZERO" in on(screen, "#step"))
        assert set(screen.guided.session.skipped) == set(range(2, 11))
        await pilot.press("s", "escape")
        await until(pilot, "back", lambda: interface.screen is screen)
        assert len(screen.guided.session.skipped) == 9
        await pilot.press("b", "2", *"works now", "enter")
        await until(pilot, "brought back", lambda: 2 not in screen.guided.session.skipped)
        await until(pilot, "back", lambda: interface.screen is screen)
        assert "LEG X   MAX" in on(screen, "#step")


async def test_hold_takes_nothing(tmp_path: Path) -> None:
    async with measuring(tmp_path) as (pilot, _, screen):
        await pilot.press("p")
        await until(pilot, "hold", lambda: "ON HOLD" in on(screen, "#progress"))
        await pilot.press("a")
        await until(pilot, "stillness", screen.attended.ready_by_hand)
        await pilot.press("space")
        await pilot.pause(0.5)
        assert screen.guided.session.done() == set()
        assert "on hold" in on(screen, "#said")
        await pilot.press("p")
        await until(pilot, "goes on", lambda: len(screen.guided.session.done()) > 0)
        assert notes(screen) == ["on hold", "continued"]


async def test_hold_while_an_unattended_review_is_shown(tmp_path: Path) -> None:
    async with measuring(tmp_path) as (pilot, interface, screen):
        await pilot.press("a")
        await until(pilot, "review", lambda: isinstance(interface.screen, LegReviewScreen))
        await pilot.press("p")
        await until(pilot, "hold", lambda: interface.screen is screen and screen.attended.on_hold)
        assert "ON HOLD" in on(screen, "#progress")
        assert "LEG Y   ZERO" in on(screen, "#step")
        assert notes(screen) == ["on hold"]


async def test_a_computer_that_slept_holds_the_session(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with measuring(tmp_path) as (pilot, _, screen):
        monkeypatch.setattr("protocols.clock.steady_s", lambda: steady_s() + 720.0)
        await until(pilot, "hold", lambda: screen.attended.on_hold)
        assert "slept for 12 min" in on(screen, "#said")
        assert "press P to continue" in on(screen, "#said")
        assert notes(screen) == ["the computer slept for 720 s"]


async def test_a_clock_that_is_set_is_told_and_noted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with measuring(tmp_path) as (pilot, _, screen):
        clock = screen.guided.clock
        wall_clock = clock.wall
        monkeypatch.setattr(clock, "wall", lambda: wall_clock() + timedelta(hours=1))
        await until(pilot, "words", lambda: "set forward by 3600 s" in on(screen, "#said"))
        assert not screen.attended.on_hold
        assert notes(screen) == ["the computer's clock was set forward by 3600 s; time_s goes on"]


async def test_review_after_each_leg(tmp_path: Path) -> None:
    async with measuring(tmp_path, (120, 40)) as (pilot, interface, screen):
        for _ in range(9):
            await take(pilot, screen)
        await press_for(
            pilot, screen, "review", lambda: isinstance(interface.screen, LegReviewScreen)
        )
        await until(pilot, "its words", lambda: text(interface, "#review-text"))
        review_text = str(interface.screen.query_one("#review-text", Static).content)
        assert "Leg X is done" in review_text
        assert "4 differences so far" in review_text
        assert "X along Y, MAX" in review_text
        table_rows = [
            line.split() for line in review_text.splitlines() if line.startswith((" Y ", " Z "))
        ]
        assert [row[2] for row in table_rows] == ["4", "4"], (
            "10 readings, 4 cells and 2 more cycles an axis"
        )
        assert interface.screen.query_one(ChartPlot).display
        await pilot.press("space")
        await until(pilot, "next leg", lambda: interface.screen is screen)
        assert "LEG Y   ZERO" in on(screen, "#step")


async def test_plot_instead_of_the_table_and_help(tmp_path: Path) -> None:
    async with measuring(tmp_path) as (pilot, interface, screen):
        for _ in range(2):
            await take(pilot, screen)
        assert not screen.query_one(ChartPlot).display
        await pilot.press("v")
        await pilot.pause()
        assert screen.query_one(ChartPlot).display
        assert not screen.query_one("#table").display
        await pilot.press("v", "f1")
        await until(pilot, "help", lambda: isinstance(interface.screen, HelpDialog))
        await pilot.press("escape")
        assert screen.query_one("#table").display


async def test_wide_terminal_shows_table_and_plot(tmp_path: Path) -> None:
    async with measuring(tmp_path, (140, 40)) as (pilot, _, screen):
        await take(pilot, screen)
        assert screen.query_one(ChartPlot).display
        assert screen.query_one("#table").display


async def test_a_skipped_step_brought_back_from_another_leg_brings_its_zero(tmp_path: Path) -> None:
    async with measuring(tmp_path) as (pilot, _, screen):
        await take(pilot, screen)
        screen.guided.skip(range(2, 11), "no time")
        screen.proceed()
        await take(pilot, screen)
        await pilot.press("b", "2")
        await until(pilot, "why", lambda: isinstance(screen.app.screen, TextDialog))
        question = str(screen.app.screen.query_one(Static).content)
        assert "Why is step 2 brought back?" in question
        assert "2 steps are measured, to share one zero" in question
        await pilot.press("o", "k", "enter")
        await until(pilot, "back", lambda: screen.guided.step() == screen.guided.steps[0])
        assert set(screen.guided.session.skipped) == set(range(3, 11))


async def test_an_empty_reason_is_not_taken_and_escape_says_what_is_next(tmp_path: Path) -> None:
    async with measuring(tmp_path) as (pilot, interface, screen):
        await take(pilot, screen)
        for keys, question in ((("b", "1"), "Why is step 1"), (("s", "1"), "Why?")):
            await pilot.press(*keys)
            await until(pilot, "a reason", lambda: isinstance(interface.screen, TextDialog))
            question_text = str(interface.screen.query_one(Static).content)
            assert question in question_text
            assert "Escape: nothing changes, step 2 stays the next." in question_text
            assert interface.screen.query_one(Input).value == ""
            await pilot.press("enter", "space", "enter")
            await pilot.pause()
            assert interface.screen.query_one(Input), "still asked"
            await pilot.press("escape")
            await until(pilot, "back", lambda: interface.screen is screen)
            assert "Nothing changes, step 2 stays the next." in on(screen, "#said")
        assert screen.guided.session.done() == {1}


async def test_escape_asks_and_home_offers_the_paused_session(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    async with measuring(tmp_path) as (pilot, interface, screen):
        await take(pilot, screen)
        path = screen.guided.path
        for answer in ("escape", "1"):
            await pilot.press("escape")
            await until(pilot, "question", lambda: isinstance(interface.screen, ChoiceDialog))
            await pilot.press(answer)
            await until(pilot, "measuring", lambda: interface.screen is screen)
        await pilot.press("escape")
        await until(pilot, "question", lambda: isinstance(interface.screen, ChoiceDialog))
        await pilot.press("2")
        await until(pilot, "home", lambda: isinstance(interface.screen, HomeScreen))
        assert interface.guided is None
        assert len(fold(read_record(path).events).readings) == 2
        listed = interface.screen.query_one(OptionList).get_option_at_index(0)
        assert str(listed.prompt).startswith("Continue")


@pytest.mark.parametrize("key", ["b", "escape"])
async def test_a_question_that_is_left_leaves_automatic_as_it_is_shown(
    tmp_path: Path, key: str
) -> None:
    """Once it took by hand from there on, and the screen still said automatic."""
    async with measuring(tmp_path) as (pilot, interface, screen):
        await take(pilot, screen)
        await pilot.press("p", "a", key)  # on hold nothing is taken meanwhile
        await until(pilot, "question", lambda: isinstance(interface.screen, ChoiceDialog))
        await pilot.press("escape")
        await until(pilot, "no question", lambda: interface.screen is screen)
        await pilot.press("p")
        await until(pilot, "continued", lambda: not screen.attended.on_hold)
        assert screen.attended.automatic
        assert "automatic" in on(screen, "#progress")


async def test_nothing_is_taken_under_a_question_while_one_over_it_is_answered(
    tmp_path: Path,
) -> None:
    async with measuring(tmp_path) as (pilot, interface, screen):
        await pilot.press("n")
        await until(pilot, "note", lambda: isinstance(interface.screen, TextDialog))
        screen.run_worker(screen.ask(ChoiceDialog("Stand?", [("yes", "Yes")]), over=True))
        await until(pilot, "over it", lambda: isinstance(interface.screen, ChoiceDialog))
        await pilot.press("enter")
        await until(pilot, "note again", lambda: isinstance(interface.screen, TextDialog))
        screen.attended.automatic = True
        await pilot.pause(0.5)  # all stand still: it would be taken
        assert screen.asking
        assert not screen.guided.session.readings
        await pilot.press("escape")
        await until(pilot, "taken by itself", lambda: bool(screen.guided.session.readings))
