"""What an operator is told to do at a step, in the words of the machine's own drives."""

from __future__ import annotations

from app.report.text.session import step_text
from calib.tripod.geometry import Geometry
from protocols.machine import Machine
from protocols.procedure import load_procedure
from protocols.session import Opened, fold
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
