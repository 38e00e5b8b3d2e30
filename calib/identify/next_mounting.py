"""The next mounting worth reading: what lowers the expected tool error most per minute."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from calib.arrays import (
    BLIND,
    LEG_NAMES,
    Conditions,
    FloatArray,
    Observations,
    conditions,
    descending,
    largest,
    svd_of_all,
)
from calib.design.criteria import covariances_after, inverse
from calib.errors import NotIdentifiable
from calib.identify.fit import prior_fit
from calib.identify.identify import identify
from calib.identify.tool_bound import ToolBound, claim_of
from calib.noise.reading import IndicatorFigures, Noise, reading_noise, reading_weights, visits
from calib.stats import coverage_factor
from calib.tripod.geometry import PARAMETER_NAMES, Geometry
from calib.tripod.pipeline import Model, derivatives
from calib.tripod.planning import TripodPlanning, sensitivity_of_readings, tool_metric
from calib.tripod.pool import FREE, PARAMETERS, STATIONS, LegPool, leg_pool

SECONDS_PER_STEP = 20.0
MINUTES_PER_MOUNTING = 2.0
RUNNERS_UP = 5

WAY = (0.0, 0.37, 1.0, 0.7, 0.37, 0.0, -0.37, -0.7, -1.0, -0.7, -0.37, 0.0)
"""Displacements of a set-up as parts of the way: uneven ones, most of them from both sides."""

WORTH = 0.9
"""A further set-up is worth its time where it lowers the bound to less than this part."""

MOST_FURTHER = 6


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
class FurtherSetUp:
    """Set-ups read over the whole way, there and back, and the bound at the tool afterwards.

    ``legs`` each get one at this station. ``open_name`` is what the bound is for then, empty where
    it is noise and tolerances. ``minutes`` count from the first of them.
    """

    legs: tuple[str, ...]
    station: float
    displacements_mm: tuple[float, ...]
    minutes: float
    bound_mm: float
    open_name: str


@dataclass(frozen=True)
class Reach:
    """What the tool is off by at most (95 %) with the values of readings and tolerances entered.

    ``further`` are set-ups in turn, as long as one lowers the bound to `WORTH` of what it was.
    """

    bound: ToolBound
    further: tuple[FurtherSetUp, ...]

    @property
    def bound_mm(self) -> float:
        """Before any further set-up."""
        return self.bound.bound_mm

    @property
    def open_name(self) -> str:
        """As in `FurtherSetUp`, before any."""
        return _open_words(self.bound)

    @property
    def left_open(self) -> str:
        """The same after the last one."""
        return self.further[-1].open_name if self.further else self.open_name

    @property
    def is_last(self) -> bool:
        """Whether more set-ups would not help."""
        return len(self.further) < MOST_FURTHER

    def towards(self, wanted_mm: float, before_mm: float = math.inf) -> FurtherSetUp | None:
        """The next set-up; None where the bound is as wanted, or more would not help.

        More does not help where none is worth it, nor where the last one was not: ``before_mm`` is
        the bound before that.
        """
        helped = self.bound_mm <= WORTH * before_mm
        return self.further[0] if self.further and helped and self.bound_mm > wanted_mm else None


@dataclass(frozen=True)
class NextMountings:
    """The best proposal first; ``tool_before_mm`` without any of them."""

    tool_before_mm: float
    noise_words: str
    proposals: tuple[Proposal, ...]
    reach: Reach


def next_mountings(
    model: Model,
    tolerance_mm: FloatArray,
    noise: tuple[Noise, str],
    minutes_per_mounting: float,
    observed: Observations | None = None,
    figures: IndicatorFigures | None = None,
    seconds_per_step: float = SECONDS_PER_STEP,
) -> NextMountings:
    """Judge every mounting with two or three displacements on top of what was ``observed``.

    Before any reading the parameters are known to the tolerances ``(6,)``. ``noise`` of a reading
    comes with words on where it is from. With ``figures`` of the indicators the noise that the
    readings show themselves takes its place. A step takes ``seconds_per_step``, by hand or less.
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
    pace = minutes_per_mounting, seconds_per_step
    found = _judged(model, covariance, metric, stated.standard_deviation_mm, *pace)
    if observed is not None:  # what a model leaves is no noise of the bound
        stated = (figures and reading_noise(visited, figures)) or stated
    return NextMountings(
        tool_before_mm=before**0.5,
        noise_words=words,
        proposals=tuple(found),
        reach=reach_of(model, observed, stated, tolerance_mm, *pace),
    )


