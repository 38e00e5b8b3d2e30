"""Simulated sessions for the tests of the diagnosis, as its steps take them."""

from __future__ import annotations

import numpy as np

from calib.arrays import Observations, observe
from calib.diagnosis.problem import Case, Problem
from calib.diagnosis.results import Diagnosis
from calib.noise.reading import IndicatorFigures
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.pipeline import Model, measure
from tests.builders import conditions_of

TOLERANCE_MM = np.array([2.0] * 3 + [0.1] * 3)
LAWS = {effect.id: effect for effect in reversed(CATALOGUE)}


SWEEP, TWO_STATION, SHORT = map(conditions_of, ("sweep", "two-station", "zero-max-min"))


def case(
    taken: Observations,
    *effects: EffectInstance,
    seed: int = 0,
    scatter_mm: float = 0.002,
    model: Model | None = None,
) -> Case:
    generator = np.random.default_rng(seed)
    offsets = np.concatenate([generator.uniform(-2, 2, 3), generator.normal(0, 0.03, 3)])
    truth = Model(parameters_mm=tuple(offsets.tolist()), effects=effects)
    value = measure(truth, taken, scatter_mm=scatter_mm, resolution_mm=0.0, generator=generator)
    return Case(model or Model(), observe(taken, value), IndicatorFigures(), TOLERANCE_MM)


def problem(taken: Observations, seed: int) -> Problem:
    return Problem.of([case(taken, seed=seed).fitted()])


def names(found: Diagnosis) -> list[tuple[str, str]]:
    return [(one.id, one.where) for one in found.effects]
