"""What people must be able to read, in every theme and size; and the way back from every screen."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rich.style import Style
from textual.color import Color
from textual.pilot import Pilot
from textual.screen import Screen
from textual.theme import BUILTIN_THEMES
from textual.widgets import Label

from app.evaluating.comparison import compare_files
from app.evaluating.solution import solve_files
from app.machines.registry import LOOKS
from app.measuring.demo import demo_plan
from app.report.charts.colours import LEGIBLE, contrast
from app.report.text.signals import SIGNALS
from app.screens.check import CheckScreen
from app.screens.diagnose import DiagnoseScreen
from app.screens.history import CompareScreen
from app.screens.home import HomeScreen
from app.screens.interface import ChoiceDialog, Glidecal, HelpDialog, TextDialog
from app.screens.pages import COLOURS_OF_WORDS
from app.screens.prepare import PrepareScreen
from app.screens.replay import ReplayScreen
from app.screens.result import ResultScreen
from app.screens.session_view import LegReviewScreen
from protocols.record import read_record
from protocols.session import fold
from tests.conftest import LONG, first_quick
from tests.screens.driving import rows, strips, text, until

SIZES = [(80, 24), (100, 30), (120, 40)]


def interface_on(first: Screen[None], theme: str = "textual-dark") -> Glidecal:
    interface = Glidecal(first, looks=LOOKS)
    interface.animation_level = "none"
    interface.theme = theme
    return interface


def contrasts(interface: Glidecal, word: str) -> list[float]:
    """Contrast of a word with its ground wherever it is on the screen, as rendered."""
    ratios = []
    for strip in strips(interface.screen):
        for segment in strip:
            style = segment.style
            if word in segment.text and style and style.color and style.bgcolor:
                pair = (style.color, style.bgcolor)
                ratios.append(contrast(*(Color.from_rich_color(part).rgb for part in pair)))
    return ratios


def test_contrast_as_the_standard_states_it() -> None:
    """WCAG 2.1: black on white is 21, a colour on itself 1; #767676 is the palest grey on white."""
    white = (255, 255, 255)
    assert contrast((0, 0, 0), white) == pytest.approx(21.0)
    assert contrast(white, white) == 1.0
    assert contrast(white, (0x76, 0x76, 0x76)) == pytest.approx(4.54, abs=0.01)
    assert contrast(white, (0x77, 0x77, 0x77)) < LEGIBLE


async def test_words_in_colour_are_legible_in_every_theme() -> None:
    interface = interface_on(HomeScreen())
    async with interface.run_test() as pilot:
        for name in (name for name, theme in BUILTIN_THEMES.items() if not theme.ansi):
            interface.theme = name
            await pilot.pause()
            variables = interface.theme_variables
            grounds = [Color.parse(variables[ground]).rgb for ground in ("background", "surface")]
            for word in COLOURS_OF_WORDS:
                colour = Color.parse(variables[word]).rgb
                assert min(contrast(colour, ground) for ground in grounds) >= LEGIBLE, (name, word)
    assert len({SIGNALS[word] for word in ("Next:", "Taken", "WARNING:", "FAULT:")}) == 4


@LONG
@pytest.mark.parametrize("theme", first_quick(["textual-dark", "textual-light"]))
@pytest.mark.parametrize("size", first_quick(SIZES))
async def test_a_result_opens_on_the_numbers_to_enter_and_the_next_step(
    samples: Path, size: tuple[int, int], theme: str
) -> None:
    path = samples / "experiment_3_twelve.jsonl"
    interface = interface_on(ResultScreen(solve_files([path]), None, path), theme)
    async with interface.run_test(size=size) as pilot:
        await until(pilot, "text", lambda: "Next: D" in text(interface, "#result-text"))
        await pilot.pause()
        screen_rows = rows(interface.screen)
        first = [
            next(k for k, row in enumerate(screen_rows) if row.lstrip().startswith(words))
            for words in ("enter ", "d_rho_x", "d_rho_z", "Tool error", "now ", "after ", "Next: D")
        ]
        assert first == sorted(first)
        assert interface.screen.query_one("#result VerticalScroll").max_scroll_y == 0, (
            "all of it is seen"
        )
        assert contrasts(interface, "Next:")
        assert min(contrasts(interface, "Next:")) >= LEGIBLE


@pytest.mark.parametrize("size", SIZES)
async def test_a_review_is_as_large_as_its_text(samples: Path, size: tuple[int, int]) -> None:
    session = fold(read_record(samples / "simulated_zero-max-min.jsonl").events)
    step = session.steps()[-1]
    interface = interface_on(HomeScreen())
    async with interface.run_test(size=size) as pilot:
        await pilot.pause()
        interface.push_screen(LegReviewScreen(session, step))
        await until(pilot, "review", lambda: "Leg Z is done" in text(interface, "#review-text"))
        await pilot.pause()
        review = interface.screen.query_one("#review")
        assert review.max_scroll_y == 0, "all twelve differences without scrolling"
        lines = text(interface, "#review-text").splitlines()
        screen_text = "\n".join(rows(interface.screen))
        assert all(line.strip() in screen_text for line in lines)
        assert review.size.height <= max(len(lines), 20), "no empty dialog around few lines"
        await pilot.press("v")
        await pilot.pause()
        assert interface.screen.query_one("#review-chart").size.height >= 10


