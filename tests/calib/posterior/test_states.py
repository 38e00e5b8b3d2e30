"""Sessions measured in one state of the machine share its joint offsets, but for homing."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import replace

import numpy as np
import pytest

from calib.arrays import FloatArray, Observations, observe
from calib.noise.reading import IndicatorFigures
from calib.posterior.cells import HOMING_MM, SessionCase
from calib.posterior.correction import correction
from calib.posterior.models import Posterior
from calib.posterior.posterior import posterior
from calib.posterior.readings import LENGTHS
from calib.posterior.tool import mean_square
from calib.tripod.pipeline import Model, measure
from tests.calib.posterior.hidden_machines import SWEEP, TOLERANCE_MM, TWO_STATION
from tests.conftest import LONG

LEG_X = TWO_STATION.take(np.flatnonzero((TWO_STATION.leg == 0) & (TWO_STATION.axis == 1)))
OFFSETS_MM, LENGTH_ERRORS_MM = np.array([0.41, -0.32, 0.2]), (0.02, -0.03, 0.01)
HOMED_MM = np.array([0.006, -0.004, 0.005])
"""What homing changed between two sessions."""


def read(
    conditions: Observations,
    change_mm: FloatArray | float,
    seed: int,
    state: Hashable = "as built",
    bars_mm: FloatArray | float = 0.0,
) -> SessionCase:
    """What was read with joint offsets and bars that differ by so much ``(3,)``."""
    lengths_mm = np.array(LENGTH_ERRORS_MM) + bars_mm
    parameters = (*(OFFSETS_MM + change_mm).tolist(), *lengths_mm.tolist())
    machine = Model(parameters_mm=parameters)
    value = measure(machine, conditions, scatter_mm=0.001, resolution_mm=0.0, generator=seed)
    observations = observe(conditions, value)
    return SessionCase(Model(), observations, IndicatorFigures(), TOLERANCE_MM, state=state)


def change_of(result: Posterior) -> tuple[FloatArray, FloatArray]:
    """Offsets of the second session less those of the first ``(3,)``, and their deviations, mm.

    Of the models by which one state's offsets were shared, or not: the likelier ones.
    """
    into = np.zeros((3, len(result.models[0].base)))
    into[:, LENGTHS : LENGTHS + 3] = -np.eye(3)
    into[:, LENGTHS + 3 : LENGTHS + 6] = np.eye(3)
    best = result.models[0]
    count = into.shape[1]
    change = into @ best.mean[:count]
    return change, np.sqrt(np.diag(into @ best.covariance[:count, :count] @ into.T))


@pytest.fixture(scope="module")
def sessions() -> list[SessionCase]:
    """The whole machine, then one leg along one direction after it was homed again."""
    return [read(SWEEP, 0.0, 1), read(LEG_X, HOMED_MM, 2)]


@LONG
def test_a_leg_read_again_leaves_the_machine_known(sessions: list[SessionCase]) -> None:
    together = posterior(sessions)
    change, deviation = change_of(together)
    assert np.all(np.abs(change - HOMED_MM) < 3.0 * deviation)
    assert np.all(deviation < 1.01 * HOMING_MM)
    assert deviation[1] < 0.5 * HOMING_MM  # leg x read along y shows it
    alone = posterior([replace(case, state=None) for case in sessions])
    shared_mm, own_mm = (
        correction(result, "offsets").off.bound_mm["touched-off"] for result in (together, alone)
    )
    assert shared_mm < 0.01
    assert own_mm > 0.5


@LONG
def test_offsets_that_changed_all_the_same_are_each_sessions_own() -> None:
    changed = np.array([0.3, 0.0, -0.1])
    change, deviation = change_of(posterior([read(SWEEP, 0.0, 1), read(TWO_STATION, changed, 2)]))
    assert np.all(np.abs(change - changed) < 3.0 * deviation)
    assert np.all(deviation < 0.003)


def test_what_was_entered_in_between_is_known(sessions: list[SessionCase]) -> None:
    entered_mm = np.array([5.0, 0.0, -0.4])
    after = replace(read(LEG_X, HOMED_MM - entered_mm, 2), entered_mm=(5.0, 0.0, -0.4))
    change, deviation = change_of(posterior([sessions[0], after]))
    assert np.all(np.abs(change - HOMED_MM + entered_mm) < 3.0 * deviation)
    assert np.all(deviation < 1.01 * HOMING_MM)


def test_sessions_of_other_states_do_not_share(sessions: list[SessionCase]) -> None:
    moved = [sessions[0], replace(sessions[1], state="after a crash")]
    apart = [replace(case, state=None) for case in sessions]
    for states, none in zip(
        *(change_of(posterior(cases)) for cases in (moved, apart)), strict=True
    ):
        assert np.array_equal(states, none)


@LONG
def test_the_tool_has_the_bars_of_the_last_session() -> None:
    """A bar was exchanged: the machine as it is now has the new one, whichever came first."""
    longer = np.array([0.0, 1.0, 0.0])
    for before, now in ((0.0, longer), (longer, 0.0)):
        cases = [read(TWO_STATION, 0.0, k, bars_mm=bars) for k, bars in enumerate((before, now))]
        together = posterior(cases)
        true_mm = np.zeros(len(together.mean))
        true_mm[:6] = [*OFFSETS_MM, *(np.array(LENGTH_ERRORS_MM) + now)]
        metric = together.field.metrics["touched-off"]
        assert mean_square(metric, together.mean - true_mm) < 0.02**2
        assert correction(together, "kinematics").off.bound_mm["touched-off"] < 0.05
