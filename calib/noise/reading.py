"""How much a single reading scatters, how well that is known, and what each reading weighs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.special import fdtrc

from calib.arrays import FloatArray, IntArray, Observations, descending, numbered, ranks
from calib.noise.repeats import (
    Outlier,
    Repeats,
    arithmetic_mm2,
    cycle_drift,
    outlying_readings,
)
from calib.noise.rounding import quantisation_of_repeatability, quantisation_variance

NoiseSource = Literal["repeats", "instrument", "residuals"]
Repeated = Literal["nothing", "equal", "rounding", "scatter"]

LEAST_NOISE_MM = 1e-9
"""Less than this is arithmetic, not measurement."""

POOLING_LEVEL = 0.01
"""Chance that indicators of equal scatter are kept apart."""


@dataclass(frozen=True)
class IndicatorNoise:
    """Variance (mm²) of one indicator's readings: what repeats show, and what they all share.

    ``quantisation_mm2`` is the part of the rounding that repeats in one posture have in common
    (`calib.noise.rounding`). ``degrees_of_freedom`` belong to ``repeatability_mm2``.
    """

    repeatability_mm2: float
    quantisation_mm2: float
    degrees_of_freedom: float

    @property
    def variance_mm2(self) -> float:
        """Variance of a single reading."""
        return self.repeatability_mm2 + self.quantisation_mm2


@dataclass(frozen=True)
class Noise:
    """Noise of single readings: one entry of ``indicators`` for each indicator.

    Those of a session are all the same where ``pooled``; equal ones share one estimate.
    ``outliers`` are readings that do not fit their own repeats; they are counted nevertheless.
    Degrees of freedom are infinite for a stated instrument: taken as known (GUM 4.3, type B).
    ``repeated`` is what repeats show: nothing where there are none, equal readings, less scatter
    than rounding, or scatter. ``cycle_drift_mm`` is how far readings drift from cycle to cycle
    where that is more than chance; it is not in the variances.
    """

    indicators: tuple[IndicatorNoise, ...]
    source: NoiseSource
    pooled: bool = True
    outliers: tuple[Outlier, ...] = ()
    repeated: Repeated = "nothing"
    cycle_drift_mm: float | None = None

    @classmethod
    def of_sessions(cls, noises: Sequence[Noise]) -> Noise:
        """Noise of several sessions: the indicators of each, in the order of the sessions."""
        indicators = tuple(indicator for noise in noises for indicator in noise.indicators)
        pooled = all(noise.pooled for noise in noises)
        return replace(noises[0], indicators=indicators, pooled=pooled)

    @property
    def standard_deviation_mm(self) -> float:
        """Standard deviation of a single reading, mean square over the indicators, mm."""
        return math.sqrt(
            sum(indicator.variance_mm2 for indicator in self.indicators) / len(self.indicators)
        )

    @property
    def scatter_of_repeats(self) -> tuple[float, float]:
        """What repeats scatter by, mean square over the indicators, mm; its degrees of freedom."""
        scatter_mm2 = sum(indicator.repeatability_mm2 for indicator in self.indicators)
        estimates = {*self.estimates.tolist()}
        free = sum(self.indicators[number].degrees_of_freedom for number in estimates)
        return math.sqrt(scatter_mm2 / len(self.indicators)), free

    @property
    def quiet_mm2(self) -> float:
        """Variance of a single reading of the quietest indicator."""
        return min(indicator.variance_mm2 for indicator in self.indicators)

    @property
    def degrees_of_freedom(self) -> float:
        """Degrees of freedom of that standard deviation (Welch and Satterthwaite, GUM G.4.1)."""
        total = sum(indicator.variance_mm2 for indicator in self.indicators)
        scatter = np.array([indicator.repeatability_mm2 for indicator in self.indicators])
        spread = sum(
            float(scatter[self.estimates == number].sum()) ** 2
            / self.indicators[number].degrees_of_freedom
            for number in set(self.estimates.tolist())
        )
        return total**2 / spread if spread > 0.0 else math.inf

    @property
    def estimates(self) -> IntArray:
        """For each indicator the first one ``(n_indicators,)`` that shares its estimate."""
        first: dict[IndicatorNoise, int] = {}
        numbers = [first.setdefault(indicator, k) for k, indicator in enumerate(self.indicators)]
        return np.array(numbers, dtype=np.intp)

    def for_indicators(self, count: int) -> Noise:
        """The noise for so many indicators, all alike."""
        shares = [
            (indicator.repeatability_mm2, indicator.quantisation_mm2)
            for indicator in self.indicators
        ]
        scatter, shared = np.mean(shares, axis=0).tolist()
        alike = IndicatorNoise(scatter, shared, self.degrees_of_freedom)
        return replace(self, indicators=(alike,) * count, pooled=True, outliers=())

    def repeatability_mm2(self, observations: Observations) -> FloatArray:
        """Variance of each value ``(n_readings,)`` that repeats reduce, mm²."""
        scatter = np.array([indicator.repeatability_mm2 for indicator in self.indicators])
        return np.asarray(scatter[observations.indicator] / observations.averaged)

    def quantisation_mm2(self, observations: Observations) -> FloatArray:
        """Variance that each value ``(n_readings,)`` shares with its repeats, mm²."""
        shared = np.array([indicator.quantisation_mm2 for indicator in self.indicators])
        return np.asarray(shared[observations.indicator])

    def scattering(self, factor: float) -> Noise:
        """The noise with the variance that repeats show times ``factor``."""
        return replace(
            self,
            indicators=tuple(
                replace(indicator, repeatability_mm2=indicator.repeatability_mm2 * factor)
                for indicator in self.indicators
            ),
        )


def reading_weights(observations: Observations, noise: Noise | None) -> FloatArray:
    """Weight of each value ``(n_readings,)`` in 1/mm² such that those of a posture add up right.

    Values of one mounting in one posture have together the weight of their mean,
    1/(repeatability/n + quantisation). Without a noise the number of averaged readings serves.
    """
    if noise is None:
        return observations.averaged
    place = observations.posture
    together = np.bincount(place, observations.averaged)[place]
    share = observations.averaged / together
    of_mean = share * noise.repeatability_mm2(observations) + noise.quantisation_mm2(observations)
    return np.asarray(share / of_mean)


@dataclass(frozen=True)
class IndicatorFigures:
    """What is stated or seen of the indicators, in mm; None where nothing is known.

    ``repeatability_mm`` is a standard deviation. ``step_mm`` is the step in which the readings are
    written down; it tells when repeats are too equal to mean anything. ``values_step_mm`` is the
    coarser step on which all values lie beyond chance (`calib.noise.display`): with repeats, or
    with a stated repeatability, it serves as a stated resolution does.
    """

    resolution_mm: float | None = None
    repeatability_mm: float | None = None
    step_mm: float | None = None
    values_step_mm: float | None = None

    @property
    def display_mm(self) -> float:
        """Step of the display, stated or seen; 0 where neither is known."""
        return max(self.resolution_mm or 0.0, self.step_mm or 0.0, self.values_step_mm or 0.0)

    @property
    def display_found_mm(self) -> float | None:
        """Step of the display where the values show a coarser one than is stated or written."""
        step_mm = max(self.resolution_mm or 0.0, self.step_mm or 0.0)
        return self.values_step_mm if (self.values_step_mm or 0.0) > step_mm else None

    @property
    def _resolved_mm(self) -> float:
        return max(self.resolution_mm or 0.0, self.values_step_mm or 0.0)

    @property
    def stated_mm(self) -> float | None:
        """Standard deviation of a reading, rounding included, where repeatability is stated."""
        if not self.repeatability_mm:
            return None
        return math.hypot(self.repeatability_mm, self._resolved_mm / math.sqrt(12.0))

    def noise(self, indicator_count: int = 1) -> Noise | None:
        """Noise from resolution and repeatability, None where neither is stated.

        Rounding to a step r adds a variance of ``r² / 12`` (GUM F.2.2.1). A step that only the
        values show is no noise by itself: without repeats nothing tells how much is added to it.
        """
        if not self.resolution_mm and not self.repeatability_mm:
            return None
        scatter, step = self.repeatability_mm or 0.0, self._resolved_mm
        rounding = float(quantisation_variance(np.array([scatter]), step)[0])
        repeatability = scatter**2 + step**2 / 12.0 - rounding
        if repeatability + rounding <= LEAST_NOISE_MM**2:
            return None
        indicator_noise = IndicatorNoise(max(repeatability, 0.0), rounding, math.inf)
        return Noise((indicator_noise,) * indicator_count, "instrument")


def visit_means(observations: Observations, visit: IntArray | None = None) -> Observations:
    """Average what was read in place: readings of a mounting with no motion between them.

    Neither of the machine nor of a stand along its plane. ``visit`` ``(n_readings,)`` numbers the
    visits as they begin, where that is known better than by postures.

    Such repeats share the error of their approach, so they count as one reading, not as several.
    """
    visit = visit_numbers(observations) if visit is None else visit
    first = np.unique(visit, return_index=True)[1]
    if len(first) == len(observations):
        return observations
    weight = np.bincount(visit, observations.averaged)
    mean = np.bincount(visit, observations.averaged * observations.value_mm) / weight
    return replace(
        observations.take(first),
        value_mm=mean,
        averaged=weight / np.bincount(visit).astype(np.float64),
    )


def visit_starts(observations: Observations) -> IntArray:
    """Row of the first reading of each visit ``(n_visits,)``, in the order of `visits`."""
    return np.asarray(np.unique(visit_numbers(observations), return_index=True)[1])


def visit_numbers(observations: Observations) -> IntArray:
    """Number of the visit that each reading ``(n_readings,)`` belongs to, counted as they begin.

    The tool leaves the plate after each contact.
    """
    order = np.argsort(observations.mount, kind="stable")
    mount, posture = observations.mount[order], observations.posture[order]
    begins = np.append(True, (np.diff(mount) != 0) | (np.diff(posture) != 0))[: len(order)]
    begins |= observations.contact[order]
    visit = np.empty(len(order), dtype=np.intp)
    visit[order] = numbered(order[begins])[np.cumsum(begins) - 1]
    return visit


def reading_noise(
    visits: Observations,
    indicator: IndicatorFigures,
    apart: Sequence[int] = (),
    *,
    steady: bool = False,
) -> Noise | None:
    """Noise from repeats where they tell something, else from the stated instrument, else None.

    The scatter of repeats is taken for each indicator, drift removed, and pooled but for those that
    scatter more than chance allows. Repeats that all agree say nothing: then the resolution
    rules, stated or seen in the text of the readings. Rows that stand ``apart`` are no repeats, a
    ``steady`` drift is removed as in `Repeats.of`, unless it leaves nothing of the repeats. The
    resolution of a probe alone is no noise of contacts.
    """
    repeats = Repeats.of(visits, apart, steady=steady)
    if steady and repeats.degrees_of_freedom.sum() <= 0.0:
        repeats = Repeats.of(visits, apart)
    free = repeats.degrees_of_freedom
    step = indicator.display_mm
    squares = repeats.sums_of_squares(visits.value_mm)
    if free.sum() <= 0.0:
        # a probe trips within many of its steps: without repeats these alone tell no noise
        only_steps = visits.contact.all() and not indicator.repeatability_mm
        return None if only_steps else indicator.noise(visits.indicator_count)
    if float(squares.sum()) <= arithmetic_mm2(visits) * free.sum():
        count = visits.indicator_count
        stated_noise = indicator.noise(count) or IndicatorFigures(resolution_mm=step).noise(count)
        return replace(stated_noise, repeated="equal") if stated_noise else None
    estimates = _noise_of_indicators(squares, free, step)
    scatter = sum(estimate.repeatability_mm2 for estimate in estimates)
    rounding = sum(estimate.quantisation_mm2 for estimate in estimates)
    floor = step**2 / 12.0
    noise = Noise(
        estimates,
        "repeats",
        len(set(estimates)) == 1,
        outlying_readings(repeats, floor),
        "scatter",
        cycle_drift(repeats, floor),
    )
    if scatter >= rounding:
        return noise
    return replace(noise, source="instrument", repeated="rounding")


def _noise_of_indicators(
    squares: FloatArray, free: FloatArray, step: float
) -> tuple[IndicatorNoise, ...]:
    """Variances of each indicator: the noisy ones their own, all others the pooled ones.

    The noisiest is set aside until the rest may be pooled. One without repeats of its own gets what
    all together show.
    """
    judged = np.flatnonzero(free > 0.0)
    quiet = judged[np.argsort(-ranks(squares[judged] / free[judged]), kind="stable")]
    while not may_be_pooled(squares[quiet], free[quiet], step):
        quiet = quiet[:-1]
    pooled = _split(float(squares[quiet].sum()), float(free[quiet].sum()), step)
    alone = len(quiet) < len(judged)
    noise_of_all = _split(float(squares.sum()), float(free.sum()), step) if alone else pooled
    estimates = [noise_of_all] * len(free)
    for k in judged:
        indicator_noise = _split(float(squares[k]), float(free[k]), step)
        estimates[k] = pooled if k in quiet else indicator_noise
    return tuple(estimates)


def _split(square_sum: float, degrees_of_freedom: float, step: float) -> IndicatorNoise:
    scatter = square_sum / degrees_of_freedom
    shared = quantisation_of_repeatability(np.array([scatter]), step, degrees_of_freedom)
    return IndicatorNoise(scatter, float(shared[0]), degrees_of_freedom)


def may_be_pooled(squares: FloatArray, free: FloatArray, step: float) -> bool:
    """Whether none scatters more than the others by more than chance (variance ratio).

    ``squares`` and ``free`` ``(k,)`` are square sums and degrees of freedom of what is compared.
    """
    judged = free > 0.0
    square, nu = squares[judged], free[judged]
    if len(nu) < 2:
        return True
    remaining_square, remaining_nu = square.sum() - square, nu.sum() - nu
    variances = _variances(square / nu, step, nu)
    pooled = _variances(remaining_square / remaining_nu, step, remaining_nu)
    never = np.full_like(variances, np.inf)
    ratio = np.divide(variances, pooled, out=never, where=pooled > 0.0)
    return bool((fdtrc(nu, remaining_nu, ratio) * len(nu) >= POOLING_LEVEL).all())


def _variances(repeatability_mm2: FloatArray, step: float, free: FloatArray) -> FloatArray:
    scatter = np.maximum(repeatability_mm2, 0.0)
    return np.asarray(scatter + quantisation_of_repeatability(scatter, step, free))


@dataclass(frozen=True)
class NoisyIndicator:
    """An indicator that scatters more than the quietest: its first row and its scatter, mm.

    ``mounting`` is False where it was used in more than one mounting; ``number`` counts from 1.
    """

    row: int
    mounting: bool
    number: int
    scatter_mm: float


def noisy_indicators(observations: Observations, noise: Noise) -> list[NoisyIndicator]:
    """Indicators with an estimate of their own, the noisiest first."""
    quiet = noise.quiet_mm2
    noisy = []
    for k, indicator in enumerate(noise.indicators):
        if indicator.variance_mm2 > quiet:
            rows = np.flatnonzero(observations.indicator == k)
            single = len(np.unique(observations.mount[rows])) == 1
            scatter = math.sqrt(indicator.variance_mm2)
            noisy.append(NoisyIndicator(int(rows[0]), single, k + 1, scatter))
    return descending(noisy, lambda indicator: indicator.scatter_mm)


def single_posture_rows(observations: Observations) -> list[IntArray]:
    """Rows of each mounting of a single posture: without another one they say nothing."""
    posture = numbered(observations.displacement_mm, *observations.position_mm.T)
    return [rows for rows in observations.mountings if len(np.unique(posture[rows])) == 1]


LEAST_STILL = 3
"""Postures from which on it is worth a look that an indicator reads the same in all of them: two
are alike wherever a leg happens to be true to a step of the display."""


def still_rows(observations: Observations) -> list[IntArray]:
    """Rows of each mounting that reads one value in `LEAST_STILL` postures or more; no contacts."""
    return [
        rows
        for rows in observations.mountings
        if len(np.unique(observations.posture[rows])) >= LEAST_STILL
        and not observations.contact[rows].any()
        and not np.ptp(observations.value_mm[rows])
    ]
