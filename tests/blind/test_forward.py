"""The bench's own machine against the numbers of the theory: the generator itself is right."""

from __future__ import annotations

import numpy as np
import pytest

from tests.blind.effects import EFFECT_IDS, candidates
from tests.blind.forward import LEG_MM, FloatArray, Hidden, Hypothesis, Rows, carriages, readings
from tests.blind.forward import three_spheres as meet
from tests.blind.signatures import Columns, left_out_rms
from tests.blind.steps import PLANS, Plan, rows_of, sorted_by_cycle, visits

THREE = Plan((0.0, 60.0, -100.0), 1)


def taken(plan: Plan = THREE, in_place: bool = False) -> Rows:
    return rows_of(plan, np.random.default_rng(1), in_place)


def change(entry: Hypothesis, size: float, leg: int, axis: int) -> tuple[float, float]:
    """Derivative of the differences Max − Zero and Min − Zero of one indicator."""
    rows = taken()
    up, down = (readings(rows, Hidden().plus([(entry, s * size)])) for s in (1, -1))
    slope = (up - down) / (2 * size)
    gauge_rows = np.flatnonzero((rows.leg == leg) & (rows.axis == axis))
    zero, high, low = (slope[gauge_rows[k]] for k in range(3))
    return float(high - zero), float(low - zero)


def test_zero_posture_is_the_assembled_machine_not_the_far_root() -> None:
    assert carriages(np.zeros((1, 3)))[0] == pytest.approx([LEG_MM] * 3)
    feet = LEG_MM * np.eye(3)[None]
    assert meet(feet, np.full((1, 3), LEG_MM))[0] == pytest.approx([0, 0, 0], abs=1e-10)


def test_direct_kinematics_undoes_the_inverse() -> None:
    points = np.random.default_rng(2).uniform(-100, 60, (50, 3))
    feet = carriages(points)[:, :, None] * np.eye(3)
    assert meet(feet, np.full((50, 3), LEG_MM)) == pytest.approx(points, abs=1e-9)


def test_legs_that_cannot_meet_are_refused() -> None:
    with pytest.raises(ValueError, match="cannot meet"):
        meet(LEG_MM * np.eye(3)[None], np.full((1, 3), 10.0))


def test_postures_lie_where_the_theory_puts_them() -> None:
    joints = carriages(np.array([[60.0, 0, 0], [-100.0, 0, 0]]))
    alpha = np.radians([11.1508, -18.8033])
    assert joints[:, 0] == pytest.approx(LEG_MM * (1 + np.sin(alpha)), abs=1e-3)
    assert joints[:, 1] == pytest.approx(LEG_MM * np.cos(alpha), abs=1e-3)


@pytest.mark.parametrize(("posture", "travel_mm"), [(0, 60.0), (1, -100.0)])
def test_coefficients_of_system_11(posture: int, travel_mm: float) -> None:
    sine = travel_mm / LEG_MM
    cosine = np.sqrt(1 - sine**2)
    b = (0.5 + sine) * sine / cosine
    c = (0.5 + sine) / cosine - 0.5
    # The indicator along y on leg x reads a d_rho_y + b d_rho_x − c d_L_y − b d_L_x.
    expected = {("offset", 1): sine, ("offset", 0): b, ("length", 1): -c, ("length", 0): -b}
    for (name, leg), figure in expected.items():
        change_mm = change((name, (leg,)), 1e-4, leg=0, axis=1)[posture]
        assert change_mm == pytest.approx(figure, abs=1e-7)


def test_conditioning_of_the_twelve_differences() -> None:
    rows = taken()
    columns = Columns(rows, Hidden()).base[:, :6]
    differences = []
    for mount in range(6):
        zero, high, low = columns[np.flatnonzero(rows.mount == mount)[:3]]
        differences += [high - zero, low - zero]
    sizes = np.linalg.svd(np.array(differences), compute_uv=False)
    assert sizes == pytest.approx([1.0122, 0.6827, 0.6827, 0.0166, 0.0164, 0.0164], abs=1e-4)


