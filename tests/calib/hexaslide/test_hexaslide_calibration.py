"""Calibrations of simulated Hexa Slides: exact without noise, honest with it."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation

from calib.arrays import FloatArray
from calib.errors import CalibrationError, NotIdentifiable, UnreachablePosture
from calib.hexaslide import procedures
from calib.hexaslide.calibration import Calibration, calibrate
from calib.hexaslide.checked import check_postures, frames_apart, inner_lengths, length_slopes
from calib.hexaslide.derivatives import jacobian, joint_angles
from calib.hexaslide.geometry import (
    ENCODERS,
    NAMES,
    Box,
    HexaSlide,
    forward,
    inverse,
    rotation,
    values,
    with_values,
)
from calib.hexaslide.procedures import Procedure, held_postures, looseness
from calib.hexaslide.residuals import (
    Readings,
    postures_of,
    residuals,
    shares,
    stretch,
    whitening,
)
from calib.hexaslide.simulation import SimulatedHexaSlide, disturbed, measure, on_link
from calib.stats import coverage_factor
from tests.calib.hexaslide.test_hexaslide import H60, random_machine
from tests.conftest import LONG

NOMINAL = HexaSlide(H60.geometry, H60.box, H60.link)
NOISE_M, NOISE_RAD = 1e-5, 2e-5
MACHINES = [NOMINAL] + [
    HexaSlide(example.geometry, example.box, example.link)
    for example in (random_machine(1), random_machine(2))
]


def calibrated(
    kind: str,
    count: int,
    seed: int,
    nominal: HexaSlide = NOMINAL,
    noise: tuple[float, float] = (0.0, 0.0),
) -> tuple[Calibration, HexaSlide, Readings]:
    """Result, true machine with errors of 1 mm, and what was measured on it."""
    generator = np.random.default_rng(seed)
    truth = disturbed(nominal, Procedure.of(kind), 1e-3, generator)
    readings = measure(
        Procedure.of(kind),
        nominal,
        truth,
        count,
        generator,
        length_noise_m=noise[0],
        angle_noise_rad=noise[1],
    )
    return calibrate(readings, nominal), truth, readings


def stand(machine: HexaSlide, sliders: FloatArray) -> FloatArray:
    return np.asarray(forward(machine.geometry, sliders, machine.box))


def elsewhere(truth: HexaSlide, count: int = 100) -> FloatArray:
    """Sliders ``(count, 6)`` of postures that no calibration here has used."""
    procedure, generator = Procedure.of("position"), np.random.default_rng(987)
    return measure(procedure, truth, truth, count, generator).sliders


@pytest.mark.parametrize("machine", MACHINES, ids=["H60", "other 1", "other 2"])
@pytest.mark.parametrize(("kind", "count"), [("pose-inverse", 12), ("pose-forward", 12)])
def test_whole_postures_without_noise_give_every_parameter(
    kind: str, count: int, machine: HexaSlide
) -> None:
    calibration, truth, _ = calibrated(kind, count, 1, machine)
    assert (calibration.rank, calibration.unidentifiable, calibration.steps <= 12) == (49, (), True)
    assert calibration.parameters == pytest.approx(truth.parameters(calibration.names), abs=1e-11)
    assert calibration.known == calibration.names


@pytest.mark.parametrize("machine", MACHINES, ids=["H60", "other 1", "other 2"])
def test_positions_without_noise_give_positions_and_one_constant_turn(machine: HexaSlide) -> None:
    calibration, truth, _ = calibrated("position", 24, 2, machine)
    assert (calibration.rank, calibration.unidentifiable_count, len(calibration.known)) == (
        46,
        3,
        31,
    )
    assert calibration.unidentifiable == tuple(
        f"platform frame turned about its {axis}" for axis in "XYZ"
    )
    sliders = elsewhere(truth)
    computed, true = stand(calibration.machine, sliders), stand(truth, sliders)
    assert np.abs(computed[:, :3] - true[:, :3]).max() < 1e-11
    turns = np.swapaxes(rotation(true[:, 3:]), 1, 2) @ rotation(computed[:, 3:])
    assert np.abs(turns - turns[0]).max() < 1e-11  # the same at every posture, and not nothing
    assert np.abs(turns[0] - np.eye(3)).max() > 1e-4
    apart = frames_apart(computed, true, calibration.unidentifiable)
    size = np.arccos((np.trace(turns[0]) - 1.0) / 2.0)
    assert apart.turned_rad == pytest.approx(size, rel=1e-6)
    assert apart.angles_rad.max() < 1e-11
    before = frames_apart(stand(machine, sliders), true, ())
    assert before.places_m.max() > 1e-3


@pytest.mark.parametrize("machine", MACHINES, ids=["H60", "other 1", "other 2"])
def test_a_constraint_link_without_noise_gives_all_that_no_frame_changes(
    machine: HexaSlide,
) -> None:
    calibration, truth, readings = calibrated("constraint-link", 60, 3, machine)
    assert (
        calibration.rank,
        calibration.unidentifiable_count,
        len(calibration.unidentifiable),
    ) == (48, 7, 7)
    assert calibration.steps <= 12
    solution_geometry, true = calibration.machine.geometry, truth.geometry
    for i in range(6):
        for j in range(i):
            between = [
                np.linalg.norm(geometry.platform[i] - geometry.platform[j])
                for geometry in (solution_geometry, true)
            ]
            assert between[0] == pytest.approx(between[1], abs=1e-9)
        start = [np.linalg.norm(geometry.base[i]) for geometry in (solution_geometry, true)]
        assert start[0] == pytest.approx(start[1], abs=1e-9)
    assert solution_geometry.links == pytest.approx(true.links, abs=1e-9)
    assert np.abs(inner_lengths(NOMINAL.geometry) - inner_lengths(true)).max() > 1e-4
    apart = frames_apart(
        stand(calibration.machine, readings.sliders),
        stand(truth, readings.sliders),
        calibration.unidentifiable,
    )
    assert apart.places_m.max() < 1e-9
    assert apart.shifted_m > 1e-5


def test_the_true_machine_keeps_the_length_of_its_link() -> None:
    _, truth, readings = calibrated("constraint-link", 60, 5)
    assert readings.measured.shape == (60, 0)
    assert np.abs(stretch(truth.link, stand(truth, readings.sliders))).max() < 1e-12
    assert np.abs(stretch(NOMINAL.link, stand(NOMINAL, readings.sliders))).max() > 1e-4
    play = calibrated("constraint-link", 60, 5, noise=(1e-4, 1e-4))
    residual = stretch(play[1].link, stand(play[1], play[2].sliders))
    assert residual.std() == pytest.approx(1e-4, rel=0.3)


def test_what_is_not_seen_stays_where_the_start_has_it() -> None:
    for kind, count in (("position", 24), ("constraint-link", 80)):
        calibration, truth, _ = calibrated(kind, count, 4)
        moved = calibration.parameters - NOMINAL.parameters(calibration.names)
        true = truth.parameters(calibration.names) - NOMINAL.parameters(calibration.names)
        assert np.linalg.norm(calibration.null.T @ moved) < 0.02 * np.linalg.norm(
            calibration.null.T @ true
        )


@pytest.mark.parametrize(
    ("kind", "measured"),
    [
        ("pose-inverse", ()),
        ("pose-forward", ()),
        ("position", ()),
        ("constraint-link", ()),
        ("constraint-link", ("theta", "psi")),
        ("pose-forward", ENCODERS),
        ("constraint-link", ("swing6", "x", "turn3")),
    ],
)
def test_derivatives_are_those_of_what_is_left(kind: str, measured: tuple[str, ...]) -> None:
    """Central differences of the residuals themselves, independent of the implicit functions."""
    procedure = Procedure.of(kind, measured)
    readings = measure(procedure, NOMINAL, NOMINAL, 3, np.random.default_rng(6))
    names, nominal = procedure.parameters, NOMINAL.parameters(procedure.parameters)
    at = readings.measured if kind == "pose-inverse" else stand(NOMINAL, readings.sliders)
    slopes = residuals(readings, NOMINAL, at)[1]
    step = 1e-6
    for k in range(0, len(names), 4):
        ends = []
        for sign in (1.0, -1.0):
            moved = NOMINAL.with_parameters(names, nominal + sign * step * np.eye(len(nominal))[k])
            ends.append(residuals(readings, moved, postures_of(readings, moved))[0].values)
        difference = (ends[0] - ends[1]) / (2.0 * step)
        assert -difference == pytest.approx(slopes[:, :, k], abs=1e-7)


def test_joint_angles_are_those_of_rotated_links() -> None:
    """Each link once more as its rail turned by scipy: swung out, then turned about the rail."""
    machine = random_machine(7)
    postures = machine.box.random(4, np.random.default_rng(1))
    angles, geometry = joint_angles(machine.geometry, postures), machine.geometry
    sliders = inverse(geometry, postures)
    for p, posture in enumerate(postures):
        turn = Rotation.from_euler("YXZ", posture[3:])
        ends = posture[:3] + turn.apply(geometry.platform)
        for k, rail in enumerate(geometry.rails):
            up = np.array([0.0, 0.0, np.sign(rail[2])])
            axis = np.cross(up, rail)
            angle = np.arctan2(np.linalg.norm(axis), up @ rail)
            carry = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis))
            first = carry.apply([1.0, 0.0, 0.0])
            out = Rotation.from_rotvec(angles[p, 2 * k] * rail).apply(first)
            swing = angles[p, 2 * k + 1]
            link = geometry.links[k] * (np.cos(swing) * rail + np.sin(swing) * out)
            carriage = geometry.base[k] + sliders[p, k] * rail
            assert carriage + link == pytest.approx(ends[k], abs=1e-12)


@pytest.mark.parametrize(
    ("kind", "measured", "rank", "count"),
    [
        ("constraint-link", ("theta", "psi"), 51, 30),
        ("constraint-link", ("theta", "psi", "swing1", "swing3", "swing5"), 54, 24),
        ("pose-forward", ENCODERS, 54, 16),
    ],
)
def test_tilts_and_encoders_without_noise_give_all_that_no_frame_changes(
    kind: str, measured: tuple[str, ...], rank: int, count: int
) -> None:
    procedure, generator = Procedure.of(kind, measured), np.random.default_rng(2)
    truth = disturbed(NOMINAL, procedure, 1e-3, generator)
    calibration = calibrate(measure(procedure, NOMINAL, truth, count, generator), NOMINAL)
    assert (calibration.rank, calibration.unidentifiable_count) == (
        rank,
        len(calibration.names) - rank,
    )
    assert len(calibration.unidentifiable) == calibration.unidentifiable_count
    lengths = inner_lengths(calibration.machine.geometry) - inner_lengths(truth.geometry)
    assert np.abs(lengths).max() < 1e-9
    zeros = (calibration.machine.zeros_rad - truth.zeros_rad)[1::2]  # swings have no frame
    assert np.abs(zeros).max() < 1e-9


@LONG
@pytest.mark.parametrize(
    ("kind", "count", "sessions"),
    [("pose-inverse", 20, 240), ("position", 30, 150), ("constraint-link", 60, 120)],
)
def test_intervals_of_individually_known_parameters_hold_the_truth(
    kind: str, count: int, sessions: int
) -> None:
    coverage: list[float] = []
    for seed in range(sessions):
        calibration, truth, _ = calibrated(kind, count, seed, noise=(NOISE_M, NOISE_RAD))
        assert calibration.covariance is not None
        columns = [calibration.names.index(name) for name in calibration.known]
        error = (calibration.parameters - truth.parameters(calibration.names))[columns]
        u = np.sqrt(calibration.covariance.diagonal())[columns]
        coverage.append(float((np.abs(error) <= coverage_factor(np.inf) * u).mean()))
    assert np.mean(coverage) == pytest.approx(0.95, abs=0.02)


def test_uncertainty_from_what_is_left_where_no_noise_is_stated() -> None:
    stated, _, readings = calibrated("pose-forward", 40, 8, noise=(NOISE_M, NOISE_M))
    silent = calibrate(replace(readings, length_noise_m=0.0, angle_noise_rad=0.0), NOMINAL)
    assert stated.degrees_of_freedom == np.inf
    assert (silent.degrees_of_freedom, silent.free_values) == (6 * 40 - 49, 6 * 40 - 49)
    assert silent.noise_m == pytest.approx(NOISE_M, rel=0.15)
    assert silent.parameters == pytest.approx(stated.parameters, abs=1e-9)
    few = calibrated("constraint-link", 48, 9)[0]
    assert (few.covariance, few.noise_m, few.free_values) == (None, None, 0)


def test_pose_inverse_counts_the_noise_of_the_posture_not_of_the_sliders() -> None:
    """Weighted by what the posture's noise does to the sliders it is pose-forward, nearly."""
    inverse, _, readings = calibrated("pose-inverse", 20, 10, noise=(NOISE_M, NOISE_RAD))
    forward_readings = replace(readings, procedure=Procedure.of("pose-forward"))
    ahead = calibrate(forward_readings, NOMINAL)
    assert inverse.covariance is not None
    assert ahead.covariance is not None
    u = np.sqrt(ahead.covariance.diagonal())
    assert np.sqrt(inverse.covariance.diagonal()) == pytest.approx(u, rel=0.02)
    assert np.abs(inverse.parameters - ahead.parameters).max() < 0.2 * u.max()


