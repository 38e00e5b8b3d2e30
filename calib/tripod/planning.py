"""What a procedure sees of a machine with three drives, what else could be read, and what helps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.arrays import (
    LEG_NAMES,
    TOUCHED_NAMES,
    FloatArray,
    IntArray,
    Observations,
    largest,
    set_up_unknowns,
    without_zeros,
)
from calib.design.criteria import Aim, covariances_after, inverse
from calib.design.exchange import Candidates, Choice, choose
from calib.design.identifiability import AddedMeasurement, Examination
from calib.errors import ImpossibleRequest, NotIdentifiable
from calib.noise.reading import Noise, reading_weights, visits
from calib.tripod.geometry import TOLERANCE_MM, Geometry, Pair
from calib.tripod.leg_refinement import move_off_grid
from calib.tripod.pipeline import derivatives
from calib.tripod.pool import (
    FREE,
    PARAMETERS,
    STATIONS,
    LegPool,
    information_with_zeros,
    leg_pool,
    turning_mm,
    visiting_order,
)
from calib.tripod.sensitivity import sensitivity_of_readings, tool_metric

Coordinates = dict[str, float | str]
"""One posture: names with their unit, such as ``displacement_mm``."""

Orders = dict[tuple[int, float], list[float]]
"""Displacements in mm to visit for each mounting (leg, station)."""

ZERO_SPREAD_MM = 1000.0
"""Nothing is known of the zero of a mounting: its standard deviation before the first reading."""


@dataclass(frozen=True, eq=False)
class TripodPlanning:
    """A machine and the readings that a procedure takes, values without meaning, with their noise.

    ``of_tool`` tells that no leg is read from Zero: the tool against a plate, or legs over a
    plane alone; ``stations`` are those of legs from Zero.
    """

    name: str
    geometry: Geometry
    procedure: str
    planned: Observations
    of_tool: bool
    stations: tuple[float, ...]
    step_count: int
    mounting_count: int
    seconds_per_step: float
    minutes_per_mounting: float
    noise: Noise
    noise_words: str

    def examine(self) -> Examination:
        """Readings of the procedure with a free zero, and tilt of a plane, for each mounting."""
        visited, weight, design = self._readings()
        axes = zip(visited.axis, visited.leg, strict=True)
        names = [f"{LEG_NAMES[axis]}_{TOUCHED_NAMES[leg]}" for axis, leg in axes]
        minutes = self.step_count * self.seconds_per_step / 60.0
        return Examination(
            procedure=self.procedure,
            sensitivity=sensitivity_of_readings(
                self.geometry, visited, weight, design, FREE, noise_known=True
            ),
            bare=without_zeros(visited, np.ones(len(visited)), design),
            measured=tuple(dict.fromkeys(names)),
            posture_count=self.step_count,
            independent_count=int(visited.posture.max()) + 1 - set_up_unknowns(visited),
            minutes=minutes + self.mounting_count * self.minutes_per_mounting,
            units="readings and parameters in mm",
            noise_words=self.noise_words,
        )

    def _readings(self) -> tuple[Observations, FloatArray, FloatArray]:
        """What counts of the procedure, weights in 1/mm², derivatives at the nominal machine."""
        visited = visits(self.planned)
        design = derivatives(self.geometry, np.zeros(PARAMETERS), visited)
        return visited, reading_weights(visited, self.noise), design

    def pool(self) -> TripodPool:
        """All legs, displacements, sides of approach and stations.

        Raises ImpossibleRequest where the tool is read instead.
        """
        if self.of_tool:
            raise ImpossibleRequest(
                f"optimum postures with {self.procedure}",
                "readings against a plate or plane alone",
                "a procedure that reads legs from Zero",
            )
        return TripodPool(self, leg_pool(self.geometry))

    def metric(self) -> FloatArray:
        """Mean square of the tool's movement over the workspace."""
        return tool_metric(self.geometry)

    def cures(self, vectors: Sequence[FloatArray]) -> tuple[AddedMeasurement | None, ...]:
        """The best one of a level added to a mounting, or a new mounting read there and at Zero.

        None where the tool is read: no more positions show what one set-up cannot. Nor is one
        looked for beside readings over a plane.
        """
        if self.of_tool or self.planned.over_plane.any():
            return (None,) * len(vectors)
        stations = tuple(dict.fromkeys([*self.stations, *STATIONS]))
        pool = leg_pool(self.geometry, stations=stations, both_ways=False)
        visited, weight, design = self._readings()
        prior = np.full(pool.rows.shape[2], ZERO_SPREAD_MM**-2.0)
        prior[:PARAMETERS] = TOLERANCE_MM**-2.0
        information = information_with_zeros(design, weight, visited, pool) + np.diag(prior)
        covariance = inverse(information)
        used = {(int(leg), float(s)) for leg, s in zip(visited.leg, visited.station, strict=True)}
        mounted = np.array([pool.places[p] in used for p in pool.place], dtype=np.bool_)
        zero = np.array(
            [pool.index(int(i), 0.0, float(s)) for i, s in zip(pool.leg, pool.station, strict=True)]
        )
        # two readings of a new mounting, its own zero fitted: their difference
        alone = (pool.rows - pool.rows[zero]) / math.sqrt(2.0)
        rows = np.where(mounted[:, None, None], pool.rows, alone) / self.noise.standard_deviation_mm
        after = covariances_after(covariance, rows, np.ones(2), list(FREE))
        return tuple(self._cure(pool, mounted, after, vector) for vector in vectors)

    def _cure(
        self, pool: LegPool, mounted: NDArray[np.bool_], after: FloatArray, vector: FloatArray
    ) -> AddedMeasurement:
        variance = np.einsum("i,bij,j->b", vector, after, vector)
        best = largest(-variance)
        where = f"leg {LEG_NAMES[pool.leg[best]]} at {pool.displacement_mm[best]:+g} mm"
        station = f"station {pool.station[best]:g}"
        if not mounted[best]:
            where, station = f"{where} and at Zero", f"{station}, a new mounting"
        return AddedMeasurement(f"{where} ({station})", float(np.sqrt(variance[best])))


