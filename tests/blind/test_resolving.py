"""A quick part of the page of resolving: each sort of proposal once, and what the bench does."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.blind.cases import Case
from tests.blind.forward import readings
from tests.blind.generator import Again, made_again, make
from tests.blind.resolving import Follower, machine_text, visits_of
from tests.blind.resolving_page import page
from tests.blind.steps import Visit
from tests.blind.trials import Trial, possible
from tests.conftest import LONG

pytest.importorskip("app.evaluating.diagnosis", reason="there is no diagnosis to test yet")

Json = dict[str, Any]

SEED = 6
PROCEDURE = """
legs = ["z"]
stations = [0.3, 0.7]
cycles = 2
levels = ["zero", 15.0, -40.0]
"""


def case(procedure: str, effect: str, strength: float, number: int = 0) -> Case:
    key = f"resolving/{procedure}/{effect}/{strength}/{number}"
    return Case(key, "single", procedure, "gaussian", (effect,), (strength,))


def test_a_proposed_file_as_visits() -> None:
    sequence = visits_of(PROCEDURE)
    assert len(sequence) == 2 * (2 * 3 + 1)
    assert sequence[0] == Visit(2, 0.3, 0.0, 1)
    assert [v.displacement_mm for v in sequence[:7]] == [0.0, 15.0, -40.0, 0.0, 15.0, -40.0, 0.0]
    assert {v.station for v in sequence[7:]} == {0.7}


def test_the_same_machine_with_offsets_entered_and_a_load() -> None:
    """An offset that is entered is gone, weight counts twice, everything else is as it was."""
    session = make(case("sweep", "gravity_sag", 4.0), SEED)
    offsets = session.hidden.amounts["offset"]
    again = Again(visits_of(PROCEDURE), tuple(offsets.tolist()), 2.0)
    further = made_again(session, again, "gaussian", np.random.default_rng(1))
    expected = session.hidden.plus(
        [(("offset", (k,)), -float(offsets[k])) for k in range(3)]
        + [(("sag", (k,)), float(session.hidden.amounts["sag"][k])) for k in range(3)]
    )
    residual = further.values_mm - readings(further.rows, expected)
    for mount in range(4):
        gauge_residual = residual[further.rows.mount == mount]
        assert np.std(gauge_residual) < 3.0 * session.sigma_mm
    assert further.table.splitlines()[1].startswith("z,x,0,")
    document = tomllib.loads(machine_text(again))
    assert document["load"] == 2.0
    assert document["entered_offsets_mm"] == offsets.tolist()


@LONG
@pytest.mark.parametrize(
    ("procedure", "effect", "load", "shifted"),
    [
        ("zero-max-min", "actuator_cyclic", 1.0, False),
        ("two-station", "gauge_tilt", 1.0, True),
        ("zero-max-min", "actuator_scale", 2.0, False),
    ],
)
def test_each_sort_of_proposal_resolves(
    tmp_path: Path, procedure: str, effect: str, load: float, shifted: bool
) -> None:
    trial = Follower.of(case(procedure, effect, 1.0), SEED, tmp_path).trial(1)
    proposal = trial.first["next_measurement"]
    assert trial.first["verdict"] == "ambiguous"
    assert proposal["load"] == load
    assert any(proposal["entered_mm"]) is shifted
    assert trial.expected >= 25.0
    assert effect in {name for name, _ in trial.between}
    assert trial.resolved()
    assert trial.single(1)
    text = page([trial], 1, SEED)
    assert "| resolved, every proposal | – | 100.0 % (2.5 … 100.0; 1/1) | – |" in text


def document(verdict: str, *names: tuple[str, str], also: tuple[tuple[str, str], ...] = ()) -> Json:
    rivals = [{"id": name, "where": where} for name, where in also]
    return {
        "verdict": verdict,
        "effects": [
            {"id": name, "where": where, "indistinguishable_from": rivals} for name, where in names
        ],
        "next_measurement": {
            "apart": 30.0,
            "names": [
                [{"id": "backlash", "where": "x"}],
                [{"id": "actuator_scale", "where": "x"}],
            ],
            "load": 1.0,
            "entered_mm": [0.0, 0.0, 0.0],
        },
    }


def trial_of(*documents: Json) -> Trial:
    hidden = {"id": "backlash", "where": ["x"], "parameters": [{"value": 1.0, "index": [0]}]}
    return Trial({"hidden": [hidden]}, documents)


BACKLASH, SCALE = ("backlash", "x"), ("actuator_scale", "x")
FIRST = document("ambiguous", BACKLASH, also=(SCALE,))


def test_what_counts_as_resolved() -> None:
    assert possible(FIRST) == {BACKLASH, SCALE}
    right = trial_of(FIRST, document("explained", BACKLASH))
    assert right.resolved()
    assert right.single(1)
    assert not right.wrong()
    stalemate = trial_of(FIRST, FIRST)
    assert not stalemate.resolved()
    assert not stalemate.single(2)
    trial = trial_of(FIRST, document("explained", SCALE))
    assert not trial.resolved()
    assert trial.wrong()
    rival = trial_of(FIRST, document("ambiguous", BACKLASH, also=(("leg_bow", "xy"),)))
    assert rival.resolved()
    assert not rival.single(1)
    elsewhere = trial_of(FIRST, document("explained", ("backlash", "y")))
    assert not elsewhere.single(1)


def test_the_page_counts_what_was_not_followed() -> None:
    text = page([trial_of(FIRST), trial_of(FIRST, FIRST)], 5, SEED)
    assert "5 sessions drawn, seed 6; 2 were ambiguous" in text
    assert "- actuator_scale, backlash: 1\n" in text
    assert "0/1) | **no** |" in text
