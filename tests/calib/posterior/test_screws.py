"""Leads that are searched in readings, against least squares with waves of the pipeline."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.linalg import block_diag

from calib.arrays import FloatArray, Observations
from calib.posterior.cells import Cells
from calib.posterior.screws import AS_GOOD, with_searched_leads
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.drives import ISO_LEADS_MM, ActuatorCyclic
from calib.tripod.effects.effect import Effect, EffectInstance
from calib.tripod.geometry import Geometry
from calib.tripod.pipeline import Model, derivatives, simulate
from tests.calib.posterior.sessions import SHORT, SWEEP, TWO_STATION, case
from tests.conftest import first_quick

SMALL_UM = 1e-3
"""Of a wave: readings follow its size."""


def leads_of(effects: tuple[Effect, ...]) -> list[float]:
    return [effect.lead_mm for effect in effects if isinstance(effect, ActuatorCyclic)]


def searched(sessions: list[Cells]) -> list[float]:
    catalogue_leads = leads_of(CATALOGUE)
    return [
        lead
        for lead in leads_of(with_searched_leads(CATALOGUE, sessions))
        if lead not in catalogue_leads
    ]


@dataclass(frozen=True, eq=False)
class Readings:
    """Sessions whose base is free: an orthonormal basis of it, and what it leaves of readings.

    ``plain`` are the readings of each fitted model.
    """

    sessions: list[Cells]
    plain: dict[int, FloatArray]
    basis: FloatArray
    left: FloatArray

    @classmethod
    def of(cls, sessions: list[Cells]) -> Readings:
        """A zero of each mounting, and the parameters about each fitted model."""
        blocks, targets = [], []
        plain = {id(cells): cells.model.readings(cells.means) for cells in sessions}
        for cells in sessions:
            observations, root = cells.means, 1.0 / np.sqrt(cells.variance_mm2)
            base = derivatives(
                cells.model.geometry, np.array(cells.model.parameters_mm), observations
            )
            columns = np.column_stack([np.eye(observations.mount_count)[observations.mount], base])
            blocks.append(root[:, None] * columns)
            targets.append(root * (observations.value_mm - plain[id(cells)]))
        free, target = np.asarray(block_diag(*blocks)), np.concatenate(targets)
        axes, singular, _ = np.linalg.svd(free / np.linalg.norm(free, axis=0), full_matrices=False)
        basis = axes[:, singular > 1e-10 * singular[0]]
        return cls(sessions, plain, basis, target - basis @ (basis.T @ target))

    def explained(self, lead_mm: float, place: str) -> float:
        """Square that a wave of this lead takes from them.

        Waves are differences of the pipeline's readings about each fitted model.
        """
        waves = np.vstack([self._waves(cells, lead_mm, place) for cells in self.sessions])
        waves -= self.basis @ (self.basis.T @ waves)
        size = np.linalg.lstsq(waves, self.left, rcond=1e-10)[0]
        residual = self.left - waves @ size
        return float(self.left @ self.left - residual @ residual)

    def _waves(self, cells: Cells, lead_mm: float, place: str) -> FloatArray:
        model, small = cells.model, (SMALL_UM, 1j * SMALL_UM)  # sine beside cosine
        wave = EffectInstance(ActuatorCyclic(lead_mm), place, small)
        parameters = np.array(model.parameters_mm)
        read = simulate(model.geometry, parameters, cells.means, (*model.effects, wave))
        waves = np.column_stack([read.real - self.plain[id(cells)], read.imag]) / SMALL_UM
        return np.asarray(waves / np.sqrt(cells.variance_mm2)[:, None])


@pytest.mark.parametrize("observations", [SWEEP, TWO_STATION], ids=["sweep", "two-station"])
@pytest.mark.parametrize("lead_mm", first_quick([8.0, 13.3, 25.0]))
@pytest.mark.parametrize("sessions", first_quick([1, 2]))
def test_leads_that_are_added_explain_as_much_as_any(
    observations: Observations, lead_mm: float, sessions: int
) -> None:
    """Against a fine grid of frequencies; the true one is among them, within its own doubt.

    A wave of one carriage may be taken for one of another, which is then searched, too.
    """
    screw = EffectInstance(ActuatorCyclic(lead_mm), "x", (15.0, 10.0))
    cells = [Cells.of(case(observations, screw, seed=3 + k)) for k in range(sessions)]
    leads, explained = searched(cells), Readings.of(cells).explained
    turns = np.linspace(1.0 / ISO_LEADS_MM[-1], 1.0 / ISO_LEADS_MM[0], 250)
    best = {place: max(explained(float(1.0 / turn), place) for turn in turns) for place in "xyz"}
    assert best["x"] > 40.0
    all_leads = [*leads, *leads_of(CATALOGUE)]
    assert max(explained(lead, "x") for lead in all_leads) > best["x"] - AS_GOOD
    for lead in leads:  # three digits of a lead are less than its doubt
        short = {place: best[place] - explained(lead, place) for place in "xyz"}
        assert min(short.values()) < 1.5 * AS_GOOD
    assert min(abs(lead / lead_mm - 1.0) for lead in leads) < 0.03


@pytest.mark.parametrize("seed", range(5))
def test_noise_has_no_lead(seed: int) -> None:
    assert searched([Cells.of(case(TWO_STATION, seed=seed))]) == []


def test_a_lead_in_the_machine_file_three_postures_and_other_laws_are_not_searched() -> None:
    screw = EffectInstance(ActuatorCyclic(8.0), "x", (15.0, 10.0))
    machine = Model(Geometry(screw_lead_mm=10.0))
    assert searched([Cells.of(case(SWEEP, screw, seed=3))])
    assert not searched([Cells.of(case(SWEEP, screw, seed=3, model=machine))])
    assert not searched([Cells.of(case(SHORT, screw, seed=3))])
    laws = tuple(law for law in CATALOGUE if not isinstance(law, ActuatorCyclic))
    assert with_searched_leads(laws, [Cells.of(case(SWEEP, screw, seed=3))]) == laws
