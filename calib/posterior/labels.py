"""Mistakes of labels and of single readings: other designs for the same readings.

Every exchange of labels puts readings elsewhere in the table; a stand that moved, a first take and
a wild reading get zeros of their own. So each mistake is a session with the same number of
readings, and its evidence compares with that of the session as it is written. Two mistakes that
leave the same readings have equal evidence: both come back, and neither alone is the answer.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Generic, TypeVar

import numpy as np

from calib.arrays import (
    LEG_NAMES,
    TOUCHED_LETTERS,
    FloatArray,
    IntArray,
    Observations,
    incidence,
    numbered,
    rows_of,
    tilts,
    without_means,
)
from calib.errors import NotIdentifiable
from calib.identify.fit import design_of
from calib.posterior.readings import BASE, Cells
from calib.tripod.pipeline import Model

INCH_MM = 25.4

PRIOR = {
    "first_take": 0.02,
    "wild_reading": 0.003,
    "stand_slip": 0.003,
    "gauge_swap": 0.003,
    "legs_exchanged": 0.003,
    "tables_exchanged": 0.001,
    "postures_exchanged": 0.003,
    "gauge_sign": 0.003,
    "unit_mixup": 0.003,
}
"""Of a session; shared by all places of a kind."""

WILD_OCTAVES = math.log(1000.0)
"""A reading that is wrong is off by anything between 10 µm and 10 mm, each octave alike."""

MOST = 3
"""Mistakes of one session that are looked for together."""

TRIED = 12
"""Mistakes that are fitted, of which `RACED` are compared with all that may be true."""
RACED = 4

DOUBTED = 5.0
"""Of log evidence below the best: what is less likely than that is not tried."""

FITS = 1.0
"""Standard deviations of the square sum above what noise leaves up to which labels fit."""

MOST_VALUES = 2_000_000
"""Values of exchanges that are held at once."""

VISITS_OF_CYCLE = 16
"""Of cycles of more visits only neighbours are tried as exchanged."""


@dataclass(frozen=True, eq=False)
class Mistake:
    """One mistake: its name, place and words, the visits it touches, and the visits put right.

    ``log_prior`` is that of the mistake, with the density of what it makes of readings.
    """

    id: str
    where: str
    title: str
    rows: IntArray
    visited: Observations
    log_prior: float


@dataclass(frozen=True, eq=False)
class _Exchange:
    """Values of rows ``here`` that belong to ``there``, and of ``there`` to ``here``; a factor."""

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


def exchanges(visited: Observations) -> Iterator[_Exchange]:
    """Every exchange of labels: of indicators, legs, tables, postures; sign and unit."""
    yield from _tables(visited)
    yield from _postures(visited)
    moved = np.abs(without_means(visited.mount, visited.averaged, visited.value_mm))
    for where, rows in _groups(visited):
        if moved[rows].max() > 1e-9:  # a factor would change zeros of mountings only
            yield _Exchange("gauge_sign", where, "sign reversed", rows, rows, -1.0)
            yield _Exchange("unit_mixup", where, "inch recorded as mm", rows, rows, INCH_MM)
            yield _Exchange("unit_mixup", where, "mm recorded as inch", rows, rows, 1.0 / INCH_MM)


def _groups(visited: Observations) -> list[tuple[str, IntArray]]:
    """Rows that one indicator may have taken: a mounting, a place, one of the indicators."""
    places = [*visited.mountings, *rows_of(numbered(visited.leg, visited.axis))]
    groups = [(place_of(visited, rows), rows) for rows in places]
    indicators = enumerate(rows_of(visited.indicator), start=1)
    groups += [(f"indicator {number}", rows) for number, rows in indicators]
    every = {tuple(rows.tolist()): (where, rows) for where, rows in reversed(groups)}
    return [group for key, group in every.items() if len(key) < len(visited)]


def _tables(visited: Observations) -> Iterator[_Exchange]:
    """Tables of a leg and axis exchanged: two of a leg, of two legs, or all of two legs."""
    stations = np.unique(visited.station[visited.leg >= 0]).tolist()
    for of in ([stations] if len(stations) > 1 else []) + [[one] for one in stations]:
        there = np.isin(visited.station, of) & ~visited.over_plane
        at = "" if len(of) == len(stations) else f" at station {of[0]:g}"
        tables = {
            (leg, axis): np.flatnonzero(there & (visited.leg == leg) & (visited.axis == axis))
            for leg in range(3)
            for axis in range(3)
            if leg != axis
        }
        for one, other in combinations(tables, 2):
            pair = _matched(visited, tables[one], tables[other])
            if pair and one[0] == other[0]:
                where = LEG_NAMES[one[0]]
                yield _Exchange("gauge_swap", where, f"indicators exchanged{at}", *pair)
            elif pair:
                where = ",".join(LEG_NAMES[leg] + LEG_NAMES[axis] for leg, axis in (one, other))
                yield _Exchange("tables_exchanged", where, f"their tables exchanged{at}", *pair)
        for a, b in combinations(range(3), 2):
            third = 3 - a - b
            for axes in ((a, third), (third, a)):
                pairs = [
                    _matched(visited, tables[a, axis], tables[b, other])
                    for axis, other in zip((b, third), axes, strict=True)
                ]
                if pairs[0] and pairs[1]:
                    where = LEG_NAMES[a] + "," + LEG_NAMES[b]
                    both = [np.concatenate(rows) for rows in zip(*pairs, strict=True)]  # type: ignore[arg-type]
                    yield _Exchange("legs_exchanged", where, f"their tables exchanged{at}", *both)


def _matched(
    visited: Observations, one: IntArray, other: IntArray
) -> tuple[IntArray, IntArray] | None:
    """Rows of two tables with the same postures in the same cycles; None where these differ."""
    if not len(one) or len(one) != len(other):
        return None
    keys = [(visited.cycle[rows], visited.level[rows]) for rows in (one, other)]
    first, second = (np.lexsort(key) for key in keys)
    for k in range(2):
        if not np.array_equal(keys[0][k][first], keys[1][k][second]):
            return None
    return one[first], other[second]


def _postures(visited: Observations) -> Iterator[_Exchange]:
    """Two visits of a cycle, or two postures of all cycles, of one indicator or of a whole leg."""
    stands = numbered(visited.leg, visited.station, visited.over_plane)
    for stand in rows_of(stands):
        mountings = [stand[rows] for rows in rows_of(numbered(visited.mount[stand]))]
        sets = [[rows] for rows in mountings]
        if len(mountings) > 1 and len({len(rows) for rows in mountings}) == 1:
            sets.append(mountings)
        for members in sets:
            where = place_of(visited, members[0])
            where = where if len(members) == 1 else where[0]
            cycle, level = visited.cycle[members[0]], visited.level[members[0]]
            for i, j, title in _pairs(visited, members[0], cycle, level):
                here = np.concatenate([rows[i] for rows in members])
                there = np.concatenate([rows[j] for rows in members])
                yield _Exchange("postures_exchanged", where, title, here, there)


def _pairs(
    visited: Observations, rows: IntArray, cycle: IntArray, level: IntArray
) -> Iterator[tuple[IntArray, IntArray, str]]:
    """Places in a mounting whose values may be exchanged, and words for it."""
    for number in np.unique(cycle).tolist():
        mine = np.flatnonzero(cycle == number)
        near = 1 if len(mine) > VISITS_OF_CYCLE else len(mine)
        for first, i in enumerate(mine):
            for j in mine[first + 1 : first + 1 + near]:
                if level[i] != level[j]:
                    words = " and ".join(visited.posture_words(int(rows[k])) for k in (i, j))
                    title = f"{words} exchanged in cycle {number}"
                    yield np.array([i]), np.array([j]), title
    if len(np.unique(cycle)) == 1 or len(np.unique(level)) > VISITS_OF_CYCLE:
        return
    for one, other in combinations(np.unique(level).tolist(), 2):
        here, there = np.flatnonzero(level == one), np.flatnonzero(level == other)
        count = min(len(here), len(there))
        # of a first or last visit more than the others have, either may be the one that is right
        for i, j in {
            (tuple(here[:count]), tuple(there[:count])),
            (tuple(here[-count:]), tuple(there[-count:])),
        }:
            words = " and ".join(visited.posture_words(int(rows[k])) for k in (i[0], j[0]))
            yield np.array(i), np.array(j), f"{words} exchanged in all cycles"


def place_of(observed: Observations, rows: IntArray) -> str:
    """Leg (or ``t``, the tool) and axis of the first of these rows, in letters."""
    first = rows[0]
    return TOUCHED_LETTERS[observed.leg[first]] + LEG_NAMES[observed.axis[first]]


def words_of(observed: Observations, row: int) -> str:
    """Posture and cycle of a reading."""
    return f"at {observed.posture_words(row)}, cycle {observed.cycle[row]}"


@dataclass(frozen=True, eq=False)
class Beside:
    """A model that may be true beside a mistake: its log weight, and columns ``(n_cells, r)``.

    The columns are of the session, each of the size that the model expects.
    """

    log_weight: float
    columns: FloatArray


@dataclass(frozen=True, eq=False)
class _Screen:
    """Visits of one session about a model: what is left of other values of the same rows.

    ``basis`` ``(n + p, r)`` are zeros, base parameters and columns beside them, with their
    expectations as ``p`` rows; all visits have the middle variance of the indicators.
    """

    visited: Observations
    predicted_mm: FloatArray
    root: FloatArray
    basis: FloatArray
    expected: FloatArray
    freedom: float
    known: bool

    @classmethod
    def of(cls, cells: Cells, model: Model, columns: FloatArray) -> _Screen:
        """About a model of the session."""
        visited = cells.visited
        root = np.sqrt(_even_mm2(cells))
        spread = cells.case.tolerance_mm
        derivatives = design_of(model, visited, range(BASE), ()) * spread
        expected = (np.array(cells.case.model.parameters_mm) - model.parameters_mm) / spread
        zeros = np.hstack([incidence(visited.mount), tilts(visited)])
        shown = np.hstack([zeros, derivatives, columns[cells.cell]]) / root[:, None]
        below = np.hstack(
            [np.zeros((BASE + columns.shape[1], zeros.shape[1])), np.eye(BASE + columns.shape[1])]
        )
        basis = np.linalg.qr(np.vstack([shown, below]))[0]
        target = np.concatenate([expected, np.zeros(columns.shape[1])])
        freedom = len(visited) - zeros.shape[1] - 3.0
        known = cells.noise is not None and math.isinf(cells.noise.degrees_of_freedom)
        return cls(visited, model.readings(visited), root, basis, target, freedom, known)

    def left(self, value_mm: FloatArray) -> FloatArray:
        """What is left ``(n + p, k)`` of values ``(n, k)``."""
        rows = (value_mm - self.predicted_mm[:, None]) / self.root[:, None]
        expected = np.repeat(self.expected[:, None], rows.shape[1], axis=1)
        rows = np.vstack([rows, expected])
        return np.asarray(rows - self.basis @ (self.basis.T @ rows))

    def log_likelihood(
        self, square: FloatArray | float, freedom: float | None = None
    ) -> FloatArray:
        """Of what is left, but for what does not depend on it."""
        if self.known:
            return np.asarray(-0.5 * np.asarray(square))
        free = self.freedom if freedom is None else freedom
        return np.asarray(
            math.lgamma(free / 2.0) - 0.5 * free * np.log(np.maximum(square, 1e-9) / 2.0)
        )


def _even_mm2(cells: Cells) -> FloatArray:
    """Variance of each visit ``(n,)``, of the middle of the indicators: none in another unit."""
    noise = cells.noise
    if noise is None:
        return cells.scatter_mm2
    middle = float(np.median([one.variance_mm2 for one in noise.indicators]))
    return np.maximum(middle / cells.visited.averaged, 1e-10)


def suspects(cells: Cells, beside: Sequence[Beside], log_evidence: float) -> list[Mistake]:
    """Mistakes of a session that may be likelier than none, the likeliest first.

    ``beside`` are models of the session as it is, the plain one first, ``log_evidence`` that of all
    of them.
    """
    try:
        model = cells.model
    except NotIdentifiable:
        model = cells.case.model
    scored: dict[tuple[str, str, str], tuple[float, Mistake]] = {}
    for one in beside:
        screen = _Screen.of(cells, model, one.columns)
        for score, mistake in _scores(cells, screen):
            key = (mistake.id, mistake.where, mistake.title)
            whole = one.log_weight + score
            if key not in scored or scored[key][0] < whole:
                scored[key] = (whole, mistake)
    likely = [each for each in scored.values() if each[0] > log_evidence - DOUBTED]
    likely = sorted(likely, key=lambda each: -each[0])[:TRIED]
    if len(likely) <= RACED:
        return [mistake for _, mistake in likely]
    fitted = [(max(score, beside[0].log_weight + _gain(cells, m)), m) for score, m in likely]
    return [mistake for _, mistake in sorted(fitted, key=lambda each: -each[0])[:RACED]]


def _gain(cells: Cells, mistake: Mistake) -> float:
    """Log likelihood that a mistake adds in its own plain fit, its prior included."""
    square = []
    for each in (cells, Cells.of_visits(cells.case, mistake.visited)):
        try:
            screen = _Screen.of(each, each.model, np.zeros((len(each.means), 0)))
        except NotIdentifiable:
            return -math.inf
        screen = replace(screen, root=np.sqrt(_even_mm2(cells)))
        square.append(float((screen.left(each.visited.value_mm[:, None]) ** 2).sum()))
    before, after = screen.log_likelihood(np.array(square), screen.freedom)
    return float(after - before) + mistake.log_prior


def _scores(cells: Cells, screen: _Screen) -> Iterator[tuple[float, Mistake]]:
    """Mistakes with the log likelihood that each adds, its prior included."""
    left = screen.left(cells.visited.value_mm[:, None])[:, 0]
    square = float(left @ left)
    yield from _apart(screen, left, square)
    if (
        square > screen.freedom + FITS * math.sqrt(2.0 * max(screen.freedom, 0.0))
        or cells.noise is None
    ):
        yield from _exchanged(screen, square)


def _exchanged(screen: _Screen, square: float) -> Iterator[tuple[float, Mistake]]:
    visited = screen.visited
    every = list(exchanges(visited))
    names = [one.id for one in every]
    squares = np.empty(len(every))
    at_once = max(MOST_VALUES // max(len(visited), 1), 1)
    for first in range(0, len(every), at_once):
        some = every[first : first + at_once]
        values = np.column_stack([one.put_right(visited.value_mm) for one in some])
        squares[first : first + at_once] = (screen.left(values) ** 2).sum(axis=0)
    more = screen.log_likelihood(squares) - screen.log_likelihood(square)
    for k in np.argsort(-more, kind="stable")[: 4 * TRIED].tolist():
        one = every[k]
        rows = np.union1d(one.here, one.there)
        log_prior = math.log(PRIOR[one.id] / names.count(one.id))
        # readings of a mounting but one: its zero is free whatever the unit
        free = len(rows) - len(np.unique(visited.mount[rows]))
        log_prior += free * math.log(abs(one.factor))
        right = replace(visited, value_mm=one.put_right(visited.value_mm))
        mistake = Mistake(one.id, one.where, one.title, rows, right, log_prior)
        yield float(more[k]) + log_prior, mistake


def _apart(screen: _Screen, left: FloatArray, square: float) -> Iterator[tuple[float, Mistake]]:
    """Readings with a zero of their own: single ones, first takes, all after a stand moved."""
    visited, count = screen.visited, len(screen.visited)
    basis, root = screen.basis[:count], screen.root
    first = np.unique(visited.mount, return_index=True)[1]
    groups: list[tuple[str, str, str, list[IntArray], int]] = []
    one_alone = left[:count] ** 2 / np.maximum(1.0 - (basis**2).sum(axis=1), 1e-6)
    for row in np.argsort(-one_alone, kind="stable")[:TRIED].tolist():
        title = f"one outlier {words_of(visited, row)}"
        groups.append(
            ("wild_reading", place_of(visited, np.array([row])), title, [np.array([row])], count)
        )
    stands = numbered(visited.leg[first], visited.station[first], visited.over_plane[first])
    for members in rows_of(stands):
        where = TOUCHED_LETTERS[visited.leg[first[members[0]]]]
        groups.append(("first_take", where, _FIRST, [np.array([row]) for row in first[members]], 3))
    if stands.max(initial=0):
        groups.append(("first_take", "all", _FIRST, [np.array([row]) for row in first], 3))
    for rows in visited.mountings:
        groups += [
            (
                "stand_slip",
                place_of(visited, rows),
                "the stand moved before the reading " + words_of(visited, int(rows[k])),
                [rows[k:]],
                count,
            )
            for k in _clearest_steps(left, basis, root, rows)
        ]
    for name, where, title, moved, share in groups:
        columns = np.zeros((len(screen.basis), len(moved)))
        for k, rows in enumerate(moved):
            columns[rows, k] = 1.0 / root[rows]
        columns -= screen.basis @ (screen.basis.T @ columns)
        inner = columns.T @ columns
        size, axes = np.linalg.eigh(inner)
        if size[0] < 1e-6 / float(root.max()) ** 2:
            continue
        off_mm = np.linalg.solve(inner, columns.T @ left)
        after = square - float(off_mm @ inner @ off_mm)
        more = screen.log_likelihood(after, screen.freedom - len(moved))
        more = more - screen.log_likelihood(square)
        room = 0.5 * (len(moved) * math.log(2.0 * math.pi) - float(np.log(size).sum()))
        log_sizes = -np.log(2.0 * WILD_OCTAVES * np.maximum(np.abs(off_mm), root.min())).sum()
        log_prior = math.log(PRIOR[name] / share) + float(log_sizes)
        mount = visited.mount.copy()
        for k, rows in enumerate(moved):
            mount[rows] = visited.mount_count + k
        right = replace(visited, mount=numbered(mount))
        rows = np.concatenate(moved)
        mistake = Mistake(name, where, title, rows, right, log_prior)
        yield float(more) + room + log_prior, mistake


_FIRST = "the first take stands apart: it settled, stood within a play or was another posture"


def _clearest_steps(
    left: FloatArray, basis: FloatArray, root: FloatArray, rows: IntArray
) -> list[int]:
    """The rows of a mounting, counted, from which on a shift explains most; not at its ends."""
    if len(rows) < 4:
        return []
    along = np.cumsum((left[rows] / root[rows])[::-1])[::-1]
    shown = np.cumsum((basis[rows] / root[rows, None])[::-1], axis=0)[::-1]
    size = np.cumsum((1.0 / root[rows] ** 2)[::-1])[::-1] - (shown**2).sum(axis=1)
    gain = np.where(size > 1e-6 * size.max(), along**2 / np.maximum(size, 1e-12), 0.0)
    order = 2 + np.argsort(-gain[2:-1], kind="stable")
    return [int(k) for k in order[:2]]


Solution = TypeVar("Solution")


@dataclass(frozen=True, eq=False)
class Solved(Generic[Solution]):
    """Sessions with what may be true of them: the log evidence, and models of each session."""

    solution: Solution
    log_evidence: float
    beside: Sequence[Sequence[Beside]]
    mistakes: tuple[Mistake, ...] = field(default=())

    @property
    def log_weight(self) -> float:
        """With the priors of its mistakes."""
        return self.log_evidence + sum(one.log_prior for one in self.mistakes)


def with_mistakes(
    sessions: Sequence[Cells],
    solve: Callable[[Sequence[Cells]], Solved[Solution]],
) -> list[Solved[Solution]]:
    """The sessions as they are, and put right in each way that may be true; the likeliest first.

    One mistake after the other: each is looked for in the readings that the likeliest ones before
    leave.
    """
    every = [solve(sessions)]
    best, now = every[0], list(sessions)
    for _ in range(MOST):
        tried = []
        for number, cells in enumerate(now):
            for mistake in suspects(cells, best.beside[number], best.log_evidence):
                try:
                    right = Cells.of_visits(cells.case, mistake.visited)
                    others = [*now[:number], right, *now[number + 1 :]]
                    solved = solve(others)
                except NotIdentifiable:
                    continue
                solved = replace(solved, mistakes=(*best.mistakes, mistake))
                tried.append((solved, others))
        every += [solved for solved, _ in tried]
        better = max(tried, key=lambda each: each[0].log_weight, default=None)
        if better is None or better[0].log_weight < best.log_weight:
            break
        best, now = better
    return sorted(every, key=lambda each: -each.log_weight)
