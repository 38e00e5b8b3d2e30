"""Where nobody saw how a first posture was reached: machines that homed down, or up.

Sessions of the blind bench's simulation, which is driven along a path and knows every movement.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app.evaluating.diagnosis import diagnose_files
from calib.arrays import Observations, conditions
from calib.noise.reading import visit_means
from calib.tripod.geometry import Geometry
from calib.tripod.movements import last_movement, with_first_movements
from protocols.observations import to_observations
from protocols.record import read_record
from protocols.session import fold
from tests.blind.bench_files import write_session
from tests.blind.cases import Case
from tests.blind.generator import make
from tests.conftest import LONG, first_quick

PROCEDURES = ("zero-max-min", "sweep", "two-station")


def session(folder: Path, case: Case) -> Path:
    path = folder / f"{case.session}.jsonl"
    write_session(make(case, 1), path)
    return path


def visited(path: Path) -> Observations:
    return visit_means(to_observations([fold(read_record(path).events)]))


@LONG
@pytest.mark.parametrize("procedure", first_quick(PROCEDURES))
@pytest.mark.parametrize("strengths", first_quick([(8.0,), (8.0, 12.0, 16.0)]), ids=str)
def test_play_is_all_that_is_missing_however_the_machine_homed(
    strengths: tuple[float, ...], procedure: str, tmp_path: Path
) -> None:
    for number, strength in enumerate(strengths):
        name = f"homed/{procedure}/{number}"
        case = Case(name, "single", procedure, "gaussian", ("backlash",), (strength,), homed=-1.0)
        diagnosis = diagnose_files([session(tmp_path, case)]).diagnosis
        places = [
            (effect.id, effect.where) for effect in diagnosis.effects if effect.kind == "machine"
        ]
        (hidden,) = make(case, 1).truth["hidden"]
        assert ("backlash", hidden["where"][0]) in places
        assert diagnosis.verdict in ("explained", "ambiguous")
        assert diagnosis.gap_after.p_value > 1e-3


def test_a_first_reading_that_agrees_with_its_repeats_stays_as_it_is(tmp_path: Path) -> None:
    plain = visited(session(tmp_path, Case("homed/none", "none", "sweep", "gaussian", homed=-1.0)))
    assert not with_first_movements(Geometry(), plain).movement.any()


@pytest.mark.parametrize("cycles", [2, 3])
def test_the_first_reading_takes_the_other_side_of_its_repeats(cycles: int, tmp_path: Path) -> None:
    every = visited(session(tmp_path, Case("homed/off", "none", "zero-max-min", "gaussian")))
    plain = every.take(every.cycle <= cycles)
    first = int(plain.mountings[3][0])
    value = plain.value_mm.copy()
    value[first] += 0.1
    moved = with_first_movements(Geometry(), replace(plain, value_mm=value))
    assert np.flatnonzero(moved.movement.any(axis=1)).tolist() == [first]
    of_repeats = last_movement(Geometry(), plain)[
        (plain.mount == 3) & plain.at_zero & plain.approach_known
    ]
    assert last_movement(Geometry(), moved)[first] == pytest.approx(-of_repeats[0])


def test_without_repeats_nothing_is_known(tmp_path: Path) -> None:
    plain = visited(session(tmp_path, Case("homed/once", "none", "zero-max-min", "gaussian")))
    once = plain.take(plain.cycle == 1)
    value = once.value_mm.copy()
    value[0] += 0.1
    assert not with_first_movements(Geometry(), replace(once, value_mm=value)).movement.any()


@pytest.mark.parametrize(
    ("lean", "down"), [(6e-6, False), (4e-3, False), (0.05, True)], ids=["rounding", "5", "50"]
)
def test_a_carriage_that_turned_by_less_than_a_play_did_not_turn(lean: float, down: bool) -> None:
    """Across a drive that leans by c a carriage turns c L before Zero, and comes back c² L / 2."""
    length = 310.25
    along = (lean, (1.0 - lean**2) ** 0.5, 0.0)
    geometry = Geometry(direction=((1.0, 0.0, 0.0), along, (0.0, 0.0, 1.0)))
    back_mm = lean**2 * length / 2.0
    assert (back_mm > 0.01) == down
    arriving = replace(conditions([1], [0], [0.0]), approach=np.array([-1.0]))
    moved = last_movement(geometry, arriving)[0]
    assert moved[0] == (-1.0 if down else 1.0)
    assert moved[1:].tolist() == [-1.0, 1.0]
