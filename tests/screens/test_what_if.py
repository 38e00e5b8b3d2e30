"""What if: sizes by keys, the figures beside those of Python, adopting, dropping, wrong moments."""

from __future__ import annotations

import re
import shutil
import threading
from collections.abc import Sequence
from pathlib import Path

import pytest
from textual.pilot import Pilot
from textual.widgets import Input, OptionList

import glidecal
from app.evaluating.solution import solve_files
from app.evaluating.what_if import Trial
from app.report.text import diagnosis as diagnosis_texts
from app.report.text import what_if as texts
from app.report.text.home import ONLY_SHOWN
from app.screens.diagnose import DiagnoseScreen
from app.screens.interface import ChoiceDialog, Glidecal, TextDialog
from app.screens.plot import ChartPlot
from app.screens.result import ResultScreen
from app.screens.what_if import WhatIfScreen
from calib.errors import UsageError
from protocols.effect_entries import EffectEntry, ParameterEntry
from protocols.model_file import ModelFile, read_model_file
from protocols.record import read_record
from tests.conftest import LONG, SAMPLES
from tests.hidden_sessions import write_session
from tests.screens.diagnosing import diagnosed, offered, verdict
from tests.screens.driving import SIZE, rows, said, text, until

NUMBER = r"([-+]?\d+\.\d+|0)"


async def tried(pilot: Pilot[str], interface: Glidecal, number: str = "1") -> WhatIfScreen:
    """The page of one effect of the list, once its first figures are there."""
    await pilot.press("w")
    await until(pilot, "the list", lambda: isinstance(interface.screen, ChoiceDialog))
    await pilot.press(number)
    await until(pilot, "the page", lambda: isinstance(interface.screen, WhatIfScreen))
    screen = interface.screen
    assert isinstance(screen, WhatIfScreen)
    await until(pilot, "figures", lambda: screen.ready)
    return screen


async def pressed(pilot: Pilot[str], screen: WhatIfScreen, *keys: str) -> None:
    await pilot.press(*keys)
    await until(pilot, "the figures of this size", lambda: screen.ready)


def shown(interface: Glidecal, words: str) -> tuple[float, float]:
    """A row of the figures: without the effect, and with it."""
    match = re.search(
        rf"^\s*{re.escape(words)}\s+{NUMBER}\s+{NUMBER}", body(interface), re.MULTILINE
    )
    assert match, (words, body(interface))
    return float(match[1]), float(match[2])


def body(interface: Glidecal) -> str:
    return text(interface, "#what-if")


@LONG
async def test_figures_follow_the_size_as_in_python(bowed: Path) -> None:
    before = bowed.read_bytes()
    interface = Glidecal(DiagnoseScreen([bowed]))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        diagnosis = await diagnosed(pilot, interface)
        assert "w" in offered(interface)
        screen = await tried(pilot, interface)
        assert text(interface, "#heading").startswith("What if leg_bow (xy)   bow [x].jsonl")
        (fitted,) = screen.trial.fitted
        assert fitted.value == pytest.approx(0.25, abs=3 * fitted.standard_uncertainty)
        chart = screen.query_one("#left-chart0", ChartPlot)
        pictures = [str(chart.render())]
        for keys in (["right"], ["left", "left"], ["shift+left", "shift+left"], ["0", "right"]):
            await pressed(pilot, screen, *keys)
            (size,) = screen.values
            subset = screen.trial.subset
            outcome = glidecal.what_if(bowed, effect="leg_bow:xy", size=size, subset=subset)
            former = glidecal.solve(bowed, subset=subset).solution
            residuals = shown(interface, "differences left, mm r.m.s.")
            assert residuals == (
                round(former.rms_after_mm, 4),
                round(outcome.result.solution.rms_after_mm, 4),
            )
            alone = shown(interface, "tool, effect not compensated, mm r.m.s.")[1]
            assert alone == pytest.approx(outcome.tool_mm, abs=5e-5)
            entered = shown(interface, "tool, values without it entered, mm r.m.s.")[1]
            assert entered == pytest.approx(outcome.misled_mm, abs=5e-5)
            assert screen.now is not None
            assert screen.now.solution.predicted_mm.tolist() == pytest.approx(
                outcome.result.solution.predicted_mm.tolist(), abs=1e-12
            )
            await pilot.pause()
            pictures.append(str(chart.render()))
        assert pictures[0] != pictures[-1]
        assert size == screen.trial.sizes.steps[0]
        for page, words in (("2", "x measured   o without   + with it"), ("3", "left, mm")):
            await pilot.press(page)
            await pilot.pause(0.05)
            assert any(words in row for row in rows(screen))
            assert not any(re.search(r"[xyz]_[xyz][+-]", row) for row in rows(screen))
        await pilot.press("escape")
        await until(pilot, "back", lambda: interface.screen is diagnosis)
        await pilot.press("f10")
    assert [entry.name for entry in bowed.parent.iterdir()] == [bowed.name]
    assert bowed.read_bytes() == before


