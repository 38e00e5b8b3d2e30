"""Sizes of a model file are free in a diagnosis and a correction, unless a person holds them."""

from __future__ import annotations

from pathlib import Path

import pytest

from app.evaluating.diagnosis import SessionDiagnosis, diagnose_files
from app.evaluating.loading import load_sessions
from app.evaluating.solution import solve_files
from app.planning.tripod import next_measurement
from calib.tripod.effects.drives import Backlash
from protocols.effect_entries import EffectEntry, ParameterEntry
from protocols.machine import Machine
from protocols.model_file import ModelFile, free_effects
from tests.conftest import LONG
from tests.hidden_sessions import write_session

TRUE_MM, WRONG_MM = 0.05, 0.03


def model(folder: Path, *, held: bool = False) -> Path:
    """A model with play at z of a wrong size."""
    size = ParameterEntry(value=WRONG_MM, unit="mm", held=True if held else None)
    entry = EffectEntry(id="backlash", where="z", parameters={"play": size})
    path = folder / f"held-{held}.json"
    path.write_text(ModelFile(effects=(entry,)).text(), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("play") / "play.jsonl"
    return write_session(path, "sweep", 3, "backlash:z", TRUE_MM)


def play_mm(diagnosed: SessionDiagnosis) -> float:
    return diagnosed.corrections.of("play").values["backlash z: play"].value


@LONG
def test_the_size_that_is_entered_is_that_of_the_readings(session: Path, tmp_path: Path) -> None:
    diagnosed = diagnose_files([session], model=model(tmp_path))
    assert diagnosed.diagnosis.verdict == "agrees"
    assert play_mm(diagnosed) == pytest.approx(TRUE_MM, abs=0.003)
    without = diagnose_files([session])
    bounds_mm = [result.tool.entered_mm["play"] for result in (diagnosed, without)]
    # what is adopted is no cause any more: another one beside it is likelier than before
    assert bounds_mm[1] < bounds_mm[0] < 2.0 * bounds_mm[1]
    solved = solve_files([session], model=model(tmp_path), holds="play")
    assert solved.correction.bound_mm == pytest.approx(bounds_mm[0], rel=1e-9)


@LONG
def test_a_plan_is_made_of_the_same_posterior(session: Path, tmp_path: Path) -> None:
    path = model(tmp_path)
    sessions, _ = load_sessions([session])
    plan = next_measurement(sessions, model_file=path)
    diagnosed = diagnose_files([session], model=path)
    bound_mm = diagnosed.tool.entered_mm["offsets"]
    assert plan.planner.bound_mm == pytest.approx(bound_mm, rel=1e-6)


def test_a_held_size_is_no_size_of_the_readings(session: Path, tmp_path: Path) -> None:
    diagnosed = diagnose_files([session], model=model(tmp_path, held=True))
    assert diagnosed.diagnosis.missing > 0.99
    posterior = diagnosed.corrections.posterior
    (column,) = posterior.field.columns[Backlash(), "z"]
    assert posterior.start[column] == WRONG_MM


def test_every_place_of_an_effect_is_free_unless_one_of_its_sizes_is_held() -> None:
    sizes = {
        f"play_{place}": ParameterEntry(value=mm, unit="mm", of="play", places=(place,))
        for place, mm in zip("xyz", (0.01, 0.02, 0.03), strict=True)
    }
    play = EffectEntry(id="backlash", where="x,y,z", parameters=sizes)
    shared = EffectEntry(
        id="actuator_scale",
        where="all",
        parameters={"scale": ParameterEntry(value=0.1, unit="mm/m", places=("x", "y", "z"))},
    )
    file = ModelFile(machine=Machine(), effects=(play, shared))
    assert {(law.id, place) for law, place in free_effects(file)} == {
        (name, place) for name in ("backlash", "actuator_scale") for place in "xyz"
    }
    numbers = {law.id: 0 for law, _ in free_effects(file)}
    for (law, _), size in free_effects(file).items():
        numbers[law.id] += sum(size == other_size for other_size in free_effects(file).values())
    assert numbers == {"backlash": 3, "actuator_scale": 9}, "each its own, and one of all three"
    one_held = {**sizes, "play_y": sizes["play_y"].model_copy(update={"held": True})}
    entry = play.model_copy(update={"parameters": one_held})
    held_file = ModelFile(machine=Machine(), effects=(entry, shared))
    assert {law.id for law, _ in free_effects(held_file)} == {"actuator_scale"}
