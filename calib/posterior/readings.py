"""Sessions as one linear problem of few rows: means of cells, and what their readings do in time.

What depends on time differs within a cell; a QR decomposition keeps of that exactly what such
columns can show. The cost of everything after goes with cells.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, combinations, pairwise, starmap

import numpy as np
from scipy.sparse import block_diag  # scipy.linalg would take 0.04 s more to import

from calib.arrays import FloatArray, IntArray, set_up_unknowns
from calib.identify.fit import design_of
from calib.posterior.cells import BASE, Cells, SessionCase
from calib.posterior.library import ELSE, OTHER_BARS, Component, other_bars, something_else
from calib.tripod.effects.candidates import placed_columns
from calib.tripod.effects.effect import Effect, Kind, Placed
from calib.tripod.pipeline import Model

LENGTHS = BASE - 3


def depends_on_time(effect: Effect) -> bool:
    """Whether readings of one cell may differ by it."""
    return effect.kind == Kind.ENVIRONMENT or "per_" in effect.parameters[0].name


@dataclass(frozen=True, eq=False)
class Rows:
    """Readings of all sessions about a model of each, whitened, their zeros free.

    ``residual`` ``(n,)`` is measured less predicted; ``base`` ``(n, b)`` are derivatives by the
    lengths that sessions share, then by the joint offsets of each; ``columns`` ``(n, k)`` those of
    laws, each in its ``places``. The first ``cells`` rows are means of cells; up to ``exact``
    follow distances between marks; the others are what readings do within cells.
    ``value`` ``(b,)`` is where the models have the base parameters, ``prior`` ``(b,)`` where they
    are expected, within ``spread`` ``(b,)``; ``whitening`` ``(b, b)`` makes what is expected of
    them, in these standard deviations, independent. ``free`` directions are left to readings beside
    zeros and joint offsets; ``freedom`` belongs to the noise. ``excess`` is the square sum of
    repeats that disagree, ``log_constant`` what evidences of other labels differ by as well.
    """

    residual: FloatArray
    base: FloatArray
    columns: FloatArray
    places: dict[Placed, slice]
    cells: int
    exact: int
    value: FloatArray
    prior: FloatArray
    spread: FloatArray
    whitening: FloatArray
    free: int
    freedom: float
    excess: float
    log_constant: float


def rows_of(
    sessions: Sequence[Cells],
    models: Sequence[Model],
    placed_laws: Sequence[Mapping[Placed, FloatArray]],
    *,
    within: bool = True,
) -> Rows:
    """The sessions about these models; ``placed_laws`` are columns of laws in each, zero elsewhere.

    Without ``within`` only the means of cells, and distances.
    """
    laws = dict.fromkeys(law for by_law in placed_laws for law in by_law)
    ends = [*accumulate((len(effect.parameters) for effect, _ in laws), initial=0)]
    places = dict(zip(laws, starmap(slice, pairwise(ends)), strict=True))
    width = LENGTHS + 3 * len(sessions)

    def block(
        number: int, residual: FloatArray, by_base: FloatArray, by_law: Mapping[Placed, FloatArray]
    ) -> FloatArray:
        """Rows of a session: what is left, lengths, joint offsets of every session, laws."""
        base, columns = np.zeros((len(residual), width)), np.zeros((len(residual), ends[-1]))
        base[:, :LENGTHS] = by_base[:, 3:]
        base[:, LENGTHS + 3 * number : LENGTHS + 3 * number + 3] = by_base[:, :3]
        for law, by_values in by_law.items():
            columns[:, places[law]] = by_values
        return np.column_stack([residual, base, columns])

    parts, measured, in_time = [], [], []
    for number, (cells, model, by_law) in enumerate(
        zip(sessions, models, placed_laws, strict=True)
    ):
        means, visits, distances = cells.means, cells.visits, cells.case.distances
        left_mm = means.value_mm - model.readings(means)
        by_base = design_of(model, means, range(BASE), ())
        parts.append(cells.whitened(block(number, left_mm, by_base, by_law)))
        if len(distances):
            residual, by_base = distances.residual(model), distances.by_base(model)
            measured.append(block(number, residual, by_base, distances.by_laws(model, laws)))
        timed = [law for law in by_law if depends_on_time(law[0])]
        if within and timed and len(visits) > len(means):
            effects = list(dict.fromkeys(effect for effect, _ in timed))
            by_timed = placed_columns(model, visits, effects, timed)
            columns = np.hstack([by_timed[law] for law in timed])
            rows = cells.in_time(columns, visits.value_mm - model.readings(visits))
            starts = np.cumsum([1, *(by_timed[law].shape[1] for law in timed)])
            residual, *split = np.split(rows, starts[:-1], axis=1)
            no_base = np.zeros((len(rows), BASE))
            in_time.append(block(number, residual, no_base, dict(zip(timed, split, strict=True))))
    rows = np.vstack([*parts, *measured, *in_time])

    def base_of(values: Sequence[Sequence[float] | FloatArray]) -> FloatArray:
        return np.concatenate([values[0][3:], *(of_session[:3] for of_session in values)])

    free = len(rows) + sum(len(cells.apart) for cells in sessions)
    free -= sum(set_up_unknowns(cells.means) + 3 for cells in sessions)
    freedom = sum(cells.freedom for cells in sessions)
    cells_count = sum(map(len, parts))
    return Rows(
        residual=rows[:, 0],
        base=rows[:, 1 : 1 + width],
        columns=rows[:, 1 + width :],
        places=places,
        cells=cells_count,
        exact=cells_count + sum(map(len, measured)),
        value=base_of([model.parameters_mm for model in models]),
        prior=base_of(_expected_mm(sessions)),
        spread=base_of([cells.case.spread_mm for cells in sessions]),
        whitening=_whitening(sessions),
        free=free,
        freedom=freedom,
        excess=sum(cells.excess for cells in sessions),
        log_constant=sum(cells.log_constant for cells in sessions) + log_of_student(freedom, free),
    )


def _expected_mm(sessions: Sequence[Cells]) -> list[FloatArray]:
    """Parameters ``(6,)`` that each session expects: those of its model.

    Offsets that were entered since the first session of the same state are gone from its own.
    """
    expected = []
    for cells in sessions:
        parameters = np.array(cells.case.model.parameters_mm)
        first = next(session.case for session in sessions if session.case.state == cells.case.state)
        if cells.case.state is not None:
            parameters[:3] += np.subtract(first.entered_mm, cells.case.entered_mm)
        expected.append(parameters)
    return expected


def _whitening(sessions: Sequence[Cells]) -> FloatArray:
    """Sessions of one state of the machine have the same joint offsets, but for homing ``(b, b)``.

    The inverse of a Cholesky root of how lengths and offsets of all sessions correlate; lengths and
    offsets do not.
    """
    correlation = np.eye(LENGTHS + 3 * len(sessions))
    correlation[:LENGTHS, :LENGTHS] = sessions[-1].case.base_correlation[3:, 3:]
    for earlier, later in combinations(range(len(sessions)), 2):
        state, spread = sessions[earlier].case.state, sessions[earlier].case.spread_mm[:3]
        if state is None or state != sessions[later].case.state:
            continue
        alike = 1.0 - 0.5 * np.minimum(sessions[later].case.homing_mm / spread, 1.0) ** 2
        first, second = (LENGTHS + 3 * k + np.arange(3) for k in (earlier, later))
        correlation[first, second] = correlation[second, first] = alike
    return np.asarray(np.linalg.inv(np.linalg.cholesky(correlation)))


def log_of_student(freedom: float, free: int) -> float:
    """What Student's t for so many readings has before the power of their square sum."""
    if not freedom or math.isinf(freedom):
        return 0.0
    half = (freedom + free) / 2.0
    log_gammas = math.lgamma(half) - math.lgamma(freedom / 2.0)
    return half * math.log(freedom) + log_gammas - free / 2.0 * math.log(freedom / 2.0)


