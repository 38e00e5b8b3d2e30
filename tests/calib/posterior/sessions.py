"""Simulated sessions for the tests of the posterior."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.arrays import FloatArray, Observations, observe
from calib.noise.reading import IndicatorFigures
from calib.posterior.cells import SessionCase
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.pipeline import Model, measure
from tests.builders import conditions_of

SCATTER_MM = 0.002
TOLERANCE_MM = np.array([2.0] * 3 + [0.1] * 3)
SWEEP, SHORT, TWO_STATION = map(conditions_of, ("sweep", "zero-max-min", "two-station"))


def case(
    conditions: Observations, *effects: EffectInstance, seed: int = 0, model: Model | None = None
) -> SessionCase:
    """A machine with joint offsets and lengths of its own, each mounting with a zero of its own."""
    generator = np.random.default_rng(seed)
    offsets = np.concatenate([generator.uniform(-2, 2, 3), generator.normal(0, 0.03, 3)])
    truth = Model(parameters_mm=tuple(offsets.tolist()), effects=effects)
    value = measure(
        truth, conditions, scatter_mm=SCATTER_MM, resolution_mm=0.0, generator=generator
    )
    return SessionCase(
        model or Model(), observe(conditions, value), IndicatorFigures(), TOLERANCE_MM
    )


def with_values(session: SessionCase, value_mm: FloatArray) -> SessionCase:
    """The same session with other values ``(n,)``."""
    return replace(session, observations=replace(session.observations, value_mm=value_mm))
