"""The screen of the Hexa Slide: procedures, pages, drawing, searching and leaving, wrong files."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Iterator
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from rich.text import Text
from textual.color import Color
from textual.containers import VerticalScroll
from textual.pilot import Pilot
from textual.widgets import Input, OptionList, TabbedContent

import app.planning.hexaslide as searching
from app.machines.registry import LOOKS
from app.planning.hexaslide import Request
from app.screens.hexaslide import HexaSlideScreen
from app.screens.home import HomeScreen
from app.screens.interface import ChoiceDialog, Glidecal, HelpDialog, TextDialog
from app.screens.plot import ChartPlot
from calib.hexaslide.derivatives import jacobian
from calib.hexaslide.geometry import HexaSlide
from calib.hexaslide.procedures import Procedure
from calib.hexaslide.search import BestPostures, Search, searches
from tests.conftest import LONG
from tests.screens.driving import SIZE, looked, said, text, until

BRAILLE = range(0x2801, 0x2900)
RANKS = {
    "1": ("pose-inverse", 49, 49, 49, 9),
    "2": ("pose-forward", 49, 49, 49, 9),
    "3": ("position", 46, 49, 48, 16),
    "4": ("constraint-link", 48, 55, 46, 48),
}
"""Key: procedure, rank, parameters, the paper's rank, fewest postures."""


def drawn(interface: Glidecal, name: str) -> str:
    return str(interface.screen.query_one(f"#{name}", ChartPlot).render())


def number_colours(interface: Glidecal, name: str) -> tuple[object, object]:
    """Colours of the letter and of the ground where chain 1 is written."""
    picture = interface.screen.query_one(f"#{name}", ChartPlot).render()
    assert isinstance(picture, Text)
    place = next(m.start() for m in re.finditer(r"(?<![.\d])1(?![.\d])", picture.plain))
    style = picture.get_style_at_offset(interface.console, place)
    assert style.color is not None
    assert style.bgcolor is not None
    return Color.from_rich_color(style.color).rgb, Color.from_rich_color(style.bgcolor).rgb


def page(interface: Glidecal) -> str:
    return interface.screen.query_one(TabbedContent).active


async def enter(pilot: Pilot[str], interface: Glidecal, words: str) -> None:
    """The line of a dialog replaced and accepted."""
    await until(pilot, "a dialog", lambda: isinstance(interface.screen, TextDialog))
    await until(pilot, "a line", lambda: bool(interface.screen.query(Input)))
    interface.screen.query_one(Input).value = words
    await pilot.press("enter")
    await until(pilot, "no dialog", lambda: not isinstance(interface.screen, TextDialog))


class Gate:
    """Starts of the search wait: the first for one event, the later ones until they are left."""

    def __init__(self) -> None:
        self.first = threading.Event()
        self.counts: list[int] = []
        self.left = 0
        self.ended = threading.Event()

    def searches(
        self,
        procedure: Procedure,
        machine: HexaSlide,
        count: int,
        search: Search,
        watch: Callable[[], object],
    ) -> Iterator[BestPostures]:
        self.counts.append(count)
        assert self.first.wait(20.0)
        result = next(searches(procedure, machine, count, search, watch))
        try:
            yield result
            self.counts.append(count)
            while True:  # ends by what `watch` raises
                watch()
        finally:
            self.left += 1
            self.ended.set()


@pytest.fixture
def gate(monkeypatch: pytest.MonkeyPatch) -> Iterator[Gate]:
    new_gate = Gate()
    monkeypatch.setattr(searching, "searches", new_gate.searches)
    yield new_gate
    new_gate.first.set()


@LONG
async def test_procedures_by_keys_with_the_papers_ranks_beside() -> None:
    interface = Glidecal(HexaSlideScreen())
    async with interface.run_test(size=SIZE) as pilot:
        for key, (name, rank, count, published, fewest) in RANKS.items():
            await pilot.press("p", key)
            screen = await looked(pilot, interface, HexaSlideScreen)
            assert text(interface, "#heading") == f"example H60   {key} of 4: {name}"
            words = text(interface, "#sees-text")
            assert f"IDENTIFIABLE: {rank} of {count} combinations" in words
            assert f"(papers/001: {published})" in words
            assert f"FEWEST POSTURES: {fewest}." in words
            assert ("papers/001 counts" in words) == (rank != published)
            scroll = screen.query_one("#sees VerticalScroll", VerticalScroll)
            assert scroll.max_scroll_x == 0
        await pilot.press("f10")


async def test_what_is_lost_known_and_how_units_change_the_condition_number() -> None:
    interface = Glidecal(HexaSlideScreen(Request("position")))
    async with interface.run_test(size=SIZE) as pilot:
        screen = await looked(pilot, interface, HexaSlideScreen)
        words = text(interface, "#sees-text")
        assert "platform frame turned about its X, Y, Z." in " ".join(words.split())
        assert "Identifiable alone (31): ax1, ay1, l1" in words
        assert "papers/001: 16 optimum" in words
        assert screen.view is not None
        metres, millimetres = (screen.view.conditions[unit] for unit in ("m, rad", "mm, rad"))
        assert 20.0 * metres < millimetres
        assert screen.query_one("#sees VerticalScroll", VerticalScroll).max_scroll_y == 0
        await pilot.press("f10")


