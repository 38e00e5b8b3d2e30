"""Models with effects: written, read, simulated; added to and taken from, with a history."""

from __future__ import annotations

import json
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from calib.errors import RecordError, UsageError
from calib.posterior.library import laws
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.candidates import candidates
from calib.tripod.effects.drives import ActuatorCyclic, AxisOffset
from calib.tripod.effects.effect import Effect, EffectInstance
from calib.tripod.effects.empirical import Empirical
from calib.tripod.effects.gauges import ROUND, SHAPES, PlatformTilt, TiltOfTouchedPlate
from calib.tripod.pipeline import Flow, Model, Stage
from protocols.effect_entries import EffectEntry, Provenance, with_effect, without_effect
from protocols.machine import Machine
from protocols.model_file import ModelFile, effect_entry, model_file, read_model, read_model_file
from tests.builders import postures

OFF = (1.2, -0.7, 0.4, 0.05, -0.02, 0.03)
WHEN = datetime(2026, 3, 1, 12, 0, tzinfo=UTC)


def written(tmp_path: Path, model: ModelFile) -> Path:
    path = tmp_path / "model.json"
    path.write_text(model.text(), encoding="utf-8")
    return path


def adopted(arrangement: str = "mirror") -> tuple[tuple[EffectInstance, ...], EffectEntry]:
    """An effect as a diagnosis adopts it, with uncertainties."""
    model = Model(parameters_mm=OFF)
    candidate = next(
        c
        for c in candidates(model, postures())
        if (c.id, c.arrangement) == ("straightness", arrangement)
    )
    values = np.array([0.11, -0.07])
    placed = candidate.effects(values)
    uncertainties = {
        parameter.name: (float(value), 0.004)
        for parameter, value in zip(candidate.parameters, values, strict=True)
    }
    provenance = Provenance(sessions=("a.jsonl",), digests=("0f",), found=WHEN, verdict="explained")
    return placed, effect_entry(candidate.where, placed, uncertainties, provenance)


@pytest.mark.parametrize(
    "effect",
    tuple(dict.fromkeys((*CATALOGUE, *laws(Machine().geometry())))),
    ids=lambda effect: f"{effect.id}-{effect.parameters[0].name}",
)
def test_every_law_that_may_be_adopted_comes_back(tmp_path: Path, effect: Effect) -> None:
    places = effect.places(postures())
    sizes = tuple(0.5 * p.tolerance for p in effect.parameters)
    machine = Machine()
    model = Model(
        machine.geometry(), OFF, tuple(EffectInstance(effect, place, sizes) for place in places)
    )
    path = tmp_path / "model.json"
    path.write_text(model_file(model, machine).text(), encoding="utf-8")
    assert read_model(path) == (model, machine)


@pytest.mark.parametrize(
    "effect",
    [TiltOfTouchedPlate(), *SHAPES, ROUND, PlatformTilt()],
    ids=lambda e: e.parameters[0].name,
)
def test_every_law_of_contacts_comes_back(tmp_path: Path, effect: Effect) -> None:
    """The tool met a plate, or a probe beside it: such places exist in no other readings."""
    where = "x" if isinstance(effect, PlatformTilt) else "tz"
    sizes = tuple(0.5 * p.tolerance for p in effect.parameters)
    machine = Machine()
    model = Model(machine.geometry(), OFF, (EffectInstance(effect, where, sizes),))
    path = tmp_path / "model.json"
    path.write_text(model_file(model, machine).text(), encoding="utf-8")
    assert read_model(path) == (model, machine)


def test_a_lead_of_the_machine_file(tmp_path: Path) -> None:
    machine = Machine(screw_lead_mm=7.5)
    effect = EffectInstance(ActuatorCyclic(7.5), "y", (3.0, -2.0))
    model = Model(machine.geometry(), OFF, (effect,))
    path = tmp_path / "model.json"
    path.write_text(model_file(model, machine).text(), encoding="utf-8")
    assert read_model(path)[0].effects == (effect,)


def test_shifts_of_axes_and_any_lead_stay_readable(tmp_path: Path) -> None:
    """Shifts were named before distances were; a lead that was searched is in no catalogue."""
    path = tmp_path / "model.json"
    path.write_text(
        """{"schema": "glidecal.model/1", "effects": [
        {"id": "axis_offset", "where": "x", "parameters": {
          "shift_xy": {"value": 0.1, "unit": "mm", "of": "shift", "places": ["xy"]},
          "shift_xz": {"value": -0.2, "unit": "mm", "of": "shift", "places": ["xz"]}}},
        {"id": "actuator_cyclic", "where": "y", "parameters": {
          "sine_13.2mm": {"value": 3.0, "unit": "µm"},
          "cosine_13.2mm": {"value": 4.0, "unit": "µm"}}}]}""",
        encoding="utf-8",
    )
    assert read_model(path)[0].effects == (
        EffectInstance(AxisOffset(), "xy", (0.1,)),
        EffectInstance(AxisOffset(), "xz", (-0.2,)),
        EffectInstance(ActuatorCyclic(13.2), "y", (3.0, 4.0)),
    )


