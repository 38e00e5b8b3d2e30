"""Every screen, page and help at the sizes of usual terminals: no word is cut, no row of a table
broken, no key beyond the edge. What stands below the last row must be reached by scrolling.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from rich.cells import cell_len
from textual.color import Color
from textual.filter import Monochrome
from textual.map_geometry import MapGeometry
from textual.pilot import Pilot
from textual.screen import Screen
from textual.widget import Widget
from textual.widgets import Footer, Input, Static, TabbedContent, TabPane
from textual.widgets._toast import Toast

from app.evaluating.comparison import compare_files
from app.evaluating.hexaslide import causes_to_try
from app.evaluating.history import read_history
from app.evaluating.loading import load_sessions
from app.evaluating.solution import solve_files
from app.evaluating.what_if import choices, trial_of
from app.machines.registry import LOOKS
from app.measuring.demo import WATCHED, demo_plan
from app.measuring.plan import Plan
from app.report.charts.characters import BLANK, NOTHING
from app.report.charts.charts import CUT
from app.report.charts.colours import contrast
from app.report.text.questions import question_choices
from app.screens.align import AlignScreen
from app.screens.check import CheckScreen, DryRunScreen
from app.screens.corrections import Corrections
from app.screens.diagnose import DiagnoseScreen
from app.screens.fast_keys import LeftOnce
from app.screens.hexaslide import HexaSlideScreen
from app.screens.hexaslide_result import HexaSlideResultScreen, PostureWhatIfScreen
from app.screens.history import CompareScreen, HistoryScreen
from app.screens.home import HomeScreen, ReplayChoiceScreen
from app.screens.interface import (
    ChoiceDialog,
    Dialog,
    Glidecal,
    HelpDialog,
    MainScreen,
    TextDialog,
)
from app.screens.measure import MeasureScreen
from app.screens.paged import PagedScreen
from app.screens.pages import Message
from app.screens.plot import ChartPlot
from app.screens.prepare import FormScreen, IndicatorScreen, PrepareScreen
from app.screens.replay import ReplayScreen
from app.screens.result import ResultScreen
from app.screens.session_view import (
    GaugeDisplay,
    LegReviewScreen,
    MotionDialog,
    SessionScreen,
    SetUpScreen,
)
from app.screens.what_if import SizesScreen, WhatIfScreen
from protocols.hexaslide_measured import measured_in
from protocols.machine import load_machine
from protocols.procedure import load_procedure
from protocols.record import read_record
from protocols.session import Session, fold
from tests.app.posture_sessions import posture_session
from tests.conftest import LONG, SAMPLES, first_quick
from tests.drivers.motion.twins import MotionTrouble
from tests.screens.driving import (
    QUESTIONED,
    placed,
    quick_plan,
    rows,
    said,
    strips,
    take,
    to_measuring,
    until,
)
from tests.screens.test_moving import measuring as moving

SIZES = [(80, 24), (100, 30), (120, 40)]
TITLE_EDGES = 6
"""On a border a title has a corner, a dash and a blank on both sides."""

LEAST_CONTRAST = 3.0
"""Of large and bold words (WCAG 2.1, 1.4.3); signal words have more, by test_legible."""

ROW = re.compile(r"\S {2,}\S.* {2,}\S")
"""A row of a table; prose has no such gaps and may be wrapped."""

ONE, TWO = (SAMPLES / f"experiment_{n}_twelve.jsonl" for n in (2, 3))
SWEEP = SAMPLES / "simulated_sweep.jsonl"


def simulated() -> Session:
    return fold(read_record(SAMPLES / "simulated_zero-max-min.jsonl").events)


def result(folder: Path) -> Screen[Any]:
    """With a comparison beside it, as after a verification."""
    plan = demo_plan(folder, "zero-max-min", 1)
    return ResultScreen(solve_files([TWO]), replace(plan, before=solve_files([ONE])), TWO)


def set_up(_: Path) -> Screen[Any]:
    session = simulated()
    return SetUpScreen(session, session.steps()[3], session.opened.instruments)


def dry_run(_: Path) -> Screen[Any]:
    machine = load_machine(None)
    procedure = load_procedure("two-station", machine.geometry())
    return DryRunScreen(Plan(Path(), machine, procedure, simulated().opened.instruments))


def what_if(_: Path) -> Screen[Any]:
    """Two sizes, and others that fit as well."""
    sessions = load_sessions([SWEEP])[0]
    (choice,) = (c for c in choices(sessions) if c.key == ("straightness", "x"))
    choice = replace(choice, alike=("leg_bow (xy)", "leg_taper (xz)", "axis_squareness (yz)"))
    trial = trial_of(choice, sessions, subset="with-tolerances")
    return WhatIfScreen(choice, trial, mistakes=True)


def posture_what_if(folder: Path) -> Screen[Any]:
    session = posture_session(folder / "moved.jsonl", "position", 24)
    causes = causes_to_try(measured_in(session).source)
    return PostureWhatIfScreen(session, causes, next(iter(causes.likely)))


QUESTION = "Step 4, leg X ZERO:\nalong Y +0.2000 mm where +0.000 ± 0.050 mm is expected"
FORM = {"port": "/dev/ttyUSB0", "profile": "mitutoyo-01a", "certificate": "D-K-15123 2025-11"}
MAKERS: dict[type[Screen[Any]], Callable[[Path], Screen[Any]]] = {
    HomeScreen: lambda _: HomeScreen(),
    ReplayChoiceScreen: lambda _: ReplayChoiceScreen([ONE, TWO]),
    PrepareScreen: lambda _: PrepareScreen(),
    IndicatorScreen: lambda _: IndicatorScreen("Second indicator", FORM, {}),
    DryRunScreen: dry_run,
    CheckScreen: lambda _: CheckScreen(demo_plan(Path(), "sweep", 1, WATCHED)),
    ResultScreen: result,
    CompareScreen: lambda _: CompareScreen(compare_files(ONE, TWO)),
    DiagnoseScreen: lambda _: DiagnoseScreen([SWEEP]),
    WhatIfScreen: what_if,
    ReplayScreen: lambda _: ReplayScreen(SAMPLES / "simulated_zero-max-min.jsonl"),
    HexaSlideScreen: lambda _: HexaSlideScreen(),
    HexaSlideResultScreen: lambda folder: HexaSlideResultScreen(
        posture_session(folder / "postures.jsonl", "position", 12)
    ),
    PostureWhatIfScreen: posture_what_if,
    HistoryScreen: lambda folder: HistoryScreen(read_history(folder)),
    LegReviewScreen: lambda _: LegReviewScreen(simulated(), simulated().steps()[-1]),
    SetUpScreen: set_up,
    ChoiceDialog: lambda _: ChoiceDialog(QUESTION, question_choices(QUESTIONED)),
    TextDialog: lambda _: TextDialog("Why? " * 30, "reason", without="step 12 stays the next."),
    HelpDialog: lambda _: HelpDialog("words"),
}
PARTS = {
    Corrections,
    Dialog,
    FormScreen,
    LeftOnce,
    MainScreen,
    PagedScreen,
    SessionScreen,
    SizesScreen,
}
"""What screens are made of."""


def kinds(of: type[Any]) -> Iterator[type[Any]]:
    for kind in of.__subclasses__():
        yield from kinds(kind)
        if kind.__module__.startswith("app."):
            yield kind


def test_every_screen_is_looked_at() -> None:
    """Three have tests of their own, for they need a session under way; one is in test_align."""
    assert {*kinds(Screen)} - PARTS == {*MAKERS, MeasureScreen, MotionDialog, AlignScreen}


def cut(interface: Glidecal) -> list[str]:
    """What of the screen on top cannot be read."""
    places = placed(interface.screen)
    widgets = [
        (widget, place) for widget, place in places.items() if widget.display and widget.size
    ]
    return [f"{widget!r}: {what}" for widget, place in widgets for what in of_widget(widget, place)]


def of_widget(widget: Widget, place: MapGeometry) -> Iterator[str]:
    room, region, clip = widget.content_size, place.region, place.clip
    scrolled = any(isinstance(a, Widget) and a.allow_vertical_scroll for a in widget.ancestors)
    if region.x < clip.x or region.right > clip.right:
        yield f"beyond the side, {region} of {clip}"
    if not scrolled and (region.y < clip.y or region.bottom > clip.bottom):
        yield f"beyond the end, {region} of {clip}"
    if isinstance(widget, Input) and cell_len(widget.value or str(widget.placeholder)) > room.width:
        yield f"{widget.value or widget.placeholder!r} in {room.width} cells"
    for title in (widget.border_title, widget.border_subtitle):
        if title and cell_len(str(title)) > region.width - TITLE_EDGES:
            yield f"title {title!r} in {region.width - TITLE_EDGES} cells"
    if isinstance(widget, ChartPlot) and str(picture := widget.render()) and widget.chart:
        heading, title = widget.chart.heading, str(picture).splitlines()[0].strip()
        yield from [f"title {title!r} of {heading!r}"] * (not tells(title, heading))
    if isinstance(widget, Static) and str(widget.content):
        words, rules = widget.visual, widget.styles.get_rules()
        if (needed := words.get_height(rules, room.width)) > room.height:
            yield f"{needed} rows in {room.height}"
        nowrap = rules.get("text_wrap") == "nowrap"
        optimal = words.get_optimal_width(rules, room.width)
        if (needed := optimal if nowrap else words.get_minimal_width(rules)) > room.width:
            yield f"a word of {needed} in {room.width} cells"
        helped = isinstance(widget.screen, HelpDialog)  # its lines are broken by hand
        lines = [row for row in str(widget.content).splitlines() if helped or ROW.search(row)]
        yield from (f"broken {row!r}" for row in lines if cell_len(row.rstrip()) > room.width)


def tells(title: str, heading: str) -> bool:
    """Whether a title is the heading of a chart, its middle cut out where there is no room."""
    begins, _, ends = title.removesuffix(BLANK).strip().removesuffix(f": {NOTHING}").partition(CUT)
    whole_or_cut = bool(begins and ends) or begins == heading
    return whole_or_cut and heading.startswith(begins) and heading.endswith(ends)


def faint(interface: Glidecal) -> list[str]:
    """Words that nobody tells from their ground, as they are sent to the terminal."""
    if interface.screen.is_modal:
        return []  # what lies behind a dialog is dim
    segments = [segment for strip in strips(interface.screen) for segment in strip]
    pairs = [
        (segment.text.strip(), segment.style.color, segment.style.bgcolor)
        for segment in segments
        if segment.style and any(map(str.isalnum, segment.text))
    ]
    return [
        f"{words!r} has a contrast of {ratio:.1f}"
        for words, *pair in pairs
        if None not in pair
        and (ratio := contrast(*(Color.from_rich_color(part).rgb for part in pair)))
        < LEAST_CONTRAST
    ]


def colours(interface: Glidecal) -> list[str]:
    """Words that are not black, grey or white."""
    segments = [segment for strip in strips(interface.screen) for segment in strip]
    pairs = [(segment.text, segment.style.color) for segment in segments if segment.style]
    return [words for words, c in pairs if c and len(set(c.get_truecolor())) > 1]


async def look(pilot: Pilot[str], interface: Glidecal) -> list[str]:
    await pilot.pause()
    await pilot.pause(0.05)
    return cut(interface) + faint(interface)


async def pages(pilot: Pilot[str], interface: Glidecal) -> list[str]:
    """Of every page of the screen, and of its help."""
    screen = interface.screen
    cuts = await look(pilot, interface)
    for page in screen.query(TabPane):
        screen.query_one(TabbedContent).active = str(page.id)
        cuts += await look(pilot, interface)
    if screen.query(Footer):
        await pilot.press("f1")
        await until(pilot, "help", lambda: isinstance(interface.screen, HelpDialog))
        cuts += await look(pilot, interface)
        await pilot.press("escape")
        await until(pilot, "back", lambda: interface.screen is screen)
    return cuts


@pytest.mark.parametrize("kind", first_quick(MAKERS), ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("size", first_quick(SIZES), ids=str)
async def test_nothing_is_cut(
    size: tuple[int, int], kind: type[Screen[Any]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Colours and messages are looked at where there is least room."""
    monkeypatch.chdir(tmp_path)
    for path in (ONE, SWEEP):
        shutil.copy(path, tmp_path)
    interface = Glidecal(HomeScreen(), looks=LOOKS)
    async with interface.run_test(size=SIZES[-1], notifications=True) as pilot:
        interface.push_screen(screen := MAKERS[kind](tmp_path))
        await until(pilot, "the screen", lambda: interface.screen is screen)
        await until(pilot, "its words", lambda: not getattr(screen, "looking", False))
        if kind is CheckScreen:
            await until(pilot, "readings", lambda: interface.indicators is not None)
        await pilot.resize_terminal(*size)
        assert not (cuts := await pages(pilot, interface)), cuts
        if size != SIZES[0]:
            return
        interface.theme = "textual-light"
        assert not (cuts := await pages(pilot, interface)), ("light", cuts)
        interface._filters.append(Monochrome())  # as Textual does at its start with NO_COLOR
        interface.theme = "textual-dark"
        assert not (cuts := await pages(pilot, interface)), ("NO_COLOR", cuts)
        assert not colours(interface)
        assert isinstance(interface.screen, kind)
        interface.notify("what happened last")
        await pilot.pause()
        assert not screen.query(Toast), "a message lies over nothing"
        below = [layer for layer in interface.screen_stack if layer.query(Footer)][-1]
        assert "what happened last" in "".join(
            str(widget.content) for widget in below.query(Static)
        )
        interface.complain("what went wrong")
        await pilot.pause()
        for line in below.query(Message):
            assert line.has_class("wrong"), "in the colour of errors"


