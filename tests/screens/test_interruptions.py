"""Faults, full disks, pulled cables and sessions that go on after a break."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from textual.pilot import Pilot
from textual.widgets import Input, OptionList

from app.measuring.indicators import remember
from app.measuring.plan import QUICK_INTERVAL_S, Plan, plan_to_continue
from app.screens.check import CheckScreen
from app.screens.home import HomeScreen
from app.screens.interface import ChoiceDialog, Glidecal, TextDialog
from drivers.profile import Spindle
from drivers.profiles.mitutoyo_01a import MITUTOYO_01A
from drivers.twins import IndicatorTwin, TwinPort, default_transport
from protocols.machine import Instrument
from protocols.record import read_record
from protocols.session import fold
from tests.conftest import LONG
from tests.screens.driving import (
    SIZE,
    answered,
    press_for,
    quick_plan,
    take,
    text,
    to_measuring,
    until,
)


async def test_continue_at_the_first_unfinished_step(tmp_path: Path) -> None:
    plan = quick_plan(tmp_path)
    first = Glidecal(CheckScreen(plan))
    async with first.run_test(size=SIZE) as pilot:
        screen = await to_measuring(pilot, first)
        await take(pilot, screen)
        await pilot.press("f10")
    second = Glidecal(CheckScreen(plan_to_continue(plan.path)))
    async with second.run_test(size=SIZE) as pilot:
        await until(pilot, "words", lambda: "Enter continues" in text(second, "#words"))
        screen = await to_measuring(pilot, second)
        assert "LEG X   MAX" in text(second, "#step")
        assert "1 of 30 steps done" in text(second, "#progress")
        await take(pilot, screen)
        assert screen.guided.session.mountings[-1].mounts == {"y": "xy#2", "z": "xz#2"}
        await pilot.press("f10")


async def test_a_port_that_is_not_there_is_said_in_words(tmp_path: Path) -> None:
    missing = Instrument(profile="mitutoyo-01a", port="/dev/tty[none]")
    plan = replace(quick_plan(tmp_path), instruments=(missing,))
    interface = Glidecal(CheckScreen(plan))
    async with interface.run_test(size=SIZE) as pilot:
        await until(pilot, "words", lambda: "no such port" in text(interface, "#words"))
        assert "/dev/tty[none]" in text(interface, "#words")
        await pilot.press("escape")
    assert interface.return_code == 4
    assert "no such port" in str(interface.return_value)


@pytest.mark.skipif(os.name != "posix", reason="a device path that appears needs POSIX")
async def test_a_cable_plugged_in_later_is_found_by_another_try(tmp_path: Path) -> None:
    plugged = tmp_path / "tty"
    late = Instrument(profile="mitutoyo-01a", port=str(plugged))
    plan = replace(quick_plan(tmp_path), instruments=(late,))
    interface = Glidecal(CheckScreen(plan))
    with TwinPort(still_twin(), "pty") as port:
        async with interface.run_test(size=SIZE) as pilot:
            await until(pilot, "words", lambda: "R tries again" in text(interface, "#words"))
            await pilot.press("enter")
            assert isinstance(interface.screen, CheckScreen), "nothing to begin with"
            plugged.symlink_to(port.url)
            await pilot.press("r")
            screen = await to_measuring(pilot, interface)
            await take(pilot, screen)
            assert screen.guided.session.done() == {1}
            await pilot.press("f10")
    assert interface.return_code == 0


def still_twin() -> IndicatorTwin:
    """An indicator whose spindle rests."""
    return IndicatorTwin(MITUTOYO_01A, Spindle(lambda: 0.5, 0.001))


def plan_at(port: str, folder: Path) -> Plan:
    """A quick plan with one indicator at a port."""
    indicator = Instrument(profile="mitutoyo-01a", port=port)
    return replace(quick_plan(folder), instruments=(indicator,))


async def test_an_indicator_goes_on_at_another_port(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its cable is pulled, and its adapter comes back under another name, known by its number."""
    with TwinPort(still_twin(), "tcp") as first, TwinPort(still_twin(), "tcp") as second:
        where = {first.url: "A1"}
        monkeypatch.setattr("app.measuring.gauges.adapter_at", lambda port: where.get(port, ""))
        monkeypatch.setattr("app.measuring.indicators.adapters", lambda: where)
        monkeypatch.setattr(
            "app.measuring.indicators.serial_ports", lambda: [(port, "USB") for port in where]
        )
        plan = plan_at(first.url, tmp_path)
        interface = Glidecal(CheckScreen(plan))
        async with interface.run_test(size=SIZE) as pilot:
            screen = await to_measuring(pilot, interface)
            await take(pilot, screen)
            await pilot.press("o")
            await until(pilot, "no need", lambda: "Every indicator" in text(interface, "#said"))
            where.clear()
            first.close()
            lost = "O chooses it."
            await until(pilot, "a fault", lambda: lost in text(interface, "#said"))
            await pilot.press("space")
            await pilot.pause(0.2)
            assert "stable" not in text(interface, "#said")
            where[second.url] = "A1"
            back = f"Its adapter is at {second.url} now: O goes on there."
            await until(pilot, "its port", lambda: back in text(interface, "#said"))
            await pilot.press("o")
            await until(pilot, "a list", lambda: isinstance(interface.screen, ChoiceDialog))
            assert "the same adapter, no. A1" in str(
                interface.screen.query_one(OptionList).get_option_at_index(0).prompt
            )
            await type_port(pilot, interface, "2", "/dev/tty[none]")
            wrong = "FAULT: port /dev/tty[none]: no such port."
            await until(pilot, "why not", lambda: wrong in text(interface, "#said"))
            await pilot.press("o")
            await until(pilot, "a list", lambda: isinstance(interface.screen, ChoiceDialog))
            await type_port(pilot, interface, "2", second.url)
            await until(pilot, "its name", lambda: "FAULT" not in text(interface, "#said"))
            assert not screen.attended.on_hold
            assert second.url in str(screen.query_one("#gauge0").border_subtitle)
            await pilot.press("f10")
    notes = [e.text for e in read_record(plan.path).events if e.event == "noted"]
    assert any(note.endswith(f"goes on at {second.url}, adapter A1") for note in notes)


