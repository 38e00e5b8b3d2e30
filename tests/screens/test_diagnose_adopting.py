"""Adopting what a diagnosis names, and diagnosing again; the next measurement as a procedure."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
from textual.widgets import Input, OptionList, Static

from app.evaluating.diagnosis import SessionDiagnosis
from app.evaluating.solution import solve_files
from app.screens.diagnose import DiagnoseScreen
from app.screens.interface import ChoiceDialog, Glidecal, TextDialog
from app.screens.result import ResultScreen
from protocols.journal import write_whole
from protocols.machine import load_machine
from protocols.model_file import read_model_file
from protocols.procedure import load_procedure
from protocols.record import read_record
from protocols.session import Opened, Reading
from tests.conftest import LONG
from tests.hidden_sessions import write_session
from tests.screens.diagnosing import diagnosed, offered, verdict
from tests.screens.driving import SIZE, said, text, until


@LONG
async def test_adopt_writes_a_model_and_the_second_gap_is_smaller(
    bowed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    texts: list[int] = []

    def in_words(diagnosis: SessionDiagnosis) -> str:
        texts.append(id(diagnosis))
        return "a diagnosis"

    monkeypatch.setattr(SessionDiagnosis, "__repr__", in_words)
    interface = Glidecal(DiagnoseScreen([bowed]))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        screen = await diagnosed(pilot, interface)
        assert screen.diagnosed is not None
        before = screen.diagnosed.diagnosis.gap_before.rms_mm
        await pilot.press("a")
        await until(pilot, "choice", lambda: isinstance(interface.screen, ChoiceDialog))
        listed = interface.screen.query_one(OptionList).options
        assert [str(option.prompt) for option in listed] == ["1  adopt leg_bow (xy)"]
        await pilot.press("1")
        await until(pilot, "file name", lambda: isinstance(interface.screen, TextDialog))
        model = bowed.with_name("bow [x]_model.json")
        assert interface.screen.query_one(Input).value == str(model)
        await pilot.press("enter")
        await until(pilot, "again", lambda: screen.adopting.model == model and not screen.looking)
        assert [(e.id, e.where) for e in read_model_file(model).effects] == [("leg_bow", "xy")]
        assert screen.diagnosed is not None
        again = screen.diagnosed.diagnosis
        assert again.verdict == "agrees"
        assert again.gap_before.rms_mm < before / 3
        assert verdict(interface).startswith("AGREES.")
        words = f"bow [x]_model.json: gap {before:.4f} → {again.gap_before.rms_mm:.4f} mm."
        assert words in verdict(interface).replace("\n", " ")
        assert f"{words} Given leg_bow (xy): tool" in " ".join(verdict(interface).split())
        assert text(interface, "#heading").endswith("model bow [x]_model.json")
        assert f"Model written: {model}" in said(interface)
        await pilot.press("a")
        await until(pilot, "nothing", lambda: "Nothing to adopt" in said(interface))
        await pilot.press("f10")
    assert not texts, "to put all its numbers in words takes seconds, in the thread that draws"


@LONG
async def test_another_effect_of_an_ambiguous_set_is_adopted(doubtful: Path) -> None:
    user_file = doubtful.with_name("taken.toml")
    user_file.write_text("mine", encoding="utf-8")
    target = doubtful.with_name("other.json")
    interface = Glidecal(DiagnoseScreen([doubtful]))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        screen = await diagnosed(pilot, interface)
        assert verdict(interface).startswith("AMBIGUOUS.")
        alike = text(interface, "#candidates-text").replace("\n", " ")
        assert "cannot distinguish actuator_scale (y) from: " in alike
        for path in (user_file, target):
            await pilot.press("a")
            await until(pilot, "choice", lambda: isinstance(interface.screen, ChoiceDialog))
            listed = [str(o.prompt) for o in interface.screen.query_one(OptionList).options]
            assert listed[0] == "1  adopt actuator_scale (y)"
            rival = re.fullmatch(r"2  adopt (\w+) \((\w+)\) instead", listed[1])
            assert rival is not None
            assert f"{rival[1]} ({rival[2]})" in alike
            await pilot.press("2")
            await until(pilot, "file name", lambda: isinstance(interface.screen, TextDialog))
            interface.screen.query_one(Input).value = str(path)
            await pilot.press("enter")
            if path == user_file:
                await until(pilot, "question", lambda: bool(interface.screen.query(OptionList)))
                question = str(interface.screen.query(Static).first().content)
                assert question == f"{user_file} is there already."
                await pilot.press("1")
                await until(pilot, "kept", lambda: interface.screen is screen)
        assert user_file.read_text(encoding="utf-8") == "mine"
        await until(pilot, "again", lambda: screen.adopting.model == target and not screen.looking)
        assert rival is not None
        assert [(e.id, e.where) for e in read_model_file(target).effects] == [rival.groups()]
        await pilot.press("f10")


@LONG
async def test_a_law_without_a_name_is_adopted(nameless: Path) -> None:
    interface = Glidecal(DiagnoseScreen([nameless]))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        screen = await diagnosed(pilot, interface)
        words = " ".join(verdict(interface).split())
        law = "What has no name is most likely this: a carriage is off along its way"
        assert f"{law} with the cube of travel. travel_cube_at_100mm = " in words
        assert "a" in offered(interface)
        await pilot.press("a")
        await until(pilot, "choice", lambda: isinstance(interface.screen, ChoiceDialog))
        listed = [str(o.prompt) for o in interface.screen.query_one(OptionList).options]
        (number,) = [line[0] for line in listed if "an unnamed effect (x)" in line]
        await pilot.press(number)
        await until(pilot, "file name", lambda: isinstance(interface.screen, TextDialog))
        await pilot.press("enter")
        model = nameless.with_name("cube_model.json")
        await until(pilot, "again", lambda: screen.adopting.model == model and not screen.looking)
        (entry,) = read_model_file(model).effects
        assert (entry.id, entry.where) == ("empirical", "x")
        assert list(entry.parameters) == ["travel_cube_at_100mm"]
        assert verdict(interface).startswith("AGREES.")
        await pilot.pause()
        assert not offered(interface) & {"a", "n"}
        await pilot.press("f10")


async def test_the_next_measurement_becomes_a_procedure(doubtful: Path) -> None:
    interface = Glidecal(DiagnoseScreen([doubtful]))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await diagnosed(pilot, interface)
        assert "Next measurement: " in verdict(interface)
        words = " ".join(verdict(interface).split())
        assert re.search(r"it (helps to decide|decides) between actuator_scale \(y\), ", words)
        assert "gravity_sag (y) and " in words
        await pilot.press("n")
        paths = doubtful.with_name("doubt_next.toml")
        await until(pilot, "words", lambda: f"--protocol {paths}" in said(interface))
        procedure = tomllib.loads(paths.read_text(encoding="utf-8"))
        assert procedure["schema"] == "glidecal.procedure/1"
        assert len(procedure["levels"]) > 2
        load_procedure(str(paths), load_machine(None).geometry())
        await pilot.press("f10")


async def test_a_session_that_agrees(tmp_path: Path) -> None:
    path = write_session(tmp_path / "plain.jsonl", "zero-max-min", 4)
    interface = Glidecal(DiagnoseScreen([path]))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await diagnosed(pilot, interface)
        assert verdict(interface).startswith("AGREES.")
        assert "would have been found" in verdict(interface)
        assert "names nothing to adopt" in " ".join(text(interface, "#change-text").split())
        assert "▲▲ ▼▼ more than 5" in text(interface, "#where-text")
        assert not offered(interface) & {"a", "n"}
        for key, words in (("a", "Nothing to adopt"), ("n", "No measurement is proposed")):
            await pilot.press(key)
            await pilot.pause()
            assert said(interface).startswith(words), "in the place of what was said before"
        assert not isinstance(interface.screen, ChoiceDialog)
        await pilot.press("f10")
    assert [entry.name for entry in tmp_path.iterdir()] == ["plain.jsonl"]


@LONG
async def test_a_mistake_is_put_right_in_a_new_session_and_its_result_shown(tmp_path: Path) -> None:
    right = write_session(tmp_path / "right.jsonl", "sweep", 4)
    events = read_record(right).events
    turned = [
        event.model_copy(update={"value_mm": -event.value_mm})
        if isinstance(event, Reading) and (event.leg, event.axis) == ("y", "z")
        else event
        for event in events
    ]
    wrong = tmp_path / "wrong.jsonl"
    opened = events[0]
    assert isinstance(opened, Opened)
    write_whole(wrong, opened, list(turned[1:-1]))
    interface = Glidecal(DiagnoseScreen([wrong]))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        screen = await diagnosed(pilot, interface)
        assert "gauge_sign (yz)" in verdict(interface)
        await pilot.press("a")
        await until(pilot, "choice", lambda: isinstance(interface.screen, ChoiceDialog))
        listed = [str(o.prompt) for o in interface.screen.query_one(OptionList).options]
        assert listed[0] == "1  correct the readings in a new session: gauge_sign (yz)"
        await pilot.press("1")
        await until(pilot, "file name", lambda: isinstance(interface.screen, TextDialog))
        await pilot.press("enter")
        new = tmp_path / "wrong_corrected.jsonl"
        await until(pilot, "again", lambda: screen.adopting.paths == (new,) and not screen.looking)
        assert verdict(interface).startswith("AGREES.")
        assert text(interface, "#heading").startswith(new.name)
        await pilot.press("l")
        await until(pilot, "result", lambda: isinstance(interface.screen, ResultScreen))
        result_screen = interface.screen
        assert isinstance(result_screen, ResultScreen)
        expected = solve_files([right]).joint_offsets_mm
        assert result_screen.result.joint_offsets_mm == pytest.approx(expected, abs=1e-9)
        why = "Corrected from wrong.jsonl"
        await until(
            pilot, "text", lambda: why in " ".join(text(interface, "#details-text").split())
        )
        await pilot.press("f10")


@LONG
async def test_the_result_with_an_adopted_model_is_exported(tmp_path: Path) -> None:
    session = write_session(tmp_path / "play.jsonl", "two-station", 6, "backlash:y", 0.05)
    interface = Glidecal(DiagnoseScreen([session]))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        screen = await diagnosed(pilot, interface)
        for keys in ("a", "1", "enter"):
            await pilot.press(keys)
            await pilot.pause()
        await until(
            pilot, "again", lambda: screen.adopting.model is not None and not screen.looking
        )
        await pilot.press("l")
        await until(pilot, "result", lambda: isinstance(interface.screen, ResultScreen))
        await until(pilot, "text", lambda: "backlash y: play" in text(interface, "#details-text"))
        await pilot.press("e")
        await until(
            pilot,
            "caution",
            lambda: "WARNING: the present HOME_OFFSET" in text(interface, "#result-text"),
        )
        await pilot.press("f10")
    paths = sorted(path.name for path in (tmp_path / "play").iterdir())
    joints = [f"calib_joint{n}.inc" for n in range(3)]
    assert paths == [*joints, "model.json", "offsets.csv", "offsets.json"]
    effects = read_model_file(tmp_path / "play" / "model.json").effects
    (play,) = [effect for effect in effects if (effect.id, effect.where) == ("backlash", "y")]
    assert play.parameters["play"].value == pytest.approx(0.05, abs=0.003)
    words = " ".join((tmp_path / "play" / joints[1]).read_text().replace("\n# ", " ").split())
    assert "play of y" in words
    assert "states how the joints home" in words


async def test_where_nothing_may_be_written(doubtful: Path) -> None:
    interface = Glidecal(DiagnoseScreen([doubtful]), read_only=True)
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await diagnosed(pilot, interface)
        assert not offered(interface) & {"a", "n"}
        for key in "an":
            interface.notify("")
            await pilot.press(key)
            await pilot.pause()
            assert said(interface).count("This program only shows") == 1
        assert isinstance(interface.screen, DiagnoseScreen)
        await pilot.press("f10")
    assert [entry.name for entry in doubtful.parent.iterdir()] == ["doubt.jsonl"]
