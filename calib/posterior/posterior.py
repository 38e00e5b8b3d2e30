"""One posterior of one or several sessions, as they are and put right in each way."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.posterior.cells import Cells, SessionCase
from calib.posterior.labels import Solved, with_mistakes
from calib.posterior.library import Component
from calib.posterior.library import laws as library_laws
from calib.posterior.models import Posterior, Weighted
from calib.posterior.problem import PosteriorProblem
from calib.posterior.race import LIGHTEST
from calib.posterior.screws import with_searched_leads
from calib.posterior.tool import tool_field
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.effect import Effect
from calib.tripod.movements import with_first_movements

CHANGED = 0.003
"""Probability, as of any mistake, that joint offsets changed between sessions of one state of the
machine: a switch was moved, or what was entered is not what the file says."""
CHANGE_MM = 1.0
"""Standard deviation of such a change. It is expected about the offsets before: a session of one
leg would else pull those of the others towards what the file says."""


def posterior(cases: Sequence[SessionCase], effects: Sequence[Effect] | None = None) -> Posterior:
    """Of these sessions together. Raises NotIdentifiable where one cannot be fitted."""
    every = Cells.of_all(cases)
    laws = with_searched_leads(CATALOGUE if effects is None else effects, every)
    laws = (*laws, *_adopted_variants(cases[-1], laws))

    def solve(sessions: Sequence[Cells]) -> Solved[Posterior]:
        return PosteriorProblem.of(tuple(sessions), laws).solved()

    return _mixed(with_mistakes(_ways(every), solve))


def _adopted_variants(case: SessionCase, effects: Sequence[Effect]) -> list[Effect]:
    """Laws of adopted effects of which the library has other variants only, as screws' leads."""
    known = library_laws(case.model.geometry, effects)
    ids = {law.id for law in known}
    adopted = dict.fromkeys(law for law, _ in case.free_spread)
    return [law for law in adopted if law.id in ids and law not in known]


def _ways(sessions: Sequence[Cells]) -> list[tuple[float, list[Cells]]]:
    """How sessions may have come about, with the log prior of each.

    Nobody saw how the first postures of mountings were reached, or repeats tell. Joint offsets of
    sessions of one state of the machine are the same but for homing, or changed by more.
    """
    states = [cells.case.state for cells in sessions if cells.case.state is not None]
    if len(states) == len(set(states)):
        return [(0.0, way) for way in _ways_of_first_takes(sessions)]
    ways = [(math.log(1.0 - CHANGED), way) for way in _ways_of_first_takes(sessions)]
    changed = [replace(cells, case=replace(cells.case, homing_mm=CHANGE_MM)) for cells in sessions]
    return [*ways, *((math.log(CHANGED), way) for way in _ways_of_first_takes(changed))]


def _ways_of_first_takes(sessions: Sequence[Cells]) -> list[list[Cells]]:
    moved = []
    for cells in sessions:
        visited = with_first_movements(cells.visited)
        changed = not np.array_equal(visited.movement, cells.visited.movement)
        moved.append(Cells.of_visits(cells.case, visited) if changed else cells)
    same = all(new is old for new, old in zip(moved, sessions, strict=True))
    return [list(sessions)] if same else [list(sessions), moved]


def _mixed(every: Sequence[Solved[Posterior]]) -> Posterior:
    """The sessions as they are, and put right in each way, weighed by their evidence.

    The first knows the sessions; each has components of its own, since its rows differ.
    """
    log = np.array([one.log_weight for one in every])
    share = np.exp(log - log.max())
    share /= share.sum()
    share = np.where(share > LIGHTEST, share, 0.0) / share[share > LIGHTEST].sum()
    components: list[Component] = []
    models: list[Weighted] = []
    for one, weight in zip(every, share.tolist(), strict=True):
        if not weight:
            continue
        first = len(components)
        models += [
            replace(
                model,
                members=tuple(first + k for k in model.members),
                everywhere=tuple(first + k for k in model.everywhere),
                weight=weight * model.weight,
                mistakes=one.mistakes,
            )
            for model in one.solution.models
        ]
        components += one.solution.components
    likeliest = every[0].solution
    laws = (law for one in every for law in one.solution.field.placed)
    field = tool_field(likeliest.geometry, tuple(dict.fromkeys(laws)))
    return Posterior(likeliest.sessions, tuple(components), tuple(models), field, likeliest.linear)
