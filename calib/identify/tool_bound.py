"""What the tool may be off by at most: noise, tolerances, and effects that readings leave open.

Readings y = B θ + E β + noise with the base parameters θ, held by their tolerances, and the sizes β
of one name of the catalogue at a time (its places together or apart), normal with a standard
deviation of the smallest size that would have been found, at most ten unremarkable ones; also of
four times that, for readings that show more. With the values t entered the tool is off by
J(p) (θ - t) + T(p) β. Each name has by Bayes a weight and a normal (θ, β); the mean square over
the workspace is a quadratic form of it, with the quantile of a gamma distribution of equal mean
and variance (Satterthwaite). The bound is the largest 95 % quantile among the names that together
hold 95 % of the weight.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from scipy.special import gammaincinv

from calib.arrays import (
    LEG_NAMES,
    TIE,
    TINY,
    Conditions,
    FloatArray,
    Observations,
    descending,
    joined,
    set_up_unknowns,
    without,
    without_zeros,
)
from calib.identify.fit import Size, design_of
from calib.noise.reading import Noise, visits
from calib.stats import COVERAGE
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.candidates import place_columns, tool_columns
from calib.tripod.effects.drives import effects_of
from calib.tripod.effects.effect import Effect, EffectInstance
from calib.tripod.effects.empirical import AT_MM, BASES, Coupling, Empirical
from calib.tripod.geometry import PARAMETER_NAMES, Geometry
from calib.tripod.movements import with_first_movements
from calib.tripod.pipeline import Model
from calib.tripod.workspace import tool_jacobian_at, workspace_points

BASE = len(PARAMETER_NAMES)

TOLERATED = 10.0
"""Unremarkable sizes that nobody would have left in a machine where nothing shows them."""

UNHELD = 50.0
"""Unremarkable sizes that a fitted size may have: readings tell it, no tolerance."""

LARGER = (1.0, 4.0)
"""Times the smallest size that would have been found: readings may show more than that, and of
several sizes together those are unlike that hardly show."""

FOUND = 5.5
"""Standard deviations of a size found nine times in ten among some hundred at 1 % over all."""

SHOWN = 17.8
"""Noise variances explained from which noise alone is not the reason: (FOUND - 1.28) squared."""

FINEST_MM = 1e-5
"""No indicator reads better; with less, rounding would be taken for what readings show."""

NAMELESS: tuple[Effect, ...] = (
    *(Empirical((f"travel_{name}_at_100mm",)) for name in ("square", "cube", "fourth")),
    Coupling(),
)
"""Laws of travel without a name: what is in no catalogue is mostly near one of them."""

Placed = tuple[Effect, str]


@dataclass(frozen=True)
class OpenName:
    """A name that readings leave open, where, and the bound at the tool if it is the one.

    ``shown`` is True where readings show it, or something that looks like it; else they could not
    have seen it.
    """

    id: str
    where: str
    title: str
    bound_mm: float
    shown: bool


@dataclass(frozen=True)
class ToolBound:
    """R.m.s. distance of the tool over the workspace that is kept to in 95 of 100 machines, mm.

    ``parameters_mm`` is the same if the model lacks nothing and all parameters are as far off as
    tolerances and readings allow; ``names`` are what readings leave open, the worst first, one
    for each id. Over a plane no effect is modelled: there are none, and parameters are all.
    """

    bound_mm: float
    parameters_mm: float
    names: tuple[OpenName, ...]

    @property
    def worst(self) -> OpenName | None:
        """The name that the bound is for; None where parameters alone may do as much."""
        first = next(iter(self.names), None)
        return first if first and first.bound_mm > self.parameters_mm else None

    @property
    def worst_shown(self) -> OpenName | None:
        """Of the names that fit what readings show."""
        return next((one for one in self.names if one.shown), None)

    @property
    def worst_unseen(self) -> OpenName | None:
        """Of the names that readings could not have seen."""
        return next((one for one in self.names if not one.shown), None)


@dataclass(frozen=True, eq=False)
class _Name:
    """One hypothesis: an effect at some places, and which columns its sizes are."""

    effect: Effect
    where: str
    columns: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Claim:
    """What readings tell of the machine, as far as the tool is concerned.

    ``rows`` ``(n, 1 + b + k)`` are means of postures, whitened and without zeros: residual,
    derivatives by base parameters and fitted sizes, and by the sizes of the catalogue; ``free``
    directions are left to these. ``prior`` ``(b,)`` are expected base parameters and sizes,
    ``spread`` ``(b,)`` their standard deviations, both from the point of linearisation; ``size``
    ``(k,)`` are unremarkable sizes of the effects' columns, ``metric`` ``(b + k, b + k)`` mean
    squares at the tool.
    """

    rows: FloatArray
    free: int
    prior: FloatArray
    spread: FloatArray
    size: FloatArray
    names: tuple[_Name, ...]
    metric: FloatArray

    def adding(self, more: Sequence[FloatArray]) -> Claim:
        """The same after readings like these rows that show what is expected."""
        count, expected = len(self.spread), self.expected
        shown = [one[:, 1 : 1 + count] @ expected for one in more]
        extra = [
            np.column_stack([of_it, one[:, 1:]]) for of_it, one in zip(shown, more, strict=True)
        ]
        return replace(self, rows=np.vstack([self.rows, *extra]))

    @cached_property
    def _solved(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Of base parameters alone: covariance, its answer to rows, columns and residual left."""
        count = len(self.spread)
        residual, base, effects = np.split(self.rows, [1, 1 + count], axis=1)
        held = np.zeros((count, effects.shape[1] + 1))
        held[:, -1] = self.prior / self.spread
        others = np.vstack([np.hstack([effects, residual]), held])
        # tolerances are rows beside the readings: no product of derivatives loses digits
        q, r = np.linalg.qr(np.vstack([base * self.spread, np.eye(count)]))
        inverse_r = self.spread[:, None] * np.linalg.inv(r)
        left = without(q, others)
        return inverse_r @ inverse_r.T, inverse_r @ (q.T @ others), left[:, :-1], left[:, -1]

    @property
    def expected(self) -> FloatArray:
        """Base parameters and sizes ``(b,)`` that readings and tolerances tell, nothing missing."""
        return np.asarray(self._solved[1][:, -1])

    @cached_property
    def _plain(self) -> _Posterior:
        """Nothing is missing."""
        covariance, answer, _, _ = self._solved
        return _Posterior((), answer[:, -1], covariance)

    @cached_property
    def _weighed(self) -> tuple[list[FloatArray], FloatArray, FloatArray]:
        """Expected sizes ``(k,)`` in each scale; log of the room of a name, and what it explains.

        The last two ``(scales, names)``; what is explained in squares of the noise.
        """
        _, _, left, residual = self._solved
        seen, shown = left.T @ left, left.T @ residual
        found = FOUND / np.sqrt(np.maximum(seen.diagonal(), TINY))
        scales = [np.minimum(times * found, TOLERATED * self.size) for times in LARGER]
        room, explained = np.zeros((2, len(scales), len(self.names)))
        counts = [len(one.columns) for one in self.names]
        for count in set(counts):  # names of equally many sizes side by side
            members = [k for k, of in enumerate(counts) if of == count]
            index = np.array([self.names[k].columns for k in members])
            block = seen[index[:, :, None], index[:, None, :]]
            for row, every in enumerate(scales):
                scale = every[index]
                inner = np.eye(count) + scale[:, :, None] * block * scale[:, None, :]
                pulled = scale * shown[index]
                answer = np.linalg.solve(inner, pulled[..., None])[..., 0]
                room[row, members] = -0.5 * np.linalg.slogdet(inner)[1]
                explained[row, members] = (pulled * answer).sum(axis=1)
        return scales, room, explained

    @property
    def misfit(self) -> float:
        """Variance ratio that the name which explains most leaves; at least 1."""
        residual, explained = self._solved[3], self._weighed[2]
        square = float(residual @ residual)
        free = self.free - np.array([len(one.columns) for one in self.names])
        left = (square - explained) / np.maximum(free, 1)
        return max(1.0, float(left.min()))

    @cached_property
    def _open(self) -> list[tuple[_Name, _Posterior, float, bool]]:
        """The names that hold 95 % of the weight, each with its own and whether it is shown.

        Each id has the same weight before any reading.
        """
        scales, room, explained = self._weighed
        ids = [one.effect.id for one in self.names]
        ways = np.log([ids.count(one) for one in ids])
        log = (room + 0.5 * explained - ways).ravel()
        weight = np.exp(log - log.max())
        order = descending(range(len(log)), lambda k: float(log[k]))
        inside = np.cumsum(weight[order]) / weight.sum()
        kept = order[: int(np.searchsorted(inside, COVERAGE)) + 1]
        shown = explained.ravel() >= SHOWN
        found = []
        for k in kept:
            name = self.names[k % len(ids)]
            one = self._posterior(name.columns, scales[k // len(ids)])
            found.append((name, one, float(weight[k]), bool(shown[k])))
        return found

    def _posterior(self, members: tuple[int, ...], expected: FloatArray) -> _Posterior:
        """Base parameters, then the sizes of a name, of which ``expected`` ``(k,)`` are likely."""
        covariance, answer, left, residual = self._solved
        index = list(members)
        scale, columns = expected[index], left[:, index]
        inner = np.eye(len(index)) + scale[:, None] * (columns.T @ columns) * scale
        spread = scale[:, None] * np.linalg.inv(inner) * scale
        value = spread @ (columns.T @ residual)
        moved = answer[:, index]
        beside = -moved @ spread
        return _Posterior(
            members,
            np.concatenate([answer[:, -1] - moved @ value, value]),
            np.block([[covariance - beside @ moved.T, beside], [beside.T, spread]]),
        )

    def bound(self, entered: FloatArray) -> ToolBound:
        """With parameters and sizes ``(b,)`` entered, from the point of linearisation."""
        plain = self._quantile_mm(self._plain, entered, self.metric)
        worst: dict[str, OpenName] = {}
        for name, one, _, shown in self._open:
            effect, at_most = name.effect, self._quantile_mm(one, entered, self.metric)
            # of places that bind alike the first stays, whatever the last digit says
            so_far = worst[effect.id].bound_mm * (1.0 + TIE) if effect.id in worst else -1.0
            if at_most > so_far:
                worst[effect.id] = OpenName(effect.id, name.where, effect.title, at_most, shown)
        names = tuple(descending(worst.values(), lambda one: one.bound_mm))
        return ToolBound(max([plain, *(one.bound_mm for one in names)]), plain, names)

    def _quantile_mm(self, one: _Posterior, entered: FloatArray, metric: FloatArray) -> float:
        return quantile_mm(*self._off(one, entered, metric), one.covariance)

    def _off(
        self, one: _Posterior, entered: FloatArray, metric: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """The metric of a name's parameters and sizes, and what they are off by."""
        count = len(self.spread)
        index = [*range(count), *(count + k for k in one.columns)]
        off = one.mean.copy()
        off[:count] -= entered
        return metric[np.ix_(index, index)], off


@dataclass(frozen=True, eq=False)
class _Posterior:
    """After the readings: mean and covariance of base parameters and of the sizes ``columns``."""

    columns: tuple[int, ...]
    mean: FloatArray
    covariance: FloatArray


def quantile_mm(metric: FloatArray, mean: FloatArray, covariance: FloatArray) -> float:
    """Root of the 95 % quantile of xᵀ metric x for normal x, by its first two moments."""
    moved = metric @ covariance
    size = float(np.trace(moved)) + float(mean @ metric @ mean)
    variance = 2.0 * float(np.trace(moved @ moved)) + 4.0 * float(mean @ moved @ metric @ mean)
    if not size > 0.0:
        return 0.0
    variance = max(variance, 1e-12 * size**2)
    return math.sqrt(float(gammaincinv(size**2 / variance, COVERAGE)) * variance / size)


def claim_of(
    model: Model,
    observed: Observations | None,
    noise: Noise,
    tolerance_mm: FloatArray,
    nominal_mm: Sequence[float],
    *,
    sizes: tuple[Size, ...] = (),
    more: Sequence[Conditions] = (),
) -> tuple[Claim, list[FloatArray]]:
    """What the readings tell, linear about a fitted ``model``, whose ``sizes`` are free.

    Base parameters are expected at ``nominal_mm`` ``(6,)`` within their tolerances ``(6,)``. With
    it what single readings taken like ``more`` would add, each set-up with zeros of its own.
    """
    taken = [] if observed is None else [_means(with_first_movements(visits(observed)))]
    every = joined([*taken, *more])
    effects: tuple[Effect, ...] = (*effects_of(CATALOGUE, model.geometry), *NAMELESS)
    placed, columns = [], []
    for effect, places in zip(effects, place_columns(model, every, effects), strict=True):
        placed += [(effect, place) for place in places]
        columns += list(places.values())
    size = [one for effect, _ in placed for one in _unremarkable(effect, model.geometry)]
    base = design_of(model, every, range(BASE), sizes)
    single = noise.standard_deviation_mm**2
    variances = [noise.repeatability_mm2(one) + noise.quantisation_mm2(one) for one in taken]
    variances += [np.full(len(one), single) for one in more]
    df = noise.degrees_of_freedom  # a variance from few repeats may be far too small
    doubt = 1.0 if math.isinf(df) else df / max(df - 2.0, 1.0)
    weight = 1.0 / np.maximum(doubt * np.concatenate(variances), FINEST_MM**2)
    off = [one.value_mm - model.readings(one) for one in taken]
    off += [np.zeros(len(one)) for one in more]
    rows = np.column_stack([np.concatenate(off), base, *columns])
    rows = np.sqrt(weight)[:, None] * without_zeros(every, weight, rows)
    parts = np.split(rows, np.cumsum([len(one) for one in (*taken, *more)])[:-1])
    start = np.array([*model.parameters_mm, *(one.value(model) for one in sizes)])
    known = tuple(placed)
    claim = Claim(
        parts.pop(0) if taken else rows[:0],
        sum(len(one) - set_up_unknowns(one) for one in taken) - len(start),
        np.concatenate([nominal_mm, start[BASE:]]) - start,
        np.concatenate([tolerance_mm, [UNHELD * one.tolerance for one in sizes]]),
        np.array(size),
        _names(known),
        _metric(model, known, sizes),
    )
    # what no name explains is more noise than the repeats show
    return replace(claim, rows=claim.rows / math.sqrt(claim.misfit)), parts


def _unremarkable(effect: Effect, geometry: Geometry) -> list[float]:
    """Sizes of an effect; that of an unnamed law counts at the end of a longer travel."""
    size, longest = [one.tolerance for one in effect.parameters], 1.0
    if effect in NAMELESS:
        reach_mm = max(geometry.travel_max_mm, -geometry.travel_min_mm)
        power = BASES[effect.bases[0]].power if isinstance(effect, Empirical) else 2
        longest = max(1.0, reach_mm / AT_MM) ** power
    return [one / longest for one in size]


def _means(visited: Observations) -> Observations:
    """One value for each posture and side of approach, its time the mean of theirs."""
    first, cell = np.unique(visited.cell, return_index=True, return_inverse=True)[1:]
    together = np.asarray(np.bincount(cell, visited.averaged), dtype=np.float64)
    value, time_s = (
        np.bincount(cell, visited.averaged * of) / together
        for of in (visited.value_mm, visited.time_s)
    )
    return replace(visited.take(first), time_s=time_s, value_mm=value, averaged=together)


def _names(placed: Sequence[Placed]) -> tuple[_Name, ...]:
    """Each effect at each place, at both directions across one leg, and wherever it may be."""
    found: list[_Name] = []
    at: dict[Effect, dict[str, tuple[int, ...]]] = {}
    start = 0
    for effect, place in placed:
        end = start + len(effect.parameters)
        at.setdefault(effect, {})[place] = tuple(range(start, end))
        start = end
    for effect, places in at.items():
        groups = {place: [place] for place in places}
        by_leg = {leg: [place for place in places if place[0] == leg] for leg in LEG_NAMES}
        if all(len(each) == 2 for each in by_leg.values()):  # both directions across
            groups |= by_leg
        groups["all"] = list(places)
        for where, each in groups.items():
            found.append(_Name(effect, where, tuple(k for place in each for k in places[place])))
    return tuple(found)


def _metric(model: Model, placed: tuple[Placed, ...], sizes: tuple[Size, ...]) -> FloatArray:
    """Mean squares at the tool ``(6 + s + k, 6 + s + k)`` with columns of fitted sizes between."""
    acting = [model.effects[effect] for size in sizes for effect, _ in size.at]
    own = tuple((one.effect, one.place) for one in acting if isinstance(one, EffectInstance))
    count = sum(len(effect.parameters) for effect, _ in placed)
    metric = _tool_metric(model.geometry, (*placed, *own))
    if not sizes:
        return metric
    # each size moves the tool by the sum over its places
    starts = iter(np.cumsum([0, *(len(effect.parameters) for effect, _ in own)]).tolist())
    summed = np.zeros((len(metric), len(sizes)))
    for column, size in enumerate(sizes):
        for _, number in size.at:
            summed[BASE + count + next(starts) + number, column] = 1.0
    whole = np.eye(len(metric))
    into = np.hstack([whole[:, :BASE], summed, whole[:, BASE : BASE + count]])
    return np.asarray(into.T @ metric @ into)


@lru_cache(maxsize=16)
def _tool_metric(geometry: Geometry, placed: tuple[Placed, ...]) -> FloatArray:
    """Mean over the workspace of products of movements ``(6 + k, 6 + k)``; of the nominal machine.

    Half of the postures are reached with all carriages coming up, half down.
    """
    points = workspace_points(geometry)

    def moved(tool_mm: FloatArray, way: float) -> FloatArray:
        base = tool_jacobian_at(geometry, tool_mm)
        return np.concatenate([base, tool_columns(geometry, tool_mm, placed, way)], axis=2)

    rows = np.concatenate([moved(points, way) for way in (1.0, -1.0)])
    flat = rows.reshape(-1, rows.shape[2])
    return np.asarray(flat.T @ flat / len(rows))
