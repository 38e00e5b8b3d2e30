"""Legs over a reference plane (papers/000, fig. 4a): forward model, what is seen, what is found.

The machine is written out here once more: three spheres about the feet, a point on a bar, its
height over a tilted plane.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import product

import numpy as np
import pytest

from app.measuring.simulated import planned_readings
from calib.arrays import Conditions, FloatArray, Observations, observe, set_up_unknowns
from calib.diagnosis.gap import Leftover
from calib.errors import NotIdentifiable
from calib.identify.fit import PlainFit
from calib.noise.reading import IndicatorFigures, visit_means
from calib.posterior.cells import Cells, SessionCase
from calib.tripod.effects.bars import LegBow
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.geometry import Geometry
from calib.tripod.pipeline import Model, command, derivatives, simulate
from calib.tripod.plain import TripodDesign, plain_design
from protocols.machine import Machine
from protocols.procedure import Plane, Procedure, load_procedure
from tests.calib.identify.identified import identify

NOMINAL = Geometry()
L_MM = 310.25
SIGMA_MM = 0.01
OFF = np.array([1.2, -0.9, 1.7, 0.05, -0.04, 0.08])


def taken_by(name: str) -> Observations:
    return planned_readings(load_procedure(name, NOMINAL), Machine())


def measured(
    name: str, parameters: FloatArray, tilt: float = 0.0, scatter: float = 0.0
) -> Observations:
    """A session of a machine; zeros and tilts of the planes at random, scatter as asked."""
    conditions = taken_by(name)
    generator = np.random.default_rng(4)
    over = conditions.over_plane
    values = np.asarray(simulate(NOMINAL, parameters, conditions))
    values = values + generator.normal(size=conditions.mount_count)[conditions.mount]
    slope = tilt * generator.normal(size=conditions.mount_count)[conditions.mount]
    values[over] += (slope * conditions.along_mm)[over]
    return observe(conditions, values + scatter * generator.normal(size=len(conditions)))


def height(
    parameters: FloatArray, leg: int, axis: int, displacement: float, station: float
) -> float:
    """The touched point's coordinate by plain geometry."""
    joints = np.full(3, np.sqrt(L_MM**2 - displacement**2))
    joints[leg] = L_MM + displacement
    feet = np.diag(joints + parameters[:3])
    lengths = L_MM + parameters[3:]

    tool = np.zeros(3)
    tool[leg] = displacement
    for _ in range(8):  # Newton on the three spheres
        miss = ((tool - feet) ** 2).sum(axis=1) - lengths**2
        tool = tool - np.linalg.solve(2.0 * (tool - feet), miss)
    return float((tool + station * (feet[leg] - tool))[axis])


def test_readings_are_heights_of_the_bar() -> None:
    conditions = taken_by("plane")
    expected = [
        height(OFF, int(leg), int(axis), float(at), float(station))
        for leg, axis, at, station in zip(
            conditions.leg,
            conditions.axis,
            conditions.displacement_mm,
            conditions.station,
            strict=True,
        )
    ]
    assert np.ptp(expected) > 1.0
    assert simulate(NOMINAL, OFF, conditions) == pytest.approx(np.array(expected), abs=1e-9)


def test_the_closed_form_and_its_derivatives_are_the_pipeline() -> None:
    conditions = taken_by("zero-max-min-plane")
    design = plain_design(NOMINAL, conditions)
    assert isinstance(design, TripodDesign)
    value, slope = design.readings_and_derivatives(OFF[:, None])
    assert value[:, 0] == pytest.approx(simulate(NOMINAL, OFF, conditions), abs=1e-11)
    assert pytest.approx(derivatives(NOMINAL, OFF, conditions), abs=1e-11) == slope[:, :, 0].T


