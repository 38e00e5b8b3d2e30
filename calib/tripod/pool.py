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
from numpy.typing import ArrayLike

from calib.arrays import Conditions, FloatArray, IntArray, conditions
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


@dataclass(frozen=True, eq=False)
class LegPool:
    """Candidates ``(n,)`` and their rows ``(n, 2, 6 + n_zeros)``, mm per mm.

    ``place`` numbers the pairs (leg, station) in ``places``; ``approach`` is the sign of the
    carriage's last movement. A displacement on a joint limit, or where the bar's usable part ends,
    is reached from one side only.
    """

    leg: IntArray
    displacement_mm: FloatArray
    approach: IntArray
    station: FloatArray
    place: IntArray
    places: tuple[tuple[int, float], ...]
    rows: FloatArray

    def __len__(self) -> int:
        return len(self.leg)

    def take(self, kept: IntArray) -> LegPool:
        """Only these candidates; the zeros stay."""
        return LegPool(
            leg=self.leg[kept],
            displacement_mm=self.displacement_mm[kept],
            approach=self.approach[kept],
            station=self.station[kept],
            place=self.place[kept],
            places=self.places,
            rows=self.rows[kept],
        )

    def moved(
        self, geometry: Geometry, displacement_mm: FloatArray, station: FloatArray
    ) -> LegPool:
        """The same candidates elsewhere ``(n,)``; those of one mounting keep a common station."""
        places = list(self.places)
        for place, leg, value in zip(self.place, self.leg, station, strict=True):
            places[place] = int(leg), float(value)
        rows = _rows(
            geometry,
            self.leg,
            displacement_mm,
            station,
            self.place,
            len(places),
            (0.0,) * PARAMETERS,
        )
        return replace(
            self,
            displacement_mm=displacement_mm,
            station=station,
            places=tuple(places),
            rows=rows,
        )

    def index(self, leg: int, displacement_mm: float, station: float) -> int:
        """The first candidate there."""
        found = (
            (self.leg == leg)
            & (self.displacement_mm == displacement_mm)
            & (self.station == station)
        )
        return int(np.flatnonzero(found)[0])


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
    parameters_mm: ArrayLike = (0.0,) * PARAMETERS,
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
    ]
    if not any(level for _, level, _ in steps):
        raise ImpossibleRequest(
            "touched points of the bars",
            f"no displacement at any of the stations {', '.join(f'{s:g}' for s in stations)}",
            "a usable part of the bars that an indicator stays on",
            "Widen usable_bar in the machine file.",
        )
    place = np.array([number for number, _, _ in steps], dtype=np.intp)
    displacement = np.array([level for _, level, _ in steps])
    leg = np.array([places[number][0] for number in place], dtype=np.intp)
    station = np.array([places[number][1] for number in place])
    return LegPool(
        leg=leg,
        displacement_mm=displacement,
        approach=np.array([side for _, _, side in steps], dtype=np.intp),
        station=station,
        place=place,
        places=places,
        rows=_rows(geometry, leg, displacement, station, place, len(places), parameters_mm),
    )


def turning_mm(geometry: Geometry, leg: int, station: float) -> Pair:
    """Lowest and highest displacement of a set-up that can be dialled."""
    low, high = geometry.span_mm(leg, station)
    steps = 10.0**DIAL_DECIMALS
    return (
        low if low == geometry.travel_min_mm else math.ceil(low * steps) / steps,
        high if high == geometry.travel_max_mm else math.floor(high * steps) / steps,
    )


def _rows(
    geometry: Geometry,
    leg: IntArray,
    displacement: FloatArray,
    station: FloatArray,
    place: IntArray,
    place_count: int,
    parameters_mm: ArrayLike,
) -> FloatArray:
    """Derivatives by the six parameters, and 1 for the zero of the mounting."""
    rows = np.zeros((len(leg), 2, PARAMETERS + 2 * place_count))
    for k in range(2):
        taken = conditions(
            leg.tolist(), across(leg, k).tolist(), displacement.tolist(), station=station.tolist()
        )
        rows[:, k, :PARAMETERS] = derivatives(geometry, parameters_mm, taken)
        rows[np.arange(len(leg)), k, PARAMETERS + 2 * place + k] = 1.0
    return rows


def across(leg: IntArray, k: int) -> IntArray:
    """The first (``k`` 0) or second of the two axes across each leg."""
    axes = np.array([[1, 2], [0, 2], [0, 1]], dtype=np.intp)
    return np.asarray(axes[leg, k])


def information_with_zeros(
    design: FloatArray, weight: FloatArray, taken: Conditions, pool: LegPool
) -> FloatArray:
    """Information ``(6 + n_zeros, ...)`` of readings that stand at places of the pool.

    ``design`` ``(n_readings, 6)`` in mm per mm, ``weight`` ``(n_readings,)`` in 1/mm². Readings
    share the zero of the pool's mounting at their leg, station and axis.
    """
    number = {place: k for k, place in enumerate(pool.places)}
    rows = np.zeros((len(taken), pool.rows.shape[2]))
    rows[:, :PARAMETERS] = design
    for n, (leg, axis, station) in enumerate(
        zip(taken.leg, taken.axis, taken.station, strict=True)
    ):
        second = int(across(np.array([leg]), 1)[0] == axis)
        rows[n, PARAMETERS + 2 * number[int(leg), float(station)] + second] = 1.0
    return np.asarray((rows.T * weight) @ rows)


def visiting_order(visits: Sequence[tuple[float, int]], ends_mm: Pair) -> list[float]:
    """Displacements of one mounting such that each visit comes from its own side.

    ``visits`` are displacement and side, repeats allowed; the tool starts at Zero. Where the way
    must turn first, the end of the way, `turning_mm`, is visited in between and read as well.
    """
    passes = _passes(visits)
    orders = [_walk(_chained(passes, up_first=up), ends_mm) for up in (True, False)]
    return min(orders, key=len)


def _passes(visits: Sequence[tuple[float, int]]) -> list[list[tuple[float, int]]]:
    """The visits without repeats, then the second ones of those repeated, and so on."""
    passes: list[list[tuple[float, int]]] = []
    for visit in visits:
        free = next((one for one in passes if visit not in one), None)
        if free is None:
            passes.append([visit])
        else:
            free.append(visit)
    return passes


def _chained(passes: list[list[tuple[float, int]]], *, up_first: bool) -> list[tuple[float, int]]:
    chain: list[tuple[float, int]] = []
    for one in passes:
        up = sorted(visit for visit in one if visit[1] > 0)
        down = sorted((visit for visit in one if visit[1] <= 0), reverse=True)
        chain += up + down if up_first else down + up
    return chain


def _walk(chain: list[tuple[float, int]], ends_mm: Pair) -> list[float]:
    position, walked = 0.0, []
    for level, side in chain:
        if (level - position) * side <= 0.0:
            position = ends_mm[0] if side > 0 else ends_mm[1]
            walked.append(position)
        walked.append(level)
        position = level
    return walked
