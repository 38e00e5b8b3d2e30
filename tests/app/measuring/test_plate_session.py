"""Plates in the guided session: positions in the place of legs, one indicator at the tool.

The machine behind the indicators is that of `tests.app.exports.upright_towers`, written from the
geometry; the indicators answer over real serial connections.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import numpy as np
import pytest

from app.measuring.doubts import Doubt
from app.measuring.gauges import Gauge
from app.measuring.indicators import simulated_indicators
from app.measuring.leg_review import review_leg
from app.measuring.opening import opened_event, start_session
from app.measuring.plan import QUICK_INTERVAL_S, Plan
from app.measuring.session import GuidedSession, Indicators
from app.measuring.unattended import measure_all
from app.report.text.leg_review import review_text
from app.report.text.questions import question_text
from app.report.text.session import point_text, so_far_text, step_in_list, step_text
from app.version import program
from calib.errors import UsageError
from drivers.profile import Query
from drivers.profiles.mitutoyo_01a import MITUTOYO_01A
from drivers.twins import SimulatedRig, default_transport
from protocols.journal import Journal
from protocols.machine import Instrument, load_machine
from protocols.procedure import Procedure, Step, load_procedure
from protocols.record import read_record
from protocols.session import fold
from tests.app.cli import glidecal
from tests.app.exports.upright_towers import BELIEVED, Hidden, errors, klipper, rms
from tests.conftest import LONG

MACHINE = load_machine("linear-delta")
RINGS = load_procedure("plate-rings", MACHINE.geometry())
OFF = Hidden((0.5, -0.4, 0.3), (0.12, -0.1, 0.06))
SCATTER_MM = 0.002


def short(**plate: object) -> Procedure:
    fields = {"radii_mm": (0.0, 60.0), "points": 3, **plate}
    return Procedure.model_validate(RINGS.model_dump() | {"cycles": 1, "plate": fields})


def plan(path: Path, procedure: Procedure = RINGS) -> Plan:
    return Plan(path, MACHINE, procedure, simulated_indicators(), interval_s=QUICK_INTERVAL_S)


@contextmanager
def session(
    path: Path, hidden: Hidden, procedure: Procedure, *, by_hand: bool = False
) -> Iterator[tuple[GuidedSession, Callable[[Step], None]]]:
    """A session at the hidden machine; the second says where the machine is sent."""
    chance = np.random.default_rng(5)
    with closing(
        SimulatedRig([MITUTOYO_01A], resolution_mm=0.001, transport=default_transport())
    ) as rig:

        def go(step: Step) -> None:
            there = hidden.tool(BELIEVED(np.array(step.position_mm)))
            rig.go([float(there[2]) + 0.7 + chance.normal(scale=SCATTER_MM)])

        gauge = Gauge(
            MITUTOYO_01A,
            rig.ports[0],
            Query(),
            interval_s=QUICK_INTERVAL_S,
            window_s=0.1,
            tolerance_mm=0.004,
        )
        gauge.start()
        session_plan = plan(path, procedure)
        journal = (
            Journal.resume(path, program())
            if path.exists()
            else Journal.create(path, opened_event(session_plan))
        )
        indicators = Indicators((gauge,), None if by_hand else go)
        with GuidedSession(journal, indicators) as guided:
            yield guided, go


def test_positions_are_steps_of_one_record(tmp_path: Path) -> None:
    path = tmp_path / "s.jsonl"
    with start_session(plan(path, short(lift_mm=4.0))) as guided:
        measure_all(guided)
    record = read_record(path)
    measured_session = fold(record.events)
    assert record.end == "closed"
    assert measured_session.complete
    assert len(measured_session.opened.instruments) == 1
    assert [r.position_mm for r in measured_session.readings] == [
        *((0.0, 0.0, 0.0), (0.0, 60.0, 0.0), (-51.962, -30.0, 0.0), (51.962, -30.0, 0.0)),
        (0.0, 0.0, 0.0),
    ]
    assert {(r.leg, r.axis, r.lift_mm, r.mount) for r in measured_session.readings} == {
        ("tool", "z", 4.0, "tool-z")
    }


def test_a_reading_without_a_move_does_not_count(tmp_path: Path) -> None:
    with session(tmp_path / "s.jsonl", OFF, short(), by_hand=True) as (guided, go):
        go(guided.steps[0])
        first = guided.take()
        assert first is not None
        assert first.doubt is None
        forgotten = guided.take()
        assert forgotten is not None
        assert forgotten.doubt is Doubt.UNCHANGED
        assert [r.step for r in guided.session.readings] == [1]
        go(guided.steps[1])
        taken_step = guided.take()
        assert taken_step is not None
        assert taken_step.step.number == 2
        assert taken_step.doubt is None
        go(guided.steps[3])  # the wrong position of a machine that is off by half a millimetre
        wrong = guided.take()
        assert wrong is not None
        guided.undo()
        back = guided.step()
        assert back is not None
        assert back.number == wrong.step.number


def test_after_a_break_the_tool_has_a_new_zero(tmp_path: Path) -> None:
    path = tmp_path / "s.jsonl"
    with session(path, OFF, short()) as (guided, _):
        for _ in range(2):
            guided.go()
            guided.take()
        guided.leave()
    with session(path, OFF, short()) as (guided, _):
        step = guided.step()
        assert step is not None
        assert step.position_mm == (-51.962, -30.0, 0.0)
        measure_all(guided)
    mounts = [r.mount for r in fold(read_record(path).events).readings]
    assert mounts == ["tool-z"] * 2 + ["tool-z#2"] * 3


def test_a_plate_wants_an_indicator_along_its_axis(tmp_path: Path) -> None:
    across = Instrument(profile="mitutoyo-01a", port="a", axes="yx")
    along = Instrument(profile="mitutoyo-01a", port="b", axes="z")
    instruments = Plan(tmp_path / "s", MACHINE, RINGS, (across, along)).instruments
    assert instruments == (along,)
    with pytest.raises(UsageError, match="one along z, at the tool"):
        Plan(tmp_path / "s", MACHINE, RINGS, (across,))


@LONG
def test_from_a_hidden_machine_to_firmware_that_stands_right(tmp_path: Path) -> None:
    """Guided session, solution, export; then firmware written from its formulas drives it."""
    path, out = tmp_path / "s.jsonl", tmp_path / "calib.cfg"
    with session(path, OFF, RINGS) as (guided, _):
        measure_all(guided)
    run = glidecal(
        "export", path, "--format", "klipper", "--endstops", "300.1,299.9,300.4", "-o", out
    )
    assert run.status == 0, run.err
    before, after = rms(errors(OFF, BELIEVED)), rms(errors(OFF, klipper(out.read_text())))
    assert before > 0.15
    assert after < 0.02, f"{before:.4f} → {after:.4f} mm"


def test_what_the_operator_reads_of_a_plate(tmp_path: Path) -> None:
    geometry = MACHINE.geometry()
    with session(tmp_path / "s.jsonl", OFF, short(lift_mm=5.0), by_hand=True) as (guided, go):
        first, second, *_ = guided.steps
        lines = step_text(second, guided.session).splitlines()
        assert lines[0] == "TOOL   (0, 60, 0) mm   cycle 1 of 1"
        assert lines[1] == "First, at Zero: indicator at the tool, plate under it; + is towards +Z."
        assert lines[2].startswith("Lift off by 5 mm")
        assert lines[3:5] == ["G53 G0 X0.000 Y60.000 Z5.000", "G53 G0 X0.000 Y60.000 Z0.000"]
        assert step_in_list(first, geometry, "1") == "ZERO"
        assert step_in_list(guided.steps[2], geometry, "1") == "-52 -30 0"
        go(first)
        guided.take()
        unmoved = guided.take()
        assert unmoved is not None
        text = question_text(unmoved, guided.session)
        assert "Step 2, tool (0, 60, 0) mm" in text
        assert "Unchanged since ZERO" in text
        for step in guided.steps[1:]:
            go(step)
            guided.take()
        table = so_far_text(guided.session, guided.steps, second).splitlines()
        assert table[0].split() == ["minus", "Zero", "cycle", "1"]
        differences = [
            float(OFF.tool(BELIEVED(np.array(place)))[2] - OFF.tool(BELIEVED(np.zeros(3)))[2])
            for place in ((0.0, 60.0, 0.0), (-51.962, -30.0, 0.0), (51.962, -30.0, 0.0))
        ]
        values = [float(line.split()[-1]) for line in table[1:4]]
        assert values == pytest.approx(differences, abs=5 * SCATTER_MM)
        assert table[4].startswith("back at Zero")
        assert point_text(second, guided.session).startswith("step   2  tool  (0, 60, 0) mm")
        review = review_text(review_leg(guided.session, guided.steps[-1]), guided.session)
        assert review.startswith("✓ The plate is done.")
        assert "z(0, 60, 0)" in review
