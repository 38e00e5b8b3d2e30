"""The lead of a screw is searched where the machine file names none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.arrays import Observations
from calib.diagnosis.diagnose import diagnose
from calib.diagnosis.hypotheses import screws_of, with_searched_leads
from calib.diagnosis.problem import Problem
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.candidates import place_columns
from calib.tripod.effects.drives import ActuatorCyclic, ActuatorScale
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.geometry import Geometry
from calib.tripod.pipeline import Model
from tests.calib.diagnosis.diagnosed_sessions import SHORT, SWEEP, TWO_STATION, case, names, problem


@pytest.mark.parametrize("taken", [SWEEP, TWO_STATION])
@pytest.mark.parametrize("lead_mm", [8.0, 25.0, 13.3])
def test_any_lead_is_found(taken: Observations, lead_mm: float) -> None:
    """Leads of which four that were tried before hold 8, 25 and 13.3 mm for 10, 20 and 20."""
    hidden = EffectInstance(ActuatorCyclic(lead_mm), "x", (15.0, 10.0))
    found = diagnose([case(taken, hidden, seed=3)], CATALOGUE)
    assert names(found) == [("actuator_cyclic", "x")]
    said = found.effects[0].parameters[0].name.removeprefix("sine_").removesuffix("mm")
    others = " ".join(found.remarks)
    assert float(said) == pytest.approx(lead_mm, rel=0.03) or f"{lead_mm:.2g}" in others


def test_a_lead_that_is_not_the_only_one_is_said() -> None:
    """Between three postures any lead goes; nothing is searched in pure noise."""
    plain = problem(SWEEP, 0)
    assert with_searched_leads(plain, CATALOGUE) == CATALOGUE
    assert diagnose([case(SWEEP, seed=0)], CATALOGUE).verdict == "agrees"
    hidden = EffectInstance(ActuatorCyclic(13.3), "z", (-6.0, 6.0))
    found = diagnose([case(SWEEP, hidden, seed=2)], CATALOGUE)
    assert any("leads of" in said and "machine file" in said for said in found.remarks)


def test_a_known_lead_is_not_searched() -> None:
    hidden = EffectInstance(ActuatorCyclic(8.0), "x", (15.0, 10.0))
    machine = Model(Geometry(screw_lead_mm=10.0))
    one = case(SWEEP, hidden, seed=3, model=machine)
    made = Problem.of([replace(one, model=machine).fitted()])
    assert with_searched_leads(made, CATALOGUE) == CATALOGUE


def test_columns_of_any_lead_are_those_of_the_simulation() -> None:
    """From one derivative by the place of a carriage, at Zero nothing moves."""
    made = problem(TWO_STATION, 0)
    model, taken = made.fitted_sessions[0].model, made.fitted_sessions[0].observed
    (columns,) = place_columns(model, taken, [ActuatorCyclic(13.3)])
    screw = next(one for one in screws_of(made) if one.place == "y")
    turn = 2.0 * np.pi * screw.travel_mm / 13.3
    assert screw.per_mm * np.sin(turn) * 1e-3 == pytest.approx(columns["y"][:, 0], abs=1e-12)
    assert ActuatorScale().places(taken)


def test_three_postures_have_no_lead() -> None:
    """Sine, cosine and lead fit what any effect does in them."""
    hidden = EffectInstance(ActuatorCyclic(8.0), "x", (15.0, 10.0))
    made = Problem.of([case(SHORT, hidden, seed=3).fitted()])
    assert with_searched_leads(made, CATALOGUE) == CATALOGUE
