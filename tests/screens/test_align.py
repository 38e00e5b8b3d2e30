"""The alignment screen by keys: a screw of the simulated machine is watched, turned, recorded."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from app.measuring.indicators import simulated_indicators
from app.measuring.opening import start_session
from app.measuring.plan import Plan, aligning
from app.screens.align import AlignScreen
from app.screens.interface import Glidecal
from app.screens.measure import MeasureScreen
from protocols.machine import Machine
from protocols.record import read_record
from protocols.session import fold
from tests.app.measuring.test_aligning import SHORT, measure
from tests.screens.driving import SIZE, rows, text, until
from tests.screens.test_not_cut import SIZES, look

ONCE = SHORT.model_copy(update={"stations": (0.3, 0.6)})


async def test_a_screw_is_turned_live(tmp_path: Path) -> None:
    path = tmp_path / "s.jsonl"
    basis = Plan(path, Machine(), ONCE, simulated_indicators(["mitutoyo-01a"] * 2), seed=3)
    plan = replace(aligning(basis, "x"), interval_s=0.03)
    guided = start_session(plan)
    measure(guided)
    interface = Glidecal(MeasureScreen(guided, plan))
    interface.guided = guided
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await until(pilot, "the screen", lambda: isinstance(interface.screen, AlignScreen))
        screen = interface.screen
        assert isinstance(screen, AlignScreen)
        await until(pilot, "the moves", lambda: "to go" in text(interface, "#screws"))
        assert "rail X is the reference and stays" in text(interface, "#said")
        lines = rows(screen)
        for size in (*SIZES[1:], SIZES[0]):
            await pilot.resize_terminal(*size)
            assert not (problems := await look(pilot, interface)), (size, problems)
        assert sum("mm  " in row and ("  Y " in row or "  Z " in row) for row in lines) >= 7
        await pilot.press("right")
        await until(pilot, "a word", lambda: "Space watches the screw" in text(interface, "#said"))
        await pilot.press("c")
        await until(pilot, "a word", lambda: "Nothing was moved" in text(interface, "#said"))
        await pilot.press("space")
        await until(pilot, "a question", lambda: interface.screen is not screen)
        assert len(guided.session.readings) > 0
        await pilot.press("2")
        await until(pilot, "watching", lambda: screen.round and screen.round.watching)
        assert guided.session.readings == ()
        for _ in range(10):
            await pilot.press("right")
        live = screen.round.live_mm if screen.round else lambda: None
        await until(pilot, "a move", lambda: abs((live() or 0.0) - 0.2) < 0.06)
        await pilot.press("down")
        await until(pilot, "a word", lambda: "this screw is watched" in text(interface, "#said"))
        await pilot.press("space")
        await until(pilot, "the record", lambda: "In the record" in text(interface, "#said"))
        await pilot.press("f")
        await until(pilot, "a word", lambda: "moved since" in text(interface, "#said"))
        await pilot.press("x")
        await until(pilot, "as asked", lambda: "as asked" in text(interface, "#screws"))
        await pilot.press("c")
        await until(pilot, "measuring", lambda: isinstance(interface.screen, MeasureScreen))
        assert guided.step() == guided.steps[0]
        await pilot.press("f10")
    changes = fold(read_record(path).events).changes
    assert [change.support_mm for change in changes] == [None, 210.25, 370.25]
    assert changes[1].moved_mm is not None
    assert abs(changes[1].moved_mm - 0.2) < 0.06
    assert changes[2].moved_mm is None
