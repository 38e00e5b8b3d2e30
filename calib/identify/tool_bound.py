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

FREE = 50.0
"""Unremarkable sizes that a fitted size may have: readings tell it, no tolerance."""

LARGER = (1.0, 4.0)
"""Times the smallest size that would have been found: readings may show more than that, and of
several sizes together those are unlike that hardly show."""

FOUND = 5.5
"""Standard deviations of a size found nine times in ten among some hundred at 1 % over all."""

SHOWN = 17.8
"""Noise variances explained from which noise alone is not the reason: (FOUND - 1.28) squared."""

LEAST_NOISE_MM = 1e-5
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
class Seen:
    """Means of postures, whitened and without zeros: residual ``(n,)`` and derivatives.

    ``base`` ``(n, b)`` are columns of base parameters and fitted sizes at ``at`` ``(b,)``,
    ``effects`` ``(n, k)`` those of the catalogue.
    """

    residual: FloatArray
    base: FloatArray
    effects: FloatArray
    free: int


@dataclass(frozen=True, eq=False)
class Claim:
    """What readings tell of the machine, as far as the tool is concerned.

    ``prior_mm`` ``(b,)`` are expected base parameters and sizes, ``spread`` ``(b,)`` their standard
    deviations, both from the point of linearisation; ``size`` ``(k,)`` are unremarkable sizes of
    the effects' columns, ``metric`` ``(b + k, b + k)`` mean squares at the tool, ``near`` those of
    where it is relative to Zero, over the part of the workspace about it.
    """

    seen: Seen
    prior: FloatArray
    spread: FloatArray
    size: FloatArray
    names: tuple[_Name, ...]
    metric: FloatArray
    near: FloatArray

    def adding(self, more: Sequence[Seen]) -> Claim:
        """The same after readings that show what these let expect."""
        expected = self.expected
        extra = [replace(one, residual=one.base @ expected) for one in more]
        every = [self.seen, *extra]
        return replace(
            self,
            seen=Seen(
                np.concatenate([one.residual for one in every]),
                np.vstack([one.base for one in every]),
                np.vstack([one.effects for one in every]),
                sum(one.free for one in every),
            ),
        )

    @cached_property
    def _solved(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Of base parameters alone: covariance, its answer to rows, columns and residual left."""
        rows = np.vstack([self.seen.base * self.spread, np.eye(len(self.spread))])
        q, r = np.linalg.qr(rows)
        inverse_r = self.spread[:, None] * np.linalg.inv(r)
        width = self.seen.effects.shape[1]
        effects = np.vstack([self.seen.effects, np.zeros((len(self.spread), width))])
        residual = np.concatenate([self.seen.residual, self.prior / self.spread])
        answer = inverse_r @ (q.T @ np.column_stack([effects, residual]))
        left = without(q, np.column_stack([effects, residual]))
        return inverse_r @ inverse_r.T, answer, left[:, :-1], left[:, -1]

    @property
    def expected(self) -> FloatArray:
        """Base parameters and sizes ``(b,)`` that readings and tolerances tell, nothing missing."""
        return np.asarray(self._solved[1][:, -1])

    @cached_property
    def _plain(self) -> _Posterior:
        """Nothing is missing."""
        covariance, answer, _, _ = self._solved
        return _Posterior(None, (), answer[:, -1], covariance)

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
        if not self.names:
            return max(1.0, square / max(self.seen.free, 1))
        free = self.seen.free - np.array([len(one.columns) for one in self.names])
        left = (square - explained) / np.maximum(free, 1)
        return max(1.0, float(left.min()))

    def noisier(self, factor: float) -> Claim:
        """The same with so many times the variance of the noise."""
        seen, root = self.seen, math.sqrt(factor)
        residual, base, effects = seen.residual / root, seen.base / root, seen.effects / root
        return replace(self, seen=Seen(residual, base, effects, seen.free))

    @cached_property
    def _open(self) -> list[_Posterior]:
        """The names that hold 95 % of the weight; each id has the same before any reading."""
        if not self.names:
            return []
        scales, room, explained = self._weighed
        ids = [one.effect.id for one in self.names]
        ways = np.log([ids.count(one) for one in ids])
        log = (room + 0.5 * explained - ways).ravel()
        weight = np.exp(log - log.max())
        order = descending(range(len(log)), lambda k: float(log[k]))
        inside = np.cumsum(weight[order]) / weight.sum()
        kept = order[: int(np.searchsorted(inside, COVERAGE)) + 1]
        shown = explained.ravel() >= SHOWN
        return [
            replace(
                self._posterior(self.names[k % len(ids)], scales[k // len(ids)]),
                weight=float(weight[k]),
                shown=bool(shown[k]),
            )
            for k in kept
        ]

    def _posterior(self, name: _Name, expected: FloatArray) -> _Posterior:
        """Base parameters, then the sizes of a name, of which ``expected`` ``(k,)`` are likely."""
        covariance, answer, left, residual = self._solved
        index = list(name.columns)
        scale, columns = expected[index], left[:, index]
        inner = np.eye(len(index)) + scale[:, None] * (columns.T @ columns) * scale
        spread = scale[:, None] * np.linalg.inv(inner) * scale
        value = spread @ (columns.T @ residual)
        moved = answer[:, index]
        beside = -moved @ spread
        return _Posterior(
            name,
            name.columns,
            np.concatenate([answer[:, -1] - moved @ value, value]),
            np.block([[covariance - beside @ moved.T, beside], [beside.T, spread]]),
        )

    def expected_mm(self, entered: FloatArray) -> float:
        """R.m.s. error of the tool to expect, over the names that are open."""
        every = self._open or [self._plain]
        square = sum(one.weight * self._square_mm2(one, entered) for one in every)
        return math.sqrt(square / sum(one.weight for one in every))

    def bound(self, entered: FloatArray) -> ToolBound:
        """With parameters and sizes ``(b,)`` entered, from the point of linearisation."""
        plain = self._quantile_mm(self._plain, entered)
        worst: dict[str, OpenName] = {}
        for one in self._open:
            if one.name is None:
                continue
            effect, at_most = one.name.effect, self._quantile_mm(one, entered)
            # of places that bind alike the first stays, whatever the last digit says
            so_far = worst[effect.id].bound_mm * (1.0 + TIE) if effect.id in worst else -1.0
            if at_most > so_far:
                what = effect.id, one.name.where, effect.title
                worst[effect.id] = OpenName(*what, at_most, one.shown)
        names = tuple(descending(worst.values(), lambda one: one.bound_mm))
        return ToolBound(max([plain, *(one.bound_mm for one in names)]), plain, names)

    def near_mm(self, entered: FloatArray) -> float:
        """The bound of the error relative to Zero, over a workpiece there: what milling shows."""
        every = [self._plain, *self._open]
        return max(
            quantile_mm(*self._off(one, entered, self.near), one.covariance) for one in every
        )

    def _quantile_mm(self, one: _Posterior, entered: FloatArray) -> float:
        return quantile_mm(*self._off(one, entered), one.covariance)

    def _square_mm2(self, one: _Posterior, entered: FloatArray) -> float:
        metric, off = self._off(one, entered)
        return float(np.trace(metric @ one.covariance) + off @ metric @ off)

    def _off(
        self, one: _Posterior, entered: FloatArray, metric: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """The metric of a name's parameters and sizes, and what they are off by."""
        count = len(self.spread)
        index = [*range(count), *(count + k for k in one.columns)]
        off = one.mean.copy()
        off[:count] -= entered
        return (self.metric if metric is None else metric)[np.ix_(index, index)], off


@dataclass(frozen=True, eq=False)
class _Posterior:
    """A name after the readings: mean and covariance of base and its columns."""

    name: _Name | None
    columns: tuple[int, ...]
    mean: FloatArray
    covariance: FloatArray
    weight: float = 1.0
    shown: bool = False


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
) -> tuple[Claim, tuple[Seen, ...]]:
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
    weight = 1.0 / np.maximum(doubt * np.concatenate(variances), LEAST_NOISE_MM**2)
    off = [one.value_mm - model.readings(one) for one in taken]
    off += [np.zeros(len(one)) for one in more]
    rows = np.column_stack([np.concatenate(off), base, *columns])
    rows = np.sqrt(weight)[:, None] * without_zeros(every, weight, rows)
    last = 1 + base.shape[1]
    ends = np.cumsum([len(one) for one in (*taken, *more)])[:-1]
    parts = [
        Seen(part[:, 0], part[:, 1:last], part[:, last:], len(one) - set_up_unknowns(one))
        for one, part in zip((*taken, *more), np.split(rows, ends), strict=True)
    ]
    nothing = Seen(rows[:0, 0], rows[:0, 1:last], rows[:0, last:], 0)
    first, others = (parts[0], parts[1:]) if taken else (nothing, parts)
    start = np.array([*model.parameters_mm, *(one.value(model) for one in sizes)])
    known = tuple(placed)
    claim = Claim(
        replace(first, free=first.free - len(start)),
        np.concatenate([nominal_mm, start[BASE:]]) - start,
        np.concatenate([tolerance_mm, [FREE * one.tolerance for one in sizes]]),
        np.array(size),
        _names(known),
        _metric(model, known, sizes),
        _metric(model, known, sizes, near_zero=True),
    )
    misfit = claim.misfit
    return (claim.noisier(misfit) if misfit > 1.0 else claim), tuple(others)


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


