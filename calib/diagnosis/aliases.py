"""What a procedure cannot tell apart, before any data: which effect can imitate which."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.diagnosis.hypotheses import unremarkable
from calib.diagnosis.problem import Case, Problem
from calib.diagnosis.selection import ALIKE, contained
from calib.linalg import without
from calib.noise.reading import IndicatorFigures
from calib.observations import Observations
from calib.tripod.effects.candidates import candidates, invisible
from calib.tripod.effects.effect import Law
from calib.tripod.pipeline import Model

NOISE_MM = 0.002
TOLERANCE_MM = (2.0, 2.0, 2.0, 0.1, 0.1, 0.1)
"""Of joint offsets and bar lengths."""


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


def alias_map(model: Model, taken: Observations, laws: Sequence[Law]) -> AliasMap:
    """Compare every effect in its smallest places with every other; base parameters are free.

    ``taken`` holds the readings of a procedure; their values do not matter.
    """
    figures = IndicatorFigures(repeatability_mm=NOISE_MM)
    session = Case(model, taken, figures, np.array(TOLERANCE_MM)).fitted()
    problem = Problem.of([session])
    compared = [c for c in candidates(model, session.observed, laws) if c.arrangement != "each"]
    blocks = [problem.block(c.columns) for c in compared]
    found = []
    for i, first in enumerate(compared):
        for j, second in enumerate(compared):
            if first.id == second.id or not blocks[i].shape[1]:
                continue
            share = contained(blocks[i], blocks[j])
            if share > ALIKE:
                column = problem.free(first.columns @ unremarkable(first))
                rest = float((without(blocks[j], column) ** 2).sum())
                pair = (first.id, first.where), (second.id, second.where)
                found.append(Imitation(*pair, share, rest))
    return AliasMap(
        tuple(dict.fromkeys((c.id, c.where) for c in compared)),
        tuple(found),
        invisible(model, session.observed, laws),
    )
