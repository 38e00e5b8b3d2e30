"""Indicators stay on the usable part of the bar: whatever is measured, and whatever is proposed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from app.evaluating.loading import load_sessions
from app.evaluating.solution import solve_sessions
from app.measuring.indicators import simulated_indicators
from app.measuring.opening import begin
from app.measuring.plan import plan_to_repeat
from app.measuring.session import Indicators
from app.measuring.simulated import planned_readings, short_travels, simulated_session
from app.planning.tripod import stated_noise
from calib.arrays import LEG_NAMES, FloatArray, conditions
from calib.errors import CalibrationError, ImpossibleRequest, NotIdentifiable, RecordError
from calib.posterior.measurements import set_ups_of
from calib.tripod.geometry import Geometry
from calib.tripod.optimum import optimum_postures
from calib.tripod.pipeline import Model, derivatives
from calib.tripod.planning import TripodPlanning
from calib.tripod.pool import leg_pool
from protocols.journal import write_whole
from protocols.machine import Drive, Instrument, Machine
from protocols.procedure import Leg, Procedure, load_procedure
from tests.app.cli import refused
from tests.conftest import LONG

RAW = 0.002
"""Of a bar: by so much a raw machine and a way straight in joint coordinates leave the interval."""

EDGE_MM = 0.001
"""A touched point is judged to a millionth of the bar."""

NOISE = stated_noise(Machine(), 0.02)[0]

WAY = np.linspace(0.0, 1.0, 6)

FEW = settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))
VERY_FEW = settings(max_examples=6, deadline=None, suppress_health_check=list(HealthCheck))

MINE = Procedure.model_validate(
    {"schema": "glidecal.procedure/1", "name": "mine", "title": "t", "cycles": 1}
    | {"levels": ("zero", 5.0, -5.0)}
)


@st.composite
def machines(draw: st.DrawFn) -> Machine:
    """Of the Orthoglide's kind: bars of three lengths, a wide platform, each bar's own interval."""
    length = draw(st.floats(150.0, 600.0))
    part = st.tuples(st.floats(0.02, 0.4), st.floats(0.6, 0.98))
    wide = st.floats(-0.05 * length, 0.05 * length)
    drives = [
        Drive(
            origin_mm=(0.0, 0.0, 0.0),
            direction=(float(k == 0), float(k == 1), float(k == 2)),
            platform_mm=draw(st.tuples(wide, wide, wide)),
            leg_length_mm=length * draw(st.floats(0.9, 1.1)),
            usable_bar=draw(part),
        )
        for k in range(3)
    ]
    return Machine(
        leg_length_mm=length,
        travel_max_mm=length * draw(st.floats(0.05, 0.3)),
        travel_min_mm=-length * draw(st.floats(0.05, 0.4)),
        drive=(drives[0], drives[1], drives[2]),
    )


@st.composite
def errors_mm(draw: st.DrawFn) -> FloatArray:
    """Joint offsets and lengths at three standard deviations of the usual tolerances."""
    return np.array([draw(st.floats(-6.0, 6.0)) for _ in range(3)] + [0.3, -0.3, 0.3])


class Plain:
    """One machine with errors, worked out without the program: spheres cut by linear equations."""

    def __init__(self, machine: Machine, wrong_mm: FloatArray) -> None:
        assert machine.drive is not None
        self.along = np.array([drive.direction for drive in machine.drive])
        self.held = np.array([drive.platform_mm for drive in machine.drive])
        self.length = np.array([drive.leg_length_mm for drive in machine.drive])
        self.wrong = wrong_mm

    def joints(self, tool: FloatArray) -> FloatArray:
        ends = tool + self.held
        ahead = (ends * self.along).sum(axis=1)
        return np.asarray(ahead + np.sqrt(self.length**2 - (ends**2).sum(axis=1) + ahead**2))

    def tool_and_feet(self, joints: FloatArray) -> tuple[FloatArray, FloatArray]:
        feet = self.along * (joints + self.wrong[:3])[:, None]
        middle, radius = feet - self.held, self.length + self.wrong[3:]
        square = (middle**2).sum(axis=1) - radius**2
        planes, sides = 2.0 * (middle[1:] - middle[0]), square[1:] - square[0]
        line = np.cross(*planes)
        line /= np.linalg.norm(line)
        start = np.linalg.lstsq(planes, sides, rcond=None)[0] - middle[0]
        half = start @ line
        root = np.sqrt(half**2 - start @ start + radius[0] ** 2)
        tools = [middle[0] + start + (sign * root - half) * line for sign in (1.0, -1.0)]
        # the tool is nearer to the origin of the drives than its mirror image
        return min(tools, key=lambda tool: float(tool @ tool)), feet

    def touched(self, leg: int, station: float, joints: FloatArray) -> float:
        where = []
        for at in (self.joints(np.zeros(3)), joints):
            tool, feet = self.tool_and_feet(at)
            where.append(((tool + self.held[leg]) @ self.along[leg], feet[leg] @ self.along[leg]))
        (end_zero, foot_zero), (end, foot) = where
        point = end_zero + station * (foot_zero - end_zero)
        return float((point - end) / (foot - end))

    def on_the_way(self, leg: int, station: float, levels: Sequence[float]) -> Iterator[float]:
        """From Zero over every level, straight for the tool and straight for the joints."""
        for a, b in pairwise([0.0, *levels]):
            first, last = (self.joints(level * self.along[leg]) for level in (a, b))
            for t in WAY:
                tool = (a + t * (b - a)) * self.along[leg]
                yield self.touched(leg, station, self.joints(tool))
                yield self.touched(leg, station, first + t * (last - first))


def assert_on_bar(
    machine: Machine, wrong_mm: FloatArray, leg: int, station: float, levels: Sequence[float]
) -> None:
    low, high = machine.geometry().usable_bar[leg]
    for fraction in Plain(machine, wrong_mm).on_the_way(leg, station, levels):
        assert low - RAW <= fraction <= high + RAW
        assert 0.0 < fraction < 1.0


@FEW
@given(machines(), st.floats(0.02, 0.98), st.floats(-0.3, 0.25))
def test_the_fraction_is_linear_and_that_of_plain_geometry(
    machine: Machine, station: float, part: float
) -> None:
    plain, geometry = Plain(machine, np.zeros(6)), machine.geometry()
    for leg in range(3):
        level = part * machine.leg_length_mm
        there = geometry.touched(np.array([leg]), np.array([station]), np.array([level]))[0]
        exact = plain.touched(leg, station, plain.joints(level * plain.along[leg]))
        assert there == pytest.approx(exact, abs=1e-9)
        low, high = geometry.span_mm(leg, station)
        levels_mm = np.array([0.0, level])
        on = geometry.on_bar(np.array([leg] * 2), np.array([station] * 2), levels_mm).all()
        reached = machine.travel_min_mm <= level <= machine.travel_max_mm
        lowest, highest = min(level, 0.0), max(level, 0.0)
        if low <= lowest and highest <= high:
            assert on
            assert reached
        if on and reached:
            assert low - EDGE_MM <= lowest
            assert highest <= high + EDGE_MM


@FEW
@given(
    machines(),
    errors_mm(),
    st.lists(st.floats(0.05, 0.95), min_size=1, max_size=3, unique=True),
    st.lists(st.floats(0.0, 1.0), min_size=2, max_size=4, unique=True),
)
def test_what_is_measured_and_simulated_stays_on_the_bar(
    machine: Machine, wrong_mm: FloatArray, stations: list[float], parts: list[float]
) -> None:
    low, high = machine.travel_min_mm, machine.travel_max_mm
    levels = [low + part * (high - low) for part in parts]
    assume(len({*levels}) > 1)
    fields = {"stations": tuple(stations), "levels": tuple(levels)}
    procedure = Procedure.model_validate(MINE.model_dump(by_alias=True) | fields)
    geometry = machine.geometry()
    try:
        planned = planned_readings(procedure, machine)
    except RecordError:
        plain = Plain(machine, np.zeros(6))
        nominal = [
            not lowest <= fraction <= highest
            for leg, (lowest, highest) in enumerate(geometry.usable_bar)
            for station in stations
            for fraction in plain.on_the_way(leg, station, levels)
        ]
        assert any(nominal)
        return
    assert planned.displacement_mm.size
    for leg in range(3):
        for station in stations:
            assert_on_bar(machine, wrong_mm, leg, station, levels)


@LONG
@FEW
@given(machines(), errors_mm())
def test_what_plan_and_next_propose_stays_on_the_bar(
    machine: Machine, wrong_mm: FloatArray
) -> None:
    geometry = machine.geometry()
    for set_up in set_ups_of(Model(geometry)):
        for name in set_up.legs:
            leg = LEG_NAMES.index(name)
            assert_on_bar(machine, wrong_mm, leg, set_up.station, set_up.levels_mm)


@LONG
@VERY_FEW
@given(machines(), errors_mm(), st.booleans())
def test_chosen_postures_and_the_turns_between_them_stay_on_the_bar(
    machine: Machine, wrong_mm: FloatArray, common: bool
) -> None:
    planning = TripodPlanning(
        name="random",
        geometry=machine.geometry(),
        procedure="mine",
        planned=planned_readings(MINE, machine),
        of_tool=False,
        stations=(0.5,),
        step_count=12,
        mounting_count=3,
        seconds_per_step=20.0,
        minutes_per_mounting=2.0,
        noise=NOISE,
        noise_words="",
    )
    try:
        optimum = optimum_postures(planning, 12, starts=1, common=common)
    except (ImpossibleRequest, NotIdentifiable):
        assume(False)
    assert optimum.orders
    for (leg, station), levels in optimum.orders.items():
        assert_on_bar(machine, wrong_mm, leg, station, levels)


@pytest.mark.parametrize("part", [(0.9, 0.2), (0.5, 0.5)])
def test_an_empty_interval_is_refused(part: tuple[float, float]) -> None:
    with pytest.raises(
        ValueError, match=r"usable_bar of bar x: found 0\.\d … 0\.\d, not a part of it"
    ):
        Machine(usable_bar=part)
    with pytest.raises(CalibrationError):
        Geometry(usable_bar=((0.05, 0.95), (0.05, 0.95), part))


def test_an_interval_without_a_station_leaves_nothing_to_choose() -> None:
    narrow = Machine(usable_bar=(0.85, 0.95)).geometry()
    with pytest.raises(ImpossibleRequest, match="Widen usable_bar"):
        leg_pool(narrow)
    assert not list(set_ups_of(Model(narrow)))


def test_candidates_that_the_default_pool_lost() -> None:
    """480 candidates before; 21 were off the bar, 24 more within a twentieth of its ends."""
    free = leg_pool(Geometry(usable_bar=((0.0, 1.0),) * 3))
    assert (len(free), len(leg_pool(Geometry()))) == (480 - 21, 480 - 45)
    fraction = free.station - free.displacement_mm / 310.25
    assert 0.0 <= fraction.min() < 0.01
    assert 0.95 < fraction.max() <= 1.0


@pytest.mark.parametrize(("axis", "travel_mm", "short"), [("y", 1.0, True), ("y", 12.0, False)])
def test_a_short_indicator_is_named(axis: Leg, travel_mm: float, short: bool) -> None:
    machine, procedure = Machine(), load_procedure("zero-max-min", Geometry())
    gauge = Instrument(profile="a", axes=axis + "xz", travel_mm=travel_mm)
    shortages = short_travels(procedure, machine, (gauge, Instrument(profile="b")))
    assert len(shortages) == short
    for instrument, needed_mm, where in shortages:
        assert (instrument, where) == (gauge, "along Y of leg X, station 0.5")
        # independent: many machines with errors of these tolerances, 95 % of them need less
        plan = conditions([0] * 3, [1] * 3, [0.0, 60.0, -100.0])
        slopes = derivatives(Geometry(), np.zeros(6), plan)
        drawn = np.random.default_rng(1).normal(size=(20_000, 6)) * machine.tolerances_mm()
        spans = np.ptp(drawn @ slopes.T, axis=1)
        assert needed_mm == pytest.approx(float(np.quantile(spans, 0.95)), rel=0.15)


OFF = """schema = "glidecal.procedure/1"
name = "off"
title = "t"
cycles = 2
stations = [0.5,
    0.8]