def _metric(
    model: Model, placed: tuple[Placed, ...], sizes: tuple[Size, ...], *, near_zero: bool = False
) -> FloatArray:
    """Mean squares at the tool ``(6 + s + k, 6 + s + k)`` with columns of fitted sizes between."""
    acting = [model.effects[effect] for size in sizes for effect, _ in size.at]
    own = tuple((one.effect, one.place) for one in acting if isinstance(one, EffectInstance))
    count = sum(len(effect.parameters) for effect, _ in placed)
    metric = _tool_metric(model.geometry, (*placed, *own), near_zero=near_zero)
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
def _tool_metric(
    geometry: Geometry, placed: tuple[Placed, ...], *, near_zero: bool = False
) -> FloatArray:
    """Mean over the workspace of products of movements ``(6 + k, 6 + k)``; of the nominal machine.

    Half of the postures are reached with all carriages coming up, half down. With ``near_zero``
    over a workpiece there, less what they are at Zero, which is reached coming up.
    """
    points = workspace_points(geometry, near_zero=near_zero)

    def moved(tool_mm: FloatArray, way: float) -> FloatArray:
        base = tool_jacobian_at(geometry, tool_mm)
        return np.concatenate([base, tool_columns(geometry, tool_mm, placed, way)], axis=2)

    rows = np.concatenate([moved(points, way) for way in (1.0, -1.0)])
    if near_zero:
        rows = rows - moved(np.zeros((1, 3)), 1.0)
    flat = rows.reshape(-1, rows.shape[2])
    return np.asarray(flat.T @ flat / len(rows))
