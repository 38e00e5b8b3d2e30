"""Legs over a reference plane in the guided session: the stand slides, one indicator reads.

What the indicators show comes from the heights that `tests.calib.tripod.test_plane` writes out, on
a plane that leans, over real serial connections.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app.evaluating.solution import solve_files
from app.measuring.doubts import Doubt
from app.measuring.gauges import Gauge
from app.measuring.indicators import simulated_indicators
from app.measuring.leg_review import review_leg
from app.measuring.opening import opened_event
from app.measuring.plan import Plan
from app.measuring.session import GuidedSession, Indicators
from app.measuring.simulated import short_travels
from app.measuring.unattended import measure_all
from app.report.charts.tripod import drawn_set_up
from app.report.text.leg_review import review_text
from app.report.text.preparing import dry_run_text
from app.report.text.questions import question_text
from app.report.text.session import point_text, set_up_text, so_far_text, step_in_list, step_text
from app.version import program
from calib.arrays import LEG_NAMES
from calib.errors import RecordError, UsageError
from drivers.profile import Query
from drivers.profiles.mitutoyo_01a import MITUTOYO_01A
from drivers.twins import SimulatedRig, default_transport
from protocols.journal import Journal
from protocols.machine import Instrument, Machine
from protocols.observations import to_observations
from protocols.procedure import Plane, Procedure, Step, load_procedure
from protocols.record import read_record
from protocols.session import fold
from tests.calib.tripod.test_plane import OFF, height

MACHINE = Machine()
BOTH = load_procedure("zero-max-min-plane", MACHINE.geometry())
ALONE = load_procedure("plane", MACHINE.geometry())
ONCE = ALONE.model_copy(update={"cycles": 1, "legs": ("x",)})
TILT = 2e-3
ACROSS = Instrument(profile="mitutoyo-01a", port="simulated", axes="yx")
ALONG = Instrument(profile="mitutoyo-01a", port="simulated", axes="zy")


def shown_mm(step: Step, axis: str, tilt: float = TILT) -> float:
    """A height over a plane that leans; from Zero it does not matter here."""
    leg, k = LEG_NAMES.index(step.leg), LEG_NAMES.index(axis)
    at = height(OFF, leg, k, step.displacement_mm, step.station)
    return at + 0.4 + tilt * (step.displacement_mm + step.station * 310.0) * step.over_plane


@contextmanager
def session(
    path: Path,
    procedure: Procedure = ONCE,
    instruments: tuple[Instrument, ...] = simulated_indicators()[:1],
    *,
    by_hand: bool = False,
    tilt: float = TILT,
) -> Iterator[tuple[GuidedSession, Callable[[Step], None]]]:
    plan = Plan(path, MACHINE, procedure, instruments)
    count = len(plan.instruments)
    profiles = [MITUTOYO_01A] * count
    with closing(SimulatedRig(profiles, resolution_mm=0.001, transport=default_transport())) as rig:
        values = [5.0] * count

        def go(step: Step) -> None:
            for number, axis in zip(step.indicators, step.axes, strict=True):
                values[number] = shown_mm(step, axis, tilt)
            rig.go(values)

        gauges = tuple(
            Gauge(
                MITUTOYO_01A,
                port,
                Query(),
                interval_s=0.01,
                window_s=0.1,
                tolerance_mm=0.004,
            )
            for port in rig.ports
        )
        for gauge in gauges:
            gauge.start()
        is_continued = path.exists()
        journal = (
            Journal.resume(path, program())
            if is_continued
            else Journal.create(path, opened_event(plan))
        )
        indicators = Indicators(gauges, None if by_hand else go)
        with GuidedSession(journal, indicators) as guided:
            yield guided, go


def test_one_set_up_for_each_leg_and_what_was_off_is_found(tmp_path: Path) -> None:
    path = tmp_path / "s.jsonl"
    procedure = ALONE.model_copy(update={"cycles": 1})
    with session(path, procedure) as (guided, _):
        measure_all(guided)
    record = read_record(path)
    measured_session = fold(record.events)
    assert record.end == "closed"
    assert measured_session.complete
    assert [(m.leg, m.over_plane, m.mounts) for m in measured_session.mountings] == [
        ("x", True, {"z": "xz-plane"}),
        ("y", True, {"z": "yz-plane"}),
    ]
    assert [
        (r.station, r.displacement_mm, r.over_plane) for r in measured_session.readings[:4]
    ] == [
        (0.1, 0.0, True),
        (0.9, 0.0, True),
        (0.1, 60.0, True),
        (0.9, 60.0, True),
    ]
    observations = to_observations([measured_session])
    assert observations.along_mm[:3] == pytest.approx([31.025, 279.225, 91.025])
    result = solve_files([path], subset="joint-offsets")
    # bars are off too (OFF): what shows along z is the height of the feet less that of the tool
    exact = [height(OFF, 0, 2, 0.0, s) for s in (0.1, 0.9)]
    assert float(observations.value_mm[1] - observations.value_mm[0]) == pytest.approx(
        exact[1] - exact[0] + TILT * 248.0, abs=0.002
    )
    assert result.solution.values_mm[2] == pytest.approx(OFF[2] - OFF[5], abs=0.05)


def test_a_stand_that_was_not_slid_is_asked_about(tmp_path: Path) -> None:
    with session(tmp_path / "s.jsonl", by_hand=True) as (guided, go):
        go(guided.steps[0])
        first = guided.take()
        assert first is not None
        assert first.doubt is None
        forgotten = guided.take()
        assert forgotten is not None
        assert forgotten.doubt is Doubt.UNCHANGED
        assert "Unchanged since ZERO 0.1: did machine or stand move?" in question_text(
            forgotten, guided.session
        )
        go(guided.steps[1])
        slid = guided.take()
        assert slid is not None
        assert slid.doubt is None


def test_after_a_break_the_stand_has_a_new_zero(tmp_path: Path) -> None:
    path = tmp_path / "s.jsonl"
    with session(path) as (guided, _):
        for _ in range(3):
            guided.go()
            guided.take()
        guided.leave()
    with session(path) as (guided, _):
        measure_all(guided)
    mounts = [r.mount for r in fold(read_record(path).events).readings]
    assert mounts == ["xz-plane"] * 3 + ["xz-plane#2"] * 5


def test_the_indicator_that_may_measure_across_the_plane_reads(tmp_path: Path) -> None:
    assert Plan(tmp_path / "s", MACHINE, ALONE, (ACROSS, ALONG)).instruments == (ALONG,)
    with pytest.raises(UsageError, match="one along z, over the plane"):
        Plan(tmp_path / "s", MACHINE, ALONE, (ACROSS,))
    short = BOTH.model_copy(update={"cycles": 1})
    path = tmp_path / "t.jsonl"
    with session(path, short, (ACROSS, ALONG)) as (guided, _):
        measure_all(guided)
        over = [step for step in guided.steps if step.over_plane]
        assert {step.indicators for step in over} == {range(1, 2)}
    measured_session = fold(read_record(path).events)
    observations = to_observations([measured_session])
    assert set(observations.indicator[observations.over_plane].tolist()) == {1}
    assert measured_session.complete


def test_what_the_operator_reads_over_a_plane(tmp_path: Path) -> None:
    geometry = MACHINE.geometry()
    with session(tmp_path / "s.jsonl") as (guided, _):
        first, second, third, *_ = guided.steps
        keys = {"measure.where": "W", "measure.take": "Space"}
        lines = step_text(first, guided.session).splitlines()
        for key_id, key in keys.items():
            lines = [line.replace(f"{{{key_id}}}", key) for line in lines]
        assert lines[:3] == [
            "LEG X   ZERO   cycle 1 of 1",
            "First, at Zero: stand on the plane under leg X, indicator along Z (1). W shows it.",
            "Move the tool to X +0.00 mm. Slide the stand to 31 mm from its tool end (10%); Space.",
        ]
        assert step_in_list(second, geometry, "1") == "X ZERO 0.9"
        guided.go()
        guided.take()
        slide = (
            "The machine stays. Slide the stand to 279 mm from its tool end (90%); {measure.take}."
        )
        assert step_text(second, guided.session).splitlines()[1] == slide
        assert "The stand slides on the plane." in set_up_text(guided.session, second, [ALONG])
        picture = drawn_set_up(guided.session, third, [ALONG])
        assert picture is not None
        assert picture.title == "Leg X at MAX"
        while guided.step():
            guided.go()
            guided.take()
        heading, row = so_far_text(guided.session, guided.steps, first).splitlines()
        assert heading.split() == ["far", "−", "near", "ZERO", "MAX", "MIN", "back", "at", "Zero"]
        expected = [
            shown_mm(replace(first, displacement_mm=at, station=0.9), "z")
            - shown_mm(replace(first, displacement_mm=at), "z")
            for at in (0.0, 60.0, -100.0)
        ]
        assert [float(cell) for cell in row.split()[3:]] == pytest.approx(
            [*expected, 0.0], abs=0.002
        )
        assert point_text(second, guided.session).startswith("step   2  leg X  ZERO 0.9")
        assert review_text(review_leg(guided.session, first), guided.session).startswith(
            "✓ Leg X is done."
        )
    text = dry_run_text(BOTH, MACHINE, (ACROSS, ALONG))
    last = next(line for line in text.split("\n") if line.split()[:1] == ["67"])
    assert " ".join(last.split()) == "67 y MIN 3 p 0.1 z 2 G53 G0 X0.000 Y-100.000 Z0.000"
    assert "2: the second one reads" in text


def test_a_plane_that_leans_too_far_is_no_plane(tmp_path: Path) -> None:
    path = tmp_path / "s.jsonl"
    with session(path, ALONE.model_copy(update={"cycles": 1}), tilt=9e-3) as (guided, _):
        measure_all(guided)
    message = r"plane under leg X along Z, from reading 1 on: found tilted by \+9\.\d mrad"
    with pytest.raises(RecordError, match=message + r".*up to 5 mrad, plane_tilt_mrad"):
        solve_files([path], subset="joint-offsets")


def test_a_plane_that_ends_too_early_names_posture_and_limit() -> None:
    machine = Machine(plane_mm=(0.0, 300.0))
    procedure = BOTH.model_copy(update={"plane": Plane(stations=(0.1, 0.9))})
    message = r"station 0\.9 of leg x in posture MAX at 339\.2 mm.*plane_mm .*0 … 300 mm"
    with pytest.raises(RecordError, match=message):
        procedure.check_bars(machine.geometry())
    low = Machine(plane_mm=(-50.0, 400.0))
    with pytest.raises(RecordError, match=r"station 0\.1 of leg x in posture MIN at -69\.0 mm"):
        procedure.check_bars(low.geometry())


def test_the_way_of_a_spindle_over_a_plane() -> None:
    """By the standard deviations of height differences on machines drawn within tolerances."""
    chance = np.random.default_rng(3)
    limits = np.repeat([2.0, 0.1], 3)
    places = [(at, s) for at in (0.0, 60.0, -100.0) for s in (0.1, 0.9)]
    rows = []
    for _ in range(300):
        off = chance.normal(scale=limits)
        tilt = chance.normal(scale=2.5e-3)
        rows.append([height(off, 0, 2, *p) + tilt * (p[0] + p[1] * 310.25) for p in places])
    drawn = np.array(rows)
    spread = max(2.0 * np.std(drawn[:, a] - drawn[:, b]) for a in range(6) for b in range(6))
    instrument = ALONG.model_copy(update={"travel_mm": 0.1})
    ((_, needed_mm, where),) = short_travels(ALONE, MACHINE, (instrument,))
    assert where == "along Z of leg X, over the plane"
    assert needed_mm == pytest.approx(spread, rel=0.15)
