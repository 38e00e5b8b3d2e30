"""The diagnosis screen: its pages, adopting and diagnosing again, refusals, the ways in."""

from __future__ import annotations

import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from textual.pilot import Pilot
from textual.widgets import Input, OptionList, TabbedContent

from app.bench import hidden_machine
from app.diagnosing import diagnose_files
from app.diagnosis_plots import residuals_before_and_after
from app.diagnosis_residuals import explained_share, residual_cells, rms_um
from app.hidden_effect import hidden_effect
from app.planning_orthoglide import planned_readings
from app.screens.diagnose import DiagnoseScreen
from app.screens.dialogs import ChoiceDialog, HelpDialog, TextDialog
from app.screens.home import HomeScreen
from app.screens.interface import Interface
from app.screens.plot import ChartPlot
from app.screens.result import ResultScreen
from app.simulated_session import simulated_session
from app.wording.diagnose_screen import where_text
from calib.orthoglide.effects import CATALOGUE
from calib.orthoglide.effects.empirical import Empirical
from calib.orthoglide.effects.law import Placed
from protocols.journal import write_whole
from protocols.machine import load_machine
from protocols.model_file import read_model_file
from protocols.procedure import load_procedure
from tests.screens.driving import SIZE, text, until

SCATTER_MM = 0.002
CUBE = Placed(Empirical(("travel_cube_at_100mm",)), "x", (900.0,))


def write_session(
    path: Path,
    protocol: str,
    seed: int,
    effect: str = "",
    size: float = 0.0,
    *,
    law: Placed | None = None,
) -> Path:
    """A simulated session, with an effect hidden in its machine."""
    machine = load_machine(None)
    procedure = load_procedure(protocol, machine.geometry())
    truth = hidden_machine(machine.geometry(), seed)
    if effect:
        taken = planned_readings(procedure, machine)
        hidden = hidden_effect(
            effect, truth, taken, laws=CATALOGUE, seed=seed, noise_mm=SCATTER_MM, size=size
        )
        truth = replace(truth, effects=hidden)
    if law:
        truth = replace(truth, effects=(law,))
    opened, readings = simulated_session(
        procedure, machine, truth, seed=seed, scatter_mm=SCATTER_MM, resolution_mm=0.001
    )
    write_whole(path, opened, list(readings))
    return path


@pytest.fixture
def bowed(tmp_path: Path) -> Path:
    """A bowed bar that a sweep shows without doubt; the name looks like markup."""
    return write_session(tmp_path / "bow [x].jsonl", "sweep", 3, "leg_bow:xy", 0.25)


@pytest.fixture
def doubtful(tmp_path: Path) -> Path:
    """A wrong scale that weight on a soft bar would look like."""
    return write_session(tmp_path / "doubt.jsonl", "zero-max-min", 4, "actuator_scale:y", 1.6)


@pytest.fixture
def nameless(tmp_path: Path) -> Path:
    """A carriage that is off with the cube of its travel: nothing of the catalogue."""
    return write_session(tmp_path / "cube.jsonl", "sweep", 5, law=CUBE)


def said(interface: Interface) -> str:
    return "\n".join(note.message for note in interface._notifications)


def verdict(interface: Interface) -> str:
    return text(interface, "#verdict-text")


async def diagnosed(pilot: Pilot[str], interface: Interface) -> DiagnoseScreen:
    """The screen once its diagnosis is there."""
    await until(pilot, "the screen", lambda: isinstance(interface.screen, DiagnoseScreen))
    screen = interface.screen
    assert isinstance(screen, DiagnoseScreen)
    await until(pilot, "a diagnosis", lambda: screen.is_mounted and not screen.looking)
    await pilot.pause()
    return screen