@LONG
async def test_the_scale_stays_while_a_size_is_moved(bowed: Path) -> None:
    """Between nothing and about twice the size that fits; beyond it grows, and does not shrink."""
    interface = Glidecal(DiagnoseScreen([bowed]))
    async with interface.run_test(size=(120, 40), notifications=True) as pilot:
        await diagnosed(pilot, interface)
        screen = await tried(pilot, interface)
        chart = screen.query_one("#left-chart0", ChartPlot)

        async def scale(*keys: str) -> list[float]:
            await pressed(pilot, screen, *keys)
            await pilot.pause()
            *_, numbers, _ = str(chart.render()).splitlines()  # names stand at the left
            return [float(number) for number in numbers.split()]

        began = await scale("f")
        assert began[0] < 0.0 < began[-1]
        for keys in (["0"], ["shift+right"] * 2, ["f"]):
            assert await scale(*keys) == began
        far = await scale(*["shift+right"] * 20)
        assert far[0] < began[0] or far[-1] > began[-1]
        assert await scale("f") == far
        await pilot.press("f10")


@LONG
async def test_a_size_that_was_moved_is_adopted_and_held(bowed: Path) -> None:
    interface = Glidecal(DiagnoseScreen([bowed]))
    model = bowed.with_name("bow [x]_model.json")
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        diagnosis = await diagnosed(pilot, interface)
        screen = await tried(pilot, interface)
        await pressed(pilot, screen, "shift+left")
        (size,) = screen.values
        await pilot.press("enter")
        await until(pilot, "file name", lambda: isinstance(interface.screen, TextDialog))
        assert interface.screen.query_one(Input).value == str(model)
        await pilot.press("enter")
        await until(
            pilot, "again", lambda: diagnosis.adopting.model == model and not diagnosis.looking
        )
        (entry,) = read_model_file(model).effects
        (parameter,) = entry.parameters.values()
        assert (parameter.value, parameter.held) == (size, True)
        assert parameter.standard_uncertainty is None
        assert verdict(interface)
        # on the result with that model the same effect can be moved on, and freed again
        await pilot.press("l")
        await until(pilot, "result", lambda: isinstance(interface.screen, ResultScreen))
        result = interface.screen
        sentence = "Held as a person stated it"
        await until(
            pilot, "text", lambda: sentence in " ".join(text(interface, "#details-text").split())
        )
        screen = await tried(pilot, interface)
        assert screen.effect_choice.standing == "model"
        await pressed(pilot, screen, "right", "f")
        (best,) = screen.trial.fitted
        await pilot.press("enter")
        await until(pilot, "written", lambda: f"Model written: {model}" in said(interface))
        (entry,) = read_model_file(model).effects
        (parameter,) = entry.parameters.values()
        assert parameter.held is None
        assert parameter.value == pytest.approx(best.value, abs=best.standard_uncertainty)
        assert interface.screen is result
        await until(
            pilot,
            "freed",
            lambda: sentence not in " ".join(text(interface, "#details-text").split()),
        )
        actions = [event.action for event in read_model_file(model).history]
        assert actions == ["added", "removed", "added"]
        # the diagnosis below looks again, for its model is another one now
        was = diagnosis.diagnosed
        await pilot.press("escape")
        await until(pilot, "another", lambda: diagnosis.diagnosed not in (None, was))
        await pilot.press("f10")


