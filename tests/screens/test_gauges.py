"""The panels of the indicators."""

from __future__ import annotations

from pathlib import Path

from textual.app import App, ComposeResult
from textual.containers import Horizontal
from textual.pilot import Pilot
from textual.widget import Widget

from app.measuring.gauges import Live, Motion, Trace
from app.report.charts.digits import large_digits
from app.report.charts.strips import strip_rows
from app.report.text.indicator import state_words
from app.screens import interface
from app.screens.session_view import GaugeDisplay, big_digits
from drivers.profile import Fault, FaultKind, IndicatorReading, Outcome
from protocols.machine import Instrument
from tests.screens.driving import rows, strips

SIZE = (80, 24)
TRACE = Trace(((2, 0.0, 0.0), (1, 0.5, 0.5)), (0.498, 0.502))
LEFT = Instrument(profile="sylvac", port="/dev/tty[USB]0", axes="yx")


def live(outcome: Outcome, motion: Motion) -> Live:
    return Live(outcome, 0.0, motion, lambda: TRACE)


def shown(value_mm: float, motion: Motion = Motion.STABLE, *, age_s: float = 0.0) -> Live:
    return Live(
        IndicatorReading(f"{value_mm}", value_mm, 0.001, False), age_s, motion, lambda: TRACE
    )


class Panels(App[None]):
    """Two indicators beside each other, in the looks of the program."""

    CSS_PATH = Path(interface.__file__).with_name("glidecal.tcss")

    def compose(self) -> ComposeResult:
        with Horizontal(id="gauges"):
            yield GaugeDisplay(0, LEFT)
            yield GaugeDisplay(1, None)

    @property
    def panels(self) -> tuple[GaugeDisplay, GaugeDisplay]:
        left, right = self.query(GaugeDisplay)
        return left, right


def rows_of(app: App[None], widget: Widget) -> list[str]:
    region = widget.region
    return [row[region.x : region.right] for row in rows(app.screen)[region.y : region.bottom]]


async def test_a_panel_shows_digits_state_and_trend_within_its_border() -> None:
    app = Panels()
    async with app.run_test(size=SIZE) as pilot:
        left, right = app.panels
        left.show(shown(-12.345))
        await pilot.pause()
        panel = rows_of(app, left)
        assert len({len(row) for row in panel}) == 1
        assert "─ 1 sylvac ─" in panel[0]
        assert "─ /dev/tty[USB]0 ─" in panel[-1]
        for row, digits in zip(panel[1:4], big_digits("-12.345"), strict=True):
            assert row[1:-1].strip() == digits.strip()
        assert panel[4][1:-1].rstrip() == "= STABLE"
        assert tuple(row[1:-1] for row in panel[5:-1]) == strip_rows(TRACE, left.size.width, 3)
        assert rows_of(app, right)[4][1:-1].strip() == "", "the other has nothing to show"
        assert await as_drawn_anew(pilot, app) == rows(app.screen)


async def as_drawn_anew(pilot: Pilot[None], app: App[None]) -> list[str]:
    """The picture when nothing is kept of what was drawn."""
    for widget in app.screen.walk_children(Widget):
        widget.refresh()
    await pilot.pause()
    return rows(app.screen)


async def test_every_change_is_drawn_and_nothing_old_stays() -> None:
    app = Panels()
    async with app.run_test(size=SIZE) as pilot:
        left, right = app.panels
        lost_gauge = live(Fault(FaultKind.NO_ANSWER, "", "E[1] \x1b[2J is gone"), Motion.FAULT)
        changes = (shown(0.5), shown(0.501), shown(12.5, Motion.MOVING), shown(1.0, age_s=3.0))
        for change in (*changes, lost_gauge, shown(-0.001)):
            left.show(change)
            right.show(shown(0.25))
            await pilot.pause()
            screen_rows = rows(app.screen)
            assert await as_drawn_anew(pilot, app) == screen_rows
            first = rows_of(app, left)[1][1:-1].strip()
            words = state_words(change).replace("\x1b", "")
            assert first == (words if change is lost_gauge else digits_in(left)[0].strip())
            assert left.has_class(change.motion.value)
        assert left.number == "-0.001"


