"""The picture of a set-up is where the machine says, on any machine with drives at right angles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from calib.arrays import FloatArray, conditions
from calib.errors import CalibrationError
from calib.tripod.drawing import Lines, set_up_lines, view
from calib.tripod.geometry import Geometry, Three, Triple, direct
from calib.tripod.pipeline import Model
from tests.tripods import DELTA

ORTHOGLIDE = Geometry()


def three(rows: FloatArray) -> Three:
    a, b, c = (triple(row) for row in rows)
    return a, b, c


def triple(row: FloatArray) -> Triple:
    x, y, z = row.tolist()
    return x, y, z


@st.composite
def machines(draw: st.DrawFn) -> Geometry:
    """Orthoglides turned any way, with axes that do not meet, a platform and unequal bars."""
    chance = np.random.default_rng(draw(st.integers(0, 10**6)))
    try:
        return replace(
            ORTHOGLIDE,
            direction=three(Rotation.random(None, chance).as_matrix()),
            origin_mm=three(chance.uniform(-30.0, 30.0, (3, 3))),
            platform_mm=three(chance.uniform(-30.0, 30.0, (3, 3))),
            leg_length_mm=triple(chance.uniform(280.0, 340.0, 3)),
            gravity=triple(Rotation.random(None, chance).as_matrix()[0]),
        )
    except CalibrationError:
        assume(False)
        raise


legs = st.sampled_from([(0, (1, 2)), (0, (2, 1)), (1, (0, 2)), (2, (1, 0)), (2, (0,))])
stations = st.floats(0.1, 0.9)
displacements = st.floats(-100.0, 60.0)


def drawn(geometry: Geometry, leg: int, axes: tuple[int, ...], at: float, mm: float) -> Lines:
    return set_up_lines(geometry, leg, axes, (1.0, -1.0)[: len(axes)], at, mm)


@given(machines(), legs, stations, displacements)
def test_the_touched_point_is_where_the_machine_says(
    geometry: Geometry, where: tuple[int, tuple[int, ...]], station: float, mm: float
) -> None:
    leg, axes = where
    now, zero = (drawn(geometry, leg, axes, station, d) for d in (mm, 0.0))
    ends, feet = now.bars[:, 0], now.bars[:, 1]
    assert np.linalg.norm(feet - ends, axis=1) == pytest.approx(geometry.lengths)
    along = ((feet - geometry.origins) * geometry.directions).sum(axis=1)
    assert feet == pytest.approx(geometry.origins + along[:, None] * geometry.directions)
    tool = now.platform[0, 0]
    assert tool == pytest.approx(direct(geometry, along), abs=1e-6)
    own_zero = np.zeros(3)  # a tripod without a common one: the bar lies along its drive there
    if not geometry.common_zero:
        across = geometry.anchors[leg] @ geometry.directions[leg] * geometry.directions[leg]
        own_zero = geometry.anchors[leg] - across
    assert tool == pytest.approx(own_zero + mm * geometry.directions[leg], abs=1e-6)
    # at Zero the station from the tool end; then the stand keeps its place along the drive
    zero_bar = zero.bars[leg]
    assert zero.touched == pytest.approx(zero_bar[0] + station * (zero_bar[1] - zero_bar[0]))
    drive = geometry.directions[leg]
    assert now.touched @ drive == pytest.approx(zero.touched @ drive, abs=1e-6)
    bar = feet[leg] - ends[leg]
    assert np.cross(now.touched - ends[leg], bar) == pytest.approx(np.zeros(3), abs=1e-5)
    # and an indicator there reads what the simulation of the machine reads
    rows = conditions([leg] * len(axes), list(axes), [mm] * len(axes), station=station)
    read = (now.touched - zero.touched) @ geometry.directions[list(axes)].T
    assert Model(geometry).readings(rows) == pytest.approx(read, abs=1e-6)


@given(machines(), legs, stations, displacements)
def test_each_spindle_stands_on_its_side_along_its_axis(
    geometry: Geometry, where: tuple[int, tuple[int, ...]], station: float, mm: float
) -> None:
    leg, axes = where
    lines = drawn(geometry, leg, axes, station, mm)
    for axis, side, spindle, ahead in zip(
        axes, (1.0, -1.0), lines.spindles, lines.ahead, strict=False
    ):
        assert spindle[0] == pytest.approx(lines.touched)
        way = (spindle[1] - spindle[0]) / np.linalg.norm(spindle[1] - spindle[0])
        assert way == pytest.approx(side * geometry.directions[axis])
        assert (ahead[1] - ahead[0]) @ geometry.directions[axis] > 0.0


@given(machines())
def test_no_drive_hides_behind_another_and_gravity_pulls_down(geometry: Geometry) -> None:
    axes = view(geometry)
    assert axes @ axes.T == pytest.approx(np.eye(2))
    drives = geometry.directions @ axes.T
    assert np.linalg.norm(drives, axis=1) == pytest.approx(np.full(3, (2.0 / 3.0) ** 0.5))
    for first, second in ((0, 1), (1, 2), (2, 0)):
        assert drives[first] @ drives[second] / (2.0 / 3.0) == pytest.approx(-0.5)
    falls = axes @ np.array(geometry.gravity)
    assert falls[0] == pytest.approx(0.0, abs=1e-9)
    assert falls[1] < 0.0


def test_a_machine_seen_along_its_gravity_has_a_picture_too() -> None:
    slanted = 3.0**-0.5
    axes = view(replace(ORTHOGLIDE, gravity=(-slanted, -slanted, -slanted)))
    assert axes @ axes.T == pytest.approx(np.eye(2))


def test_parallel_drives_are_seen_aslant_beside_one_another() -> None:
    """Before: seen along the drives, divided by the length that nothing of gravity has there."""
    for leg, axes in ((0, (1, 2)), (2, (1,))):
        lines = set_up_lines(DELTA, leg, axes, (1.0, 1.0)[: len(axes)], 0.5, 0.0).seen(view(DELTA))
        assert all(np.isfinite(part).all() for part in vars(lines).values())
        feet = lines.bars[:, 1]
        assert min(np.linalg.norm(feet - np.roll(feet, 1, axis=0), axis=1)) > 50.0
        assert (lines.rails[:, -1] - lines.rails[:, 0])[:, 1].min() > 100.0


def test_the_usual_machine_by_hand() -> None:
    """Seen from the corner: z up, x down to the left, y down to the right."""
    axes = view(ORTHOGLIDE)
    half, third = 2.0**-0.5, 6.0**-0.5
    assert axes == pytest.approx(np.array([[-half, half, 0.0], [-third, -third, 2.0 * third]]))