def test_weights_make_residuals_independent_and_equal() -> None:
    _, truth, readings = calibrated("pose-inverse", 400, 11, noise=(NOISE_M, NOISE_RAD))
    white = whitening(readings, truth.geometry)
    residual = residuals(readings, truth, postures_of(readings, truth))[0].values
    plain = np.einsum("prs,ps->pr", white, residual) / NOISE_M
    assert np.cov(plain.T) == pytest.approx(np.eye(6), abs=0.2)


def test_shares_of_what_is_left_point_at_a_wrong_reading() -> None:
    generator = np.random.default_rng(12)
    readings = measure(
        Procedure.of("position"), NOMINAL, NOMINAL, 60, generator, length_noise_m=NOISE_M
    )
    readings.measured[17, 2] += 50 * NOISE_M
    calibration = calibrate(readings, NOMINAL)
    by_column, by_posture = shares(readings, calibration.machine.geometry, calibration.after)
    assert (int(by_column.argmax()), int(by_posture.argmax())) == (2, 17)
    assert by_column.sum() == pytest.approx(1.0)
    assert by_posture.sum() == pytest.approx(1.0)
    assert calibration.square_sum is not None
    assert calibration.square_sum / calibration.free_values > 2.0


def test_inner_lengths_do_not_move_with_frames() -> None:
    slopes = length_slopes(NOMINAL.geometry, NAMES)
    for kind, count in (("position", 24), ("constraint-link", 80)):
        calibration, _, _ = calibrated(kind, count, 13)
        inner = length_slopes(calibration.machine.geometry, NAMES)
        assert np.abs(inner @ calibration.null[:49]).max() < 1e-9
    base, step = values(NOMINAL.geometry), 1e-6
    for k in range(0, 49, 5):
        unit = step * np.eye(49)[k]
        ends = [inner_lengths(with_values(NOMINAL.geometry, base + s * unit)) for s in (1, -1)]
        assert (ends[0] - ends[1]) / (2.0 * step) == pytest.approx(slopes[:, k], abs=1e-8)


