"""What was commanded and what was read, as arrays with one entry for each reading."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

LEG_NAMES = ("x", "y", "z")

TOOL = -1
"""In the place of a leg: the indicator reads the tool itself, as against a plate."""

TOUCHED_NAMES = (*LEG_NAMES, "tool")
"""What an indicator touches, by the number of the leg; `TOOL` is the last."""

TOUCHED_LETTERS = (*LEG_NAMES, "t")
"""The same as the first letter of a place such as ``xy`` or ``tz``."""


@dataclass(frozen=True, eq=False)
class Conditions:
    """How each reading was taken, without its value. All arrays have shape ``(n_readings,)``.

    ``leg`` and ``axis`` are 0, 1, 2 for x, y, z; a leg of `TOOL` reads the tool itself.
    ``displacement_mm`` is the commanded displacement of the tool from Zero along the leg's axis.
    ``station`` is the touched point at Zero as a fraction of the leg's length from the tool end.
    ``approach`` is +1 or -1 for the sign of the last movement of the carriage and 0 where it is not
    known. ``mount`` numbers the mountings from 0 without gaps; readings of one mounting share one
    unknown zero. ``indicator`` numbers the indicators, which may scatter differently. ``time_s``
    and ``temperature_c`` hold NaN where they were not measured.

    Of readings of the tool, ``position_mm`` ``(n_readings, 3)`` is the commanded tool position from
    Zero and ``movement`` ``(n_readings, 3)`` the sign of each carriage's last movement; station,
    displacement and approach are 0. Both are 0 for readings of legs.
    """

    leg: IntArray
    axis: IntArray
    displacement_mm: FloatArray
    station: FloatArray
    approach: FloatArray
    cycle: IntArray
    time_s: FloatArray
    temperature_c: FloatArray
    mount: IntArray
    indicator: IntArray
    position_mm: FloatArray
    movement: FloatArray

    def __len__(self) -> int:
        return len(self.leg)

    def take(self, rows: NDArray[Any] | Sequence[int]) -> Self:
        """The same kind of object with only these rows (indices or a mask), numbered anew."""
        picked = np.asarray(rows)
        arrays = {f.name: getattr(self, f.name)[picked] for f in fields(self)}
        for name in ("mount", "indicator"):
            arrays[name] = numbered(arrays[name])
        return replace(self, **arrays)

    @cached_property
    def level(self) -> IntArray:
        """Numbers ``(n_readings,)`` of what the controller was told, by displacement first."""
        return numbered(self.displacement_mm, *self.position_mm.T)

    @property
    def approach_known(self) -> NDArray[np.bool_]:
        """Whether the last movement of a carriage is known ``(n_readings,)``."""
        return np.asarray((self.approach != 0.0) | self.movement.any(axis=1))

    @property
    def at_zero(self) -> NDArray[np.bool_]:
        """Whether the tool is commanded to Zero ``(n_readings,)``."""
        return np.asarray((self.displacement_mm == 0.0) & ~self.position_mm.any(axis=1))

    def posture_words(self, row: int) -> str:
        """``+60 mm`` for a leg, ``(0, 35, 10) mm`` for the tool."""
        if self.leg[row] == TOOL:
            return f"({', '.join(f'{v:g}' for v in self.position_mm[row])}) mm"
        return f"{self.displacement_mm[row]:+g} mm"

    @property
    def posture(self) -> IntArray:
        """Numbers ``(n_readings,)`` of the groups of one mounting in one posture."""
        return numbered(self.mount, self.level)

    @property
    def cell(self) -> IntArray:
        """Numbers ``(n_readings,)`` of the groups of a posture approached from one side."""
        return numbered(self.mount, self.level, self.approach, *self.movement.T)

    @property
    def mountings(self) -> list[IntArray]:
        """Rows of each mounting."""
        return rows_of(self.mount)

    @property
    def mount_count(self) -> int:
        """Number of mountings, each with a zero of its own."""
        return int(self.mount.max()) + 1 if len(self) else 0

    @property
    def indicator_count(self) -> int:
        """Number of indicators."""
        return int(self.indicator.max()) + 1 if len(self) else 0


@dataclass(frozen=True, eq=False)
class Observations(Conditions):
    """Conditions with what the indicators showed.

    ``value_mm`` and ``averaged`` have shape ``(n_readings,)``; ``averaged`` is the number of
    readings that one value is the mean of and serves as its weight.
    """

    value_mm: FloatArray
    averaged: FloatArray


def numbered(*keys: NDArray[Any]) -> IntArray:
    """Number the groups ``(n,)`` of rows that agree in all keys ``(n,)``, in the keys' order."""
    order = np.lexsort(keys[::-1])
    group = np.zeros(len(order), dtype=np.intp)
    for key in keys:
        ordered = key[order]
        group[1:] |= ordered[1:] != ordered[:-1]
    group[order] = np.cumsum(group)
    return group


def rows_of(group: IntArray) -> list[IntArray]:
    """Rows of each group, ``(n,)`` numbers without gaps."""
    order = np.argsort(group, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(group[order])) + 1) if len(group) else []


def conditions(
    leg: Sequence[int],
    axis: Sequence[int],
    displacement_mm: Sequence[float],
    *,
    station: float | Sequence[float] = 0.5,
    mount: Sequence[int] | None = None,
) -> Conditions:
    """Conditions of a plain list of readings, one mounting for each leg, axis and station.

    Time, approach and cycle are zero and the temperature is not known: for tables of theory and
    for tests, where only the geometry matters.
    """
    n = len(leg)
    stations = np.broadcast_to(np.asarray(station, dtype=np.float64), n).copy()
    keys = list(zip(leg, axis, stations.tolist(), strict=True))
    order = {key: k for k, key in enumerate(dict.fromkeys(keys))}
    mounts = [order[key] for key in keys] if mount is None else mount
    return Conditions(
        leg=np.asarray(leg, dtype=np.intp),
        axis=np.asarray(axis, dtype=np.intp),
        displacement_mm=np.asarray(displacement_mm, dtype=np.float64),
        station=stations,
        approach=np.zeros(n),
        cycle=np.ones(n, dtype=np.intp),
        time_s=np.zeros(n),
        temperature_c=np.full(n, np.nan),
        mount=np.asarray(mounts, dtype=np.intp),
        indicator=np.zeros(n, dtype=np.intp),
        position_mm=np.zeros((n, 3)),
        movement=np.zeros((n, 3)),
    )


def tool_conditions(position_mm: ArrayLike, axis: int = 2) -> Conditions:
    """Conditions of readings of the tool at positions ``(n_readings, 3)`` from Zero, mm.

    One mounting, along one coordinate; else as `conditions`.
    """
    position = np.asarray(position_mm, dtype=np.float64)
    n = len(position)
    plain = conditions([TOOL] * n, [axis] * n, [0.0] * n, station=0.0)
    return replace(plain, position_mm=position)


def observe(
    taken: Conditions, value_mm: FloatArray, averaged: FloatArray | None = None
) -> Observations:
    """Observations from conditions and values, both with ``n_readings`` entries."""
    arrays = {f.name: getattr(taken, f.name) for f in fields(Conditions)}
    weight = np.ones(len(taken)) if averaged is None else np.asarray(averaged, dtype=np.float64)
    return Observations(**arrays, value_mm=np.asarray(value_mm, dtype=np.float64), averaged=weight)
