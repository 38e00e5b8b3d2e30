"""Driving the screens by keys, and waiting for what must happen."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from textual.pilot import Pilot
from textual.widgets import Static

from app.bench import BenchSettings
from app.demo import demo_plan
from app.opening import Plan
from app.screens.interface import Interface
from app.screens.leg_review import LegReviewScreen
from app.screens.measure import MeasureScreen

SIZE = (80, 24)


PATIENCE = 1500


def quick_plan(folder: Path) -> Plan:
    return replace(
        demo_plan(folder, "zero-max-min", 1, BenchSettings()), interval_s=0.01, window_s=0.15
    )


def text(interface: Interface, selector: str) -> str:
    """The words of a widget, none while the screen is still being composed."""
    found = interface.screen.query(selector).results(Static)
    return "".join(str(one.content) for one in found)


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
    await until(pilot, "stillness", screen.ready_by_hand)
    await pilot.press("space")
    await until(
        pilot,
        "a reading taken",
        lambda: len(screen.guided.session.all_readings) > before and not screen.busy,
    )
    if isinstance(screen.app.screen, LegReviewScreen):
        await pilot.press("space")
