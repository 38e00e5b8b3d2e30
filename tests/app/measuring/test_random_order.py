"""A shuffled procedure: the same postures, another order, and only where that is allowed."""

from __future__ import annotations

import pytest

from calib.errors import UsageError
from protocols.machine import load_machine
from protocols.procedure import load_procedure, shuffled
from tests.app.cli import glidecal, refused

GEOMETRY = load_machine(None).geometry()


def test_same_postures_in_another_order() -> None:
    procedure = load_procedure("verify", GEOMETRY)
    mixed = shuffled(procedure, 7)
    assert mixed.random_seed == 7
    before = [(s.leg, s.cycle, s.displacement_mm) for s in procedure.steps(GEOMETRY)]
    after = [(s.leg, s.cycle, s.displacement_mm) for s in mixed.steps(GEOMETRY)]
    assert before != after
    assert sorted(before) == sorted(after)
    again = shuffled(procedure, 7)
    assert again.steps(GEOMETRY) == mixed.steps(GEOMETRY)


def test_a_fixed_order_is_kept() -> None:
    with pytest.raises(UsageError, match=r'its purpose \("fixed"\)\. Allowed: .* order = "free"'):
        shuffled(load_procedure("sweep", GEOMETRY), 7)


def test_run_takes_a_seed() -> None:
    run = glidecal("run", "--dry-run", "--random-order", "7")
    assert "shuffled in each" in run.out
    assert "seed 7" in run.out
    message = refused(2, "run", "--dry-run", "--random-order", "7", "--protocol", "sweep")
    assert "random order of procedure sweep" in message
