"""Tables of distances between marks: a row for each distance that a person measured."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.errors import RecordError
from calib.tripod.geometry import Geometry
from protocols.documents import Triple, triple
from protocols.session import Distance
from protocols.table import FROM, TO, Row, rows_of_table

OFF_MM = 5.0
"""So far what was measured may be from what was commanded: a machine that is off by more was of no
use, and the distance is of other marks, or in another unit."""

LEAST_MM = 1e-4
"""Nothing is marked and measured better."""


@dataclass(frozen=True)
class MeasuredDistance:
    """A distance between two places of the tool, and where that stands, for messages."""

    from_mm: Triple
    to_mm: Triple
    value_mm: float
    text: str
    source: str
    deviation_mm: float | None = None


def distances_of_table(path: Path) -> tuple[MeasuredDistance, ...]:
    """The distances of a table. Raises RecordError naming line, column and value."""
    return tuple(_measured(row) for row in rows_of_table(path)[0])


def _measured(row: Row) -> MeasuredDistance:
    if "distance_mm" not in row.fields:
        raise RecordError(
            f"table {row.path}, header",
            ", ".join(row.fields),
            "columns " + ", ".join((*FROM, *TO, "distance_mm")),
            "Missing: distance_mm",
        )
    return MeasuredDistance(
        triple(map(row.number, FROM)),
        triple(map(row.number, TO)),
        row.number("distance_mm"),
        row.with_point("distance_mm"),
        f"table {row.path}, line {row.line}",
        row.optional("deviation_mm", row.number, None),
    )


def checked(
    measured: Sequence[MeasuredDistance], geometry: Geometry, deviation_mm: float | None = None
) -> tuple[Distance, ...]:
    """Lines of the record, numbered from 1; ``deviation_mm`` of those that state none.

    Raises RecordError for marks that the bars do not reach, two marks at one place, a distance that
    is none, or far from what was commanded.
    """
    # standard deviation of marking and measuring with a caliper, if nobody states another
    usual_mm = 0.05 if deviation_mm is None else deviation_mm
    return tuple(
        _checked(number, entry, geometry, usual_mm)
        for number, entry in enumerate(measured, start=1)
    )


def _checked(number: int, entry: MeasuredDistance, geometry: Geometry, usual_mm: float) -> Distance:
    for place in (entry.from_mm, entry.to_mm):
        if not (geometry.reach_mm2(np.array(place)) > 0.0).all():
            at = ", ".join(f"{value:g}" for value in place)
            raise RecordError(entry.source, f"a mark at ({at}) mm", "places that the bars reach")
    apart_mm = math.dist(entry.from_mm, entry.to_mm)
    if not (apart_mm > 0.0 < entry.value_mm and abs(entry.value_mm - apart_mm) <= OFF_MM):
        raise RecordError(
            entry.source,
            f"{entry.value_mm:g} mm between marks that were commanded {apart_mm:.6g} mm apart",
            f"two marks, and a distance within {OFF_MM:g} mm of that",
            "Is it in mm, and of these two marks? Measure it again, or take it out.",
        )
    deviation_mm = usual_mm if entry.deviation_mm is None else entry.deviation_mm
    if not LEAST_MM <= deviation_mm <= OFF_MM:
        raise RecordError(
            entry.source,
            f"a standard deviation of {deviation_mm:g} mm",
            f"{LEAST_MM:g} … {OFF_MM:g} mm, that of marking and measuring together",
        )
    return Distance(
        distance=number,
        from_mm=entry.from_mm,
        to_mm=entry.to_mm,
        value_mm=entry.value_mm,
        deviation_mm=deviation_mm,
        text=entry.text,
    )
