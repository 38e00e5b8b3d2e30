"""Averages of repeats and the differences between postures that they give."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from calib.arrays import (
    LEG_NAMES,
    TOOL,
    Conditions,
    FloatArray,
    IntArray,
    Observations,
    numbered,
    rows_of,
)
from calib.errors import NotIdentifiable
from calib.tripod.geometry import PARAMETER_NAMES, Geometry
from calib.tripod.pipeline import derivatives

MORE_PLACES = "Probe the middle and two rings of six places: glidecal plan --macro writes them."
"""What to do with contacts at few places."""

FEWEST_PLACES = 7
"""Of contacts, for what firmware fits: three switches, a radius, two angles, and the plate."""


def few_contacts(observations: Observations) -> bool:
    """Whether these are contacts, at so few places that more of them show more."""
    return bool(observations.contact.any()) and len(np.unique(observations.posture)) < FEWEST_PLACES


PAIRS = ((0, 1), (1, 2), (0, 2))
"""Row blocks of papers/000 (11): pairs (x,y), (y,z), (x,z)."""


Level = tuple[float, ...]
"""Displacement of a leg, or position of the tool."""

Key = tuple[int, int, float, bool, Level, Level]
"""Leg, axis, station, whether over a plane, level, level of the reference."""

CONTACT: Level = ()
"""In the place of the level of the reference: of contacts it is the mean."""

OVER_PLANE = "@p"
"""In the name of a difference, before the station."""

Terms = tuple[IntArray, FloatArray]
"""Rows of the readings and their weights in one difference."""


@dataclass(frozen=True, eq=False)
class Differences:
    """Differences between postures as one linear map of the readings.

    ``combine`` ``(n_differences, n_readings)`` is sparse: ``value_mm = combine @ readings``, and
    the same map turns a reading matrix into system (11) and a reading covariance into (14).
    ``names`` are ``axis_leg`` with ``+`` for Max, ``-`` for Min, both minus Zero; ``y_x`` alone is
    Max minus Min where Zero is missing; other displacements are written out, as in ``y_x@30.0``.
    Readings of the tool are named by axis and position, as in ``z(0, 30, 0)``. Contacts are named
    by their place across, as in ``z(0, 30)``: by so much the tool is higher there than commanded,
    less the mean of all places, which is ``beside_mm`` less than what the map gives. Over a plane
    it is the height at a station less that of the line through both ends of the leg at Zero, so
    that neither zero nor tilt are in it: ``z_x+@p0.1``.
    """

    names: tuple[str, ...]
    combine: csr_array
    value_mm: FloatArray
    beside_mm: FloatArray

    def of(self, readings_mm: FloatArray) -> FloatArray:
        """The differences ``(n_differences,)`` of readings ``(n_readings,)``."""
        return np.asarray(self.combine @ readings_mm - self.beside_mm)

    def __len__(self) -> int:
        return len(self.names)

    @property
    def published_rows(self) -> IntArray:
        """Rows that the papers tabulate: Max and Min (or Max minus Min) at one station.

        Those over a plane, which the papers only describe, are among them. Without any of these it
        is every displacement at one station.
        """
        numbers = list(enumerate(self.names))
        rows = [k for k, name in numbers if "@" not in name or OVER_PLANE in name]
        rows = rows or [k for k, name in numbers if "@s" not in name]
        return np.array(rows, dtype=np.intp)


def differences(geometry: Geometry, observations: Observations) -> Differences:
    """Average the repeats of each mounting and subtract its reference posture.

    The reference is Zero where the mounting has it, else its lowest displacement; that of contacts
    is the mean of their places. Several
    mountings of the same leg, axis and station are averaged with equal weight. Rows come in the
    order of papers/000 (11). Raises NotIdentifiable where no mounting has two postures.
    """
    terms: dict[Key, list[Terms]] = {}
    for members in observations.mountings:
        for key, terms_of_mount in _differences_of_mount(observations, members):
            terms.setdefault(key, []).append(terms_of_mount)
    if not terms:
        raise NotIdentifiable(
            "differences between postures",
            f"each mounting in a single posture, readings: {len(observations)}",
            "at least two postures for one mounting; over a plane two stations at Zero, too",
            MORE_PLACES
            if few_contacts(observations)
            else "Measure Max and Min besides Zero without moving the stand.",
        )
    keys = sorted(terms, key=lambda key: _order_of_11(geometry, key))
    combine = _matrix([terms[key] for key in keys], len(observations))
    rows = np.arange(len(observations))
    commanded = np.where(
        observations.contact, observations.position_mm[rows, observations.axis], 0.0
    )
    expected = combine @ commanded
    value_mm = combine @ observations.value_mm - expected
    return Differences(_unlike(_names(geometry, keys)), combine, value_mm, expected)


def _matrix(rows: list[list[Terms]], reading_count: int) -> csr_array:
    """One row for each list: the mean of its mountings' differences."""
    columns = [index for row in rows for index, _ in row]
    weights = [weight / len(row) for row in rows for _, weight in row]
    lengths = [sum(len(index) for index, _ in row) for row in rows]
    return csr_array(
        (
            np.concatenate(weights),
            (np.repeat(np.arange(len(rows)), lengths), np.concatenate(columns)),
        ),
        shape=(len(rows), reading_count),
    )


