"""The side of machines with three drives of `app.planning`: procedures, candidates, files."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.measuring.simulated import planned_readings
from app.planning.machines import Coordinates, Cure, Examined, Request
from calib.design.criteria import Aim, covariances_after, inverse
from calib.design.exchange import Candidates, Choice, choose
from calib.errors import NotIdentifiable
from calib.identify.fit import without_zeros
from calib.identify.identify import sensitivity_of_readings
from calib.noise.reading import IndicatorFigures, Noise, reading_weights, visits
from calib.observations import LEG_NAMES, TOUCHED_NAMES, FloatArray, IntArray, Observations
from calib.ties import largest
from calib.tripod.geometry import TOLERANCE_MM, Geometry
from calib.tripod.leg_refinement import move_off_grid
from calib.tripod.pipeline import derivatives
from calib.tripod.pool import (
    PARAMETERS,
    STATIONS,
    LegPool,
    information_with_zeros,
    leg_pool,
    visiting_order,
)
from calib.tripod.workspace import workspace_jacobian
from protocols.errors import UsageError
from protocols.machine import Machine, load_machine
from protocols.procedure import Procedure, load_procedure

PROTOTYPE_NOISE_MM = 0.02
"""Repeatability of the papers' indicators; serves where nothing is stated."""

ZERO_SPREAD_MM = 1000.0
"""Nothing is known of the zero of a mounting: its standard deviation before the first reading."""

FREE = tuple(range(PARAMETERS))


def tool_metric(geometry: Geometry) -> FloatArray:
    """Mean square movement of the tool over the workspace ``(6, 6)``, mm² per mm²."""
    jacobian = workspace_jacobian(geometry)
    return np.asarray(np.einsum("pij,pik->jk", jacobian, jacobian) / len(jacobian))


def stated_noise(machine: Machine, noise_mm: float | None) -> tuple[Noise, str]:
    """Noise of single readings and where it is from. Raises UsageError where it is not positive."""
    figures = IndicatorFigures(repeatability_mm=noise_mm)
    words = "as asked for"
    if noise_mm is None:
        worst = [
            max((float(v) for v in values if v is not None), default=None)
            for values in zip(
                *((i.resolution_mm, i.repeatability_mm) for i in machine.indicator), strict=True
            )
        ] or [None, None]
        figures, words = IndicatorFigures(worst[0], worst[1]), "of the machine file's indicators"
        if figures.noise() is None:
            figures = IndicatorFigures(repeatability_mm=PROTOTYPE_NOISE_MM)
            words = "that of the papers' indicators"
    noise = figures.noise(2)
    if noise is None:
        raise UsageError("--noise", f"{noise_mm:g} mm", "a positive length in mm")
    return noise, f"{noise.standard_deviation_mm:.4g} mm, {words}"


@dataclass(frozen=True, eq=False)
class OrthoglidePlanning:
    """A machine file, a procedure and a noise."""

    name: str
    machine: Machine
    procedure: Procedure
    noise: Noise
    noise_words: str
    minutes_per_mounting: float

    @classmethod
    def of(cls, name: str, request: Request) -> OrthoglidePlanning:
        """From names and paths. Raises UsageError and RecordError."""
        machine = load_machine(request.machine_file or name)
        wanted = request.procedure or machine.usual_procedure
        procedure = load_procedure(wanted, machine.geometry())
        noise, words = stated_noise(machine, request.noise_mm)
        return cls(name, machine, procedure, noise, words, request.minutes_per_mounting)

    def examine(self) -> Examined:
        """Readings of the procedure with a free zero for each mounting."""
        geometry = self.machine.geometry()
        visited, weight, design = self._readings()
        steps = self.procedure.steps(geometry)
        axes = zip(visited.axis, visited.leg, strict=True)
        names = [f"{LEG_NAMES[axis]}_{TOUCHED_NAMES[leg]}" for axis, leg in axes]
        mountings = len({step.place for step in steps})
        minutes = self.procedure.duration_s(geometry) / 60.0
        return Examined(
            procedure=self.procedure.name,
            sensitivity=sensitivity_of_readings(
                geometry, visited, weight, design, FREE, noise_known=True
            ),
            bare=without_zeros(visited, np.ones(len(visited)), design),
            measured=tuple(dict.fromkeys(names)),
            posture_count=len(steps),
            independent_count=int(visited.posture.max()) + 1 - visited.mount_count,
            minutes=minutes + mountings * self.minutes_per_mounting,
            units="readings and parameters in mm",
            noise_words=self.noise_words,
        )

    def _readings(self) -> tuple[Observations, FloatArray, FloatArray]:
        """What counts of the procedure, weights in 1/mm², derivatives at the nominal machine."""
        visited = visits(planned_readings(self.procedure, self.machine))
        design = derivatives(self.machine.geometry(), np.zeros(PARAMETERS), visited)
        return visited, reading_weights(visited, self.noise), design

    def pool(self) -> OrthoglidePool:
        """All legs, displacements, sides of approach and stations.

        Raises UsageError where the tool is read instead.
        """
        if self.procedure.plate is not None:
            raise UsageError(
                f"optimum postures with {self.procedure.name}",
                "readings of the tool against a plate",
                "a procedure that reads legs",
            )
        pool = leg_pool(self.machine.geometry())
        return OrthoglidePool(self, pool)

    def metric(self) -> FloatArray:
        """Mean square of the tool's movement over the workspace."""
        return tool_metric(self.machine.geometry())

    def cures(self, vectors: Sequence[FloatArray]) -> tuple[Cure | None, ...]:
        """The best one of a level added to a mounting, or a new mounting read there and at Zero.

        None where the tool is read: no more positions show what one set-up cannot.
        """
        if self.procedure.plate is not None:
            return (None,) * len(vectors)
        stations = tuple(dict.fromkeys([*self.procedure.stations, *STATIONS]))
        pool = leg_pool(self.machine.geometry(), stations=stations, both_ways=False)
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
    ) -> Cure:
        variance = np.einsum("i,bij,j->b", vector, after, vector)
        best = largest(-variance)
        where = f"leg {LEG_NAMES[pool.leg[best]]} at {pool.displacement_mm[best]:+g} mm"
        station = f"station {pool.station[best]:g}"
        if not mounted[best]:
            where, station = f"{where} and at Zero", f"{station}, a new mounting"
        return Cure(f"{where} ({station})", float(np.sqrt(variance[best])))


