"""The procedures as they are driven: visits, path of the carriages, rows of readings."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tests.blind.forward import FloatArray, Rows, carriages

UNEVEN = (0.0, 22.0, 60.0, 41.0, 22.0, 0.0, -37.0, -71.0, -100.0, -71.0, -37.0)
PATH_POINTS = 60
SECONDS_A_VISIT = 20.0
SECONDS_A_REPEAT = 6.0


@dataclass(frozen=True)
class Plan:
    """Levels of displacement, how often, and at which touched points."""

    levels_mm: tuple[float, ...]
    cycles: int
    stations: tuple[float, ...] = (0.5,)
    over_plane: tuple[float, ...] = ()


PLANS = {
    "zero-max-min": Plan((0.0, 60.0, -100.0), 3),
    "sweep": Plan(UNEVEN, 2),
    "two-station": Plan(UNEVEN, 2, (0.5, 0.35)),
    "zero-max-min-plane": Plan((0.0, 60.0, -100.0), 3, (0.5,), (0.1, 0.9)),
    "plane": Plan((0.0, 60.0, -100.0), 3, (), (0.1, 0.9)),
}


@dataclass(frozen=True)
class Visit:
    """One posture driven to (or kept: ``repeat`` > 0), read by both indicators.

    Over a plane one indicator reads along z, at a station to which its stand slides.
    """

    leg: int
    station: float
    displacement_mm: float
    cycle: int
    repeat: int = 0
    over_plane: bool = False

    @property
    def axes(self) -> tuple[int, ...]:
        return (2,) if self.over_plane else tuple(k for k in range(3) if k != self.leg)


def visits(plan: Plan, in_place: bool) -> list[Visit]:
    """All visits; with ``in_place`` every level is driven to once and read again without moving."""
    sequence = []
    for leg in range(3):
        for station in plan.stations:
            sequence += _one_mounting(plan, leg, station, in_place)
    for leg in (0, 1) if plan.over_plane else ():
        cycles = [(d, c) for c in range(1, plan.cycles + 1) for d in plan.levels_mm]
        sequence += [
            Visit(leg, station, at, cycle, over_plane=True)
            for at, cycle in (*cycles, (0.0, plan.cycles))
            for station in plan.over_plane
        ]
    return sequence


def _one_mounting(plan: Plan, leg: int, station: float, in_place: bool) -> list[Visit]:
    cycles = range(1, plan.cycles + 1)
    if in_place:
        order = [(d, c, c - 1) for d in plan.levels_mm for c in cycles]
    else:
        order = [(d, c, 0) for c in cycles for d in plan.levels_mm]
    route = [Visit(leg, station, *step) for step in order]
    return [*route, Visit(leg, station, 0.0, plan.cycles)]


def rows_of(
    plan: Plan, rng: np.random.Generator, in_place: bool = False, homed: float = 1.0
) -> Rows:
    """The rows of a procedure in the order taken, two for each visit; ``homed`` -1: downwards."""
    return rows_of_visits(visits(plan, in_place), rng, homed)


def rows_of_visits(route: list[Visit], rng: np.random.Generator, homed: float = 1.0) -> Rows:
    """Two rows for each of these visits, one over a plane."""
    pairs = [(number, v, axis) for number, v in enumerate(route) for axis in v.axes]
    of = np.array([number for number, _, _ in pairs])
    keys = [(v.leg, axis, -1.0 if v.over_plane else v.station) for _, v, axis in pairs]
    places = {key: k for k, key in enumerate(dict.fromkeys(keys))}
    number = np.cumsum([v.repeat == 0 for v in route]) - 1
    return Rows(
        leg=np.array([v.leg for _, v, _ in pairs], dtype=np.intp),
        axis=np.array([axis for _, _, axis in pairs], dtype=np.intp),
        displacement_mm=np.array([v.displacement_mm for _, v, _ in pairs]),
        station=np.array([v.station for _, v, _ in pairs]),
        time_s=_times(route, rng)[of],
        cycle=np.array([v.cycle for _, v, _ in pairs], dtype=np.intp),
        visit=number[of].astype(np.intp),
        mount=np.array([places[key] for key in keys], dtype=np.intp),
        moved=_movements(route, homed)[of],
        plane=np.array([v.over_plane for _, v, _ in pairs]),
    )


def _times(route: list[Visit], rng: np.random.Generator) -> FloatArray:
    pauses = [SECONDS_A_REPEAT if v.repeat else SECONDS_A_VISIT for v in route]
    passed = np.cumsum(np.array(pauses) * rng.uniform(0.85, 1.3, len(route)))
    return np.asarray(np.round(passed, 1), dtype=np.float64)


def _movements(route: list[Visit], homed: float) -> FloatArray:
    """Sign of each carriage's last movement at every visit, ``(n_visits, 3)``.

    The tool is driven along straight lines; the carriages follow the nominal joints. Before the
    first visit each was moved as homing ended.
    """
    here, last = np.zeros(3), homed * np.ones(3)
    movements = []
    for visit in route:
        there = np.zeros(3)
        there[visit.leg] = visit.displacement_mm
        parts = np.linspace(0.0, 1.0, PATH_POINTS)[:, None]
        steps = np.sign(np.diff(carriages(here + parts * (there - here)), axis=0).round(9))
        from_end = np.argmax(steps[::-1] != 0, axis=0)
        ended = steps[-1 - from_end, np.arange(3)]
        last = np.where(ended == 0, last, ended)
        movements.append(last)
        here = there
    return np.array(movements)


def sorted_by_cycle(rows: Rows) -> Rows:
    """In-place repeats written down as if every cycle had driven to every posture again."""
    order = np.lexsort((np.arange(len(rows)), rows.cycle, rows.station < 0.5, rows.leg))
    names = ("leg", "axis", "displacement_mm", "station", "cycle", "visit", "mount", "moved")
    return replace(rows, **{name: getattr(rows, name)[order] for name in names})
