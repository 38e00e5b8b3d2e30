"""Key W on the result of a session of postures: a cause is moved, readings and platform follow."""

from __future__ import annotations

from pathlib import Path

import pytest
from textual.widgets import OptionList

from app.screens.hexaslide_result import HexaSlideResultScreen, PostureWhatIfScreen
from app.screens.interface import ChoiceDialog, Glidecal
from app.screens.plot import ChartPlot
from tests.app.hexaslide_hidden import hidden_session
from tests.blind.hexaslide import Hidden
from tests.screens.driving import SIZE, looked, text, until


@pytest.fixture(scope="module")
def scaled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return hidden_session(tmp_path_factory.mktemp("s") / "s.jsonl", Hidden("rail_scale", 2, 5e-4))


async def test_the_size_is_moved_and_all_follows(scaled: Path) -> None:
    interface = Glidecal(HexaSlideResultScreen(scaled))
    async with interface.run_test(size=SIZE) as pilot:
        await looked(pilot, interface, HexaSlideResultScreen)
        await pilot.press("w")
        await until(
            pilot,
            "choices",
            lambda: isinstance(interface.screen, ChoiceDialog) and interface.screen.is_mounted,
        )
        first = interface.screen.query_one(OptionList).get_option_at_index(0)
        assert "scale of rail 3" in str(first.prompt)
        await pilot.press("enter")
        await until(
            pilot,
            "what if",
            lambda: (
                isinstance(interface.screen, PostureWhatIfScreen)
                and "with it" in text(interface, "#what-if")
            ),
        )
        screen = interface.screen
        assert isinstance(screen, PostureWhatIfScreen)
        best = screen.values
        assert best == screen.trial.best
        without, with_it = figures(interface, "readings left")
        assert without > 1.2 > with_it
        assert screen.query_one(ChartPlot).region.area
        await pilot.press("right")
        assert screen.values[0] > best[0]
        await pilot.press("shift+left")
        assert screen.values[0] < best[0]
        await pilot.press("0")
        assert screen.values == (0.0,)
        await until(pilot, "its figures", lambda: screen.ready)
        without, with_it = figures(interface, "readings left")
        assert without == with_it
        assert figures(interface, "cause not compensated") == (0.0, 0.0)
        await pilot.press("f")
        assert screen.values == best
        await until(pilot, "its figures", lambda: screen.ready)
        assert figures(interface, "values without it entered")[1] > 0.01
        await pilot.press("escape")
        await until(pilot, "result", lambda: isinstance(interface.screen, HexaSlideResultScreen))
        await pilot.press("f10")


def figures(interface: Glidecal, row: str) -> tuple[float, float]:
    """Both numbers of the row that has these words."""
    (line,) = [line for line in text(interface, "#what-if").splitlines() if row in line]
    without, with_it = line.split()[-2:]
    return float(without), float(with_it)