def test_condition_number_is_that_of_the_bare_derivatives() -> None:
    calibration, _, readings = calibrated("position", 30, 14)
    at = stand(calibration.machine, readings.sliders)
    bare = jacobian(readings.procedure, calibration.machine.geometry, at).reshape(-1, 49)
    singular = np.linalg.svd(bare, compute_uv=False)
    assert calibration.condition_number == pytest.approx(singular[0] / singular[45], rel=1e-8)


def test_too_few_postures_say_how_many_are_needed() -> None:
    readings = measure(Procedure.of("position"), NOMINAL, NOMINAL, 15, np.random.default_rng(0))
    with pytest.raises(NotIdentifiable, match=r"found 15\. Allowed: 16 or more"):
        calibrate(readings, NOMINAL, fewest=16)


def test_readings_of_another_machine_do_not_settle() -> None:
    readings = measure(Procedure.of("position"), NOMINAL, NOMINAL, 30, np.random.default_rng(0))
    mirrored = replace(readings, measured=readings.measured[::-1] * [1.0, -1.0, 1.0])
    with pytest.raises(NotIdentifiable, match=r"no rest after 12 steps|no step that improves"):
        calibrate(mirrored, NOMINAL)


def test_a_posture_that_cannot_be_is_named_by_its_number() -> None:
    for kind in ("pose-inverse", "position"):
        readings = measure(Procedure.of(kind), NOMINAL, NOMINAL, 20, np.random.default_rng(0))
        if kind == "position":
            readings.sliders[6, 0] += 2.0
        else:
            readings.measured[6, 0] += 2.0
        with pytest.raises(UnreachablePosture, match="posture 7"):
            calibrate(readings, NOMINAL)


