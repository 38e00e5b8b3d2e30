"""The Hexa Slide: kinematics, exact derivatives, true ranks and what is lost, on any geometry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.arrays import FloatArray
from calib.design.identifiability import classical_qr
from calib.errors import CalibrationError, NotIdentifiable, UnreachablePosture
from calib.hexaslide.derivatives import jacobian
from calib.hexaslide.geometry import (
    NAMES,
    Box,
    ConstraintLink,
    Geometry,
    HexaSlide,
    forward,
    forward_near,
    inverse,
    legs,
    rotation,
    values,
    with_values,
)
from calib.hexaslide.planning import (
    differenced,
    fewest_postures,
    reachable,
)
from calib.hexaslide.procedures import (
    COMPONENTS,
    Procedure,
    ProcedureKind,
    held_postures,
)
from calib.hexaslide.search import Search, best_postures
from protocols.hexaslide import load_hexaslide
from tests.calib.hexaslide.hexaslide_draws import SHAPES, drawn_machine, jacobian_and_slopes
from tests.conftest import LONG, first_quick

RANKS = {
    ProcedureKind.POSE_INVERSE: (49, 49, 9),
    ProcedureKind.POSE_FORWARD: (49, 49, 9),
    ProcedureKind.POSITION: (46, 49, 16),
    ProcedureKind.CONSTRAINT_LINK: (48, 55, 48),
}
TINY = 1e-30


def example() -> HexaSlide:
    machine = load_hexaslide()
    return machine.whole()


H60 = example()


def random_machine(seed: int) -> HexaSlide:
    """H60 with every parameter and both ends of the link disturbed by centimetres."""
    generator = np.random.default_rng(seed)
    moved = values(H60.geometry) + generator.uniform(-0.04, 0.04, len(NAMES))
    assert H60.link is not None
    shifts = generator.uniform(-0.05, 0.05, (2, 3))
    ends = (H60.link.platform_end + shifts[0], H60.link.base_end + shifts[1])
    half = (H60.box.upper - H60.box.lower) / 4.0
    box = Box(H60.box.centre - half, H60.box.centre + half)
    return HexaSlide(with_values(H60.geometry, moved), box, ConstraintLink(*ends, 0.55))


def some(machine: HexaSlide, count: int) -> FloatArray:
    return machine.box.random(count, np.random.default_rng(7))


def test_rotation_is_that_of_the_paper() -> None:
    matrix = rotation(np.radians([[10.0, -5.0, 20.0]]))[0]
    expected = [
        [0.9202403, -0.35104581, 0.17298739],
        [0.34071865, 0.93611681, 0.08715574],
        [-0.19253206, -0.02126419, 0.98106026],
    ]
    assert matrix == pytest.approx(np.array(expected), abs=5e-9)


def test_sliders_of_the_middle_posture() -> None:
    expected = [
        0.4094415081753665,
        0.39791084805408805,
        0.364938449787372,
        0.3707538789083237,
        0.43454930815897264,
        0.4402516678178078,
    ]
    sliders = inverse(H60.geometry, np.array([[0.0, -0.8, -1.15, 0.0, 0.0, 0.0]]))[0]
    assert sliders == pytest.approx(expected, abs=1e-14)


def test_derivatives_of_the_third_slider() -> None:
    posture = np.array([[-0.123, -0.654, -1.234, 0.1, -0.2, 0.3]])
    row = jacobian(Procedure.of("pose-inverse"), H60.geometry, posture)[0, 2]
    lengths = [
        row[NAMES.index(f"{part}3")]
        for part in ["Bx", "By", "Bz", "Ax", "Ay", "Az", "ax", "ay", "l"]
    ]
    expected = [0.44287273, 0.35823036, -0.85456074, -0.22264667, -0.29390269]
    expected += [0.9585348, 0.10379773, -0.00695604, -1.02700502]
    assert lengths == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize("seed", [None, 1, 2])
def test_forward_kinematics_returns_everywhere_in_the_box(seed: int | None) -> None:
    machine = H60 if seed is None else random_machine(seed)
    postures = np.vstack([machine.box.grid(), some(machine, 500)])
    sliders = inverse(machine.geometry, postures)
    places = forward(machine.geometry, sliders, machine.box)
    assert np.abs(places - postures).max() < 1e-12
    assert np.abs(inverse(machine.geometry, places) - sliders).max() < 1e-12


def test_the_iteration_of_the_paper_needs_the_other_sign() -> None:
    """papers/001, 2.2, step iii prints X + J⁻¹ (Q_g - Q_d); with Q_d - Q_g it arrives."""
    posture = np.array([[0.05, -0.75, -1.1, 0.05, -0.08, 0.1]])
    sliders = inverse(H60.geometry, posture)
    misses = {}
    for sign in (1.0, -1.0):
        guess = H60.box.centre[None].copy()
        for _ in range(6):
            steps = guess + 1j * TINY * np.eye(6)
            slope = inverse(H60.geometry, steps).imag.T / TINY
            guess = guess + sign * np.linalg.solve(
                slope, (sliders - inverse(H60.geometry, guess))[0]
            )
            misses[sign] = float(np.abs(guess - posture).max())
            if misses[sign] > 0.3:  # the postures beyond need not exist
                break
    assert misses[1.0] < 1e-9
    assert misses[-1.0] > 0.3


def test_outside_the_reachable_space_both_ways_refuse() -> None:
    with pytest.raises(UnreachablePosture, match="does not reach its rail"):
        inverse(H60.geometry, np.array([[2.0, 0.0, 0.0, 0.0, 0.0, 0.0]]))
    with pytest.raises(UnreachablePosture, match=r"sliders \(3, 0, 0, -3, 0, 0\) m: found none"):
        forward(H60.geometry, np.array([[3.0, 0.0, 0.0, -3.0, 0.0, 0.0]]), H60.box)


def test_sliders_without_a_posture_are_always_told_and_the_bad_one_named() -> None:
    generator = np.random.default_rng(0)
    good = inverse(H60.geometry, some(H60, 1))
    for _ in range(100):
        sliders = generator.uniform(2.0, 30.0, (1, 6)) * [1.0, -1.0, 1.0, -1.0, 1.0, -1.0]
        count = f"posture of the sliders .{sliders[0, 0]:g}, {sliders[0, 1]:g}"
        with pytest.raises(UnreachablePosture, match=count):
            forward(H60.geometry, np.vstack([good, sliders]), H60.box)


def test_a_posture_beyond_singular_ones_is_never_given() -> None:
    """Sliders of such postures: either another posture has them too, or there is none."""
    generator = np.random.default_rng(2)
    wide = generator.uniform(-1.0, 1.0, (4000, 6)) * [0.2, 0.2, 0.2, 1.5, 1.5, 3.0]
    wide += H60.box.centre
    side = np.sign(np.linalg.det(legs(H60.geometry, wide).arms.by_posture))
    centre = np.sign(np.linalg.det(legs(H60.geometry, H60.box.centre[None]).arms.by_posture))[0]
    beyond = wide[side != centre][:100]
    assert len(beyond) == 100
    solutions = 0
    for posture in beyond[:, None]:
        sliders = inverse(H60.geometry, posture)
        assert np.abs(forward_near(H60.geometry, sliders, posture) - posture).max() < 1e-9
        try:
            postures = forward(H60.geometry, sliders, H60.box)
        except UnreachablePosture:
            solutions += 1
        else:
            slopes = legs(H60.geometry, postures).arms.by_posture
            assert np.sign(np.linalg.det(slopes))[0] == centre
            assert np.abs(inverse(H60.geometry, postures) - sliders).max() < 1e-9
    assert solutions > 0


def test_all_of_the_box_is_reached_on_one_side_of_singular_postures() -> None:
    postures = H60.box.grid()
    assert len(postures) == 3**6
    by_posture = legs(H60.geometry, postures).arms.by_posture
    sides = np.sign(np.linalg.det(by_posture))
    assert (sides == sides[0]).all()
    assert np.linalg.cond(by_posture).max() < 36.5
    sliders = inverse(H60.geometry, postures)
    assert 0.01 < sliders.min() < sliders.max() < 1.02


def test_a_platform_that_is_not_held_is_told_where_it_matters() -> None:
    """All joints on a line: the platform turns about it, whatever the sliders do."""
    nominal = H60.geometry
    line = np.linspace(-0.2, 0.2, 6)[:, None] * [1.0, 0.5, 0.0]
    loose = HexaSlide(
        Geometry(nominal.base, nominal.rails, line, nominal.links + 0.3), H60.box, H60.link
    )
    for kind in (ProcedureKind.POSE_FORWARD, ProcedureKind.POSITION, ProcedureKind.CONSTRAINT_LINK):
        with pytest.raises(CalibrationError, match="a singular one"):
            reachable(Procedure.of(kind), loose)
    assert jacobian(Procedure.of("pose-inverse"), loose.geometry, some(loose, 5)).shape == (
        5,
        6,
        49,
    )


def test_implicit_derivatives_are_those_of_a_complex_step() -> None:
    """Through inverse and forward kinematics, which know nothing of the theorem."""
    machine = random_machine(3)
    postures, parameters = some(machine, 4), values(machine.geometry)
    sliders = inverse(machine.geometry, postures)
    inverse_rows = np.empty((4, 6, 49))
    forward_rows = np.empty((4, 6, 49))
    for k in range(49):
        step = parameters.astype(complex)
        step[k] += 1j * TINY
        changed = with_values(machine.geometry, step)
        inverse_rows[..., k] = inverse(changed, postures.astype(complex)).imag / TINY
        moved = forward(changed, sliders.astype(complex), machine.box)
        forward_rows[..., k] = moved.imag / TINY
    for kind, expected in (
        (ProcedureKind.POSE_INVERSE, inverse_rows),
        (ProcedureKind.POSE_FORWARD, forward_rows),
        (ProcedureKind.POSITION, forward_rows[:, :3]),
    ):
        slopes = jacobian(Procedure.of(kind), machine.geometry, postures)
        assert np.abs(slopes - expected).max() < 1e-12 * np.abs(expected).max()


def test_link_derivatives_are_those_of_a_complex_step() -> None:
    machine = random_machine(4)
    postures, link = some(machine, 4), machine.link
    assert link is not None
    procedure = Procedure(ProcedureKind.CONSTRAINT_LINK, known=())
    column = jacobian(procedure, machine.geometry, postures, link)[:, 0]
    sliders = inverse(machine.geometry, postures).astype(complex)
    start = np.concatenate([values(machine.geometry), link.platform_end, link.base_end])
    for k in range(55):
        step = start.astype(complex)
        step[k] += 1j * TINY
        poses = forward(with_values(machine.geometry, step[:49]), sliders, machine.box)
        apart = poses[:, :3] + rotation(poses[:, 3:]) @ step[49:52] - step[52:]
        expected = np.sqrt((apart * apart).sum(axis=1)).imag / TINY
        assert column[:, k] == pytest.approx(expected, abs=1e-12 * np.abs(column).max())
    assert (column[:, 55] == -1.0).all()


def test_slopes_by_the_posture_agree_with_differences() -> None:
    postures = some(H60, 3)
    for kind in ProcedureKind:
        procedure = Procedure.of(kind)
        rows, slopes = jacobian_and_slopes(procedure, H60.geometry, postures, H60.link)
        plain = jacobian(procedure, H60.geometry, postures, H60.link)
        assert rows == pytest.approx(plain, abs=1e-13)
        for d in range(6):
            shift = 1e-5 * np.eye(6)[d]
            high = jacobian(procedure, H60.geometry, postures + shift, H60.link)
            low = jacobian(procedure, H60.geometry, postures - shift, H60.link)
            assert slopes[..., d] == pytest.approx((high - low) / 2e-5, abs=2e-6)


@pytest.mark.parametrize("machine", [H60, *(drawn_machine(8, shape) for shape in SHAPES)])
def test_forward_rows_are_inverse_rows_turned_and_blocks_have_their_ranks(
    machine: HexaSlide,
) -> None:
    postures = held_postures(machine, 9, 3)
    by_posture = legs(machine.geometry, postures).arms.by_posture
    by_parameter = jacobian(Procedure.of("pose-inverse"), machine.geometry, postures)
    slopes = jacobian(Procedure.of("pose-forward"), machine.geometry, postures)
    expected = -np.linalg.inv(by_posture) @ by_parameter
    assert np.abs(slopes - expected).max() < 1e-12 * np.abs(expected).max()
    sizes = np.linalg.svd(np.swapaxes(by_parameter, 0, 1), compute_uv=False)
    ranks = (sizes > 1e-9 * sizes[:, :1]).sum(axis=1)
    assert ranks.tolist() == [6, 7, 9, 9, 9, 9]
    positions = jacobian(Procedure.of("position"), machine.geometry, postures)
    assert positions == pytest.approx(slopes[:, :3], rel=1e-12)


@pytest.mark.parametrize("kind", list(ProcedureKind))
def test_fewest_postures(kind: ProcedureKind) -> None:
    assert fewest_postures(Procedure.of(kind), H60) == RANKS[kind][2]


def test_measured_subsets_and_what_they_lose() -> None:
    tilt = reachable(Procedure.of("pose-forward", ("x", "y", "z", "theta")), H60)
    assert tilt.rank == 48
    assert [direction.combination for direction in tilt.unseen] == [
        "platform frame turned about its Z"
    ]
    angles = reachable(Procedure.of("pose-forward", COMPONENTS[3:]), H60)
    shifts = [f"platform frame shifted along its {axis}" for axis in "XYZ"]
    assert [direction.combination for direction in angles.unseen][:3] == shifts


def test_individually_known_parameters_with_positions_only() -> None:
    sensitivity = reachable(Procedure.of("position"), H60)
    assert len(sensitivity.individually_known) == 31
    assert not [name for name in sensitivity.individually_known if name.startswith("B")]


@LONG
@pytest.mark.parametrize(
    ("kind", "limit"),
    first_quick(
        [(ProcedureKind.POSE_INVERSE, 55.0), (ProcedureKind.POSE_FORWARD, 500.0)], several=True
    ),
)
def test_best_postures_are_far_better_than_random_ones(kind: ProcedureKind, limit: float) -> None:
    design = best_postures(Procedure.of(kind), H60, 9, Search(starts=2))
    assert design.condition_number < limit < design.start_condition_number / 10.0
    rows = jacobian(Procedure.of(kind), H60.geometry, design.refined.coordinates)
    assert np.linalg.cond(rows.reshape(-1, 49)) == pytest.approx(design.condition_number, rel=1e-6)
    inside = design.refined.coordinates
    assert ((inside >= H60.box.lower) & (inside <= H60.box.upper)).all()


@pytest.mark.parametrize(
    ("kind", "count", "counted"),
    [
        (ProcedureKind.POSE_FORWARD, 9, 49),
        (ProcedureKind.POSITION, 16, 48),
        (ProcedureKind.POSITION, 17, 49),
        (ProcedureKind.CONSTRAINT_LINK, 46, 46),
        (ProcedureKind.CONSTRAINT_LINK, 48, 48),
        (ProcedureKind.CONSTRAINT_LINK, 100, 55),
    ],
)
def test_the_rule_of_the_paper_on_its_differences_counts_rows_or_parameters(
    kind: ProcedureKind, count: int, counted: int
) -> None:
    procedure, postures = Procedure.of(kind), some(H60, count)
    rows = differenced(procedure, H60, postures)
    exact = jacobian(procedure, H60.geometry, postures, H60.link)
    assert np.abs(rows - exact).max() < 1e-6 * np.abs(exact).max()
    names = procedure.parameters
    flat = rows.reshape(-1, len(names))
    assert len(names) - len(classical_qr(flat, names).flagged) == counted == min(flat.shape)


@pytest.mark.parametrize("kind", [ProcedureKind.POSE_INVERSE, ProcedureKind.POSITION])
def test_matrices_that_the_paper_calls_homogeneous_are_not(kind: ProcedureKind) -> None:
    """Of one unit they would be the same in mm and m; those of rail components grow with it."""
    procedure, postures = Procedure.of(kind), some(H60, 12)
    larger = replace(
        H60.geometry,
        base=1000.0 * H60.geometry.base,
        platform=1000.0 * H60.geometry.platform,
        links=1000.0 * H60.geometry.links,
    )
    in_mm = postures * np.array([1000.0, 1000.0, 1000.0, 1.0, 1.0, 1.0])
    ratio = np.abs(jacobian(procedure, larger, in_mm, None)).max(axis=(0, 1))
    ratio = ratio / np.abs(jacobian(procedure, H60.geometry, postures, None)).max(axis=(0, 1))
    assert set(np.round(ratio).astype(int)) == {1, 1000}
    assert 0 < (np.round(ratio) == 1000).sum() <= 12


def test_differences_through_the_inverse_kinematics_and_of_the_link_alone() -> None:
    procedure = Procedure.of("constraint-link", known=("d",))
    for kind in (procedure, Procedure.of("pose-inverse")):
        slopes = differenced(kind, H60, some(H60, 5))
        expected = jacobian(kind, H60.geometry, some(H60, 5), H60.link)
        assert slopes == pytest.approx(expected, abs=2e-6)
    with pytest.raises(CalibrationError, match="one in the machine file"):
        differenced(procedure, replace(H60, link=None), some(H60, 5))


def test_wrong_input_is_refused() -> None:
    with pytest.raises(CalibrationError, match="different ones of c, d, length"):
        Procedure.of("constraint-link", known=("c", "c"))
    with pytest.raises(CalibrationError, match="constraint-link only"):
        Procedure.of("position", known=())
    with pytest.raises(NotIdentifiable, match="16 or more"):
        best_postures(Procedure.of("position"), H60, 15)
    with pytest.raises(CalibrationError, match="different ones of x, y, z"):
        Procedure.of("position", ("x", "roll"))
    nominal = H60.geometry
    with pytest.raises(CalibrationError, match="a unit vector"):
        Geometry(nominal.base, 1.1 * nominal.rails, nominal.platform, nominal.links)
    with pytest.raises(CalibrationError, match="six chains"):
        Geometry(nominal.base[:5], nominal.rails[:5], nominal.platform[:5], nominal.links[:5])
    with pytest.raises(CalibrationError, match="positive lengths"):
        Geometry(nominal.base, nominal.rails, nominal.platform, -nominal.links)