def test_squareness_of_a_pair_reads_alike_on_both_its_legs() -> None:
    for leg, axis in ((0, 1), (1, 0)):
        for entry in ((0, 1), (1, 0)):
            change_mm = change(("lean", entry), 1e-6, leg, axis)
            assert change_mm == pytest.approx((-41.6035, 17.7679), abs=1e-4)


def test_an_axis_shifted_sideways() -> None:
    assert change(("shift", (0, 1)), 1e-4, 1, 0) == pytest.approx((-0.1367, 0.0605), abs=1e-4)
    assert change(("shift", (0, 1)), 1e-4, 0, 1) == pytest.approx((-0.1934, 0.3223), abs=1e-4)


def test_the_touched_point_travels_along_the_bar() -> None:
    """−60 mm … +100 mm as displacement goes +60 … −100."""
    assert change(("taper", (0, 1)), 1e-5, 0, 1) == pytest.approx((-60.0, 100.0), abs=1e-6)
    assert change(("bow", (0, 1)), 1e-8, 0, 1) == pytest.approx((3600.0, 10000.0), abs=1e-3)


def test_the_second_station_moves_the_touched_point() -> None:
    rows = taken(Plan((0.0,), 1, (0.5, 0.35)))
    slope = readings(rows, Hidden().plus([(("taper", (0, 1)), 1e-3)])) / 1e-3
    gauge_rows = (rows.leg == 0) & (rows.axis == 1)
    assert slope[gauge_rows & (rows.station == 0.35)] == pytest.approx(-0.15 * LEG_MM)
    assert slope[gauge_rows & (rows.station == 0.5)] == pytest.approx(0.0, abs=1e-9)


def test_the_weight_stretches_the_hanging_leg_only() -> None:
    """At Zero the leg along z carries everything, so the tool goes down by the sag."""
    weight = [(("sag", (leg,)), 1.0) for leg in range(3)]
    rows = taken(Plan((0.0,), 1))
    sunk = readings(rows, Hidden().plus(weight))
    expected = -(1 - rows.station) * np.where(rows.axis == 2, 1.0, 0.0)
    assert sunk == pytest.approx(expected, abs=0.01)


def one(entry: Hypothesis, size: float, level: float, leg: int, axis: int) -> float:
    """What an entry changes in the reading at a level, coming from Zero."""
    rows = taken(Plan((0.0, level), 1))
    gauge_rows = np.flatnonzero((rows.leg == leg) & (rows.axis == axis))[1]
    return float(
        (readings(rows, Hidden().plus([(entry, size)])) - readings(rows, Hidden()))[gauge_rows]
    )


def test_a_guide_like_an_s_leaves_its_line_with_the_cube() -> None:
    """At +60 mm it is off by 0.6³, at -100 mm by -1; the curve of a guide by 0.6² and 1."""
    for level, cube, square in ((60.0, 0.216, 0.36), (-100.0, -1.0, 1.0)):
        bent = one(("s_guide", (0, 1)), 1e-3, level, 0, 1)
        curved = one(("curve", (0, 1)), 1e-7, level, 0, 1)
        assert bent / curved == pytest.approx(cube / square, rel=1e-3)


def test_clearance_is_taken_up_by_pull_and_push() -> None:
    """At +60 mm the hanging bar z pulls bar x with tan 11.15° of the weight: half of it."""
    longer = one(("clearance", (0,)), 0.01, 60.0, 0, 1)
    half = one(("length", (0,)), 0.005, 60.0, 0, 1)
    assert longer == pytest.approx(half, rel=1e-3)
    assert one(("clearance", (0,)), 0.01, -60.0, 0, 1) == pytest.approx(
        one(("length", (0,)), -0.005, -60.0, 0, 1), rel=1e-3
    )


