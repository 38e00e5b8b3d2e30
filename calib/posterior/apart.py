"""What a mistake is, and readings that stand apart: a first take, a wild one, a stand that moved.

Each gets a zero of its own, so it is a session with the same number of readings.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.arrays import (
    TOUCHED_LETTERS,
    IntArray,
    Observations,
    numbered,
    rows_of,
)
from calib.posterior.exchanges import place_of
from calib.posterior.screening import Screen

PRIOR = {
    "first_take": 0.02,
    "wild_reading": 0.003,
    "label_error": 0.003,
    "posture_off": 0.001,
    "stand_slip": 0.003,
    "gauge_swap": 0.003,
    "legs_exchanged": 0.0005,
    "tables_exchanged": 0.0005,
    "postures_exchanged": 0.003,
    "gauge_sign": 0.003,
    "unit_mixup": 0.003,
}
"""Of a session; shared by all places of a kind.

Two cables change places more often than whole tables of two legs, which a guided session asks for
one after the other; readings tell neither from the other.
"""

LEAST = {
    "first_take": 6.0,
    "wild_reading": 13.0,
    "label_error": 13.0,
    "posture_off": 13.0,
    "stand_slip": 8.0,
}
"""Standard deviations of a reading from which on it is a mistake: less is in the tail of noise.

Of Student's t with 3 degrees of freedom one of 60 readings is beyond 13 in one session of thirty.
"""

FIRST_TAKE = "the first take is off: it settled, was within a play, or was another posture"
FIRST_CONTACT = "the first contact is off: it settled, or something hung from the nozzle"

LOG_RANGE = math.log(1000.0)
"""A reading that is wrong is off by anything between 10 µm and 10 mm, each octave alike."""

LEAST_SEEN = 1e-6
"""Share of a shift's square that others must leave, or it cannot be told."""

FEW_POSTURES = 5
"""Of a mounting of fewer postures none can be off by itself: a law goes through the others."""

TRIED = 12
"""Mistakes of a kind that are looked at, the likeliest first."""


@dataclass(frozen=True, eq=False)
class Mistake:
    """One mistake: its name, place and words, the visits it touches, and the visits put right.

    ``log_prior`` is that of the mistake, with the density of what it makes of readings;
    ``session`` the number of the session that it is in. The value of visit i was written at visit
    ``source[i]``, ``factor`` times as large in ``rows``.
    """

    id: str
    where: str
    title: str
    rows: IntArray
    visits: Observations
    log_prior: float
    source: IntArray
    factor: float = 1.0
    session: int = 0

    @cached_property
    def relabels(self) -> bool:
        """Whether values belong elsewhere, or have another sign or unit; else some stand apart."""
        is_moved = not np.array_equal(self.source, np.arange(len(self.source)))
        return is_moved or self.factor != 1.0


Scored = tuple[float, Mistake]
"""A log weight and the mistake that has it."""


@dataclass(frozen=True, eq=False)
class _Apart:
    """Rows with zeros of their own, a group for each, and how many places such a mistake has."""

    id: str
    where: str
    title: str
    groups: tuple[IntArray, ...]
    places: int


def readings_apart(screen: Screen) -> Iterator[Scored]:
    """Readings that stand apart, and the log likelihood that each adds, its prior included."""
    visits, root = screen.cells.visits, screen.root
    contacts = bool(visits.contact.any())
    slips = () if contacts else _slips(screen)  # there is no stand
    apart = *single_readings(screen), *_first_takes(visits), *_postures_off(screen), *slips
    middle_mm = float(np.median(root))
    for suspect in apart:
        # a shift of few rows: its products need no more than these
        within = np.array([(1.0 / root[rows]) @ screen.basis[rows] for rows in suspect.groups])
        square = np.array([float((1.0 / root[rows] ** 2).sum()) for rows in suspect.groups])
        along = np.array([float((screen.left[rows] / root[rows]).sum()) for rows in suspect.groups])
        inner = np.diag(square) - within @ within.T
        sizes = np.linalg.eigvalsh(inner)
        if sizes[0] < 1e-6 / float(root.max()) ** 2:
            continue
        off_mm = np.linalg.solve(inner, along)
        if np.abs(off_mm).max() < LEAST[suspect.id] * middle_mm:
            continue
        gain = screen.log_likelihood(
            screen.square - float(off_mm @ inner @ off_mm), len(suspect.groups)
        ) - screen.log_likelihood(screen.square)
        room = 0.5 * float(np.log(2.0 * math.pi / sizes).sum())
        density = 1.0 / (2.0 * LOG_RANGE * np.maximum(np.abs(off_mm), root.min()))
        name, title = suspect.id, suspect.title
        if name == "wild_reading" and not contacts:
            row = int(suspect.groups[0][0])
            chance, label = _other_label(visits, row, float(root[row]))
            if chance > density[0]:
                name, title = "label_error", f"{title}; it fits {label}"
                density = np.array([chance])
        log_prior = math.log(PRIOR[name] / suspect.places) + float(np.log(density).sum())
        mistake = standing_apart(visits, name, suspect.where, title, suspect.groups, log_prior)
        yield float(gain) + room + log_prior, mistake


def standing_apart(
    visits: Observations,
    id: str,
    where: str,
    title: str,
    groups: Sequence[IntArray],
    log_prior: float,
) -> Mistake:
    """The mistake of rows that get a zero of their own, one for each of the groups."""
    mount = visits.mount.copy()
    for k, rows in enumerate(groups):
        mount[rows] = visits.mount_count + k
    right, source = replace(visits, mount=numbered(mount)), np.arange(len(visits), dtype=np.intp)
    return Mistake(id, where, title, np.concatenate(groups), right, log_prior, source)


