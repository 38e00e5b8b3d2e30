"""The lead of a screw is searched where the machine file names none."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from calib.arrays import Observations
from calib.posterior.cells import Cells
from calib.posterior.screws import with_searched_leads
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.drives import ActuatorCyclic
from calib.tripod.effects.effect import (
    Acting,
    EffectInstance,
    EffectParameter,
    OfCarriage,
    travel_mm,
)
from calib.tripod.geometry import Geometry
from calib.tripod.pipeline import Model
from tests.calib.diagnosis.diagnosed_sessions import (
    SHORT,
    SWEEP,
    TWO_STATION,
    case,
    diagnose,
    names,
)
from tests.conftest import LONG, first_quick


@pytest.mark.parametrize("observations", first_quick([SWEEP, TWO_STATION]))
@pytest.mark.parametrize("lead_mm", first_quick([8.0, 25.0, 13.3]))
def test_any_lead_is_found(observations: Observations, lead_mm: float) -> None:
    """Leads of which four that were tried before hold 8, 25 and 13.3 mm for 10, 20 and 20."""
    hidden = EffectInstance(ActuatorCyclic(lead_mm), "x", (15.0, 10.0))
    diagnosis = diagnose([case(observations, hidden, seed=3)], CATALOGUE)
    assert names(diagnosis) == [("actuator_cyclic", "x")]
    lead = diagnosis.effects[0].parameters[0].name.removeprefix("sine_").removesuffix("mm")
    remarks = " ".join(diagnosis.remarks)
    assert float(lead) == pytest.approx(lead_mm, rel=0.03) or f"{lead_mm:.2g}" in remarks


@LONG
def test_a_lead_that_is_not_the_only_one_is_said() -> None:
    """Between three postures any lead goes; nothing is searched in pure noise."""
    plain = case(SWEEP, seed=0)
    assert with_searched_leads(CATALOGUE, [Cells.of(plain)]) == CATALOGUE
    assert diagnose([plain], CATALOGUE).verdict == "agrees"
    hidden = EffectInstance(ActuatorCyclic(13.3), "z", (-6.0, 6.0))
    diagnosis = diagnose([case(SWEEP, hidden, seed=2)], CATALOGUE)
    assert any("leads of" in remark and "machine file" in remark for remark in diagnosis.remarks)


@dataclass(frozen=True)
class Teeth(OfCarriage):
    """A carriage is off by a sawtooth: up along a tooth of 23 mm, then back at once."""

    id = "teeth"
    title = "a sawtooth"
    parameters = (EffectParameter("tooth", "mm", 0.01),)
    controller = "nothing"

    def off(self, at: Acting) -> NDArray[Any]:
        teeth = travel_mm(at.flow, at.leg) / 23.0
        return np.asarray(at.values[0] * (teeth - np.floor(teeth)))


@LONG
@pytest.mark.parametrize("place", ["x", "y", "z"])
def test_what_repeats_and_is_no_sine_is_not_called_a_screw(place: str) -> None:
    """The catalogue has no sawtooth, of which a sine of some lead explains most."""
    diagnosis = diagnose(
        [case(TWO_STATION, EffectInstance(Teeth(), place, (0.03,)), seed=4)], CATALOGUE
    )
    assert diagnosis.verdict in ("unexplained", "partly-explained")
    assert diagnosis.something_else > 0.9
    assert diagnosis.left_over is not None
    assert diagnosis.left_over.where == place
    assert "repeats every" in diagnosis.left_over.title


def test_a_known_lead_is_not_searched() -> None:
    hidden = EffectInstance(ActuatorCyclic(8.0), "x", (15.0, 10.0))
    machine = Model(Geometry(screw_lead_mm=10.0))
    cells = Cells.of(case(SWEEP, hidden, seed=3, model=machine))
    assert with_searched_leads(CATALOGUE, [cells]) == CATALOGUE


def test_three_postures_have_no_lead() -> None:
    """Sine, cosine and lead fit what any effect does in them."""
    hidden = EffectInstance(ActuatorCyclic(8.0), "x", (15.0, 10.0))
    cells = Cells.of(case(SHORT, hidden, seed=3))
    assert with_searched_leads(CATALOGUE, [cells]) == CATALOGUE