levels = ["zero", "max", "min"]
"""


@pytest.mark.parametrize(
    "verb", [("run", "--dry-run"), ("run", "--simulated", "--headless"), ("simulate",)]
)
def test_a_station_that_a_posture_does_not_reach_is_named(
    tmp_path: Path, verb: tuple[str, ...]
) -> None:
    path = tmp_path / "off.toml"
    path.write_text(OFF, encoding="utf-8")
    message = refused(3, *verb, "--protocol", path, "-o", tmp_path / "s.jsonl")
    assert "off.toml, line 6, stations: found station 0.8 of leg x touched at 1.122" in message
    assert "in posture MIN; usable is 0.05 … 0.95. Allowed:" in message
    assert not (tmp_path / "s.jsonl").exists()


def test_an_older_record_with_such_points_is_solved_and_not_repeated(tmp_path: Path) -> None:
    free, path = Machine(usable_bar=(0.0, 1.0)), tmp_path / "old.jsonl"
    fields = {"stations": (0.5, 0.65), "levels": ("zero", "max", "min")}
    procedure = Procedure.model_validate(MINE.model_dump(by_alias=True) | fields)
    session = simulated_session(
        procedure, free, Model(), seed=1, scatter_mm=0.002, resolution_mm=0.001
    )
    older = {"machine": Machine(), "instruments": simulated_indicators()}
    write_whole(path, session.opened.model_copy(update=older), [*session.readings])
    sessions, warnings = load_sessions([path])
    assert len(sessions[0].readings) == len(session.readings)
    assert warnings == [
        "old.jsonl: readings off the bars: 6, the first at station 0.65 of leg x touched at 0.972 "
        "of the bar in posture MIN; usable is 0.05 … 0.95. They are used as if the bar "
        "continued there."
    ]
    assert solve_sessions(sessions).reading_count == len(session.readings)
    again = plan_to_repeat(path)
    assert again is not None
    with pytest.raises(RecordError, match=r"station 0\.65 of leg x touched at 0\.972"):
        begin(replace(again, path=tmp_path / "new.jsonl"), Indicators(()))
