"""Telescopic legs: kinematics, derivatives and a calibration beside computations of their own.

What is compared with is `telescopic_draws`, written from the definition of the machine alone.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.errors import CalibrationError, ImpossibleRequest
from calib.hexaslide.calibration import calibrate
from calib.hexaslide.checked import frames_apart
from calib.hexaslide.derivatives import RowMaker, jacobian, joint_angles
from calib.hexaslide.geometry import forward, inverse, with_values
from calib.hexaslide.planning import fewest_postures, reachable
from calib.hexaslide.platform import platform_error
from calib.hexaslide.procedures import Procedure
from calib.hexaslide.residuals import Readings
from tests.blind.hexaslide import diagnosed
from tests.blind.telescopic import scored
from tests.calib.hexaslide.telescopic_draws import (
    FILE,
    MACHINE,
    NOISE_M,
    NOISE_RAD,
    PLAIN,
    Plain,
    some,
)
from tests.conftest import LONG


def test_the_drives_read_what_the_definition_says() -> None:
    postures = some(200, 1)
    expected = np.array([PLAIN.reads(posture) for posture in postures])
    assert inverse(MACHINE.geometry, postures) == pytest.approx(expected, abs=1e-14)
    assert forward(MACHINE.geometry, expected, MACHINE.box) == pytest.approx(postures, abs=1e-11)


@LONG
@pytest.mark.parametrize("kind", ["pose-inverse", "pose-forward"])
def test_derivatives_are_those_of_differences(kind: str) -> None:
    """Central differences of the definition, forward ones through scipy's solution."""
    postures, step = some(3, 2), 1e-6
    procedure = Procedure.of(kind).on(MACHINE)
    assert len(procedure.parameters) == 37
    slopes_by_row = jacobian(procedure, MACHINE.geometry, postures)
    for column, name in enumerate(procedure.parameters):
        ends = [PLAIN.with_value(name, way * step) for way in (1.0, -1.0)]
        for row, posture in enumerate(postures):
            if kind == "pose-inverse":
                up, down = (end.reads(posture) for end in ends)
            else:
                drives = PLAIN.reads(posture)
                up, down = (end.stands(drives, posture) for end in ends)
            slope = (up - down) / (2.0 * step)
            assert slopes_by_row[row, :, column] == pytest.approx(slope, abs=2e-7), name