def _differences_of_mount(
    observations: Observations, members: IntArray
) -> Iterable[tuple[Key, Terms]]:
    """Key and terms of each difference to the mounting's reference posture.

    Of contacts it is the mean of all places: no place is the one that all others err by.
    """
    first = members[0]
    if observations.over_plane[first]:
        yield from _over_plane(observations, members)
        return
    leg, axis = int(observations.leg[first]), int(observations.axis[first])
    along = observations.position_mm if leg == TOOL else observations.displacement_mm[:, None]
    cells = [members[rows] for rows in rows_of(observations.level[members])]
    levels = [tuple(along[cell[0]].tolist()) for cell in cells]
    means = [_mean(observations, cell) for cell in cells]
    if observations.contact[first]:
        all_rows, weights = (np.concatenate(parts) for parts in zip(*means, strict=True))
        of_reference, reference = CONTACT, (all_rows, weights / len(cells))
    else:
        zeros = [k for k, cell in enumerate(cells) if observations.at_zero[cell[0]]]
        number = zeros[0] if zeros else 0
        of_reference, reference = levels[number], means[number]
    for level, (index, weight) in zip(levels, means, strict=True):
        if len(cells) > 1 and level != of_reference:
            terms = np.concatenate([index, reference[0]]), np.concatenate([weight, -reference[1]])
            yield (leg, axis, float(observations.station[first]), False, level, of_reference), terms


def _unlike(names: Iterable[str]) -> tuple[str, ...]:
    """The names, numbered where one comes again: two mountings met the plate at one place."""
    counts: Counter[str] = Counter()
    unlike = []
    for name in names:
        counts[name] += 1
        unlike.append(name if counts[name] == 1 else f"{name} {counts[name]}")
    return tuple(unlike)


def _over_plane(observations: Observations, members: IntArray) -> Iterable[tuple[Key, Terms]]:
    """Heights less those of the line through both ends of the leg at the reference."""
    place = numbered(observations.station[members], observations.displacement_mm[members])
    cells = [members[rows] for rows in rows_of(place)]
    level, station, along = (
        np.array([float(values[cell[0]]) for cell in cells])
        for values in (observations.displacement_mm, observations.station, observations.along_mm)
    )
    reference = 0.0 if 0.0 in level else float(level.min())
    at_reference = np.flatnonzero(level == reference)
    near, far = (int(at_reference[end]) for end in (0, -1))  # by station
    if near == far:
        return
    first = members[0]
    where = (int(observations.leg[first]), int(observations.axis[first]))
    for k in range(len(cells)):
        if k not in (near, far):
            share = (along[k] - along[near]) / (along[far] - along[near])
            weights = ((k, 1.0), (near, share - 1.0), (far, -share))
            means = [(_mean(observations, cells[j]), w) for j, w in weights]
            index = np.concatenate([rows for (rows, _), _ in means])
            weight = np.concatenate([w * mean for (_, mean), w in means])
            yield (
                (*where, float(station[k]), True, (float(level[k]),), (reference,)),
                (index, weight),
            )