async def adopted(path: Path, target: Path, key: str) -> ModelFile:
    """The model that A writes, or Enter after what-if with the size that fits best."""
    interface = Glidecal(DiagnoseScreen([path]))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await diagnosed(pilot, interface)
        if key == "w":
            screen = await tried(pilot, interface)
            await pressed(pilot, screen, "right", "f")
            await pilot.press("enter")
        else:
            await pilot.press(key)
            await until(pilot, "the list", lambda: isinstance(interface.screen, ChoiceDialog))
            await pilot.press("1")
        await until(pilot, "file name", lambda: isinstance(interface.screen, TextDialog))
        interface.screen.query_one(Input).value = str(target)
        await pilot.press("enter")
        await until(pilot, "written", target.exists)
        await pilot.press("f10")
    return read_model_file(target)


@LONG
async def test_what_fits_best_is_adopted_as_a_does(bowed: Path) -> None:
    by_a, by_w = [await adopted(bowed, bowed.with_name(f"{key}.json"), key) for key in "aw"]
    assert by_a.parameters_mm == by_w.parameters_mm
    assert [e.parameters for e in by_a.effects] == [e.parameters for e in by_w.effects]


@LONG
async def test_what_cannot_be_told_apart_is_said(doubtful: Path) -> None:
    interface = Glidecal(DiagnoseScreen([doubtful]))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await diagnosed(pilot, interface)
        await pilot.press("w")
        await until(pilot, "list", lambda: isinstance(interface.screen, ChoiceDialog))
        listed = [str(o.prompt) for o in interface.screen.query_one(OptionList).options]
        assert listed[0].startswith("1  actuator_scale (y), named: ")
        assert len({option[3:].partition(",")[0] for option in listed}) == len(listed)
        rival = next(k for k, option in enumerate(listed) if "  gravity_sag (y)" in option)
        await pilot.press("escape")
        for number, rival_name in (
            ("1", "gravity_sag (y)"),
            (str(rival + 1), "actuator_scale (y)"),
        ):
            await tried(pilot, interface, number)
            words = " ".join(body(interface).split())
            assert f"WARNING: these readings cannot distinguish it from: {rival_name}" in words
            await pilot.press("escape")
        await pilot.press("f10")


