"""What was commanded and read, as arrays, and what every room does with columns.

A ``basis`` ``(n, r)`` has orthonormal columns. Where a rank is cut depends on what made the
columns, so each cut has its name and its reason here. Cuts of sums of squares are their squares.
What is chosen or sorted by computed numbers goes through `ranks`: legs, axes and stations of a
symmetrical machine give equal numbers but for rounding, and rounding differs between processors.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, Self, TypeVar

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


@dataclass(frozen=True, eq=False, repr=False)
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

    Where a stand slides on a reference plane, ``along_mm`` is the place of the touched point along
    the leg, from the tool at Zero, and ``station`` is that in the posture itself. Such a reading
    does not count from Zero; its mounting has a zero, and a tilt of the plane along the leg. NaN
    for all others.

    Where ``contact`` holds nothing was read: at the commanded position the tool was on a plate.
    The value is its height over the plate, 0 where it touches, and the zero that of the plate.
    What met the plate was ``beside_mm`` ``(n_readings, 3)`` from the tool: a probe; 0 for all else.
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
    along_mm: FloatArray
    contact: NDArray[np.bool_]
    beside_mm: FloatArray

    def __len__(self) -> int:
        return len(self.leg)

    def take(self, rows: NDArray[Any] | Sequence[int]) -> Self:
        """An object of this kind with only these rows (indices or a mask), numbered anew."""
        indices = np.asarray(rows)
        arrays = {f.name: getattr(self, f.name)[indices] for f in fields(self)}
        for name in ("mount", "indicator"):
            arrays[name] = numbered(arrays[name])
        return replace(self, **arrays)

    @cached_property
    def level(self) -> IntArray:
        """Numbers ``(n_readings,)`` of what the controller was told, by displacement first.

        Over a plane each station counts as one of its own.
        """
        station = np.where(self.over_plane, self.station, 0.0)
        return numbered(self.displacement_mm, *self.position_mm.T, station)

    @property
    def over_plane(self) -> NDArray[np.bool_]:
        """Whether a reference plane is what each reading counts from ``(n_readings,)``."""
        return ~np.isnan(self.along_mm)

    @property
    def approach_known(self) -> NDArray[np.bool_]:
        """Whether the last movement of a carriage is known ``(n_readings,)``."""
        return np.asarray((self.approach != 0.0) | self.movement.any(axis=1))

    @property
    def at_zero(self) -> NDArray[np.bool_]:
        """Whether the tool is commanded to Zero ``(n_readings,)``."""
        return np.asarray((self.displacement_mm == 0.0) & ~self.position_mm.any(axis=1))

    def posture_words(self, row: int) -> str:
        """``+60 mm`` or ``Zero`` for a leg, ``(0, 35, 10) mm`` for the tool."""
        if self.leg[row] == TOOL:
            return f"({', '.join(f'{round(v, 3) + 0.0:g}' for v in self.position_mm[row])}) mm"
        at = f" and {self.station[row]:g} of the bar" if self.over_plane[row] else ""
        displacement_mm = self.displacement_mm[row]
        return f"{displacement_mm:+g} mm{at}" if displacement_mm else f"Zero{at}"

    @cached_property
    def posture(self) -> IntArray:
        """Numbers ``(n_readings,)`` of the groups of one mounting, one posture and station."""
        return numbered(self.mount, self.station, self.level)

    @cached_property
    def cell(self) -> IntArray:
        """Numbers ``(n_readings,)`` of the groups of a posture approached from one side."""
        return numbered(self.mount, self.station, self.level, self.approach, *self.movement.T)

    @cached_property
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


@dataclass(frozen=True, eq=False, repr=False)
class Observations(Conditions):
    """Conditions with what the indicators showed.

    ``value_mm`` and ``averaged`` have shape ``(n_readings,)``; ``averaged`` is the number of
    readings that one value is the mean of and serves as its weight.
    """

    value_mm: FloatArray
    averaged: FloatArray


def joined(several: Sequence[Conditions]) -> Conditions:
    """All readings one after the other, each with set-ups and indicators of its own."""
    arrays = {
        f.name: np.concatenate([getattr(conditions, f.name) for conditions in several])
        for f in fields(Conditions)
    }
    for name in ("mount", "indicator"):
        parts = [getattr(conditions, name) for conditions in several]
        arrays[name] = numbered(
            np.repeat(np.arange(len(parts)), [len(part) for part in parts]), arrays[name]
        )
    return Conditions(**arrays)


def joined_values(values: Sequence[FloatArray]) -> FloatArray:
    """All values ``(n,)`` one after the other."""
    return np.concatenate(values) if values else np.empty(0)


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
    position_mm: ArrayLike | None = None,
) -> Conditions:
    """Conditions of a plain list of readings, one mounting for each leg, axis and station.

    Time, approach and cycle are zero and the temperature is not known: for tables of theory and
    for tests, where only the geometry matters. ``position_mm`` ``(3,)`` or ``(n, 3)`` is that of
    readings of the tool.
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
        position_mm=np.array(np.broadcast_to(0.0 if position_mm is None else position_mm, (n, 3))),
        movement=np.zeros((n, 3)),
        along_mm=np.full(n, np.nan),
        contact=np.zeros(n, dtype=np.bool_),
        beside_mm=np.zeros((n, 3)),
    )


