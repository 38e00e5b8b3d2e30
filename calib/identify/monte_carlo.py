"""Many simulated sessions of one kind, identified all at once: are the uncertainties true?

No loop over sessions: sessions lie along the last axis of every array, in chunks that keep the
memory flat.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import numpy as np

from calib.arrays import FloatArray, Observations
from calib.clusters import in_parallel
from calib.identify.fit import PlainFit
from calib.identify.solution import SUBSETS, Solution
from calib.newton import Optimum, normal_equations, solve_positive
from calib.noise.reading import (
    IndicatorFigures,
    IndicatorNoise,
    Noise,
    reading_weights,
    visit_means,
)
from calib.noise.repeats import Repeats
from calib.noise.rounding import quantisation_of_repeatability, scatter_of_repeatability
from calib.stats import coverage_factors
from calib.tripod.geometry import PARAMETER_NAMES
from calib.tripod.pipeline import ZERO_SPREAD_MM, Model, round_to

CHUNK = 2048
"""Sessions at once: about 20 MB of work arrays for a standard session."""

STEPS_APART = 10.0
"""Spread of the simulated machines in steps of the display: one machine alone would always meet the
same rounding."""

LEAST_LOCKED = 1e-6
"""Of the variance that repeats show: with less that they share, the display is fine enough."""


@dataclass(frozen=True, eq=False)
class Campaign:
    """What is simulated: a kind of session, the scatter of its readings, the machines.

    Every session has the postures and repeats of ``observations`` (its values do not matter). Each
    machine departs from ``model`` by normal errors of standard deviation ``spread_mm`` ``(6,)`` in
    the free parameters. With ``noise_known`` scatter and resolution are stated, not taken from the
    repeats of each session.
    """

    model: Model
    observations: Observations
    free: tuple[int, ...]
    scatter_mm: float
    resolution_mm: float
    spread_mm: FloatArray
    noise_known: bool = False

    @classmethod
    def like(
        cls, solution: Solution, observations: Observations, figures: IndicatorFigures
    ) -> Self:
        """Sessions like the one of a solution, on machines like the one it found.

        All indicators scatter alike there; with a coarse display the machines differ by some steps.
        """
        noise = solution.noise
        repeatability_mm2 = float(
            np.mean([indicator.repeatability_mm2 for indicator in noise.indicators])
        )
        rounded = any(
            indicator.quantisation_mm2 > LEAST_LOCKED * repeatability_mm2
            for indicator in noise.indicators
        )
        step = figures.display_mm if rounded else 0.0
        return cls(
            solution.model,
            visit_means(observations),
            SUBSETS[solution.subset],
            scatter_of_repeatability(repeatability_mm2, step),
            step,
            np.full(len(PARAMETER_NAMES), STEPS_APART * step),
            noise_known=noise.repeated in ("nothing", "equal"),
        )


@dataclass(frozen=True, eq=False)
class MonteCarlo:
    """Errors of identified parameters over all sessions that converged.

    ``covered`` ``(k,)`` is the share of 95 % intervals that hold the truth,
    ``error_covariance_mm2`` ``(k, k)`` the mean product of errors, ``stated_mm`` ``(k,)`` the
    standard uncertainties as they were stated, r.m.s., mm.
    """

    names: tuple[str, ...]
    sessions: int
    failed: int
    covered: FloatArray
    error_covariance_mm2: FloatArray
    stated_mm: FloatArray

    @property
    def true_mm(self) -> FloatArray:
        """Standard uncertainties as they were ``(k,)``, mm."""
        return np.sqrt(self.error_covariance_mm2.diagonal())


def simulate_and_identify(campaign: Campaign, sessions: int, seed: int) -> MonteCarlo:
    """Simulate, identify and judge so many sessions."""
    kind = _Kind(campaign)
    chunks = [(start, min(start + CHUNK, sessions)) for start in range(0, sessions, CHUNK)]
    parts = in_parallel(lambda chunk: kind.sums(seed, *chunk), chunks)
    good, covered, product, stated_variance = (
        np.sum(part, axis=0) for part in zip(*parts, strict=True)
    )
    judged = max(int(good), 1)
    return MonteCarlo(
        names=tuple(PARAMETER_NAMES[k] for k in campaign.free),
        sessions=sessions,
        failed=sessions - int(good),
        covered=covered / judged,
        error_covariance_mm2=product / judged,
        stated_mm=np.sqrt(stated_variance / judged),
    )


class _Kind:
    """One kind of session, prepared."""

    def __init__(self, campaign: Campaign) -> None:
        self.campaign, observations = campaign, campaign.observations
        count = observations.indicator_count
        expected = IndicatorFigures(campaign.resolution_mm, campaign.scatter_mm).noise(count)
        # perfect readings: equal weights, whatever they are
        expected = expected or Noise((IndicatorNoise(1.0, 0.0, math.inf),) * count, "instrument")
        self.expected, self.repeats = expected.indicators[0], Repeats.of(observations)
        weight = reading_weights(observations, expected)
        self.fit = PlainFit(campaign.model, observations, campaign.free, weight)
        self.place = np.argmax(self.fit.average > 0.0, axis=0)
        self.count_at_place = np.bincount(self.place, observations.averaged)

    def sums(
        self, seed: int, start: int, end: int
    ) -> tuple[int, FloatArray, FloatArray, FloatArray]:
        """Simulate, identify and judge the sessions of these numbers, always alike.

        How many converged, and over these: intervals that hold the truth ``(k,)``, products of
        errors ``(k, k)``, stated variances ``(k,)``.
        """
        truth, values = self.draw(end - start, np.random.default_rng([seed, start]))
        optimum = self.fit.solve(values)
        good = optimum.converged
        error = (optimum.values - truth)[:, good]
        uncertainty, factor = (part[:, good] for part in self.intervals(optimum, values))
        covered = np.abs(error) <= factor * uncertainty
        return int(good.sum()), covered.sum(axis=1), error @ error.T, (uncertainty**2).sum(axis=1)

    def draw(self, count: int, generator: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """True free parameters ``(k, count)`` and readings ``(n_readings, count)``, mm."""
        campaign, observations = self.campaign, self.campaign.observations
        index = list(campaign.free)
        truth = np.repeat(np.array(campaign.model.parameters_mm)[:, None], count, axis=1)
        spread = campaign.spread_mm[index, None]
        truth[index] += spread * generator.normal(size=(len(index), count))
        exact = self.fit.design.readings(truth)[self.place]
        zeros = generator.normal(scale=ZERO_SPREAD_MM, size=(observations.mount_count, count))
        scatter = campaign.scatter_mm / np.sqrt(observations.averaged)[:, None]
        noisy = exact + zeros[observations.mount] + scatter * generator.normal(size=exact.shape)
        return truth[index], round_to(noisy, campaign.resolution_mm)

    def intervals(self, optimum: Optimum, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Standard uncertainty and coverage factor ``(k, b)`` of each session.

        From its own repeats, pooled over the indicators.

        Where the noise is known, from that.
        """
        free, scatter_mm2, locked = self._noise(values)
        normal, _ = normal_equations(optimum.residual, optimum.jacobian)
        maps = np.einsum("kgb,gh->khb", optimum.jacobian, self.fit.whiten)
        estimator = np.stack(
            [solve_positive(normal, maps[:, h])[0] for h in range(maps.shape[1])], axis=1
        )
        square = estimator**2
        repeatability_mm2 = np.einsum("khb,h->kb", square, 1.0 / self.count_at_place) * scatter_mm2
        variance = repeatability_mm2 + square.sum(axis=1) * locked
        with np.errstate(divide="ignore", invalid="ignore"):
            degrees = np.where(
                repeatability_mm2 > 0.0, variance**2 / (repeatability_mm2**2 / free), math.inf
            )
        return np.sqrt(variance), coverage_factors(degrees)

    def _noise(self, values: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Degrees of freedom, and the variances shown and locked of each session ``(b,)``, mm²."""
        if self.campaign.noise_known:
            unit_row = np.ones(values.shape[1])
            return (
                math.inf,
                self.expected.repeatability_mm2 * unit_row,
                self.expected.quantisation_mm2 * unit_row,
            )
        free = float(self.repeats.degrees_of_freedom.sum())
        scatter_mm2 = self.repeats.sums_of_squares(values).sum(axis=0) / free
        return (
            free,
            scatter_mm2,
            quantisation_of_repeatability(scatter_mm2, self.campaign.resolution_mm, free),
        )
