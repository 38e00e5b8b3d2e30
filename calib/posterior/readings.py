"""Sessions as one linear problem of few rows: means of cells, and what their readings do in time.

What depends on time differs within a cell; a QR decomposition keeps of that exactly what such
columns can show. The cost of everything after goes with cells.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calib.arrays import FloatArray, Observations, set_up_unknowns
from calib.identify.fit import design_of
from calib.posterior.cells import BASE, Cells
from calib.tripod.effects.candidates import place_columns
from calib.tripod.effects.effect import Effect, Kind
from calib.tripod.pipeline import Model

LENGTHS = BASE - 3

Placed = tuple[Effect, str]
"""A law and its place."""


def placed_columns(
    model: Model, taken: Observations, effects: Sequence[Effect]
) -> dict[Placed, FloatArray]:
    """Derivatives ``(n, k)`` of readings by the values of each law at each place."""
    of_each = place_columns(model, taken, effects)
    return {
        (effect, place): columns
        for effect, places in zip(effects, of_each, strict=True)
        for place, columns in places.items()
    }


def depends_on_time(effect: Effect) -> bool:
    """Whether readings of one cell may differ by it."""
    return effect.kind == Kind.ENVIRONMENT or "per_" in effect.parameters[0].name


@dataclass(frozen=True, eq=False)
class Rows:
    """Readings of all sessions about a model of each, whitened, their zeros free.

    ``residual`` ``(n,)`` is measured less predicted; ``base`` ``(n, b)`` are derivatives by the
    lengths that sessions share, then by the joint offsets of each; ``columns`` ``(n, k)`` those of
    effects. ``value`` ``(b,)`` is where the models have the base parameters, ``prior`` ``(b,)``
    where they are expected, within ``spread`` ``(b,)``. ``free`` directions are left to readings
    beside zeros and joint offsets; ``freedom`` belongs to the noise. ``excess`` is the square sum
    of repeats that disagree, ``log_constant`` what evidences of other labels differ by as well.
    """

    residual: FloatArray
    base: FloatArray
    columns: FloatArray
    value: FloatArray
    prior: FloatArray
    spread: FloatArray
    free: int
    freedom: float
    excess: float
    log_constant: float


def rows_of(
    sessions: Sequence[Cells],
    models: Sequence[Model],
    placed: Sequence[Mapping[Placed, FloatArray]],
    order: Sequence[Placed],
    widths: Sequence[int],
) -> Rows:
    """The sessions about these models; ``placed`` are columns of effects in each, else zero."""
    count = len(sessions)
    width, total = LENGTHS + 3 * count, sum(widths)
    parts = []
    for number, (cells, model, effects) in enumerate(zip(sessions, models, placed, strict=True)):
        means = cells.means
        by_base = design_of(model, means, range(BASE), ())
        base = np.zeros((len(means), width))
        base[:, :LENGTHS] = by_base[:, 3:]
        base[:, LENGTHS + 3 * number : LENGTHS + 3 * number + 3] = by_base[:, :3]
        columns = np.hstack(
            [
                effects.get(one, np.zeros((len(means), k)))
                for one, k in zip(order, widths, strict=True)
            ]
            or [np.zeros((len(means), 0))]
        )
        rows = np.column_stack([means.value_mm - model.readings(means), base, columns])
        parts.append(cells.whitened(rows))
        timed = [k for k, (effect, _) in enumerate(order) if depends_on_time(effect)]
        timed = [k for k in timed if order[k] in effects]
        if timed and len(cells.visited) > len(means):
            by_effect = placed_columns(model, cells.visited, [order[k][0] for k in timed])
            shown = cells.in_time(np.hstack([by_effect[order[k]] for k in timed]))
            more = np.zeros((len(shown), 1 + width + total))
            more[:, 0] = shown[:, 0]
            starts = np.cumsum([0, *widths])
            index = [1 + width + c for k in timed for c in range(starts[k], starts[k + 1])]
            more[:, index] = shown[:, 1:]
            parts.append(more)
    rows = np.vstack(parts)

    def base_of(values: Sequence[Sequence[float] | FloatArray]) -> FloatArray:
        return np.array([*values[0][3:], *(v for one in values for v in one[:3])])

    free = len(rows) + sum(len(cells.apart) for cells in sessions)
    free -= sum(set_up_unknowns(cells.means) + 3 for cells in sessions)
    freedom = sum(cells.freedom for cells in sessions)
    return Rows(
        rows[:, 0],
        rows[:, 1 : 1 + width],
        rows[:, 1 + width :],
        base_of([model.parameters_mm for model in models]),
        base_of([cells.case.model.parameters_mm for cells in sessions]),
        base_of([cells.case.tolerance_mm for cells in sessions]),
        free,
        freedom,
        sum(cells.excess for cells in sessions),
        sum(cells.log_constant for cells in sessions) + _log_of_student(freedom, free),
    )


def _log_of_student(freedom: float, free: int) -> float:
    """What Student's t for so many readings has before the power of their square sum."""
    if not freedom or math.isinf(freedom):
        return 0.0
    whole = (freedom + free) / 2.0
    log_gammas = math.lgamma(whole) - math.lgamma(freedom / 2.0)
    return whole * math.log(freedom) + log_gammas - free / 2.0 * math.log(freedom / 2.0)
