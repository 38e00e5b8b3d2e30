"""The review after a leg: whole in every size, over a session whose indicators go on."""

from __future__ import annotations

from pathlib import Path

import pytest
from textual.widgets import Static

from app.measuring.gauges import Gauge, Live, Motion
from app.screens.check import CheckScreen
from app.screens.interface import Glidecal
from app.screens.plot import ChartPlot
from app.screens.session_view import LegReviewScreen
from drivers.profile import IndicatorReading
from tests.conftest import first_quick
from tests.screens.driving import numbers, press_for, quick_plan, take, text, to_measuring, until

STEPS_OF_A_LEG = 10
ELSEWHERE = Live(IndicatorReading("7.777", 7.777, 0.001, False), 0.0, Motion.STABLE)


def charted(interface: Glidecal) -> str:
    return str(interface.screen.query_one(ChartPlot).render())


@pytest.mark.parametrize("size", first_quick([(80, 24), (120, 40)]))
async def test_the_review_is_whole_and_gives_the_session_back(
    tmp_path: Path, size: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    interface = Glidecal(CheckScreen(quick_plan(tmp_path)))
    async with interface.run_test(size=size) as pilot:
        screen = await to_measuring(pilot, interface)
        for _ in range(STEPS_OF_A_LEG - 1):
            await take(pilot, screen)
        await press_for(
            pilot, screen, "review", lambda: isinstance(interface.screen, LegReviewScreen)
        )
        await until(pilot, "words", lambda: "Leg X is done." in text(interface, "#review-text"))
        wide = size[0] > 80
        beside = interface.screen.query_one(ChartPlot)
        await until(pilot, "its place", lambda: beside.display == wide)
        await until(pilot, "chart", lambda: not wide or "along Y" in charted(interface))
        before = numbers(screen)
        with monkeypatch.context() as patched:
            looked: list[Gauge] = []

            def live(gauge: Gauge) -> Live:
                looked.append(gauge)
                return ELSEWHERE

            patched.setattr(Gauge, "live", live)
            screen.guided.gauges[0].on_news()
            await until(pilot, "a look", lambda: len(looked) > len(screen.guided.gauges))
            assert numbers(screen) == before, "drawn in vain behind the review"
            await pilot.press("space")
            await until(pilot, "digits", lambda: numbers(screen) == ["+7.777", "+7.777"])
        assert interface.screen is screen
        assert "LEG Y   ZERO" in text(interface, "#step")
        assert "Taken and on the disk, step 10" in str(screen.query_one("#said", Static).content)
        await pilot.press("f10")
