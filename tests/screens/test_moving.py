"""A machine that moves itself, on the screen: keys stop it, a set-up waits for one."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
from textual.events import MouseDown
from textual.pilot import Pilot
from textual.widgets import Input, Select, Static

from app.measuring.moving import Mover
from app.measuring.plan import Plan
from app.report.text.motion import QUESTION
from app.screens.check import CheckScreen
from app.screens.interface import ChoiceDialog, Glidecal, TextDialog
from app.screens.measure import MeasureScreen
from app.screens.prepare import PrepareScreen
from app.screens.session_view import LegReviewScreen, MotionDialog
from drivers.motion.guard import DETACHED
from drivers.motion.line import DEAD_S, Patience
from drivers.motion.states import State
from protocols.machine import Instrument, Machine, MotionLimits
from protocols.procedure import load_procedure
from tests.app.measuring.moving_machine import (
    Bench,
    carriages,
    following,
    linuxcnc,
    remember_proved,
    taken,
    wrong,
)
from tests.conftest import LONG, first_quick
from tests.drivers.motion.twins import TWINS, MotionTrouble, MotionTwin
from tests.screens.driving import SIZE, fill_in, rows, text, to_measuring, until

SLOW = Machine(motion=MotionLimits(feed_mm_min=3000.0))
QUIET_S = 1.1
"""A little more than the dead time, and than a key that is held repeats."""


@pytest.fixture(autouse=True)
def _busy_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    """Screens of tests may be held up for longer than the program allows its own."""
    monkeypatch.setattr("app.measuring.opening.STRICT", Patience(silence_s=3.0))
    monkeypatch.setattr("app.measuring.gauges.LOST_S", 2.0)


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

    async def comes(self, *states: State) -> None:
        await until(self.pilot, str(states), lambda: self.mover.state in states)

    async def says(self, words: str) -> None:
        await until(self.pilot, words, lambda: words in text(self.interface, "#said"))

    async def go(self) -> None:
        """G, when the last thing was long enough ago."""
        await self.pilot.pause(QUIET_S)
        moves = len(self.twin.moves)
        await self.pilot.press("g")
        await until(self.pilot, "a move", lambda: len(self.twin.moves) > moves)

    async def prove(self) -> None:
        """G for a move of a proof, again where the indicators did not rest at that moment."""
        moves = len(self.twin.moves)
        for _ in range(5):
            await until(self.pilot, "rest", self.screen.attended.ready_by_hand)
            await self.pilot.pause(QUIET_S)
            await self.pilot.press("g")
            await self.pilot.pause(0.2)
            if len(self.twin.moves) > moves:
                return
        pytest.fail(f"no move: {text(self.interface, '#said')} {self.mover.why}")

    async def set_up(self) -> None:
        await self.says("Nobody at the machine? G moves it to Zero, 3.7 mm.")
        await self.go()
        await self.says("Set up at leg X")
        assert not self.bench.axes.moving
        step = self.screen.guided.step()
        assert step is not None
        self.bench.set_up(step)
        await self.go()

    async def second_move(self) -> int:
        """Under way to the second step; how many readings there are."""
        await self.set_up()
        await until(self.pilot, "a take", lambda: len(taken(self.path)) >= 2)
        await until(self.pilot, "the next move", lambda: self.bench.axes.moving)
        return len(taken(self.path))

    async def dialog(self) -> MotionDialog:
        await until(self.pilot, "dialog", lambda: isinstance(self.interface.screen, MotionDialog))
        await until(self.pilot, "its words", lambda: bool(text(self.interface, "#event")))
        assert isinstance(self.interface.screen, MotionDialog)
        return self.interface.screen


@asynccontextmanager
async def measuring(
    folder: Path, name: str = "linuxcnc", *troubles: MotionTrouble, proved: bool = True
) -> AsyncIterator[Moved]:
    machine = SLOW if name == "linuxcnc" else SLOW.model_copy(update={"mdi": "joint"})
    procedure = load_procedure("zero-max-min", SLOW.geometry())
    short = procedure.model_copy(update={"cycles": 1, "legs": ("x",)})
    path = folder / "a.jsonl"
    make = linuxcnc if name == "linuxcnc" else TWINS[name]
    with following(make, machine.mdi) as (bench, twin, ports):
        for trouble in troubles:
            twin.befall(trouble)
        instruments = tuple(Instrument(profile="mitutoyo-01a", port=port) for port in ports)
        plan = Plan(path, machine, short, instruments, window_s=0.2, motion=twin.endpoint)
        if proved:
            remember_proved(plan)
        interface = Glidecal(CheckScreen(plan))
        async with interface.run_test(size=SIZE, notifications=True) as pilot:
            screen = await to_measuring(pilot, interface)
            yield Moved(pilot, interface, screen, bench, twin, path)


@LONG
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
            form.query_one("#motion", Input).value = twin.endpoint
            await until(pilot, "more to measure", lambda: chosen.value == "two-station")
            await pilot.press("f2")
            await until(pilot, "a dry run", lambda: text(interface, "#dry-run-text"))
            words = " ".join(text(interface, "#dry-run-text").split())
            assert "Procedure two-station: the usual one where a machine moves itself" in words
            await pilot.press("escape")
            await until(pilot, "the form", lambda: interface.screen is form)
            await pilot.press("f5")
            await until(pilot, "the check", lambda: "longest move" in text(interface, "#words"))
            check_text = " ".join(text(interface, "#words").split())
            assert "joint_homed YES YES YES" in check_text
            assert "longest move 38.0 mm" in check_text  # from 22 to Max
            shown = interface.screen.query_one("#words", Static)
            first, *others = str(shown.content).splitlines()
            assert QUESTION in first, "broken by the screen"
            await until(pilot, "its bar", lambda: shown.region.width < SIZE[0])
            room, prose = shown.content_size.width, [line for line in others if "G53" not in line]
            twice = [line for line in prose if room < len(line) < 2 * room]
            assert not twice, "what is broken already is not broken again"
            await pilot.pause()
            assert "Enter begins; nothing moves yet" in "".join(
                rows(interface.screen)[:6]
            )  # never scrolled out
            assert check_text.count("G53 G1 X") == 138  # of two-station, which nobody named
            await pilot.press("escape")
            await until(pilot, "the form", lambda: interface.screen is form)
        assert not twin.moves


async def test_it_measures_itself_once_each_way_is_consented(tmp_path: Path) -> None:
    async with measuring(tmp_path) as moved:
        await moved.set_up()
        await until(
            moved.pilot, "review", lambda: isinstance(moved.interface.screen, LegReviewScreen)
        )
    assert len(taken(moved.path)) == 8
    assert not wrong(taken(moved.path), moved.bench)


@pytest.mark.parametrize(
    "key", first_quick(["space", "p", "escape", "enter", "x", "n", "f1", "click"])
)
async def test_every_key_stops_it_and_only_g_goes_on(key: str, tmp_path: Path) -> None:
    async with measuring(tmp_path) as moved:
        before = await moved.second_move()
        assert "The tool goes to" in text(moved.interface, "#step")
        await until(moved.pilot, "keys", lambda: "Take" not in rows(moved.screen)[-1])
        assert not {"Repeat", "Back", "Skip", "Hold"} & {*rows(moved.screen)[-1].split()}
        if key == "click":
            click = MouseDown(None, 9, 9, 0, 0, 1, shift=False, meta=False, ctrl=False)
            moved.interface.post_message(click)
        else:
            await moved.pilot.press(key)
        await moved.comes(State.STOPPED)
        assert not moved.bench.axes.moving
        await until(moved.pilot, "keys", lambda: "Take" in rows(moved.screen)[-1])
        await moved.says("STOPPED: stopped by the operator.")
        assert isinstance(moved.interface.screen, MeasureScreen)  # the key did nothing else
        assert moved.screen.attended.on_hold
        moves = len(moved.twin.moves)
        await moved.pilot.press("g")  # within the dead time
        for other_key in ("space", "enter", "p", "a"):
            await moved.pilot.press(other_key)
        await moved.pilot.pause(QUIET_S)
        await moved.pilot.press("space", "enter", "p", "p", "a", "a")
        await moved.pilot.pause(0.3)
        assert len(moved.twin.moves) == moves
        assert len(taken(moved.path)) == before
        await moved.go()
        await until(moved.pilot, "the next take", lambda: len(taken(moved.path)) > before)
    assert not wrong(taken(moved.path), moved.bench)


async def test_g_that_is_held_counts_once(tmp_path: Path) -> None:
    """Through the way to Zero and the arrival there, where hands go in."""
    async with measuring(tmp_path) as moved:
        await moved.says("G moves it to Zero")
        await moved.pilot.pause(QUIET_S)
        end = time.monotonic() + 2.5
        while time.monotonic() < end:
            await moved.pilot.press("g")
            await moved.pilot.pause(0.03)
        assert len(moved.twin.moves) == 1
        await moved.says("Set up at leg X")


@pytest.mark.parametrize("late_s", first_quick([0.0, 0.3]))
async def test_space_meant_as_stop_just_after_the_arrival_moves_nothing(
    late_s: float, tmp_path: Path
) -> None:
    async with measuring(tmp_path) as moved:
        await moved.says("G moves it to Zero")
        await moved.go()
        await until(moved.pilot, "the arrival", lambda: not moved.bench.axes.moving)
        await moved.pilot.pause(late_s)
        await moved.pilot.press("space", "g")
        await moved.pilot.pause(0.8)
        assert len(moved.twin.moves) == 1


async def test_nothing_moves_while_an_indicator_gives_no_value(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for silence in ("LATEST", "PROOF"):  # no late answer is on its way here
        monkeypatch.setattr(f"drivers.exchange.{silence}", 1.0)
    async with measuring(tmp_path) as moved:
        await moved.says("G moves it to Zero")
        moved.bench.unplugged = True
        await moved.says("FAULT: indicator 1")
        await moved.pilot.pause(QUIET_S)
        await moved.pilot.press("g")
        await moved.pilot.pause(0.5)
        assert not moved.twin.moves
        moved.bench.unplugged = False
        await moved.says("answers again")
        await moved.go()


@pytest.mark.parametrize(
    "trouble", first_quick([MotionTrouble.ESTOP, MotionTrouble.NAK, "indicator"])
)
async def test_what_befalls_it_is_said_and_answered_before_it_moves(
    trouble: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("app.measuring.gauges.LOST_S", 0.7)
    async with measuring(tmp_path) as moved:
        before = await moved.second_move()
        if trouble == "indicator":
            moved.bench.unplugged = True
        else:
            moved.twin.befall(MotionTrouble(trouble))
        await moved.comes(State.HELD, State.FAULT)
        assert not moved.bench.axes.moving
        moves = len(moved.twin.moves)
        monkeypatch.setattr("app.screens.session_view.DEAD_S", 600.0)  # however slow this runs
        dialog = await moved.dialog()
        await moved.pilot.press("p", "g", "enter")  # as one who is startled
        await moved.pilot.pause(0.3)
        assert moved.interface.screen is dialog
        assert len(moved.twin.moves) == moves
        moved.twin.mend()
        moved.bench.unplugged = False
        monkeypatch.setattr("app.screens.session_view.DEAD_S", DEAD_S)
        await moved.pilot.pause(QUIET_S)
        await moved.pilot.press("enter")
        await moved.comes(State.READY)
        await until(
            moved.pilot, "the screen", lambda: isinstance(moved.interface.screen, MeasureScreen)
        )
        await moved.pilot.pause(0.3)
        assert len(moved.twin.moves) == moves
        assert len(taken(moved.path)) == before
        if trouble != "indicator":  # which needs half a minute until its answers count again
            await moved.go()
            await until(moved.pilot, "the next take", lambda: len(taken(moved.path)) > before)
    assert not wrong(taken(moved.path), moved.bench)


@pytest.mark.parametrize(
    "trouble",
    first_quick([MotionTrouble.MODE, MotionTrouble.OVERRIDE, MotionTrouble.UNHOMED, "jog"]),
)
async def test_what_others_do_while_hands_are_in_it_is_said(trouble: str, tmp_path: Path) -> None:
    async with measuring(tmp_path) as moved:
        await moved.says("G moves it to Zero")
        await moved.go()
        await moved.says("Set up at leg X")
        if trouble == "jog":
            moved.bench.axes.go((0.0, 5.0, 0.0), 600.0)
        else:
            moved.twin.befall(MotionTrouble(trouble))
        await moved.dialog()
        assert moved.mover.state is State.HELD
        assert len(moved.twin.moves) == 1


async def test_a_board_that_its_port_reset_is_homed_from_here_with_a_word_for_it(
    tmp_path: Path,
) -> None:
    """Opening the port of an Uno starts it anew; nobody else can then tell it to home."""
    async with measuring(tmp_path, "grbl", MotionTrouble.NOT_HOMED) as moved:
        await moved.dialog()
        assert "H      Home it" in text(moved.interface, "#event")
        await moved.pilot.pause(QUIET_S)
        await moved.pilot.press("h")
        await moved.comes(State.READY)
        await moved.go()  # no question whether it is homed: it was seen


async def asked_whether_it_was_homed(moved: Moved) -> None:
    """G asks on a board that cannot tell; nothing moved yet."""
    await moved.says("G moves it to Zero")
    await moved.pilot.pause(QUIET_S)
    await moved.pilot.press("g")
    await until(moved.pilot, "question", lambda: isinstance(moved.interface.screen, ChoiceDialog))
    assert not moved.twin.moves


async def test_a_board_that_cannot_tell_is_homed_by_the_operators_word(tmp_path: Path) -> None:
    async with measuring(tmp_path, "grbl") as moved:
        await asked_whether_it_was_homed(moved)
        await moved.pilot.press("1")
        await moved.go()


async def test_a_board_that_was_not_homed_is_homed_from_here(tmp_path: Path) -> None:
    async with measuring(tmp_path, "grbl") as moved:
        await asked_whether_it_was_homed(moved)
        await moved.pilot.press("2")
        await moved.dialog()
        assert "found not homed" in text(moved.interface, "#event")
        await moved.pilot.pause(QUIET_S)
        await moved.pilot.press("h")
        await moved.comes(State.READY)
        await moved.go()


@LONG
async def test_a_machine_that_does_not_stop_is_said_in_red_until_it_does(tmp_path: Path) -> None:
    async with measuring(tmp_path) as moved:
        await moved.second_move()
        moved.twin.befall(MotionTrouble.SILENCE)
        await moved.pilot.press("space")
        await moved.dialog()
        await until(
            moved.pilot,
            "words",
            lambda: "Use the emergency stop" in text(moved.interface, "#event"),
        )
        assert moved.mover.line.not_stopped
        moved.twin.mend()
        await moved.comes(State.STOPPED, State.FAULT)


@LONG
@pytest.mark.parametrize("silent", first_quick([True, False]))
async def test_who_leaves_is_told_last_whether_the_machine_was_seen_to_stop(
    silent: bool, tmp_path: Path
) -> None:
    async with measuring(tmp_path) as moved:
        await moved.second_move()
        if silent:
            moved.twin.befall(MotionTrouble.SILENCE)
        await moved.pilot.press("ctrl+q")
        await until(moved.pilot, "the end", lambda: moved.interface.return_value is not None)
        moved.twin.mend()
        await until(
            moved.pilot, "a guard", lambda: all(process.poll() is not None for process in DETACHED)
        )
    words = str(moved.interface.return_value)
    assert words.startswith("NOT STOPPED. Use the emergency stop.") is silent
    assert "Session paused after 1 of 4 steps" in words
    assert words.endswith(f"glidecal run --continue {moved.path} --motion {moved.twin.endpoint}")


@LONG
async def test_a_new_machine_moves_each_carriage_a_little_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("app.measuring.moving.FEED_MM_MIN", 1500.0)
    async with measuring(tmp_path, proved=False) as moved:
        await moved.says(
            "Set up at leg X, station 0.5, along Y and Z, with the machine where it is"
        )
        step = moved.screen.guided.step()
        assert step is not None
        moved.bench.set_up(step)
        for number, name in enumerate("XYZ"):
            await moved.says(f"G moves carriage {name} 5 mm outward")
            await moved.pilot.press("space", "enter")
            await moved.prove()
            await until(moved.pilot, "back", lambda n=number: len(moved.twin.moves) == 2 * n + 2)
            if name == "X":
                await until(
                    moved.pilot, "eye", lambda: isinstance(moved.interface.screen, ChoiceDialog)
                )
                await moved.pilot.press("2")
        await moved.says("Proved. Take the stand away from the bar.")
        await moved.says("G moves it to Zero, 3.7 mm.")
        assert moved.mover.unproved is None
        assert len(moved.twin.moves) == 6


async def test_a_machine_that_is_not_as_its_file_says_is_told_and_moves_no_further(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("app.measuring.moving.FEED_MM_MIN", 1500.0)
    start = carriages((3.0, -2.0, 1.0))
    async with measuring(tmp_path, proved=False) as moved:
        moved.bench.wired = lambda now: [
            start[k] + now[j] - start[j] for k, j in enumerate((1, 0, 2))
        ]
        await moved.says("G moves carriage X")
        await moved.prove()
        dialog = await moved.dialog()
        assert "carriage Y moves in its place" in text(moved.interface, "#event")
        await moved.pilot.pause(QUIET_S)
        await moved.pilot.press("enter")
        await until(moved.pilot, "an answer", lambda: moved.interface.screen is not dialog)
        await moved.says("NOT PROVED. Sent carriage X 5 mm outward")
        await moved.pilot.pause(QUIET_S)
        await moved.pilot.press("space", "p", "enter")
        assert len(moved.twin.moves) == 1


async def test_any_key_stops_a_proof_half_way(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("app.measuring.moving.FEED_MM_MIN", 60.0)
    async with measuring(tmp_path, proved=False) as moved:
        await moved.says("G moves carriage X")
        await moved.prove()
        await moved.says("MOVING carriage X 5 mm outward")
        await moved.pilot.press("x")
        await moved.comes(State.STOPPED)
        await moved.says("G moves carriage X 5 mm outward")
        assert len(moved.twin.moves) == 1


async def test_a_note_that_comes_when_the_record_is_let_go_of_is_refused(tmp_path: Path) -> None:
    async with measuring(tmp_path) as moved:
        await moved.says("G moves it to Zero")
        await moved.pilot.press("n")
        await until(moved.pilot, "question", lambda: isinstance(moved.interface.screen, TextDialog))
        await asyncio.to_thread(moved.screen.guided.leave)
        await moved.pilot.press("x", "enter")
        await moved.says("found a closed record")


async def test_a_note_that_is_typed_on_answers_no_dialog(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its letters, and the Enter behind them, go to the dialog that came over it."""
    async with measuring(tmp_path) as moved:
        await moved.says("G moves it to Zero")
        await moved.pilot.press("n")
        await until(moved.pilot, "question", lambda: isinstance(moved.interface.screen, TextDialog))
        monkeypatch.setattr("app.screens.session_view.DEAD_S", 2.0)
        moved.bench.axes.go((0.0, 5.0, 0.0), 600.0)
        dialog = await moved.dialog()
        end_s = time.monotonic() + 2.5
        while time.monotonic() < end_s:
            await moved.pilot.press("o")
        await moved.pilot.press("enter")
        await moved.pilot.pause(0.3)
        assert moved.interface.screen is dialog
        assert moved.mover.state is State.HELD
        await moved.pilot.pause(2.1)
        await moved.pilot.press("enter")
        await moved.comes(State.READY)
