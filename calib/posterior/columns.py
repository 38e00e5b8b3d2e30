"""Columns of every component in the rows of sessions, about a model of each."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from calib.arrays import FloatArray, IntArray
from calib.posterior.cells import Cells, SessionCase
from calib.posterior.library import ELSE, OTHER_BARS, Component, other_bars, something_else
from calib.posterior.models import LinearSessions
from calib.posterior.readings import LENGTHS, Rows, rows_of
from calib.tripod.effects.candidates import placed_columns
from calib.tripod.effects.effect import Placed
from calib.tripod.pipeline import Model


def linear_about(
    sessions: Sequence[Cells],
    models: Sequence[Model],
    components: Sequence[Component],
    placed: Sequence[Mapping[Placed, FloatArray]] | None = None,
) -> tuple[LinearSessions, tuple[Component, ...], tuple[Placed, ...]]:
    """The sessions about a model of each; components with as many values as they have columns.

    ``placed`` are `placed_columns` of each session, of these laws and others, where they are known.
    """
    rows, placed_laws, blocks = rows_and_blocks(sessions, models, components, placed)
    of_postures, squares = _of_postures(sessions, len(rows.residual))
    pairs = []
    for component, block in zip(components, blocks, strict=True):
        if component.id == ELSE:
            component, block = component.with_values(squares), of_postures
        if component.id != OTHER_BARS:
            pairs.append((component, block * component.unit))
    pairs += _bars_of_sessions(sessions, rows)
    widths = [block.shape[1] for _, block in pairs]
    starts = np.cumsum([0, *widths[:-1]])
    index = tuple(
        np.arange(at, at + w, dtype=np.intp) for at, w in zip(starts, widths, strict=True)
    )
    columns = np.hstack([block for _, block in pairs])
    sized = tuple(component for component, _ in pairs)
    return LinearSessions(rows, columns, index), sized, placed_laws


def rows_and_blocks(
    sessions: Sequence[Cells],
    models: Sequence[Model],
    components: Sequence[Component],
    placed: Sequence[Mapping[Placed, FloatArray]] | None = None,
    *,
    within: bool = True,
) -> tuple[Rows, tuple[Placed, ...], list[FloatArray]]:
    """Rows about these models, laws at places, and the columns ``(n, r)`` of each component.

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
    widths = {law: len(law[0].parameters) for by_law in placed_laws for law in by_law}
    rows = rows_of(sessions, models, placed_laws, widths, within=within)
    starts = dict(zip(widths, np.cumsum([0, *widths.values()]).tolist(), strict=False))
    blocks = []
    for component in components:
        block = np.zeros((len(rows.residual), len(component.unit)))
        for share in component.shares:
            first = starts[share.effect, share.place]
            for at, value in enumerate(share.values):
                block[:, value] += rows.columns[:, first + at]
        blocks.append(block)
    return rows, tuple(widths), blocks


def free_spread(component: Component, case: SessionCase) -> FloatArray | None:
    """Standard deviations ``(r,)`` of an adopted effect at one place; None of other components."""
    if component.candidate is None or component.candidate.arrangement != "one":
        return None
    (share,) = component.shares
    return case.free_spread.get((share.effect, share.place))


def free_columns(
    components: Sequence[Component],
    columns: FloatArray,
    index: Sequence[IntArray],
    case: SessionCase,
) -> FloatArray:
    """Columns ``(n, r)`` of adopted effects per standard deviation; others are per unit."""
    blocks = [np.zeros((len(columns), 0))]
    for component, places in zip(components, index, strict=True):
        spread = free_spread(component, case)
        if spread is not None:
            blocks.append(columns[:, places] * (spread / component.unit))
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
    blocks = [
        cells.whitened(errors_of_session)
        for cells, errors_of_session in zip(sessions, errors, strict=True)
    ]
    squares = np.concatenate(
        [(errors_of_session**2).mean(axis=0) for errors_of_session in errors]
    ) / len(sessions)
    columns = np.zeros((total, sum(block.shape[1] for block in blocks)))
    row = column = 0
    for block in blocks:
        columns[row : row + len(block), column : column + block.shape[1]] = block
        row, column = row + block.shape[0], column + block.shape[1]
    return columns, squares
