"""What the program corrects by itself today, as a person would have it: an answerer.

The table is imported. Where the diagnosis names mistakes in the readings they are corrected in the
record. Then everything is entered that a controller can hold, offsets alone to own kinematics. For
`tests.blind.corrections`.
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
    from calib.tripod.pipeline import Model
    from tests.blind.forward import FloatArray
    from tests.blind.tool import Commanded

INVERSION_ROUNDS = 12

NAMES = {"offsets": OFFSETS, "kinematics": "today"}
"""Joint offsets as any controller holds them, and the most that the program exports."""


def answers(table: str, resolution_mm: float | None) -> list[Answer]:
    """What is exported for every controller, each with its bounds in all frames; touched off."""
    from app.commands.sessions import import_table
    from app.evaluating.diagnosis import correct, diagnose_files, mistakes_of
    from app.evaluating.solution import solve_files
    from calib.posterior.correction import HOLDS

    with tempfile.TemporaryDirectory() as name, contextlib.redirect_stderr(io.StringIO()):
        written, session = Path(name, "table.csv"), Path(name, "session.jsonl")
        written.write_text(table, encoding="utf-8")
        import_table(written, session, machine=None, resolution=resolution_mm)
        diagnosed, mistakes = diagnose_files([session]), ""
        if found := mistakes_of(diagnosed):
            mistakes = ", ".join(f"{one.id}:{one.where}" for one in found)
            corrected = Path(name, "corrected.jsonl")
            correct(diagnosed, session, corrected)
            session = corrected
        solved = solve_files([session])
    named = ", ".join(f"{one.id}:{one.where}" for one in diagnosed.diagnosis.effects)
    remark = f"{diagnosed.diagnosis.verdict} {mistakes or named}".strip()
    told = []
    for holds in HOLDS:
        made = solved.corrections.of(holds)
        bounds = {frame.replace("-", "_"): mm for frame, mm in made.off.bound_mm.items()}
        told.append(Answer(NAMES.get(holds, holds), inverse_of(made.model), bounds, remark))
    return told


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
