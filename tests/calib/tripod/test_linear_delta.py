"""A linear delta read against a plate, beside geometry written out by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import root

from calib.arrays import Conditions, FloatArray, observe, tool_conditions, without_zeros
from calib.errors import CalibrationError, NotIdentifiable
from calib.identify.monte_carlo import Campaign, simulate_and_identify
from calib.identify.solution import SUBSETS
from calib.noise.reading import IndicatorFigures
from calib.tripod.geometry import Geometry, Three, inverse
from calib.tripod.pipeline import Model, derivatives, simulate
from calib.tripod.workspace import workspace_jacobian
from tests.calib.identify.identified import choose_subset, identify
from tests.tripods import DELTA, ORTHOGLIDE

X = (1.0, 0.0, 0.0)
BAR, RADIUS = 250.0, 124.0
ANGLES = np.radians([210.0, 330.0, 90.0])
TOWERS = RADIUS * np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1)


def rings(heights: tuple[float, ...] = (0.0,), repeats: int = 1) -> Conditions:
    around = np.radians(np.arange(0.0, 360.0, 60.0) + 15.0)
    place = [[0.0, 0.0, h] for h in heights]
    place += [[r * np.cos(a), r * np.sin(a), h] for h in heights for r in (30, 80) for a in around]
    return tool_conditions(place * repeats)


def height_by_hand(place: FloatArray, offset: FloatArray, length: FloatArray) -> float:
    """Where the tool really is, z: spheres about the carriages, solved without our kinematics."""
    across = ((place[:2] - TOWERS) ** 2).sum(axis=1)
    carriage = place[2] + np.sqrt(BAR**2 - across) + offset

    def left(p: FloatArray) -> FloatArray:
        flat = ((p[:2] - TOWERS) ** 2).sum(axis=1)
        return np.asarray(flat + (carriage - p[2]) ** 2 - (BAR + length) ** 2)

    return float(root(left, place, tol=1e-13).x[2])


def readings_by_hand(place: FloatArray, parameters: FloatArray) -> FloatArray:
    offset, length = parameters[:3], parameters[3:]
    zero = height_by_hand(np.zeros(3), offset, length)
    return np.array([height_by_hand(p, offset, length) - zero for p in place])


def test_readings_are_those_of_the_geometry_written_out() -> None:
    conditions = rings((0.0, 12.0))
    parameters = np.array([0.4, -0.3, 0.2, 0.1, -0.2, 0.15])
    readings = simulate(DELTA, parameters, conditions)
    assert readings == pytest.approx(readings_by_hand(conditions.position_mm, parameters), abs=2e-6)


def test_a_plate_shows_five_of_six_combinations_and_not_what_all_towers_share() -> None:
    """Rank of derivatives by differences of independent geometry, zeros taken out."""
    conditions, step = rings(), 1e-3
    columns = [
        (readings_by_hand(conditions.position_mm, h) - readings_by_hand(conditions.position_mm, -h))
        / (2 * step)
        for h in step * np.eye(6)
    ]
    by_hand = np.stack(columns, axis=1)
    ours = derivatives(DELTA, np.zeros(6), conditions)
    assert ours == pytest.approx(by_hand, abs=2e-6)
    free = without_zeros(
        observe(conditions, np.zeros(len(conditions))), np.ones(len(conditions)), by_hand
    )
    singular, axes = np.linalg.svd(free)[1:]
    assert int((singular > 1e-4 * singular[0]).sum()) == 5
    assert np.abs(axes[5]) == pytest.approx(np.array([1, 1, 1, 0, 0, 0]) / np.sqrt(3), abs=1e-4)


def test_what_a_plate_shows_is_identified_and_the_rest_refused() -> None:
    conditions = rings(repeats=2)
    truth = np.array([0.3, -0.25, 0.1, 0.08, -0.05, 0.06])
    value = simulate(DELTA, truth, conditions) + 0.7
    observations, model = observe(conditions, value), Model(DELTA)
    with pytest.raises(NotIdentifiable, match="d_rho_x \\+ d_rho_y \\+ d_rho_z"):
        identify(model, observations, "both", indicator=IndicatorFigures(repeatability_mm=1e-5))
    solution = identify(
        model,
        observations,
        "with-tolerances",
        indicator=IndicatorFigures(repeatability_mm=1e-5),
        tolerance_mm=np.array([1.0] * 3 + [0.3] * 3),
    )
    values = np.array(solution.model.parameters_mm)
    assert values[3:] == pytest.approx(truth[3:], abs=1e-4)
    assert values[:3] - values[:3].mean() == pytest.approx(truth[:3] - truth[:3].mean(), abs=1e-4)
    assert solution.uncertainty_mm[:3] == pytest.approx([1.0 / np.sqrt(3.0)] * 3, abs=1e-3)


def test_offsets_that_a_plate_cannot_show_alone_are_viewed_with_tolerances() -> None:
    conditions, tolerance = rings(repeats=3), np.array([1.0] * 3 + [0.3] * 3)
    truth = np.array([0.3, -0.25, 0.1, 0.08, -0.05, 0.06])
    noise = np.random.default_rng(2).normal(scale=0.002, size=len(conditions))
    value = simulate(DELTA, truth, conditions) + noise
    choice = choose_subset(Model(DELTA), observe(conditions, value), tolerance_mm=tolerance)
    assert choice.usual == "with-tolerances"
    assert "joint-offsets" in choice.refused


def test_errors_of_the_tool_count_from_zero() -> None:
    assert DELTA.set_at_zero
    jacobian = workspace_jacobian(DELTA)
    assert np.abs(jacobian[:, :, :3].sum(axis=2)).max() < 1e-12
    free = workspace_jacobian(replace(DELTA, set_at_zero=False))
    assert free[:, :, :3].sum(axis=2) == pytest.approx(np.tile([0.0, 0.0, 1.0], (len(free), 1)))


def test_uncertainties_are_true_on_many_sessions() -> None:
    conditions = rings(repeats=3)
    campaign = Campaign(
        Model(DELTA),
        observe(conditions, np.zeros(len(conditions))),
        SUBSETS["leg-lengths"],
        scatter_mm=0.005,
        resolution_mm=0.0,
        spread_mm=np.full(6, 0.1),
    )
    summary = simulate_and_identify(campaign, 600, seed=1)
    assert summary.failed == 0
    assert summary.covered == pytest.approx([0.95] * 3, abs=0.035)


def test_cells_are_positions_with_the_way_there() -> None:
    """Same place from two sides: two cells; the same side again: one."""
    conditions = tool_conditions([[0.0, 0.0, 0.0], [30.0, 0.0, 0.0]] * 2 + [[30.0, 0.0, 0.0]])
    movement = np.array([[1, 1, 1], [1, -1, 1], [1, 1, 1], [1, -1, 1], [-1, 1, 1]], dtype=float)
    observations = observe(replace(conditions, movement=movement), np.zeros(5))
    assert observations.cell.tolist() == [0, 2, 0, 2, 1]
    assert [observations.posture_words(k) for k in (0, 1)] == ["(0, 0, 0) mm", "(30, 0, 0) mm"]


def moved(origin: Three | None = None, **changes: object) -> Geometry:
    return replace(DELTA, **({"origin_mm": origin} if origin else {}), **changes)  # type: ignore[arg-type]  # any field


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (
            lambda: moved((DELTA.origin_mm[2],) * 3, platform_mm=(DELTA.platform_mm[2],) * 3),
            "singular posture at Zero",
        ),
        (
            lambda: replace(ORTHOGLIDE, direction=(X, X, (0.0, 0.0, 1.0))),
            "singular posture at Zero",
        ),
        (lambda: moved(leg_length_mm=(250.0, 100.0, 250.0)), "bar y: found 100 mm long, too short"),
        (lambda: moved(leg_length_mm=(124.0,) * 3, platform_mm=DELTA.platform_mm), "bar"),
        (lambda: moved(direction=((0.0, 0.0, 0.0), *DELTA.direction[1:])), "drive x"),
        (
            lambda: moved(workspace_mm=((-150.0, -150.0, 0.0), (60.0, 60.0, 10.0))),
            "too short with the tool at",
        ),
        (lambda: moved(workspace_mm=((0.0, 0.0, 0.0), (0.0, 1.0, 1.0))), "workspace"),
    ],
)
def test_machines_that_cannot_work_are_refused(build: object, message: str) -> None:
    assert callable(build)
    with pytest.raises(CalibrationError, match=message):
        build()


def test_parallel_drives_at_different_places_are_no_fault() -> None:
    assert not DELTA.orthogonal
    assert DELTA.zero_mm == pytest.approx([np.sqrt(BAR**2 - RADIUS**2)] * 3, abs=1e-3)
    assert inverse(DELTA, [0.0, 0.0, 40.0]) == pytest.approx(DELTA.zero_mm + 40.0)


def test_directions_across_are_radial_and_tangential() -> None:
    assert list(DELTA.across) == ["xr", "xt", "yr", "yt", "zr", "zt"]
    assert DELTA.across["zr"] == pytest.approx([0.0, 1.0, 0.0])
    assert DELTA.across["zt"] == pytest.approx([-1.0, 0.0, 0.0])
    assert DELTA.towards(0, 1) == pytest.approx([1.0, 0.0, 0.0])
    assert list(ORTHOGLIDE.across) == ["xy", "xz", "yx", "yz", "zx", "zy"]
    assert ORTHOGLIDE.across["xz"].tolist() == [0.0, 0.0, 1.0]
