"""An adopted model is a second way to the same answer: sessions solved with it, and its own files.

What is true of each machine is stated here; the tool's errors are worked out by Newton's method.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import root

import glidecal
from app.evaluating.diagnosis import adopt, diagnose_files
from app.evaluating.solution import SessionSolution, solve_files
from app.exports import as_csv
from app.report.offsets import offsets_from_files
from app.report.text.caveats import caveats
from app.report.text.diagnosis import diagnosis_text
from calib.arrays import FloatArray
from calib.tripod.controller import left_by_tables_mm
from calib.tripod.geometry import Geometry, direct
from calib.tripod.workspace import workspace_points
from protocols.effect_entries import EffectEntry, ParameterEntry
from protocols.journal import write_whole
from protocols.model_file import ModelFile, read_model_file
from tests.conftest import LONG

OFFSETS_MM = (0.4, -0.3, 0.2)
LENGTHS_MM = (0.03, -0.05, 0.02)
LEAN_MRAD = 2.0
JOINTS = ("d_rho_x", "d_rho_y", "d_rho_z")


def hidden(folder: Path, procedure: str, *effects: EffectEntry) -> Path:
    """A session of a machine with these offsets, lengths and effects."""
    values = (*OFFSETS_MM, *LENGTHS_MM)
    names = (*JOINTS, "d_L_x", "d_L_y", "d_L_z")
    file = ModelFile(parameters_mm=dict(zip(names, values, strict=True)), effects=effects)
    model = folder / "truth.json"
    model.write_text(file.text(), encoding="utf-8")
    return simulated(folder / "measured.jsonl", procedure, model, 7)


def simulated(path: Path, procedure: str, model: Path, seed: int) -> Path:
    session = glidecal.simulate(procedure, model=model, seed=seed)
    write_whole(path, session.opened, [*session.readings])
    return path


def entry(name: str, where: str, size: str, value: float, unit: str) -> EffectEntry:
    parameters = {size: ParameterEntry(value=value, unit=unit)}
    return EffectEntry(id=name, where=where, parameters=parameters)


def adopted(session: Path) -> Path:
    """The model of what the diagnosis names."""
    target = session.with_name("adopted.json")
    adopt(diagnose_files([session]), target, replace=True)
    return target


@pytest.fixture(scope="module")
def leaning(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Axis y alone leans towards x: no leg shows which of the two does."""
    lean = entry("axis_lean", "yx", "axis_lean", LEAN_MRAD, "mrad")
    return hidden(tmp_path_factory.mktemp("leaning"), "sweep", lean)