@dataclass(frozen=True, eq=False)
class TripodPool:
    """Candidates of the method that observes the legs, with their time."""

    planning: TripodPlanning
    pool: LegPool

    @property
    def candidates(self) -> Candidates:
        """Rows divided by the noise of a reading; columns of unused zeros left out."""
        rows = self.pool.rows / self.planning.noise.standard_deviation_mm
        used = np.asarray(np.abs(rows).max(axis=(0, 1)) > 0.0)
        used[:PARAMETERS] = True
        return Candidates(np.ascontiguousarray(rows[:, :, used]))

    @property
    def wanted(self) -> tuple[int, ...]:
        """The six parameters; zeros are nuisance."""
        return FREE

    @property
    def geometry(self) -> Geometry:
        """The nominal one."""
        return self.planning.geometry

    def take(self, kept: IntArray) -> TripodPool:
        """Only these candidates."""
        return TripodPool(self.planning, self.pool.take(kept))

    def symmetric(self, count: int, aim: Aim, seed: int) -> list[Choice]:
        """Displacements common to all legs, at each station alone.

        Single swaps rarely empty a mounting, so these serve as starts, too.
        """
        rows, legs = self.candidates.rows, np.unique(self.pool.leg)
        each, rest = divmod(count, len(legs))
        if rest:
            return []
        found = []
        for station in np.unique(self.pool.station):
            members = self._visits_of_all(legs, station)
            if each <= len(members[0]):
                together = np.stack(members, axis=1)
                merged = Candidates(rows[together].reshape(len(together), -1, rows.shape[2]))
                try:
                    best = choose(merged, each, aim, seed=seed, starts=2)
                except NotIdentifiable:
                    continue
                found.append(
                    replace(best, chosen=tuple(together[list(best.chosen)].ravel().tolist()))
                )
        return found

    def _visits_of_all(self, legs: IntArray, station: float) -> list[IntArray]:
        """Candidates at a station ``(k,)`` for each leg, of displacements that all legs allow."""
        visits = list(zip(self.pool.displacement_mm, self.pool.approach, strict=True))
        places = [(self.pool.leg == leg) & (self.pool.station == station) for leg in legs]
        of_legs = [np.flatnonzero(place) for place in places]
        common = set.intersection(*({visits[k] for k in one} for one in of_legs))
        return [np.array([k for k in one if visits[k] in common], np.intp) for one in of_legs]

    def coordinates(self, chosen: Sequence[int]) -> tuple[Coordinates, ...]:
        """Leg by leg, station by station, rising displacements."""
        pool = self.pool
        order = sorted(
            chosen,
            key=lambda k: (pool.leg[k], pool.station[k], pool.displacement_mm[k], pool.approach[k]),
        )
        return tuple(
            {
                "leg": LEG_NAMES[pool.leg[k]],
                "station": float(pool.station[k]),
                "displacement_mm": float(pool.displacement_mm[k]),
                "approach": "+" if pool.approach[k] > 0 else "-",
            }
            for k in order
        )

    def on_bound(self, chosen: Sequence[int]) -> int:
        """Displacements on a joint limit and stations at an end of their range."""
        picked = list(chosen)
        limits = (self.geometry.travel_min_mm, self.geometry.travel_max_mm)
        ends = (min(STATIONS), max(STATIONS))
        moved = np.isin(self.pool.displacement_mm[picked], limits).sum()
        return int(moved + np.isin(self.pool.station[picked], ends).sum())

    def moved(self, chosen: Sequence[int], aim: Aim) -> TripodPool:
        """The chosen ones alone, at displacements and stations that can be dialled."""
        noise_mm = self.planning.noise.standard_deviation_mm
        found = move_off_grid(self.geometry, self.pool, chosen, noise_mm, aim)
        return TripodPool(self.planning, found.pool)

    def orders(self, chosen: Sequence[int]) -> Orders:
        """Displacements to visit for each mounting (leg, station)."""
        grouped: dict[tuple[int, float], list[tuple[float, int]]] = {}
        for k in sorted(chosen, key=lambda k: self.pool.place[k]):
            visit = float(self.pool.displacement_mm[k]), int(self.pool.approach[k])
            grouped.setdefault(self.pool.places[self.pool.place[k]], []).append(visit)
        return {
            place: _two_levels(visiting_order(some, ends), ends)
            for place, some in grouped.items()
            for ends in [turning_mm(self.geometry, *place)]
        }

    def minutes(self, chosen: Sequence[int]) -> float:
        """Steps, with those where the way turns, and set-up of each mounting."""
        orders = self.orders(chosen)
        steps = sum(map(len, orders.values()))
        seconds = steps * self.planning.seconds_per_step
        return seconds / 60.0 + len(orders) * self.planning.minutes_per_mounting

    def reduced(self, chosen: Sequence[int]) -> IntArray | None:
        """Candidates of the mountings in use but for the one with the fewest postures."""
        used, counts = np.unique(self.pool.place[list(chosen)], return_counts=True)
        if len(used) < 2:
            return None
        kept = np.delete(used, counts.argmin())
        return np.flatnonzero(np.isin(self.pool.place, kept))


def _two_levels(levels: list[float], ends_mm: Pair) -> list[float]:
    """A mounting tells nothing from one displacement: Zero is read, too."""
    second = 0.0 if levels[0] else ends_mm[1] or ends_mm[0]
    return levels if len(set(levels)) > 1 else [*levels, second]