def test_an_adopted_effect_keeps_names_uncertainties_and_origin(tmp_path: Path) -> None:
    placed, entry = adopted()
    plain = model_file(Model(parameters_mm=OFF), Machine())
    path = written(tmp_path, with_effect(plain, entry, "diagnosis"))
    stored = json.loads(path.read_text(encoding="utf-8"))["effects"][0]
    assert stored["where"] == "all"
    assert stored["parameters"]["sideways_at_100mm_first"] == {
        "value": 0.11,
        "unit": "mm",
        "standard_uncertainty": 0.004,
        "of": "sideways_at_100mm",
        "places": ["xy", "yx", "zx"],
    }
    assert stored["provenance"]["digests"] == ["0f"]
    again, _ = read_model(path)
    conditions = postures()
    direct = Model(parameters_mm=OFF, effects=placed)
    assert again.readings(conditions) == pytest.approx(direct.readings(conditions), abs=1e-14)


def test_adding_and_removing_leaves_a_history(tmp_path: Path) -> None:
    _, entry = adopted()
    plain = model_file(Model(parameters_mm=OFF), Machine())
    before = datetime.now(UTC)
    added = with_effect(plain, entry, "found in March")
    with pytest.raises(UsageError, match="in the model already"):
        with_effect(added, entry, "again")
    removed = without_effect(added, "straightness", "all", "the guide was set")
    assert removed.effects == ()
    again = read_model_file(written(tmp_path, removed))
    assert [(h.action, h.why) for h in again.history] == [
        ("added", "found in March"),
        ("removed", "the guide was set"),
    ]
    assert before <= again.history[0].at <= again.history[1].at <= datetime.now(UTC)
    assert again.history[1].effect == entry
    assert read_model(tmp_path / "model.json")[0].effects == ()
    with pytest.raises(UsageError, match="straightness at all"):
        without_effect(added, "backlash", None, "")
    with pytest.raises(UsageError, match="the model has none"):
        without_effect(removed, "straightness", None, "")


def test_a_short_hand_written_effect(tmp_path: Path) -> None:
    path = tmp_path / "model.json"
    path.write_text(
        '{"effects": [{"id": "backlash", "where": "all",'
        ' "parameters": {"play": {"value": 0.02, "unit": "mm"}}}]}'
    )
    effects = [e for e in read_model(path)[0].effects if isinstance(e, EffectInstance)]
    assert [(e.id, e.place, e.values) for e in effects] == [
        ("backlash", leg, (0.02,)) for leg in "xyz"
    ]


