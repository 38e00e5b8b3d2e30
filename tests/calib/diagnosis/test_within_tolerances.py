"""Parameters of geometry have a name beyond their tolerances, and none within."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app.evaluating.diagnosis import diagnose_sessions
from app.evaluating.solution import solve_sessions
from calib.diagnosis.claims import Claims
from calib.posterior.statements import AS_STATED
from protocols.machine import load_machine
from protocols.session import fold
from protocols.table import opened_table
from tests.blind.linear_delta import Hidden as Printer
from tests.blind.linear_delta import contacts
from tests.blind.tilted import SHAPES, Hidden, table
from tests.conftest import LONG, first_quick

TOLERANCES = "across_tolerance_mm = 0.2\nlean_tolerance_mrad = 1.0\nscale_tolerance_mm_m = 0.1\n"


@LONG
@pytest.mark.parametrize(
    ("lean_mrad", "verdict"), first_quick([(1.0, "agrees"), (8.0, "explained")], several=True)
)
def test_a_pair_of_drives_has_a_name_only_beyond_its_tolerance(
    tmp_path: Path, lean_mrad: float, verdict: str
) -> None:
    """Two drives may each lean by 1 mrad: both to each other by 1.4. A simulation of its own.

    A tenth of that is clearly seen; 1 mrad was EXPLAINED by a fault of the machine.
    """
    shape = SHAPES["star"]
    hidden = Hidden(np.zeros(3), np.zeros(3), "axis_squareness", (0, 1), 1e-3 * lean_mrad)
    machine_file, csv = tmp_path / "star.toml", tmp_path / "t.csv"
    text = shape.file.replace("[[drive]]", f"{TOLERANCES}[[drive]]", 1)
    machine_file.write_text(text, encoding="utf-8")
    csv.write_text(table(shape, hidden, np.random.default_rng(3), 0.002), encoding="utf-8")
    opened, events, _ = opened_table(csv, load_machine(machine_file), "test")
    diagnosis = diagnose_sessions([fold([opened, *events])]).diagnosis
    assert diagnosis.verdict == verdict
    names = {(effect.id, effect.where) for effect in diagnosis.effects}
    assert names == (set() if verdict == "agrees" else {("axis_squareness", "xy")})


@LONG
def test_bars_that_are_stated_in_the_likeliest_way_keep_their_name(tmp_path: Path) -> None:
    """Models of other ways stand beside it: there a bar is beyond the tolerance that it has."""
    csv = tmp_path / "t.csv"
    csv.write_text(contacts(Printer(length_mm=(3.0, 0.0, 0.0)), 3), encoding="utf-8")
    opened, events, _ = opened_table(csv, load_machine("linear-delta"), "test")
    posterior = solve_sessions([fold([opened, *events])]).corrections.posterior
    stated = [
        replace(cells, case=replace(cells.case, as_stated=AS_STATED[-1]))
        for cells in posterior.sessions
    ]
    claims = Claims.of(posterior)
    assert claims.ids["leg_length"] > 0.1
    assert Claims.of(replace(posterior, sessions=tuple(stated))).ids == claims.ids
