"""The guided session driven by keys alone: state and messages first."""

from __future__ import annotations

from pathlib import Path

import pytest
from textual.pilot import Pilot
from textual.widgets import Digits, Input, OptionList, Static

from app.bench import BenchSettings
from app.demo import demo_plan
from app.opening import Plan, plan_to_continue
from app.screens.check import CheckScreen
from app.screens.home import HomeScreen
from app.screens.interface import Interface
from app.screens.measure import MeasureScreen
from app.screens.prepare import PrepareScreen
from app.screens.result import ResultScreen
from drivers.profile import Spindle
from drivers.profiles.mitutoyo_01a import MITUTOYO_01A
from drivers.twin_port import TwinPort
from protocols.record import read_record
from protocols.session import fold

SIZE = (80, 24)


@pytest.fixture(autouse=True)
def _fast_fingers(monkeypatch: pytest.MonkeyPatch) -> None:
    """The pilot presses faster than a held key repeats."""
    monkeypatch.setattr("app.screens.measure.HELD_KEY_S", 0.0)


PATIENCE = 1500


def quick_plan(folder: Path) -> Plan:
    from dataclasses import replace

    return replace(
        demo_plan(folder, "zero-max-min", 1, BenchSettings()), interval_s=0.01, window_s=0.15
    )


def text(interface: Interface, selector: str) -> str:
    return str(interface.screen.query_one(selector, Static).content)


async def until(pilot: Pilot[str], what: str, condition: object) -> None:
    """Wait until the condition holds; says what did not happen."""
    assert callable(condition)
    for _ in range(PATIENCE):
        if condition():
            return
        await pilot.pause(0.02)
    pytest.fail(f"did not happen: {what}")


async def to_measuring(pilot: Pilot[str], interface: Interface) -> MeasureScreen:
    await until(pilot, "indicators open", lambda: interface.indicators is not None)
    await pilot.press("enter")
    await until(pilot, "measuring", lambda: isinstance(interface.screen, MeasureScreen))
    screen = interface.screen
    assert isinstance(screen, MeasureScreen)
    return screen


async def take(pilot: Pilot[str], screen: MeasureScreen) -> None:
    before = len(screen.guided.session.all_readings)
    await until(pilot, "stillness", screen._ready_by_hand)
    await pilot.press("space")
    await until(
        pilot,
        "a reading taken",
        lambda: len(screen.guided.session.all_readings) > before and not screen.busy,
    )


async def test_instrument_check_shows_live_values(tmp_path: Path) -> None:
    interface = Interface(CheckScreen(quick_plan(tmp_path)))
    async with interface.run_test(size=SIZE) as pilot:
        await until(pilot, "indicators open", lambda: interface.indicators is not None)
        await until(
            pilot,
            "digits",
            lambda: all(d.value == "+0.000" for d in interface.screen.query(Digits)),
        )
        assert "Enter begins the session" in text(interface, "#words")
        await pilot.press("f10")
    assert not list(tmp_path.glob("*.jsonl"))


async def test_take_repeat_note_remount_and_pause(tmp_path: Path) -> None:
    plan = quick_plan(tmp_path)
    interface = Interface(CheckScreen(plan))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        screen = await to_measuring(pilot, interface)
        assert "LEG X   ZERO   cycle 1 of 3" in text(interface, "#step")
        assert "indicators on leg X along Y and Z" in text(interface, "#step")
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
        await pilot.press("m")
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


async def test_whole_session_verify_and_compare(tmp_path: Path) -> None:
    plan = quick_plan(tmp_path)
    interface = Interface(CheckScreen(plan))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        screen = await to_measuring(pilot, interface)
        for _ in range(30):
            await take(pilot, screen)
        await until(pilot, "result", lambda: isinstance(interface.screen, ResultScreen))
        await until(pilot, "text", lambda: "Joint offsets known to" in text(interface, "#text"))
        await pilot.press("3")
        await until(pilot, "both", lambda: "d_L_z" in text(interface, "#text"))
        await pilot.press("e")
        folder = plan.path.with_suffix("")
        await until(pilot, "export", lambda: (folder / "calib_joint2.inc").exists())
        await pilot.press("v")
        await until(pilot, "check", lambda: isinstance(interface.screen, CheckScreen))
        screen = await to_measuring(pilot, interface)
        for _ in range(30):
            await take(pilot, screen)
        await until(pilot, "comparison", lambda: isinstance(interface.screen, ResultScreen))
        await until(
            pilot,
            "before and after",
            lambda: "Leg deviations went from" in text(interface, "#text"),
        )
        await pilot.press("f10")
    assert interface.return_code == 0
    sessions = sorted(tmp_path.glob("*.jsonl"))
    assert [read_record(p).end for p in sessions] == ["closed", "closed"]


async def test_automatic_takes_whatever_stands_still(tmp_path: Path) -> None:
    interface = Interface(CheckScreen(quick_plan(tmp_path)))
    async with interface.run_test(size=SIZE) as pilot:
        screen = await to_measuring(pilot, interface)
        await pilot.press("a")
        await until(pilot, "two steps", lambda: len(screen.guided.session.done()) >= 2)
        assert "automatic" in text(interface, "#progress")
        await pilot.press("f10")