async def test_pages_by_keys(bowed: Path) -> None:
    interface = Interface(DiagnoseScreen([bowed]))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        screen = await diagnosed(pilot, interface)
        assert text(interface, "#diagnosed") == "bow [x].jsonl   against: nominal machine"
        assert verdict(interface).startswith("EXPLAINED. What was missing is: ")
        assert re.search(r"leg_bow \(xy\), machine", verdict(interface))
        assert re.search(r"gap 0\.\d{4} → 0\.\d{4} mm", verdict(interface))
        assert "Held out (one side" in verdict(interface)
        tabs = screen.query_one(TabbedContent)
        pages = []
        for key in ("2", "3", "4", "1", "right", "tab", "left", "shift+tab"):
            await pilot.press(key)
            await pilot.pause()
            pages.append(tabs.active)
        assert pages == [
            *("where", "candidates", "change", "verdict"),
            *("where", "candidates", "where", "verdict"),
        ]
        assert "▲▲" in text(interface, "#where-text")
        assert "Where the gap lies" in text(interface, "#where-text")
        ranked = text(interface, "#candidates-text")
        assert re.search(r"leg_bow +xy +█+ +\d+% +0\.\d{4} +named", ranked)
        assert "No other effect looks like leg_bow (xy)" in ranked
        await pilot.press("4")
        await until(pilot, "chart", lambda: "+ after" in drawn(interface))
        assert "X along Y" in drawn(interface)
        assert "after adopting what was" in text(interface, "#change-text")
        await pilot.press("y")
        assert interface.clipboard == text(interface, "#change-text")
        await pilot.press("f1")
        await until(pilot, "help", lambda: isinstance(interface.screen, HelpDialog))
        await pilot.press("escape", "f10")
    assert interface.return_code == 0


def drawn(interface: Interface) -> str:
    return str(interface.screen.query_one("#change-chart", ChartPlot).render())


async def test_adopt_writes_a_model_and_the_second_gap_is_smaller(bowed: Path) -> None:
    interface = Interface(DiagnoseScreen([bowed]))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        screen = await diagnosed(pilot, interface)
        assert screen.diagnosed is not None
        before = screen.diagnosed.diagnosis.gap_before.rms_mm
        await pilot.press("a")
        await until(pilot, "choice", lambda: isinstance(interface.screen, ChoiceDialog))
        listed = interface.screen.query_one(OptionList).options
        assert [str(one.prompt) for one in listed] == ["1  what was named: leg_bow (xy)"]
        await pilot.press("1")
        await until(pilot, "file name", lambda: isinstance(interface.screen, TextDialog))
        model = bowed.with_name("bow [x]_model.json")
        assert interface.screen.query_one(Input).value == str(model)
        await pilot.press("enter")
        await until(pilot, "again", lambda: screen.model == model and not screen.looking)
        assert [(e.id, e.where) for e in read_model_file(model).effects] == [("leg_bow", "xy")]
        assert screen.diagnosed is not None
        again = screen.diagnosed.diagnosis
        assert again.verdict == "agrees"
        assert again.gap_before.rms_mm < before / 3
        assert verdict(interface).startswith("AGREES.")
        words = f"bow [x]_model.json: gap {before:.4f} → {again.gap_before.rms_mm:.4f} mm."
        assert words in verdict(interface).replace("\n", " ")
        assert text(interface, "#diagnosed").endswith("model bow [x]_model.json")
        assert f"Model written: {model}" in said(interface)
        await pilot.press("a")
        await until(pilot, "nothing", lambda: "Nothing to adopt" in said(interface))
        await pilot.press("f10")


async def test_another_effect_of_an_ambiguous_set_is_adopted(doubtful: Path) -> None:
    taken = doubtful.with_name("taken.toml")
    taken.write_text("mine", encoding="utf-8")
    target = doubtful.with_name("other.json")
    interface = Interface(DiagnoseScreen([doubtful]))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        screen = await diagnosed(pilot, interface)
        assert verdict(interface).startswith("AMBIGUOUS.")
        alike = text(interface, "#candidates-text").replace("\n", " ")
        assert "cannot tell actuator_scale (y) from: " in alike
        for path in (taken, target):
            await pilot.press("a")
            await until(pilot, "choice", lambda: isinstance(interface.screen, ChoiceDialog))
            listed = [str(o.prompt) for o in interface.screen.query_one(OptionList).options]
            assert "what was named: actuator_scale (y)" in listed[0]
            rival = re.fullmatch(r"2  instead (\w+) \((\w+)\)", listed[1])
            assert rival is not None
            assert f"{rival[1]} ({rival[2]})" in alike
            await pilot.press("2")
            await until(pilot, "file name", lambda: isinstance(interface.screen, TextDialog))
            interface.screen.query_one(Input).value = str(path)
            await pilot.press("enter")
            await pilot.pause()
        assert f"{taken} is there already" in said(interface)
        assert taken.read_text(encoding="utf-8") == "mine"
        await until(pilot, "again", lambda: screen.model == target and not screen.looking)
        assert rival is not None
        assert [(e.id, e.where) for e in read_model_file(target).effects] == [rival.groups()]
        await pilot.press("f10")


def offered(interface: Interface) -> set[str]:
    """Keys that the footer shows."""
    every = interface.screen.active_bindings.items()
    return {key for key, entry in every if entry.binding.show}