def test_readings_of_a_wrong_shape_or_value_are_refused() -> None:
    procedure = Procedure.of("position")
    with pytest.raises(CalibrationError, match="six sliders and 3 values"):
        Readings(procedure, np.zeros((4, 5)), np.zeros((4, 3)))
    with pytest.raises(CalibrationError, match="finite"):
        Readings(procedure, np.zeros((4, 6)), np.full((4, 3), np.nan))


def test_a_link_that_cannot_be_kept_in_the_box_is_refused() -> None:
    assert NOMINAL.link is not None
    low = Box(NOMINAL.box.lower, NOMINAL.box.upper)
    short = HexaSlide(NOMINAL.geometry, low, replace(NOMINAL.link, length_m=0.05))
    with pytest.raises(CalibrationError, match="random postures keep"):
        measure(Procedure.of("constraint-link"), short, short, 10, np.random.default_rng(0))
    machine = HexaSlide(NOMINAL.geometry, low)
    with pytest.raises(CalibrationError, match="constraint link: found none"):
        measure(Procedure.of("constraint-link"), machine, machine, 10, np.random.default_rng(0))


def test_a_simulated_machine_without_tolerances_is_off_by_centimetres_at_most() -> None:
    procedure = Procedure.of("position")
    nominal = NOMINAL.parameters(procedure.parameters)
    unknown = SimulatedHexaSlide(procedure, NOMINAL, np.full(len(nominal), np.inf), 3)
    off = unknown.truth.parameters(procedure.parameters) - nominal
    assert 0.01 < float(np.sqrt((off**2).mean())) < 0.03
    fine = SimulatedHexaSlide(procedure, NOMINAL, np.full(len(nominal), 1e-4), 3)
    assert fine.truth.parameters(procedure.parameters) - nominal == pytest.approx(off / 200.0)