async def type_port(pilot: Pilot[str], interface: Glidecal, row: str, port: str) -> None:
    """Choose the row of a list after which a port is typed, and type it."""
    await pilot.press(row)
    await until(pilot, "a line", lambda: isinstance(interface.screen, TextDialog))
    await pilot.pause()
    interface.screen.query_one(Input).value = port
    await pilot.press("enter")


async def test_another_adapter_under_the_old_name_puts_the_session_on_hold(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two cables that were pulled may come back with their names exchanged."""
    numbers = ["A1"]
    monkeypatch.setattr("app.measuring.gauges.adapter_at", lambda _: numbers[-1])
    first = TwinPort(still_twin(), "tcp")
    interface = Glidecal(CheckScreen(plan_at(first.url, tmp_path)))
    async with interface.run_test(size=SIZE) as pilot:
        screen = await to_measuring(pilot, interface)
        await take(pilot, screen)
        first.close()
        await until(pilot, "a fault", lambda: "FAULT" in text(interface, "#said"))
        numbers.append("B2")
        with TwinPort(still_twin(), "tcp", tcp_port=int(first.url.rpartition(":")[2])):
            await until(pilot, "the hold", lambda: screen.attended.on_hold)
            await until(pilot, "why", lambda: "adapter B2 is there now" in text(interface, "#said"))
            await pilot.press("f10")


@pytest.mark.skipif(os.name != "posix", reason="a device path that appears needs POSIX")
async def test_at_continue_a_port_that_has_gone_is_chosen_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gone, here = str(tmp_path / "ttyOLD"), str(tmp_path / "ttyNEW")
    where = {gone: "A1"}
    monkeypatch.setattr("app.measuring.indicators.adapters", lambda: where)
    monkeypatch.setattr(
        "app.measuring.indicators.serial_ports", lambda: [(port, "USB") for port in where]
    )
    instrument = Instrument(profile="mitutoyo-01a", port=gone)
    plan = replace(quick_plan(tmp_path), instruments=(instrument,))
    remember(plan.machine.name, [instrument])
    where.clear()
    where[here] = "A1"
    with TwinPort(still_twin(), "pty") as port:
        Path(here).symlink_to(port.url)
        interface = Glidecal(CheckScreen(plan))
        async with interface.run_test(size=SIZE) as pilot:
            await until(pilot, "words", lambda: "no such port" in text(interface, "#words"))
            words = " ".join(text(interface, "#words").split())
            assert f"its adapter is at {here} now." in words
            assert "O chooses another port, R tries again, Escape goes back." in words
            await pilot.press("o")
            await until(pilot, "a list", lambda: isinstance(interface.screen, ChoiceDialog))
            await type_port(pilot, interface, "2", "socket://127.0.0.1:1")
            refused = "no device answers at this address"
            await until(pilot, "why not", lambda: refused in text(interface, "#words"))
            await pilot.press("o")
            await until(pilot, "a list", lambda: isinstance(interface.screen, ChoiceDialog))
            await pilot.press("1")
            screen = await to_measuring(pilot, interface)
            await take(pilot, screen)
            assert screen.guided.session.done() == {1}
            await pilot.press("f10")


async def test_indicator_fault_is_not_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from app.measuring.gauges import Gauge
    from drivers.profile import Fault, FaultKind

    interface = Glidecal(CheckScreen(quick_plan(tmp_path)))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        screen = await to_measuring(pilot, interface)
        silence = Fault(FaultKind.NO_ANSWER, "", "no answer [1]: is it on?")
        with monkeypatch.context() as patched:
            patched.setattr(Gauge, "ask", lambda _: answered(silence))
            await press_for(
                pilot, screen, "refusal", lambda: "no answer [1]" in text(interface, "#said")
            )
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

    interface = Glidecal(CheckScreen(quick_plan(tmp_path)))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        screen = await to_measuring(pilot, interface)
        await take(pilot, screen)

        def refuse(_: int) -> None:
            raise OSError(errno.ENOSPC, "No space left on device")

        with monkeypatch.context() as patched:
            patched.setattr(os, "fsync", refuse)
            await press_for(
                pilot, screen, "words", lambda: "No space left" in text(interface, "#said")
            )
        assert screen.guided.session.done() == {1}
        await take(pilot, screen)
        assert screen.guided.session.done() == {1, 2}
        await pilot.press("f10")


@pytest.mark.skipif(os.name != "posix", reason="an open file cannot be replaced there")
async def test_a_record_that_is_replaced_ends_measuring_and_its_copy_is_named(
    tmp_path: Path,
) -> None:
    interface = Glidecal(CheckScreen(quick_plan(tmp_path)))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        screen = await to_measuring(pilot, interface)
        await take(pilot, screen)
        path = screen.guided.path
        path.unlink()
        path.write_text("something else")
        await press_for(
            pilot, screen, "words", lambda: "removed or replaced" in text(interface, "#said")
        )
        await pilot.press("f10")
    copy_path = path.with_stem(f"{path.stem}-kept")
    assert f"Every reading taken is in {copy_path}" in str(interface.return_value)
    assert interface.return_code == 3
    assert len(fold(read_record(copy_path).events).readings) == 2


async def test_home_offers_an_interrupted_session_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    plan = quick_plan(tmp_path)
    first = Glidecal(CheckScreen(plan))
    async with first.run_test(size=SIZE) as pilot:
        await take(pilot, await to_measuring(pilot, first))
        await pilot.press("f10")
    interface = Glidecal(HomeScreen())
    async with interface.run_test(size=SIZE) as pilot:
        options = interface.screen.query_one(OptionList)
        assert "Continue" in str(options.get_option_at_index(0).prompt)
        assert "interrupted at step 2 of 30" in str(options.get_option_at_index(0).prompt)
        await pilot.press("enter")
        await to_measuring(pilot, interface)
        await pilot.press("f10")


async def test_pulled_cable_in_the_middle_of_a_session(tmp_path: Path) -> None:
    """One line tells that the indicator is gone, another that it is back; nothing is lost."""
    gauge = tmp_path / "ttyUSB0"
    first = TwinPort(still_twin(), default_transport())
    point_to(gauge, first.url)
    instrument = Instrument(profile="mitutoyo-01a", port=str(gauge))
    plan = replace(quick_plan(tmp_path), instruments=(instrument,))
    interface = Glidecal(CheckScreen(plan))
    async with interface.run_test(size=SIZE) as pilot:
        screen = await to_measuring(pilot, interface)
        await take(pilot, screen)
        gauge.unlink()
        first.close()
        await until(pilot, "told", lambda: "check the cable" in text(interface, "#said"))
        assert "The session waits" in text(interface, "#said")
        with TwinPort(
            IndicatorTwin(MITUTOYO_01A, Spindle(lambda: 0.7, 0.001)), default_transport()
        ) as second:
            point_to(gauge, second.url)
            back = f"Indicator 1 (mitutoyo-01a, {gauge}) answers again."
            await until(pilot, "back", lambda: back in text(interface, "#said"))
            await take(pilot, screen)
            await pilot.press("f10")
            await until(pilot, "left", lambda: interface.guided is None)
    counted = fold(read_record(plan.path).events).readings
    assert [r.value_mm for r in counted] == [0.5, 0.7]


async def test_the_fault_that_lasts_stays_on_the_line_while_another_ends(tmp_path: Path) -> None:
    names = [tmp_path / "first", tmp_path / "second"]
    ports = [TwinPort(still_twin(), default_transport()) for _ in names]
    for name, port in zip(names, ports, strict=True):
        point_to(name, port.url)
    instruments = tuple(Instrument(profile="mitutoyo-01a", port=str(name)) for name in names)
    plan = replace(quick_plan(tmp_path), instruments=instruments)
    interface = Glidecal(CheckScreen(plan))
    async with interface.run_test(size=SIZE) as pilot:
        screen = await to_measuring(pilot, interface)
        await take(pilot, screen)
        for name, port in zip(names, ports, strict=True):
            name.unlink()
            port.close()

        def lines() -> list[str]:
            return text(interface, "#said").splitlines()

        def faults() -> list[str]:
            return [line for line in lines() if line.startswith("FAULT: ") and "O chooses" in line]

        await until(pilot, "both told", lambda: len(faults()) == 2)
        with TwinPort(
            IndicatorTwin(MITUTOYO_01A, Spindle(lambda: 0.7, 0.001)), default_transport()
        ) as again:
            point_to(names[1], again.url)
            await until(pilot, "back", lambda: "answers again." in lines()[0])
            assert [("first" in fault) for fault in faults()] == [True], lines()
            assert "Continue with this step" not in text(interface, "#said")
            await pilot.press("space")
            await until(pilot, "an answer", lambda: "answers again" not in lines()[0])
            assert "Space again" not in text(interface, "#said")
            assert [("first" in fault) for fault in faults()] == [True], lines()
            await pilot.press("f10")
            await until(pilot, "left", lambda: interface.guided is None)


def point_to(name: Path, port: str) -> None:
    if not port.startswith("/"):
        pytest.skip("needs pseudo-terminals and links")
    name.symlink_to(port)


@pytest.mark.skipif(sys.platform == "win32", reason="loops take no signals there")
async def test_a_signal_ends_what_is_computed_when_the_screens_are_gone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    loop = asyncio.get_running_loop()
    async with Glidecal(HomeScreen()).run_test(size=SIZE) as pilot:
        await pilot.press("f10")
    assert not loop.remove_signal_handler(signal.SIGTERM)
    assert not loop.remove_signal_handler(signal.SIGHUP)


@LONG
async def test_a_continued_verification_still_compares(tmp_path: Path) -> None:
    from app.evaluating.solution import solve_files
    from app.measuring.opening import start_session
    from app.measuring.plan import verification_plan
    from app.measuring.unattended import measure_all

    plan = replace(quick_plan(tmp_path), interval_s=QUICK_INTERVAL_S)
    with start_session(plan) as guided:
        measure_all(guided)
    verify = verification_plan(plan, solve_files([plan.path]))
    interface = Glidecal(CheckScreen(verify))
    async with interface.run_test(size=SIZE) as pilot:
        await take(pilot, await to_measuring(pilot, interface))
        await pilot.press("f10")
    again = plan_to_continue(verify.path)
    assert again.before is not None
    with start_session(replace(again, interval_s=QUICK_INTERVAL_S)) as guided:
        measure_all(guided)
    after = solve_files([verify.path]).solution
    assert after.rms_before_mm < 0.1 * again.before.solution.rms_before_mm
