"""The check of the indicators: whose spindle moved, ports exchanged, what the record says."""

from __future__ import annotations

import asyncio
import threading
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import pytest

from app.measuring.demo import demo_plan
from app.measuring.plan import Plan
from app.measuring.session import Indicators
from app.screens.check import CheckScreen
from app.screens.interface import Glidecal
from app.screens.measure import MeasureScreen
from app.screens.session_view import GaugeDisplay
from drivers.profile import Spindle
from drivers.profiles.mitutoyo_01a import MITUTOYO_01A
from drivers.twins import IndicatorTwin, TwinPort
from protocols.machine import Instrument
from protocols.record import read_record
from protocols.session import fold
from tests.screens.driving import SIZE, numbers, text, until


def plan_of(folder: Path, places_mm: list[float], undo: ExitStack) -> Plan:
    """Two indicators on ports of their own, whose spindles stand at these places."""
    ports = []
    for k in range(2):
        spindle = Spindle(lambda k=k: places_mm[k], 0.001)  # type: ignore[misc]
        ports.append(undo.enter_context(TwinPort(IndicatorTwin(MITUTOYO_01A, spindle), "tcp")).url)
    instruments = (
        Instrument(profile="mitutoyo-01a", port=ports[0], axes="yxz"),
        Instrument(profile="mitutoyo-01a", port=ports[1], axes="zyx"),
    )
    plan = demo_plan(folder, "zero-max-min", 1)
    return replace(plan, instruments=instruments, window_s=0.3)


async def test_a_swap_is_found_before_the_first_reading(tmp_path: Path) -> None:
    places_mm = [0.0, 0.0]
    with ExitStack() as undo:
        plan = plan_of(tmp_path, places_mm, undo)
        first, second = (instrument.port for instrument in plan.instruments)
        interface = Glidecal(CheckScreen(plan))
        async with interface.run_test(size=SIZE) as pilot:

            async def push(number: int, words: str) -> None:
                still = ["+0.000", "+0.000"]
                await until(pilot, "rest", lambda: numbers(interface.screen) == still)
                await pilot.pause(0.5)
                places_mm[number] = -1.5
                await until(pilot, "a push", lambda: "-1.500" in numbers(interface.screen))
                places_mm[number] = 0.0
                await until(pilot, words, lambda: words in text(interface, "#trial"))

            await until(pilot, "trial", lambda: "along Y of leg X" in text(interface, "#trial"))
            assert f"indicator 1 (mitutoyo-01a, {first})" in text(interface, "#trial")
            await pilot.press("x")
            assert "moved" not in text(interface, "#trial"), "nothing to exchange yet"
            await push(1, f"Indicator 2 (mitutoyo-01a, {second}) moved")
            await pilot.press("x")
            words = f"along Z of leg X and let it go: indicator 2 (mitutoyo-01a, {first})"
            await until(pilot, "the exchange", lambda: words in text(interface, "#trial"))
            display = interface.screen.query(GaugeDisplay).first()
            assert display.border_subtitle is not None
            assert second in display.border_subtitle
            await push(0, "Each spindle was found at its place")
            await pilot.press("enter")
            await until(pilot, "measuring", lambda: isinstance(interface.screen, MeasureScreen))
            display = interface.screen.query(GaugeDisplay).first()
            assert second in str(display.border_subtitle), "as exchanged"
            places_mm[1] = 7.0
            await until(pilot, "order", lambda: numbers(interface.screen)[0] == "+7.000")
            await pilot.press("f10")
    session = fold(read_record(plan.path).events)
    assert [(i.port, i.axes, i.pushed_in) for i in session.opened.instruments] == [
        (second, "yxz", "smaller"),
        (first, "zyx", "smaller"),
    ]
    assert session.notes[0].startswith("before the first reading: ports exchanged; indicator 1")


async def test_begun_without_the_record_says_so(tmp_path: Path) -> None:
    with ExitStack() as undo:
        plan = plan_of(tmp_path, [0.0, 0.0], undo)
        interface = Glidecal(CheckScreen(plan))
        async with interface.run_test(size=SIZE) as pilot:
            await until(pilot, "open", lambda: "Enter begins without" in text(interface, "#trial"))
            await pilot.press("enter")
            await until(pilot, "measuring", lambda: isinstance(interface.screen, MeasureScreen))
            await pilot.press("f10")
    session = fold(read_record(plan.path).events)
    assert session.notes[0].count("not pushed by hand") == 2
    assert [instrument.pushed_in for instrument in session.opened.instruments] == [None, None]


async def test_ports_that_open_after_the_program_was_left_are_closed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    exit_event, closed = threading.Event(), threading.Event()

    def slowly(_: Plan) -> Indicators:
        assert exit_event.wait(20.0)
        return Indicators((), close_bench=closed.set)

    monkeypatch.setattr("app.measuring.opening.open_indicators", slowly)
    interface = Glidecal(CheckScreen(demo_plan(tmp_path, "zero-max-min", 1)))
    async with interface.run_test(size=SIZE) as pilot:
        await pilot.press("f10")
    exit_event.set()
    assert await asyncio.to_thread(closed.wait, 20.0)