async def test_the_label_of_the_field_with_the_focus_stands_out() -> None:
    interface = interface_on(HomeScreen())
    async with interface.run_test(size=(80, 24)) as pilot:
        interface.push_screen(PrepareScreen())
        await until(pilot, "form", lambda: bool(interface.screen.query(Label)))
        for name in ("indicator1", "indicator2", "operator", "temperature"):
            await pilot.pause()
            field = interface.screen.query_one(f"#{name}")
            assert field.has_focus
            marked = [
                label for label in interface.screen.query(Label) if label.styles.text_style.reverse
            ]
            assert [label.parent for label in marked] == [field.parent]
            await pilot.press("tab")


def over_home(samples: Path, folder: Path) -> dict[str, Callable[[], Screen[Any]]]:
    first, second = (samples / f"experiment_{n}_twelve.jsonl" for n in (2, 3))
    return {
        "prepare": PrepareScreen,
        "check": lambda: CheckScreen(demo_plan(folder, "zero-max-min", 1)),
        "result": lambda: ResultScreen(solve_files([first]), None, first),
        "diagnose": lambda: DiagnoseScreen([first]),
        "compare": lambda: CompareScreen(compare_files(first, second)),
        "replay": lambda: ReplayScreen(first),
        "hexaslide": LOOKS[0].screen,
        "help": lambda: HelpDialog("words"),
        "choice": lambda: ChoiceDialog("Which?", [("a", "a")]),
        "line": lambda: TextDialog("Why?", "reason"),
    }


@LONG
async def test_escape_leads_back_from_every_screen(
    samples: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    interface = interface_on(HomeScreen())
    async with interface.run_test(size=(80, 24)) as pilot:
        for name, make in over_home(samples, tmp_path).items():
            screen = make()
            await pilot.pause()
            interface.push_screen(screen)
            await until(pilot, name, lambda screen=screen: interface.screen is screen)
            await pilot.pause()
            await escape(pilot, interface, name)


async def escape(pilot: Pilot[str], interface: Glidecal, name: str) -> None:
    await pilot.press("escape")
    await until(pilot, f"home after {name}", lambda: isinstance(interface.screen, HomeScreen))


@pytest.fixture(params=["textual-dark", "textual-light", "NO_COLOR"])
def theme(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Each theme, and the dark one where no colours are wanted."""
    if request.param != "NO_COLOR":
        return str(request.param)
    monkeypatch.setenv("NO_COLOR", "1")
    return "textual-dark"


async def test_a_leg_that_is_done_looks_done(samples: Path, theme: str) -> None:
    """By colour, by a word, and by a mark."""
    session = fold(read_record(samples / "simulated_zero-max-min.jsonl").events)
    interface = interface_on(HomeScreen(), theme)
    async with interface.run_test(size=(80, 24)) as pilot:
        await pilot.pause()
        interface.push_screen(LegReviewScreen(session, session.steps()[-1]))
        words = "✓ Leg Z is done."
        await until(pilot, "review", lambda: words in text(interface, "#review-text"))
        await pilot.pause()
        segments = (segment for strip in strips(interface.screen) for segment in strip)
        style = next(segment.style for segment in segments if segment.text == words)
        assert style is not None
        assert style.bold
        if not interface.no_color:
            assert min(contrasts(interface, words)) >= LEGIBLE
            assert style.color != Style.parse(interface.theme_variables["foreground"]).color
            success = Color.parse(interface.theme_variables["success"])
            assert interface.screen.query_one(".done").styles.border.top[1] == success


async def test_the_page_that_is_shown_is_marked_without_colour(samples: Path, theme: str) -> None:
    """In one line below that of the session; reversed, so that no colour is needed."""
    path = samples / "experiment_3_twelve.jsonl"
    interface = interface_on(ResultScreen(solve_files([path]).work_out(), None, path), theme)
    async with interface.run_test(size=(80, 24)) as pilot:
        await until(pilot, "text", lambda: "Next: D" in text(interface, "#result-text"))
        await pilot.press("2")
        await pilot.pause()
        heading, tabs, *_ = strips(interface.screen)
        assert heading.text.split() == [path.name, "in", path.parent.name]
        assert tabs.text.split("  ")[:2] == [" 1 Result", "2 Details"]
        marked = [tab.text.strip() for tab in tabs if tab.style and tab.style.reverse]
        assert marked == ["2 Details"]
