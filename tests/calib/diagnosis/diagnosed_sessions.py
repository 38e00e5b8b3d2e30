"""Simulated sessions for the tests of the diagnosis, and what their readings are changed to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.arrays import FloatArray, Observations, observe
from calib.diagnosis.diagnose import diagnosis_of
from calib.diagnosis.results import Diagnosis, Finding
from calib.noise.reading import IndicatorFigures
from calib.posterior.cells import SessionCase
from calib.posterior.posterior import posterior
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.effect import Effect, EffectInstance, Kind
from calib.tripod.pipeline import Model, measure
from tests.builders import conditions_of

TOLERANCE_MM = np.array([2.0] * 3 + [0.1] * 3)
LAWS = {effect.id: effect for effect in reversed(CATALOGUE)}


SWEEP, TWO_STATION, SHORT = map(conditions_of, ("sweep", "two-station", "zero-max-min"))


def diagnose(
    cases: Sequence[SessionCase],
    effects: Sequence[Effect] | None = None,
    held_out: Sequence[SessionCase] = (),
) -> Diagnosis:
    return diagnosis_of(posterior(cases, effects), held_out)


def case(
    conditions: Observations,
    *effects: EffectInstance,
    seed: int = 0,
    scatter_mm: float = 0.002,
    model: Model | None = None,
) -> SessionCase:
    generator = np.random.default_rng(seed)
    offsets = np.concatenate([generator.uniform(-2, 2, 3), generator.normal(0, 0.03, 3)])
    truth = Model(parameters_mm=tuple(offsets.tolist()), effects=effects)
    value = measure(
        truth, conditions, scatter_mm=scatter_mm, resolution_mm=0.0, generator=generator
    )
    return SessionCase(
        model or Model(), observe(conditions, value), IndicatorFigures(), TOLERANCE_MM
    )


def with_readings(session: SessionCase, observations: Observations) -> SessionCase:
    """The same machine with other readings."""
    return replace(session, observations=observations)


def with_values(session: SessionCase, value_mm: FloatArray) -> SessionCase:
    """The same postures with other values ``(n,)``."""
    return with_readings(session, replace(session.observations, value_mm=value_mm))


def names(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    return [(finding.id, finding.where) for finding in diagnosis.effects]


def mistakes(diagnosis: Diagnosis) -> list[Finding]:
    """Mistakes of the readings that are named."""
    return [finding for finding in diagnosis.effects if finding.kind == Kind.GROSS_ERROR]


def possible(diagnosis: Diagnosis) -> set[tuple[str, str]]:
    """Names at their places, and their rivals."""
    rivals = {
        (r.id, r.where) for effect in diagnosis.effects for r in effect.indistinguishable_from
    }
    return {*names(diagnosis), *rivals}
