"""What the program corrects by itself today, as a person would have it: an answerer.

The table is imported. Where the diagnosis names mistakes in the readings they are corrected and the
record is diagnosed again. What it names of the machine is adopted, and the joints are those with
which the exported model stands where it was sent; where it names nothing, or the export of the
model is refused, the recommended set is entered. For `tests.blind.corrections`.
"""

from __future__ import annotations

import contextlib
import io
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from tests.blind.corrections import Answer
from tests.blind.corrections_page import OFFSETS

if TYPE_CHECKING:
    from app.evaluating.diagnosis import SessionDiagnosis
    from app.evaluating.solution import SessionSolution
    from calib.tripod.pipeline import Model
    from tests.blind.forward import FloatArray
    from tests.blind.tool import Commanded

INVERSION_ROUNDS = 12


def answers(table: str, resolution_mm: float | None) -> list[Answer]:
    """Joint offsets as exported, the recommended set, and the correction after a diagnosis.

    One bound at the tool is stated, in the machine's own frame: it bounds what a shift or a turn
    leaves, too. That of an adopted model is what ``solve --model`` states, else that of the page of
    the diagnosis.
    """
    from app.commands.sessions import import_table
    from app.evaluating.diagnosis import correct, diagnose_files, mistakes_of
    from app.evaluating.solution import solve_files

    with tempfile.TemporaryDirectory() as name, contextlib.redirect_stderr(io.StringIO()):
        written, session = Path(name, "table.csv"), Path(name, "session.jsonl")
        written.write_text(table, encoding="utf-8")
        import_table(written, session, machine=None, resolution=resolution_mm)
        diagnosed, mistakes = diagnose_files([session]), ""
        if found := mistakes_of(diagnosed):
            mistakes = ", ".join(f"{one.id}:{one.where}" for one in found)
            corrected = Path(name, "corrected.jsonl")
            correct(diagnosed, session, corrected)
            session, diagnosed = corrected, diagnose_files([corrected])
        solved = solve_files([session])
        exported = solved.for_controller()
        plain = [
            Answer(OFFSETS, _of(exported, lengths=False), _bounds(exported)),
            Answer("recommended", _of(solved), _bounds(solved), solved.solution.subset),
        ]
        verdict = f"{diagnosed.diagnosis.verdict} {mistakes}".strip()
        return [*plain, _adopted(diagnosed, session, plain[-1], verdict)]


def _adopted(diagnosed: SessionDiagnosis, session: Path, otherwise: Answer, verdict: str) -> Answer:
    """The named effects adopted; the other answer where nothing can be adopted."""
    from app.evaluating.diagnosis import SETS, adopt
    from app.evaluating.solution import solve_files
    from app.report.offsets import offsets_from_file
    from calib.errors import CalibrationError, NotIdentifiable, RecordError, UsageError

    target = session.with_name("model.json")
    try:
        written = adopt(diagnosed, target)
    except UsageError:
        return Answer("today", otherwise.commanded, otherwise.bounds, verdict)
    names = ", ".join(f"{effect.id}:{effect.where}" for effect in written.effects)
    try:
        exported = offsets_from_file(target, None, "exact")
    except RecordError:  # a model whose offsets nothing determined
        remark = f"{verdict}: {names}; export refused"
        return Answer("today", otherwise.commanded, otherwise.bounds, remark)
    bound = diagnosed.tool_bound
    bounds = {} if bound is None else dict.fromkeys(BOUNDED, bound.bound_mm)
    for subset in SETS:
        try:
            bounds = _bounds(solve_files([session], subset=subset, model=target))
        except (NotIdentifiable, CalibrationError):
            continue
        break
    return Answer("today", inverse_of(exported.model), bounds, f"{verdict}: {names}")


BOUNDED = ("machine", "touched_off", "aligned")


def _of(solved: SessionSolution, *, lengths: bool = True) -> Commanded:
    from calib.tripod.controller import commanded_with

    model = solved.solution.model
    parameters = [*model.parameters_mm[:3], *(mm * lengths for mm in model.parameters_mm[3:])]
    return lambda tool_mm, _: commanded_with(model.geometry, parameters)(tool_mm)


def _bounds(solved: SessionSolution) -> dict[str, float]:
    bounds = dict.fromkeys(BOUNDED, solved.bound_after.bound_mm)
    return {**bounds, "near": solved.near_after_mm}


def inverse_of(model: Model) -> Commanded:
    """The joints with which the tool of the program's own model is where it was sent."""
    from calib.tripod.geometry import inverse
    from calib.tripod.workspace import machine_at

    def commanded(tool_mm: FloatArray, way: float) -> FloatArray:
        nominal = joints = inverse(model.geometry, tool_mm)
        for _ in range(INVERSION_ROUNDS):
            reached = machine_at(model, joints, way).tool_mm
            joints = joints + nominal - inverse(model.geometry, reached)
        return joints

    return commanded