async def test_the_machine_is_drawn_from_two_sides() -> None:
    interface = Glidecal(HexaSlideScreen())
    async with interface.run_test(size=SIZE) as pilot:
        screen = await looked(pilot, interface, HexaSlideScreen)
        await pilot.press("tab")
        await until(pilot, "the page", lambda: page(interface) == "drawn")
        await pilot.pause()
        titles = {"drawn-chart0": "From the front, z in m", "drawn-chart1": "From above, y in m"}
        for name, title in titles.items():
            picture = drawn(interface, name)
            assert title in picture
            inside = "".join(
                re.split("[│┤]", line, maxsplit=1)[-1] for line in picture.splitlines()
            )
            assert set("123456·:▄") <= set(inside)
            assert any(ord(letter) in BRAILLE for letter in inside)
            assert all(len(line) <= SIZE[0] // 2 for line in picture.splitlines())
        words, ground = number_colours(interface, "drawn-chart0")
        assert (words, ground) == number_colours(interface, "drawn-chart1")
        assert words != ground
        assert ground == Color.parse(interface.theme_variables["surface"]).rgb
        assert "Drawn at the middle of the box." in text(interface, "#drawn-text")
        assert not screen.query_one("#sees .beside").display
        await pilot.resize_terminal(120, 40)
        await pilot.press("left")
        await pilot.pause()
        assert screen.query_one("#sees .beside").display
        assert "From above" in drawn(interface, "sees-chart1")
        await pilot.press("f10")


@LONG
async def test_search_shows_start_and_optimum_and_stops(gate: Gate) -> None:
    interface = Glidecal(HexaSlideScreen())
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        screen = await looked(pilot, interface, HexaSlideScreen)
        assert "No postures yet" in text(interface, "#search-text")
        await pilot.press("o")
        await until(pilot, "the page", lambda: page(interface) == "search")
        assert "Searching for 9 postures" in text(interface, "#search-text")
        gate.first.set()
        await until(pilot, "a first start", lambda: screen.best_postures is not None)
        assert "start 1 of 8" in text(interface, "#search-text")
        assert "papers/001 140.2" in text(interface, "#search-text")
        assert screen.searching
        await pilot.press("escape")
        assert not screen.searching
        await until(pilot, "the end of the search", lambda: gate.left == len(gate.counts) - 1)
        assert "Stopped." in said(interface)
        assert isinstance(interface.screen, HexaSlideScreen)
        assert "Escape stops" not in text(interface, "#search-text")
        check_found(screen)
        for name in ("search-chart0", "search-chart1"):
            assert "x start   o optimum" in drawn(interface, name)
        await pilot.press("tab")
        await until(pilot, "angles", lambda: page(interface) == "angles")
        await pilot.pause()
        assert "psi over theta, °" in drawn(interface, "angles-chart0")
        await pilot.press("tab")
        await pilot.pause()
        listed = text(interface, "#list-text").splitlines()
        assert listed[0].split() == ["x_m", "y_m", "z_m", "theta_deg", "psi_deg", "phi_deg"]
        assert len(listed) == 2 + 9
        await pilot.press("y")
        assert interface.clipboard == text(interface, "#list-text")
        assert "9 optimum postures" in text(interface, "#sees-text")
        await check_drawn_at_postures(pilot, interface)
        await pilot.press("f10")


def check_found(screen: HexaSlideScreen) -> None:
    """Both condition numbers once more, from the derivatives themselves."""
    optimum, view = screen.best_postures, screen.view
    assert optimum is not None
    assert view is not None
    machine, best = view.machine, optimum
    for postures, stated in (
        (best.begin, best.start_condition_number),
        (best.coordinates, best.condition_number),
    ):
        rows = jacobian(view.procedure, machine.geometry, postures).reshape(-1, 49)
        assert np.linalg.cond(rows) == pytest.approx(stated, rel=1e-6)
    assert best.condition_number < 140.2
    assert ((machine.box.lower <= best.coordinates) & (best.coordinates <= machine.box.upper)).all()


async def check_drawn_at_postures(pilot: Pilot[str], interface: Glidecal) -> None:
    await pilot.press("left", "left", "left")
    await until(pilot, "the page", lambda: page(interface) == "drawn")
    await pilot.pause()
    middle = drawn(interface, "drawn-chart0")
    await pilot.press("plus")
    await pilot.pause()
    assert "optimum posture 1 of 9" in text(interface, "#drawn-text")
    assert drawn(interface, "drawn-chart0") != middle
    await pilot.press("minus", "minus")
    assert "optimum posture 9 of 9" in text(interface, "#drawn-text")


@LONG
async def test_leaving_while_it_searches(gate: Gate) -> None:
    interface = Glidecal(HomeScreen(), looks=LOOKS)
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        choices = interface.screen.query_one("#choices", OptionList)
        await until(pilot, "choices", lambda: choices.option_count > 0)
        choices.highlighted = choices.get_option_index("hexaslide")
        await pilot.press("enter")
        screen = await looked(pilot, interface, HexaSlideScreen)
        gate.first.set()
        await pilot.press("o")
        await until(pilot, "a second start", lambda: len(gate.counts) == 2)
        await pilot.press("p")
        await until(pilot, "choice", lambda: isinstance(interface.screen, ChoiceDialog))
        await pilot.press("3")
        await until(pilot, "the end of the search", lambda: gate.left == 1)
        await looked(pilot, interface, HexaSlideScreen)
        assert not screen.searching
        assert screen.best_postures is None
        await pilot.press("escape")
        await until(pilot, "home", lambda: isinstance(interface.screen, HomeScreen))
        await pilot.press("f10")
    assert interface.return_code == 0
    assert gate.counts == [9, 9]


@LONG
async def test_quitting_while_it_searches(gate: Gate) -> None:
    interface = Glidecal(HexaSlideScreen())
    async with interface.run_test(size=SIZE) as pilot:
        await looked(pilot, interface, HexaSlideScreen)
        gate.first.set()
        await pilot.press("o")
        await until(pilot, "a second start", lambda: len(gate.counts) == 2)
        await pilot.press("f10")
    assert gate.ended.wait(20.0)
    assert interface.return_code == 0
    assert gate.counts == [9, 9]


@LONG
async def test_count_of_postures(gate: Gate) -> None:
    interface = Glidecal(HexaSlideScreen())
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        screen = await looked(pilot, interface, HexaSlideScreen)
        for wrong in ("8", "x [y]", "201"):
            await pilot.press("c")
            await enter(pilot, interface, wrong)
            assert f"found '{wrong}'. Allowed: 9 to 200" in said(interface)
        await pilot.press("c")
        await enter(pilot, interface, "10")
        gate.first.set()
        await pilot.press("o")
        await until(pilot, "a first start", lambda: screen.best_postures is not None)
        assert gate.counts[0] == 10
        assert screen.best_postures is not None
        assert len(screen.best_postures.coordinates) == 10
        await pilot.press("escape")
        await until(pilot, "the end of the search", lambda: gate.left == len(gate.counts) - 1)
        await pilot.press("f10")


async def test_measured_components_of_ones_own() -> None:
    interface = Glidecal(HexaSlideScreen())
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await looked(pilot, interface, HexaSlideScreen)
        await pilot.press("m")
        await enter(pilot, interface, "x, y, z, theta")
        await looked(pilot, interface, HexaSlideScreen)
        assert text(interface, "#heading").endswith("your own: pose-forward")
        words = text(interface, "#sees-text")
        assert "IDENTIFIABLE: 48 of 49 combinations" in words
        assert "papers/001" not in words
        await pilot.press("m")
        await enter(pilot, interface, "x,roll [deg]")
        await looked(pilot, interface, HexaSlideScreen)
        assert "roll [deg]" in text(interface, "#sees-text")
        await pilot.press("o")
        assert "nothing to search" in said(interface)
        await pilot.press("f10")


async def test_a_broken_machine_file_then_a_good_one(tmp_path: Path) -> None:
    good = (resources.files("protocols") / "machines" / "hexaslide-h60.toml").read_text("utf-8")
    broken, linkless = tmp_path / "own [m].toml", tmp_path / "linkless.toml"
    broken.write_text(good.replace("link_mm = 880.0", "link_mm = 100.0", 1), encoding="utf-8")
    linkless.write_text(good[: good.index("[constraint_link]")], encoding="utf-8")
    interface = Glidecal(HexaSlideScreen(Request("pose-inverse", broken)))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        screen = await looked(pilot, interface, HexaSlideScreen)
        assert text(interface, "#heading") == "own [m].toml"
        assert "does not reach its rail" in text(interface, "#sees-text")
        assert not any(plot.display for plot in screen.query(ChartPlot))
        await pilot.press("c")
        assert "nothing to search" in said(interface)
        await pilot.press("f")
        await enter(pilot, interface, str(linkless))
        await looked(pilot, interface, HexaSlideScreen)
        assert text(interface, "#heading") == "linkless.toml   1 of 4: pose-inverse"
        assert all(plot.display for plot in screen.query(ChartPlot))
        await pilot.press("p", "4")
        await looked(pilot, interface, HexaSlideScreen)
        assert "no [constraint_link]" in text(interface, "#sees-text")
        await pilot.press("f1")
        await until(pilot, "help", lambda: isinstance(interface.screen, HelpDialog))
        await pilot.press("escape", "escape")
        await until(pilot, "home", lambda: isinstance(interface.screen, HomeScreen))
        await pilot.press("f10")
    assert interface.return_code == 0
