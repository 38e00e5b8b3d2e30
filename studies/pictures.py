"""Make the pictures of the documentation from the running program: python -m studies.pictures."""

from __future__ import annotations

import asyncio
import contextlib
import re
import tempfile
from collections.abc import AsyncIterator
from concurrent.futures import Future
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

from textual.pilot import Pilot
from textual.widgets import Static

from app.evaluating.solution import solve_files
from app.machines.tripod import simulate
from app.measuring.attended import HELD_KEY_S
from app.measuring.demo import demo_plan
from app.measuring.gauges import Gauge
from app.planning.hexaslide import Request
from app.report.text.result import WORKING_OUT
from app.screens.check import CheckScreen
from app.screens.diagnose import DiagnoseScreen
from app.screens.hexaslide import HexaSlideScreen
from app.screens.interface import ChoiceDialog, Glidecal
from app.screens.measure import MeasureScreen
from app.screens.result import ResultScreen
from app.screens.session_view import GaugeDisplay, LegReviewScreen
from app.screens.what_if import WhatIfScreen
from app.version import program
from drivers.profile import IndicatorReading, Outcome
from protocols.journal import write_whole
from protocols.printers.imported import imported_printer
from tests.screens.driving import answered, press_for, to_measuring, until

PICTURES = Path(__file__).parents[1] / "docs" / "pictures"
PRINTER = Path(__file__).parents[1] / "sample_sessions" / "printer"
NARROW, WIDE = (80, 24), (120, 40)
MIDDLE_OF_LEG = 8
QUESTIONED = 4
"""The first step whose posture was measured before."""

OFF_MM = 0.2
"""So much a reading is wrong on purpose, to be questioned."""


async def save(pilot: Pilot[str], name: str) -> None:
    """The screen as SVG, without the addresses of web fonts."""
    await pilot.pause(0.3)
    await pilot.wait_for_scheduled_animations()
    svg = pilot.app.export_screenshot(title="glidecal")
    svg = re.sub(r"@font-face \{.*?\}", "", svg, flags=re.DOTALL)
    (PICTURES / f"{name}.svg").write_text(svg, encoding="utf-8", newline="\n")


def still(screen: MeasureScreen) -> bool:
    """Whether every panel says that its indicator stands still."""
    return all(panel.has_class("stable") for panel in screen.query(GaugeDisplay))


def has_done(screen: MeasureScreen, number: int) -> bool:
    """Whether a step has been taken."""
    return number in screen.guided.session.done() and not screen.busy


async def take_wrong(pilot: Pilot[str], screen: MeasureScreen) -> None:
    """A reading that does not agree with its repeats, questioned; then it is taken again."""
    ask = Gauge.ask

    def wrong(gauge: Gauge) -> Future[Outcome]:
        outcome = ask(gauge).result()
        if isinstance(outcome, IndicatorReading):
            outcome = replace(outcome, value_mm=outcome.value_mm + OFF_MM)
        return answered(outcome)

    def questioned() -> bool:
        return isinstance(screen.app.screen, ChoiceDialog)

    with patch.object(Gauge, "ask", wrong):
        await press_for(pilot, screen, "the question", questioned)
    await save(pilot, "question")
    await pilot.press("1")
    await until(pilot, "measuring", lambda: screen.is_current)
    await pilot.pause(HELD_KEY_S)  # a key held down counts once


async def measure(pilot: Pilot[str], interface: Glidecal, *, photographed: bool) -> None:
    """Every step of a session; on the way the pictures."""
    screen = await to_measuring(pilot, interface)
    reviewed = False
    for step in screen.guided.steps:
        if photographed and step.number == QUESTIONED:
            await take_wrong(pilot, screen)
        await press_for(pilot, screen, "the step", partial(has_done, screen, step.number))
        if photographed and step.number == MIDDLE_OF_LEG:
            await photograph_measuring(pilot, screen)
        if isinstance(interface.screen, LegReviewScreen):
            if photographed and not reviewed:
                await photograph(pilot, "review_wide", WIDE)
                reviewed = True
            await pilot.press("space")
    await until(pilot, "the result", lambda: isinstance(interface.screen, ResultScreen))
    result = interface.screen
    assert isinstance(result, ResultScreen)
    await until(pilot, "the values", lambda: not working(result))


async def photograph_measuring(pilot: Pilot[str], screen: MeasureScreen) -> None:
    """The middle of a leg: in a narrow terminal and in a wide one with the plot."""
    await until(pilot, "stillness", partial(still, screen))
    await save(pilot, "measure")
    await photograph(pilot, "measure_wide", WIDE)