def test_postures_that_check_a_calibration_are_spread_evenly_and_not_needed_by_it() -> None:
    assert np.flatnonzero(check_postures(40, 10, 0.25)).tolist() == [
        2,
        6,
        10,
        14,
        18,
        22,
        26,
        30,
        34,
        38,
    ]
    for count in (8, 10, 12):
        assert not check_postures(count, 10, 0.25).any()
    for count in range(12, 60):
        out = int(check_postures(count, 10, 0.25).sum())
        assert out <= 0.25 * count
        assert count - out >= min(count, 15)


def test_postures_of_a_simulation_are_well_held_or_the_best_of_many(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    usual = np.sort(looseness(NOMINAL.geometry, NOMINAL.random(400, np.random.default_rng(1))))
    for bound, every in ((float(usual[100]), True), (float(usual[0]) / 2.0, False)):
        monkeypatch.setattr(procedures, "WELL_HELD", bound)
        worst = looseness(NOMINAL.geometry, held_postures(NOMINAL, 30, 3))
        assert len(worst) == 30
        assert bool((worst < bound).all()) == every
        assert worst.max() < usual[100]


def test_postures_on_a_link_are_those_lifted_to_its_length_within_the_box() -> None:
    """As far from its base end as it is long, on the side of the platform, one by one."""
    link, wide = NOMINAL.link, NOMINAL.box
    assert link is not None
    free = wide.random(300, np.random.default_rng(2))
    lifted = on_link(NOMINAL, free)
    lower, upper = wide.lower.copy(), wide.upper.copy()
    lower[2], upper[2] = np.quantile(lifted[:, 2], [0.3, 0.8])
    expected = []
    for posture in free:
        turn = rotation(posture[None, 3:])[0]
        apart = posture[:3] + turn @ link.platform_end - link.base_end
        below = link.length_m**2 - apart[0] ** 2 - apart[1] ** 2
        if below > 0.0:
            above = wide.centre[2] + link.platform_end[2] - link.base_end[2] > 0.0
            z = posture[2] + (1.0 if above else -1.0) * below**0.5 - apart[2]
            if lower[2] <= z <= upper[2]:
                expected.append([*posture[:2], z, *posture[3:]])
    assert len(expected) == 150
    narrow, inside = replace(NOMINAL, box=Box(lower, upper)), []
    for posture in free:
        with suppress(CalibrationError):
            inside += on_link(narrow, posture[None]).tolist()
    assert np.array(inside) == pytest.approx(np.array(expected))


def test_a_link_that_is_too_short_is_refused_with_the_lengths_that_fit() -> None:
    link, posture = NOMINAL.link, NOMINAL.box.centre
    assert link is not None
    turn = rotation(posture[None, 3:])[0]
    ends = [
        np.array([*posture[:2], z]) + turn @ link.platform_end - link.base_end
        for z in (NOMINAL.box.lower[2], NOMINAL.box.upper[2])
    ]
    least, greatest = (1000.0 * float(np.linalg.norm(end)) for end in ends)
    short = replace(NOMINAL, link=replace(link, length_m=0.1))
    words = rf"found a constraint link of 100 mm. Allowed: {least:.1f} to {greatest:.1f} mm there"
    with pytest.raises(CalibrationError, match=words):
        on_link(short, posture[None])


def test_lengths_that_no_frame_changes_are_all_between_joints_starts_and_links() -> None:
    geometry = NOMINAL.geometry
    starts = np.linalg.norm(geometry.base[1:], axis=1)
    expected = np.concatenate([pdist(geometry.platform), starts, geometry.links])
    assert inner_lengths(geometry) == pytest.approx(expected)


def test_a_posture_outside_the_box_is_refused_but_for_rounding() -> None:
    box, middle = NOMINAL.box, NOMINAL.box.centre
    for column in range(6):
        for bound, way in ((box.lower, -1.0), (box.upper, 1.0)):
            posture = middle.copy()
            posture[column] = bound[column] + way * 1e-12
            assert box.inside(posture[None])[0, column] == bound[column]
            posture[column] = bound[column] + way * 1e-6
            with pytest.raises(CalibrationError, match="the machine's box"):
                box.inside(posture[None])


def test_rails_that_reach_nothing_are_told_after_fifty_tries_for_each_posture() -> None:
    nowhere = replace(NOMINAL, travel_m=np.array([[9.0] * 6, [9.1] * 6]))
    with pytest.raises(CalibrationError, match="rails that reach 0 of 500 random postures"):
        nowhere.random(10, np.random.default_rng(1))