@pytest.mark.parametrize("method", ["exact", "linear"])
def test_neither_zero_nor_tilt_of_a_plane_matters(method: str) -> None:
    """Noise-free sessions over planes off by 10 mm in 1 m give the machine back."""
    figures = IndicatorFigures(repeatability_mm=SIGMA_MM)
    solution = identify(
        Model(), measured("zero-max-min-plane", OFF, tilt=0.01), "both", indicator=figures
    )
    assert solution.values_mm == pytest.approx(OFF, abs=1e-7)
    if method == "linear":  # of first order: small errors, weighted by covariance
        small = 1e-4 * OFF
        session = measured("zero-max-min-plane", small, tilt=0.01)
        solution = identify(
            Model(), session, "both", "linear", weights="covariance", indicator=figures
        )
        assert solution.values_mm == pytest.approx(small, abs=1e-7)


def test_a_tilt_over_all_the_table_is_of_first_order_only() -> None:
    """A plane tilted by 1 mrad under a leg 2 mm off its place: less than 2 µm of offset."""
    parameters = np.array([2.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    conditions = taken_by("zero-max-min-plane")
    values = np.array(simulate(NOMINAL, parameters, conditions))
    along = conditions.along_mm + 2.0  # where the bar is in truth
    values[conditions.over_plane] += 1e-3 * along[conditions.over_plane]
    solution = identify(
        Model(),
        observe(conditions, values),
        "joint-offsets",
        indicator=IndicatorFigures(repeatability_mm=SIGMA_MM),
    )
    assert solution.values_mm == pytest.approx(parameters[:3], abs=2e-3)


def test_what_the_plane_shows_alone() -> None:
    """Both sums d_rho + d_L of legs x and y stay hidden; of six combinations four are seen."""
    conditions = visit_means(taken_by("plane"))
    assert set_up_unknowns(conditions) == 4  # a zero and a tilt for each of two legs
    with pytest.raises(NotIdentifiable, match="d_rho_x \\+ d_L_x; d_rho_y \\+ d_L_y"):
        identify(
            Model(), measured("plane", OFF), indicator=IndicatorFigures(repeatability_mm=SIGMA_MM)
        )


def test_zero_and_tilt_of_a_plane_never_reach_the_diagnosis() -> None:
    """They are in its base: the same readings on other planes leave the same."""
    figures = IndicatorFigures(repeatability_mm=SIGMA_MM)
    tolerance = np.repeat([2.0, 0.1], 3)
    leftovers = []
    for tilt in (0.0, 4e-3):
        observations = measured("zero-max-min-plane", OFF, tilt=tilt, scatter=SIGMA_MM)
        cells = Cells.of(SessionCase(Model(), observations, figures, tolerance))
        leftovers.append(Leftover.of([cells]))
    assert leftovers[1].left == pytest.approx(leftovers[0].left, abs=1e-5)
    assert float(np.abs(leftovers[0].left).max()) > 0.5
    (cells,) = leftovers[0].sessions
    assert cells.zeros.T @ cells.zeros == pytest.approx(np.eye(cells.zeros.shape[1]), abs=1e-9)
    assert cells.zeros.shape[1] == 6 + 2 * 2  # zeros, zeros and tilts over planes
    assert leftovers[0].freedom == len(cells.means) - (6 + 2 * 2 + 3)  # and joint offsets


def test_a_bowed_bar_over_a_plane_by_hand() -> None:
    """A parabola over the bar: at s it stands 4 s (1 - s) out, wherever the posture is."""
    conditions = taken_by("plane")
    bow = EffectInstance(LegBow(), "xz", (0.05,))
    change = Model(effects=(bow,)).readings(conditions) - Model().readings(conditions)
    expected = np.where(
        conditions.leg == 0, 0.05 * 4 * conditions.station * (1 - conditions.station), 0.0
    )
    assert change == pytest.approx(expected, abs=1e-12)


def uncertainty(rows: FloatArray, zeros: FloatArray, free: range = range(6)) -> FloatArray:
    """Least squares with everything in ``zeros`` unknown; one reading of each, σ = 0.01 mm."""
    design = np.hstack([rows[:, list(free)], zeros]) / SIGMA_MM
    return np.asarray(np.sqrt(np.linalg.inv(design.T @ design).diagonal())[: len(free)])


def from_zero() -> tuple[FloatArray, FloatArray]:
    """Derivatives of 18 readings of zero-max-min by central differences, and their zeros."""
    places = [
        (i, j, d) for i, j in product(range(3), range(3)) if i != j for d in (0.0, 60.0, -100.0)
    ]

    def value(parameters: FloatArray, leg: int, axis: int, at: float) -> float:
        """Where the bar crosses the coordinate of its middle at Zero, (10)."""
        middle = height(parameters, leg, leg, 0.0, 0.5)
        ends = [height(parameters, leg, leg, at, s) for s in (0.0, 1.0)]
        share = (middle - ends[0]) / (ends[1] - ends[0])
        return height(parameters, leg, axis, at, float(share))

    rows = by_differences([partial(at_place, value, place) for place in places])
    return rows, np.asarray(np.kron(np.eye(6), np.ones((3, 1))), dtype=np.float64)


def at_place(
    value: Callable[..., float], place: tuple[float, ...], parameters: FloatArray
) -> float:
    return value(parameters, *place)


def by_differences(values: Sequence[Callable[[FloatArray], float]]) -> FloatArray:
    step = 1e-3
    rows = [[(f(step * e) - f(-step * e)) / (2 * step) for e in np.eye(6)] for f in values]
    return np.array(rows)


def over_planes(
    axes: tuple[int, ...], stations: tuple[float, float]
) -> tuple[FloatArray, list[tuple[int, int, float, float]]]:
    """Derivatives of heights of legs across these axes, in Zero, Max and Min."""
    places = [
        (leg, axis, at, station)
        for axis in axes
        for leg in range(3)
        if leg != axis
        for at in (0.0, 60.0, -100.0)
        for station in stations
    ]
    return by_differences([partial(at_place, height, place) for place in places]), places


@pytest.mark.parametrize(
    ("axes", "stations", "zero", "tilted", "full", "offsets"),
    [
        # the one plane that the papers allow, own zero in each posture: only z gains
        ((2,), (0.1, 0.9), "posture", False, (0.7252, 0.2889), (0.0173, 0.0067)),
        # one zero for each leg: an indicator that keeps its height along the plane
        ((2,), (0.1, 0.9), "leg", False, (0.7247, 0.2031), (0.0156, 0.0067)),
        ((2,), (0.1, 0.9), "leg", True, (0.7247, 0.2248), (0.0170, 0.0131)),
        # three planes, square to each other with the drives
        ((0, 1, 2), (0.1, 0.9), "posture", False, (0.2757, 0.2757), (0.0065, 0.0065)),
        ((0, 1, 2), (0.1, 0.9), "leg", False, (0.1874, 0.1874), (0.0064, 0.0064)),
        ((0, 1, 2), (0.1, 0.9), "leg", True, (0.2221, 0.2221), (0.0113, 0.0113)),
    ],
)
def test_what_4a_adds_to_4b(
    axes: tuple[int, ...],
    stations: tuple[float, float],
    zero: str,
    tilted: bool,
    full: tuple[float, float],
    offsets: tuple[float, float],
) -> None:
    """d_rho_x and d_rho_z, mm; 4b alone gives 0.726 and 0.019."""
    base, zeros = from_zero()
    assert uncertainty(base, zeros)[:3] == pytest.approx([0.726] * 3, abs=5e-4)
    assert uncertainty(base, zeros, range(3)) == pytest.approx([0.0194] * 3, abs=5e-5)
    added, places = over_planes(axes, stations)
    keys = [(leg, axis, at if zero == "posture" else 0.0) for leg, axis, at, _ in places]
    legs = [(leg, axis) for leg, axis, _, _ in places]
    unknown = [
        np.array([[key == column for column in dict.fromkeys(keys)] for key in keys], dtype=float)
    ]
    if tilted:
        along = np.array([at + station * L_MM for _, _, at, station in places])
        of_leg = np.array(
            [[leg == column for column in dict.fromkeys(legs)] for leg in legs], dtype=float
        )
        unknown.append(along[:, None] * of_leg)
    zeros_block = np.hstack(unknown)
    rows = np.vstack([base, added])
    design = np.zeros((len(rows), 6 + zeros_block.shape[1]))
    design[: len(base), :6], design[len(base) :, 6:] = zeros, zeros_block
    of_full, of_offsets = uncertainty(rows, design), uncertainty(rows, design, range(3))
    assert (of_full[0], of_full[2]) == pytest.approx(full, abs=1e-4)
    assert (of_offsets[0], of_offsets[2]) == pytest.approx(offsets, abs=1e-4)


def test_the_program_promises_what_the_covariance_says() -> None:
    """One cycle of both techniques, tilt unknown: the third row above."""
    steps = Procedure(
        schema="glidecal.procedure/1",
        name="once",
        title="once",
        cycles=1,
        levels=("zero", "max", "min"),
        plane=Plane(),
        return_to_zero=False,
    )
    observations = planned_readings(steps, Machine())
    solution = identify(
        Model(), observations, indicator=IndicatorFigures(repeatability_mm=SIGMA_MM)
    )
    stated = np.sqrt(solution.covariance_mm2.diagonal())
    assert (stated[0], stated[2]) == pytest.approx((0.7247, 0.2248), abs=1e-4)


def test_intervals_hold_the_truth() -> None:
    """300 sessions with tilts and noise: 95 % of the intervals of d_rho_z."""
    conditions = taken_by("zero-max-min-plane")
    weight = np.full(len(conditions), SIGMA_MM**-2.0)
    generator = np.random.default_rng(2)
    over = np.nan_to_num(conditions.along_mm)[:, None]
    values = np.asarray(simulate(NOMINAL, OFF, conditions))[:, None]
    values = values + generator.normal(size=(conditions.mount_count, 300))[conditions.mount]
    values = (
        values
        + over * 1e-3 * generator.normal(size=(conditions.mount_count, 300))[conditions.mount]
    )
    values = values + SIGMA_MM * generator.normal(size=values.shape)
    optimum = PlainFit(Model(), conditions, tuple(range(6)), weight).solve(values)
    assert optimum.converged.all()
    stated = identify(
        Model(),
        observe(conditions, values[:, 0]),
        indicator=IndicatorFigures(repeatability_mm=SIGMA_MM),
    )
    assert stated.noise.standard_deviation_mm == pytest.approx(SIGMA_MM, rel=0.3)
    uncertainty_mm = (
        np.sqrt(stated.covariance_mm2.diagonal()) * SIGMA_MM / stated.noise.standard_deviation_mm
    )
    off = optimum.values - OFF[:, None]
    assert off.std(axis=1) == pytest.approx(uncertainty_mm, rel=0.12)
    coverage = (np.abs(off) < 1.96 * uncertainty_mm[:, None]).mean(axis=1)
    assert (coverage > 0.91).all()


def test_steps_slide_the_stand_and_keep_the_set_up() -> None:
    steps = load_procedure("plane", NOMINAL).steps(NOMINAL)
    assert len(steps) == 2 * (3 * 3 + 1) * 2
    assert [s.station for s in steps[:4]] == [0.1, 0.9, 0.1, 0.9]
    assert len({s.place for s in steps}) == 2
    assert {(s.leg, s.axes) for s in steps} == {("x", ("z",)), ("y", ("z",))}
    assert load_procedure("plane", NOMINAL).repeats_in_place(NOMINAL) == 0
    conditions: Conditions = taken_by("plane")
    assert len(visit_means(taken_by("plane"))) == len(steps)
    assert command(NOMINAL, conditions).shape == (len(steps), 3)
