"""Effects of sessions of postures: adopted in a model, fitted beside the parameters, refused."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.evaluating.hexaslide_calibration import calibrate_file, decided
from app.report.schema.hexaslide import HexaSlideCalibrationReport
from app.report.text.hexaslide_calibration import caveats
from calib.errors import RecordError
from calib.hexaslide.procedures import Procedure
from calib.hexaslide.residuals import Readings
from protocols.hexaslide_model import read_hexaslide_model
from tests.app.cli import glidecal, refused
from tests.app.hexaslide_hidden import hidden_session, written
from tests.blind.hexaslide import Hidden
from tests.blind.telescopic import moved
from tests.calib.hexaslide.telescopic_draws import FILE, NOISE_M, NOISE_RAD, PLAIN, some
from tests.conftest import LONG

SCALE = Hidden("rail_scale", 2, 5e-4)
SCALE_MM_PER_M = 0.5


@dataclass(frozen=True)
class Measured:
    """Two sessions of one machine with a scale, and the model of the first."""

    first: Path
    second: Path
    model: Path
    document: dict[str, Any]


@pytest.fixture(scope="module")
def scaled(tmp_path_factory: pytest.TempPathFactory) -> Measured:
    folder = tmp_path_factory.mktemp("scaled")
    first = hidden_session(folder / "first.jsonl", SCALE)
    second = hidden_session(folder / "second.jsonl", SCALE, take=1)
    adopting = glidecal("diagnose", first, "--adopt", folder / "m.json", "--json")
    assert (adopting.status, adopting.err) == (0, f"model written: {folder / 'm.json'}\n")
    return Measured(first, second, folder / "m.json", json.loads(adopting.out))


def test_what_is_named_is_adopted_with_its_size(scaled: Measured) -> None:
    adopted = scaled.document["adopted"]
    (effect,) = adopted["effects"]
    assert (effect["id"], effect["where"]) == ("rail_scale", "rail 3")
    assert effect["values"][0] == pytest.approx(
        SCALE_MM_PER_M, abs=3.5 * effect["standard_uncertainties"][0]
    )
    assert adopted["mean_square_before"] > 1.5 > adopted["mean_square_after"]
    assert adopted["left_out"]["after"] < 0.8 * adopted["left_out"]["before"]
    bounds = [adopted[key]["bound_rms_mm"] for key in ("platform_before", "platform")]
    assert bounds[1] == pytest.approx(bounds[0], rel=0.05), "nothing else was likely"
    model = read_hexaslide_model(scaled.model)
    (entry,) = model.effects
    assert entry.parameters["scale"].value == effect["values"][0]
    assert entry.parameters["scale"].unit == "mm/m"
    assert entry.provenance is not None
    assert entry.provenance.verdict == "explained"
    assert [line.action for line in model.history] == ["added"]


def test_play_of_an_older_model_file_keeps_its_way(scaled: Measured, tmp_path: Path) -> None:
    """Until form 1 it was negative where a carriage stays behind."""
    content = json.loads(scaled.model.read_text(encoding="utf-8"))
    play = {"value": -0.1, "unit": "mm"}
    effect = {"id": "backlash", "where": "rail 2", "parameters": {"play": play}}
    content["schema"], (old,) = "glidecal.hexaslide-model/1", content["effects"]
    content["effects"] = [old, effect]
    content["history"].append({**content["history"][0], "effect": effect})
    (older := tmp_path / "older.json").write_text(json.dumps(content), encoding="utf-8")
    model = read_hexaslide_model(older)
    assert model.schema_id == "glidecal.hexaslide-model/2"
    assert model.effects[0].parameters["scale"].value == old["parameters"]["scale"]["value"]
    for entry in (model.effects[1], model.history[1].effect):
        assert entry.parameters["play"].value == 0.1
    older.write_text("{}", encoding="utf-8")
    with pytest.raises(RecordError, match="model"):
        read_hexaslide_model(older)


def test_beside_the_model_nothing_is_missing(scaled: Measured) -> None:
    """In a session that did not choose the name; its size is fitted to that one, too."""
    without = json.loads(glidecal("diagnose", scaled.second, "--json").out)
    beside = json.loads(glidecal("diagnose", scaled.second, "--model", scaled.model, "--json").out)
    assert (without["verdict"], beside["verdict"]) == ("explained", "agrees")
    assert without["mean_square_before"] > 1.5 > beside["mean_square_before"]
    assert without["p_value_before"] < 1e-3 < beside["p_value_before"]
    (effect,) = beside["effects_of_model"]
    assert effect["values"][0] == pytest.approx(SCALE_MM_PER_M, abs=0.2)
    text = " ".join(glidecal("diagnose", scaled.second, "--model", scaled.model).out.split())
    assert "second.jsonl: agrees Beside the model's scale of rail 3." in text


def test_a_probability_is_neither_nothing_nor_certain(scaled: Measured) -> None:
    """As of a tripod; rare causes were "0 %"."""
    text = glidecal("diagnose", scaled.second).out
    assert re.search(r"\n scale of rail 3 +0\.9\d\n", text)
    assert re.search(r"\n scale of rail 3 and [a-z0-9 ]+ < 0\.01\n", text)


def test_solve_fits_the_size_beside_the_parameters(scaled: Measured) -> None:
    without, beside = (
        json.loads(glidecal("solve", scaled.second, *options, "--held-out", "0", "--json").out)
        for options in ((), ("--model", scaled.model))
    )
    assert without["lack_of_fit"]["p_value"] < 1e-3 < beside["lack_of_fit"]["p_value"]
    assert beside["rms_after"]["length_mm"] < 0.7 * without["rms_after"]["length_mm"]
    assert beside["residuals"]["effects"] == ["rail_scale:rail 3"]
    assert without["sizes"] == []
    (size,) = beside["sizes"]
    assert (size["name"], size["unit"]) == ("rail 3, scale", "mm/m")
    text = glidecal("solve", scaled.second, "--model", scaled.model).out
    assert re.search(rf"rail 3, scale +\{size['value']:+.2f}", text)
    # what is entered counted the scale already: it needs no adoption
    bounds = [solution["platform"]["bound_rms_mm"] for solution in (without, beside)]
    assert bounds[1] == pytest.approx(bounds[0], rel=0.05)


def test_a_cause_that_explains_the_rest_does_not_hinder_a_pass(scaled: Measured) -> None:
    """The bound counts it. Parameters alone leave more than noise, of which `solve` warns."""
    result = calibrate_file(scaled.second, None, 0.0)
    assert result.fit.p_value is not None
    assert result.fit.p_value < 1e-3
    assert result.platform.bound_m is not None
    least_mm = 1000.0 * (result.platform.now.places_rms_m + result.platform.bound_m)
    assert decided(result, 1.001 * least_mm) == "pass"
    assert decided(result, 0.999 * least_mm) == "undecided"
    document = HexaSlideCalibrationReport.of(result)
    assert "something that the model does not have" in " ".join(caveats(document))


@LONG
def test_a_model_is_shown_extended_held_and_reduced(scaled: Measured, tmp_path: Path) -> None:
    model = tmp_path / "m.json"
    content = json.loads(scaled.model.read_text("utf-8"))
    content["effects"][0]["parameters"]["scale"] |= {"value": 0.9, "held": True}
    model.write_text(json.dumps(content), encoding="utf-8")
    beside = json.loads(glidecal("diagnose", scaled.second, "--model", model, "--json").out)
    assert beside["effects_of_model"][0]["values"] == [0.9]
    assert beside["verdict"] != "agrees", "a size that a person states wrongly stays"
    solved = json.loads(glidecal("solve", scaled.second, "--model", model, "--json").out)
    assert solved["sizes"] == [], "nothing was fitted"
    run = glidecal("model", model)
    assert "scale = +0.9" in run.out
    assert "held" in run.out
    session = hidden_session(tmp_path / "both.jsonl", Hidden("backlash", 1, 1e-4))
    extending = glidecal(
        "diagnose", session, "--model", scaled.model, "--adopt", tmp_path / "n.json"
    )
    assert extending.status == 0, extending.err
    effects = {
        (entry.id, entry.where) for entry in read_hexaslide_model(tmp_path / "n.json").effects
    }
    assert effects == {("rail_scale", "rail 3"), ("backlash", "rail 2")}
    assert (
        glidecal("model", tmp_path / "n.json", "--remove", "backlash:2", "--why", "oil").status == 0
    )
    extension = json.loads(glidecal("model", tmp_path / "n.json", "--json").out)
    assert [entry["id"] for entry in extension["effects"]] == ["rail_scale"]
    assert extension["history"][-1]["why"] == "oil"
    assert "rail_scale at rail 3" in refused(
        2, "model", tmp_path / "n.json", "--remove", "backlash:2", "--why", "oil"
    )


def test_what_the_readings_do_not_support_is_refused(scaled: Measured, tmp_path: Path) -> None:
    out = tmp_path / "x.json"
    sound = hidden_session(tmp_path / "sound.jsonl", Hidden(None))
    few = hidden_session(tmp_path / "few.jsonl", SCALE, count=17)
    wrong = hidden_session(tmp_path / "wrong.jsonl", Hidden("wrong_posture", 7, 3e-3))
    assert "nothing is missing" in refused(2, "diagnose", sound, "--adopt", out)
    assert "5 readings beyond the parameters" in refused(2, "diagnose", few, "--adopt", out)
    assert "a mistake: posture 8" in refused(2, "diagnose", wrong, "--adopt", out)
    adopting = ("diagnose", scaled.first, "--adopt", out, "--candidate")
    for candidate, reason in (
        ("backlash:2", "probability is below 1 %"),
        ("wrong_posture:7", "a mistake of the readings"),
        ("leg_scale:1", "no such effect"),
    ):
        message = refused(2, *adopting, candidate)
        assert reason in message
        assert "rail_scale:3 (100 %)" in message
    assert "--adopt" in refused(2, "diagnose", scaled.first, "--candidate", "rail_scale")
    assert "there already" in refused(2, "diagnose", scaled.first, "--adopt", scaled.model)
    assert not out.exists()


@pytest.mark.parametrize(
    ("changed", "status", "message"),
    [
        ({"id": "leg_scale"}, 3, "found leg_scale at rail 3"),
        ({"where": "rail 7"}, 3, "Allowed: rail 1, rail 2"),
        ({"parameters": {"scale": {"value": 1.0, "unit": "mm"}}}, 3, "Allowed: scale in mm/m"),
    ],
)
def test_models_that_do_not_fit_are_refused(
    scaled: Measured, tmp_path: Path, changed: dict[str, Any], status: int, message: str
) -> None:
    content = json.loads(scaled.model.read_text("utf-8"))
    content["effects"][0] |= changed
    model = tmp_path / "m.json"
    model.write_text(json.dumps(content), encoding="utf-8")
    for verb in ("diagnose", "solve"):
        assert message in refused(status, verb, scaled.second, "--model", model)
    content["machine"]["name"] = "another"
    model.write_text(json.dumps(content), encoding="utf-8")
    assert "another machine" in refused(2, "solve", scaled.second, "--model", model)
    model.write_text("{}", encoding="utf-8")
    assert refused(3, "diagnose", scaled.second, "--model", scaled.first)


@LONG
def test_legs_of_a_platform_get_their_effects_as_well(tmp_path: Path) -> None:
    chance = np.random.default_rng(4)
    truth, postures = PLAIN.off(chance), some(40, 5)
    readings = np.array([PLAIN.reads(posture) for posture in postures])
    pairs = zip(moved(readings, "leg_scale", 3, 5.0), postures, strict=True)
    stood = np.array([truth.stands(*pair) for pair in pairs])[:, :3]
    values = stood + NOISE_M * chance.normal(size=stood.shape)
    procedure = Procedure.of("position")
    session = written(
        tmp_path / "s.jsonl", FILE, Readings(procedure, readings, values, NOISE_M, NOISE_RAD)
    )
    model = tmp_path / "m.json"
    adopting = glidecal("diagnose", session, "--adopt", model, "--json")
    assert adopting.status == 0, adopting.err
    (effect,) = json.loads(adopting.out)["adopted"]["effects"]
    assert (effect["id"], effect["where"]) == ("leg_scale", "leg 4")
    assert effect["values"][0] == pytest.approx(0.5, abs=3.5 * effect["standard_uncertainties"][0])
    result = json.loads(glidecal("solve", session, "--model", model, "--json").out)
    assert result["lack_of_fit"]["p_value"] > 1e-3