def test_a_round_bar_reads_less_by_the_square_of_the_way_across() -> None:
    """Across by z on a radius of 10 mm: z² / 20 mm."""
    rows = taken(Plan((0.0, 60.0), 1))
    off = Hidden().plus([(("offset", (2,)), 2.0)])
    across, gauge_rows = (
        np.flatnonzero((rows.leg == 0) & (rows.axis == axis))[1] for axis in (2, 1)
    )
    z = readings(rows, off)[across] - readings(rows, off)[across - 2]
    round_bar = off.plus([(("round", (0, 1)), 0.1)])
    assert readings(rows, round_bar)[gauge_rows] - readings(rows, off)[gauge_rows] == pytest.approx(
        -(z**2) / 20.0, rel=1e-6
    )


def test_an_indicator_with_play_follows_only_beyond_it() -> None:
    """Up 22, 60, down 22: what goes up is shown half too low, what comes down half too high."""
    rows = taken(Plan((0.0, 22.0, 60.0, 22.0), 1))
    off = Hidden().plus([(("offset", (0,)), 2.0)])
    gauge_rows = np.flatnonzero((rows.leg == 0) & (rows.axis == 1))
    true = readings(rows, off)[gauge_rows]
    change_mm = readings(rows, off.plus([(("lag", (0, 1)), 0.004)]))[gauge_rows] - true
    way = np.sign(np.diff(true[:4]))
    assert change_mm[1:4] == pytest.approx(-0.002 * way, abs=1e-9)


def test_a_stand_wanders_alone() -> None:
    rows = taken(Plan((0.0, 60.0), 1))
    change_mm = readings(rows, Hidden().plus([(("stand", (0, 1)), 1e-6)])) - readings(
        rows, Hidden()
    )
    gauge_rows = (rows.leg == 0) & (rows.axis == 1)
    assert change_mm == pytest.approx(np.where(gauge_rows, 1e-6 * rows.time_s, 0.0), abs=1e-12)


def test_backlash_keeps_the_foot_back_after_a_movement_down() -> None:
    rows = taken(Plan((0.0, 30.0, -30.0), 1))
    gauge_rows = (rows.leg == 0) & (rows.axis == 1)
    # +30: x up, y and z down (the bar leans); −30: x down, the others again down; then all up.
    assert rows.moved[gauge_rows].tolist() == [[1, 1, 1], [1, -1, -1], [-1, -1, -1], [1, 1, 1]]
    persistent = Hidden().plus([(("lost", (0,)), 0.01)])
    pushed = Hidden().plus([(("offset", (0,)), 0.01)])
    down = rows.moved[:, 0] < 0
    assert readings(rows, persistent)[down] == pytest.approx(readings(rows, pushed)[down], abs=1e-6)
    assert readings(rows, persistent)[~down] == pytest.approx(0.0, abs=1e-12)


def test_cyclic_error_repeats_with_the_lead() -> None:
    rows = taken(Plan((0.0, 5.0, 12.5), 1))
    change_mm = readings(rows, Hidden().plus([(("sine", (1,)), 0.01), (("cosine", (1,)), 0.01)]))
    gauge_rows = (rows.leg == 1) & (rows.axis == 0)
    scale = readings(rows, Hidden().plus([(("offset", (1,)), 0.01)]))
    # At 5 mm as at Zero, half a lead on with the opposite sign.
    assert change_mm[gauge_rows][1] == pytest.approx(scale[gauge_rows][1], abs=1e-5)
    assert change_mm[gauge_rows][2] == pytest.approx(-scale[gauge_rows][2], abs=1e-5)