def whole(screen: Screen[Any], display: GaugeDisplay) -> bool:
    """Whether a panel shows its digits, and below its state the strip chart."""
    (x, y), high = display.content_region.offset, len(display.digits)
    drawn = [row[x : x + display.size.width] for row in rows(screen)[y : y + high]]
    beside = zip(drawn, display.digits, strict=True)
    room = display.size.height - high - 1
    return all(row.strip() == d.strip() for row, d in beside) and 0 < len(display.strip) <= room


@LONG
async def test_nothing_is_cut_while_measuring(tmp_path: Path) -> None:
    """With the longest words: a new set-up, a fault, what was taken, every page."""
    interface = Glidecal(CheckScreen(quick_plan(tmp_path)))
    async with interface.run_test(size=SIZES[0]) as pilot:
        screen = await to_measuring(pilot, interface)
        for size in SIZES:
            await pilot.resize_terminal(*size)
            assert not (cuts := await pages(pilot, interface)), (size, cuts)
            for display in screen.query(GaugeDisplay):
                assert len(display.digits) == 5, "legible from three metres where there is room"
                await until(pilot, "digits", lambda display=display: whole(screen, display))
        await take(pilot, screen)
        for size in SIZES:
            await pilot.resize_terminal(*size)
            for key in ("v", "v", "v", "w", "s"):
                await pilot.press(key)
                assert not await look(pilot, interface), (size, key)
                if interface.screen is not screen:
                    await pilot.press("escape")
                    await until(pilot, "back", lambda: interface.screen is screen)
        await pilot.resize_terminal(*SIZES[0])
        screen.say(f"Noted: {'as long as a note may be, ' * 8}")
        assert not [cut_text for cut_text in await look(pilot, interface) if "'said'" in cut_text]
        displays = screen.query(GaugeDisplay)
        assert all(cell_len(display.number) <= display.content_size.width for display in displays)


