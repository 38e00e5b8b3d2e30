"""The end of measuring: skipped steps are named, a result that fails is said and tried again."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path

import pytest

from app.evaluating.solution import SessionSolution, solve_files
from app.measuring.opening import start_session
from app.measuring.plan import QUICK_INTERVAL_S
from app.measuring.unattended import measure_all
from app.report.text.result import solution_text
from app.screens.check import CheckScreen
from app.screens.interface import Glidecal
from app.screens.result import ResultScreen
from calib.errors import NotIdentifiable
from protocols.record import read_record
from tests.conftest import LONG
from tests.screens.driving import SIZE, quick_plan, take, text, to_measuring, until


async def test_skipped_steps_are_named_in_the_result(tmp_path: Path) -> None:
    plan = replace(quick_plan(tmp_path), interval_s=QUICK_INTERVAL_S)
    with start_session(plan) as guided:
        guided.go()
        guided.take()
        guided.skip([2, 3], "cable in [the] way")
        guided.skip([4], "no time")
        measure_all(guided)
    words = " ".join(solution_text(solve_files([plan.path])).split())
    assert "Remark: 3 steps left out: cable in [the] way; no time" in words


async def test_a_result_that_cannot_be_computed_yet(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The record is closed; words say why there is no result; Space tries again; F10 leaves."""
    tries: list[Path] = []

    def refuse(paths: list[Path]) -> SessionSolution:
        tries.extend(paths)
        raise NotIdentifiable("offsets", "nothing [seen]", "both postures of a leg")

    monkeypatch.setattr("app.screens.corrections.solve_files", refuse)
    plan = quick_plan(tmp_path)
    interface = Glidecal(CheckScreen(plan))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        screen = await to_measuring(pilot, interface)
        await take(pilot, screen)
        screen.guided.skip(range(2, 30), "short")
        screen.proceed()
        await take(pilot, screen)
        await until(pilot, "words", lambda: "nothing [seen]" in said_by(interface))
        assert "Every reading is on the disk" in said_by(interface)
        assert "Space tries again, F10 leaves" in said_by(interface)
        assert read_record(plan.path).end == "closed"
        await pilot.pause(0.6)
        assert "nothing [seen]" in said_by(interface), "closed indicators do not talk over it"
        await pilot.press("space")
        await until(pilot, "another try", lambda: len(tries) == 2)
        await pilot.press("f10")
    assert interface.return_code == 0
    assert tries == [plan.path] * 2
    assert interface.return_value == f"The session is complete: {plan.path}"


@LONG
async def test_trying_again_may_succeed(
    tmp_path: Path, samples: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = solve_files([samples / "experiment_2_twelve.jsonl"])
    answers: list[SessionSolution | None] = [None, result]

    def at_last(paths: list[Path]) -> SessionSolution:
        if answer := answers.pop(0):
            return answer
        raise NotIdentifiable("offsets", "nothing", "something")

    monkeypatch.setattr("app.screens.corrections.solve_files", at_last)
    interface = Glidecal(CheckScreen(quick_plan(tmp_path)))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        screen = await to_measuring(pilot, interface)
        screen.guided.skip(range(1, 31), "all of it")
        screen.proceed()
        await until(pilot, "words", lambda: "tries again" in said_by(interface))
        await pilot.press("space")
        await until(pilot, "result", lambda: isinstance(interface.screen, ResultScreen))
        await pilot.press("f10")
    assert interface.return_code == 0


async def test_space_twice_computes_the_result_once(
    tmp_path: Path, samples: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = solve_files([samples / "experiment_2_twelve.jsonl"])
    tries: list[Path] = []
    allowed = threading.Event()

    def slowly(paths: list[Path]) -> SessionSolution:
        tries.extend(paths)
        allowed.wait(20.0)
        return result

    monkeypatch.setattr("app.screens.corrections.solve_files", slowly)
    monkeypatch.setattr("app.measuring.attended.HELD_KEY_S", 0.0)
    interface = Glidecal(CheckScreen(quick_plan(tmp_path)))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        screen = await to_measuring(pilot, interface)
        screen.guided.skip(range(1, 31), "all of it")
        screen.proceed()
        assert "Computing the result" in said_by(interface)
        await until(pilot, "computing", lambda: len(tries) == 1)
        await pilot.press("space", "space", "b", "u")
        await pilot.pause()
        assert interface.screen is screen
        allowed.set()
        await until(pilot, "result", lambda: isinstance(interface.screen, ResultScreen))
        assert len(tries) == 1
        await pilot.press("f10")


def said_by(interface: Glidecal) -> str:
    return text(interface, "#said")