def test_indicators_scale_tilt_and_wander() -> None:
    rows = taken()
    machine = Hidden().plus([(("offset", (1,)), 1.0), (("offset", (2,)), 0.5)])
    plain = readings(rows, machine)
    gauge_rows = (rows.leg == 0) & (rows.axis == 1)
    second = (rows.leg == 0) & (rows.axis == 2)
    gained = readings(rows, machine.plus([(("gain", (0, 1)), 0.1)]))
    assert gained[gauge_rows] == pytest.approx(1.1 * plain[gauge_rows])
    tilted = readings(rows, machine.plus([(("tilt", (0, 1)), 0.1)]))
    assert tilted[gauge_rows] == pytest.approx(
        np.cos(0.1) * plain[gauge_rows] + np.sin(0.1) * plain[second]
    )
    wandered = readings(rows, machine.plus([(("drift", (1,)), 1e-4)])) - plain
    assert wandered == pytest.approx(1e-4 * rows.time_s * (rows.axis == 1), abs=1e-12)
    for changed in (gained, tilted):
        assert changed[~gauge_rows] == pytest.approx(plain[~gauge_rows], abs=1e-12)


def test_shapes_outside_the_catalogue_do_what_they_say() -> None:
    rows = taken(Plan((0.0, 50.0), 1))
    gauge_rows = np.flatnonzero((rows.leg == 0) & (rows.axis == 1))[1]
    # An offset of carriage x as large as the travel error shows the same there.
    travel, passive = 50.0, np.sqrt(LEG_MM**2 - 2500.0) - LEG_MM
    sizes = {
        ("cubic", (0,)): 0.5**3,
        ("saw", (0,)): 50.0 / 23.0 - 2.0,
        ("product", (0, 1)): travel * passive / 1000.0,
    }
    for entry, size in sizes.items():
        change_mm = readings(rows, Hidden().plus([(entry, 1e-3)]))[gauge_rows]
        expected = readings(rows, Hidden().plus([(("offset", (0,)), 1e-3 * size)]))[gauge_rows]
        assert change_mm == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize(("name", "count"), [("zero-max-min", 60), ("sweep", 138)])
def test_procedures_have_their_rows(name: str, count: int) -> None:
    rows = taken(PLANS[name])
    assert len(rows) == count
    assert len(taken(PLANS["two-station"])) == 276
    assert np.all(np.diff(rows.time_s[::2]) > 0)
    last = [np.flatnonzero(rows.leg == leg)[-1] for leg in range(3)]
    assert rows.displacement_mm[last].tolist() == [0, 0, 0]


def test_repeats_in_place_do_not_move_and_can_be_mislabelled() -> None:
    plan = PLANS["zero-max-min"]
    visits_of_x = [v for v in visits(plan, in_place=True) if v.leg == 0]
    assert [v.displacement_mm for v in visits_of_x] == [0, 0, 0, 60, 60, 60, -100, -100, -100, 0]
    rows = taken(plan, in_place=True)
    assert rows.visit[:8].tolist() == [0, 0, 0, 0, 0, 0, 1, 1]
    false = sorted_by_cycle(rows)
    assert false.displacement_mm[:8:2].tolist() == [0, 60, -100, 0]
    assert false.time_s.tolist() == rows.time_s.tolist()
    assert false.mount[:6].tolist() == [0, 1] * 3


def test_every_effect_of_the_contract_has_a_place_that_a_sweep_sees() -> None:
    rows = taken(PLANS["two-station"])
    machine = Hidden().plus([(("offset", (i,)), 1.0 - i) for i in range(3)])
    columns = Columns(rows, machine)
    ids = {c.id for c in candidates() if columns.span(c).shape[1] == len(c.directions)}
    assert ids == set(EFFECT_IDS)


def test_left_out_groups_equal_refits_without_them() -> None:
    rng = np.random.default_rng(3)
    design, values = rng.normal(size=(20, 3)), rng.normal(size=20)
    groups = [k // 4 for k in range(20)]
    errors: list[FloatArray] = []
    for group in range(5):
        out = np.array(groups) == group
        fit = np.linalg.lstsq(design[~out], values[~out], rcond=None)[0]
        errors.append(values[out] - design[out] @ fit)
    expected = float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))
    assert left_out_rms(design, values, groups) == pytest.approx(expected)