@LONG
async def test_wrong_moments(bowed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    interface = Glidecal(screen := DiagnoseScreen([bowed]))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await until(pilot, "looking", lambda: screen.is_mounted and screen.looking)
        await pilot.press("w")
        assert diagnosis_texts.NOT_YET in said(interface)
        await diagnosed(pilot, interface)
        await pilot.press("w")
        await until(pilot, "list", lambda: isinstance(interface.screen, ChoiceDialog))
        come, begun, done = threading.Event(), threading.Event(), Trial.begin

        def waiting(trial: Trial) -> object:
            begun.set()
            come.wait(60)
            return done(trial)

        monkeypatch.setattr(Trial, "begin", waiting)
        await pilot.press("1")
        await until(pilot, "page", lambda: isinstance(interface.screen, WhatIfScreen))
        await until(pilot, "beginning", begun.is_set)
        await pilot.press("right", "0", "up", "f", "enter", "y")
        await until(pilot, "words", lambda: texts.NOT_YET in said(interface))
        assert body(interface) == texts.WORKING
        await pilot.press("escape")
        await until(pilot, "back", lambda: interface.screen is screen)
        come.set()  # figures of a page that is gone
        page = await tried(pilot, interface)
        await pressed(pilot, page, "0")
        await pilot.press("enter")
        await until(pilot, "words", lambda: interface.keyed(texts.NOTHING) in said(interface))
        assert interface.screen is page
        await pilot.press("f10")
    assert [entry.name for entry in bowed.parent.iterdir()] == [bowed.name]


async def test_a_session_that_cannot_be_diagnosed_has_nothing_to_try(tmp_path: Path) -> None:
    path = tmp_path / "none.jsonl"
    path.write_text("no session", encoding="utf-8")
    interface = Glidecal(DiagnoseScreen([path]))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await diagnosed(pilot, interface)
        await pilot.press("w")
        assert diagnosis_texts.NOTHING_FOUND in said(interface)
        await pilot.press("f10")


async def test_on_a_result_any_effect_is_tried_and_none_adopted(tmp_path: Path) -> None:
    path = write_session(tmp_path / "plain.jsonl", "zero-max-min", 4)
    result = solve_files([path], subset="both")
    interface = Glidecal(ResultScreen(result, None, path))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await pilot.pause()
        page = await tried(pilot, interface)
        assert page.effect_choice.standing == "undiagnosed"
        assert page.trial.subset == "both"
        await pressed(pilot, page, "right")
        await pilot.press("enter")
        words = interface.keyed(texts.DIAGNOSE_FIRST)
        await until(pilot, "words", lambda: words in said(interface))
        assert interface.screen is page, "the size stays"
        await pilot.press("f10")
    assert [entry.name for entry in tmp_path.iterdir()] == ["plain.jsonl"]


async def test_figures_or_a_problem_are_of_the_size_that_is_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Once the figures of the size before stayed beside it, and the problem beside later ones."""
    path = write_session(tmp_path / "plain.jsonl", "zero-max-min", 4)
    interface = Glidecal(ResultScreen(solve_files([path], subset="both"), None, path))
    words = "tool, effect not compensated"

    def refused(trial: Trial, values: Sequence[float]) -> Trial:
        raise UsageError("size", f"{values[0]:g}", "one that a machine can have")

    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await pilot.pause()
        page = await tried(pilot, interface)
        await until(pilot, "figures", lambda: words in body(interface))
        with monkeypatch.context() as patched:
            patched.setattr(Trial, "at", refused)
            await pilot.press("right")
            await until(pilot, "problem", lambda: "a machine can have" in body(interface))
        assert words not in body(interface)
        await pressed(pilot, page, "right")
        await until(pilot, "figures", lambda: words in body(interface))
        assert "a machine can have" not in body(interface)
        await pilot.press("f10")


async def test_who_only_looks_adopts_nothing(tmp_path: Path) -> None:
    shutil.copy(SAMPLES / "simulated_sweep.jsonl", path := tmp_path / "sweep.jsonl")
    interface = Glidecal(ResultScreen(solve_files([path]), None, path), read_only=True)
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await pilot.pause()
        page = await tried(pilot, interface)
        await pressed(pilot, page, "right")
        await pilot.press("enter")
        await until(pilot, "words", lambda: ONLY_SHOWN in said(interface))
        assert interface.screen is page
        await pilot.press("f10")
    assert [entry.name for entry in tmp_path.iterdir()] == ["sweep.jsonl"]


@LONG
async def test_a_size_that_readings_do_not_show_can_be_moved_all_the_same(tmp_path: Path) -> None:
    """One temperature: no fit tells an expansion by it."""
    record = read_record(SAMPLES / "experiment_2_twelve.jsonl")
    shutil.copy(record.path, path := tmp_path / "a.jsonl")
    parameter = ParameterEntry(value=0.0, unit="mm")
    entry = EffectEntry(id="leg_length", where="x", parameters={"length": parameter})
    model = tmp_path / "m.json"
    content = ModelFile(machine=record.opened.machine, effects=(entry,))
    model.write_text(content.text(), encoding="utf-8")
    result = solve_files([path], subset="both")
    interface = Glidecal(ResultScreen(result, None, path, model))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await pilot.pause()
        page = await tried(pilot, interface)
        assert not page.trial.sizes.best
        assert "not seen" in body(interface)
        await pilot.press("f")
        await until(pilot, "why", lambda: "not shown by these readings" in said(interface))
        await pressed(pilot, page, "right")
        assert page.values == pytest.approx([0.01])
        assert shown(interface, "tool, effect not compensated, mm r.m.s.")[1] > 0.0
        await pilot.press("f10")
