"""The next mounting worth reading: what lowers the expected tool error most per minute."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from calib.design.criteria import covariances_after, inverse
from calib.errors import NotIdentifiable
from calib.identify.identify import identify
from calib.noise.reading import IndicatorFigures, Noise, reading_noise, reading_weights, visits
from calib.observations import LEG_NAMES, FloatArray, Observations
from calib.ties import descending, largest
from calib.tripod.pipeline import Model, derivatives
from calib.tripod.pool import FREE, PARAMETERS, LegPool, leg_pool
from calib.tripod.sensitivity import sensitivity_of_readings, tool_metric

SECONDS_PER_STEP = 20.0
RUNNERS_UP = 5


@dataclass(frozen=True)
class Proposal:
    """One more mounting and the displacements to read there along both axes.

    ``tool_mm`` is the expected r.m.s. error of the tool over the workspace afterwards.
    """

    leg: str
    station: float
    displacements_mm: tuple[float, ...]
    minutes: float
    tool_mm: float
    variance_per_minute_mm2: float


@dataclass(frozen=True)
class NextMountings:
    """The best proposal first; ``tool_before_mm`` without any of them."""

    tool_before_mm: float
    noise_words: str
    proposals: tuple[Proposal, ...]


def next_mountings(
    model: Model,
    tolerance_mm: FloatArray,
    noise: tuple[Noise, str],
    minutes_per_mounting: float,
    observed: Observations | None = None,
    figures: IndicatorFigures | None = None,
) -> NextMountings:
    """Judge every mounting with two or three displacements on top of what was ``observed``.

    Before any reading the parameters are known to the tolerances ``(6,)``. ``noise`` of a reading
    comes with words on where it is from. With ``figures`` of the indicators the noise that the
    readings show themselves takes its place.
    """
    information, (stated, words) = np.diag(tolerance_mm**-2.0), noise
    if observed is not None:
        visited, shown = visits(observed), None
        if figures is not None:
            shown, said = _noise_of(visited, model, figures, tolerance_mm)
            words = said or words
        stated = shown or Noise(stated.indicators[:1] * visited.indicator_count, "instrument")
        information = information + _measured(visited, model, stated)
    covariance, metric = inverse(information), tool_metric(model.geometry)
    before = float(np.trace(metric @ covariance))
    found = _judged(model, covariance, metric, stated.standard_deviation_mm, minutes_per_mounting)
    return NextMountings(before**0.5, words, tuple(found))


def _measured(visited: Observations, model: Model, noise: Noise) -> FloatArray:
    """Information ``(6, 6)`` of readings."""
    design = derivatives(model.geometry, model.parameters_mm, visited)
    weight = reading_weights(visited, noise)
    whitened = sensitivity_of_readings(
        model.geometry, visited, weight, design, FREE, noise_known=True
    ).jacobian
    return np.asarray(whitened.T @ whitened)


def _noise_of(
    visited: Observations,
    model: Model,
    figures: IndicatorFigures,
    tolerance_mm: FloatArray,
) -> tuple[Noise | None, str]:
    """What the model leaves beyond chance counts as noise, as ``solve`` tells it."""
    noise = reading_noise(visited, figures)
    if noise is None:
        return None, ""
    words = f"{noise.standard_deviation_mm:.4g} mm, from the sessions"
    try:
        fitted = identify(
            model, visited, "with-tolerances", indicator=figures, tolerance_mm=tolerance_mm
        )
    except NotIdentifiable:  # nothing to compare with the noise
        return noise, words
    if not fitted.lacks_fit:
        return noise, words
    words += f", times {fitted.spread**0.5:.3g} because the model leaves so much: "
    words += "run glidecal diagnose first"
    return noise.scaled(fitted.spread), words


def _judged(
    model: Model,
    covariance: FloatArray,
    metric: FloatArray,
    noise_mm: float,
    minutes_per_mounting: float,
) -> list[Proposal]:
    """The best proposal of each leg and station, the best of all first."""
    pool = leg_pool(model.geometry, parameters_mm=model.parameters_mm, both_ways=False)
    before = float(np.trace(metric @ covariance))
    best: dict[tuple[int, float], Proposal] = {}
    for size in (2, 3):
        minutes = minutes_per_mounting + size * SECONDS_PER_STEP / 60.0
        for leg, station, some, rows in _mountings(pool, size):
            after = covariances_after(
                covariance, rows / noise_mm, np.ones(rows.shape[1]), list(FREE)
            )
            variance = np.einsum("ij,bji->b", metric, after)
            k = largest(-variance)
            proposal = Proposal(
                leg=LEG_NAMES[leg],
                station=station,
                displacements_mm=some[k],
                minutes=minutes,
                tool_mm=float(variance[k]) ** 0.5,
                variance_per_minute_mm2=(before - float(variance[k])) / minutes,
            )
            held = best.get((leg, station))
            if held is None or _gain(proposal) > _gain(held):
                best[leg, station] = proposal
    return descending(best.values(), _gain)[: RUNNERS_UP + 1]


def _gain(proposal: Proposal) -> float:
    return proposal.variance_per_minute_mm2


def _mountings(
    pool: LegPool, size: int
) -> list[tuple[int, float, list[tuple[float, ...]], FloatArray]]:
    """Sets of displacements at each place with rows ``(b, 2 size, 6)``, own zeros fitted."""
    found = []
    for number, (leg, station) in enumerate(pool.places):
        members = np.flatnonzero(pool.place == number)
        row = {float(pool.displacement_mm[k]): int(k) for k in members}
        levels = sorted(row)
        sets = list(combinations(levels, size))
        if size == 3:  # a third one between the ends
            sets = [one for one in sets if (one[0], one[-1]) == (levels[0], levels[-1])]
        if not sets:
            continue
        index = np.array([[row[level] for level in one] for one in sets])
        rows = pool.rows[index][:, :, :, :PARAMETERS]
        centred = rows - rows.mean(axis=1, keepdims=True)
        found.append((leg, station, sets, centred.reshape(len(sets), -1, PARAMETERS)))
    return found