@pytest.mark.parametrize("kind", ["pose-inverse", "pose-forward", "position", "constraint-link"])
def test_the_pull_is_that_of_complex_steps(kind: str) -> None:
    procedure, postures = Procedure.of(kind).on(MACHINE), some(4, 3)
    maker = RowMaker(procedure, MACHINE.geometry, MACHINE.link, np.eye(len(procedure.parameters)))
    rows, pull = maker(postures)
    weights = np.random.default_rng(4).normal(size=rows.shape)
    steps = (postures + 1e-30j * unit for unit in np.eye(6))
    slopes = [(weights * maker(moved)[0].imag).sum(axis=(1, 2)) / 1e-30 for moved in steps]
    product = pull(weights)
    assert product == pytest.approx(np.stack(slopes, axis=-1), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(
    ("kind", "rank", "count", "fewest"),
    [
        # 6 legs of 7 less the 5 of the base frame; 6 rows a posture, so 7 of them
        ("pose-inverse", 37, 37, 7),
        ("pose-forward", 37, 37, 7),
        # less three turns of the platform's frame; 3 rows
        ("position", 34, 37, 12),
        # 6 more of the link, less six of the platform's frame and one of the base; 1 row
        ("constraint-link", 36, 43, 36),
    ],
)
def test_what_can_be_identified(kind: str, rank: int, count: int, fewest: int) -> None:
    procedure = Procedure.of(kind).on(MACHINE)
    analysis = reachable(procedure, MACHINE)
    assert (analysis.rank, len(analysis.names)) == (rank, count)
    assert fewest_postures(procedure, MACHINE) == fewest


def readings(truth: Plain, count: int, chance: np.random.Generator, noise: float) -> Readings:
    """Whole postures of a machine whose controller holds the file."""
    procedure = Procedure.of("pose-forward").on(MACHINE)
    drives = np.array([PLAIN.reads(posture) for posture in some(count, 5)])
    stood = [truth.stands(*pair) for pair in zip(drives, some(count, 5), strict=True)]
    errors = noise * np.array([NOISE_M] * 3 + [NOISE_RAD] * 3) * chance.normal(size=(count, 6))
    return Readings(procedure, drives, np.array(stood) + errors, NOISE_M, NOISE_RAD)


def test_a_hidden_machine_comes_back_without_noise() -> None:
    chance = np.random.default_rng(6)
    truth = PLAIN.off(chance)
    calibration = calibrate(readings(truth, 20, chance, 0.0), MACHINE)
    geometry = calibration.machine.geometry
    assert geometry.base == pytest.approx(truth.base, abs=1e-10)
    assert geometry.platform == pytest.approx(truth.joint, abs=1e-10)
    assert geometry.links == pytest.approx(truth.zero, abs=1e-10)
    assert (calibration.rank, calibration.unidentifiable) == (37, ())


@LONG
def test_parameters_lie_in_their_intervals_and_the_bound_holds() -> None:
    """Of 20 hidden machines: 95 % of 740 parameters, give or take four standard deviations."""
    within, within_bound = 0, 0
    for seed in range(20):
        chance = np.random.default_rng(100 + seed)
        truth = PLAIN.off(chance)
        calibration = calibrate(readings(truth, 20, chance, 1.0), MACHINE)
        assert calibration.covariance is not None
        deviation = np.sqrt(calibration.covariance.diagonal())
        values = [
            (truth.joint, truth.base, truth.zero)["BAl".index(name[0])][
                (int(name[-1]) - 1, "xyz".index(name[1])) if name[0] != "l" else int(name[-1]) - 1
            ]
            for name in calibration.names
        ]
        within += int((np.abs(calibration.parameters - values) <= 1.96 * deviation).sum())
        bound_m = platform_error(MACHINE, calibration).bound_m
        assert bound_m is not None
        fresh = some(60, 900 + seed)
        drives = np.asarray(inverse(calibration.machine.geometry, fresh))
        stood = np.array([truth.stands(*pair) for pair in zip(drives, fresh, strict=True)])
        within_bound += frames_apart(fresh, stood, calibration.laid_over).places_rms_m <= bound_m
    assert abs(within - 0.95 * 740) <= 4.0 * np.sqrt(740 * 0.95 * 0.05)
    assert within_bound >= 17, "a binomial of 20 and 95 % is below 17 once in 60 times"


def test_a_leg_with_a_wrong_scale_is_named() -> None:
    chance = np.random.default_rng(7)
    right = readings(PLAIN.off(chance), 24, chance, 1.0)
    drives = right.sliders.copy()
    drives[:, 2] -= 0.001 * (drives[:, 2] - drives[:, 2].mean())
    tolerances = FILE.tolerances.of(right.procedure.parameters)
    assert diagnosed(right, MACHINE, tolerances).verdict == "agrees"
    diagnosis = diagnosed(replace(right, sliders=drives), MACHINE, tolerances)
    assert [claim.causes for claim in diagnosis.named] == [(("leg_scale", "leg 3"),)]
    assert diagnosis.sizes[0].value == pytest.approx(
        1.0, abs=4.0 * diagnosis.sizes[0].standard_uncertainty + 0.01
    )


def test_what_needs_rails_is_refused() -> None:
    with pytest.raises(ImpossibleRequest, match="turn1 of telescopic legs"):
        Procedure.of("pose-forward", ("x", "turn1")).on(MACHINE)
    with pytest.raises(CalibrationError, match="telescopic legs"):
        joint_angles(MACHINE.geometry, some(1, 8))


def test_a_drive_may_read_the_whole_length_of_its_leg() -> None:
    """Then its length at 0 is none, and a calibration may find a little less than none."""
    geometry = replace(MACHINE.geometry, links=np.zeros(6))
    postures = some(20, 9)
    expected = np.array([PLAIN.reads(posture) for posture in postures]) + PLAIN.zero
    assert inverse(geometry, postures) == pytest.approx(expected, abs=1e-14)
    parameters = np.zeros(49)
    machine = replace(MACHINE, geometry=geometry)
    moved = machine.with_parameters(("l1",), np.array([-3e-4]))
    assert moved.geometry.links[0] == -3e-4
    assert moved.geometry.telescopic
    with pytest.raises(CalibrationError, match="the first leg at"):  # all starts at one point
        with_values(geometry, parameters)


@LONG
def test_the_blind_bench_names_nothing_wrong() -> None:
    """The first of its machines; a wrong name, or one on nothing, is a defect."""
    score = scored("pose-forward", 24, 12)
    assert (score.wrong, score.on_nothing) == (0, 0)
    assert score.in_set >= 11
    assert 0 < score.named <= score.hidden < 12