async def test_continue_at_the_first_unfinished_step(tmp_path: Path) -> None:
    plan = quick_plan(tmp_path)
    first = Interface(CheckScreen(plan))
    async with first.run_test(size=SIZE) as pilot:
        screen = await to_measuring(pilot, first)
        await take(pilot, screen)
        await pilot.press("f10")
    second = Interface(CheckScreen(plan_to_continue(plan.path), continued=True))
    async with second.run_test(size=SIZE) as pilot:
        await until(pilot, "words", lambda: "Enter continues" in text(second, "#words"))
        screen = await to_measuring(pilot, second)
        assert "LEG X   MAX" in text(second, "#step")
        assert "1 of 30 steps done" in text(second, "#progress")
        await take(pilot, screen)
        assert screen.guided.session.mountings[-1].mounts == {"y": "xy#2", "z": "xz#2"}
        await pilot.press("f10")


async def test_a_port_that_is_not_there_is_said_in_words(tmp_path: Path) -> None:
    from dataclasses import replace

    from protocols.machine import Instrument

    missing = Instrument(profile="mitutoyo-01a", port="/dev/tty[none]")
    plan = replace(quick_plan(tmp_path), instruments=(missing,))
    interface = Interface(CheckScreen(plan))
    async with interface.run_test(size=SIZE) as pilot:
        await until(pilot, "words", lambda: "no such port" in text(interface, "#words"))
        assert "/dev/tty[none]" in text(interface, "#words")
        await pilot.press("escape")
    assert interface.return_code == 4
    assert "no such port" in str(interface.return_value)


async def test_indicator_fault_is_not_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from app.acquisition import Gauge
    from drivers.outcome import Fault, FaultKind

    interface = Interface(CheckScreen(quick_plan(tmp_path)))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        screen = await to_measuring(pilot, interface)
        silence = Fault(FaultKind.NO_ANSWER, "", "no answer [1]: is it on?")
        with monkeypatch.context() as patched:
            patched.setattr(Gauge, "ask", lambda _: silence)
            await pilot.press("space")
            await until(pilot, "refusal", lambda: "no answer [1]" in text(interface, "#said"))
        assert screen.guided.session.all_readings == ()
        await take(pilot, screen)
        assert screen.guided.session.done() == {1}
        await pilot.press("f10")
    events = read_record(screen.guided.path).events
    assert [e.axis for e in events if e.event == "faulted"] == ["y", "z"]


async def test_disk_full_is_said_and_the_session_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import errno
    import os

    interface = Interface(CheckScreen(quick_plan(tmp_path)))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        screen = await to_measuring(pilot, interface)
        await take(pilot, screen)

        def refuse(_: int) -> None:
            raise OSError(errno.ENOSPC, "No space left on device")

        with monkeypatch.context() as patched:
            patched.setattr(os, "fsync", refuse)
            await pilot.press("space")
            await until(pilot, "words", lambda: "No space left" in text(interface, "#said"))
        assert screen.guided.session.done() == {1}
        await take(pilot, screen)
        assert screen.guided.session.done() == {1, 2}
        await pilot.press("f10")


async def test_home_offers_an_interrupted_session_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    plan = quick_plan(tmp_path)
    first = Interface(CheckScreen(plan))
    async with first.run_test(size=SIZE) as pilot:
        await take(pilot, await to_measuring(pilot, first))
        await pilot.press("f10")
    interface = Interface(HomeScreen())
    async with interface.run_test(size=SIZE) as pilot:
        options = interface.screen.query_one(OptionList)
        assert "Continue" in str(options.get_option_at_index(0).prompt)
        assert "interrupted at step 2 of 30" in str(options.get_option_at_index(0).prompt)
        await pilot.press("enter")
        await to_measuring(pilot, interface)
        await pilot.press("f10")


async def test_prepare_form_with_keys(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    interface = Interface(HomeScreen())
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await pilot.press("enter")
        await until(pilot, "form", lambda: isinstance(interface.screen, PrepareScreen))
        assert "Without any, choose the demonstration" in text(interface, "#summary")
        with TwinPort(MITUTOYO_01A.make_twin(Spindle(lambda: 0.5, 0.001)), "tcp") as twin:
            await prepare(pilot, interface, twin.url)


async def prepare(pilot: Pilot[str], interface: Interface, port: str) -> None:
    interface.screen.query_one("#indicator1", Input).value = f"mitutoyo-01a:{port}"
    await pilot.pause()
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
    from app.solving import solve_files

    path = samples / "experiment_2_twelve.jsonl"
    solved, _ = solve_files([path])
    interface = Interface(ResultScreen(solved, None, path))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await until(pilot, "text", lambda: "something is missing" in text(interface, "#text"))
        await pilot.press("v")
        await pilot.pause()
        assert isinstance(interface.screen, ResultScreen)
        await pilot.press("f10")
