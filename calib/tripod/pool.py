"""What may be measured on an Orthoglide: candidates of the method that observes the legs.

A candidate is one step: the tool goes to a displacement along a leg's axis, coming from one side,
and two indicators on that leg, at one station, are read along both other axes. Every mounting
(leg, station, axis) has a zero of its own: further parameters behind the six of the machine.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from calib.arrays import FloatArray, IntArray, conditions
from calib.errors import ImpossibleRequest
from calib.tripod.geometry import PARAMETER_NAMES, Geometry, Pair
from calib.tripod.pipeline import derivatives

STATIONS = (0.2, 0.35, 0.5, 0.65, 0.8)
"""Touched points at Zero, as fractions of the leg from the tool end, that a stand reaches."""

DIAL_DECIMALS = 1
"""Displacements are commanded in steps of 0.1 mm."""

LEVEL_COUNT = 17
"""Displacements between the joint limits: steps of 10 mm on the prototype."""

PARAMETERS = len(PARAMETER_NAMES)
FREE = tuple(range(PARAMETERS))

ACROSS = np.array([[1, 2], [0, 2], [0, 1]], dtype=np.intp)
"""The two axes across each leg."""


@dataclass(frozen=True, eq=False)
class LegPool:
    """Candidates ``(n,)`` and their rows ``(n, 2, 6 + n_zeros)``, mm per mm.

    ``place`` numbers the pairs (leg, station) in ``places``; ``approach`` is the sign of the
    carriage's last movement. A displacement on a joint limit, or where the bar's usable part ends,
    is reached from one side only.
    """

    geometry: Geometry
    leg: IntArray
    displacement_mm: FloatArray
    approach: IntArray
    station: FloatArray
    place: IntArray
    places: tuple[tuple[int, float], ...]
    rows: FloatArray

    def __len__(self) -> int:
        return len(self.leg)

    def take(self, subset: IntArray) -> LegPool:
        """Only these candidates; the zeros stay."""
        arrays = ("leg", "displacement_mm", "approach", "station", "place", "rows")
        return replace(self, **{name: getattr(self, name)[subset] for name in arrays})

    def moved(self, displacement_mm: FloatArray, station: FloatArray) -> LegPool:
        """The candidates elsewhere ``(n,)``; those of one mounting keep a common station."""
        places = list(self.places)
        for place, leg, value in zip(self.place, self.leg, station, strict=True):
            places[place] = int(leg), float(value)
        elsewhere = replace(
            self, displacement_mm=displacement_mm, station=station, places=tuple(places)
        )
        return elsewhere.with_rows()

    def with_rows(self) -> LegPool:
        """The candidates with their rows: derivatives by the six, 1 for the mounting's zero."""
        rows, numbers = (
            np.zeros((len(self), 2, PARAMETERS + 2 * len(self.places))),
            range(len(self)),
        )
        for k, axis in enumerate(ACROSS[self.leg].T):
            planned = conditions(
                self.leg.tolist(),
                axis.tolist(),
                self.displacement_mm.tolist(),
                station=self.station.tolist(),
            )
            rows[:, k, :PARAMETERS] = derivatives(self.geometry, np.zeros(PARAMETERS), planned)
            rows[numbers, k, PARAMETERS + 2 * self.place + k] = 1.0
        return replace(self, rows=rows)

    def index(self, leg: int, displacement_mm: float, station: float) -> int:
        """The first candidate there."""
        matches = (
            (self.leg == leg)
            & (self.displacement_mm == displacement_mm)
            & (self.station == station)
        )
        return int(np.flatnonzero(matches)[0])


def levels_mm(geometry: Geometry) -> tuple[float, ...]:
    """Displacements between the joint limits on a grid, Zero among them, mm."""
    grid = np.linspace(geometry.travel_min_mm, geometry.travel_max_mm, LEVEL_COUNT)
    near = 0.5 * float(grid[1] - grid[0])  # of Zero, which takes the place of what is next to it
    inner = [round(float(level), 3) for level in grid[1:-1] if abs(level) >= near]
    ends = [geometry.travel_min_mm, geometry.travel_max_mm]
    return tuple(sorted({*inner, *ends, 0.0}))


def leg_pool(
    geometry: Geometry,
    *,
    stations: Sequence[float] = STATIONS,
    both_ways: bool = True,
) -> LegPool:
    """All candidates on usable parts of the bars; ``both_ways`` counts each side of approach.

    Without backlash in the model both sides tell the same; they are different visits all the same.
    Raises ImpossibleRequest where no station allows any displacement.
    """
    places = tuple((leg, float(station)) for leg in range(3) for station in stations)
    ends = [turning_mm(geometry, *place) for place in places]
    steps = [
        (number, level, side)
        for (number, (low, high)), level in product(enumerate(ends), levels_mm(geometry))
        for side in ((1, -1) if both_ways else (1,))
        if low <= min(level, 0.0) <= max(level, 0.0) <= high
        and not (both_ways and level == (low if side > 0 else high))
        and (geometry.common_zero or geometry.goes(places[number][0], level))
    ]
    if not any(level for _, level, _ in steps):
        raise ImpossibleRequest(
            "touched points of the bars",
            f"no displacement at any of the stations {', '.join(f'{s:g}' for s in stations)}",
            "a usable part of the bars that an indicator stays on",
            "Widen usable_bar in the machine file.",
        )
    place = np.array([number for number, _, _ in steps], dtype=np.intp)
    return LegPool(
        geometry=geometry,
        leg=np.array([places[number][0] for number in place], dtype=np.intp),
        displacement_mm=np.array([level for _, level, _ in steps]),
        approach=np.array([side for _, _, side in steps], dtype=np.intp),
        station=np.array([places[number][1] for number in place]),
        place=place,
        places=places,
        rows=np.empty(0),  # made next, from all the others
    ).with_rows()


def turning_mm(geometry: Geometry, leg: int, station: float) -> Pair:
    """Lowest and highest displacement of a set-up that can be dialled."""
    low, high = geometry.span_mm(leg, station)
    steps = 10.0**DIAL_DECIMALS
    return (
        low if low == geometry.travel_min_mm else math.ceil(low * steps) / steps,
        high if high == geometry.travel_max_mm else math.floor(high * steps) / steps,
    )
