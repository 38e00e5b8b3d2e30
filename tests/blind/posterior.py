"""What the posterior says to enter: an answerer for `tests.blind.corrections`."""

from __future__ import annotations

import contextlib
import io
import tempfile
from pathlib import Path

from tests.blind.corrections import Answer
from tests.blind.corrections_page import OFFSETS
from tests.blind.today import inverse_of


def answers(table: str, resolution_mm: float | None) -> list[Answer]:
    """Of everything that a controller may hold, each with its bounds; touched off."""
    from app.commands.sessions import import_table
    from app.evaluating.diagnosis import cases
    from app.evaluating.solution import load_sessions
    from calib.posterior.cells import Case
    from calib.posterior.correction import HOLDS, correction
    from calib.posterior.posterior import posterior
    from calib.tripod.pipeline import Model

    with tempfile.TemporaryDirectory() as name, contextlib.redirect_stderr(io.StringIO()):
        written, session = Path(name, "table.csv"), Path(name, "session.jsonl")
        written.write_text(table, encoding="utf-8")
        import_table(written, session, machine=None, resolution=resolution_mm)
        sessions, _ = load_sessions([session])
    (one,) = cases(sessions, Model(sessions[0].opened.machine.geometry()))
    case = Case(one.model, one.observed, one.indicator, one.tolerance_mm)
    told = posterior([case])
    found = []
    names = ", ".join(f"{i}:{w} {p:.2f}" for (i, w), p in list(told.places.items())[:4])
    for holds in HOLDS:
        entered = correction(told, holds)
        bounds = {frame.replace("-", "_"): entered.bound_mm[frame] for frame in entered.bound_mm}
        name = OFFSETS if holds == "offsets" else holds
        found.append(Answer(name, inverse_of(entered.model), bounds, names))
    return found