def effect_text(**changed: object) -> str:
    entry: dict[str, object] = {
        "id": "backlash",
        "where": "x",
        "parameters": {"play": {"value": 0.02, "unit": "mm"}},
    }
    return json.dumps({"effects": [entry | changed]})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (effect_text(id="back_lash"), "'back_lash'.*axis_squareness.*plate_bow.*docs/effects.md"),
        (effect_text(where="xy"), "place of backlash: found xy. Allowed: x, y, z"),
        (effect_text(parameters={}), "parameters of backlash: found none. Allowed: play"),
        (effect_text(parameters={"gap": {"value": 1.0, "unit": "mm"}}), "found gap"),
        (effect_text(parameters={"play": {"value": 1.0, "unit": "inch"}}), "'inch'. Allowed: mm"),
        (effect_text(parameters={"play": {"value": "1", "unit": "mm"}}), "play.value"),
        (
            effect_text(
                id="actuator_cyclic",
                parameters={
                    "sine_5mm": {"value": 1.0, "unit": "µm", "places": ["x"]},
                    "cosine_5mm": {"value": 1.0, "unit": "µm", "places": ["y"]},
                },
            ),
            "actuator_cyclic at x: found sine_5mm. Allowed: sine_5mm and cosine_5mm",
        ),
    ],
)
def test_effects_that_cannot_be_used(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "model.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(RecordError, match=message):
        read_model(path)


UNNAMED = {
    "cube_at_100mm_xy": {"value": 12.0, "unit": "µm", "of": "cube_at_100mm", "places": ["xy"]},
    "per_hour_xy": {"value": 3.0, "unit": "µm/h", "of": "per_hour", "places": ["xy"]},
    "cube_at_100mm_xz": {"value": -5.0, "unit": "µm", "of": "cube_at_100mm", "places": ["xz"]},
    "per_hour_xz": {"value": 1.0, "unit": "µm/h", "of": "per_hour", "places": ["xz"]},
}


def test_a_law_without_a_name_comes_back(tmp_path: Path) -> None:
    effect = Empirical(("cube_at_100mm", "per_hour"))
    placed = (EffectInstance(effect, "xy", (12.0, 3.0)), EffectInstance(effect, "xz", (-5.0, 1.0)))
    uncertainties = {
        name: (value, 0.5) for name, value in zip(UNNAMED, (12.0, 3.0, -5.0, 1.0), strict=True)
    }
    entry = effect_entry("x", placed, uncertainties)
    assert (entry.id, entry.title) == (
        "empirical",
        "readings grow with the cube of displacement and with time",
    )
    written_entry = json.loads(entry.model_dump_json(exclude_none=True))["parameters"]
    assert written_entry == {
        name: parameter | {"standard_uncertainty": 0.5} for name, parameter in UNNAMED.items()
    }
    plain = model_file(Model(parameters_mm=OFF), Machine())
    path = written(tmp_path, with_effect(plain, entry, "what is left"))
    assert set(read_model(path, ())[0].effects) == set(placed)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({}, "parameters of empirical: found none. Allowed: line_at_100mm, square_at_100mm"),
        ({"play": {"value": 0.02, "unit": "mm"}}, "found play. Allowed: line_at_100mm"),
        (
            {
                "cube_at_100mm": {"value": 1.0, "unit": "µm"},
                "travel_cube_at_100mm": {"value": 1.0, "unit": "µm"},
            },
            "found cube_at_100mm, travel_cube_at_100mm",
        ),
        ({"cube_at_100mm": {"value": 1.0, "unit": "mm"}}, "unit: found 'mm'. Allowed: µm"),
        (
            {"cube_at_100mm": {"value": 1.0, "unit": "µm", "places": ["x"]}},
            "place of empirical: found x. Allowed: xy, xz",
        ),
    ],
)
def test_laws_without_a_name_that_cannot_be_used(
    tmp_path: Path, parameters: dict[str, object], message: str
) -> None:
    path = tmp_path / "model.json"
    path.write_text(effect_text(id="empirical", where="xy", parameters=parameters), "utf-8")
    with pytest.raises(RecordError, match=message):
        read_model(path)


def test_old_files_that_call_a_place_each_are_read(tmp_path: Path) -> None:
    shifts = {
        f"scale_{leg}": {"value": 0.1, "unit": "mm/m", "of": "scale", "places": [leg]}
        for leg in "xyz"
    }
    path = tmp_path / "model.json"
    old = effect_text(id="actuator_scale", where="each", parameters=shifts)
    path.write_text(old, encoding="utf-8")
    effects = read_model(path)[0].effects
    assert [(e.id, e.place) for e in effects if isinstance(e, EffectInstance)] == [
        ("actuator_scale", leg) for leg in "xyz"
    ]
    assert without_effect(read_model_file(path), "actuator_scale", "each", "set").effects == ()


def test_the_load_of_the_tool(tmp_path: Path) -> None:
    """A sag under twice the weight is twice as large; nothing else knows of the load."""
    conditions = postures()
    sag = EffectInstance(
        next(effect for effect in CATALOGUE if effect.id == "gravity_sag"), "z", (0.1,)
    )
    twice = EffectInstance(sag.effect, "z", (0.2,))
    loaded = Machine(load=2.0)
    assert Machine.model_validate_json(loaded.model_dump_json()) == loaded
    readings = Model(loaded.geometry(), OFF, (sag,)).readings(conditions)
    assert readings == pytest.approx(
        Model(Machine().geometry(), OFF, (twice,)).readings(conditions)
    )
    assert Model(loaded.geometry(), OFF).readings(conditions) == pytest.approx(
        Model(Machine().geometry(), OFF).readings(conditions)
    )
    with pytest.raises(ValueError, match="load"):
        Machine(load=0.0)


@dataclass(frozen=True)
class Stranger:
    """An effect that is no law of a catalogue."""

    id: str = "stranger"
    stage: Stage = Stage.READING

    def change(self, stage_input: NDArray[Any], flow: Flow) -> NDArray[Any]:
        return stage_input


def test_what_cannot_be_written() -> None:
    with pytest.raises(RecordError, match="stranger"):
        model_file(Model(effects=(Stranger(),)), Machine())
    with pytest.raises(RecordError, match="real numbers"):
        model_file(Model(effects=(EffectInstance(CATALOGUE[0], "xy", (1j,)),)), Machine())


@pytest.mark.parametrize("gravity", [(0.0, 0.0, 0.0), (0.0, float("nan"), 1.0)])
def test_gravity_needs_a_direction(gravity: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match="gravity"):
        Machine(gravity=gravity)
    assert Machine(gravity=(0.0, 3.0, -4.0)).geometry().gravity == pytest.approx((0.0, 0.6, -0.8))
