"""The chart on any theme and in any room."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest
from rich.color import Color as RichColor
from rich.style import Style
from rich.text import Text
from textual.app import App, ComposeResult
from textual.color import Color
from textual.theme import BUILTIN_THEMES

from app.report.charts.characters import BLANK, MARKERS
from app.report.charts.charts import Chart, Series
from app.screens.plot import ChartPlot
from tests.conftest import LONG

LEAST_CONTRAST = 3.0
"""Of graphics on their ground, WCAG 2.1."""

LINES = tuple(Series(f"series {m}", (-100.0, 0.0, 60.0), (k - 1.5, 0.0, k)) for k, m in
              enumerate(MARKERS))  # fmt: skip
CHART = Chart("Leg X: readings minus Zero", "displacement, mm", "mm", LINES)


class OneChart(App[None]):
    """A chart alone."""

    def __init__(self, chart: Chart) -> None:
        super().__init__()
        self._chart = chart

    def compose(self) -> ComposeResult:
        yield ChartPlot(self._chart)


def picture(app: App[None]) -> Text:
    content = app.query_one(ChartPlot).render()
    assert isinstance(content, Text)
    return content


def luminance(red: float, green: float, blue: float) -> float:
    """Relative luminance, WCAG 2.1."""

    def linear(part: float) -> float:
        part /= 255.0
        return part / 12.92 if part <= 0.03928 else ((part + 0.055) / 1.055) ** 2.4

    return 0.2126 * linear(red) + 0.7152 * linear(green) + 0.0722 * linear(blue)


def contrast(first: tuple[int, int, int], second: tuple[int, int, int]) -> float:
    bright, dark = sorted((luminance(*first), luminance(*second)), reverse=True)
    return (bright + 0.05) / (dark + 0.05)


def rgb(color: RichColor | None) -> tuple[int, int, int]:
    assert color is not None
    return Color.from_rich_color(color).rgb


def style_of(app: App[None], marker: str) -> Style:
    """How the first point of a series is drawn."""
    content = picture(app)
    lines = content.plain.splitlines(keepends=True)
    row = next(k for k, line in enumerate(lines) if k > 1 and marker in line)
    place = sum(map(len, lines[:row])) + lines[row].index(marker)
    return content.get_style_at_offset(app.console, place)


@LONG
@pytest.mark.parametrize("theme", [name for name in BUILTIN_THEMES if "ansi" not in name])
async def test_every_series_is_legible_on_every_theme(theme: str) -> None:
    app = OneChart(CHART)
    async with app.run_test(size=(80, 24)) as pilot:
        app.theme = theme
        await pilot.pause()
        surface = Color.parse(app.theme_variables["surface"]).rgb
        for marker in MARKERS:
            style = style_of(app, marker)
            assert rgb(style.bgcolor) == surface
            assert contrast(rgb(style.color), surface) >= LEAST_CONTRAST, marker


async def test_a_chart_that_comes_before_the_style_sheet_has_the_colours_of_its_theme() -> None:
    """Before: those of the dark theme for good, in every later chart of the process."""
    app = OneChart(CHART)
    async with app.run_test(size=(80, 24)) as pilot:
        dark_variables = app.theme_variables
        app.register_theme(replace(BUILTIN_THEMES["textual-light"], name="only-here"))
        await app.query_one(ChartPlot).remove()
        app.theme = "only-here"
        await pilot.pause()
        app.theme_variables = dark_variables  # as they are until the style sheet follows
        await app.mount(ChartPlot(CHART))
        await pilot.pause()
        surface = Color.parse(app.theme_variables["surface"]).rgb
        assert surface != Color.parse(dark_variables["surface"]).rgb
        assert rgb(style_of(app, MARKERS[0]).bgcolor) == surface


@pytest.mark.parametrize("theme", ["ansi-dark", "ansi-light"])
async def test_colours_that_the_terminal_chooses_are_left_to_it(theme: str) -> None:
    app = OneChart(CHART)
    async with app.run_test(size=(80, 24)) as pilot:
        app.theme = theme
        await pilot.pause()
        for marker in MARKERS:
            assert (style_of(app, marker).color, style_of(app, marker).bgcolor) == (None, None)
        app.theme = "textual-dark"
        await pilot.pause()
        assert style_of(app, "x").color is not None


async def test_title_unit_legend_and_scales() -> None:
    app = OneChart(CHART)
    async with app.run_test(size=(110, 20)) as pilot:
        await pilot.pause()
        lines = picture(app).plain.splitlines()
    assert lines[0].strip() == "Leg X: readings minus Zero, mm"
    assert lines[-2].split() == ["-100", "-50", "0", "50", "100"]
    legend = "   ".join(f"{m} series {m}" for m in MARKERS)
    assert lines[-1].strip() == f"displacement, mm   {legend}"
    assert next(line for line in lines if line.startswith(" 0┤")).count("─") > 90


async def test_no_room_for_the_words_of_the_axis_leaves_the_legend() -> None:
    app = OneChart(CHART)
    async with app.run_test(size=(60, 20)) as pilot:
        await pilot.pause()
        assert picture(app).plain.splitlines()[-1].split()[:3] == ["x", "series", "x"]


@pytest.mark.parametrize("size", [(1, 1), (4, 3), (20, 5), (30, 18), (60, 8)])
async def test_small_places_do_not_break_it(size: tuple[int, int]) -> None:
    names = tuple(f"n{k}" for k in range(12))
    values = tuple(float(k) for k in range(1, 13))
    named = Chart("Differences", "", "mm", (Series("measured", values, values),), names)
    app = OneChart(named)
    async with app.run_test(size=size) as pilot:
        await pilot.pause()
        assert all(len(line) <= size[0] for line in picture(app).plain.splitlines())
        assert len(picture(app).plain.splitlines()) <= size[1]


async def test_without_readings_it_says_so() -> None:
    app = OneChart(Chart("Leg X", "displacement, mm", "mm", ()))
    async with app.run_test(size=(60, 12)) as pilot:
        await pilot.pause()
        assert picture(app).plain.splitlines()[0].strip() == "Leg X, mm: nothing measured yet"


@pytest.mark.parametrize("columns", [110, 60, 55, 48])
async def test_joint_and_unit_stay_in_a_title_of_a_long_name(columns: int) -> None:
    title = "orthoglide 4711-2025-AB of hall 12, joint x, change of the offset (1 of 3)"
    app = OneChart(Chart(title, "days", "µm", (Series("session", (0.0, 9.0), (-100.0, 50.0)),)))
    async with app.run_test(size=(columns, 12)) as pilot:
        await pilot.pause()
        shown = picture(app).plain.splitlines()[0].strip(f" {BLANK}")
    assert re.fullmatch(r"or.*, joint x, change of the offset \(1 of 3\), µm", shown), shown
    assert ("…" in shown) == (columns < 80)


async def test_a_title_stands_beside_long_names_too() -> None:
    names = tuple(f"leg X along Y, {k}" for k in range(12))
    values = tuple(float(k) for k in range(1, 13))
    chart = Chart("Differences: leg along axis", "", "mm", (Series("measured", values, values),))
    app = OneChart(replace(chart, x_names=names))
    async with app.run_test(size=(40, 30)) as pilot:
        await pilot.pause()
        assert picture(app).plain.startswith("Differences: leg along axis, mm")
