"""What an indicator read over the travel of its leg, what a model makes of it, and what is left."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from calib.arrays import TOOL, FloatArray, IntArray, Observations, numbered, rows_of
from calib.noise.reading import visit_starts
from calib.tripod.pipeline import Model

STEPS = 48
"""Places at which the model is drawn between the ends of the travel."""

ALIKE_MM = 1e-6
"""A model that differs by less is drawn once for both directions of approach."""


@dataclass(frozen=True, eq=False)
class LegCurve:
    """Visits of one leg, read along one axis at one ``station``, in the order of time.

    ``at_mm`` ``(n,)`` is the displacement from Zero, over a plane the place along the leg, of the
    tool the number of its position. ``value_mm`` ``(n,)`` are readings less what the model has at
    Zero, ``left_mm`` ``(n,)`` what the model leaves of them. ``approach`` ``(n,)`` is that of the
    `Conditions`, ``mount`` ``(n,)`` numbers the mountings. ``model_mm`` are lines ``(m, 2)`` of
    places and of what the model has there.
    """

    leg: int
    axis: int
    station: float
    over_plane: bool
    at_mm: FloatArray
    value_mm: FloatArray
    left_mm: FloatArray
    approach: FloatArray
    mount: IntArray
    model_mm: tuple[FloatArray, ...]

    @property
    def first(self) -> IntArray:
        """The first visit of each mounting, by its row."""
        return np.asarray(np.unique(self.mount, return_index=True)[1])


def leg_curves(model: Model, observations: Observations, left_mm: FloatArray) -> list[LegCurve]:
    """A curve for each leg, axis and station that ``observed`` has.

    ``left_mm`` ``(n_visits,)`` is what the fitted model leaves of each visit. Several mountings and
    sessions share a curve, each about a zero of its own.
    """
    visits = observations.take(visit_starts(observations))
    points_mm = model.readings(visits) + left_mm
    plane = visits.over_plane
    if plane.any():  # their mountings have a tilt, too, which is in what is left
        fitted = visits.value_mm - left_mm
        mean = np.bincount(visits.mount, fitted) / np.bincount(visits.mount)
        points_mm = np.where(plane, visits.value_mm - mean[visits.mount], points_mm)
    station = np.where(plane, 0.0, visits.station)
    groups = rows_of(numbered(visits.leg, visits.axis, plane, station))
    return [_curve(model, visits.take(rows), points_mm[rows], left_mm[rows]) for rows in groups]


def _curve(
    model: Model, visits: Observations, value_mm: FloatArray, left_mm: FloatArray
) -> LegCurve:
    """The curve of readings of one leg, axis and station."""
    plane = bool(visits.over_plane[0])
    if visits.leg[0] == TOOL or plane:
        at = np.asarray(visits.along_mm if plane else 1.0 + visits.level, dtype=np.float64)
        lines = tuple(_joined(at, value_mm - left_mm, visits, plane=plane))
    else:
        at, level_mm = visits.displacement_mm, 0.0
        drawn_lines = _drawn(model, visits)
        level_mm = float(np.mean([np.interp(0.0, *line.T) for line in drawn_lines]))
        value_mm = value_mm - level_mm
        lines = tuple(line - [0.0, level_mm] for line in drawn_lines)
    return LegCurve(
        leg=int(visits.leg[0]),
        axis=int(visits.axis[0]),
        station=float(visits.station[0]),
        over_plane=plane,
        at_mm=at,
        value_mm=value_mm,
        left_mm=left_mm,
        approach=visits.approach,
        mount=visits.mount,
        model_mm=lines,
    )


def _drawn(model: Model, visits: Observations) -> list[FloatArray]:
    """The model over the travel, once for each direction of approach where these differ."""
    places = np.linspace(visits.displacement_mm.min(), visits.displacement_mm.max(), STEPS + 1)
    middle = np.argsort(visits.time_s, kind="stable")[len(visits) // 2]
    between = visits.take(np.full(len(places), middle))
    lines: list[FloatArray] = []
    for approach in (1.0, -1.0):
        way = replace(between, displacement_mm=places, approach=np.full(len(places), approach))
        lines.append(np.column_stack([places, model.readings(way)]))
    alike = np.abs(lines[0] - lines[1]).max() < ALIKE_MM
    return lines[:1] if alike else lines


def _joined(
    at: FloatArray, fitted_mm: FloatArray, visits: Observations, *, plane: bool
) -> Iterator[FloatArray]:
    """Fitted values ``(n,)`` of each posture over a plane, or of all positions of the tool."""
    for rows in rows_of(numbered(visits.displacement_mm)) if plane else [np.arange(len(at))]:
        places = numbered(at[rows])
        means = [np.bincount(places, values[rows]) for values in (at, fitted_mm)]
        yield np.column_stack([total / np.bincount(places) for total in means])