@dataclass(frozen=True, eq=False)
class LinearSessions:
    """Sessions about one fit of the base, as components see them.

    ``columns`` ``(n, k)`` of all components, per unit of their values; ``index`` says which are
    whose.
    """

    rows: Rows
    columns: FloatArray
    index: tuple[IntArray, ...]


def linear_about(
    sessions: Sequence[Cells],
    models: Sequence[Model],
    components: Sequence[Component],
    placed: Sequence[Mapping[Placed, FloatArray]] | None = None,
) -> tuple[LinearSessions, tuple[Component, ...]]:
    """The sessions about a model of each; components with as many values as they have columns.

    ``placed`` are `placed_columns` of each session, of these laws and others, where they are known.
    """
    rows, blocks = rows_and_blocks(sessions, models, components, placed)
    of_postures, squares = _of_postures(sessions, len(rows.residual))
    pairs = []
    for component, block in zip(components, blocks, strict=True):
        if component.id == ELSE:
            unit, block = np.full(len(squares), component.unit[0]), of_postures
            component = replace(component, unit=unit, squares=squares)
        if component.id != OTHER_BARS:
            pairs.append((component, block * component.unit))
    pairs += _bars_of_sessions(sessions, rows)
    ends = np.cumsum([block.shape[1] for _, block in pairs])
    index = np.split(np.arange(ends[-1], dtype=np.intp), ends[:-1])
    columns = np.hstack([block for _, block in pairs])
    return LinearSessions(rows, columns, tuple(index)), tuple(component for component, _ in pairs)