def tool_conditions(position_mm: ArrayLike, axis: int = 2) -> Conditions:
    """Conditions of readings of the tool at positions ``(n_readings, 3)`` from Zero, mm.

    One mounting, along one coordinate; else as `conditions`.
    """
    position = np.asarray(position_mm, dtype=np.float64)
    n = len(position)
    return conditions([TOOL] * n, [axis] * n, [0.0] * n, station=0.0, position_mm=position)


def observe(
    conditions: Conditions, value_mm: FloatArray, averaged: FloatArray | None = None
) -> Observations:
    """Observations from conditions and values, both with ``n_readings`` entries."""
    arrays = {f.name: getattr(conditions, f.name) for f in fields(Conditions)}
    weight = (
        np.ones(len(conditions)) if averaged is None else np.asarray(averaged, dtype=np.float64)
    )
    return Observations(**arrays, value_mm=np.asarray(value_mm, dtype=np.float64), averaged=weight)


NEW_DIRECTION = 1e-3
"""Of columns of unit length: what is left of one beside all that is known, from which on it counts
as a direction of its own. An effect shows in less only from a thousand times its noise on."""

DEPENDENT = 1e-9
"""Relative, of columns of groups and derivatives of about one size, or of their products: what
depends on others is left with rounding, some 1e-15, all else with 1e-3 and more."""

EXACT_BLIND = 1e-10
"""Relative singular value below which exact derivatives show nothing; gaps found are 1e9."""

BLIND = 1e-6
"""The same whatever the derivatives: ten times what derivatives wrong by 1e-7 can feign."""

BLIND_IN_SQUARES = 1e-7
"""Root of a relative eigenvalue of scaled information: squares keep half the digits, and rounding
feigns 1e-8."""

ROUNDING = 1e-13
"""Relative singular value that is nothing but rounding: keeps logarithms and inverses finite."""

TINY = 1e-300


def onto(basis: FloatArray, rows: FloatArray) -> FloatArray:
    """The part of ``(n,)`` or ``(n, k)`` that lies in a basis ``(n, r)``."""
    return np.asarray(basis @ (basis.T @ rows))


def without(basis: FloatArray, rows: FloatArray) -> FloatArray:
    """The part of ``(n,)`` or ``(n, k)`` that a basis ``(n, r)`` leaves."""
    return np.asarray(rows - basis @ (basis.T @ rows))


def squares_in(basis: FloatArray, rows: FloatArray) -> float:
    """Square sum of the part that lies in a basis."""
    return float(((basis.T @ rows) ** 2).sum())


def lengths(columns: FloatArray) -> FloatArray:
    """Lengths ``(k,)`` of columns, fit to divide by."""
    return np.asarray(np.maximum(np.sqrt((columns**2).sum(axis=0)), TINY))


def basis_of(columns: FloatArray, cut: float, scale: float | None = None) -> FloatArray:
    """Basis ``(n, r)`` of columns ``(n, k)``.

    Singular values up to ``cut`` times ``scale`` do not count; the scale is the largest of them
    unless it is given: what the columns were before something was projected out.
    """
    vectors, singular, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(vectors[:, _counted(singular, cut, scale)])


def basis_by_products(columns: FloatArray) -> FloatArray:
    """Basis of few columns of many rows, quicker; they have a size of 1 or more, or are nothing."""
    square, axes = np.linalg.eigh(columns.T @ columns)
    visible = square > DEPENDENT * max(float(square[-1]), DEPENDENT)
    return np.asarray(columns @ (axes[:, visible] / np.sqrt(square[visible])))


def rank_of(columns: FloatArray, cut: float, scale: float | None = None) -> int:
    """Rank of columns ``(n, k)``, cut as in `basis_of`."""
    singular = np.asarray(np.linalg.svd(columns, compute_uv=False), dtype=np.float64)
    return int(_counted(singular, cut, scale).sum())


def _counted(singular: FloatArray, cut: float, scale: float | None) -> NDArray[np.bool_]:
    return np.asarray(singular > cut * (singular.max(initial=0.0) if scale is None else scale))


def null_space(rows: FloatArray) -> FloatArray:
    """Basis ``(k, k - n)`` of what is orthogonal to independent rows ``(n, k)``."""
    return np.asarray(np.linalg.qr(rows.T, mode="complete")[0][:, len(rows) :])


