"""Measurements that may be added: where, at which displacements, and what is changed before."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import groupby, product

import numpy as np

from calib.arrays import LEG_NAMES, Conditions, Observations, conditions, joined, observe
from calib.noise.reading import IndicatorFigures
from calib.posterior.models import Posterior
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
STATIONS_OF_CYCLES = (0.3, 0.7)

SHIFT_MM = 5.0
"""A joint offset is changed by so much where readings must become larger; levels keep clear of the
joint limits by as much."""

NOTHING_MM = 1e4
"""Scatter of an indicator that tells nothing: ten metres."""

LOAD = 2.0
"""The tool with a mass as heavy as itself."""
MATTERS_OF_LOAD = "gravity_sag"

MINUTES_OF_PREPARATION = 5.0
"""Of a change before a measurement."""


@dataclass(frozen=True)
class Pace:
    """What measuring takes: minutes of a set-up, seconds of a step."""

    minutes_per_mounting: float = 2.0
    seconds_per_step: float = 20.0


@dataclass(frozen=True)
class MeasurementPreparation:
    """What is changed before measuring: offsets entered in the controller, mm, and the load."""

    entered_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    load: float = 1.0

    @property
    def words(self) -> str:
        """An instruction, empty where nothing is changed."""
        parts = [
            f"add {change:+g} mm to the entered joint offset of {leg.upper()}"
            for leg, change in zip(LEG_NAMES, self.entered_mm, strict=True)
            if change
        ]
        if self.load != 1.0:
            parts.append(
                f"load the tool to {self.load:g} times its weight and note load = {self.load:g} "
                "in the machine file"
            )
        return " and ".join(parts)

    def model(self, model: Model) -> Model:
        """The machine as it is then."""
        parameters = np.array(model.parameters_mm)
        parameters[:3] -= self.entered_mm
        load = model.geometry.load * self.load
        return replace(
            model.with_parameters(parameters), geometry=replace(model.geometry, load=load)
        )


@dataclass(frozen=True, eq=False)
class FurtherMeasurement:
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
    preparation: MeasurementPreparation = MeasurementPreparation()
    procedure: str = ""

    @property
    def words(self) -> str:
        """The measurement in short."""
        introduction = f"{self.preparation.words}; then " if self.preparation.words else ""
        if self.procedure:
            return f"{introduction}procedure {self.procedure}"
        levels = ", ".join(f"{level:+g}" if level else "Zero" for level in self.levels_mm)
        first = "Zero, " if self.cycles > 1 else ""
        times = f", {self.cycles} times" if self.cycles > 1 else ""
        where = stand_words(self.legs, self.station)
        return f"{introduction}{where}: {first}{levels} mm{times}"

    @property
    def is_way(self) -> bool:
        """Whether it is a set-up over the whole way, with nothing changed before."""
        return self.cycles == 1 and not self.procedure and not self.preparation.words

    @property
    def text(self) -> str:
        """The procedure as a file that can be run; of one that comes with the program its name."""
        if self.procedure:
            return self.procedure
        several = self.cycles > 1
        path = [0.0, *self.levels_mm] if several else self.levels_mm
        levels = [f"{level:.1f}" if level else '"zero"' for level in path]
        legs = [f'"{leg}"' for leg in self.legs]
        preparation = self.preparation.words
        return (
            'schema = "glidecal.procedure/1"\n'
            f'name = "next-{"".join(self.legs)}"\n'
            'title = "The measurement that was proposed next"\n'
            + (f'description = "First {preparation}."\n' if preparation else "")
            + f"legs = [{', '.join(legs)}]\n"
            f"stations = [{self.station}]\n"
            f"cycles = {self.cycles}\n"
            f"levels = [{', '.join(levels)}]\n"
            + ("" if several else 'return_to_zero = false\norder = "fixed"\n')
        )


def stand_words(legs: Sequence[str], station: float) -> str:
    """Which legs are read, and where on their bars."""
    leg_words = "leg" if len(legs) == 1 else "legs"
    return f"{leg_words} {', '.join(legs).upper()}, {station:.0%} from the tool end"


USUAL_PACE = Pace()


def candidates(
    posterior: Posterior,
    pace: Pace = USUAL_PACE,
    procedures: Mapping[str, Sequence[Conditions]] | None = None,
) -> list[FurtherMeasurement]:
    """Set-ups of legs, as far as bars are usable, and ``procedures`` by name, each set-up apart.

    A machine of which the tool is read has ``procedures`` only.
    """
    measurements = [
        FurtherMeasurement(tuple(conditions), _minutes(pace, conditions), procedure=name)
        for name, conditions in (procedures or {}).items()
    ]
    load_tells = any(name == MATTERS_OF_LOAD for name, _ in posterior.places)
    return [*measurements, *set_ups_of(posterior.sessions[-1].model, pace, load_tells=load_tells)]


def set_ups_of(
    model: Model, pace: Pace = USUAL_PACE, *, load_tells: bool = True
) -> Iterator[FurtherMeasurement]:
    """Every set-up of legs that is considered on a machine; none where the tool is read."""
    if not model.geometry.reads_legs:
        return
    ways: list[tuple[tuple[float, ...], int, float]] = [(WAY, 1, at) for at in STATIONS]
    ways += [(parts, CYCLES, at) for parts, at in product(LEVEL_SETS, STATIONS_OF_CYCLES)]
    yield from _of_legs(model.geometry, pace, ways, MeasurementPreparation())
    changed = [MeasurementPreparation(load=LOAD)] if load_tells else []
    for leg, offset in enumerate(model.parameters_mm[:3]):
        entered = [0.0, 0.0, 0.0]
        entered[leg] = math.copysign(SHIFT_MM, -offset) + 0.0
        changed.append(MeasurementPreparation((entered[0], entered[1], entered[2])))
    for preparation in changed:
        yield from _of_legs(model.geometry, pace, [(WAY, 1, MIDDLE)], preparation)


def _of_legs(
    geometry: Geometry,
    pace: Pace,
    ways: Iterable[tuple[Sequence[float], int, float]],
    preparation: MeasurementPreparation,
) -> Iterator[FurtherMeasurement]:
    """Each leg alone and all together."""
    clear_mm = max(abs(change) for change in preparation.entered_mm)
    extra = MINUTES_OF_PREPARATION if preparation.words else 0.0
    for parts, cycles, station in ways:
        for legs in [(leg,) for leg in range(3)] + [(0, 1, 2)]:
            places = [(leg, station) for leg in legs]
            levels = levels_within(geometry, places, parts, clear_mm)
            if not levels:
                continue
            set_ups = tuple(
                set_up(leg, station, levels, cycles, pace.seconds_per_step) for leg in legs
            )
            yield FurtherMeasurement(
                set_ups,
                extra + _minutes(pace, set_ups),
                tuple(LEG_NAMES[leg] for leg in legs),
                station,
                levels,
                cycles,
                preparation,
            )


def _minutes(pace: Pace, set_ups: Sequence[Conditions]) -> float:
    """Minutes of set-ups; both axes of a leg are read in one step."""
    steps = sum(int((set_up.axis == set_up.axis[0]).sum()) for set_up in set_ups)
    return len(set_ups) * pace.minutes_per_mounting + steps * pace.seconds_per_step / 60.0


def levels_within(
    geometry: Geometry,
    places: Iterable[tuple[int, float]],
    parts: Sequence[float],
    clear_mm: float = 0.0,
) -> tuple[float, ...]:
    """Displacements, whole mm, as parts of the way that joint limits and bars allow.

    ``places`` are legs and stations; the ends stay clear of limits by ``clear_mm``. None where no
    way to both sides is left. Where each leg has its own Zero the machine may stand on one side of
    it only; then the levels of that side remain.
    """
    places = list(places)
    lows, highs = zip(*(geometry.span_mm(*place) for place in places), strict=True)
    low, high = math.ceil(max(lows) + clear_mm), math.floor(min(highs) - clear_mm)
    if geometry.common_zero and not low < 0 < high:
        return ()
    if not geometry.common_zero:
        low, high = (_farthest(geometry, places, end) for end in (low, high))
    ends = [round(part * (high if part > 0.0 else -low)) for part in parts]
    levels = tuple(float(level) for level, _ in groupby(ends))  # none twice without a movement
    return levels if any(levels) else ()


def _farthest(geometry: Geometry, places: Iterable[tuple[int, float]], end_mm: int) -> int:
    """How far from their Zeros, towards an end, all of these legs can go, whole mm."""
    way_mm = np.linspace(0, end_mm, abs(end_mm) + 1)
    points = (
        geometry.leg_zero_mm[leg] + way_mm[:, None] * geometry.directions[leg] for leg, _ in places
    )
    stands = np.all([geometry.stands(tool_mm) for tool_mm in points], axis=0)
    return end_mm if stands.all() else int(way_mm[max(stands.argmin() - 1, 0)])


@lru_cache(maxsize=256)
def set_up(
    leg: int, station: float, levels_mm: tuple[float, ...], cycles: int, seconds: float
) -> Conditions:
    """Both axes of a leg at these displacements; of several cycles Zero before each and last."""
    path = [0.0, *levels_mm] * cycles + [0.0] if cycles > 1 else list(levels_mm)
    count, axes = len(path), [axis for axis in range(3) if axis != leg]
    planned = conditions(
        [leg] * 2 * count, [a for a in axes for _ in path], path * 2, station=station
    )
    approach = np.sign(np.diff(path, prepend=path[0]))  # nobody saw how the first was reached
    cycle = 1 + np.arange(count) // (len(levels_mm) + 1) if cycles > 1 else np.ones(count)
    return replace(
        planned,
        approach=np.tile(approach, 2),
        time_s=np.tile(seconds * np.arange(count), 2),
        cycle=np.tile(cycle.astype(np.intp), 2),
    )


def nothing_measured(model: Model) -> tuple[Observations, IndicatorFigures]:
    """Readings that tell nothing, with such an indicator: of every bar, at both ends of it.

    With them the posterior is what is known beforehand, of effects too that act on these places.
    Where no way is left each leg at Zero.
    """
    ways = []
    for leg, station in product(range(3), STATIONS_OF_CYCLES):
        levels = levels_within(model.geometry, [(leg, station)], WAY) or (0.0,)
        ways.append(set_up(leg, station, levels, 1, USUAL_PACE.seconds_per_step))
    planned = joined(ways)
    return observe(planned, np.zeros(len(planned))), IndicatorFigures(repeatability_mm=NOTHING_MM)
