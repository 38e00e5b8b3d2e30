"""One posterior of one or several sessions, as they are and put right in each way."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.posterior.cells import Cells, SessionCase
from calib.posterior.first_takes import first_takes_apart
from calib.posterior.labels import with_mistakes
from calib.posterior.library import Component
from calib.posterior.library import laws as library_laws
from calib.posterior.models import Posterior, WeightedModel
from calib.posterior.problem import SolvedSessions, Way
from calib.posterior.screws import with_searched_leads
from calib.posterior.selection import LIGHTEST
from calib.posterior.statements import AS_STATED, DIRECTIONS, NOTHING, Statement
from calib.posterior.tool import tool_field
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.effect import Effect
from calib.tripod.movements import with_first_movements

CHANGED = 0.03
"""Probability that joint offsets changed between sessions of one state of the machine: a switch was
moved or slipped, or what was entered is not what the file says. Ten times that of other bars, which
look the same to a short session: bars have to be taken off for that."""
CHANGES_MM = (0.1, 1.0)
"""Standard deviations of such a change, equally likely: with the large one alone small changes were
called other bars, which have scales, too: with 0.99, of an offset that drifted by 0.1 mm, and the
tool was off by 0.020 mm with a bound of 0.011. It is expected about the offsets before: a session
of one leg would else pull those of the others towards what the file says."""


TYPED_IN = 0.2
"""How likely the places of towers in a printer's firmware are a guess. Of 14 printers of which
owners have published the file six began 3 to 16 mm beside the radius of their calibration, the
others within 2 mm; of printers that were calibrated before, fewer. Ten measured heights of another
turn two of its towers by 3 and 4 mm."""


def posterior(cases: Sequence[SessionCase], effects: Sequence[Effect] | None = None) -> Posterior:
    """The posterior of these sessions together. Raises NotIdentifiable where no fit exists."""
    shares = _shares(cases)
    cells_by_statement = {
        s: Cells.of_all([replace(case, as_stated=s) for case in cases]) for s in shares
    }
    sessions = cells_by_statement[NOTHING]
    laws = with_searched_leads(CATALOGUE if effects is None else effects, sessions)
    laws = (*laws, *_adopted_variants(cases[-1], laws))
    ways = [
        way for s, share in shares.items() for way in _ways(cells_by_statement[s], math.log(share))
    ]
    return _mixed(with_mistakes(ways, laws))


def _shares(cases: Sequence[SessionCase]) -> dict[Statement, float]:
    """How likely so much of the machine is as its file states it; what comes first is least."""
    if not any(case.geometry for case in cases):
        return {NOTHING: 1.0}
    shares = {statement: statement.prior for statement in AS_STATED}
    if cases[0].model.geometry.common_zero:  # no towers
        firmware = [statement for statement in AS_STATED if statement.of_firmware]
        shares[DIRECTIONS] += math.fsum(shares.pop(statement) for statement in firmware)
    if not any(case.radius_mm for case in cases):
        return shares
    measured = {statement: (1.0 - TYPED_IN) * share for statement, share in shares.items()}
    as_measured = replace(NOTHING, name="radius", guessed=False)
    return {NOTHING: TYPED_IN, as_measured: measured.pop(NOTHING), **measured}


def _adopted_variants(case: SessionCase, effects: Sequence[Effect]) -> list[Effect]:
    """Laws of adopted effects of which the library has other variants only, as screws' leads.

    And parameters of geometry that it has not.
    """
    laws = library_laws(case.model.geometry, effects)
    ids = {law.id for law in laws} | {law.id for law in case.named_beyond}
    adopted = dict.fromkeys((*(law for law, _ in case.free_spread), *case.named_beyond))
    return [law for law in adopted if law.id in ids and law not in laws]


def _ways(sessions: Sequence[Cells], log_prior: float) -> list[Way]:
    """How sessions may have come about.

    Joint offsets of sessions of one state of the machine are the same but for homing, or changed by
    more.
    """
    states = [cells.case.state for cells in sessions if cells.case.state is not None]
    if len(states) == len(set(states)):
        return _ways_of_first_takes(sessions, log_prior)
    ways = _ways_of_first_takes(sessions, log_prior + math.log(1.0 - CHANGED))
    share = log_prior + math.log(CHANGED / len(CHANGES_MM))
    for mm in CHANGES_MM:
        changed = [replace(cells, case=replace(cells.case, homing_mm=mm)) for cells in sessions]
        ways += _ways_of_first_takes(changed, share)
    return ways


def _ways_of_first_takes(sessions: Sequence[Cells], log_prior: float) -> list[Way]:
    """Nobody saw how the first postures of mountings were reached, or repeats tell.

    First takes that depart from these were reached from the other side, or are within a play.
    """
    moved, apart, mistakes = [], [], []
    for number, cells in enumerate(sessions):
        visits = with_first_movements(cells.case.model.geometry, cells.visits)
        changed = not np.array_equal(visits.movement, cells.visits.movement)
        moved.append(Cells.of_visits(cells.case, visits) if changed else cells)
        mistake = first_takes_apart(cells, number)
        apart.append(Cells.of_visits(cells.case, mistake.visits) if mistake else cells)
        mistakes += [mistake] if mistake else []
    ways = [Way(sessions, log_prior)]
    if any(new is not old for new, old in zip(moved, sessions, strict=True)):
        ways.append(Way(moved, log_prior))
    if mistakes:
        ways.append(Way(apart, log_prior, tuple(mistakes), with_play=True))
    return ways


def _mixed(solutions: Sequence[SolvedSessions]) -> Posterior:
    """The sessions as they are, and put right in each way, weighed by their evidence.

    The first knows the sessions; each has components of its own, since its rows differ.
    """
    log = np.array([result.log_weight for result in solutions])
    share = np.exp(log - log.max())
    share /= share.sum()
    share = np.where(share > LIGHTEST, share, 0.0) / share[share > LIGHTEST].sum()
    components: list[Component] = []
    models: list[WeightedModel] = []
    for result, weight in zip(solutions, share.tolist(), strict=True):
        if not weight:
            continue
        first = len(components)
        models += [
            replace(
                model,
                key=tuple((first + k, scale) for k, scale in model.key),
                everywhere=tuple(first + k for k in model.everywhere),
                weight=weight * model.weight,
                mistakes=result.way.mistakes,
                as_stated=result.way.sessions[-1].case.as_stated,
            )
            for model in result.posterior.models
        ]
        components += result.posterior.components
    likeliest = solutions[0].posterior
    laws = (law for result in solutions for law in result.posterior.field.columns)
    field = tool_field(likeliest.geometry, tuple(dict.fromkeys(laws)))
    return Posterior(likeliest.sessions, tuple(components), tuple(models), field, likeliest.linear)
