"""Make the pictures of the documentation from the running program: python docs/make_pictures.py."""

from __future__ import annotations

import asyncio
import re
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from textual.pilot import Pilot

from app.bench import BenchSettings
from app.demo import demo_plan
from app.screens.check import CheckScreen
from app.screens.interface import Interface
from app.screens.measure import MeasureScreen
from app.screens.result import ResultScreen

PICTURES = Path(__file__).parent / "pictures"
SIZE = (80, 24)
PATIENCE_S = 20.0
STEPS_BEFORE_PICTURE = 8


def save(interface: Interface, name: str) -> None:
    """The screen as SVG, without the addresses of web fonts."""
    svg = interface.export_screenshot(title="glidecal")
    svg = re.sub(r"@font-face \{.*?\}", "", svg, flags=re.DOTALL)
    (PICTURES / f"{name}.svg").write_text(svg, encoding="utf-8", newline="\n")


async def until(pilot: Pilot[str], condition: Callable[[], bool]) -> None:
    """Wait for the program, not for ever."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        if time.monotonic() > deadline:
            raise TimeoutError(condition)
        await pilot.pause(0.02)


def is_done(screen: MeasureScreen, number: int) -> bool:
    """Whether a step has been taken."""
    return number in screen.guided.session.done()


async def pictures(folder: Path) -> None:
    """Drive a demonstration and photograph it."""
    plan = demo_plan(folder, "zero-max-min", 1, BenchSettings())
    interface = Interface(CheckScreen(replace(plan, interval_s=0.01)))
    async with interface.run_test(size=SIZE) as pilot:
        await until(pilot, lambda: interface.indicators is not None)
        await pilot.press("enter")
        await until(pilot, lambda: isinstance(interface.screen, MeasureScreen))
        screen = interface.screen
        assert isinstance(screen, MeasureScreen)
        for number in range(1, len(screen.guided.steps) + 1):
            await until(pilot, screen.ready_by_hand)
            await pilot.press("space")
            await until(pilot, partial(is_done, screen, number))
            await until(pilot, lambda: not screen.busy)
            if number == STEPS_BEFORE_PICTURE:
                await pilot.pause(1.0)
                save(interface, "measure")
        await until(pilot, lambda: isinstance(interface.screen, ResultScreen))
        await pilot.pause(0.3)
        save(interface, "result")
        await pilot.press("f10")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        asyncio.run(pictures(Path(temporary)))
