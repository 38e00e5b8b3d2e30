"""Labels that may be exchanged in a table of readings: values that belong to other rows of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from calib.arrays import (
    LEG_NAMES,
    TOUCHED_LETTERS,
    FloatArray,
    IntArray,
    Observations,
    numbered,
    rows_of,
)

UNITS = {
    "inch recorded as mm": 25.4,
    "mm recorded as inch": 1.0 / 25.4,
    "µm recorded as mm": 0.001,
}
"""What to multiply a recorded value by, mm a unit."""

MANY = 16
"""Of cycles of more visits only neighbours are tried as exchanged, of more postures none."""

LEGS = (0, 1, 2)


@dataclass(frozen=True, eq=False)
class LabelExchange:
    """Values of rows ``here`` and ``there`` that belong to each other, times a factor.

    Both are the same rows where only the factor is wrong: a sign or a unit.
    """

    id: str
    where: str
    title: str
    here: IntArray
    there: IntArray
    factor: float = 1.0

    def put_right(self, value_mm: FloatArray) -> FloatArray:
        """The values ``(n,)`` where they belong."""
        right = value_mm.copy()
        right[self.here] = self.factor * value_mm[self.there]
        right[self.there] = self.factor * value_mm[self.here]
        return right

    def source(self, count: int) -> IntArray:
        """The visit ``(count,)`` at which the value of each was written."""
        source = np.arange(count, dtype=np.intp)
        source[self.here], source[self.there] = self.there, self.here
        return source

    def words(self, visits: Observations) -> str:
        """The title, of postures with their displacements."""
        if self.id != "postures_exchanged":
            return self.title
        postures = (visits.posture_words(int(rows[0])) for rows in (self.here, self.there))
        return f"{' and '.join(postures)} exchanged in {self.title}"


def exchanges(visits: Observations) -> Iterator[LabelExchange]:
    """Every exchange of labels: of indicators, tables, legs; sign and unit; postures, the most."""
    yield from _tables(visits)
    for where, rows in _groups(visits):
        yield LabelExchange("gauge_sign", where, "sign reversed", rows, rows, -1.0)
        for title, factor in UNITS.items():
            yield LabelExchange("unit_mixup", where, title, rows, rows, factor)
    yield from _postures(visits)


def place_of(visits: Observations, row: int) -> str:
    """Leg (or ``t``, the tool) and axis of a row, in letters."""
    return TOUCHED_LETTERS[visits.leg[row]] + LEG_NAMES[visits.axis[row]]


def _groups(visits: Observations) -> list[tuple[str, IntArray]]:
    """Rows that one indicator may have taken, or that one table has."""
    axes, legs = rows_of(numbered(visits.axis)), rows_of(numbered(visits.leg))
    groups = [(f"along {LEG_NAMES[visits.axis[rows[0]]]}", rows) for rows in axes]
    groups += [(TOUCHED_LETTERS[visits.leg[rows[0]]], rows) for rows in legs]
    indicators = enumerate(rows_of(visits.indicator), start=1)
    groups += [(f"indicator {number}", rows) for number, rows in indicators]
    places = [*rows_of(numbered(visits.leg, visits.axis)), *visits.mountings]
    groups += [(place_of(visits, int(rows[0])), rows) for rows in places]
    by_rows = {tuple(rows.tolist()): (where, rows) for where, rows in groups}
    # all signs reversed are all parameters reversed: no leg reading tells them apart
    return [group for key, group in by_rows.items() if len(key) < len(visits)]


def _tables(visits: Observations) -> Iterator[LabelExchange]:
    """Tables of a leg and axis exchanged: two of a leg, of two legs, or all of two legs."""
    stations = np.unique(visits.station[visits.leg >= 0]).tolist()
    sets = [[station] for station in stations] + ([stations] if len(stations) > 1 else [])
    for alike in sets:
        at_station = np.isin(visits.station, alike) & ~visits.over_plane
        at = "" if len(alike) == len(stations) else f" at station {alike[0]:g}"
        tables = {
            (leg, axis): np.flatnonzero(at_station & (visits.leg == leg) & (visits.axis == axis))
            for leg, axis in product(LEGS, LEGS)
            if leg != axis
        }
        for place, rival in combinations(tables, 2):
            pair = _matched(visits, tables[place], tables[rival])
            names = [LEG_NAMES[leg] + LEG_NAMES[axis] for leg, axis in (place, rival)]
            if pair and place[0] == rival[0]:
                title = f"indicators exchanged{at}"
                yield LabelExchange("gauge_swap", LEG_NAMES[place[0]], title, *pair)
            elif pair:
                title = f"the two tables exchanged{at}"
                yield LabelExchange("tables_exchanged", ",".join(names), title, *pair)
        for (a, b), crossed in product(combinations(LEGS, 2), (False, True)):
            third = 3 - a - b
            axes = (third, a) if crossed else (a, third)
            first = _matched(visits, tables[a, b], tables[b, axes[0]])
            second = _matched(visits, tables[a, third], tables[b, axes[1]])
            if first and second:
                here, there_too = (np.concatenate(rows) for rows in zip(first, second, strict=True))
                title = f"the tables of both legs exchanged{at}"
                title += ", with the axes crossed" if crossed else ""
                where = f"{LEG_NAMES[a]},{LEG_NAMES[b]}"
                yield LabelExchange("legs_exchanged", where, title, here, there_too)


def _matched(
    visits: Observations, first_rows: IntArray, second_rows: IntArray
) -> tuple[IntArray, IntArray] | None:
    """Rows of two tables with the same postures in the same cycles; None where these differ."""
    if not len(first_rows) or len(first_rows) != len(second_rows):
        return None
    first, second = (
        rows[np.lexsort((visits.level[rows], visits.cycle[rows]))]
        for rows in (first_rows, second_rows)
    )
    matched = all(np.array_equal(key[first], key[second]) for key in (visits.cycle, visits.level))
    return (first, second) if matched else None


def _postures(visits: Observations) -> Iterator[LabelExchange]:
    """Two visits or postures of a cycle, or of all cycles, of an indicator or of a whole leg."""
    for stand in rows_of(numbered(visits.leg, visits.station, visits.over_plane)):
        mountings = [stand[rows] for rows in rows_of(numbered(visits.mount[stand]))]
        sets = [[rows] for rows in mountings]
        if len(mountings) > 1 and len({len(rows) for rows in mountings}) == 1:
            sets.append(mountings)
        pairs = _pairs(visits.cycle[mountings[0]], visits.level[mountings[0]])
        for members in sets:
            where = place_of(visits, int(members[0][0]))[: 2 if len(members) == 1 else 1]
            count = len(members[0])
            for (here, partners), when in pairs.items():
                if max(*here, *partners) < count:
                    first, second = (
                        np.concatenate([rows[list(places)] for rows in members])
                        for places in (here, partners)
                    )
                    yield LabelExchange("postures_exchanged", where, when, first, second)


Places = tuple[int, ...]


def _pairs(cycle: IntArray, level: IntArray) -> dict[tuple[Places, Places], str]:
    """Places in a mounting whose values may be exchanged, and when."""
    cycles = {
        f"cycle {number}": np.flatnonzero(cycle == number) for number in np.unique(cycle).tolist()
    }
    pairs: dict[tuple[Places, Places], str] = {}
    for when, rows in cycles.items():
        near = 1 if len(rows) > MANY else len(rows)
        for i, j in combinations(range(len(rows)), 2):
            if j - i <= near and level[rows[i]] != level[rows[j]]:
                pairs[(int(rows[i]),), (int(rows[j]),)] = when
    levels = np.unique(level).tolist()
    level_pairs = combinations(levels if len(levels) <= MANY else [], 2)
    for (first, second), last in product(level_pairs, (False, True)):
        places_by_time = {
            when: _paired(rows, level[rows], first, second, last) for when, rows in cycles.items()
        }
        here, partners = (
            tuple(i for pair in places_by_time.values() for i in pair[side]) for side in range(2)
        )
        for when, pair in {**places_by_time, "all cycles": (here, partners)}.items():
            if pair[0]:
                pairs.setdefault((min(pair), max(pair)), when)
    return pairs


def _paired(
    places: IntArray, level: IntArray, first: int, second: int, last: bool
) -> tuple[Places, Places]:
    """Visits of two postures in a cycle, as many of each; of more the first or the last."""
    here, partners = places[level == first], places[level == second]
    count = min(len(here), len(partners))
    if last:
        here, partners = here[len(here) - count :], partners[len(partners) - count :]
    return tuple(here[:count].tolist()), tuple(partners[:count].tolist())
