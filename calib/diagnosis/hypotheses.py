"""What may be missing: the catalogue at every place, powers of travel, other bars.

What each costs before any reading, and which a procedure cannot tell apart.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from calib.arrays import (
    BLIND,
    FloatArray,
    Observations,
    stacks,
    without,
)
from calib.diagnosis.policy import POLICY
from calib.diagnosis.problem import Case, Problem
from calib.diagnosis.results import AliasMap, Imitation
from calib.diagnosis.screws import with_searched_leads
from calib.diagnosis.selection import contained
from calib.noise.reading import IndicatorFigures
from calib.tripod.effects.candidates import Candidate, candidates, candidates_together, invisible
from calib.tripod.effects.effect import Effect, EffectParameter, Kind
from calib.tripod.effects.empirical import BASES, Empirical
from calib.tripod.pipeline import Model, Stage

SURE = 2.0
"""Standard uncertainties by which a size must be beyond its limit."""

MOST_LOSS = 200.0
"""What a candidate's own size may cost; a model's sizes together cost without limit."""

ALL = "all"
LENGTHS = "leg_length"
LENGTH = EffectParameter("length", "mm", 0.1)

ALIAS_NOISE_MM = 0.002
"""Noise beside which effects are compared."""

TOLERANCE_MM = (2.0, 2.0, 2.0, 0.1, 0.1, 0.1)
"""Of joint offsets and bar lengths."""


def hypotheses_of(problem: Problem, effects: Sequence[Effect]) -> list[Candidate]:
    """Every candidate that the sessions can show, stacked over them; other bars in one of them.

    Powers of one carriage's travel run beside them: what they do as well is not claimed by name.
    """
    sessions = [(one.model, one.observed) for one in problem.fitted_sessions]
    powers = [Empirical((name,)) for name in BASES if BASES[name].stage == Stage.ACTUATOR]
    every = candidates_together(sessions, [*with_searched_leads(problem, effects), *powers])
    known = [one for one in every if one.kind != Kind.EMPIRICAL or one.arrangement == "one"]
    return [*known, *_other_bars(problem)]


def is_known(candidate: Candidate) -> bool:
    """Whether it is an effect with a name; no mistake, no power of travel."""
    return candidate.kind not in (Kind.BLUNDER, Kind.EMPIRICAL)


def _other_bars(problem: Problem) -> list[Candidate]:
    """Each session but the first measured with bars of other lengths."""
    sessions = problem.fitted_sessions
    of_row = np.repeat(np.arange(len(sessions)), [len(one.observed) for one in sessions])
    title = "the bars are not those of the first session: diagnose the sessions one at a time"
    found = []
    for k, one in enumerate(sessions[1:], start=1):
        columns = np.zeros((len(of_row), 3))
        columns[of_row == k] = one.base[:, 3:] / one.case.tolerance_mm[3:]
        what = "other_bars", title, Kind.BLUNDER, f"session {k + 1}", "one"
        found.append(Candidate(*what, (LENGTH,) * 3, columns))
    return found


def causes_of(candidate: Candidate) -> int:
    """How many things are wrong at once: axes, bars, indicators with values of their own.

    Lengths beyond their tolerance are one: who made one bar so made the others.
    """
    together = candidate.kind == Kind.ENVIRONMENT or candidate.id == LENGTHS
    if candidate.arrangement != "each" or together:
        return 1
    if candidate.kind == Kind.INDICATOR:
        return len(candidate.shares)
    return 1 + candidate.where.count(",")


def unremarkable(candidate: Candidate) -> FloatArray:
    """Sizes of its parameters ``(r,)`` that nobody would remark on."""
    return np.array([parameter.tolerance for parameter in candidate.parameters])


def log_priors(problem: Problem, candidates: Sequence[Candidate]) -> FloatArray:
    """What each candidate costs in log weight ``(J,)``: to be chosen, and for its size."""
    lost = np.minimum(losses(problem, [[one] for one in candidates]), MOST_LOSS)
    return np.asarray(log_choices(candidates) + lost)


def log_choices(candidates: Sequence[Candidate]) -> FloatArray:
    """What it costs to choose each ``(J,)``, every cause of it anew, before any reading.

    All effects are equally likely; then whether one part errs or identical parts err alike; then
    which, and in which arrangement. Variants, such as screws of other leads, count as one. Bars
    need not be chosen: that they are off is known, only not how far.
    """
    causes = [causes_of(one) for one in candidates]
    simple = {
        (one.id, one.where, one.arrangement)
        for one, count in zip(candidates, causes, strict=True)
        if count == 1
    }
    ways = Counter((name, where == ALL) for name, where, _ in simple)
    kinds = Counter(name for name, _ in ways)
    effects = len({one.id for one in candidates})
    choices = [
        (1 if one.id == LENGTHS else effects)
        * max(kinds[one.id], 1)
        * max(ways[one.id, one.where == ALL], 1)
        for one in candidates
    ]
    return np.asarray(np.array(causes) * np.log(np.array(choices, dtype=np.float64)))


def losses(problem: Problem, together: Sequence[Sequence[Candidate]]) -> FloatArray:
    """What sets of candidates lose ``(k,)`` for the sizes that they would need, in log weight.

    A normal prior on each parameter, thirty times the unremarkable size wide and cut off at its
    limit: a fit that needs more pays, and directions that hardly show are not inflated.
    """
    sizes = [POLICY.far * np.concatenate([unremarkable(one) for one in some]) for some in together]
    limits = [np.array([p.limit for one in some for p in one.parameters]) for some in together]
    columns = [np.hstack([one.columns for one in some]) for some in together]
    found = np.zeros(len(together))
    y = problem.y[:, None]
    for alike, stacked in stacks([c * s for c, s in zip(columns, sizes, strict=True)]):
        white = problem.free(stacked)
        left, singular, right = np.linalg.svd(white, full_matrices=False)
        seen = singular > BLIND * singular.max(axis=1, keepdims=True, initial=0.0)
        along = left.transpose(0, 2, 1) @ y
        free = y - left @ (seen[:, :, None] * along)
        held = 1.0 / (singular**2 + 1.0)
        value = ((singular * held * along[:, :, 0])[:, None] @ right)[:, 0]
        unsure = (held[:, None] @ right**2)[:, 0]
        most = np.array([limits[k] / sizes[k] for k in alike]) + SURE * np.sqrt(unsure)
        value = np.clip(value, -most, most)
        residual = y - white @ value[:, :, None]
        loss = (residual**2).sum(axis=(1, 2)) - (free**2).sum(axis=(1, 2)) + (value**2).sum(axis=1)
        found[alike] = np.maximum(0.5 * loss, 0.0)
    return found


def prior_constrained(white: FloatArray, y: FloatArray) -> FloatArray:
    """Least squares ``(k,)`` with a unit normal prior on each value."""
    inverse = np.linalg.solve(white.T @ white + np.eye(white.shape[1]), white.T)
    return np.asarray(inverse @ y)


def alias_map(model: Model, taken: Observations, effects: Sequence[Effect]) -> AliasMap:
    """Compare every effect in its smallest places with every other; base parameters are free.

    ``taken`` holds the readings of a procedure; their values do not matter.
    """
    figures = IndicatorFigures(repeatability_mm=ALIAS_NOISE_MM)
    session = Case(model, taken, figures, np.array(TOLERANCE_MM)).fitted()
    problem = Problem.of([session])
    compared = [c for c in candidates(model, session.observed, effects) if c.arrangement != "each"]
    blocks = problem.blocks([c.columns for c in compared])
    found = []
    for i, first in enumerate(compared):
        for j, second in enumerate(compared):
            if first.id == second.id or not blocks[i].shape[1]:
                continue
            share = contained(blocks[i], blocks[j])
            if share > POLICY.alike:
                column = problem.free(first.columns @ unremarkable(first))
                rest = float((without(blocks[j], column) ** 2).sum())
                pair = (first.id, first.where), (second.id, second.where)
                found.append(Imitation(*pair, share, rest))
    return AliasMap(
        tuple(dict.fromkeys((c.id, c.where) for c in compared)),
        tuple(found),
        invisible(model, session.observed, effects),
    )
