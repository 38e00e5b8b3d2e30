"""Leads of screws that the machine file does not name, searched in the readings.

A cyclic error is a sine and a cosine of the carriage's travel; for each lead what they explain
beside the base is known in closed form.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.sparse import block_diag  # scipy.linalg would take 0.04 s more to import

from calib.arrays import LEG_NAMES, FloatArray, without
from calib.errors import NotIdentifiable
from calib.identify.fit import design_of
from calib.posterior.cells import BASE, Cells
from calib.tripod.effects.candidates import placed_columns
from calib.tripod.effects.drives import ISO_LEADS_MM, ActuatorCyclic, ActuatorScale
from calib.tripod.effects.effect import PER_THOUSAND, Effect
from calib.tripod.effects.empirical import Repeating
from calib.tripod.pipeline import command

STEP = 0.25
"""Of the grid of frequencies, in turns over the whole travel: neighbours are nearly alike."""

LEAST_LEVELS = 4
"""Postures away from Zero that a carriage's own leg needs: sine, cosine and lead fit any three."""

FINE = 10
"""Parts of a step, around the best."""

DECISIVE = 25.0
"""Noise variances that a lead explains: pure noise reaches that at some lead and carriage in less
than one of 1000 sessions."""

AS_GOOD = 9.0
"""Noise variances within which another lead is as good."""

APART = 2.0
"""Steps within which two leads are one, not so well known."""


def with_searched_leads(effects: Sequence[Effect], sessions: Sequence[Cells]) -> tuple[Effect, ...]:
    """The laws, and cyclic errors of the leads that explain most at each carriage.

    Beside each, without a name, what repeats as often and need not be a sine: of a sawtooth a sine
    is three fifths of the square.

    None where the machine file names the lead or cyclic errors are not among the laws.
    """
    leads_known = {effect.lead_mm for effect in effects if isinstance(effect, ActuatorCyclic)}
    if sessions[0].case.model.geometry.screw_lead_mm is not None or not leads_known:
        return tuple(effects)
    try:
        leads = dict.fromkeys(lead for screw in _screws(sessions) for lead in screw.leads_mm())
    except NotIdentifiable:  # of labels that are wrong nothing fits
        return tuple(effects)
    searched = [ActuatorCyclic(lead) for lead in leads if lead not in leads_known]
    return (*effects, *searched, *(Repeating(law.lead_mm) for law in searched))


class SearchedScrew:
    """A carriage: its travel ``(n_cells,)`` in each session, mm.

    ``per_mm`` ``(n_cells,)`` is what means of cells change for each mm of it, ``residual`` and
    ``basis`` what the base leaves of them and what it does, whitened.
    """

    def __init__(
        self,
        sessions: Sequence[Cells],
        travel_mm: Sequence[FloatArray],
        per_mm: Sequence[FloatArray],
        residual: FloatArray,
        basis: FloatArray,
    ) -> None:
        self.sessions, self.travel_mm, self.per_mm = sessions, travel_mm, per_mm
        self.residual, self.basis = residual, basis
        way, (finest, *_, coarsest) = max(map(np.ptp, travel_mm)), ISO_LEADS_MM
        self._step = STEP / max(float(way), STEP * coarsest)
        self._grid = np.arange(1.0 / coarsest, 1.0 / finest + self._step / 2, self._step)

    def leads_mm(self) -> Iterator[float]:
        """Leads that explain as much as the best, each the best of its peak; standard ones first.

        None where the best explains less than `DECISIVE`.
        """
        turns = self._grid  # for each mm of travel
        squares = self._explained(1.0 / turns)
        inner = np.concatenate([[-np.inf], squares, [-np.inf]])
        peaks = turns[(squares >= inner[:-2]) & (squares >= inner[2:])]
        leads = self._refined_mm(peaks)
        explained = self._explained(leads)
        if explained.max() < DECISIVE:
            return
        least = float(explained.max()) - AS_GOOD
        standard = np.array(ISO_LEADS_MM)
        standard = standard[self._explained(standard) >= least]
        yield from standard.tolist()
        for lead in leads[explained >= least].tolist():
            if (np.abs(1.0 / standard - 1.0 / lead) > APART * self._step).all():
                yield float(f"{lead:.3g}")

    def _refined_mm(self, turns: FloatArray) -> FloatArray:
        """The best lead about each peak of the grid ``(k,)``."""
        around = turns[:, None] + self._step * np.linspace(-1.0, 1.0, 2 * FINE + 1)
        fine = 1.0 / np.clip(around, *self._grid[[0, -1]])
        best = self._explained(fine.ravel()).reshape(fine.shape).argmax(axis=1)
        return np.asarray(fine[np.arange(len(fine)), best])

    def _explained(self, leads_mm: FloatArray) -> FloatArray:
        """Squares ``(k,)`` that sine and cosine of each lead explain, in noise variances."""
        turns = [2.0 * np.pi * travel[:, None] / leads_mm for travel in self.travel_mm]
        sine = self._free([np.sin(turn) for turn in turns])
        cosine = self._free([np.cos(turn) - 1.0 for turn in turns])  # at Zero nothing moves
        square = np.maximum((sine * sine).sum(axis=0), 1e-12)
        beside_sine = cosine - sine * ((sine * cosine).sum(axis=0) / square)
        rest_square = np.maximum((beside_sine * beside_sine).sum(axis=0), 1e-12)
        return np.asarray(
            (self.residual @ sine) ** 2 / square + (self.residual @ beside_sine) ** 2 / rest_square
        )

    def _free(self, waves: Sequence[FloatArray]) -> FloatArray:
        """What waves ``(n_cells, k)`` of the travel in each session do beside the base."""
        rows = np.vstack(
            [
                cells.whitened(per_mm[:, None] * wave)
                for cells, per_mm, wave in zip(self.sessions, self.per_mm, waves, strict=True)
            ]
        )
        return without(self.basis, rows)


def _screws(sessions: Sequence[Cells]) -> Iterator[SearchedScrew]:
    """The carriages that were read in enough postures. Raises NotIdentifiable."""
    models = [cells.model for cells in sessions]
    remainders, bases = [], []
    for cells, model in zip(sessions, models, strict=True):
        remainders.append(cells.whitened(cells.means.value_mm - model.readings(cells.means)))
        base = design_of(model, cells.means, range(BASE), ()) * cells.case.spread_mm
        bases.append(np.linalg.qr(cells.whitened(base))[0])
    basis, rows = block_diag(bases).toarray(), np.concatenate(remainders)
    scales = [
        placed_columns(model, cells.means, [ActuatorScale()])
        for cells, model in zip(sessions, models, strict=True)
    ]
    for number, place in enumerate(LEG_NAMES):
        travels, levels, changes = [], set(), []
        for cells, model, columns in zip(sessions, models, scales, strict=True):
            travel = (command(model.geometry, cells.means) - model.geometry.zero_mm)[:, number]
            moved, scale_columns = travel != 0.0, columns.get((ActuatorScale(), place))
            levels |= set(travel[moved & (cells.means.leg == number)].round(3).tolist())
            change = np.zeros(len(travel)) if scale_columns is None else scale_columns[:, 0]
            changes.append(
                np.where(moved, change / np.where(moved, PER_THOUSAND * travel, 1.0), 0.0)
            )
            travels.append(travel)
        if len(levels) >= LEAST_LEVELS:
            yield SearchedScrew(sessions, travels, changes, without(basis, rows), basis)
