"""Single readings that do not belong where they are written down: wild, or under a wrong label.

A reading is judged by its repeats of the same approach, and by all of its posture, since a wrong
label also makes the approach wrong and may leave a reading without repeats. A label is wrong when
the reading fits the repeats in another posture, or on another leg.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.diagnosis.blunders import Blunder, place_of
from calib.diagnosis.results import Named
from calib.diagnosis.slips import cell_basis, level_basis, posture_basis
from calib.observations import LEG_NAMES, FloatArray, IntArray, Observations

WILD_DISTANCE = 17.0
"""In standard deviations of a reading; far beyond what heavy tails of honest readings reach."""

MISLABELLED_DISTANCE = 13.0
"""The same where the reading fits another place: two coincidences, so less is enough."""

SAME_VALUE = (4.0, 6.0)
"""A reading belongs to a place when it is within so many standard deviations of it: the second
where it is ``NEARER`` times as far off where it is written down. Tails may be heavy."""

NEARER = 12.0

LEAST_SHARE = 0.15
"""A reading that its own cell follows more closely cannot be judged by it."""

ALIKE = 25.0
"""Noise variances by which one explanation must be better than another to be told from it."""

SUSPECT = 0.7
MOST_SUSPECTS = 6
MOST_STRAYS = 4
LEAST_FREE = 4.0
LEAST_VARIANCE_MM2 = 1e-8


Basis = Callable[[Observations, IntArray], FloatArray]


@dataclass(frozen=True, eq=False)
class _Judged:
    """Readings beside their repeats.

    ``distance`` ``(n,)`` is how far a reading is off in standard deviations of a reading, ``fit``
    ``(n,)`` the same in those of the distance, by the scatter of its own mounting where that is
    larger; both are 0 where it is alone. ``left_mm2`` is what is left of all readings,
    ``variance_mm2`` the noise without the worst.
    """

    distance: FloatArray
    fit: FloatArray
    left_mm2: float
    variance_mm2: float

    def holds(self, row: int, far: float) -> bool:
        """Whether a reading ``far`` off elsewhere is among its own here."""
        most = float(np.clip(far / NEARER, *SAME_VALUE))
        return bool(0.0 < self.fit[row] < most)

    @classmethod
    def of(cls, observed: Observations, least_mm2: float) -> _Judged:
        """By repeats of the same approach, by a posture's with one play, and without."""
        judges = [
            cls._beside(observed, basis, least_mm2)
            for basis in (cell_basis, posture_basis, level_basis)
        ]
        return cls(
            np.maximum.reduce([one.distance for one in judges]),
            np.maximum.reduce([one.fit for one in judges]),
            sum(one.left_mm2 for one in judges),
            judges[0].variance_mm2,
        )

    @classmethod
    def _beside(cls, observed: Observations, basis: Basis, least_mm2: float) -> _Judged:
        left, share = _scatter(observed, basis)
        own = np.where(share > LEAST_SHARE, left / np.maximum(share, LEAST_SHARE), 0.0)
        free = float(share.sum())
        if free <= LEAST_FREE:
            nothing = np.zeros(len(observed))
            return cls(nothing, nothing, float(left.sum()), least_mm2)
        pooled = np.maximum((left.sum() - own) / (free - 1.0), least_mm2)
        near = np.bincount(observed.mount, left)[observed.mount] - own
        near = near / np.maximum(np.bincount(observed.mount, share)[observed.mount] - 1.0, 1.0)
        distance = np.sqrt(own / pooled / np.maximum(share, LEAST_SHARE))
        fit = np.sqrt(own / np.maximum(pooled, near))
        return cls(distance, fit, float(left.sum()), float(pooled.min()))


