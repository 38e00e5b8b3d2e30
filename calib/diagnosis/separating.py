"""Measurements that may be added: where, at which displacements, and what is changed before."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from calib.arrays import (
    BASE_SQUARES,
    LEG_NAMES,
    NEW_DIRECTION,
    TINY,
    Conditions,
    FloatArray,
    conditions,
    without,
    without_means,
)
from calib.diagnosis.problem import Problem
from calib.tripod.effects.candidates import Candidate, candidates
from calib.tripod.effects.effect import EffectParameter
from calib.tripod.pipeline import Model, derivatives

CYCLES = 3
SECONDS_PER_STEP = 20.0


@dataclass(frozen=True)
class Preparation:
    """What is changed before measuring: offsets entered in the controller, mm, and the load."""

    entered_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    load: float = 1.0

    @property
    def words(self) -> str:
        """An instruction, empty where nothing is changed."""
        said = [
            f"add {change:+g} mm to the entered joint offset of {leg.upper()}"
            for leg, change in zip(LEG_NAMES, self.entered_mm, strict=True)
            if change
        ]
        if self.load != 1.0:
            said.append(
                f"load the tool to {self.load:g} times its weight and note load = {self.load:g} "
                "in the machine file"
            )
        return " and ".join(said)

    def model(self, model: Model) -> Model:
        """The machine as it is then."""
        parameters = np.array(model.parameters_mm)
        parameters[:3] -= self.entered_mm
        return replace(
            model.with_parameters(parameters), geometry=replace(model.geometry, load=self.load)
        )


@dataclass(frozen=True)
class Added:
    """An added measurement: legs, stations, displacements from Zero, what is changed before."""

    legs: tuple[str, ...]
    stations: tuple[float, ...]
    levels_mm: tuple[float, ...]
    preparation: Preparation = Preparation()

    @property
    def words(self) -> str:
        """In short."""
        levels = ", ".join(f"{level:+g}" if level else "Zero" for level in self.levels_mm)
        legs = "leg " if len(self.legs) == 1 else "legs "
        places = " and ".join(f"{station:.0%}" for station in self.stations)
        before = f"{self.preparation.words}; then " if self.preparation.words else ""
        return (
            f"{before}{legs}{', '.join(self.legs).upper()}, {places} from the tool end: "
            f"Zero, {levels} mm"
        )

    @property
    def steps(self) -> int:
        """How many postures are visited."""
        return len(self.legs) * len(self.stations) * (CYCLES * (len(self.levels_mm) + 1) + 1)


def added_conditions(levels: Sequence[tuple[float, tuple[float, ...]]]) -> Conditions:
    """Readings on all legs for each station and its displacements, each with mountings of its own.

    Zero before every cycle and last, both axes.
    """
    rows: list[tuple[float, ...]] = []
    places = [(leg, axis) for leg in range(3) for axis in range(3) if axis != leg]
    mountings = [(station, of_it, place) for station, of_it in levels for place in places]
    for mount, (station, of_it, place) in enumerate(mountings):
        path = [0.0, *of_it] * CYCLES + [0.0]
        approach = [0.0, *np.sign(np.diff(path))]
        for k, level in enumerate(path):
            cycle = k // (len(of_it) + 1) + 1
            rows.append((*place, level, station, mount, approach[k], k, cycle))
    leg, axis, displacement, stations, mounting, approaches, step, cycles = np.array(rows).T
    legs, axes, mounts = (of.astype(np.intp).tolist() for of in (leg, axis, mounting))
    made = conditions(legs, axes, displacement.tolist(), station=stations.tolist(), mount=mounts)
    return replace(
        made, approach=approaches, time_s=SECONDS_PER_STEP * step, cycle=cycles.astype(np.intp)
    )


@dataclass(frozen=True, eq=False)
class Explanation:
    """A candidate with the values ``(r,)`` found so far."""

    candidate: Candidate
    values: FloatArray


Name = Sequence[Explanation]
"""What goes by one name: one explanation, or several such as screws of different leads."""

Place = tuple[float, tuple[float, ...], str]
"""Station, displacements, leg."""


class Judge:
    """Products of all columns on the old readings, and what options add to them.

    ``given`` are effects that stay whatever is decided.
    """

    def __init__(
        self, problem: Problem, names: Sequence[Name], given: Sequence[Explanation] = ()
    ) -> None:
        self._names = len(names)
        self._all = [*(one for name in names for one in name), *given]
        owners = [k for k, name in enumerate(names) for _ in name]
        self._mine = [np.flatnonzero(np.equal(owners, k)) for k in range(len(names))]
        ends = np.cumsum([len(one.values) for one in self._all]).tolist()
        self._spans = [
            np.arange(end - len(one.values), end) for end, one in zip(ends, self._all, strict=True)
        ]
        self._given = self._spans[len(owners) :]
        self._values = np.zeros((ends[-1], len(self._all)))
        for k, (span, one) in enumerate(zip(self._spans, self._all, strict=True)):
            self._values[span, k] = one.values
        rows = [self._columns(one.model, one.observed) for one in problem.fitted_sessions]
        old = np.hstack([problem.root_weight[:, None] * np.vstack(rows), problem.bars])
        rest = without(problem.whitening.free, old)
        self._tolerance_mm = problem.fitted_sessions[-1].case.tolerance_mm
        self._noise_mm = problem.noise_mm
        self._raw = (old**2).sum(axis=0)[: ends[-1]]
        held = np.diag(np.arange(len(rest.T)) >= ends[-1])  # the lengths, by their tolerance
        self._old = rest.T @ rest + held

    def separations(self, model: Model, options: Sequence[Added]) -> FloatArray:
        """How far each pair of names is apart ``(options, names, names)``, noise variances.

        ``model`` is the machine as it is when the options are measured.
        """
        parts = self._parts(model, options)
        whole = np.stack(
            [
                sum(parts[s, one.levels_mm, leg] for s in one.stations for leg in one.legs)
                for one in options
            ]
        )
        width = len(self._old)
        across, base = whole[:, :width, width:], whole[:, width:, width:]
        scale = np.sqrt(np.maximum(np.einsum("okk->ok", base), TINY))
        across, base = across / scale[:, None], base / (scale[:, :, None] * scale[:, None])
        inside = np.linalg.pinv(base, rcond=BASE_SQUARES, hermitian=True)
        added = whole[:, :width, :width] - across @ inside @ np.swapaxes(across, 1, 2)
        both, count = self._old + added, len(self._raw)
        bars = np.linalg.solve(both[:, count:, count:], both[:, count:, :count])
        left = both[:, :count, :count] - both[:, :count, count:] @ bars
        size = np.sqrt(np.maximum(self._raw + np.einsum("okk->ok", whole)[:, :count], TINY))
        left = self._left(left / (size[:, :, None] * size[:, None]), size)
        found = np.zeros((len(options), self._names, self._names))
        for a, b in combinations(range(self._names), 2):
            some = left[:, self._mine[a]][:, :, self._mine[b]].min(axis=(1, 2))
            others = left[:, self._mine[b]][:, :, self._mine[a]].min(axis=(1, 2))
            found[:, a, b] = found[:, b, a] = np.minimum(some, others)
        return found

    def _left(self, products: FloatArray, size: FloatArray) -> FloatArray:
        """What each explanation leaves of each other one ``(options, other, true)``."""
        scaled = size[:, :, None] * self._values
        seen = products @ scaled
        whole = np.einsum("oke,oke->oe", scaled, seen)
        left = np.zeros((len(products), len(self._all), len(self._all)))
        for k, span in enumerate(self._spans):
            hidden = np.concatenate([span, *self._given])
            block = products[:, hidden][:, :, hidden]
            inside = np.linalg.pinv(block, rcond=NEW_DIRECTION**2, hermitian=True)
            explained = np.einsum("ohe,ohg,oge->oe", seen[:, hidden], inside, seen[:, hidden])
            left[:, k] = np.maximum(whole - explained, 0.0)
        return left

    def _columns(self, model: Model, taken: Conditions) -> FloatArray:
        """Columns of every explanation side by side; zero where one does not show."""
        effects = list(dict.fromkeys(one.candidate.shares[0].effect for one in self._all))
        seen = {_key(one): one.columns for one in candidates(model, taken, effects)}
        columns = []
        for one in self._all:
            nothing = np.zeros((len(taken), len(one.values)))
            columns.append(seen.get(_key(one.candidate), nothing))
        return np.hstack(columns)

    def _parts(self, model: Model, options: Sequence[Added]) -> dict[Place, FloatArray]:
        """Products of what is sought, lengths and offsets, zeros projected out, at every place."""
        keys = list(dict.fromkeys((s, one.levels_mm) for one in options for s in one.stations))
        taken = added_conditions(keys)
        base = derivatives(model.geometry, model.parameters_mm, taken, model.effects)
        base = (base * self._tolerance_mm)[:, [3, 4, 5, 0, 1, 2]]  # lengths are those of before
        columns = np.hstack([self._columns(model, taken), base]) / self._noise_mm
        columns = without_means(taken.mount, np.ones(len(taken)), columns)
        legs = [(*key, leg) for key in keys for leg in LEG_NAMES]  # of two mountings each
        each = ((place, columns[taken.mount // 2 == k]) for k, place in enumerate(legs))
        return {place: rows.T @ rows for place, rows in each}


def _key(one: Candidate) -> tuple[str, str, str, tuple[EffectParameter, ...]]:
    return one.id, one.where, one.arrangement, one.parameters
