"""Readings of a leg over its travel, against machines whose readings are known without a fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.evaluating.solution import SessionSolution, solve_sessions
from app.measuring.simulated import planned_readings, simulated_session
from calib.tripod.curves import LegCurve
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.effects.gauges import GaugeHysteresis
from calib.tripod.pipeline import Model
from protocols.machine import load_machine
from protocols.procedure import load_procedure

MACHINE = load_machine(None)
OFFSETS = Model(MACHINE.geometry(), (0.5, -0.3, 0.2, 0.0, 0.0, 0.0))


def exact_session(procedure: str, truth: Model) -> SessionSolution:
    """A session without noise or a display."""
    planned = load_procedure(procedure, MACHINE.geometry())
    measured = simulated_session(planned, MACHINE, truth, seed=1, scatter_mm=0.0, resolution_mm=0.0)
    return solve_sessions([measured])


def of_leg(result: SessionSolution, leg: int, axis: int) -> LegCurve:
    (curve,) = [c for c in result.curves if (c.leg, c.axis) == (leg, axis)]
    return curve


def test_readings_count_from_zero_and_the_line_is_the_machine() -> None:
    """Offsets alone: readings are what the machine shows less what it shows at Zero."""
    result = exact_session("sweep", OFFSETS)
    planned = planned_readings(load_procedure("sweep", MACHINE.geometry()), MACHINE)
    readings = OFFSETS.readings(planned)
    assert len(result.curves) == 6
    for curve in result.curves:
        rows = (planned.leg == curve.leg) & (planned.axis == curve.axis)
        at_zero = readings[rows & planned.at_zero][0]
        assert curve.at_mm == pytest.approx(planned.displacement_mm[rows])
        assert curve.value_mm == pytest.approx(readings[rows] - at_zero, abs=2e-5)
        assert np.abs(curve.left_mm).max() < 2e-5
        (line,) = curve.model_mm
        on_line = np.interp(curve.at_mm, *line.T)
        assert on_line == pytest.approx(curve.value_mm, abs=2e-4), "its places are 3 mm apart"


def test_what_a_gauge_lags_is_the_split_of_the_directions() -> None:
    lag_um = 20.0
    lagging = EffectInstance(GaugeHysteresis(), "xy", (lag_um,))
    curve = of_leg(exact_session("sweep", replace(OFFSETS, effects=(lagging,))), 0, 1)
    assert sorted(set(curve.approach.tolist())) == [-1.0, 0.0, 1.0]
    assert curve.first.tolist() == [0]
    up, down = (curve.approach == side for side in (1.0, -1.0))
    common = set(curve.at_mm[up].tolist()) & set(curve.at_mm[down].tolist())
    assert len(common) == 4
    for at_mm in common:
        here = curve.at_mm == at_mm
        split_mm = curve.left_mm[here & up].mean() - curve.left_mm[here & down].mean()
        assert split_mm == pytest.approx(-1e-3 * lag_um, abs=1e-9)


def test_over_a_plane_places_lie_along_the_leg() -> None:
    """A line for each posture, through the fitted heights of its two places."""
    curves = exact_session("plane", OFFSETS).curves
    assert [(c.leg, c.axis, c.over_plane) for c in curves] == [(0, 2, True), (1, 2, True)]
    for curve in curves:
        assert len(curve.model_mm) == 3
        assert np.abs(curve.left_mm).max() < 2e-5
        length_mm = MACHINE.geometry().covered_mm[curve.leg]
        apart_mm = {round(float(np.ptp(line[:, 0])), 3) for line in curve.model_mm}
        assert all(0.75 * length_mm < mm <= 0.8 * length_mm for mm in apart_mm)
        fitted = np.vstack(curve.model_mm)
        for at_mm, residual in zip(curve.at_mm, curve.value_mm - curve.left_mm, strict=True):
            near = np.abs(fitted[:, 0] - at_mm) < 1e-6
            assert np.abs(fitted[near, 1] - residual).min() < 1e-9