@pytest.mark.parametrize(
    "procedure", first_quick(["sweep", "two-station", "zero-max-min", "plane", "align"])
)
async def test_no_table_of_a_leg_is_cut(procedure: str) -> None:
    """In every cycle, and the row being measured is on the screen."""
    interface = Glidecal(screen := ReplayScreen(SAMPLES / f"simulated_{procedure}.jsonl"))
    async with interface.run_test(size=SIZES[0]) as pilot:
        await until(pilot, "the picture", lambda: screen.query("#progress"))
        last = {(step.place, step.cycle): step.number for step in screen.playback.steps}
        for size in SIZES:
            await pilot.resize_terminal(*size)
            for number in last.values():
                screen.action_playback("jump_to", str(number))
                assert not (cuts := await look(pilot, interface)), (size, number, cuts)
                table = str(screen.query_one("#table", Static).content).splitlines()
                shown = "\n".join(rows(screen))
                assert all(line.strip() in shown for line in table), (size, number)
                step = screen.playback.now
                assert step
                row = f"cycle {step.cycle}"
                assert sum(row in line for line in table) == len(step.axes), (size, number, table)


@LONG
async def test_nothing_is_cut_where_the_machine_moves_itself(tmp_path: Path) -> None:
    """Its keys, and what befell it; the ports of this test have names longer than any device's."""
    async with moving(tmp_path) as moved:
        await moved.says("G moves it to Zero")
        for befallen in (False, True):
            if befallen:
                moved.twin.befall(MotionTrouble.OFFSET)
                await moved.dialog()
            for size in SIZES:
                await moved.pilot.resize_terminal(*size)
                lines = await look(moved.pilot, moved.interface)
                assert not [line for line in lines if "socket://" not in line], size


@pytest.mark.parametrize("kind", [HomeScreen, CheckScreen])
@pytest.mark.parametrize("size", [(60, 18), (40, 24)])
async def test_a_terminal_that_is_too_small_says_what_is_needed(
    size: tuple[int, int], kind: type[Screen[Any]], tmp_path: Path
) -> None:
    interface = Glidecal(MAKERS[kind](tmp_path), looks=LOOKS)
    async with interface.run_test(size=size, notifications=True) as pilot:
        await until(pilot, "words", lambda: f"{size[0]} × {size[1]}" in said(interface))
        await until(pilot, "its picture", lambda: "needs 80 × 24" in " ".join(
            " ".join(rows(interface.screen)).split()))  # fmt: skip
        assert "needs 80 × 24" in said(interface)
        await pilot.resize_terminal(80, 24)
        await until(pilot, "nothing", lambda: not said(interface))
        await pilot.pause(0.1)
        assert not said(interface)  # words that came before the screen do not come behind these
