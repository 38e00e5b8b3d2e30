"""Mistakes in the data: what an operator or a cable does to a table of readings."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tests.blind.effects import LETTERS
from tests.blind.forward import FloatArray, Rows

INCH_MM = 25.4
CLEAR = 15.0  # a blunder changes readings by at least so many times the noise


@dataclass(frozen=True, eq=False)
class Table:
    """What is written down: rows, which may carry wrong labels, and values ``(n,)``."""

    rows: Rows
    values_mm: FloatArray


@dataclass(frozen=True)
class Place:
    """Where the blunder sits: every answer that is right."""

    where: tuple[str, ...]


def commit(
    blunder: str, table: Table, noise_mm: float, rng: np.random.Generator
) -> tuple[Table, Place]:
    """The table with one mistake that is large enough to matter. Raises ValueError if none is."""
    for _ in range(60):
        changed, place = _once(blunder, table, noise_mm, rng)
        if _worst(table, changed) > CLEAR * noise_mm:
            return changed, place
    raise ValueError(f"{blunder} does not show in this session: draw another machine")


def _worst(before: Table, after: Table) -> float:
    """Largest change of a reading against its mounting, labels included."""
    if after.rows is before.rows:
        change = after.values_mm - before.values_mm
        means = [change[before.rows.mount == m].mean() for m in range(before.rows.mount.max() + 1)]
        return float(np.abs(change - np.array(means)[before.rows.mount]).max())
    wrong = np.flatnonzero(
        (after.rows.mount != before.rows.mount)
        | (after.rows.displacement_mm != before.rows.displacement_mm)
    )[0]
    alike = (before.rows.mount == after.rows.mount[wrong]) & (
        before.rows.displacement_mm == after.rows.displacement_mm[wrong]
    )
    return float(np.abs(before.values_mm[alike].mean() - before.values_mm[wrong]))


def _once(
    blunder: str, table: Table, noise_mm: float, rng: np.random.Generator
) -> tuple[Table, Place]:
    rows = table.rows
    leg = int(rng.integers(3))
    axis = (leg + int(rng.integers(1, 3))) % 3
    pair = (rows.leg == leg) & (rows.axis == axis)
    if rng.random() < 0.5:  # one mounting only, or the indicator wherever it was mounted
        pair &= rows.mount == rng.choice(np.unique(rows.mount[pair]))
    here = Place((LETTERS[leg] + LETTERS[axis],))
    match blunder:
        case "gauge_sign":
            return _scaled(table, pair, -1.0), here
        case "unit_mixup":
            return _scaled(table, pair, INCH_MM if rng.random() < 0.5 else 1 / INCH_MM), here
        case "gauge_swap":
            return _swapped(table, leg), Place((LETTERS[leg],))
        case "stand_slip":
            return _slipped(table, pair, noise_mm, rng), here
        case "label_error":
            return _mislabelled(table, pair, rng)
        case "wild":
            return _wild(table, pair, noise_mm, rng), here
    raise ValueError(f"blunder {blunder!r} is not known")


def _scaled(table: Table, gauge_rows: np.ndarray, factor: float) -> Table:
    return replace(table, values_mm=np.where(gauge_rows, factor, 1.0) * table.values_mm)


def _swapped(table: Table, leg: int) -> Table:
    """Rows of a visit stand beside each other: first axis, second axis."""
    values = table.values_mm.copy()
    gauge_rows = np.flatnonzero(table.rows.leg == leg)
    values[gauge_rows] = values[gauge_rows].reshape(-1, 2)[:, ::-1].ravel()
    return replace(table, values_mm=values)


def _slipped(table: Table, pair: np.ndarray, noise_mm: float, rng: np.random.Generator) -> Table:
    """One mounting is shifted from some reading on; not at its very ends."""
    mount = rng.choice(np.unique(table.rows.mount[pair]))
    gauge_rows = np.flatnonzero(table.rows.mount == mount)
    first = int(rng.integers(len(gauge_rows) // 4, 3 * len(gauge_rows) // 4 + 1))
    values = table.values_mm.copy()
    size = CLEAR * float(np.exp(rng.uniform(np.log(1.5), np.log(10.0))))
    values[gauge_rows[first:]] += rng.choice([-1, 1]) * size * noise_mm
    return replace(table, values_mm=values)


def _wild(table: Table, pair: np.ndarray, noise_mm: float, rng: np.random.Generator) -> Table:
    values = table.values_mm.copy()
    row = rng.choice(np.flatnonzero(pair))
    values[row] += rng.choice([-1, 1]) * rng.uniform(1.5, 10) * CLEAR * noise_mm
    return replace(table, values_mm=values)


def _mislabelled(table: Table, pair: np.ndarray, rng: np.random.Generator) -> tuple[Table, Place]:
    """One row under another posture, or under the leg that has the same axis."""
    rows = table.rows
    row = int(rng.choice(np.flatnonzero(pair)))
    leg, axis = int(rows.leg[row]), int(rows.axis[row])
    second = 3 - leg - axis
    right = LETTERS[leg] + LETTERS[axis]
    if rng.random() < 0.5:
        levels = rows.displacement_mm.copy()
        levels[row] = rng.choice(np.unique(levels[levels != levels[row]]))
        return replace(table, rows=replace(rows, displacement_mm=levels)), Place((right, right[0]))
    legs, mounts = rows.leg.copy(), rows.mount.copy()
    rows_there = (rows.leg == second) & (rows.axis == axis) & (rows.station == rows.station[row])
    legs[row], mounts[row] = second, rows.mount[rows_there][0]
    wrong = LETTERS[second] + LETTERS[axis]
    places = Place((right, wrong, right[0], wrong[0]))
    return replace(table, rows=replace(rows, leg=legs, mount=mounts)), places