def _scatter(observed: Observations, basis: Basis) -> tuple[FloatArray, FloatArray]:
    """Squares ``(n,)`` in mm² beside repeats and a drift of each mounting, and their freedom."""
    left, share = np.zeros(len(observed)), np.zeros(len(observed))
    root = np.sqrt(observed.averaged)
    for mount in range(observed.mount_count):
        rows = np.flatnonzero(observed.mount == mount)
        order = np.linspace(-1.0, 1.0, len(rows))  # the time of a row from elsewhere misleads
        columns = np.column_stack([basis(observed, rows), order, order**2])
        vectors, singular, _ = np.linalg.svd(root[rows, None] * columns, full_matrices=False)
        beside = vectors[:, singular > 1e-9 * singular[0]]
        value = root[rows] * observed.value_mm[rows]
        left[rows] = (value - beside @ (beside.T @ value)) ** 2
        share[rows] = np.maximum(1.0 - (beside * beside).sum(axis=1), 0.0)
    return left, share


def set_strays_right(observed: Observations, step_mm: float = 0.0) -> list[Blunder]:
    """Readings that do not belong, worst first, each in the data that the one before left.

    ``step_mm`` is the step of the display: less than its rounding is no scatter.
    """
    least = max(LEAST_VARIANCE_MM2, step_mm**2 / 12.0)
    found: list[Blunder] = []
    while len(found) < MOST_STRAYS:
        stray = _worst(found[-1].corrected if found else observed, least)
        if stray is None:
            break
        found.append(stray)
    return found


def _worst(observed: Observations, least_mm2: float) -> Blunder | None:
    judged = _Judged.of(observed, least_mm2)
    worst = float(judged.distance.max(initial=0.0))
    if worst < MISLABELLED_DISTANCE:
        return None
    order = np.argsort(-judged.distance)[:MOST_SUSPECTS]
    suspects = order[judged.distance[order] >= SUSPECT * worst]
    mislabelled = _mislabelled(observed, suspects, worst, least_mm2)
    if mislabelled is not None or worst < WILD_DISTANCE:
        return mislabelled
    return _wild(observed, suspects, least_mm2)


@dataclass(frozen=True, eq=False)
class _Move:
    """One row under another label, what that leaves, and the place in words."""

    row: int
    left_mm2: float
    words: str
    observed: Observations


def _mislabelled(
    observed: Observations, suspects: IntArray, far: float, least_mm2: float
) -> Blunder | None:
    """The wrong label that explains most; places that fit as well are told, too."""
    fits = [
        _Move(row, judged.left_mm2, words, moved)
        for row in suspects.tolist()
        for words, moved in _moves(observed, row)
        if (judged := _Judged.of(moved, least_mm2)).holds(row, far)
    ]
    if not fits:
        return None
    best = min(fits, key=lambda one: one.left_mm2)
    bar = best.left_mm2 + ALIKE * _Judged.of(best.observed, least_mm2).variance_mm2
    alike = [one for one in fits if one.row == best.row and one.left_mm2 < bar]
    places = " or ".join(one.words for one in alike)
    title = f"the reading {_posture(observed, best.row)} belongs to {places}"
    corrected = best.observed if len(alike) == 1 else _without(observed, [best.row])
    rows = np.array([best.row], dtype=np.intp)
    return Blunder("label_error", place_of(observed, rows), title, rows, corrected)


def belongs_elsewhere(observed: Observations, row: int) -> str | None:
    """The posture of the same mounting, or the other leg, whose repeats this reading fits."""
    for words, moved in _moves(observed, row):
        if _Judged.of(moved, LEAST_VARIANCE_MM2).holds(row, WILD_DISTANCE):
            return words
    return None


def _moves(observed: Observations, row: int) -> Iterator[tuple[str, Observations]]:
    """The session with this row under each other label that is nearer to its value."""
    mount = int(observed.mount[row])
    own = _far(observed, row, mount, float(observed.displacement_mm[row]))
    for level in np.unique(observed.displacement_mm[observed.mount == mount]).tolist():
        if level != observed.displacement_mm[row] and _far(observed, row, mount, level) < own / 2:
            yield f"{level:+g} mm", relabelled(observed, row, mount, level)
    level = float(observed.displacement_mm[row])
    for other in _mounts_of_other_leg(observed, row):
        if _far(observed, row, other, level) < own / 2:
            leg = LEG_NAMES[observed.leg[observed.mount == other][0]].upper()
            yield f"leg {leg}", relabelled(observed, row, other, level)


