"""What a procedure cannot tell apart, before any data: which effect can imitate which."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.diagnosis.problem import FittedSession, Problem
from calib.diagnosis.selection import ALIKE, contained
from calib.linalg import without
from calib.noise.reading import IndicatorFigures
from calib.observations import FloatArray, Observations
from calib.tripod.effects.candidates import Candidate, candidates, invisible
from calib.tripod.effects.effect import Law
from calib.tripod.pipeline import Model

NOISE_MM = 0.002


@dataclass(frozen=True)
class Imitation:
    """How well one effect is imitated by another: 1 is never to be told apart.

    ``distinguishable`` is what the other leaves of an unremarkable size of the first, in noise
    variances: below 9 they cannot be told apart, above 25 they can.
    """

    effect: tuple[str, str]
    by: tuple[str, str]
    contained: float
    distinguishable: float


@dataclass(frozen=True)
class AliasMap:
    """Imitations that matter, in both directions, and effects that no reading shows."""

    effects: tuple[tuple[str, str], ...]
    imitations: tuple[Imitation, ...]
    invisible: tuple[tuple[str, str], ...]


def alias_map(
    model: Model, taken: Observations, laws: Sequence[Law], noise_mm: float = NOISE_MM
) -> AliasMap:
    """Compare every effect in its smallest places with every other; base parameters are free.

    ``taken`` holds the readings of a procedure; their values do not matter.
    """
    tolerance = np.array([2.0] * 3 + [0.1] * 3)
    figures = IndicatorFigures(repeatability_mm=noise_mm)
    problem = Problem.of([FittedSession.of(model, taken, figures, tolerance)])
    observed = problem.fitted_sessions[0].observed
    runners = [c for c in candidates(model, observed, laws) if c.arrangement != "each"]
    blocks = [problem.block(c.columns) for c in runners]
    found = []
    for i, first in enumerate(runners):
        for j, second in enumerate(runners):
            if i == j or first.id == second.id or not blocks[i].shape[1]:
                continue
            share = contained(blocks[i], blocks[j])
            if share > ALIKE:
                rest = _left(problem, first, blocks[j])
                found.append(
                    Imitation((first.id, first.where), (second.id, second.where), share, rest)
                )
    return AliasMap(
        tuple(dict.fromkeys((c.id, c.where) for c in runners)),
        tuple(found),
        invisible(model, observed, laws),
    )


def _left(problem: Problem, candidate: Candidate, other: FloatArray) -> float:
    """What another block leaves of this candidate at an unremarkable size, in noise variances."""
    size = np.array([p.tolerance for p in candidate.parameters])
    rest = without(other, problem.free(candidate.columns @ size))
    return float((rest**2).sum())
