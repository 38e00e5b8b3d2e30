"""The guided session driven by keys alone: state and messages first."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path

import pytest
from textual.binding import Binding
from textual.pilot import Pilot
from textual.widgets import Input, Static

from app.evaluating.solution import SessionSolution, solve_files
from app.measuring.gauges import Gauge
from app.measuring.plan import QUICK_INTERVAL_S
from app.report.text.help import help_of
from app.report.text.result import solution_text
from app.report.text.tables import KEY_ID
from app.screens.check import CheckScreen
from app.screens.home import HomeScreen
from app.screens.interface import ChoiceDialog, Glidecal, HelpDialog, TextDialog
from app.screens.measure import MeasureScreen
from app.screens.prepare import PrepareScreen
from app.screens.result import ResultScreen
from app.settings import Settings
from drivers.profile import Fault, FaultKind, IndicatorReading, Spindle
from drivers.profiles.mitutoyo_01a import MITUTOYO_01A
from drivers.twins import IndicatorTwin, TwinPort
from protocols.record import read_record
from protocols.session import fold
from tests.conftest import SAMPLES
from tests.screens.driving import (
    PRESSES,
    SIZE,
    answered,
    fill_in,
    numbers,
    press_for,
    quick_plan,
    take,
    text,
    to_measuring,
    until,
)


async def test_instrument_check_shows_live_values(tmp_path: Path) -> None:
    interface = Glidecal(CheckScreen(quick_plan(tmp_path)))
    async with interface.run_test(size=SIZE) as pilot:
        await until(pilot, "indicators open", lambda: interface.indicators is not None)
        await until(
            pilot,
            "digits",
            lambda: numbers(interface.screen) == ["+0.000", "+0.000"],
        )
        assert "Enter begins the session" in text(interface, "#words")
        await pilot.press("f10")
    assert not list(tmp_path.glob("*.jsonl"))


async def test_take_repeat_note_remount_and_pause(tmp_path: Path) -> None:
    plan = quick_plan(tmp_path)
    interface = Glidecal(CheckScreen(plan))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        screen = await to_measuring(pilot, interface)
        assert "LEG X   ZERO   cycle 1 of 3" in text(interface, "#step")
        assert "indicators on leg X along Y (1) and Z (2), 155 mm" in text(interface, "#step")
        await take(pilot, screen)
        assert "LEG X   MAX" in text(interface, "#step")
        assert "G53 G0 X60.000 Y0.000 Z0.000" in text(interface, "#step")
        assert "joints x 370.250  y 304.393  z 304.393" in text(interface, "#step")
        assert "Taken and on the disk, step 1" in text(interface, "#said")
        await take(pilot, screen)
        assert "MAX" in text(interface, "#table")
        await pilot.press("u")
        await pilot.pause()
        assert "LEG X   MAX" in text(interface, "#step")
        assert len(screen.guided.session.superseded) == 2
        await pilot.press("n", *"slip [x]", "enter")
        await pilot.pause()
        assert "Noted: slip [x]" in text(interface, "#said")
        for answer, mountings in (("1", 1), ("2", 2)):
            await pilot.press("m")
            await until(pilot, "question", lambda: isinstance(interface.screen, ChoiceDialog))
            await pilot.press(answer)
            await until(pilot, "answer", lambda: interface.screen is screen)
            assert len(screen.guided.session.mountings) == mountings
        await take(pilot, screen)
        await pilot.press("ctrl+c")
    assert interface.return_code == 130
    assert interface.return_value is not None
    assert f"glidecal run --continue {plan.path}" in interface.return_value
    session = fold(read_record(plan.path).events)
    assert session.done() == {1, 2}
    assert [m.mounts for m in session.mountings] == [
        {"y": "xy", "z": "xz"},
        {"y": "xy#2", "z": "xz#2"},
    ]
    assert read_record(plan.path).end == "open"


async def test_repeat_asks_where_it_takes_more_than_one_step(tmp_path: Path) -> None:
    """After the stand was moved one step alone has no zero: the operator hears how many go."""
    interface = Glidecal(CheckScreen(quick_plan(tmp_path)))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        screen = await to_measuring(pilot, interface)
        await take(pilot, screen)
        await take(pilot, screen)
        await pilot.press("m")
        await until(pilot, "question", lambda: isinstance(interface.screen, ChoiceDialog))
        await pilot.press("2")
        await until(pilot, "answer", lambda: interface.screen is screen)
        await pilot.press("u")
        await until(pilot, "question", lambda: isinstance(interface.screen, TextDialog))
        assert "2 steps are measured, to share one zero" in text(interface, ".dialog Static")
        await pilot.press("escape")
        await until(pilot, "answer", lambda: interface.screen is screen)
        assert screen.guided.session.done() == {1, 2}
        assert "Nothing changes, step 3 stays the next." in text(interface, "#said")
        await pilot.press("u", *"bumped", "enter")
        await until(pilot, "answer", lambda: interface.screen is screen)
        assert screen.guided.session.done() == frozenset()
        assert set(screen.guided.session.superseded.values()) == {"bumped"}
        await pilot.press("ctrl+c")


async def test_whole_session_verify_and_compare(tmp_path: Path) -> None:
    plan = quick_plan(tmp_path)
    plan = replace(plan, procedure=plan.procedure.model_copy(update={"cycles": 1}))
    interface = Glidecal(CheckScreen(plan))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        screen = await to_measuring(pilot, interface)
        for _ in screen.guided.steps:
            await take(pilot, screen)
        await until(pilot, "result", lambda: isinstance(interface.screen, ResultScreen))
        solution = solve_files([plan.path])  # as glidecal solve, home and replay have it
        words = solution_text(solution)
        await until(pilot, "the same result", lambda: words in text(interface, "#details-text"))
        await pilot.press("s", "3")
        await until(pilot, "both", lambda: "d_L_z" in text(interface, "#details-text"))
        await pilot.press("e")
        folder = plan.path.with_suffix("")
        await until(pilot, "export", lambda: (folder / "calib_joint2.inc").exists())
        await pilot.press("v")
        await until(pilot, "check", lambda: isinstance(interface.screen, CheckScreen))
        await to_measuring(pilot, interface)
        await pilot.press("a")
        await until(pilot, "comparison", lambda: isinstance(interface.screen, ResultScreen))
        await until(
            pilot,
            "before and after",
            lambda: "Leg deviations went from" in text(interface, "#result-text"),
        )
        await pilot.press("f10")
    assert interface.return_code == 0
    sessions = sorted(tmp_path.glob("*.jsonl"))
    assert [read_record(p).end for p in sessions] == ["closed", "closed"]


async def test_a_result_takes_the_place_of_the_session_under_an_open_dialog(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    computed = threading.Event()

    def slowly(_: list[Path]) -> SessionSolution:
        assert computed.wait(30.0)
        return solve_files([SAMPLES / "experiment_2_twelve.jsonl"])

    monkeypatch.setattr("app.screens.corrections.solve_files", slowly)
    plan = quick_plan(tmp_path)
    short = {"cycles": 1, "legs": ("x",)}
    plan = replace(plan, procedure=plan.procedure.model_copy(update=short))
    interface = Glidecal(CheckScreen(plan))
    async with interface.run_test(size=SIZE) as pilot:
        screen = await to_measuring(pilot, interface)
        for _ in screen.guided.steps:
            await take(pilot, screen)
        await until(pilot, "computing", lambda: screen.guided.closed)
        await pilot.press("f1")
        await until(pilot, "help", lambda: isinstance(interface.screen, HelpDialog))
        computed.set()
        await until(pilot, "result", lambda: isinstance(interface.screen, ResultScreen))
        await until(
            pilot, "its words", lambda: "Leg deviations" in text(interface, "#details-text")
        )
        assert screen not in interface.screen_stack


async def test_automatic_takes_whatever_stands_still(tmp_path: Path) -> None:
    interface = Glidecal(CheckScreen(quick_plan(tmp_path)))
    async with interface.run_test(size=SIZE) as pilot:
        screen = await to_measuring(pilot, interface)
        await pilot.press("a")
        await until(pilot, "two steps", lambda: len(screen.guided.session.done()) >= 2)
        assert "automatic" in str(screen.query_one("#progress", Static).content)
        await pilot.press("f10")


async def test_prepare_form_with_keys(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    interface = Glidecal(HomeScreen())
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await pilot.press("enter")
        await until(pilot, "form", lambda: isinstance(interface.screen, PrepareScreen))
        assert "Choose an indicator" in text(interface, "#summary")
        with TwinPort(IndicatorTwin(MITUTOYO_01A, Spindle(lambda: 0.5, 0.001)), "tcp") as twin:
            await prepare(pilot, interface, twin.url)


async def prepare(pilot: Pilot[str], interface: Glidecal, port: str) -> None:
    await fill_in(pilot, interface, "indicator1", port=port, profile="mitutoyo-01a")
    assert "60 steps with 1 indicator" in text(interface, "#summary")
    interface.screen.query_one("#machine", Input).value = "none.toml"
    await pilot.pause()
    assert "none.toml" in text(interface, "#summary")
    interface.screen.query_one("#machine", Input).value = ""
    interface.screen.query_one("#temperature", Input).value = "warm"
    await pilot.press("f5")
    await pilot.pause()
    assert isinstance(interface.screen, PrepareScreen)
    interface.screen.query_one("#temperature", Input).value = "21.5"
    await pilot.press("f5")
    await until(pilot, "check", lambda: isinstance(interface.screen, CheckScreen))
    await until(pilot, "indicators open", lambda: interface.indicators is not None)
    await pilot.press("escape")
    await until(pilot, "back", lambda: isinstance(interface.screen, PrepareScreen))
    await pilot.press("f10")


async def test_result_of_a_recorded_session(samples: Path) -> None:
    path = samples / "experiment_2_twelve.jsonl"
    result = solve_files([path])
    interface = Glidecal(ResultScreen(result, None, path))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await until(
            pilot, "text", lambda: "something is missing" in text(interface, "#result-text")
        )
        await pilot.press("v")
        await pilot.pause()
        assert isinstance(interface.screen, ResultScreen)
        await pilot.press("f10")


async def test_moving_readings_are_taken_only_on_purpose(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    interface = Glidecal(CheckScreen(quick_plan(tmp_path)))
    async with interface.run_test(size=SIZE) as pilot:
        screen = await to_measuring(pilot, interface)
        monkeypatch.setattr(screen.attended, "ready_by_hand", lambda: False)
        await pilot.press("space")
        await pilot.pause(0.1)
        assert "Press Space again" in text(interface, "#said")
        assert screen.guided.session.all_readings == ()
        await pilot.press("space")
        await until(pilot, "taken", lambda: screen.guided.session.done() == {1})
        await pilot.press("f10")


async def test_words_name_the_keys_that_are_in_force(tmp_path: Path) -> None:
    """Step, messages, help and footer after a change of keys; nothing lies over the panels."""
    keys = {"measure.take": "t,space", "measure.hold": "h", "measure.earlier": "ctrl+b"}
    interface = Glidecal(CheckScreen(quick_plan(tmp_path)), settings=Settings(keys=keys))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        screen = await to_measuring(pilot, interface)
        assert "When stable, press T." in text(interface, "#step")
        await pilot.press("h")
        await pilot.pause()
        assert "On hold. Press H to continue." in text(interface, "#said")
        await pilot.press("h")
        await pilot.pause()
        key_of = {
            binding.binding.description: key for key, binding in screen.active_bindings.items()
        }
        assert key_of["Hold"] == "h"
        await pilot.press("f1")
        await until(pilot, "help", lambda: isinstance(interface.screen, HelpDialog))
        await pilot.pause()
        words = text(interface, "HelpDialog Static")
        for line in (
            "T, Enter     take: read",
            "Ctrl+B       an earlier step",
            "H            hold",
        ):
            assert line in words
        await pilot.press("escape", "a")
        await until(pilot, "automatic", lambda: screen.attended.automatic)
        assert "press" not in text(interface, "#step")
        await pilot.press("a")
        interface.notify("nothing lies over the panels", timeout=10)
        assert text(interface, "#said") == "nothing lies over the panels"
        assert not interface._notifications
        await pilot.press("f10")


def test_the_help_has_every_key_of_the_measuring_screen() -> None:
    ids = {b.id for b in MeasureScreen.BINDINGS if isinstance(b, Binding)}
    assert ids == set(KEY_ID.findall(help_of("measure")))


async def test_automatic_on_a_real_machine_waits_for_a_movement(tmp_path: Path) -> None:
    from protocols.machine import Instrument

    position = [0.5]
    twin = IndicatorTwin(MITUTOYO_01A, Spindle(lambda: position[0], 0.001))
    with TwinPort(twin, "tcp") as port:
        instrument = Instrument(profile="mitutoyo-01a", port=port.url)
        plan = replace(quick_plan(tmp_path), instruments=(instrument,))
        interface = Glidecal(CheckScreen(plan))
        async with interface.run_test(size=SIZE) as pilot:
            screen = await to_measuring(pilot, interface)
            await pilot.press("a")
            await until(pilot, "why", lambda: "cannot show the move" in text(interface, "#said"))
            assert screen.guided.session.done() == frozenset()
            assert "press Space or the button at the indicator" in text(interface, "#said")
            assert "When stable, press Space." in text(interface, "#step")
            assert "It is read" not in text(interface, "#step")
            await take(pilot, screen)
            assert "It is read when stable." in text(interface, "#step")
            await until(pilot, "why", lambda: "no move to MAX" in text(interface, "#said"))
            position[0] = 0.9
            await until(pilot, "one step", lambda: screen.guided.session.done() == {1, 2})
            await until(pilot, "why", lambda: "no move to MIN" in text(interface, "#said"))
            await press_for(
                pilot, screen, "a question", lambda: isinstance(interface.screen, ChoiceDialog)
            )
            question = "did the machine move?"
            await until(pilot, "words", lambda: question in text(interface, "ChoiceDialog Static"))
            await pilot.press("1")
            await until(pilot, "back", lambda: interface.screen is screen)
            assert screen.guided.session.done() == {1, 2}
            assert not screen.attended.automatic
            await pilot.press("f10")


def test_verification_carries_the_new_home_offset(tmp_path: Path) -> None:
    """A second export must start from what the first one made the controller hold."""
    from app.evaluating.solution import solve_files
    from app.measuring.opening import start_session
    from app.measuring.plan import verification_plan
    from app.measuring.unattended import measure_all

    plan = replace(quick_plan(tmp_path), interval_s=QUICK_INTERVAL_S)
    machine = plan.machine.model_copy(update={"home_offset_mm": (10.0, 20.0, 30.0)})
    plan = replace(plan, machine=machine)
    with start_session(plan) as guided:
        measure_all(guided)
    before = solve_files([plan.path])
    offset = verification_plan(plan, before).machine.home_offset_mm
    assert offset is not None
    expected = [old + new for old, new in zip((10, 20, 30), before.joint_offsets_mm, strict=True)]
    assert offset == pytest.approx(expected)


async def test_the_data_button_takes_the_step(tmp_path: Path) -> None:
    """A value that the device sends unasked is a foot switch, not a reading."""
    interface = Glidecal(CheckScreen(quick_plan(tmp_path)))
    async with interface.run_test(size=SIZE) as pilot:
        screen = await to_measuring(pilot, interface)
        for _ in range(PRESSES):  # as an operator does where a press came too soon
            await until(pilot, "stillness", screen.attended.ready_by_hand)
            screen.guided.gauges[0].press(Fault(FaultKind.NO_ANSWER, "", "any outcome"))
            await pilot.pause(0.3)
            await until(pilot, "an answer", lambda: not screen.busy)
            if screen.guided.session.done():
                break
        await pilot.pause(0.3)
        assert screen.guided.session.done() == {1}
        await pilot.press("f10")


async def test_a_reading_from_another_world_is_a_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    interface = Glidecal(CheckScreen(quick_plan(tmp_path)))
    async with interface.run_test(size=SIZE) as pilot:
        screen = await to_measuring(pilot, interface)
        far = IndicatorReading("+99999.999", 99999.999, 0.001, unit_assumed=True)
        with monkeypatch.context() as patched:
            patched.setattr(Gauge, "ask", lambda _: answered(far))
            await press_for(
                pilot, screen, "refusal", lambda: "further than any" in text(interface, "#said")
            )
        assert screen.guided.session.all_readings == ()
        await pilot.press("f10")
