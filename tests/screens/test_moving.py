"""A machine that moves itself, on the screen: keys stop it, a set-up waits for one."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
from textual.pilot import Pilot
from textual.widgets import Input, Select

from app.measuring.moving import Mover, Moving
from app.measuring.plan import Plan
from app.screens.check import CheckScreen
from app.screens.interface import ChoiceDialog, TextDialog
from app.screens.measure import MeasureScreen
from app.screens.prepare import PrepareScreen
from app.screens.session_view import LegReviewScreen
from app.screens.start import Glidecal
from drivers.motion.twins import MotionTrouble, MotionTwin
from protocols.machine import Instrument, Machine, MotionLimits
from protocols.procedure import load_procedure
from tests.app.measuring.moving_machine import Bench, following, taken, wrong
from tests.screens.driving import SIZE, fill_in, rows, text, to_measuring, until

SLOW = Machine(motion=MotionLimits(feed_mm_min=6000.0))


@dataclass
class Moved:
    pilot: Pilot[str]
    interface: Glidecal
    screen: MeasureScreen
    bench: Bench
    twin: MotionTwin
    path: Path

    @property
    def mover(self) -> Mover:
        assert self.screen.guided.mover is not None
        return self.screen.guided.mover

    async def comes(self, state: Moving) -> None:
        await until(self.pilot, state, lambda: self.mover.state is state)

    async def says(self, words: str) -> None:
        await until(self.pilot, words, lambda: words in text(self.interface, "#said"))

    async def set_up(self) -> None:
        await self.comes(Moving.SET_UP)
        await self.says("Set up at leg X")
        step = self.screen.guided.step()
        assert step is not None
        self.bench.set_up(step)
        await self.pilot.press("space")
        await until(self.pilot, "a move", lambda: self.mover.state is not Moving.SET_UP)


@asynccontextmanager
async def measuring(folder: Path) -> AsyncIterator[Moved]:
    procedure = load_procedure("zero-max-min", SLOW.geometry())
    short = procedure.model_copy(update={"cycles": 1, "legs": ("x",)})
    path = folder / "a.jsonl"
    with following() as (bench, twin, ports):
        instruments = tuple(Instrument(profile="mitutoyo-01a", port=port) for port in ports)
        plan = Plan(path, SLOW, short, instruments, window_s=0.2, motion=twin.told)
        interface = Glidecal(CheckScreen(plan))
        async with interface.run_test(size=SIZE, notifications=True) as pilot:
            screen = await to_measuring(pilot, interface)
            yield Moved(pilot, interface, screen, bench, twin, path)


async def test_the_check_says_what_will_move_before_a_key_lets_it(tmp_path: Path) -> None:
    with following() as (_, twin, ports):
        form = PrepareScreen()
        interface = Glidecal(form)
        async with interface.run_test(size=SIZE, notifications=True) as pilot:
            await pilot.pause()
            for name, port in zip(("indicator1", "indicator2"), ports, strict=True):
                await fill_in(pilot, interface, name, profile="mitutoyo-01a", port=port)
            chosen = form.query_one("#procedure", Select)
            assert chosen.value == "zero-max-min"
            form.query_one("#motion", Input).value = twin.told
            await until(pilot, "more to measure", lambda: chosen.value == "two-station")
            await pilot.press("f2")
            await until(pilot, "a dry run", lambda: text(interface, "#dry-run-text"))
            words = " ".join(text(interface, "#dry-run-text").split())
            assert "Procedure two-station: the usual one where a machine moves itself" in words
            await pilot.press("escape")
            await until(pilot, "the form", lambda: interface.screen is form)
            await pilot.press("f5")
            await until(pilot, "the check", lambda: "longest move" in text(interface, "#words"))
            said = " ".join(text(interface, "#words").split())
            assert "joint_homed YES YES YES" in said
            assert "longest move 38.0 mm" in said  # from 22 to Max
            await pilot.pause()
            assert "With Enter it moves" in "".join(
                rows(interface.screen)[:6]
            )  # never scrolled out
            assert said.count("G53 G1 X") == 138  # of two-station, which nobody named
            await pilot.press("escape")
            await until(pilot, "the form", lambda: interface.screen is form)
        assert not twin.moves


async def test_it_measures_itself_once_a_set_up_is_confirmed(tmp_path: Path) -> None:
    async with measuring(tmp_path) as moved:
        await moved.set_up()
        await until(
            moved.pilot, "review", lambda: isinstance(moved.interface.screen, LegReviewScreen)
        )
    assert len(taken(moved.path)) == 8
    assert not wrong(taken(moved.path), moved.bench)


@pytest.mark.parametrize("key", ["space", "p", "escape"])
async def test_a_key_stops_it_and_p_goes_on(key: str, tmp_path: Path) -> None:
    async with measuring(tmp_path) as moved:
        await moved.set_up()
        await until(moved.pilot, "a take", lambda: len(taken(moved.path)) >= 2)
        await until(moved.pilot, "the next move", lambda: moved.bench.axes.moving)
        before = len(taken(moved.path))
        assert "The tool goes to" in text(moved.interface, "#step")
        await moved.pilot.press(key)
        await until(moved.pilot, "a stop", lambda: not moved.bench.axes.moving)
        await moved.comes(Moving.STOPPED)
        assert moved.screen.held
        if key == "escape":
            await until(
                moved.pilot, "question", lambda: isinstance(moved.interface.screen, ChoiceDialog)
            )
            await moved.pilot.press("1")
        await moved.says(". Nothing was taken")
        assert "Move the tool to" in text(moved.interface, "#step")
        assert len(taken(moved.path)) == before
        await moved.pilot.press("p")
        await until(moved.pilot, "the next take", lambda: len(taken(moved.path)) > before)
    assert not wrong(taken(moved.path), moved.bench)


@pytest.mark.parametrize("trouble", [MotionTrouble.ESTOP, MotionTrouble.NAK, "indicator"])
async def test_what_befalls_it_is_said_and_nothing_taken(trouble: str, tmp_path: Path) -> None:
    async with measuring(tmp_path) as moved:
        await moved.set_up()
        await until(moved.pilot, "a take", lambda: len(taken(moved.path)) >= 2)
        await until(moved.pilot, "the next move", lambda: moved.bench.axes.moving)
        before = len(taken(moved.path))
        if trouble == "indicator":
            moved.bench.unplugged = True
        else:
            moved.twin.befall(MotionTrouble(trouble))
        await moved.comes(Moving.STOPPED)
        await moved.says("Nothing was taken")
        assert moved.screen.held
        assert not moved.bench.axes.moving
        assert len(taken(moved.path)) == before


async def test_a_note_that_comes_when_the_record_is_let_go_of_is_refused(tmp_path: Path) -> None:
    async with measuring(tmp_path) as moved:
        await moved.comes(Moving.SET_UP)
        await moved.pilot.press("n")
        await until(moved.pilot, "question", lambda: isinstance(moved.interface.screen, TextDialog))
        await asyncio.to_thread(moved.screen.guided.leave)
        await moved.pilot.press("x", "enter")
        await moved.says("found a closed record")