def rows_and_blocks(
    sessions: Sequence[Cells],
    models: Sequence[Model],
    components: Sequence[Component],
    placed: Sequence[Mapping[Placed, FloatArray]] | None = None,
    *,
    within: bool = True,
) -> tuple[Rows, list[FloatArray]]:
    """Rows about these models, and the columns ``(n, r)`` of each component.

    ``placed`` as `linear_about` has them.
    """
    laws = dict.fromkeys(s.effect for component in components for s in component.shares)
    placed = placed or [
        placed_columns(model, cells.means, list(laws))
        for model, cells in zip(models, sessions, strict=True)
    ]
    placed_laws = [
        {law: columns for law, columns in of_session.items() if law[0] in laws}
        for of_session in placed
    ]
    rows = rows_of(sessions, models, placed_laws, within=within)
    blocks = []
    for component in components:
        block = np.zeros((len(rows.residual), len(component.unit)))
        for share in component.shares:
            columns = rows.columns[:, rows.places[share.effect, share.place]]
            for value, column in zip(share.values, columns.T, strict=True):
                block[:, value] += column
        blocks.append(block)
    return rows, blocks


def free_columns(
    components: Sequence[Component],
    columns: FloatArray,
    index: Sequence[IntArray],
    case: SessionCase,
) -> FloatArray:
    """Columns ``(n, r)`` of adopted effects per standard deviation; others are per unit."""
    blocks = [np.zeros((len(columns), 0))]
    for component, places in zip(components, index, strict=True):
        if (law := component.at_one_place) in case.free_spread:
            blocks.append(columns[:, places] * (case.free_spread[law] / component.unit))
    return np.hstack(blocks)


def _bars_of_sessions(
    sessions: Sequence[Cells], rows: Rows
) -> Iterator[tuple[Component, FloatArray]]:
    """Other bars in each session but the first, with their columns ``(n, 3)``."""
    counts = [len(cells.means) for cells in sessions]
    counts += [len(cells.case.distances) for cells in sessions]
    owner = np.repeat(np.tile(np.arange(len(sessions)), 2), counts)
    for number in range(1, len(sessions)):
        own_rows = np.flatnonzero(owner == number)
        columns = np.zeros((len(rows.residual), LENGTHS))
        columns[own_rows] = rows.base[own_rows, :LENGTHS] * rows.spread[:LENGTHS]
        yield other_bars(number, rows.spread[:LENGTHS]), columns


def _of_postures(sessions: Sequence[Cells], total: int) -> tuple[FloatArray, FloatArray]:
    """Columns ``(total, r)`` of errors of each posture's own, 1 mm r.m.s., for each session.

    Beside them their mean squares ``(r,)`` over the cells of all sessions, mm².
    """
    errors = [something_else(cells.means) for cells in sessions]
    squares = np.concatenate([(columns**2).mean(axis=0) for columns in errors]) / len(sessions)
    blocks = [cells.whitened(columns) for cells, columns in zip(sessions, errors, strict=True)]
    columns = np.zeros((total, len(squares)))
    columns[: sum(map(len, blocks))] = block_diag(blocks).toarray()
    return columns, squares