def bound_of(
    model: Model, observed: Observations, noise: Noise, tolerance_mm: FloatArray
) -> ToolBound:
    """The bound at the tool with what the readings tell of the six parameters entered."""
    fitted = _fitted(model, observed, noise, tolerance_mm)
    claim = claim_of(fitted, observed, noise, tolerance_mm, model.parameters_mm)[0]
    return claim.bound(claim.expected)


def _fitted(
    model: Model, observed: Observations | None, noise: Noise, tolerance_mm: FloatArray
) -> Model:
    if observed is None:
        return model
    visited = visits(observed)
    return prior_fit(model, visited, reading_weights(visited, noise), tolerance_mm).model


def reach_of(
    model: Model,
    observed: Observations | None,
    noise: Noise,
    tolerance_mm: FloatArray,
    minutes_per_mounting: float,
    seconds_per_step: float = SECONDS_PER_STEP,
) -> Reach:
    """The bound now, and after set-ups that each lower it most for its time."""
    fitted = _fitted(model, observed, noise, tolerance_mm)
    every: list[tuple[tuple[int, ...], float]]
    every = [((leg,), station) for station in STATIONS for leg in range(3)]
    every += [((0, 1, 2), station) for station in STATIONS]
    options = [
        (legs, at, way)
        for legs, at in every
        if (way := levels_within(fitted.geometry, [(leg, at) for leg in legs], WAY))
    ]
    taken = [_there_and_back(leg, at, way) for legs, at, way in options for leg in legs]
    claim, rows = claim_of(fitted, observed, noise, tolerance_mm, model.parameters_mm, more=taken)
    each = iter(rows)
    seen = [[next(each) for _ in legs] for legs, _, _ in options]
    took = [
        len(legs) * (minutes_per_mounting + len(way) * seconds_per_step / 60.0)
        for legs, _, way in options
    ]
    now = bound = claim.bound(claim.expected)
    found: list[FurtherSetUp] = []
    minutes = 0.0
    while len(found) < MOST_FURTHER:
        claims = [claim.adding(one) for one in seen]
        bounds = [one.bound(one.expected) for one in claims]
        worth = [k for k, one in enumerate(bounds) if one.bound_mm < WORTH * bound.bound_mm]
        if not worth:
            break
        gains = [math.log(bound.bound_mm / bounds[k].bound_mm) / took[k] for k in worth]
        best = worth[largest(np.array(gains))]
        claim, bound, minutes = claims[best], bounds[best], minutes + took[best]
        legs, at, way = options[best]
        names = tuple(LEG_NAMES[leg] for leg in legs)
        found.append(FurtherSetUp(names, at, way, minutes, bound.bound_mm, _open_words(bound)))
    return Reach(now, tuple(found))


def _open_words(bound: ToolBound) -> str:
    return f"{bound.worst.id} ({bound.worst.where})" if bound.worst else ""


def levels_within(
    geometry: Geometry,
    places: Iterable[tuple[int, float]],
    parts: Sequence[float],
    clear_mm: float = 0.0,
) -> tuple[float, ...]:
    """Displacements, whole mm, as parts of the way that joint limits and bars allow.

    ``places`` are legs and stations; the ends stay clear of limits by ``clear_mm``. None where no
    way to both sides is left.
    """
    lows, highs = zip(*(geometry.span_mm(*place) for place in places), strict=True)
    low, high = math.ceil(max(lows) + clear_mm), math.floor(min(highs) - clear_mm)
    if not low < 0 < high:
        return ()
    return tuple(float(round(part * (high if part > 0.0 else -low))) for part in parts)