def digits_in(panel: GaugeDisplay) -> tuple[str, ...]:
    """Large ones where they are no longer than the panel."""
    large = large_digits(panel.number)
    return large if len(large[0]) <= panel.size.width else big_digits(panel.number)


async def test_digits_are_large_where_there_is_room() -> None:
    """A number that is longer than the panel is smaller, never cut."""
    app = Panels()
    async with app.run_test(size=(100, 30)) as pilot:
        left, _ = app.panels
        left.styles.height = 12
        await pilot.pause()
        for value_mm in (0.501, -2.25, -12345.125, 10.125, 0.5):
            left.show(shown(value_mm))
            await pilot.pause()
            large = large_digits(left.number)
            digits = large if value_mm > -100.0 else big_digits(left.number)
            panel = [row[1:-1] for row in rows_of(app, left)[1:-1]]
            pairs = zip(panel, digits, strict=False)
            assert all(row.strip() == words.strip() for row, words in pairs)
            assert panel[len(digits)].startswith("= STABLE")
            assert await as_drawn_anew(pilot, app) == rows(app.screen)
    assert {len(large_digits(digit)) for digit in "0123456789+-."} == {5}
    assert len({large_digits(digit) for digit in "0123456789+-."}) == 13


async def test_panels_that_the_screen_cuts_show_what_fits() -> None:
    app = Panels()
    async with app.run_test(size=(80, 4)) as pilot:
        left, _ = app.panels
        for value_mm in (0.5, 0.501, -7.25):
            left.show(shown(value_mm, age_s=value_mm))
            await pilot.pause()
            assert rows(app.screen)[1][1:38].strip() == digits_in(left)[0].strip()
            screen_rows = rows(app.screen)
            assert await as_drawn_anew(pilot, app) == screen_rows


async def test_a_panel_lower_than_its_words_shows_what_fits() -> None:
    app = Panels()
    async with app.run_test(size=SIZE) as pilot:
        left, _ = app.panels
        left.styles.height = 4
        await pilot.pause()
        for age_s in (0.0, 3.0, 4.0):
            left.show(shown(0.5, age_s=age_s))  # its state is below the edge
            await pilot.pause()
            assert rows_of(app, left)[1][2:-2].strip() == big_digits("+0.500")[0].strip()
            assert await as_drawn_anew(pilot, app) == rows(app.screen)


async def test_faults_are_whole_sentences_without_control_codes() -> None:
    app = Panels()
    async with app.run_test(size=SIZE) as pilot:
        left, _ = app.panels
        words = "[red]E1 \x1b[2J the indicator reads in inch, mm is expected: change its unit and"
        left.show(live(Fault(FaultKind.NO_ANSWER, "", f"{words} look again"), Motion.FAULT))
        await pilot.pause()
        assert left.number == "------"
        panel = rows_of(app, left)[1:-1]
        assert {len(row) for row in panel} == {40}, "nothing reaches beyond the border"
        text = " ".join(" ".join(row[1:-1] for row in panel).split())
        assert text == f"! FAULT {words} look again.".replace("\x1b", "")


async def test_another_theme_and_another_size_leave_nothing_kept() -> None:
    app = Panels()
    async with app.run_test(size=SIZE) as pilot:
        left, _ = app.panels
        left.show(shown(0.5))
        await pilot.pause()
        before = grounds(app, left)
        app.theme = "textual-light"
        await pilot.pause()
        assert before.isdisjoint(grounds(app, left))
        await pilot.resize_terminal(120, 30)
        await pilot.pause()
        assert {len(row) for row in rows_of(app, left)} == {60}
        assert await as_drawn_anew(pilot, app) == rows(app.screen)


def grounds(app: App[None], widget: Widget) -> set[object]:
    """Colours behind the digits."""
    digits = strips(app.screen)[widget.region.y + 1 : widget.region.y + 4]
    return {segment.style.bgcolor for strip in digits for segment in strip if segment.style}
