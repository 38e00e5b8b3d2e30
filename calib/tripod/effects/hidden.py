"""An effect for a simulated machine, of a size that its readings show well."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.arrays import DEPENDENT, Conditions, FloatArray, basis_of, incidence, tilts, without
from calib.tripod.effects.candidates import Candidate
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.pipeline import Model, derivatives

LEAST_SIGNAL, MOST_SIGNAL = 3.0, 5.0
"""R.m.s. of what offsets and lengths cannot imitate, in noise."""

NEARLY_AS_PLAIN = 0.5
"""Arrangements that show at least this part of what the plainest one shows may be hidden."""

MOST_TOLERANCES = 60.0
"""A larger effect would be noticed without measuring; a smaller signal is taken instead …"""

FAINTEST_SIGNAL = 1.0
"""… down to this, in noise: many readings still show it clearly."""

DRAWS = 4
"""Of so many directions the one that shows best is taken: values of one leg may cancel."""

ONE_SIDED = ("backlash", "gravity_sag", "joint_clearance")
"""These push one way only."""


def hidden_among(
    candidates: Sequence[Candidate],
    truth: Model,
    conditions: Conditions,
    *,
    seed: int,
    noise_mm: float,
    size: float | None = None,
) -> tuple[EffectInstance, ...]:
    """One of the candidates that these readings show plainly, and its values, by the seed.

    ``size`` is its largest value in its own unit; without it the effect is made three to five times
    the noise, or less where that would take a monstrous size. Nothing where these readings cannot
    show it.
    """
    generator = np.random.default_rng([seed, 5])
    base = derivatives(truth.geometry, truth.parameters_mm, conditions)
    basis = basis_of(np.hstack([incidence(conditions.mount), tilts(conditions), base]), DEPENDENT)
    choices = [_Choice(c, without(basis, c.columns)) for c in candidates]
    best = max(choice.plain_mm for choice in choices)
    choices = [choice for choice in choices if choice.plain_mm >= NEARLY_AS_PLAIN * best]
    choice = choices[int(generator.integers(len(choices)))]
    draws = [choice.tolerance * _direction(generator, len(choice.tolerance)) for _ in range(DRAWS)]
    values = max(draws, key=choice.signal_mm)
    if choice.candidate.id in ONE_SIDED:
        values = np.abs(values)
    if size is not None:
        return choice.candidate.effects(values * (size / np.abs(values).max()))
    signal_mm = noise_mm * generator.uniform(LEAST_SIGNAL, MOST_SIGNAL)
    factor = signal_mm / choice.signal_mm(values)
    values = values * min(factor, MOST_TOLERANCES / np.abs(values / choice.tolerance).max())
    visible = choice.signal_mm(values) >= FAINTEST_SIGNAL * noise_mm
    return choice.candidate.effects(values) if visible else ()


def _direction(generator: np.random.Generator, count: int) -> FloatArray:
    """Numbers of either sign, none small beside the others ``(count,)``."""
    sizes, signs = generator.uniform(0.4, 1.0, count), generator.choice([-1.0, 1.0], count)
    return np.asarray(sizes * signs)


@dataclass(frozen=True, eq=False)
class _Choice:
    """A candidate, and the part of its columns that offsets, lengths and zeros leave."""

    candidate: Candidate
    left: FloatArray

    @property
    def tolerance(self) -> FloatArray:
        return np.array([parameter.tolerance for parameter in self.candidate.parameters])

    @property
    def plain_mm(self) -> float:
        """R.m.s. of the weakest parameter at an unremarkable size."""
        return float(np.sqrt(((self.left * self.tolerance) ** 2).mean(axis=0)).min())

    def signal_mm(self, values: FloatArray) -> float:
        """R.m.s. of what these values leave."""
        return float(np.sqrt(((self.left @ values) ** 2).mean()))
