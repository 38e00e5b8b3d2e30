"""What an operator is told to do at a step, in the words of the machine's own drives."""

from __future__ import annotations

from app.report.text.session import step_text
from calib.tripod.geometry import Geometry
from protocols.machine import Machine
from protocols.procedure import load_procedure
from protocols.record import read_record
from protocols.session import Continued, Mounted, Opened, Reading, fold
from tests.conftest import SAMPLES
from tests.tripods import TRIPODS


def ways_of(geometry: Geometry) -> list[str]:
    """What is asked for at Max of each leg."""
    machine = Machine().with_drives_of(geometry)
    procedure = load_procedure("zero-max-min", geometry)
    session = fold([Opened(program="t", origin="simulated", machine=machine, procedure=procedure)])
    steps = [
        step for step in procedure.steps(geometry) if step.displacement_mm > 0.0 and step.cycle == 1
    ]
    return [step_text(step, session) for step in steps]


def test_a_way_along_a_coordinate_is_that_and_another_is_along_its_drive() -> None:
    x, y, z = ways_of(Geometry())
    assert "to X +60.00 mm." in x
    assert "to Y +60.00 mm." in y
    assert "to Z +60.00 mm." in z
    x, y, z = ways_of(TRIPODS["tilted"])
    assert "to X +60.00 mm." in x
    assert "to +60.00 mm along drive Y." in y
    assert "to +60.00 mm along drive Z." in z


def test_a_posture_that_a_break_leaves_alone_is_to_be_taken_again() -> None:
    """Kept, but of a mounting with one posture, which gives no difference."""
    events = read_record(SAMPLES / "simulated_zero-max-min.jsonl").events
    begun = [k for k, event in enumerate(events) if isinstance(event, Reading)]
    for taken, words in ((2, "the posture before is lost"), (4, "the readings have a new zero")):
        mounted = Mounted(leg="x", station=0.5, mounts={"y": "xy", "z": "xz"})
        session = fold([events[0], mounted, *events[1 : begun[taken]], Continued(program="t")])
        step = session.next_step()
        assert step is not None
        assert session.last_is_alone == (taken == 2)
        assert words in step_text(step, session)