async def test_a_law_without_a_name_is_adopted(nameless: Path) -> None:
    interface = Interface(DiagnoseScreen([nameless]))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        screen = await diagnosed(pilot, interface)
        words = " ".join(verdict(interface).split())
        assert "law without a name" in words or "has no name, but follows a law" in words
        assert "with the cube of travel of carriage X" in words
        assert "Held out (one displacement of one leg left out" in words
        assert "a" in offered(interface)
        await pilot.press("a")
        await until(pilot, "choice", lambda: isinstance(interface.screen, ChoiceDialog))
        listed = [str(o.prompt) for o in interface.screen.query_one(OptionList).options]
        (number,) = [line[0] for line in listed if "a law without a name (x)" in line]
        await pilot.press(number)
        await until(pilot, "file name", lambda: isinstance(interface.screen, TextDialog))
        await pilot.press("enter")
        model = nameless.with_name("cube_model.json")
        await until(pilot, "again", lambda: screen.model == model and not screen.looking)
        (entry,) = read_model_file(model).effects
        assert (entry.id, entry.where) == ("empirical", "x")
        assert list(entry.parameters) == ["travel_cube_at_100mm"]
        assert verdict(interface).startswith("AGREES.")
        await pilot.pause()
        assert not offered(interface) & {"a", "n"}
        await pilot.press("f10")


async def test_the_next_measurement_becomes_a_procedure(doubtful: Path) -> None:
    interface = Interface(DiagnoseScreen([doubtful]))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await diagnosed(pilot, interface)
        assert "Next measurement: " in verdict(interface)
        assert "it settles it between actuator_scale (y)" in " ".join(verdict(interface).split())
        await pilot.press("n")
        written = doubtful.with_name("doubt_next.toml")
        await until(pilot, "words", lambda: f"--protocol {written}" in said(interface))
        assert tomllib.loads(written.read_text(encoding="utf-8"))["cycles"] == 3
        load_procedure(str(written), load_machine(None).geometry())
        await pilot.press("f10")


async def test_a_session_that_agrees(tmp_path: Path) -> None:
    path = write_session(tmp_path / "plain.jsonl", "zero-max-min", 4)
    interface = Interface(DiagnoseScreen([path]))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await diagnosed(pilot, interface)
        assert verdict(interface).startswith("AGREES.")
        assert "would have been found" in verdict(interface)
        assert "names nothing to adopt" in " ".join(text(interface, "#change-text").split())
        assert "▲▲ ▼▼ more than 5" in text(interface, "#where-text")
        assert not offered(interface) & {"a", "n"}
        await pilot.press("a", "n")
        await pilot.pause()
        assert "Nothing to adopt" in said(interface)
        assert "No measurement is proposed" in said(interface)
        assert not isinstance(interface.screen, ChoiceDialog)
        await pilot.press("f10")
    assert [one.name for one in tmp_path.iterdir()] == ["plain.jsonl"]


async def test_a_session_that_cannot_be_diagnosed(samples: Path) -> None:
    interface = Interface(DiagnoseScreen([samples / "damaged.jsonl"]))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        screen = await diagnosed(pilot, interface)
        assert screen.diagnosed is None
        assert verdict(interface).startswith("This cannot be diagnosed.")
        assert "line 9" in verdict(interface)
        for page in ("where", "candidates", "change"):
            assert text(interface, f"#{page}-text") == verdict(interface)
        assert not screen.query_one("#change-chart").display
        await pilot.press("a", "n", "y")
        await pilot.pause()
        assert said(interface).count("There is no diagnosis") == 3
        await pilot.press("f10")
    assert interface.return_code == 0


async def test_where_nothing_may_be_written(doubtful: Path) -> None:
    interface = Interface(DiagnoseScreen([doubtful]), read_only=True)
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await diagnosed(pilot, interface)
        assert not offered(interface) & {"a", "n"}
        await pilot.press("a", "n")
        await pilot.pause()
        assert said(interface).count("This program only shows") == 2
        assert isinstance(interface.screen, DiagnoseScreen)
        await pilot.press("f10")
    assert [one.name for one in doubtful.parent.iterdir()] == ["doubt.jsonl"]


async def test_leaving_while_it_looks(bowed: Path) -> None:
    interface = Interface(HomeScreen())
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await interface.push_screen(DiagnoseScreen([bowed]))
        assert verdict(interface).startswith("Looking for what is missing")
        await pilot.press("a")
        await until(pilot, "words", lambda: "not ready yet" in said(interface))
        await pilot.press("escape")
        await until(pilot, "home", lambda: isinstance(interface.screen, HomeScreen))
        await interface.workers.wait_for_complete()
        await pilot.press("f10")
    assert interface.return_code == 0