def _far(observed: Observations, row: int, mount: int, level_mm: float) -> float:
    """How far the reading is from the middle of others, mm; without others endless."""
    there = (observed.mount == mount) & (observed.displacement_mm == level_mm)
    there[row] = False
    if not there.any():
        return math.inf
    return abs(float(observed.value_mm[row] - np.median(observed.value_mm[there])))


def _mounts_of_other_leg(observed: Observations, row: int) -> list[int]:
    """Mountings of the other leg that is measured along the same axis, at the same station."""
    there = (observed.axis == observed.axis[row]) & (observed.leg != observed.leg[row])
    there &= observed.station == observed.station[row]
    return [int(mount) for mount in np.unique(observed.mount[there])]


def relabelled(observed: Observations, row: int, mount: int, level_mm: float) -> Observations:
    """The session with one row under another label, and the approaches that this makes."""
    model = int(np.flatnonzero(observed.mount == mount)[0])
    arrays = {
        name: getattr(observed, name).copy() for name in ("leg", "station", "indicator", "mount")
    }
    for array in arrays.values():
        array[row] = array[model]
    levels = observed.displacement_mm.copy()
    levels[row] = level_mm
    moved = replace(observed, **arrays, displacement_mm=levels)
    return _retraced(observed, moved)


def _retraced(before: Observations, after: Observations) -> Observations:
    """Approaches are changed only where the labels make them different."""
    old, new = _traced(before), _traced(after)
    return replace(after, approach=np.where(new != old, new, before.approach))


def _traced(observed: Observations) -> FloatArray:
    """Sign of the last movement before each reading ``(n,)`` of a mounting, 0 where unknown."""
    found = np.zeros(len(observed))
    for mount in range(observed.mount_count):
        rows = np.flatnonzero(observed.mount == mount)
        moved = np.sign(np.diff(observed.displacement_mm[rows], prepend=np.nan))
        moved[:1] = 0.0
        last = np.maximum.accumulate(np.where(moved != 0.0, np.arange(len(rows)), 0))
        found[rows] = moved[last]
    return found


def _wild(observed: Observations, suspects: IntArray, least_mm2: float) -> Blunder:
    """The reading without which the repeats agree best; all where several do as well."""
    left = [_Judged.of(_without(observed, [row]), least_mm2).left_mm2 for row in suspects.tolist()]
    best = int(np.argmin(left))
    rest = _Judged.of(_without(observed, [int(suspects[best])]), least_mm2)
    bar = rest.left_mm2 + ALIKE * rest.variance_mm2
    rows = np.array(
        [row for row, one in zip(suspects.tolist(), left, strict=True) if one <= bar], dtype=np.intp
    )
    title, at_the_end = _wild_in_words(observed, rows)
    where = place_of(observed, rows)
    instead = (Named("stand_slip", where),) if at_the_end else ()
    return Blunder("wild_reading", where, title, rows, _without(observed, rows), instead)


def _wild_in_words(observed: Observations, rows: IntArray) -> tuple[str, bool]:
    """The title, and whether a slip of the stand would leave the very same readings."""
    if len(rows) > 1:
        postures = " or ".join(_posture(observed, row) for row in sorted(rows.tolist()))
        return f"one reading is wild, {postures}; none of them is used", False
    row = int(rows[0])
    mounted = np.flatnonzero(observed.mount == observed.mount[row])
    title = f"one wild reading {_posture(observed, row)}"
    if row == mounted[0]:
        return f"{title}, or the stand moved after it", True
    if row == mounted[-1]:
        return f"{title}, or the stand moved before it", True
    return title, False


def _posture(observed: Observations, row: int) -> str:
    return f"at {observed.displacement_mm[row]:+g} mm, cycle {observed.cycle[row]}"


def _without(observed: Observations, rows: Sequence[int] | IntArray) -> Observations:
    return observed.take(np.delete(np.arange(len(observed)), rows))
