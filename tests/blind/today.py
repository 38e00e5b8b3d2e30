"""What the program corrects by itself today, as a person would have it: an answerer.

The table is imported, and what the program shows for each controller is entered, from joint offsets
to own kinematics. For `tests.blind.corrections`.
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

MOST_TOLD = 4
"""Probabilities of a remark."""


def answers(table: str, resolution_mm: float | None) -> list[Answer]:
    """What is exported for every controller, each with its bounds in all frames; touched off."""
    from app.commands.sessions import import_files
    from app.evaluating.solution import solve_files
    from calib.posterior.correction import HOLDS

    with tempfile.TemporaryDirectory() as name, contextlib.redirect_stderr(io.StringIO()):
        written, session = Path(name, "table.csv"), Path(name, "session.jsonl")
        written.write_text(table, encoding="utf-8")
        import_files([written], session, machine=None, resolution=resolution_mm)
        result = solve_files([session])
        posterior = result.corrections.posterior
    likely = [*posterior.mistakes.items(), *posterior.places.items()][:MOST_TOLD]
    remark = ", ".join(f"{id}:{where} {share:.2f}" for (id, where), share in likely)
    answered = []
    for holds in HOLDS:
        entry = result.corrections.of(holds)
        bounds = {frame.replace("-", "_"): mm for frame, mm in entry.off.bound_mm.items()}
        name = OFFSETS if holds == "offsets" else holds
        answered.append(Answer(name, inverse_of(entry.model), bounds, remark))
    return answered


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
