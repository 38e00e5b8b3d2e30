"""One reading under another label: which labels there are, and what fitting one of them proves.

A reading that is off lands among the repeats of some other posture by accident, too, the more
easily the more postures there are. Two things tell an accident from a wrong label: how closely it
fits, and whether every posture has been read as often as elsewhere once the label is changed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.arrays import TOUCHED_NAMES, FloatArray, Observations
from calib.diagnosis.policy import POLICY

REACH = 1.5
"""An outlier may lie anywhere, up to so many times as far from its place as it does."""


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


def _middles(observed: Observations, row: int) -> tuple[float, list[tuple[Label, float]]]:
    """Medians of the other readings, mm, at home and under each other label; inf without any."""

    def middle(mount: int, posture: int) -> float:
        there = (observed.mount == mount) & (observed.level == posture)
        there[row] = False
        return float(np.median(observed.value_mm[there])) if there.any() else math.inf

    others = [(one, middle(one.mount, one.posture)) for one in other_labels(observed, row)]
    return middle(observed.mount[row], observed.level[row]), others


def nearer_labels(observed: Observations, row: int) -> list[Label]:
    """Those whose other readings are less than half as far from this one as its own are."""
    value = float(observed.value_mm[row])
    home, others = _middles(observed, row)
    half = abs(value - home) / 2.0
    return [label for label, middle in others if abs(value - middle) < half]


def labels_within_reach(observed: Observations, row: int) -> int:
    """How many an outlier might have landed at by accident; at least one."""
    home, others = _middles(observed, row)
    if math.isinf(home):
        return max(sum(math.isfinite(middle) for _, middle in others), 1)
    reach = REACH * abs(float(observed.value_mm[row]) - home)
    return max(sum(abs(middle - home) < reach for _, middle in others), 1)


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
