"""Chosen postures of an Orthoglide moved off the grid that they were chosen from.

Displacements and stations move inside the cell of their grid point, so that postures stay as
distinct as they were chosen, and are rounded to what can be dialled before they are judged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.arrays import TINY, FloatArray, IntArray, numbered
from calib.design.criteria import Aim
from calib.design.refinement import Pull, judged, refine
from calib.tripod.pool import DIAL_DECIMALS, LegPool

STATION_DECIMALS = 2
"""A touched point is set to a hundredth of the leg: 3 mm on the prototype."""

LEAST_APART = 0.1
"""Share of the way between two grid points that stays free between their cells."""

SHARPNESS = (8.0, 64.0, 512.0)
"""Criteria of single singular values are made smooth, less and less."""

STEP_MM, STEP_STATION = 1e-2, 1e-4
"""For central differences of rows that are exact to rounding."""


def move_off_grid(
    grid: LegPool, subset: Sequence[int] | IntArray, noise_mm: float, aim: Aim
) -> LegPool:
    """Improve the chosen postures of the grid; never worse than there, joint limits and bars kept.

    Repeats stay repeats, and legs that are treated alike stay so. Raises NotIdentifiable where
    the chosen ones do not see all wanted parameters.
    """
    postures = grid.take(np.array(subset, dtype=np.intp))
    moves = _Moves.of(grid, postures)

    def rows_and_pull(coordinates: FloatArray) -> tuple[FloatArray, Pull]:
        rows = moves.at(coordinates).rows / noise_mm
        return rows, lambda weights: moves.pulled(coordinates, weights / noise_mm)

    refined = refine(rows_and_pull, moves.start, moves.lower, moves.upper, aim, sharpness=SHARPNESS)
    rounded = moves.at(moves.rounded(refined.coordinates))
    figures_before, figures_after = (
        judged(judged_postures.rows / noise_mm, aim) for judged_postures in (postures, rounded)
    )
    better = aim.criterion.better(figures_after, figures_before)
    better &= _different(rounded) == _different(postures)  # a short travel has few tenths
    on_bar = grid.geometry.on_bar(rounded.leg, rounded.station, rounded.displacement_mm)
    return rounded if better and on_bar.all() else postures


@dataclass(frozen=True, eq=False)
class _Moves:
    """Coordinates ``(c, 1)``: displacements in mm, then stations, each with a cell of its own.

    ``level`` and ``stand`` ``(n,)`` number the coordinates of each posture.
    """

    postures: LegPool
    level: IntArray
    stand: IntArray
    start: FloatArray
    lower: FloatArray
    upper: FloatArray
    level_count: int

    @staticmethod
    def of(grid: LegPool, postures: LegPool) -> _Moves:
        alike = _legs_alike(postures)
        legs = np.zeros_like(postures.leg) if alike else postures.leg
        level = numbered(legs, postures.station, postures.displacement_mm, postures.approach)
        stand = numbered(legs, postures.station)
        visit_first, stand_first = (
            np.unique(number, return_index=True)[1] for number in (level, stand)
        )
        levels, stations = postures.displacement_mm[visit_first], postures.station[stand_first]
        level_cells = _cells(np.unique(grid.displacement_mm), levels, DIAL_DECIMALS)
        station_cells = _cells(np.unique(grid.station), stations, STATION_DECIMALS)
        _keep_on_bars(postures, level, stand, level_cells, station_cells)
        cells = np.vstack([level_cells, station_cells])
        return _Moves(
            postures=postures,
            level=level,
            stand=stand + len(levels),
            start=np.concatenate([levels, stations])[:, None],
            lower=cells[:, :1],
            upper=cells[:, 1:],
            level_count=len(levels),
        )

    def at(self, coordinates: FloatArray, by_mm: float = 0.0, by_station: float = 0.0) -> LegPool:
        """The postures at coordinates, all displacements and stations shifted by so much."""
        flat = coordinates[:, 0]
        return self.postures.moved(flat[self.level] + by_mm, flat[self.stand] + by_station)

    def pulled(self, coordinates: FloatArray, weights: FloatArray) -> FloatArray:
        """Derivatives ``(c, 1)`` from those by the rows ``(n, 2, k)``."""
        slopes = np.zeros(len(coordinates))
        for column, mm, station in ((self.level, STEP_MM, 0.0), (self.stand, 0.0, STEP_STATION)):
            ahead, behind = (self.at(coordinates, s * mm, s * station).rows for s in (1.0, -1.0))
            by_posture = (weights * (ahead - behind)).sum(axis=(1, 2)) / (2.0 * (mm + station))
            slopes += np.bincount(column, by_posture, len(slopes))
        return slopes[:, None]

    def rounded(self, coordinates: FloatArray) -> FloatArray:
        """What can be dialled; a joint limit can, whatever its digits."""
        exact, stations = np.split(coordinates, [self.level_count])
        levels = np.round(exact, DIAL_DECIMALS) + 0.0  # no minus zero
        geometry = self.postures.geometry
        for limit in (geometry.travel_min_mm, geometry.travel_max_mm):
            levels[np.abs(exact - limit) < 0.5 * 10.0**-DIAL_DECIMALS] = limit
        return np.vstack([levels, np.round(stations, STATION_DECIMALS)])


def _keep_on_bars(
    postures: LegPool,
    level: IntArray,
    stand: IntArray,
    level_cells: FloatArray,
    station_cells: FloatArray,
) -> None:
    """Shrink cells ``(k, 2)`` until their worst corners touch usable parts, rounded as well.

    A touched point goes towards the foot as the station rises and the displacement falls.
    """
    geometry, station, displacement = (
        postures.geometry,
        postures.station,
        postures.displacement_mm,
    )
    touched = geometry.touched(postures.leg, station, displacement)
    covered = geometry.covered_mm[postures.leg]
    rounding = 0.5 * 10.0**-STATION_DECIMALS + 0.5 * 10.0**-DIAL_DECIMALS / covered
    for end, sign in ((0, -1.0), (1, 1.0)):
        edge = np.array(geometry.usable_bar)[postures.leg, end]
        by_station = sign * (station_cells[stand, end] - station)
        by_both = by_station + sign * (displacement - level_cells[level, 1 - end]) / covered
        room, room_at_zero = (sign * (edge - at) - rounding for at in (touched, station))
        shares = room / np.maximum(by_both, TINY), room_at_zero / np.maximum(by_station, TINY)
        share = np.clip(np.minimum(*shares), 1e-3, 1.0)  # of a cell; rounding undoes so little
        for number, cells, side, grid in (
            (level, level_cells, 1 - end, displacement),
            (stand, station_cells, end, station),
        ):
            least, middle = np.ones(len(cells)), np.empty(len(cells))
            np.minimum.at(least, number, share)
            middle[number] = grid
            cells[:, side] = middle + least * (cells[:, side] - middle)


def _legs_alike(postures: LegPool) -> bool:
    """Whether every leg that is used visits the same."""
    visit = numbered(postures.station, postures.displacement_mm, postures.approach)
    visits = [np.sort(visit[postures.leg == leg]) for leg in np.unique(postures.leg)]
    return all(np.array_equal(rows, visits[0]) for rows in visits)


def _different(postures: LegPool) -> int:
    """How many different visits there are."""
    return int(numbered(postures.place, postures.displacement_mm, postures.approach).max()) + 1


def _cells(grid: FloatArray, values: FloatArray, decimals: int) -> FloatArray:
    """Lower and upper end ``(n, 2)`` of the way each grid point has to itself.

    A single one stays: its cell is what is rounded to it.
    """
    if len(grid) < 2:
        return np.stack([values - 0.4 * 10.0**-decimals, values + 0.4 * 10.0**-decimals], axis=1)
    gaps = np.diff(grid)
    reach = (0.5 - LEAST_APART / 2.0) * gaps
    place = np.searchsorted(grid, values)
    below, above = np.append(0.0, reach)[place], np.append(reach, 0.0)[place]
    return np.stack([values - below, values + above], axis=1)
