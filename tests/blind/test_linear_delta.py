"""The blind cell of the linear delta: effects hidden by a simulation of its own, then diagnosed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from app.commands.sessions import import_files
from app.evaluating.diagnosis import diagnose_files
from calib.diagnosis.results import Diagnosis
from tests.blind.linear_delta import Hidden, table
from tests.conftest import LONG

PLAIN = Hidden(offset_mm=(0.2, -0.15, 0.1), length_mm=(0.1, -0.05, 0.08))
HIDDEN = {
    "nothing": PLAIN,
    "actuator_scale": replace(PLAIN, scale=(0.004, 0.0, 0.0)),
    "backlash": replace(PLAIN, lost_mm=(0.0, 0.03, 0.0)),
    "thermal_drift": replace(PLAIN, drift_mm_s=3e-5),
    "axis_squareness": replace(PLAIN, lean_xy=0.003),
}
"""By the name that the program gives it."""


def diagnosed(folder: Path, hidden: Hidden, seed: int) -> Diagnosis:
    source, path = folder / "blind.csv", folder / "blind.jsonl"
    source.write_text(table(hidden, seed), encoding="utf-8")
    import_files([source], path, machine="linear-delta", resolution=0.001)
    return diagnose_files([path]).diagnosis


@LONG
@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("effect", list(HIDDEN))
def test_what_is_hidden_is_named_or_among_the_names(tmp_path: Path, effect: str, seed: int) -> None:
    """Never another name alone; nothing is called nothing."""
    diagnosis = diagnosed(tmp_path, HIDDEN[effect], seed)
    if effect == "nothing":
        assert diagnosis.verdict == "agrees"
        return
    names = [
        {cause.id, *(rival.id for rival in cause.indistinguishable_from)}
        for cause in diagnosis.effects
    ]
    assert names, f"nothing named: {diagnosis.verdict}"
    assert any(effect in names_possible for names_possible in names)