async def test_from_home_and_from_the_result(bowed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(bowed.parent)
    interface = Interface(HomeScreen())
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await pilot.pause()
        listed = interface.screen.query_one(OptionList)
        ids = [str(option.id) for option in listed.options]
        await pilot.press("home", *["down"] * ids.index("diagnose"), "enter")
        await pilot.pause()
        await pilot.press("home", "enter")
        screen = await diagnosed(pilot, interface)
        assert [path.name for path in screen.paths] == [bowed.name]
        await pilot.press("escape")
        await until(pilot, "home", lambda: isinstance(interface.screen, HomeScreen))
        steps = ids.index(f"session {bowed.name}")
        await pilot.press("home", *["down"] * steps, "enter")
        await until(pilot, "choice", lambda: isinstance(interface.screen, ChoiceDialog))
        await pilot.press("1")
        await until(pilot, "result", lambda: isinstance(interface.screen, ResultScreen))
        await pilot.press("d")
        screen = await diagnosed(pilot, interface)
        assert verdict(interface).startswith("EXPLAINED.")
        await pilot.press("escape")
        await until(pilot, "result", lambda: isinstance(interface.screen, ResultScreen))
        await pilot.press("f10")


async def test_the_small_choice_of_a_session(bowed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(bowed.parent)
    interface = Interface(HomeScreen(), read_only=True)
    async with interface.run_test(size=SIZE) as pilot:
        await pilot.pause()
        await pilot.press("end", "enter")
        await until(pilot, "choice", lambda: isinstance(interface.screen, ChoiceDialog))
        listed = [str(o.prompt) for o in interface.screen.query_one(OptionList).options]
        await pilot.press(next(o for o in listed if o.endswith("Diagnose"))[0])
        await diagnosed(pilot, interface)
        assert verdict(interface).startswith("EXPLAINED.")
        await pilot.press("f10")


@pytest.mark.parametrize("size", [SIZE, (120, 40)])
async def test_no_line_is_cut_off(doubtful: Path, size: tuple[int, int]) -> None:
    interface = Interface(DiagnoseScreen([doubtful]))
    async with interface.run_test(size=size) as pilot:
        screen = await diagnosed(pilot, interface)
        for page in ("verdict", "where", "candidates", "change"):
            lines = text(interface, f"#{page}-text").splitlines()
            assert max(map(len, lines)) <= 76
        await pilot.press("4")
        await until(pilot, "chart", lambda: "displacement from left" in drawn(interface))
        chart = screen.query_one("#change-chart", ChartPlot)
        assert chart.size.height > size[1] / 2
        assert "x noise   o before   + after adopting" in drawn(interface)
        await pilot.press("f10")


def test_residuals_against_the_readings_themselves(bowed: Path) -> None:
    """Adopted, each cell is within five of its standard deviations; before, many are not."""
    cells = residual_cells(diagnose_files([bowed]))
    assert max(abs(cell.strength) for cell in cells) > 10.0
    for cell in cells:
        assert cell.after_mm is not None
        assert abs(cell.after_mm) < 5.0 * cell.noise_mm
    before, after, noise = rms_um(cells)
    assert before == pytest.approx(1e3 * np.std([c.before_mm for c in cells], mean=0.0))
    assert after is not None
    assert after < 1.5 * noise < before / 3
    chart = residuals_before_and_after(cells)
    held = {series.name: series for series in chart.series}
    assert list(held) == ["noise", "before", "after adopting"]
    assert max(map(abs, held["before"].y)) == max(abs(1000.0 * c.before_mm) for c in cells)
    assert {round(x) for x in held["before"].x} == set(range(1, len(chart.x_names) + 1))


def test_the_map_marks_what_is_more_than_noise(bowed: Path) -> None:
    found = diagnose_files([bowed])
    cells = residual_cells(found)
    shown = where_text(found, cells)
    strong = [cell for cell in cells if abs(cell.strength) > 5.0]
    table = shown.split("▲ ▼ more")[0]
    assert strong
    assert len(re.findall("▲▲|▼▼", table)) == len(strong)
    assert len(re.findall(r"[+-]\d+\.\d", table)) == len(cells)


def test_explained_share() -> None:
    assert explained_share(2.0, 1.0) == 0.75
    assert explained_share(1.0, 2.0) == 0.0
    assert explained_share(0.0, 0.0) == 0.0