def svd_of_all(rows: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Left ``(n, k)``, values ``(k,)`` and right ``(k, k)`` of ``(n, k)``, however few rows."""
    count = rows.shape[1]
    padded = np.vstack([rows, np.zeros((max(count - len(rows), 0), count))])
    left_vectors, singular, right = np.linalg.svd(padded, full_matrices=False)
    return left_vectors[: len(rows)], singular, right


def condition(rows: FloatArray, rank: int) -> float:
    """Largest by smallest of the singular values that count, columns as they are."""
    singular = np.linalg.svd(rows, compute_uv=False)
    return float(singular[0] / singular[rank - 1]) if rank else np.inf


def named_inside(
    space: FloatArray, motions: Sequence[tuple[str, FloatArray]]
) -> tuple[list[tuple[FloatArray, str]], FloatArray]:
    """Vectors of unit length with names that lie in a space, each a new one; a basis of the rest.

    ``space`` ``(k, r)`` is a basis.
    """
    directions, remainder = [], space
    for name, vector in motions:
        unit = vector / np.linalg.norm(vector)
        inside = onto(remainder, unit)
        if np.linalg.norm(without(space, unit)) < BLIND < np.linalg.norm(inside):
            directions.append((unit, name))
            inside = inside / np.linalg.norm(inside)
            # the singular values that are left are one and, once, zero
            remainder = basis_of(without(inside[:, None], remainder), 0.5, 1.0)
    return directions, remainder


def names_outside(space: FloatArray, names: Sequence[str]) -> tuple[str, ...]:
    """Names of coordinates that have no share in a space ``(k, r)``."""
    share = np.sqrt((space**2).sum(axis=1))
    return tuple(name for name, part in zip(names, share, strict=True) if part < BLIND)


def incidence(group: IntArray) -> FloatArray:
    """One column for each group ``(n, groups)``, 1 in its rows; groups are numbered from 0."""
    return np.asarray(np.eye(int(group.max(initial=-1)) + 1)[group])


def without_means(group: IntArray, weight: FloatArray, rows: FloatArray) -> FloatArray:
    """Subtract from the rows ``(n, ...)`` of each group their mean, weighted by ``(n,)``."""
    total = np.bincount(group, weight)
    flat = rows.reshape(len(rows), -1)
    means = np.empty((len(total), flat.shape[1]))
    for k, column in enumerate(flat.T):
        means[:, k] = np.bincount(group, weight * column) / total
    return np.asarray((flat - means[group]).reshape(rows.shape))


def tilts(conditions: Conditions) -> FloatArray:
    """Columns ``(n_readings, k)`` of the tilt of the plane under each mounting over one, per mm."""
    over = np.flatnonzero(conditions.over_plane)
    mount = numbered(conditions.mount[over])
    columns = np.zeros((len(conditions), int(mount.max(initial=-1)) + 1))
    columns[over, mount] = conditions.along_mm[over]
    return columns


def without_zeros(conditions: Conditions, weight: FloatArray, rows: FloatArray) -> FloatArray:
    """Rows ``(n_readings, ...)`` less the best zero of each mounting and tilt of each plane.

    The best zero of a mounting is the mean of what the model leaves, weighted by ``(n_readings,)``,
    so this done to residuals and design fits them all at once.
    """
    centred = without_means(conditions.mount, weight, rows)
    columns = tilts(conditions)
    if not columns.shape[1]:
        return centred
    root = np.sqrt(weight)[:, None]
    basis = basis_of(root * without_means(conditions.mount, weight, columns), DEPENDENT)
    flat = without(basis, root * centred.reshape(len(root), -1)) / root
    return np.asarray(flat.reshape(rows.shape))


def set_up_unknowns(conditions: Conditions) -> int:
    """How many zeros and tilts that takes."""
    columns = tilts(conditions)
    if not columns.size:
        return conditions.mount_count
    columns_beside = without_means(conditions.mount, np.ones(len(conditions)), columns)
    return conditions.mount_count + int(basis_of(columns_beside, DEPENDENT).shape[1])


One = TypeVar("One")

TIE = 1e-9
"""Relative difference that is rounding: kernels differ by 1e-16 in one operation, by up to 1e-10
where matrices of condition 1e6 are solved. No figure shown to people has nine digits."""


def ranks(values: FloatArray, unit: float = 0.0) -> IntArray:
    """Rank of each of ``(n,)``, 0 for the largest; those alike within rounding share one.

    Numbers that may cancel to nothing, such as logarithms, need the ``unit`` that is one of them:
    what rounding leaves is judged beside it.
    """
    order = np.argsort(-values, kind="stable")
    sorted_down = values[order]
    above, below = sorted_down[:-1], sorted_down[1:]
    size = np.maximum(np.maximum(np.abs(above), np.abs(below)), unit)
    with np.errstate(invalid="ignore"):
        apart = np.where(np.isfinite(size), above - below > TIE * size, above != below)
    rank = np.empty(len(values), dtype=np.intp)
    rank[order] = np.concatenate([[0], np.cumsum(apart)])[: len(values)]
    return rank


def largest(values: FloatArray, unit: float = 0.0) -> int:
    """Index of the largest of any shape, flattened; the first of those alike."""
    maximum = float(values.max())
    least = maximum - TIE * max(abs(maximum), unit) if np.isfinite(maximum) else maximum
    return int((values >= least).argmax())


def descending(things: Iterable[One], size: Callable[[One], float], unit: float = 0.0) -> list[One]:
    """The things by size, the largest first; those alike stay in the order in which they came."""
    items = list(things)
    order = np.argsort(ranks(np.array([size(item) for item in items]), unit), kind="stable")
    return [items[k] for k in order]
