"""What readings see of the six parameters, what a procedure sees, and what would help it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.arrays import (
    LEG_NAMES,
    TOUCHED_NAMES,
    Conditions,
    FloatArray,
    Observations,
    conditions,
    largest,
    set_up_unknowns,
    without_zeros,
)
from calib.design.criteria import covariances_after, inverse
from calib.design.identifiability import AddedMeasurement, Examination, Sensitivity
from calib.noise.reading import Noise, reading_weights, visit_means
from calib.tripod.geometry import PARAMETER_NAMES, TOLERANCE_MM, Geometry
from calib.tripod.pipeline import derivatives
from calib.tripod.pool import ACROSS, FREE, PARAMETERS, STATIONS, LegPool, leg_pool
from calib.tripod.workspace import workspace_jacobian

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
        visits, weight, design = self._readings()
        axes = zip(visits.axis, visits.leg, strict=True)
        names = [f"{LEG_NAMES[axis]}_{TOUCHED_NAMES[leg]}" for axis, leg in axes]
        return Examination(
            procedure=self.procedure,
            sensitivity=sensitivity_of_readings(
                self.geometry, visits, weight, design, FREE, noise_known=True
            ),
            bare=without_zeros(visits, np.ones(len(visits)), design),
            measured=tuple(dict.fromkeys(names)),
            posture_count=self.step_count,
            independent_count=int(visits.posture.max()) + 1 - set_up_unknowns(visits),
            minutes=self.minutes(self.step_count, self.mounting_count),
            units="readings and parameters in mm",
            noise_words=self.noise_words,
        )

    def _readings(self) -> tuple[Observations, FloatArray, FloatArray]:
        """What counts of the procedure, weights in 1/mm², derivatives at the nominal machine."""
        visits = visit_means(self.planned)
        design = derivatives(self.geometry, np.zeros(PARAMETERS), visits)
        return visits, reading_weights(visits, self.noise), design

    def minutes(self, steps: int, mountings: int) -> float:
        """Minutes of so many steps, and of setting up so often."""
        return steps * self.seconds_per_step / 60.0 + mountings * self.minutes_per_mounting

    def added(self, vectors: Sequence[FloatArray]) -> tuple[AddedMeasurement | None, ...]:
        """The best one of a level added to a mounting, or a new mounting read there and at Zero.

        None where nothing helps, and where the tool is read: no more positions show what one set-up
        cannot. Nor is one looked for beside readings over a plane.
        """
        if self.of_tool or self.planned.over_plane.any():
            return (None,) * len(vectors)
        stations = tuple(dict.fromkeys([*self.stations, *STATIONS]))
        pool = leg_pool(self.geometry, stations=stations, both_ways=False)
        visits, weight, design = self._readings()
        prior = np.full(pool.rows.shape[2], ZERO_SPREAD_MM**-2.0)
        prior[:PARAMETERS] = TOLERANCE_MM**-2.0
        covariance = inverse(_information(design, weight, visits, pool) + np.diag(prior))
        places = {(int(leg), float(s)) for leg, s in zip(visits.leg, visits.station, strict=True)}
        mounted = np.array([pool.places[p] in places for p in pool.place], dtype=np.bool_)
        zero = np.array(
            [pool.index(int(i), 0.0, float(s)) for i, s in zip(pool.leg, pool.station, strict=True)]
        )
        # two readings of a new mounting, its own zero fitted: their difference
        alone = (pool.rows - pool.rows[zero]) / math.sqrt(2.0)
        rows = np.where(mounted[:, None, None], pool.rows, alone) / self.noise.standard_deviation_mm
        covariances = covariances_after(covariance, rows, np.ones(2), list(FREE))

        def best_for(vector: FloatArray) -> AddedMeasurement | None:
            now = float(vector @ covariance[:PARAMETERS, :PARAMETERS] @ vector)
            variance = np.einsum("i,bij,j->b", vector, covariances, vector)
            best = largest(-variance)
            if variance[best] > (1.0 - LEAST_GAIN) * now:
                return None
            where = f"leg {LEG_NAMES[pool.leg[best]]} at {pool.displacement_mm[best]:+g} mm"
            station = f"station {pool.station[best]:g}"
            if not mounted[best]:
                where, station = f"{where} and at Zero", f"{station}, a new mounting"
            return AddedMeasurement(f"{where} ({station})", float(np.sqrt(variance[best])))

        return tuple(map(best_for, vectors))


LEAST_GAIN = 1e-6
"""Of a variance: readings that lower it by less do not see this combination at all."""


def _information(
    design: FloatArray, weight: FloatArray, conditions: Conditions, pool: LegPool
) -> FloatArray:
    """Information ``(6 + n_zeros, ...)`` of readings that stand at places of the pool.

    ``design`` ``(n_readings, 6)`` in mm per mm, ``weight`` ``(n_readings,)`` in 1/mm². Readings
    share the zero of the pool's mounting at their leg, station and axis.
    """
    number = {place: k for k, place in enumerate(pool.places)}
    rows = np.zeros((len(conditions), pool.rows.shape[2]))
    rows[:, :PARAMETERS] = design
    place = [
        number[int(leg), float(s)]
        for leg, s in zip(conditions.leg, conditions.station, strict=True)
    ]
    second = ACROSS[conditions.leg, 1] == conditions.axis
    rows[np.arange(len(conditions)), PARAMETERS + 2 * np.array(place) + second] = 1.0
    return np.asarray((rows.T * weight) @ rows)


def tool_metric(geometry: Geometry) -> FloatArray:
    """Mean square movement of the tool over the workspace ``(6, 6)``, mm² per mm²."""
    jacobian = workspace_jacobian(geometry)
    return np.asarray(np.einsum("pij,pik->jk", jacobian, jacobian) / len(jacobian))


WAY_POINTS = 17
"""Of the way that an indicator follows between the ends of its displacements."""


def excursion_mm(
    geometry: Geometry,
    tolerance_mm: FloatArray,
    mounting: tuple[int, int],
    places: Sequence[tuple[float, float]],
    tilt_mrad: float | None = None,
) -> float:
    """How far a spindle moves in one set-up, between displacements (mm) with their stations.

    ``mounting`` is the leg and the axis. Two standard deviations of the largest difference, where
    base parameters are off by ``tolerance_mm`` ``(6,)``; nominally readings never change. From Zero
    over all levels and the way between them; of a stand that slides on a plane, which leans by
    ``tilt_mrad`` at most, in the postures alone.
    """
    leg, axis = mounting
    at_mm, station = (np.array(column) for column in zip(*places, strict=True))
    if tilt_mrad is None:
        at_mm = np.append(np.linspace(at_mm.min(), at_mm.max(), WAY_POINTS), 0.0)
        station = np.full(len(at_mm), station[0])
    count, along = len(at_mm), at_mm + station * geometry.covered_mm[leg]
    planned = conditions([leg] * count, [axis] * count, at_mm.tolist(), station=station.tolist())
    if tilt_mrad is not None:
        planned = replace(planned, along_mm=along)
    moved = derivatives(geometry, np.zeros(PARAMETERS), planned) * tolerance_mm
    moved = np.hstack([moved, 1e-3 * (tilt_mrad or 0.0) / 2.0 * along[:, None]])
    return 2.0 * float(np.linalg.norm(moved[:, None] - moved, axis=-1).max())


def sensitivity_of_readings(
    geometry: Geometry,
    observations: Observations,
    weight: FloatArray,
    design: FloatArray,
    free: tuple[int, ...],
    *,
    noise_known: bool,
) -> Sensitivity:
    """Readings with a free zero for each mounting; ``design`` ``(n_readings, k)``.

    ``weight`` ``(n_readings,)`` in 1/mm² holds the noise, or none where it is not known.
    """
    jacobian = np.sqrt(weight)[:, None] * without_zeros(observations, weight, design)
    tool = workspace_jacobian(geometry)[:, :, list(free)]
    return Sensitivity(
        names=tuple(PARAMETER_NAMES[k] for k in free),
        jacobian=jacobian,
        tolerance=np.full(len(free), TOLERANCE_MM),
        cost=tool.reshape(-1, len(free)),
        points=len(tool),
        noise_known=noise_known,
    )
