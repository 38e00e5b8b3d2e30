"""Single readings that do not belong where they are written down: outliers, or mislabelled.

A reading is judged by its repeats of the same approach, and by all of its posture, since a wrong
label also makes the approach wrong and may leave a reading without repeats. A label is wrong when
the reading fits the repeats in another posture, or on another leg.

It lands among the repeats of some other posture by accident, too, the more easily the more postures
there are. Two things tell an accident from a wrong label: how closely it fits, and whether every
posture has been read as often as elsewhere once the label is changed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.arrays import (
    DEPENDENT,
    TOUCHED_NAMES,
    FloatArray,
    IntArray,
    Observations,
    basis_of,
    descending,
    largest,
    ranks,
    without,
)
from calib.diagnosis.gross_errors import (
    GrossError,
    cell_basis,
    level_basis,
    place_of,
    posture_basis,
    words_of,
)
from calib.diagnosis.policy import POLICY
from calib.diagnosis.results import Named

LEAST_SHARE = 0.15
"""A reading that its own cell follows more closely cannot be judged by it."""

SUSPECT = 0.7
MOST_SUSPECTS = 6
MOST_OUTLIERS = 4
LEAST_VARIANCE_MM2 = 1e-8

REACH = 1.5
"""An outlier may lie anywhere, up to so many times as far from its place as it does."""

Basis = Callable[[Observations, IntArray], FloatArray]


@dataclass(frozen=True, eq=False)
class _Judged:
    """Readings beside their repeats.

    ``distance`` ``(n,)`` is how far a reading is off in standard deviations of a reading, ``fit``
    ``(n,)`` the same in those of the distance, by the scatter of its own mounting where that is
    larger; both are 0 where it is alone. ``residual_mm2`` is the square sum of all readings,
    ``variance_mm2`` the noise without the worst.
    """

    distance: FloatArray
    fit: FloatArray
    residual_mm2: float
    variance_mm2: float

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
            sum(one.residual_mm2 for one in judges),
            judges[0].variance_mm2,
        )

    @classmethod
    def _beside(cls, observed: Observations, basis: Basis, least_mm2: float) -> _Judged:
        left, share = _scatter(observed, basis)
        own = np.where(share > LEAST_SHARE, left / np.maximum(share, LEAST_SHARE), 0.0)
        free = float(share.sum())
        if free <= POLICY.room:
            nothing = np.zeros(len(observed))
            return cls(nothing, nothing, float(left.sum()), least_mm2)
        pooled = np.maximum((left.sum() - own) / (free - 1.0), least_mm2)
        mount = observed.mount
        squares, frees = np.bincount(mount, left), np.bincount(mount, share)
        mine = squares[mount] - own
        near = mine / np.maximum(frees[mount] - 1.0, 1.0)
        # a mistake in one mounting, however large, must not hide one in another: the middle counts
        judging = frees > 0.5 * frees.max()
        middle = np.median(squares[judging] / frees[judging])
        known = observed.approach_known  # else it may be off by a play
        pooled = np.where(known, np.maximum(np.maximum(middle, near), least_mm2), pooled)
        distance = np.sqrt(own / pooled / np.maximum(share, LEAST_SHARE))
        fit = np.sqrt(own / np.maximum(pooled, near))
        return cls(distance, fit, float(left.sum()), float(pooled.min()))


def _scatter(observed: Observations, basis: Basis) -> tuple[FloatArray, FloatArray]:
    """Squares ``(n,)`` in mm² beside repeats and a drift of each mounting, and their freedom."""
    left, share = np.zeros(len(observed)), np.zeros(len(observed))
    root = np.sqrt(observed.averaged)
    for rows in observed.mountings:
        order = np.linspace(-1.0, 1.0, len(rows))  # the time of a row from elsewhere misleads
        columns = np.column_stack([basis(observed, rows), order, order**2])
        beside = basis_of(root[rows, None] * columns, DEPENDENT)
        left[rows] = without(beside, root[rows] * observed.value_mm[rows]) ** 2
        share[rows] = np.maximum(1.0 - (beside * beside).sum(axis=1), 0.0)
    return left, share


def set_outliers_right(observed: Observations, step_mm: float = 0.0) -> list[GrossError]:
    """Readings that do not belong, worst first, each in the data that the one before left.

    ``step_mm`` is the step of the display: less than its rounding is no scatter.
    """
    least = max(LEAST_VARIANCE_MM2, step_mm**2 / 12.0)
    found: list[GrossError] = []
    while len(found) < MOST_OUTLIERS:
        worst = _worst(found[-1].corrected if found else observed, least)
        if worst is None:
            break
        found.append(worst)
    return found


def _worst(observed: Observations, least_mm2: float) -> GrossError | None:
    judged = _Judged.of(observed, least_mm2)
    worst = float(judged.distance.max(initial=0.0))
    if worst < POLICY.mislabelled_sd:
        return None
    order = np.argsort(ranks(judged.distance), kind="stable")
    suspects = order[observed.mount[order] == observed.mount[order[0]]][:MOST_SUSPECTS]
    suspects = suspects[judged.distance[suspects] >= SUSPECT * worst]
    wild = _wild(observed, suspects, least_mm2)
    places = _likeliest(observed, wild.rows, judged.distance, least_mm2)
    odds = places[0].odds if places else 0.0
    if odds >= POLICY.doubtful_odds:
        return _mislabelled(observed, places)
    if worst < POLICY.wild_sd and odds < 1.0:
        return None
    return (
        _mislabelled_or_wild(observed, places, wild) if odds > 1.0 / POLICY.doubtful_odds else wild
    )


@dataclass(frozen=True, eq=False)
class _Fit:
    """One row under another label that it fits: what that gives, and the evidence for it.

    ``odds`` are those of a wrong label against an outlier that fits there by accident.
    """

    row: int
    words: str
    observed: Observations
    judged: _Judged
    odds: float


def _likeliest(
    observed: Observations, suspects: IntArray, distance: FloatArray, least_mm2: float
) -> list[_Fit]:
    """Of other labels that a suspect fits and that explain most the likeliest.

    Then others of its row that nearly are.
    """
    fits = []
    for row in suspects.tolist():
        near, chances = labels_near(observed, row)
        for label in near:
            moved = relabelled(observed, row, label)
            judged = _Judged.of(moved, least_mm2)
            if judged.fit[row] > 0.0:  # else it is alone there
                even = evened(observed, moved)
                far, fit = float(distance[row]), float(judged.fit[row])
                odds = odds_of_label(far, fit, chances * len(suspects), even)
                fits.append(_Fit(row, label.words, moved, judged, odds))
    if not fits:
        return []
    first = min((one.judged for one in fits), key=lambda one: one.residual_mm2)
    bar = first.residual_mm2 + POLICY.decisive * first.variance_mm2
    alike = [one for one in fits if one.judged.residual_mm2 <= bar]
    best, *others = descending(alike, lambda one: one.odds)
    nearly = [
        one for one in others if one.row == best.row and one.odds * POLICY.doubtful_odds > best.odds
    ]
    return [best, *nearly]


def _mislabelled(observed: Observations, places: list[_Fit]) -> GrossError:
    """It is put where it belongs; where several places fit as well, it is left out."""
    best = places[0]
    title = f"the reading {words_of(observed, best.row)} belongs to "
    title += " or ".join(one.words for one in places)
    corrected = best.observed if len(places) == 1 else _without(observed, [best.row])
    rows = np.array([best.row], dtype=np.intp)
    return GrossError("label_error", place_of(observed, rows), title, rows, corrected)


def _mislabelled_or_wild(
    observed: Observations, places: list[_Fit], wild: GrossError
) -> GrossError:
    """Nothing tells which; the likelier name goes first, and the reading is not used."""
    label = _mislabelled(observed, places)
    names = [(label, label.title), (wild, _wild_in_words(observed, wild.rows)[0])]
    (first, words), (second, other) = names if places[0].odds >= 1.0 else reversed(names)
    rows = np.union1d(wild.rows, label.rows)
    return GrossError(
        first.id,
        first.where,
        f"{words}, or {other}; {_unused(rows)}",
        rows,
        _without(observed, rows),
        (Named(second.id, second.where), *wild.or_else),
    )


def _wild(observed: Observations, suspects: IntArray, least_mm2: float) -> GrossError:
    """The reading without which the repeats agree best; all where several do as well."""
    each = [_Judged.of(_without(observed, [row]), least_mm2) for row in suspects.tolist()]
    left = np.array([one.residual_mm2 for one in each])
    best = each[largest(-left, least_mm2)]
    rows = suspects[left <= best.residual_mm2 + POLICY.decisive * best.variance_mm2]
    title, at_the_end = _wild_in_words(observed, rows)
    title = f"{title}; {_unused(rows)}" if len(rows) > 1 else title
    where = place_of(observed, rows)
    instead = (Named("stand_slip", where),) if at_the_end else ()
    return GrossError("wild_reading", where, title, rows, _without(observed, rows), instead)


def _wild_in_words(observed: Observations, rows: IntArray) -> tuple[str, bool]:
    """The title, and whether a shift of the stand would leave the very same readings."""
    if len(rows) > 1:
        postures = " or ".join(words_of(observed, row) for row in sorted(rows.tolist()))
        return f"one reading is an outlier, {postures}", False
    row = int(rows[0])
    mounted = np.flatnonzero(observed.mount == observed.mount[row])
    title = f"one outlier {words_of(observed, row)}"
    if row == mounted[0]:
        return f"{title}, or the stand moved after it", True
    if row == mounted[-1]:
        return f"{title}, or the stand moved before it", True
    return title, False


def _unused(rows: IntArray) -> str:
    return "none of them is used" if len(rows) > 1 else "it is not used"


def _without(observed: Observations, rows: Sequence[int] | IntArray) -> Observations:
    return observed.take(np.delete(np.arange(len(observed)), rows))


@dataclass(frozen=True)
class Label:
    """A posture of a mounting."""

    mount: int
    posture: int
    words: str


def other_labels(observed: Observations, row: int) -> Iterator[Label]:
    """The other postures of its mounting, and the same posture under the other leg."""
    own, level = int(observed.mount[row]), int(observed.level[row])
    for posture in np.unique(observed.level[observed.mount == own]).tolist():
        if posture != level:
            words = observed.posture_words(_first(observed.level == posture))
            yield Label(own, posture, words)
    there = (observed.axis == observed.axis[row]) & (observed.leg != observed.leg[row])
    there &= observed.station == observed.station[row]
    there &= observed.over_plane == observed.over_plane[row]
    for mount in np.unique(observed.mount[there]).tolist():
        leg = TOUCHED_NAMES[observed.leg[observed.mount == mount][0]].upper()
        yield Label(mount, level, f"leg {leg}")


def labels_near(observed: Observations, row: int) -> tuple[list[Label], int]:
    """Labels whose other readings are less than half as far from this one as its own are.

    With them how many an outlier might have landed at by accident; at least one.
    """

    def middle(mount: int, posture: int) -> float:
        there = (observed.mount == mount) & (observed.level == posture)
        there[row] = False
        return float(np.median(observed.value_mm[there])) if there.any() else math.inf

    value, home = float(observed.value_mm[row]), middle(observed.mount[row], observed.level[row])
    labels = list(other_labels(observed, row))
    middles = [middle(one.mount, one.posture) for one in labels]
    off = abs(value - home)
    near = [one for one, of in zip(labels, middles, strict=True) if abs(value - of) < off / 2.0]
    if math.isinf(home):  # alone in its posture: it may have landed anywhere
        return near, max(sum(map(math.isfinite, middles)), 1)
    return near, max(sum(abs(of - home) < REACH * off for of in middles), 1)


def odds_of_label(far: float, fit: float, labels: int, evened: float) -> float:
    """Odds of a wrong label against an outlier that fits by accident.

    ``far`` is its distance from where it is written down, ``fit`` from the new place, both in
    standard deviations; ``labels`` how many such fits there might be; ``evened`` is +1, 0
    or -1, see there. The tails of honest readings are Student's, 4 degrees of freedom.
    """
    there = 0.375 * math.pow(1.0 + fit**2 / 4.0, -2.5)
    return 2.0 * REACH * far * there / labels * math.pow(POLICY.doubtful_odds, evened)


def evened(before: Observations, after: Observations) -> float:
    """1 where a changed label makes the session more even in both postures, -1 less, else 0."""
    change = _unevenness(after) - _unevenness(before)
    return -float(np.sign(change)) if abs(change) > 1.5 else 0.0


def _unevenness(observed: Observations) -> float:
    """By how many readings the postures of mountings differ from what most mountings have."""
    count = np.zeros((observed.mount_count, int(observed.level.max()) + 1))
    np.add.at(count, (observed.mount, observed.level), 1.0)
    return float(np.abs(count - np.median(count, axis=0)).sum())


def relabelled(observed: Observations, row: int, label: Label) -> Observations:
    """The session with one row under another label, and the approaches that this makes.

    A reading of the tool takes the movement of the first one there.
    """
    model = _first(observed.mount == label.mount)
    there = _first(observed.level == label.posture)
    of_mount = ("leg", "station", "indicator", "mount")
    of_level: tuple[str, ...] = ("displacement_mm", "position_mm", "movement")
    if observed.over_plane[model]:
        of_level += ("station", "along_mm")
    arrays: dict[str, NDArray[Any]] = {}
    for source, names in ((model, of_mount), (there, of_level)):
        for name in names:
            arrays.setdefault(name, getattr(observed, name).copy())
            arrays[name][row] = arrays[name][source]
    moved = replace(observed, **arrays)
    old, new = _traced(observed), _traced(moved)
    return replace(moved, approach=np.where(new != old, new, observed.approach))


def _first(rows: NDArray[np.bool_]) -> int:
    return int(np.flatnonzero(rows)[0])


def _traced(observed: Observations) -> FloatArray:
    """Sign of the last movement before each reading ``(n,)`` of a mounting, 0 where unknown."""
    found = np.zeros(len(observed))
    for rows in observed.mountings:
        moved = np.sign(np.diff(observed.displacement_mm[rows], prepend=np.nan))
        moved[:1] = 0.0
        last = np.maximum.accumulate(np.where(moved != 0.0, np.arange(len(rows)), 0))
        found[rows] = moved[last]
    return found
