"""One reading under another label: which labels there are, and what fitting one of them proves.

A reading that is off lands among the repeats of some other posture by accident, too, the more
easily the more postures there are. Two things tell an accident from a wrong label: how closely it
fits, and whether every posture has been read as often as elsewhere once the label is changed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.observations import TOUCHED_NAMES, FloatArray, Observations

REACH = 1.5
"""A wild reading may lie anywhere, up to so many times as far from its place as it does."""

EVEN = 10.0
"""So much likelier is a wrong label where changing it makes an uneven session even, and so much
less likely where that makes an even one uneven. One table of ten may be uneven by itself, and one
wrong label of ten (the machine sent to another posture) leaves it even."""


@dataclass(frozen=True)
class Label:
    """A posture of a mounting."""

    mount: int
    posture: int
    words: str


def own_label(observed: Observations, row: int) -> Label:
    """Where this reading is written down."""
    return Label(int(observed.mount[row]), int(observed.level[row]), "")


def other_labels(observed: Observations, row: int) -> Iterator[Label]:
    """The other postures of its mounting, and the same posture under the other leg."""
    own = own_label(observed, row)
    for posture in np.unique(observed.level[observed.mount == own.mount]).tolist():
        if posture != own.posture:
            words = observed.posture_words(_first(observed.level == posture))
            yield Label(own.mount, posture, words)
    there = (observed.axis == observed.axis[row]) & (observed.leg != observed.leg[row])
    there &= observed.station == observed.station[row]
    for mount in np.unique(observed.mount[there]).tolist():
        leg = TOUCHED_NAMES[observed.leg[observed.mount == mount][0]].upper()
        yield Label(mount, own.posture, f"leg {leg}")


def nearer_labels(observed: Observations, row: int) -> list[Label]:
    """Those whose other readings are less than half as far from this one as its own are."""
    half = _off(observed, row, own_label(observed, row)) / 2.0
    return [one for one in other_labels(observed, row) if _off(observed, row, one) < half]


def labels_within_reach(observed: Observations, row: int) -> int:
    """How many a wild reading might have landed at by accident; at least one."""
    home = _middle(observed, row, own_label(observed, row))
    reach = REACH * abs(float(observed.value_mm[row]) - home)
    middles = [_middle(observed, row, one) for one in other_labels(observed, row)]
    if math.isinf(reach):
        return max(sum(math.isfinite(middle) for middle in middles), 1)
    return max(sum(abs(middle - home) < reach for middle in middles), 1)


def odds_of_label(far: float, fit: float, labels: int, evened: float) -> float:
    """Odds of a wrong label against a wild reading that fits by accident.

    ``far`` is its distance from where it is written down, ``fit`` from the new place, both in
    standard deviations; ``labels`` how many such fits there might be; ``evened`` is +1, 0
    or -1, see there. The tails of honest readings are Student's, 4 degrees of freedom.
    """
    there = 0.375 * math.pow(1.0 + fit**2 / 4.0, -2.5)
    return 2.0 * REACH * far * there / labels * math.pow(EVEN, evened)


def evened(before: Observations, after: Observations) -> float:
    """1 where a changed label makes the session more even in both postures, -1 less, else 0."""
    change = _unevenness(after) - _unevenness(before)
    return -float(np.sign(change)) if abs(change) > 1.5 else 0.0


def _unevenness(observed: Observations) -> float:
    """By how many readings the postures of mountings differ from what most mountings have."""
    count = np.zeros((observed.mount_count, int(observed.level.max()) + 1))
    np.add.at(count, (observed.mount, observed.level), 1.0)
    return float(np.abs(count - np.median(count, axis=0)).sum())


def _off(observed: Observations, row: int, label: Label) -> float:
    """How far the reading is from the middle of others there, mm; without others endless."""
    return abs(float(observed.value_mm[row]) - _middle(observed, row, label))


def _middle(observed: Observations, row: int, label: Label) -> float:
    """Median of the other readings under this label, mm; endless where there is none."""
    there = (observed.mount == label.mount) & (observed.level == label.posture)
    there[row] = False
    return float(np.median(observed.value_mm[there])) if there.any() else math.inf


def relabelled(observed: Observations, row: int, label: Label) -> Observations:
    """The session with one row under another label, and the approaches that this makes.

    A reading of the tool takes the movement of the first one there.
    """
    model = _first(observed.mount == label.mount)
    there = _first(observed.level == label.posture)
    arrays = {
        name: getattr(observed, name).copy() for name in ("leg", "station", "indicator", "mount")
    }
    for array in arrays.values():
        array[row] = array[model]
    for name in ("displacement_mm", "position_mm", "movement"):
        arrays[name] = getattr(observed, name).copy()
        arrays[name][row] = arrays[name][there]
    moved = replace(observed, **arrays)
    return _retraced(observed, moved)


def _first(rows: NDArray[np.bool_]) -> int:
    return int(np.flatnonzero(rows)[0])


def _retraced(before: Observations, after: Observations) -> Observations:
    """Approaches are changed only where the labels make them different."""
    old, new = _traced(before), _traced(after)
    return replace(after, approach=np.where(new != old, new, before.approach))


def _traced(observed: Observations) -> FloatArray:
    """Sign of the last movement before each reading ``(n,)`` of a mounting, 0 where unknown."""
    found = np.zeros(len(observed))
    for rows in observed.mountings:
        moved = np.sign(np.diff(observed.displacement_mm[rows], prepend=np.nan))
        moved[:1] = 0.0
        last = np.maximum.accumulate(np.where(moved != 0.0, np.arange(len(rows)), 0))
        found[rows] = moved[last]
    return found