async def photograph(pilot: Pilot[str], name: str, size: tuple[int, int]) -> None:
    """The present screen in a terminal of another size, and back."""
    await pilot.resize_terminal(*size)
    await save(pilot, name)
    await pilot.resize_terminal(*NARROW)


async def pictures(folder: Path) -> None:
    """Drive a demonstration from the check to the comparison, and photograph it."""
    plan = demo_plan(folder, "zero-max-min", 1)
    plan = replace(plan, path=folder / "demonstration.jsonl", interval_s=0.01, window_s=0.15)
    interface = Glidecal(CheckScreen(plan))
    interface.animation_level = "none"
    async with interface.run_test(size=NARROW) as pilot:
        await measure(pilot, interface, photographed=True)
        await save(pilot, "result")
        await pilot.press("v")
        await until(pilot, "the check", lambda: isinstance(interface.screen, CheckScreen))
        await measure(pilot, interface, photographed=False)
        await save(pilot, "comparison")
        await pilot.press("f10")


@contextlib.asynccontextmanager
async def diagnosed(session: Path, hidden: dict[str, Any]) -> AsyncIterator[Pilot[str]]:
    """The verdict on a simulated session with an effect hidden in it."""
    simulate(session, None, 1, **hidden)
    screen = DiagnoseScreen([session])
    interface = Glidecal(screen)
    interface.animation_level = "none"
    async with interface.run_test(size=NARROW) as pilot:
        await until(pilot, "a diagnosis", lambda: screen.diagnosed is not None)
        yield pilot
        await pilot.press("f10")


async def diagnosis(folder: Path) -> None:
    """Play in one carriage, and where it shows."""
    hidden = {"protocol": "two-station", "effect": "backlash:x", "size": 0.03}
    async with diagnosed(folder / "simulated.jsonl", hidden) as pilot:
        await save(pilot, "diagnosis")
        await pilot.resize_terminal(*WIDE)
        await pilot.press("2")
        await save(pilot, "diagnosis_where")


async def what_if(folder: Path) -> None:
    """A carriage that goes too far, its size moved beside the result."""
    hidden = {"protocol": "zero-max-min", "effect": "actuator_scale:y", "size": 1.1}
    async with diagnosed(folder / "scaled.jsonl", hidden) as pilot:
        await pilot.press("w")
        await until(pilot, "effects", lambda: isinstance(pilot.app.screen, ChoiceDialog))
        await pilot.press("1")
        await until(pilot, "what if", lambda: isinstance(pilot.app.screen, WhatIfScreen))
        screen = pilot.app.screen
        assert isinstance(screen, WhatIfScreen)
        await until(pilot, "the figures", lambda: screen.ready)
        await pilot.press(*["left"] * 3)
        await until(pilot, "the figures", lambda: screen.ready)
        await save(pilot, "what_if")


def working(screen: ResultScreen) -> bool:
    """Whether the first page is not there yet."""
    texts = (str(part.content) for part in screen.query(Static))
    return any(words.startswith(WORKING_OUT) for words in texts)


async def printer(folder: Path) -> None:
    """The result of a printer, from its configuration and a log of its probe."""
    session, files = folder / "printer.jsonl", ("printer.cfg", "probe.log")
    imported = imported_printer([PRINTER / name for name in files], program())
    write_whole(session, imported.opened, [*imported.contacts])
    screen = ResultScreen(solve_files([session]), None, session)
    interface = Glidecal(screen)
    interface.animation_level = "none"
    async with interface.run_test(size=NARROW) as pilot:
        await until(pilot, "the values", lambda: not working(screen))
        await save(pilot, "printer")
        await pilot.press("f10")


async def hexaslide() -> None:
    """What position alone sees of a Hexa Slide, and the machine drawn."""
    screen = HexaSlideScreen(Request("position"))
    interface = Glidecal(screen)
    interface.animation_level = "none"
    async with interface.run_test(size=NARROW) as pilot:
        await until(pilot, "the machine", lambda: screen.view is not None)
        await photograph(pilot, "hexaslide_wide", WIDE)
        await pilot.press("tab")
        await save(pilot, "hexaslide")
        await pilot.press("f10")


def main() -> None:
    """Make all of them."""
    quick_fingers = patch("app.measuring.attended.HELD_KEY_S", 0.0)
    with quick_fingers, tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary, "measurements")  # its name is on the pictures
        folder.mkdir()
        asyncio.run(pictures(folder))
        asyncio.run(diagnosis(folder))
        asyncio.run(what_if(folder))
        asyncio.run(hexaslide())
        asyncio.run(printer(folder))


if __name__ == "__main__":
    main()
