"""Driving the screens by keys, and waiting for what must happen."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import pytest
from textual.map_geometry import MapGeometry
from textual.pilot import Pilot
from textual.screen import Screen
from textual.strip import Strip
from textual.widget import Widget
from textual.widgets import Input, Select, Static

from app.measuring.attended import HELD_KEY_S
from app.measuring.demo import demo_plan
from app.measuring.doubts import Doubt, TakenStep
from app.measuring.plan import Plan
from app.screens.diagnose import DiagnoseScreen
from app.screens.hexaslide import HexaSlideScreen
from app.screens.hexaslide_result import HexaSlideResultScreen
from app.screens.history import HistoryScreen
from app.screens.interface import Glidecal
from app.screens.measure import MeasureScreen
from app.screens.prepare import IndicatorScreen
from app.screens.session_view import GaugeDisplay, LegReviewScreen
from drivers.profile import Outcome
from protocols.procedure import Step

SIZE = (80, 24)
PATIENCE_S = 240.0
"""Beside many other programs; then it is said what was on the screen in place of it."""

PRESSES = 5
QUESTIONED = TakenStep(Step(4, "x", 0.0, 2, 0.5, ("y", "z")), (), (), doubt=Doubt.BEYOND)
"""A step that is further off than expected."""

Looking = TypeVar("Looking", DiagnoseScreen, HexaSlideScreen, HexaSlideResultScreen)


def quick_plan(folder: Path) -> Plan:
    """Compressed time, but unhurried indicators: a pilot waits until the program is idle."""
    return replace(demo_plan(folder, "zero-max-min", 1), interval_s=0.03, window_s=0.15)


def text(interface: Glidecal, selector: str) -> str:
    """The words of a widget, none while the screen is still being composed."""
    widgets = interface.screen.query(selector).results(Static)
    return "".join(str(widget.content) for widget in widgets)


def said(interface: Glidecal) -> str:
    """What notifications say, and the line for it that a page has."""
    lines = [str(line.content) for line in interface.screen.query("#message").results(Static)]
    return "\n".join([*(note.message for note in interface._notifications), *filter(None, lines)])


def strips(screen: Screen[Any]) -> list[Strip]:
    """The rows of a screen as they are sent to the terminal; Textual has no public door to them."""
    return screen._compositor.render_strips(screen.size)


def placed(screen: Screen[Any]) -> dict[Widget, MapGeometry]:
    """Where each part of a screen is, and what of it the parts around it let through."""
    return screen._compositor.full_map


def rows(screen: Screen[Any]) -> list[str]:
    """The words of these rows, as a person sees them."""
    return [strip.text for strip in strips(screen)]


def numbers(screen: Screen[Any]) -> list[str]:
    """What the big digits of each indicator say."""
    return [display.number for display in screen.query(GaugeDisplay)]


async def until(pilot: Pilot[str], what: str, condition: object) -> None:
    """Wait until the condition holds, and screens have their parts; says what did not happen."""
    assert callable(condition)
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        if condition() and all(screen.is_mounted for screen in pilot.app.screen_stack):
            return
        await pilot.pause(0.02)
    lines = [*rows(pilot.app.screen), *(note.message for note in pilot.app._notifications)]
    pytest.fail("\n".join([f"did not happen: {what}. On the screen:", *lines]))


async def looked(pilot: Pilot[str], interface: Glidecal, kind: type[Looking]) -> Looking:
    """A screen of this kind once it has found what it looks for, or that there is nothing."""
    await until(pilot, "the screen", lambda: isinstance(interface.screen, kind))
    screen = interface.screen
    assert isinstance(screen, kind)
    await until(pilot, "the end of looking", lambda: screen.is_mounted and not screen.looking)
    await pilot.pause()
    return screen


async def history_shown(pilot: Pilot[str], interface: Glidecal) -> str:
    """The text of a history once its screen is there."""
    await until(pilot, "history", lambda: isinstance(interface.screen, HistoryScreen))
    await pilot.pause()
    return text(interface, "#history-text")


async def to_measuring(pilot: Pilot[str], interface: Glidecal) -> MeasureScreen:
    await until(pilot, "indicators open", lambda: interface.indicators is not None)
    await pilot.press("enter")

    def measuring() -> list[MeasureScreen]:  # a dialog may stand over it
        return [screen for screen in interface.screen_stack if isinstance(screen, MeasureScreen)]

    await until(pilot, "measuring", measuring)
    return measuring()[0]


async def press_for(
    pilot: Pilot[str], screen: MeasureScreen, what: str, condition: Callable[[], bool]
) -> None:
    """As an operator does: press once all stand still, and again where the press came too soon."""
    for _ in range(PRESSES):
        await until(pilot, "stillness", screen.attended.ready_by_hand)
        await pilot.press("space")
        await until(pilot, "an answer", lambda: condition() or not screen.busy)
        if condition():
            return
        await pilot.pause(HELD_KEY_S)  # a press sooner than this is a key held down
    pytest.fail(f"did not happen in {PRESSES} presses: {what}")


async def fill_in(pilot: Pilot[str], interface: Glidecal, which: str, **values: str) -> None:
    """Fill in the form of an indicator, by its fields, and come back to the form of the session."""
    form = interface.screen
    form.query_one(f"#{which}").focus()
    await pilot.press("enter")
    await until(pilot, "its form", lambda: isinstance(interface.screen, IndicatorScreen))
    await pilot.pause()
    for name, value in values.items():
        field = interface.screen.query_one(f"#{name}")
        assert isinstance(field, Input | Select)
        field.value = value
    await pilot.pause()
    await pilot.press("f5")
    await until(pilot, "the session's form", lambda: interface.screen is form)
    await pilot.pause()


async def take(pilot: Pilot[str], screen: MeasureScreen) -> None:
    before = len(screen.guided.session.all_readings)

    def taken() -> bool:
        return len(screen.guided.session.all_readings) > before and not screen.busy

    await press_for(pilot, screen, "a reading taken", taken)
    if isinstance(screen.app.screen, LegReviewScreen):
        await pilot.press("space")


def answered(outcome: Outcome) -> Future[Outcome]:
    """What a gauge that was asked gives at once."""
    future = Future[Outcome]()
    future.set_result(outcome)
    return future