@dataclass(frozen=True, eq=False)
class OrthoglidePool:
    """Candidates of the method that observes the legs, with their time and their files."""

    planning: OrthoglidePlanning
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
        """Of the machine file."""
        return self.planning.machine.geometry()

    def take(self, kept: IntArray) -> OrthoglidePool:
        """Only these candidates."""
        return OrthoglidePool(self.planning, self.pool.take(kept))

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
            members = [
                np.flatnonzero((self.pool.leg == leg) & (self.pool.station == station))
                for leg in legs
            ]
            if len({len(some) for some in members}) == 1 and each <= len(members[0]):
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

    def moved(self, chosen: Sequence[int], aim: Aim) -> OrthoglidePool:
        """The chosen ones alone, at displacements and stations that can be dialled."""
        noise_mm = self.planning.noise.standard_deviation_mm
        found = move_off_grid(self.geometry, self.pool, chosen, noise_mm, aim)
        return OrthoglidePool(self.planning, found.pool)

    def orders(self, chosen: Sequence[int]) -> dict[tuple[int, float], list[float]]:
        """Displacements to visit for each mounting (leg, station)."""
        grouped: dict[tuple[int, float], list[tuple[float, int]]] = {}
        for k in sorted(chosen, key=lambda k: self.pool.place[k]):
            visit = float(self.pool.displacement_mm[k]), int(self.pool.approach[k])
            grouped.setdefault(self.pool.places[self.pool.place[k]], []).append(visit)
        return {
            place: _two_levels(visiting_order(some, self.geometry), self.geometry)
            for place, some in grouped.items()
        }

    def minutes(self, chosen: Sequence[int]) -> float:
        """Steps, with those where the way turns, and set-up of each mounting."""
        orders = self.orders(chosen)
        steps = sum(map(len, orders.values()))
        seconds = steps * self.planning.procedure.seconds_per_step
        return seconds / 60.0 + len(orders) * self.planning.minutes_per_mounting

    def reduced(self, chosen: Sequence[int]) -> IntArray | None:
        """Candidates of the mountings in use but for the one with the fewest postures."""
        used, counts = np.unique(self.pool.place[list(chosen)], return_counts=True)
        if len(used) < 2:
            return None
        kept = np.delete(used, counts.argmin())
        return np.flatnonzero(np.isin(self.pool.place, kept))

    def files(self, chosen: Sequence[int]) -> dict[str, str]:
        """One procedure where all mountings visit the same displacements, else one for each."""
        orders = self.orders(chosen)
        legs = sorted({leg for leg, _ in orders})
        stations = sorted({station for _, station in orders})
        first = next(iter(orders.values()))
        if len(orders) == len(legs) * len(stations) and all(
            order == first for order in orders.values()
        ):
            return {"": self._toml("optimum", legs, stations, first)}
        return {
            f"-{LEG_NAMES[leg]}-{station:g}": self._toml(
                f"optimum-{LEG_NAMES[leg]}", [leg], [station], order
            )
            for (leg, station), order in orders.items()
        }

    def _toml(
        self, name: str, legs: Sequence[int], stations: Sequence[float], levels: Sequence[float]
    ) -> str:
        like = self.planning.procedure
        listed = ", ".join(f'"{LEG_NAMES[leg]}"' for leg in legs)
        return "\n".join(
            [
                'schema = "glidecal.procedure/1"',
                f'name = "{name}"',
                'title = "Optimum postures, made by glidecal postures"',
                f"legs = [{listed}]",
                f"stations = [{', '.join(map(repr, stations))}]",
                "cycles = 1",
                f"levels = [{', '.join(map(repr, levels))}]",
                "return_to_zero = false  # the postures were chosen without it",
                f"seconds_per_step = {like.seconds_per_step!r}",
                'order = "fixed"  # each level is reached from the side that was chosen',
                f"window_s = {like.window_s!r}",
                f"tolerance_mm = {like.tolerance_mm!r}",
                f"repeat_limit_mm = {like.repeat_limit_mm!r}",
                "",
            ]
        )


def _two_levels(levels: list[float], geometry: Geometry) -> list[float]:
    """A mounting tells nothing from one displacement: Zero is read, too."""
    return (
        levels if len(set(levels)) > 1 else [*levels, 0.0 if levels[0] else geometry.travel_max_mm]
    )