def _there_and_back(leg: int, station: float, levels_mm: tuple[float, ...]) -> Conditions:
    """Both axes of a leg at these displacements in turn."""
    axes = [axis for axis in range(3) if axis != leg]
    count = len(levels_mm)
    taken = conditions(
        [leg] * 2 * count, [a for a in axes for _ in levels_mm], levels_mm * 2, station=station
    )
    approach = np.sign(np.diff(levels_mm, prepend=-1.0))
    return replace(
        taken,
        approach=np.tile(approach, 2),
        time_s=np.tile(SECONDS_PER_STEP * np.arange(count, dtype=np.float64), 2),
    )


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
    seconds_per_step: float,
) -> list[Proposal]:
    """The best proposal of each leg and station, the best of all first."""
    pool = leg_pool(model.geometry, parameters_mm=model.parameters_mm, both_ways=False)
    before = float(np.trace(metric @ covariance))
    best: dict[tuple[int, float], Proposal] = {}
    for size in (2, 3):
        minutes = minutes_per_mounting + size * seconds_per_step / 60.0
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
            held = best.setdefault((leg, station), proposal)
            if proposal.variance_per_minute_mm2 > held.variance_per_minute_mm2:
                best[leg, station] = proposal
    return descending(best.values(), lambda one: one.variance_per_minute_mm2)[: RUNNERS_UP + 1]


def _mountings(
    pool: LegPool, size: int
) -> Iterator[tuple[int, float, list[tuple[float, ...]], FloatArray]]:
    """Sets of displacements at each place with rows ``(b, 2 size, 6)``, own zeros fitted."""
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
        yield leg, station, sets, centred.reshape(len(sets), -1, PARAMETERS)


@dataclass(frozen=True)
class ExpectedParameter:
    """Expanded uncertainty (95 %) to expect of a parameter, mm; None where readings do not tell it.

    ``alone_mm`` with the other kind (offsets, lengths) as in the machine file, ``all_mm`` with all
    six free; papers/000 (12)-(14). ``held_mm`` with all six held by their tolerances.
    """

    name: str
    alone_mm: float | None
    all_mm: float | None
    held_mm: float


@dataclass(frozen=True)
class ExpectedResult:
    """What a procedure will tell, before it is measured, if its readings show nothing new."""

    parameters: tuple[ExpectedParameter, ...]
    bound: ToolBound


def expected_of(planned: TripodPlanning, tolerance_mm: FloatArray) -> ExpectedResult:
    """Uncertainties and the bound at the tool for the noise of the indicator at hand."""
    jacobian = planned.examine().sensitivity.jacobian
    alone = np.concatenate([_half_widths(jacobian[:, :3]), _half_widths(jacobian[:, 3:])])
    every = _half_widths(jacobian)
    held = _half_widths(np.vstack([jacobian, np.diag(1.0 / tolerance_mm)]))
    rows = zip(PARAMETER_NAMES, alone.tolist(), every.tolist(), held.tolist(), strict=True)
    model, visited = Model(planned.geometry), visits(planned.planned)
    shown = replace(visited, value_mm=model.readings(visited))
    claim = claim_of(model, shown, planned.noise, tolerance_mm, model.parameters_mm)[0]
    parameters = tuple(
        ExpectedParameter(
            name,
            one if math.isfinite(one) else None,
            six if math.isfinite(six) else None,
            last,
        )
        for name, one, six, last in rows
    )
    return ExpectedResult(parameters, claim.bound(claim.expected))


def _half_widths(rows: FloatArray) -> FloatArray:
    """Expanded uncertainties ``(k,)`` from whitened rows ``(n, k)``; infinite where not seen."""
    _, singular, turned = svd_of_all(rows)
    if singular[-1] <= BLIND * singular[0]:
        return np.full(rows.shape[1], np.inf)
    return np.asarray(coverage_factor(math.inf) * np.linalg.norm(turned.T / singular, axis=1))