def single_readings(screen: Screen) -> Iterator[_Apart]:
    """The readings that lie furthest from where all others expect them."""
    visits = screen.cells.visits
    count = len(visits)
    share = np.maximum(1.0 - (screen.basis[:count] ** 2).sum(axis=1), 1e-6)
    furthest = np.argsort(-(screen.left[:count] ** 2) / share, kind="stable")
    for row in furthest[:TRIED].tolist():
        title = f"one {_gauge_word(visits)} is wrong, {words_of(visits, row)}"
        yield _Apart("wild_reading", place_of(visits, row), title, (np.array([row]),), count)


def _postures_off(screen: Screen) -> Iterator[_Apart]:
    """The postures of which all readings lie furthest from where others expect them."""
    visits, root = screen.cells.visits, screen.root
    posture = numbered(visits.mount, visits.level, *visits.position_mm.T)
    rows = rows_of(posture)
    of_mount = visits.mount[[int(members[0]) for members in rows]]
    enough = np.bincount(of_mount)[of_mount] >= FEW_POSTURES
    candidates = enough & (np.bincount(posture) > 1)
    if not candidates.any():
        return
    count = len(visits)
    whitened_basis = np.zeros((len(rows), screen.basis.shape[1]))
    np.add.at(whitened_basis, posture, screen.basis[:count] / root[:, None])
    size = np.bincount(posture, 1.0 / root**2) - (whitened_basis**2).sum(axis=1)
    along = np.bincount(posture, screen.left[:count] / root)
    candidates &= size > LEAST_SEEN * np.bincount(posture, 1.0 / root**2)
    gains = np.where(candidates, along**2 / np.where(candidates, size, 1.0), 0.0)
    for k in np.argsort(-gains, kind="stable")[: min(TRIED, int(candidates.sum()))].tolist():
        row = int(rows[k][0])
        title = f"all {_gauge_word(visits)}s at {visits.posture_words(row)} are off: "
        title += "something lay there" if visits.contact.any() else "it was another posture"
        places = int(candidates.sum())
        yield _Apart("posture_off", place_of(visits, row), title, (rows[k],), places)


def _gauge_word(visits: Observations) -> str:
    return "contact" if visits.contact.any() else "reading"


def words_of(visits: Observations, row: int) -> str:
    """Posture and cycle of a reading."""
    return f"at {visits.posture_words(row)}, cycle {visits.cycle[row]}"


def _other_label(visits: Observations, row: int, deviation_mm: float) -> tuple[float, str]:
    """Density, 1/mm, of a reading that belongs to another posture or leg, and words for which."""
    level, mount = visits.level, visits.mount
    postures = (mount == mount[row]) & (level != level[row])
    legs = (visits.axis == visits.axis[row]) & (visits.station == visits.station[row])
    legs &= (visits.leg != visits.leg[row]) & (level == level[row])
    same_label = np.flatnonzero(postures | legs)
    if not len(same_label):
        return 0.0, ""
    off = np.abs(visits.value_mm[same_label] - visits.value_mm[row]) / deviation_mm
    nearest = int(same_label[off.argmin()])
    labels = len(np.unique(np.column_stack([mount, level])[same_label], axis=0))
    chance = math.exp(-(float(off.min()) ** 2) / 4.0) / (math.sqrt(4.0 * math.pi) * deviation_mm)
    label = visits.posture_words(nearest)
    if mount[nearest] != mount[row]:
        label = f"leg {TOUCHED_LETTERS[visits.leg[nearest]].upper()}"
    return chance / labels, label


def _first_takes(visits: Observations) -> Iterator[_Apart]:
    """The first visits of a stand, of a leg, and of all mountings."""
    first = np.unique(visits.mount, return_index=True)[1]
    leg, station = visits.leg[first], visits.station[first]
    stands = (numbered(leg, station, visits.over_plane[first]), leg, np.zeros_like(leg))
    sets = {tuple(first[k].tolist()) for key in stands for k in rows_of(numbered(key))}
    for members in sorted(sets):
        yield _Apart(*first_takes(visits, members), len(sets))


def first_takes(
    visits: Observations, members: Sequence[int]
) -> tuple[str, str, str, tuple[IntArray, ...]]:
    """The mistake of first takes that stand apart: id, place, what it may be, its groups."""
    legs = {TOUCHED_LETTERS[number] for number in visits.leg[list(members)].tolist()}
    where = legs.pop() if len(legs) == 1 else "all"
    title = FIRST_CONTACT if visits.contact.any() else FIRST_TAKE
    return "first_take", where, title, tuple(np.array([row]) for row in members)


def _slips(screen: Screen) -> Iterator[_Apart]:
    """For each mounting the two rows from which on a shift explains most, not at its ends."""
    visits, root = screen.cells.visits, screen.root
    for rows in visits.mountings:
        if len(rows) < 4:
            continue
        along = np.cumsum((screen.left[rows] / root[rows])[::-1])[::-1]
        accumulated = np.cumsum((screen.basis[rows] / root[rows, None])[::-1], axis=0)[::-1]
        size = np.cumsum((1.0 / root[rows] ** 2)[::-1])[::-1] - (accumulated**2).sum(axis=1)
        gains = np.where(size > LEAST_SEEN * size.max(), along**2 / np.maximum(size, 1e-12), 0.0)
        for k in (2 + np.argsort(-gains[2:-1], kind="stable"))[:2].tolist():
            row = int(rows[k])
            title = f"the stand moved before the reading {words_of(visits, row)}"
            place = place_of(visits, row)
            yield _Apart("stand_slip", place, title, (rows[k:],), len(visits))