@pytest.fixture(scope="module")
def sagging(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The bar of leg z gives: offsets take over most of it."""
    sag = entry("gravity_sag", "z", "shortening", 0.4, "mm")
    return hidden(tmp_path_factory.mktemp("sagging"), "two-station", sag)


def left_mm(result: SessionSolution) -> float:
    """What the leaning machine is off by with the values entered, a shift free, r.m.s."""
    geometry = Geometry()
    along = np.eye(3)
    along[1] += [1e-3 * LEAN_MRAD, 0.0, 0.0]
    points, entered = workspace_points(geometry), np.array(result.correction.joint_offsets_mm)
    lengths = np.array(geometry.leg_length_mm) + np.array(LENGTHS_MM)
    off = []
    for tool in points:
        joints = joints_of(geometry, tool) - entered

        def closes(place: FloatArray, joints: FloatArray = joints) -> FloatArray:
            feet = (joints + np.array(OFFSETS_MM))[:, None] * along
            return np.asarray(np.linalg.norm(place - feet, axis=1) - lengths)

        off.append(root(closes, tool, tol=1e-12).x - tool)
    off_mm = np.array(off) - np.mean(off, axis=0)
    return float(np.sqrt((off_mm**2).sum(axis=1).mean()))


def joints_of(geometry: Geometry, tool: FloatArray) -> FloatArray:
    """Of the nominal machine."""

    def beside(joints: FloatArray) -> FloatArray:
        return np.asarray(direct(geometry, joints[None])[0] - tool)

    return np.asarray(root(beside, geometry.zero_mm + tool, tol=1e-12).x)


@LONG
def test_the_bound_with_an_adopted_lean_holds(leaning: Path) -> None:
    plain, known = solve_files([leaning]), solve_files([leaning], model=adopted(leaning))
    assert left_mm(known) < known.correction.bound_mm
    assert known.correction.bound_mm == pytest.approx(plain.correction.bound_mm, rel=0.02)
    # with a turn free nothing is hidden any more
    aligned = [result.correction.off.bound_in("aligned") for result in (plain, known)]
    assert aligned[1] == pytest.approx(aligned[0], rel=0.05)


@LONG
def test_the_model_is_what_the_posterior_expects(sagging: Path) -> None:
    path = adopted(sagging)
    model = read_model_file(path)
    result = solve_files([sagging], model=path)
    posterior = result.corrections.posterior
    stated = [model.parameters_mm[name] for name in JOINTS]
    # the same posterior about its own mean: a step of Gauss and Newton later
    assert stated == pytest.approx(posterior.mean[:3].tolist(), abs=0.01)
    (effect,) = model.effects
    (size,) = effect.parameters.values()
    assert size.standard_uncertainty is not None
    assert abs(size.value - 0.4) < 3.0 * size.standard_uncertainty
    diagnosed = diagnose_files([sagging], model=path)
    assert diagnosed.tool.entered_mm["offsets"] == result.correction.bound_mm


def written(paths: list[Path]) -> tuple[Mapping[str, float], str]:
    """Values and remarks of the file with joint offsets alone."""
    text = str(as_csv(offsets_from_files(paths, None, "exact")).files[""])
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    values = {row["parameter"]: float(row["value_mm"]) for row in csv.DictReader(lines)}
    return values, text


@LONG
def test_offsets_of_a_model_take_over_what_the_file_cannot_hold(sagging: Path) -> None:
    of_session, _ = written([sagging])
    of_model, text = written([adopted(sagging)])
    assert of_model.keys() == {*JOINTS}
    assert of_model == pytest.approx(of_session, abs=0.02)
    assert abs(of_model["d_rho_z"] - OFFSETS_MM[2]) > 0.4  # the machine's own leaves far more
    assert "not in these files: gravity_sag, leg lengths; joint offsets take over a part" in text
    bound_mm = solve_files([sagging]).correction.bound_mm
    leaves = float(text.partition("the rest leaves ")[2].split()[0])
    assert 0.5 * bound_mm < leaves < bound_mm


def test_a_table_of_a_short_wave_is_written_with_what_it_leaves(tmp_path: Path) -> None:
    waves = {
        name: ParameterEntry(value=value, unit="µm")
        for name, value in (("sine_5mm", 20.0), ("cosine_5mm", 0.0))
    }
    wave = EffectEntry(id="actuator_cyclic", where="x", parameters=waves)
    result = solve_files([hidden(tmp_path, "sweep", wave)], holds="tables")
    correction = result.correction
    assert any(effect.id == "actuator_cyclic" for effect in correction.model.effects)
    assert "table" not in " ".join(part.part for part in correction.left_out)
    # straight lines over 160 mm / 255 miss a sine of 20 µm by A (1 - cos(pi h / lead)) between
    between = 0.02 * (1.0 - np.cos(np.pi * 160.0 / 255.0 / 5.0))
    beside = left_by_tables_mm(correction.model)
    assert 0.4 * between < beside < between
    plain = replace(correction.off, beside_mm=0.0, _bounds_mm={})
    bounds = [off.bound_in("touched-off") for off in (correction.off, plain)]
    assert bounds[0] ** 2 - bounds[1] ** 2 == pytest.approx(beside**2, rel=1e-6)


@LONG
def test_the_frame_is_that_of_the_last_session(tmp_path: Path) -> None:
    truth = ModelFile(parameters_mm={"d_rho_x": 0.4})
    (tmp_path / "truth.json").write_text(truth.text(), encoding="utf-8")
    paths = []
    for number, frame in enumerate(("touched-off", "aligned")):
        session = glidecal.simulate("two-station", model=tmp_path / "truth.json", seed=number)
        machine = session.opened.machine.model_copy(update={"frame": frame})
        opened = session.opened.model_copy(update={"machine": machine})
        paths.append(tmp_path / f"{frame}.jsonl")
        write_whole(paths[-1], opened, [*session.readings])
    assert [diagnose_files([path]).tool.frame for path in paths] == ["touched-off", "aligned"]
    tool = diagnose_files(paths).tool
    assert tool.frame == "aligned"
    assert tool.now_mm == pytest.approx(diagnose_files(paths[1:]).tool.now_mm, rel=0.1)


@LONG
def test_offsets_that_changed_between_sessions_are_told(tmp_path: Path) -> None:
    paths = []
    for number, change_mm in enumerate((0.0, -1.2)):
        offsets = {"d_rho_x": 0.4 + change_mm, "d_rho_y": -0.3, "d_rho_z": 0.2}
        file = ModelFile(parameters_mm=offsets)
        model = tmp_path / f"{number}.json"
        model.write_text(file.text(), encoding="utf-8")
        path = tmp_path / f"{number}.jsonl"
        paths.append(simulated(path, "two-station", model, number + 1))
    (line,) = [line for line in caveats(solve_files(paths)) if "changed by" in line]
    assert "joint x changed by -1." in line
    assert "changed by" in diagnosis_text(diagnose_files(paths))
    again = simulated(tmp_path / "again.jsonl", "two-station", tmp_path / "0.json", 9)
    alike = [paths[0], again]
    assert not any("changed by" in line for line in caveats(solve_files(alike)))
