"""A file's comments speak of that file: one bound at the tool, of what the file holds."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from app.evaluating.own_effects import known_effects
from app.evaluating.solution import SessionSolution, solve_files
from app.exports.linuxcnc import NOT_HOMED
from app.report.text.tables import uncertain
from calib.posterior.correction import Holds
from calib.tripod.pipeline import Model
from calib.tripod.workspace import machine_at, workspace_points
from protocols.model_file import read_model_file, to_model
from tests.app.cli import glidecal
from tests.blind.today import inverse_of
from tests.conftest import LONG, first_quick

BOUND = re.compile(r"at most ([\d.]+) mm with these values")
TRUTH = {"d_rho_x": 0.8, "d_rho_y": -0.5, "d_rho_z": 0.3}
LEAN = {"id": "axis_squareness", "where": "xy", "parameters": {}}
HOLDS: dict[str, Holds] = {
    "json": "offsets",
    "csv": "offsets",
    "model": "kinematics",
    "linuxcnc": "tables",
    "linuxcnc-kins": "kinematics",
}


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


@pytest.fixture(scope="module")
def result(folder: Path) -> SessionSolution:
    return solve_files([folder / "s.jsonl"], model=folder / "m.json")


def written(folder: Path, out: Path, kind: str, source: str = "s.jsonl") -> tuple[list[str], str]:
    """The words of every file that people read in, and standard error."""
    model = ("--model", folder / "m.json") if source == "s.jsonl" else ()
    homing = ("--home-offset", "0,0,0") if kind.startswith("linuxcnc") else ()
    run = glidecal("export", folder / source, "--format", kind, *model, *homing, "-o", out)
    assert run.status == 0, run.err
    files = sorted(out.glob("*.inc")) if out.is_dir() else [out]
    words = [" ".join(path.read_text().replace("\n# ", " ").split()) for path in files]
    return words, " ".join(run.err.split())


def true_error_mm(folder: Path, entered: Model) -> float:
    """What the tool is really off by over the workspace with these values, a shift free."""
    true = to_model(read_model_file(folder / "truth.json"), "truth", known_effects())
    points, commanded = workspace_points(true.geometry), inverse_of(entered)
    off = np.concatenate(
        [machine_at(true, commanded(points, way), way).tool_mm - points for way in (1.0, -1.0)]
    )
    return float(np.sqrt(((off - off.mean(axis=0)) ** 2).sum(axis=1).mean()))


@LONG
@pytest.mark.parametrize("kind", first_quick(list(HOLDS)))
def test_every_file_states_the_bound_of_what_it_holds(
    folder: Path, result: SessionSolution, tmp_path: Path, kind: str
) -> None:
    """Nothing tells how the joints home, so files for joints have no tables."""
    absent = dict.fromkeys(("play", "table"), NOT_HOMED) if kind.startswith("linuxcnc") else None
    correction = result.corrections.of(HOLDS[kind], absent)
    true_mm = true_error_mm(folder, correction.model)
    files, err = written(folder, tmp_path / "out", kind)
    for text in (*files, err):
        assert BOUND.findall(text) == [uncertain(correction.bound_mm)]
    assert true_mm <= correction.bound_mm
    assert true_mm < 0.01 or HOLDS[kind] != "kinematics"
    assert true_mm > 0.02 or HOLDS[kind] == "kinematics", "else this test shows nothing"


@LONG
def test_a_model_file_says_nothing_of_files_that_hold_less(folder: Path, tmp_path: Path) -> None:
    """The bound that it carries is that of the whole model, and nothing can work out another."""
    arguments = ("--format", "model", "--model", folder / "m.json", "--subset", "joint-offsets")
    assert (
        glidecal("export", folder / "s.jsonl", *arguments, "-o", folder / "whole.json").status == 0
    )
    files, err = written(folder, tmp_path / "out", "linuxcnc", "whole.json")
    for text in files:
        assert not BOUND.findall(text)
        assert "not in these files: axis_squareness; joint offsets take over a part" in text
        assert "the rest leaves 0.0" in text
        assert "if the model is right" in text
        assert "r.m.s. at the tool, for a touched-off workpiece" in text
    assert not BOUND.findall(err)
    files, _ = written(folder, tmp_path / "kins", "linuxcnc-kins", "whole.json")
    assert all(len(BOUND.findall(text)) == 1 for text in files)