def _mean(observations: Observations, cell: IntArray) -> Terms:
    """Rows and weights that average one posture of one mounting."""
    return cell, observations.averaged[cell] / observations.averaged[cell].sum()


def _order_of_11(geometry: Geometry, key: Key) -> tuple[float, ...]:
    leg, axis, station, over, levels, _ = key
    if leg == TOOL:
        return (2.0, float(axis), *levels)
    level = levels[0]
    pair = PAIRS.index((min(leg, axis), max(leg, axis)))
    rank = {geometry.travel_max_mm: 0.0, geometry.travel_min_mm: 1.0}.get(level, 2.0)
    return (float(over), abs(station - 0.5), station, pair, rank, level, float(axis > leg))


def _names(geometry: Geometry, keys: list[Key]) -> Iterable[str]:
    """Names in the order of the keys; the first station of a leg and axis keeps the short names."""
    stations: dict[tuple[int, int], float] = {}
    for leg, axis, station, over, (level, *levels_beside), of_reference in keys:
        if leg == TOOL:
            parts, decimals = [level, *levels_beside], 3
            if of_reference == CONTACT:  # as rings and firmware have them, however steps round
                parts, decimals = [v for k, v in enumerate(parts) if k != axis], 1
            place = ", ".join(f"{round(v, decimals) + 0.0:g}" for v in parts)
            yield f"{LEG_NAMES[axis]}({place})"
            continue
        (reference,) = of_reference
        short = f"{LEG_NAMES[axis]}_{LEG_NAMES[leg]}"
        at_station = f"{OVER_PLANE}{station!r}"
        if not over:
            first = stations.setdefault((leg, axis), station)
            at_station = "" if first == station else f"@s{station!r}"
        if (level, reference) == (geometry.travel_max_mm, geometry.travel_min_mm):
            yield short + at_station
        elif reference == 0.0 and level in (geometry.travel_max_mm, geometry.travel_min_mm):
            yield short + ("+" if level > 0 else "-") + at_station
        else:
            from_reference = "" if reference == 0.0 else f"-({reference!r})"
            yield f"{short}@{level!r}{from_reference}{at_station}"


def reading_matrix(geometry: Geometry, conditions: Conditions) -> FloatArray:
    """Derivatives of the readings by d_rho and d_L at the nominal machine, ``(n_readings, 6)``.

    A reading along axis j on leg i: ``b d_rho_i + a d_rho_j - b d_L_i - c d_L_j`` with a, b, c of
    papers/000 equation (11) and ``sin(alpha) = displacement / L``. The paper touches the middle of
    the leg; for a station s the weight of the tool end is 1 - s in place of 0.5. A row at Zero
    is zero; a difference of readings is the difference of rows, so system (11) is
    ``Differences.combine @ reading_matrix``. First order: the exact model departs from it by
    several micrometres at offsets of 2 mm. Other tripods, readings of the tool and those over a
    plane have no such form: there it is the derivative of the pipeline.
    """
    if not geometry.of_papers or TOOL in conditions.leg or conditions.over_plane.any():
        return derivatives(geometry, np.zeros(len(PARAMETER_NAMES)), conditions)
    sine, weight = conditions.displacement_mm / geometry.leg_length_mm[0], 1.0 - conditions.station
    cosine = np.sqrt(1.0 - sine**2)
    b = (weight + sine) * sine / cosine
    c = (weight + sine) / cosine - weight
    rows = np.arange(len(conditions))
    matrix = np.zeros((len(conditions), 6))
    matrix[rows, conditions.leg] = b
    matrix[rows, conditions.axis] = sine
    matrix[rows, 3 + conditions.leg] = -b
    matrix[rows, 3 + conditions.axis] = -c
    return matrix
