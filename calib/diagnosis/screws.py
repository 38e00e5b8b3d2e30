"""The lead of a screw that the machine file does not name, searched in the readings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.arrays import LEG_NAMES, FloatArray, without
from calib.diagnosis.policy import POLICY
from calib.diagnosis.problem import Problem
from calib.tripod.effects.candidates import stacked_columns
from calib.tripod.effects.drives import ISO_LEADS_MM, ActuatorCyclic, ActuatorScale
from calib.tripod.effects.effect import PER_THOUSAND, Effect, EffectInstance
from calib.tripod.pipeline import command

STEP = 0.25
"""Of the grid of frequencies, in turns over the whole travel: neighbours are nearly alike."""

LEAST_LEVELS = 4
"""Postures away from Zero that a carriage's own leg needs: sine, cosine and lead fit any three."""

FINE = 10
"""Parts of a step, around the best."""


def with_searched_leads(problem: Problem, effects: Sequence[Effect]) -> tuple[Effect, ...]:
    """The laws, and the cyclic error whose lead explains most at each carriage.

    None where the machine file names the lead or cyclic errors are not among the laws.
    """
    geometry = problem.fitted_sessions[0].model.geometry
    known = {one.lead_mm for one in effects if isinstance(one, ActuatorCyclic)}
    if geometry.screw_lead_mm is not None or not known:
        return tuple(effects)
    nothing = np.zeros((len(problem.y), 0))
    leads = [best for screw in screws_of(problem) if (best := screw.best_lead_mm(nothing))]
    return (*effects, *(ActuatorCyclic(lead) for lead in dict.fromkeys(leads) if lead not in known))


def other_leads_mm(
    problem: Problem, basis: FloatArray, placed: Sequence[EffectInstance]
) -> list[float]:
    """Other leads that cannot be told from that of a screw which was named.

    ``basis`` ``(n, r)`` is what else was named; none where several screws were named together.
    """
    screws = [one for one in screws_of(problem) if [p.place for p in placed] == [one.place]]
    effect = placed[0].effect if placed else None
    if not screws or not isinstance(effect, ActuatorCyclic):
        return []
    return screws[0].other_leads_mm(basis, effect.lead_mm)


@dataclass(frozen=True, eq=False)
class Screw:
    """A carriage: its travel ``(n,)``, mm, and what the readings change for each mm of it."""

    problem: Problem
    place: str
    travel_mm: FloatArray
    per_mm: FloatArray

    @property
    def _step(self) -> float:
        return STEP / max(float(np.ptp(self.travel_mm)), STEP * ISO_LEADS_MM[-1])

    @property
    def _grid(self) -> FloatArray:
        """Turns for each mm of travel."""
        return np.arange(1.0 / ISO_LEADS_MM[-1], 1.0 / ISO_LEADS_MM[0] + self._step / 2, self._step)

    def other_leads_mm(self, basis: FloatArray, lead_mm: float) -> list[float]:
        """Peaks that cannot be told from this lead.

        One within half a turn over the whole travel is the same lead, not so well known.
        """
        grid = self._grid
        squares = self.explained(1.0 / grid, basis)
        inner = np.concatenate([[-np.inf], squares, [-np.inf]])
        peak = (squares >= inner[:-2]) & (squares >= inner[2:])
        own = float(self.explained(np.array([lead_mm]), basis)[0])
        apart = np.abs(grid - 1.0 / lead_mm) > 2.0 * self._step
        return [
            float(f"{1.0 / turns:.2g}")
            for turns in grid[peak & apart & (squares > own - POLICY.told_apart)]
        ]

    def best_lead_mm(self, basis: FloatArray) -> float | None:
        """The lead that explains most beside a basis ``(n, r)``; a standard one if it does as well.

        None where the best explains less than `POLICY.decisive`: pure noise reaches that at some
        lead and carriage in less than one of 1000 sessions.
        """
        grid = self._grid
        near = float(grid[np.argmax(self.explained(1.0 / grid, basis))])
        around = near + self._step * np.linspace(-1.0, 1.0, 2 * FINE + 1)
        fine = 1.0 / np.clip(around, *grid[[0, -1]])
        squares = self.explained(fine, basis)
        best = float(squares.max())
        if best < POLICY.decisive:
            return None
        standard = self.explained(np.array(ISO_LEADS_MM), basis)
        if standard.max() >= best - POLICY.told_apart:
            return ISO_LEADS_MM[int(np.argmax(standard))]
        return float(f"{fine[np.argmax(squares)]:.3g}")

    def explained(self, leads_mm: FloatArray, basis: FloatArray) -> FloatArray:
        """Squares ``(k,)`` that sine and cosine of each lead explain, in noise variances."""
        turn = 2.0 * np.pi * self.travel_mm[:, None] / leads_mm
        y = without(basis, self.problem.y)
        sine, cosine = (
            without(basis, self.problem.free(self.per_mm[:, None] * wave))
            for wave in (np.sin(turn), np.cos(turn) - 1.0)
        )
        square = (sine * sine).sum(axis=0)
        rest = cosine - sine * ((sine * cosine).sum(axis=0) / square)
        return np.asarray((y @ sine) ** 2 / square + (y @ rest) ** 2 / (rest * rest).sum(axis=0))


def screws_of(problem: Problem) -> list[Screw]:
    """The carriages that were read in enough postures."""
    sessions = [(one.model, one.observed) for one in problem.fitted_sessions]
    (columns,) = stacked_columns(sessions, [ActuatorScale()])
    commands = np.vstack([command(model.geometry, taken) for model, taken in sessions])
    travel = commands - sessions[0][0].geometry.zero_mm
    touched = problem.conditions("leg")
    found = []
    for place, column in columns.items():
        own = travel[:, LEG_NAMES.index(place)]
        moved = own != 0.0
        levels = np.unique(own[moved & (touched == LEG_NAMES.index(place))].round(3))
        if len(levels) < LEAST_LEVELS:
            continue
        per_mm = np.where(moved, column[:, 0] / np.where(moved, PER_THOUSAND * own, 1.0), 0.0)
        found.append(Screw(problem, place, own, per_mm))
    return found
