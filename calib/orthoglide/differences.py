"""Averages of repeats and the differences between postures that they give."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.errors import NotIdentifiable
from calib.observations import LEG_NAMES, FloatArray, Observations
from calib.orthoglide.geometry import Geometry

PAIRS = ((0, 1), (1, 2), (0, 2))
"""Row blocks of papers/000 (11): pairs (x,y), (y,z), (x,z)."""


@dataclass(frozen=True, eq=False)
class Differences:
    """Differences between postures as one linear map of the readings.

    ``combine`` has shape ``(n_differences, n_readings)``: ``value_mm = combine @ readings``, and
    the same map turns a reading matrix into system (11) and a reading covariance into (14).
    ``names`` are ``axis_leg`` with ``+`` for Max, ``-`` for Min, both minus Zero; ``y_x`` alone is
    Max minus Min where Zero is missing; other displacements are written out, as in ``y_x@30.0``.
    """

    names: tuple[str, ...]
    combine: FloatArray
    value_mm: FloatArray

    def __len__(self) -> int:
        return len(self.names)

    @property
    def published_rows(self) -> NDArray[np.intp]:
        """Rows that the papers tabulate: Max and Min (or Max minus Min) at one station."""
        return np.array([k for k, name in enumerate(self.names) if "@" not in name], dtype=np.intp)


def differences(geometry: Geometry, observed: Observations) -> Differences:
    """Average the repeats of each mounting and subtract its reference posture.

    The reference is Zero where the mounting has it, else its lowest displacement. Several
    mountings of the same leg, axis and station are averaged with equal weight. Rows come in the
    order of papers/000 (11). Raises NotIdentifiable where no mounting has two postures.
    """
    rows: dict[tuple[float, ...], list[FloatArray]] = {}
    for mount in range(observed.mount_count):
        for key, row in _rows_of_mount(observed, mount):
            rows.setdefault(key, []).append(row)
    if not rows:
        raise NotIdentifiable(
            "differences between postures",
            f"{len(observed)} readings, each mounting in a single posture",
            "at least two postures for one mounting",
            "Measure Max and Min besides Zero without moving the stand.",
        )
    keys = sorted(rows, key=lambda key: _order_of_11(geometry, key))
    combine = np.array([np.mean(rows[key], axis=0) for key in keys])
    return Differences(tuple(_names(geometry, keys)), combine, combine @ observed.value_mm)


def _rows_of_mount(
    observed: Observations, mount: int
) -> Iterable[tuple[tuple[float, ...], FloatArray]]:
    """Key (leg, axis, station, displacement, reference) and row of each difference."""
    members = np.flatnonzero(observed.mount == mount)
    if not members.size:
        return
    levels = np.unique(observed.displacement_mm[members])
    reference = 0.0 if 0.0 in levels else float(levels[0])
    base = _mean_row(observed, members, reference)
    first = members[0]
    where = (int(observed.leg[first]), int(observed.axis[first]), float(observed.station[first]))
    for level in levels[levels != reference]:
        yield (
            (*where, float(level), reference),
            _mean_row(observed, members, float(level)) - base,
        )


def _mean_row(observed: Observations, members: NDArray[np.intp], level: float) -> FloatArray:
    """Weights that average one posture of one mounting, ``(n_readings,)``."""
    cell = members[observed.displacement_mm[members] == level]
    row = np.zeros(len(observed))
    row[cell] = observed.averaged[cell] / observed.averaged[cell].sum()
    return row


def _order_of_11(geometry: Geometry, key: tuple[float, ...]) -> tuple[float, ...]:
    leg, axis, station, level, _ = key
    pair = PAIRS.index((min(int(leg), int(axis)), max(int(leg), int(axis))))
    rank = {geometry.travel_max_mm: 0.0, geometry.travel_min_mm: 1.0}.get(level, 2.0)
    return (abs(station - 0.5), station, pair, rank, level, float(axis > leg))


def _names(geometry: Geometry, keys: list[tuple[float, ...]]) -> Iterable[str]:
    """Names in the order of the keys; the first station of a leg and axis keeps the short names."""
    stations: dict[tuple[float, float], float] = {}
    for leg, axis, station, level, reference in keys:
        short = f"{LEG_NAMES[int(axis)]}_{LEG_NAMES[int(leg)]}"
        at_station = (
            "" if stations.setdefault((leg, axis), station) == station else f"@s{station!r}"
        )
        if (level, reference) == (geometry.travel_max_mm, geometry.travel_min_mm):
            yield short + at_station
        elif reference == 0.0 and level in (geometry.travel_max_mm, geometry.travel_min_mm):
            yield short + ("+" if level > 0 else "-") + at_station
        else:
            from_reference = "" if reference == 0.0 else f"-({reference!r})"
            yield f"{short}@{level!r}{from_reference}{at_station}"
