"""Measurements that may be added: where, at which displacements, and what is changed before."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from itertools import combinations

import numpy as np

from calib.diagnosis.problem import Problem
from calib.linalg import BASE_SQUARES, NEW_DIRECTION, TINY, without
from calib.observations import LEG_NAMES, Conditions, FloatArray, conditions
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
    return _joined([_at_station(*each) for each in levels])


def _at_station(station: float, levels: Sequence[float]) -> Conditions:
    cycle = [0.0, *levels]
    path = cycle * CYCLES + [0.0]
    rows = [
        (leg, axis, k)
        for leg in range(3)
        for axis in range(3)
        if axis != leg
        for k in range(len(path))
    ]
    step = np.array([k for _, _, k in rows])
    made = conditions(
        [leg for leg, _, _ in rows],
        [axis for _, axis, _ in rows],
        [path[k] for k in step],
        station=station,
    )
    return replace(
        made,
        approach=np.concatenate([[0.0], np.sign(np.diff(path))])[step],
        time_s=SECONDS_PER_STEP * step,
        cycle=step // len(cycle) + 1,
    )


def _joined(parts: Sequence[Conditions]) -> Conditions:
    """One after the other; mountings stay apart."""
    arrays = {
        f.name: np.concatenate([getattr(one, f.name) for one in parts]) for f in fields(Conditions)
    }
    before = np.cumsum([0, *(one.mount_count for one in parts)])
    arrays["mount"] = np.concatenate(
        [one.mount + start for one, start in zip(parts, before, strict=False)]
    )
    return Conditions(**arrays)


@dataclass(frozen=True, eq=False)
class Explanation:
    """A candidate with the values ``(r,)`` found so far."""

    candidate: Candidate
    values: FloatArray


Name = Sequence[Explanation]
"""What goes by one name: one explanation, or several such as screws of different leads."""

Place = tuple[float, tuple[float, ...], str]
"""Station, displacements, leg."""


@dataclass(eq=False)
class Judge:
    """Products of all columns on the old readings, and what options add to them.

    ``beside`` are effects that stay whatever is decided.
    """

    problem: Problem
    names: Sequence[Name]
    beside: Sequence[Explanation]

    def __post_init__(self) -> None:
        self._all = [*(one for name in self.names for one in name), *self.beside]
        owners = [k for k, name in enumerate(self.names) for _ in name]
        self._mine = [np.flatnonzero(np.equal(owners, k)) for k in range(len(self.names))]
        ends = np.cumsum([len(one.values) for one in self._all]).tolist()
        self._spans = [
            np.arange(b - len(e.values), b) for b, e in zip(ends, self._all, strict=True)
        ]
        rows = [self._columns(one.model, one.observed) for one in self.problem.fitted_sessions]
        old = self.problem.root_weight[:, None] * np.vstack(rows)
        rest = without(self.problem.nuisance, old)
        self._noise_mm = float(np.sqrt(np.mean(self.problem.root_weight**-2.0)))
        self._raw = (old**2).sum(axis=0)
        self._old = rest.T @ rest

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """All pairs of names."""
        return list(combinations(range(len(self.names)), 2))

    def separations(self, model: Model, options: Sequence[Added]) -> FloatArray:
        """How far each pair of names is apart ``(options, names, names)``, noise variances.

        ``model`` is the machine as it is when the options are measured.
        """
        parts = self._parts(model, options)
        whole = np.stack([sum(parts[p] for p in _places(one)) for one in options])
        width = len(self._raw)
        across, base = whole[:, :width, width:], whole[:, width:, width:]
        scale = np.sqrt(np.maximum(np.einsum("okk->ok", base), TINY))
        across, base = across / scale[:, None], base / (scale[:, :, None] * scale[:, None])
        inside = np.linalg.pinv(base, rcond=BASE_SQUARES, hermitian=True)
        added = whole[:, :width, :width] - across @ inside @ np.swapaxes(across, 1, 2)
        size = np.sqrt(np.maximum(self._raw + np.einsum("okk->ok", whole)[:, :width], TINY))
        products = (self._old + added) / (size[:, :, None] * size[:, None])
        left = self._left(products, size)
        found = np.zeros((len(options), len(self.names), len(self.names)))
        for a, b in self.pairs:
            some = left[:, self._mine[a]][:, :, self._mine[b]].min(axis=(1, 2))
            others = left[:, self._mine[b]][:, :, self._mine[a]].min(axis=(1, 2))
            found[:, a, b] = found[:, b, a] = np.minimum(some, others)
        return found

    def _left(self, products: FloatArray, size: FloatArray) -> FloatArray:
        """What each explanation leaves of each other one ``(options, other, true)``."""
        values = np.zeros((len(self._raw), len(self._all)))
        for k, (span, one) in enumerate(zip(self._spans, self._all, strict=True)):
            values[span, k] = one.values
        scaled = size[:, :, None] * values
        seen = products @ scaled
        whole = np.einsum("oke,oke->oe", scaled, seen)
        kept = self._spans[len(self._all) - len(self.beside) :]
        left = np.zeros((len(products), len(self._all), len(self._all)))
        for k, span in enumerate(self._spans):
            hidden = np.concatenate([span, *kept])
            block = products[:, hidden][:, :, hidden]
            inside = np.linalg.pinv(block, rcond=NEW_DIRECTION**2, hermitian=True)
            explained = np.einsum("ohe,ohg,oge->oe", seen[:, hidden], inside, seen[:, hidden])
            left[:, k] = np.maximum(whole - explained, 0.0)
        return left

    def _columns(self, model: Model, taken: Conditions) -> FloatArray:
        """Columns of every explanation side by side; zero where one does not show."""
        laws = list(dict.fromkeys(e.candidate.shares[0].law for e in self._all))
        seen = {_key(one): one.columns for one in candidates(model, taken, laws)}
        nothing = [np.zeros((len(taken), len(e.values))) for e in self._all]
        return np.hstack(
            [seen.get(_key(e.candidate), z) for e, z in zip(self._all, nothing, strict=True)]
        )

    def _parts(self, model: Model, options: Sequence[Added]) -> dict[Place, FloatArray]:
        """Products of what is sought and base columns, zeros projected out, at every place."""
        keys = list(dict.fromkeys((s, one.levels_mm) for one in options for s in one.stations))
        taken = added_conditions(keys)
        base = derivatives(model.geometry, model.parameters_mm, taken, model.effects)
        columns = np.hstack([self._columns(model, taken), base]) / self._noise_mm
        found: dict[Place, FloatArray] = {}
        for number, key in enumerate(keys):
            for leg, name in enumerate(LEG_NAMES):
                first = 6 * number + 2 * leg
                mounts = [columns[taken.mount == m] for m in (first, first + 1)]
                centred = np.vstack([rows - rows.mean(axis=0) for rows in mounts])
                found[*key, name] = centred.T @ centred
        return found


def _places(option: Added) -> list[Place]:
    return [(s, option.levels_mm, leg) for s in option.stations for leg in option.legs]


def _key(one: Candidate) -> tuple[str, str, str, tuple[EffectParameter, ...]]:
    return one.id, one.where, one.arrangement, one.parameters
