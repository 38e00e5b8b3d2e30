"""Which effects a procedure cannot tell apart, before any reading."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import starmap

import numpy as np

from calib.arrays import Observations, squares_in, without
from calib.diagnosis.claims import NAMES
from calib.diagnosis.gap import Leftover
from calib.diagnosis.results import AliasMap, EffectName, Imitation
from calib.noise.reading import IndicatorFigures
from calib.posterior.cells import Cells, SessionCase
from calib.posterior.problem import PosteriorProblem
from calib.tripod.effects.candidates import invisible
from calib.tripod.effects.effect import Effect
from calib.tripod.pipeline import Model

NOISE_MM = 0.002
"""Noise beside which effects are compared."""

TOLERANCE_MM = (2.0, 2.0, 2.0, 0.1, 0.1, 0.1)
"""Of joint offsets and bar lengths."""

ALIKE = 0.98
"""Share of directions from which two effects are one: 8° between two directions."""


def alias_map(model: Model, planned: Observations, effects: Sequence[Effect]) -> AliasMap:
    """Compare every effect in its smallest places with every other; base parameters are free.

    ``planned`` holds the readings of a procedure; their values do not matter.
    """
    figures = IndicatorFigures(repeatability_mm=NOISE_MM)
    cells = Cells.of(SessionCase(model, planned, figures, np.array(TOLERANCE_MM)))
    problem, ids = PosteriorProblem((cells,), effects), {effect.id for effect in effects}
    leftover = Leftover.about_rows((cells,), problem.rows)
    compared = [
        (component, problem.linear.columns[:, index])
        for component, index in zip(problem.components, problem.linear.index, strict=True)
        if component.kind in NAMES and component.id in ids and component.candidate
        if component.candidate.arrangement != "each" and "axes" not in component.where
    ]
    blocks = [leftover.explained_by(columns) for _, columns in compared]
    imitations = []
    for (first, columns), inner in zip(compared, blocks, strict=True):
        for (second, _), outer in zip(compared, blocks, strict=True):
            if first.id == second.id or not inner.shape[1]:
                continue
            share = squares_in(outer, inner) / int(inner.shape[1])
            if share > ALIKE:
                column = leftover.about.left_by(columns.sum(axis=1)[:, None])
                remainder = float((without(outer, column) ** 2).sum())
                pair = EffectName(first.id, first.where), EffectName(second.id, second.where)
                imitations.append(Imitation(*pair, share, remainder))
    return AliasMap(
        tuple(
            dict.fromkeys(EffectName(component.id, component.where) for component, _ in compared)
        ),
        tuple(imitations),
        tuple(starmap(EffectName, invisible(model, cells.means, effects))),
    )
