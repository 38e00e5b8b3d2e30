"""Rank decisions: known answers, the classical test, and firmness against wrong derivatives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.planning.tripod import tripod_planning
from calib.design.identifiability import Sensitivity, analyse, classical_qr
from calib.tripod.geometry import Geometry
from protocols.machine import load_machine
from protocols.procedure import guided_procedure_names, load_procedure


def sensitivity_of(procedure: str) -> Sensitivity:
    machine = load_machine("orthoglide")
    planned = tripod_planning(machine, load_procedure(procedure, machine.geometry()), 0.02)
    return planned.examine().sensitivity


@pytest.mark.parametrize("procedure", guided_procedure_names(Geometry()))
def test_derivatives_wrong_by_1e_7_change_no_decision(procedure: str) -> None:
    exact = sensitivity_of(procedure)
    analysis = analyse(exact)
    for seed in range(10):
        wrong = np.random.default_rng(seed).uniform(-1e-7, 1e-7, exact.jacobian.shape)
        again = analyse(replace(exact, jacobian=exact.jacobian * (1.0 + wrong)))
        assert again.rank == analysis.rank == (4 if procedure == "plane" else 6)
        assert len(again.weak) == len(analysis.weak)
        assert again.individually_known == analysis.individually_known
        assert {d.combination for d in again.weak} == {d.combination for d in analysis.weak}


@pytest.mark.parametrize("seed", range(10))
def test_an_exactly_lost_combination_stays_lost(seed: int) -> None:
    """A column that is the sum of two others, disturbed by 1e-7, with next to no noise."""
    generator = np.random.default_rng(seed)
    jacobian = 1e9 * generator.normal(size=(30, 4))
    jacobian[:, 3] = jacobian[:, 0] + jacobian[:, 1]
    jacobian *= 1.0 + generator.uniform(-1e-7, 1e-7, jacobian.shape)
    analysis = analyse(Sensitivity(tuple("abcd"), jacobian, np.ones(4)))
    assert analysis.rank == 3
    assert len(analysis.unseen) == 1
    assert abs(analysis.unseen_vectors[0][2]) < 1e-6


def test_weak_vectors_are_those_of_the_weak_combinations() -> None:
    analysis = analyse(Sensitivity(("a", "b"), np.diag([1000.0, 20.0]), np.array([1.0, 1.0])))
    assert [direction.combination for direction in analysis.weak] == ["b"]
    assert np.abs(analysis.weak[0].vector) == pytest.approx([0.0, 1.0])


def test_classical_qr_flags_the_last_of_dependent_columns() -> None:
    """papers/001, section 3: which one is flagged depends on the order of the columns."""
    jacobian = np.random.default_rng(1).integers(-4, 5, (8, 3)).astype(np.float64)
    jacobian[:, 2] = 2.0 * jacobian[:, 0]
    factorisation = classical_qr(jacobian, ("a", "b", "c"))
    diagonal = np.abs(np.linalg.qr(jacobian)[1].diagonal())
    assert factorisation.tolerance == pytest.approx(3 * np.finfo(np.float64).eps * diagonal.max())
    assert factorisation.flagged == ("c",)
    assert classical_qr(jacobian[:, ::-1], ("c", "b", "a")).flagged == ("a",)
    few = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 7.0]])
    assert classical_qr(few, ("a", "b", "c")).flagged == ("c",)


def test_without_a_noise_nothing_is_weak_and_what_is_blind_is_lost() -> None:
    jacobian = np.diag([1000.0, 1.0, 0.01, 0.0])
    shape = Sensitivity(tuple("abcd"), jacobian, np.ones(4), noise_known=False)
    analysis = analyse(shape)
    assert (analysis.rank, analysis.weak) == (3, ())
    assert [direction.combination for direction in analysis.unseen] == ["d"]
    assert analysis.individually_known == ("a", "b", "c")
    known = analyse(replace(shape, noise_known=True))
    assert (known.rank, [direction.combination for direction in known.weak]) == (2, ["b"])
