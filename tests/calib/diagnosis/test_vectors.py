"""Which way the tool is off: against the forward kinematics of the machine that was measured."""

from __future__ import annotations

import numpy as np
import pytest

from app.evaluating.solution import solve_sessions
from app.measuring.simulated import simulated_session
from calib.arrays import tool_conditions
from calib.diagnosis.vectors import vector_maps
from calib.tripod.pipeline import Flow, Model, command
from calib.tripod.workspace import PLANES
from protocols.machine import load_machine
from protocols.procedure import load_procedure


def test_arrows_are_the_way_from_where_the_tool_should_be() -> None:
    """Offsets alone, measured without noise; in the frame of the machine itself."""
    machine = load_machine(None)
    geometry = machine.geometry()
    truth = Model(geometry, (0.5, -0.3, 0.2, 0.0, 0.0, 0.0))
    procedure = load_procedure("sweep", geometry)
    session = simulated_session(
        procedure, machine, truth, seed=1, scatter_mm=0.0005, resolution_mm=0.0
    )
    correction = solve_sessions([session]).correction
    now = vector_maps(correction.off_now, "machine")
    entered = vector_maps(correction.off, "machine")
    for (across, up), before, after in zip(PLANES, now, entered, strict=True):
        maps = before.along_across, before.along_up
        rows, columns = np.nonzero(np.isfinite(before.length))
        places = np.zeros((len(rows), 3))
        places[:, across] = maps[0].coordinate_mm[columns]
        places[:, up] = maps[0].up_mm[rows]
        conditions = tool_conditions(places)
        stands = Flow(
            geometry, truth.parameters_mm, conditions, command(geometry, conditions)
        ).tool_mm
        off_mm = stands - places
        for part, axis in zip(maps, (across, up), strict=True):
            assert part.value[rows, columns] == pytest.approx(off_mm[:, axis], abs=0.02)
        assert before.length[rows, columns] == pytest.approx(
            np.linalg.norm(off_mm, axis=1), abs=0.02
        )
        assert np.nanmax(after.length) < 0.1 * np.nanmax(before.length)
