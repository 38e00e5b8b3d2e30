"""A file's comments speak of that file: one bound at the tool, of what the file holds."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from app.evaluating.own_effects import known_effects
from calib.tripod.controller import tool_error_mm
from calib.tripod.pipeline import Model
from protocols.model_file import read_model_file, to_model
from tests.app.cli import glidecal

BOUND = re.compile(r"at most ([\d.]+) mm with these values")
TRUTH = {"d_rho_x": 0.8, "d_rho_y": -0.5, "d_rho_z": 0.3}
LEAN = {"id": "axis_squareness", "where": "xy", "parameters": {}}
FORMATS = ("json", "csv", "model", "linuxcnc", "linuxcnc-kins")


def model_file(path: Path, lean_mrad: float, **offsets: float) -> Path:
    lean = LEAN | {"parameters": {"lean": {"value": lean_mrad, "unit": "mrad"}}}
    document = {"schema": "glidecal.model/1", "parameters_mm": offsets, "effects": [lean]}
    path.write_text(json.dumps(document))
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A machine with two axes out of square, its session, and a model that has this effect."""
    folder = tmp_path_factory.mktemp("bound")
    truth = model_file(folder / "truth.json", 2.0, **TRUTH)
    options = ("--protocol", "two-station", "--seed", "3", "-o", folder / "s.jsonl")
    assert glidecal("simulate", "--model", truth, *options).status == 0
    model_file(folder / "m.json", 1.0)
    return folder


def written(folder: Path, out: Path, kind: str, source: str = "s.jsonl") -> tuple[list[str], str]:
    """The words of every file that people read in, and standard error."""
    model = ("--model", folder / "m.json") if source == "s.jsonl" else ()
    known = ("--home-offset", "0,0,0") if kind.startswith("linuxcnc") else ()
    run = glidecal("export", folder / source, "--format", kind, *model, *known, "-o", out)
    assert run.status == 0, run.err
    files = sorted(out.glob("*.inc")) if out.is_dir() else [out]
    words = [" ".join(path.read_text().replace("\n# ", " ").split()) for path in files]
    return words, " ".join(run.err.split())


def true_error_mm(folder: Path, out: Path, *, holds_lean: bool) -> float:
    """What the tool is really off by with these values entered, over the workspace."""
    solved = json.loads((out / "o.json").read_text())["parameters"]
    entered = np.array([solved[name]["value"] for name in TRUTH])
    true = to_model(read_model_file(folder / "truth.json"), "truth", known_effects())
    left = np.array(list(TRUTH.values())) - entered
    rest = Model(true.geometry, (*left.tolist(), 0.0, 0.0, 0.0))
    return tool_error_mm(rest if holds_lean else rest.with_effects(true.effects))


@pytest.mark.parametrize("kind", FORMATS)
def test_every_file_states_the_bound_of_what_it_holds(
    folder: Path, tmp_path: Path, kind: str
) -> None:
    written(folder, tmp_path / "o.json", "json")
    holds_lean = kind in ("model", "linuxcnc-kins")
    true_mm = true_error_mm(folder, tmp_path, holds_lean=holds_lean)
    files, err = written(folder, tmp_path / "out", kind)
    assert true_mm > 0.05 or holds_lean, "else this test shows nothing"
    for text in (*files, err):
        (bound,) = set(BOUND.findall(text))
        assert len(BOUND.findall(text)) == 1
        assert float(bound) >= true_mm
        assert "that leaves 0" not in text
        left_out = "not in these files: axis_squareness; the bound of the tool includes"
        assert (left_out in text) == (not holds_lean)


def test_the_bound_of_files_that_hold_everything_is_that_of_the_result(
    folder: Path, tmp_path: Path
) -> None:
    options = ("--subset", "joint-offsets", "--model", folder / "m.json")
    text = " ".join(glidecal("solve", folder / "s.jsonl", *options).out.split())
    (result, _) = BOUND.findall(text)
    for kind, same in (("linuxcnc-kins", True), ("model", True), ("linuxcnc", False)):
        files, _ = written(folder, tmp_path / kind, kind)
        assert {BOUND.findall(text)[0] == result for text in files} == {same}


def test_a_model_file_says_nothing_of_files_that_hold_less(folder: Path, tmp_path: Path) -> None:
    """The bound that it carries is that of the whole model, and nothing can work out another."""
    written(folder, folder / "whole.json", "model")
    files, err = written(folder, tmp_path / "out", "linuxcnc", "whole.json")
    for text in files:
        assert not BOUND.findall(text)
        assert "not in these files: axis_squareness; that leaves 0.0" in text
        assert "if the model is right" in text
    assert not BOUND.findall(err)
    files, _ = written(folder, tmp_path / "kins", "linuxcnc-kins", "whole.json")
    assert all(len(BOUND.findall(text)) == 1 for text in files)
