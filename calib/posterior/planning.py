"""What to measure next: what lowers the bound at the tool most for its minutes.

Also which measurement separates the names that stay open, and, where no reading of legs lowers the
bound, which measurement outside shows what they cannot see.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import combinations, product

import numpy as np

from calib.arrays import LEG_NAMES, Conditions, FloatArray, conditions, descending
from calib.errors import CalibrationError
from calib.posterior.correction import Correction, Holds, distances_of, parts_of, quantile_mm
from calib.posterior.forecast import Forecast, Outcome, Readings
from calib.posterior.posterior import Posterior
from calib.posterior.tool import RIGID, Frame
from calib.tripod.geometry import Geometry
from calib.tripod.pipeline import Model
from calib.tripod.pool import STATIONS

WAY = (0.0, 0.37, 1.0, 0.7, 0.37, 0.0, -0.37, -0.7, -1.0, -0.7, -0.37, 0.0)
"""Displacements of a set-up as parts of the way: uneven ones, most of them from both sides."""

LEVEL_SETS = (
    (1.0, -1.0),
    (0.25, 0.55, 0.85, 1.0),
    (-0.25, -0.55, -0.85, -1.0),
    (0.4, 1.0, 0.4, -0.4, -1.0, -0.4),
)
"""Others, read in `CYCLES` with Zero before each: the ends, one side, both sides."""

CYCLES = 3
MIDDLE = 0.5
STATIONS_OF_CYCLES = (0.3, MIDDLE, 0.7)

SHIFT_MM = 5.0
"""A joint offset is changed by so much where readings must become larger; levels keep clear of the
joint limits by as much."""

LOAD = 2.0
"""The tool with a mass as heavy as itself."""
MATTERS_OF_LOAD = "gravity_sag"

WORTH = 0.9
"""A measurement is worth its time where it lowers the bound to less than this part."""

GOAL = 60.0
"""Noise variances between two names that are aimed at: values are known by estimate only."""
NEARLY = 0.97
"""A shorter measurement is preferred when it separates so much of the best."""
APART = 1.0
"""Names that no measurement separates by so many noise variances are one thing in other words."""
DECIDED = 0.95
"""Probability from which a name is not open."""
OPEN = 0.05
"""Weight, beside the likeliest, that a rival has at least."""
MOST_COMPARED = 6


@dataclass(frozen=True)
class Pace:
    """What measuring takes: minutes of a set-up and of a change before it, seconds of a step."""

    minutes_per_mounting: float = 2.0
    seconds_per_step: float = 20.0
    minutes_of_preparation: float = 5.0


@dataclass(frozen=True)
class Preparation:
    """What is changed before measuring: offsets entered in the controller, mm, and the load."""

    entered_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    load: float = 1.0

    @property
    def words(self) -> str:
        """An instruction, empty where nothing is changed."""
        words = [
            f"add {change:+g} mm to the entered joint offset of {leg.upper()}"
            for leg, change in zip(LEG_NAMES, self.entered_mm, strict=True)
            if change
        ]
        if self.load != 1.0:
            words.append(
                f"load the tool to {self.load:g} times its weight and note load = {self.load:g} "
                "in the machine file"
            )
        return " and ".join(words)

    def model(self, model: Model) -> Model:
        """The machine as it is then."""
        parameters = np.array(model.parameters_mm)
        parameters[:3] -= self.entered_mm
        load = model.geometry.load * self.load
        return replace(
            model.with_parameters(parameters), geometry=replace(model.geometry, load=load)
        )


@dataclass(frozen=True, eq=False)
class Candidate:
    """A measurement that may be taken: ``taken`` are its set-ups, read one after the other.

    Legs at a station are read at ``levels_mm`` in ``cycles``, each beginning at Zero where there
    are several. A ``procedure`` that comes with the program has its name instead.
    """

    taken: tuple[Conditions, ...]
    minutes: float
    legs: tuple[str, ...] = ()
    station: float = MIDDLE
    levels_mm: tuple[float, ...] = ()
    cycles: int = 1
    preparation: Preparation = Preparation()
    procedure: str = ""

    @property
    def words(self) -> str:
        """In short."""
        before = f"{self.preparation.words}; then " if self.preparation.words else ""
        if self.procedure:
            return f"{before}procedure {self.procedure}"
        levels = ", ".join(f"{level:+g}" if level else "Zero" for level in self.levels_mm)
        legs = "leg " if len(self.legs) == 1 else "legs "
        first = "Zero, " if self.cycles > 1 else ""
        times = f", {self.cycles} times" if self.cycles > 1 else ""
        return (
            f"{before}{legs}{', '.join(self.legs).upper()}, {self.station:.0%} from the tool end: "
            f"{first}{levels} mm{times}"
        )

    @property
    def text(self) -> str:
        """The procedure as a file that can be run; of one that comes with the program its name."""
        if self.procedure:
            return self.procedure
        several = self.cycles > 1
        levels = [f"{level:.1f}" if level else '"zero"' for level in self.levels_mm]
        words = self.preparation.words
        return (
            'schema = "glidecal.procedure/1"\n'
            f'name = "next-{"".join(self.legs)}"\n'
            'title = "The measurement that was proposed next"\n'
            + (f'description = "First {words}."\n' if words else "")
            + f"legs = [{', '.join(repr_of(leg) for leg in self.legs)}]\n"
            f"stations = [{self.station}]\n"
            f"cycles = {self.cycles}\n"
            f"levels = [{', '.join([repr_of('zero')] * several + levels)}]\n"
            + ("" if several else 'return_to_zero = false\norder = "fixed"\n')
        )


def repr_of(name: str) -> str:
    """A string in TOML."""
    return f'"{name}"'


def candidates(
    posterior: Posterior, pace: Pace = Pace(), procedures: Mapping[str, Sequence[Conditions]] = {}
) -> list[Candidate]:
    """Set-ups of legs, as far as bars are usable, and ``procedures`` by name, each set-up apart."""
    geometry = posterior.geometry
    every = [
        Candidate(tuple(taken), _minutes(pace, taken, len(taken)), procedure=name)
        for name, taken in procedures.items()
    ]
    ways = [(WAY, 1, station) for station in STATIONS]
    ways += [(parts, CYCLES, at) for parts, at in product(LEVEL_SETS, STATIONS_OF_CYCLES)]
    every += _of_legs(geometry, pace, ways, Preparation())
    known = {component for component, _ in posterior.places}
    changed = [Preparation(load=LOAD)] if MATTERS_OF_LOAD in known else []
    offsets = posterior.sessions[-1].model.parameters_mm[:3]
    for leg, offset in enumerate(offsets):
        entered = [0.0, 0.0, 0.0]
        entered[leg] = math.copysign(SHIFT_MM, -offset) + 0.0
        changed.append(Preparation((entered[0], entered[1], entered[2])))
    for preparation in changed:
        every += _of_legs(geometry, pace, [(WAY, 1, MIDDLE)], preparation)
    return every


def _of_legs(
    geometry: Geometry,
    pace: Pace,
    ways: Iterable[tuple[Sequence[float], int, float]],
    preparation: Preparation,
) -> Iterator[Candidate]:
    """Each leg alone and all together."""
    clear_mm = max(abs(change) for change in preparation.entered_mm)
    extra = pace.minutes_of_preparation if preparation.words else 0.0
    for parts, cycles, station in ways:
        for legs in [(leg,) for leg in range(3)] + [(0, 1, 2)]:
            places = [(leg, station) for leg in legs]
            levels = levels_within(geometry, places, parts, clear_mm)
            if not levels:
                continue
            taken = tuple(set_up(leg, station, levels, cycles) for leg in legs)
            yield Candidate(
                taken,
                extra + _minutes(pace, taken, len(taken)),
                tuple(LEG_NAMES[leg] for leg in legs),
                station,
                levels,
                cycles,
                preparation,
            )


def _minutes(pace: Pace, taken: Sequence[Conditions], mountings: int) -> float:
    """Of so many mountings; both axes of a leg are read in one step."""
    steps = sum(int((one.axis == one.axis[0]).sum()) for one in taken)
    return mountings * pace.minutes_per_mounting + steps * pace.seconds_per_step / 60.0


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


@lru_cache(maxsize=256)
def set_up(
    leg: int, station: float, levels_mm: tuple[float, ...], cycles: int, seconds: float = 20.0
) -> Conditions:
    """Both axes of a leg at these displacements; of several cycles Zero before each and last."""
    path = [0.0, *levels_mm] * cycles + [0.0] if cycles > 1 else list(levels_mm)
    count, axes = len(path), [axis for axis in range(3) if axis != leg]
    taken = conditions(
        [leg] * 2 * count, [a for a in axes for _ in path], path * 2, station=station
    )
    approach = np.sign(np.diff(path, prepend=path[0]))  # nobody saw how the first was reached
    cycle = 1 + np.arange(count) // (len(levels_mm) + 1) if cycles > 1 else np.ones(count)
    return replace(
        taken,
        approach=np.tile(approach, 2),
        time_s=np.tile(seconds * np.arange(count), 2),
        cycle=np.tile(cycle.astype(np.intp), 2),
    )


@dataclass(frozen=True, eq=False)
class Proposal:
    """A measurement, the expected bound at the tool after it, and what a minute of it gains."""

    candidate: Candidate
    bound_mm: float
    gain_mm_per_minute: float


Name = tuple[tuple[str, str], ...]
"""Ids and places of what is true together; none where nothing has a name."""


@dataclass(frozen=True, eq=False)
class Separation:
    """The measurement that tells names apart: the two nearest by ``apart`` noise variances."""

    candidate: Candidate
    names: tuple[Name, ...]
    apart: float

    @property
    def words(self) -> str:
        """The measurement and what it decides between."""
        verb = "decides" if self.apart >= GOAL / 2.0 else "helps to decide"
        names = [" with ".join(f"{i} ({where})" for i, where in name) for name in self.names]
        names = [name or "no named effect" for name in names]
        return (
            f"{self.candidate.words}; it {verb} between {', '.join(names[:-1])} and {names[-1]}"
        )


@dataclass(frozen=True)
class Outside:
    """A measurement with another instrument, and the bound where it shows no error.

    ``share`` is the part of the square of the bound that no reading of legs shows.
    """

    instrument: str
    words: str
    share: float
    bound_mm: float


@dataclass(frozen=True, eq=False)
class Plan:
    """What the posterior proposes for a frame and a controller; the best a minute first."""

    frame: Frame
    holds: Holds
    bound_mm: float
    proposals: tuple[Proposal, ...]
    separation: Separation | None
    outside: Outside | None

    @property
    def more_helps(self) -> bool:
        """Whether any proposal lowers the bound to less than `WORTH`."""
        return any(one.bound_mm < WORTH * self.bound_mm for one in self.proposals)


@dataclass(frozen=True, eq=False)
class Planner:
    """A posterior, what is entered from it, and what may be measured."""

    posterior: Posterior
    correction: Correction
    candidates: tuple[Candidate, ...]

    @cached_property
    def forecast(self) -> Forecast:
        """The posterior with what is entered now: it is entered anew after the measurement."""
        left_out = {one.part for one in self.correction.left_out}
        index = [
            k
            for group, parts in parts_of(self.posterior, self.correction.holds).items()
            for name, columns in parts
            for k in columns
            if group not in left_out and name not in left_out
        ]
        return Forecast.of(self.posterior, self.correction.frame, index)

    @property
    def bound_mm(self) -> float:
        """Of the correction as it is, in its frame."""
        return self.correction.bound_mm[self.correction.frame]

    @cached_property
    def readings(self) -> list[Readings]:
        """What each candidate is expected to show."""
        wanted: dict[Preparation, dict[int, Conditions]] = {}
        for one in self.candidates:
            wanted.setdefault(one.preparation, {}).update({id(taken): taken for taken in one.taken})
        shown: dict[tuple[Preparation, int], Readings] = {}
        for preparation, taken in wanted.items():
            apart = bool(preparation.words)
            made = self.forecast.readings(
                list(taken.values()), preparation.model, offsets_apart=apart
            )
            shown |= {(preparation, key): one for key, one in zip(taken, made, strict=True)}
        return [
            Readings.together([shown[one.preparation, id(taken)] for taken in one.taken])
            for one in self.candidates
        ]

    @cached_property
    def outcomes(self) -> list[Outcome]:
        """What is expected after each."""
        open_names = [k for k, _ in self._open]
        return [self.forecast.after(one, open_names) for one in self.readings]

    @cached_property
    def _scale(self) -> float:
        """The bound over that of the models of the forecast, which are not all."""
        return self.bound_mm / self.forecast.after(None).bound_mm

    def proposals(self) -> list[Proposal]:
        """The best a minute first."""
        every = []
        for candidate, outcome in zip(self.candidates, self.outcomes, strict=True):
            bound_mm = self._scale * outcome.bound_mm
            gain = (self.bound_mm - bound_mm) / candidate.minutes
            every.append(Proposal(candidate, bound_mm, gain))
        return descending(every, lambda one: one.gain_mm_per_minute)

    def in_turn(self, most: int) -> list[Proposal]:
        """One after the other, as long as one lowers the bound to `WORTH` of what it was."""
        taken: list[Readings] = []
        bound_mm, chosen = self.bound_mm, []
        while len(chosen) < most:
            best: tuple[float, float, int] | None = None
            for k, (candidate, readings) in enumerate(
                zip(self.candidates, self.readings, strict=True)
            ):
                if candidate.preparation.words:
                    continue
                after = self._scale * self.forecast.after(
                    Readings.together([*taken, readings])
                ).bound_mm
                gain = math.log(bound_mm / after) / candidate.minutes
                if after < WORTH * bound_mm and (best is None or gain > best[0]):
                    best = gain, after, k
            if best is None:
                break
            _, after, k = best
            gain = (bound_mm - after) / self.candidates[k].minutes
            chosen.append(Proposal(self.candidates[k], after, gain))
            taken.append(self.readings[k])
            bound_mm = after
        return chosen

    @cached_property
    def _open(self) -> list[tuple[int, Name]]:
        """The likeliest model of each name that stays open; empty where one is decided."""
        shares: dict[Name, float] = {}
        heaviest: dict[Name, int] = {}
        names = [self._name(model.members) for model in self.posterior.models]
        for model, name in zip(self.posterior.models, names, strict=True):
            shares[name] = shares.get(name, 0.0) + model.weight
        for k, number in enumerate(self.forecast.numbers.tolist()):
            heaviest.setdefault(names[number], k)
        likeliest = sorted(shares, key=lambda name: -shares[name])[:MOST_COMPARED]
        if shares[likeliest[0]] >= DECIDED:
            return []
        return [
            (heaviest[name], name)
            for name in likeliest
            if name in heaviest and shares[name] >= OPEN * shares[likeliest[0]]
        ]

    def _name(self, members: Sequence[int]) -> Name:
        components = [self.posterior.components[k] for k in members]
        return tuple(sorted((one.id, one.where) for one in components))

    def separation(self) -> Separation | None:
        """The shortest measurement that separates open names nearly best; None where none does."""
        names = [name for _, name in self._open]
        if len(names) < 2:
            return None
        weight = self.forecast.weight[[k for k, _ in self._open]]
        both = np.outer(weight, weight)
        apart = [np.minimum(one.separation, one.separation.T) for one in self.outcomes]
        score = np.array([float((np.minimum(one, GOAL) * both).sum()) for one in apart])
        good = [
            k
            for k in np.flatnonzero(score >= NEARLY * score.max()).tolist()
            if self.candidates[k].legs or self.candidates[k].procedure
        ]
        best = min(
            good,
            key=lambda k: (bool(self.candidates[k].preparation.words), self.candidates[k].minutes),
        )
        return self._between(self.candidates[best], names, apart[best])

    def _between(
        self, candidate: Candidate, names: Sequence[Name], apart: FloatArray
    ) -> Separation | None:
        """The names that are told from the likeliest and from each other."""
        told = [0]
        for k in range(1, len(names)):
            if all(apart[k, other] >= APART for other in told):
                told.append(k)
        if len(told) < 2:
            return None
        least = min(float(apart[a, b]) for a, b in combinations(told, 2))
        return Separation(candidate, tuple(names[k] for k in told), least)

    def outside(self) -> Outside | None:
        """What shows the part of the error that legs do not see, where it is the larger one."""
        frame, values = self.correction.frame, self.correction.values

        def bound(hidden: Sequence[int]) -> float:
            return quantile_mm(distances_of(self.posterior, frame, values, hidden))

        whole, seen = bound(()), bound(range(-RIGID, 0))
        share = 1.0 - (seen / whole) ** 2
        if share <= 0.5:
            return None
        after = {instrument: bound(columns) for instrument, (columns, _) in OUTSIDE.items()}
        best = min(after, key=lambda instrument: after[instrument])
        return Outside(best, OUTSIDE[best][1], share, after[best])

    def plan(self) -> Plan:
        """All answers."""
        return Plan(
            self.correction.frame,
            self.correction.holds,
            self.bound_mm,
            tuple(self.proposals()),
            self.separation(),
            self.outside(),
        )


OUTSIDE: dict[str, tuple[tuple[int, ...], str]] = {
    "square": (
        (-1,),
        "read the tool along a square that is aligned with the table: it shows how far the machine "
        "is turned about Z",
    ),
    "plate": (
        (-3, -2),
        "read the tool against a plate that lies on the table: it shows how far the machine is "
        "turned about X and Y",
    ),
    "ball": (
        (-6, -5, -4),
        "touch a ball at a known place of the table: it shows how far the machine is shifted",
    ),
}
"""Instruments, the shifts and turns of the machine that each shows, and how."""
