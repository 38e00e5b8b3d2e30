"""Sessions of simulated machines for the tests of the posterior."""

from __future__ import annotations

import numpy as np

from calib.arrays import Observations, observe
from calib.noise.reading import IndicatorFigures
from calib.posterior.cells import SessionCase
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.pipeline import Model, measure
from tests.builders import conditions_of

TOLERANCE_MM = np.array([2.0] * 3 + [0.1] * 3)
LAWS = {effect.id: effect for effect in reversed(CATALOGUE)}
SWEEP, TWO_STATION, SHORT = map(conditions_of, ("sweep", "two-station", "zero-max-min"))


def hidden(id: str, place: str, *values: float) -> EffectInstance:
    """An effect of the catalogue."""
    return EffectInstance(LAWS[id], place, values)


def session(
    conditions: Observations,
    *effects: EffectInstance,
    seed: int = 0,
    scatter_mm: float = 0.001,
    offset_mm: float = 0.5,
) -> tuple[SessionCase, Model]:
    """What was read of a machine with these effects, and the machine."""
    generator = np.random.default_rng(seed)
    parameters = np.concatenate(
        [generator.uniform(-offset_mm, offset_mm, 3), generator.normal(0, 0.03, 3)]
    )
    machine = Model(parameters_mm=tuple(parameters.tolist()), effects=effects)
    value = measure(
        machine, conditions, scatter_mm=scatter_mm, resolution_mm=0.0, generator=generator
    )
    return SessionCase(
        Model(), observe(conditions, value), IndicatorFigures(), TOLERANCE_MM
    ), machine
