"""Effects of the user: the documented one works, broken ones are named, never a traceback."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from app.evaluating.own_effects import effects_folder, known_effects
from calib.errors import RecordError
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.candidates import candidates
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.pipeline import Model
from protocols.machine import Machine
from protocols.model_file import model_file, read_model
from tests.app.cli import glidecal, refused
from tests.builders import postures
from tests.conftest import LONG, ROOT, SAMPLES

OFF = (1.2, -0.7, 0.4, 0.05, -0.02, 0.03)


def documented() -> str:
    text = (ROOT / "docs" / "effects.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    return str(code)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    path = tmp_path / "own [effects]"
    path.mkdir()
    monkeypatch.setenv("GLIDECAL_EFFECTS", str(path))
    return path


def write(folder: Path, text: str) -> None:
    (folder / "mine.py").write_text(text, encoding="utf-8")


def test_the_folder(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert effects_folder() == folder
    assert known_effects() == CATALOGUE
    monkeypatch.delenv("GLIDECAL_EFFECTS")
    assert effects_folder().parts[-2:] == ("glidecal", "effects")


def test_the_documented_effect_is_a_candidate(folder: Path) -> None:
    assert len(documented().splitlines()) < 40
    write(folder, documented())
    effects = known_effects()
    assert [effect.id for effect in effects[len(CATALOGUE) :]] == ["bent_arm"]
    conditions = postures()
    bent_arms = [
        c for c in candidates(Model(parameters_mm=OFF), conditions, effects) if c.id == "bent_arm"
    ]
    assert {c.where for c in bent_arms} >= {"xy", "zy", "x", "all", "x,y,z"}
    plain = Model(parameters_mm=OFF).readings(conditions)
    column = next(c for c in bent_arms if c.where == "xy").columns[:, 0]
    expected = np.where((conditions.leg == 0) & (conditions.axis == 1), 1e-3 * plain**2, 0.0)
    assert column == pytest.approx(expected, abs=1e-15)


def test_the_documented_effect_in_a_model(folder: Path, tmp_path: Path) -> None:
    write(folder, documented())
    effect = known_effects()[-1]
    model = Model(parameters_mm=OFF, effects=(EffectInstance(effect, "xy", (40.0,)),))
    path = tmp_path / "model.json"
    path.write_text(model_file(model, Machine()).text(), encoding="utf-8")
    again, _ = read_model(path, known_effects())
    conditions = postures()
    assert again.readings(conditions) == pytest.approx(model.readings(conditions), abs=1e-15)
    session = tmp_path / "s.jsonl"
    run = glidecal("simulate", "--model", path, "-o", session)
    assert run.status == 0, run.err
    (folder / "mine.py").unlink()
    assert "'bent_arm'" in refused(3, "simulate", "--model", path, "-o", tmp_path / "t.jsonl")


@LONG
def test_the_documented_effect_is_adopted_and_fitted(folder: Path, tmp_path: Path) -> None:
    """It acts only where readings are not 0: a nominal machine does not show it."""
    write(folder, documented())
    model, session = tmp_path / "model.json", tmp_path / "s.jsonl"
    offsets = {"d_rho_x": 1.0, "d_rho_y": -0.8, "d_rho_z": 0.6}
    model.write_text(json.dumps({"schema": "glidecal.model/1", "parameters_mm": offsets}))
    hidden = ("--effect", "bent_arm:all", "--size", "200", "--protocol", "two-station")
    assert glidecal("simulate", "--model", model, *hidden, "-o", session).status == 0
    adopted = tmp_path / "adopted.json"
    run = glidecal("diagnose", session, "--adopt", adopted, "--candidate", "bent_arm:all")
    assert run.status == 0, run.err
    stated = json.loads(adopted.read_text("utf-8"))["parameters_mm"]
    assert stated["d_rho_x"] == pytest.approx(1.0, abs=0.02)
    for subset in ("joint-offsets", "with-tolerances"):
        run = glidecal("solve", session, "--model", adopted, "--subset", subset, "--json")
        assert run.status == 0, run.err
        size = max(json.loads(run.out)["effects"], key=lambda entry: abs(entry["value"]))
        assert abs(abs(size["value"]) - 200.0) < 3.0 * size["standard_uncertainty"]
        assert size["standard_uncertainty"] < 20.0


def test_the_first_hour_of_a_newcomer(folder: Path, tmp_path: Path) -> None:
    """The commands of CONTRIBUTING.md, and the line that they lead to."""
    write(folder, documented())
    page = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    commands = re.findall(r"^glidecal (.*)$", page.partition("first hour")[2], re.MULTILINE)
    for command in commands:
        words = command.replace("sample_sessions", f"{SAMPLES}").split()
        run = glidecal(*words, cwd=tmp_path)
        assert run.status == 0, run.err
    assert len(commands) == 3
    (sentence,) = re.findall(r'"(EXPLAINED.*)"', page)
    assert run.out.splitlines()[0] == sentence


@LONG
def test_the_documented_effect_in_the_demonstration(folder: Path, tmp_path: Path) -> None:
    write(folder, documented())
    run = glidecal("demo", "--headless", "--effect", "bent_arm", cwd=tmp_path)
    assert run.status == 0, run.err
    assert "glidecal diagnose" in run.out


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("def (", "SyntaxError"),
        ("import no_such_module_here\nEFFECTS = ()", "no_such_module_here"),
        ("raise SystemExit(7)", "SystemExit: 7"),
        ("class Stop(KeyboardInterrupt): pass\nraise Stop('now')", "Stop: now"),
        ("class Worst(BaseException): pass\nraise Worst('a\\nb')", "Worst: a b"),
        ("raise GeneratorExit", "GeneratorExit"),
        (
            "class Mute(BaseException):\n    def __str__(self): raise Mute\nraise Mute",
            "Mute, whose words raise Mute",
        ),
        (
            "class Laws(tuple):\n    def __iter__(self): raise SystemExit\nEFFECTS = Laws()",
            "SystemExit",
        ),
        (
            "class Law:\n    @property\n    def id(self): raise BaseException('no id')\n"
            "EFFECTS = (Law(),)",
            "BaseException: no id",
        ),
        ("EFFECT = ()", "no EFFECTS"),
        ("EFFECTS = (3,)", "which lacks one of the texts"),
        (documented().replace("bent_arm", "Bent Arm"), "the id 'Bent Arm'"),
        (documented().replace("bent_arm", "backlash"), "the id 'backlash'"),
        (documented().replace("Stage.READING", '"reading"'), "not a Kind or a Stage"),
        (documented().replace("50.0)", "0.0)"), "a tolerance outside 1e-09"),
        (documented().replace("stage_input**2", "abs(stage_input)"), "complex values do not pass"),
        (documented().replace("values[0]", "(1 + values[0])"), "a value of 0 changes readings"),
        (documented().replace("values[0]", "values[7]"), "IndexError"),
        (documented().replace("mounts(conditions)", "()"), "places"),
    ],
)
def test_a_broken_effect_is_named(folder: Path, text: str, message: str) -> None:
    write(folder, text)
    with pytest.raises(RecordError, match="mine") as caught:
        known_effects()
    assert "mine.py" in str(caught.value)
    assert message in str(caught.value)


def test_a_broken_effect_ends_with_status_3(folder: Path, tmp_path: Path) -> None:
    write(folder, "1 / 0")
    message = refused(3, "demo", "--headless", "--effect", "backlash", cwd=tmp_path)
    assert "mine.py" in message
    assert "ZeroDivisionError: division by zero" in message


def test_whatever_a_broken_effect_raises_the_status_is_3(folder: Path, tmp_path: Path) -> None:
    write(folder, "class Worst(BaseException): pass\nraise Worst('out')")
    message = refused(3, "demo", "--headless", "--effect", "backlash", cwd=tmp_path)
    assert "Worst: out" in message
    write(folder, "raise KeyboardInterrupt")  # as a Ctrl-C while it loads
    run = glidecal("demo", "--headless", "--effect", "backlash", cwd=tmp_path)
    assert run.status == 130
    assert "Traceback" not in run.err


def test_an_installed_package_gives_effects(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A distribution on the path, as an installer leaves it."""
    site = tmp_path / "site"
    described = site / "shop-1.0.dist-info"
    described.mkdir(parents=True)
    (described / "METADATA").write_text("Metadata-Version: 2.1\nName: shop\nVersion: 1.0\n")
    (described / "entry_points.txt").write_text("[glidecal.effects]\narm = shop_effects:EFFECTS\n")
    (site / "shop_effects.py").write_text(documented(), encoding="utf-8")
    monkeypatch.syspath_prepend(str(site))
    assert [effect.id for effect in known_effects()[len(CATALOGUE) :]] == ["bent_arm"]
    (described / "entry_points.txt").write_text("[glidecal.effects]\narm = shop_effects:NONE\n")
    with pytest.raises(RecordError, match="entry point arm = shop_effects:NONE"):
        known_effects()
