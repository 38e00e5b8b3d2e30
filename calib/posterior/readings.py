"""Sessions as one linear problem of few rows: means of cells, and what their readings do in time.

Readings of one mounting, posture and side have one mean and one variance. What depends on time
differs within a cell; a QR decomposition keeps of that exactly what such columns can show. The
cost of everything after goes with cells.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.arrays import (
    FloatArray,
    IntArray,
    Observations,
    numbered,
    set_up_unknowns,
    without_means,
    without_zeros,
)
from calib.identify.fit import design_of, prior_fit
from calib.noise.reading import IndicatorFigures, Noise, reading_noise, visits
from calib.tripod.effects.candidates import place_columns
from calib.tripod.effects.effect import Effect, Kind
from calib.tripod.geometry import PARAMETER_NAMES
from calib.tripod.movements import with_first_movements
from calib.tripod.pipeline import Model

BASE = len(PARAMETER_NAMES)
LENGTHS = BASE - 3

FINEST_MM = 1e-5
"""No indicator reads better; with less, rounding would be taken for what readings show."""

Placed = tuple[Effect, str]
"""A law and its place."""


@dataclass(frozen=True, eq=False)
class Case:
    """One session: the model it was measured against, and what is known of machine and indicators.

    ``tolerance_mm`` ``(6,)`` are standard deviations of joint offsets and bar lengths.
    """

    model: Model
    observed: Observations
    indicator: IndicatorFigures
    tolerance_mm: FloatArray


@dataclass(frozen=True, eq=False)
class Cells:
    """One session by its cells: ``means`` of them, with a variance ``(n_cells,)`` of each in mm².

    The first reading of a mounting is a cell of its own: nobody saw how it was reached, and what
    settles does so after it. ``cell`` ``(n_visits,)`` numbers the cell of each visit; ``noise`` is
    None where nothing tells it.
    """

    case: Case
    visited: Observations
    cell: IntArray
    means: Observations
    variance_mm2: FloatArray
    noise: Noise | None

    @classmethod
    def of(cls, case: Case) -> Cells:
        """Group the visits of a session."""
        visited = with_first_movements(visits(case.observed))
        noise = reading_noise(visited, case.indicator)
        first = np.zeros(len(visited), dtype=np.intp)
        first[np.unique(visited.mount, return_index=True)[1]] = 1
        cell = numbered(visited.cell, first)
        rows = np.unique(cell, return_index=True)[1]
        together = np.bincount(cell, visited.averaged).astype(np.float64)
        value_mm, time_s = (
            np.bincount(cell, visited.averaged * column) / together
            for column in (visited.value_mm, visited.time_s)
        )
        means = replace(visited.take(rows), value_mm=value_mm, averaged=together, time_s=time_s)
        if noise is None:  # equal weights: what the model leaves tells the variance
            centred = without_zeros(visited, visited.averaged, visited.value_mm)
            variance = max(1e-4 * float((centred**2).mean()), 1e-8) / together
        else:
            variance = noise.repeatability_mm2(means) + noise.quantisation_mm2(means)
        return cls(case, visited, cell, means, np.maximum(variance, FINEST_MM**2), noise)

    @property
    def freedom(self) -> float:
        """Degrees of freedom of the noise; 0 where none is known."""
        return self.noise.degrees_of_freedom if self.noise else 0.0

    @cached_property
    def model(self) -> Model:
        """Base parameters fitted within their tolerances. Raises NotIdentifiable."""
        case = self.case
        return prior_fit(case.model, self.means, 1.0 / self.variance_mm2, case.tolerance_mm).model

    def in_time(self, columns: FloatArray) -> FloatArray:
        """What columns ``(n_visits, k)`` and readings do within cells: rows ``(k, 1 + k)``.

        The readings come first; whitened.
        """
        rows = np.column_stack([columns, self.visited.value_mm])
        scatter = np.full(len(rows), 1.0)
        if self.noise:
            scatter = np.maximum(self.noise.repeatability_mm2(self.visited), FINEST_MM**2)
        left = without_means(self.cell, 1.0 / scatter, rows) / np.sqrt(scatter)[:, None]
        upper = np.linalg.qr(left, mode="r")[: columns.shape[1]]
        return np.column_stack([upper[:, -1], upper[:, :-1]])


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
    effects. The first ``cells`` rows are means of cells, the others what readings do within them.
    ``value`` ``(b,)`` is where the models have the base parameters, ``prior`` ``(b,)`` where they
    are expected, within ``spread`` ``(b,)``. ``free`` directions are left to readings beside zeros
    and joint offsets; ``freedom`` belongs to the noise.
    """

    residual: FloatArray
    base: FloatArray
    columns: FloatArray
    cells: int
    value: FloatArray
    prior: FloatArray
    spread: FloatArray
    free: int
    freedom: float


def whitened(cells: Cells, rows: FloatArray) -> FloatArray:
    """Rows ``(n_cells, ...)`` in standard deviations of their cells, zeros of mountings free."""
    weight = 1.0 / cells.variance_mm2
    return np.asarray(np.sqrt(weight)[:, None] * without_zeros(cells.means, weight, rows))


def rows_of(
    sessions: Sequence[Cells],
    models: Sequence[Model],
    placed: Sequence[Mapping[Placed, FloatArray]],
    widths: Mapping[Placed, int],
    *,
    within: bool = True,
) -> Rows:
    """The sessions about these models; ``placed`` are columns of laws in each, zero elsewhere.

    ``widths`` are how many values each law has, in the order of `Rows.columns`; without ``within``
    only the means of cells.
    """
    count = len(sessions)
    width, total = LENGTHS + 3 * count, sum(widths.values())
    starts = dict(zip(widths, np.cumsum([0, *widths.values()]).tolist(), strict=False))
    parts, timed_parts = [], []
    for number, (cells, model, laws) in enumerate(zip(sessions, models, placed, strict=True)):
        means = cells.means
        rows = np.zeros((len(means), 1 + width + total))
        rows[:, 0] = means.value_mm - model.readings(means)
        by_base = design_of(model, means, range(BASE), ())
        rows[:, 1 : 1 + LENGTHS] = by_base[:, 3:]
        first = 1 + LENGTHS + 3 * number
        rows[:, first : first + 3] = by_base[:, :3]
        for law, columns in laws.items():
            at = 1 + width + starts[law]
            rows[:, at : at + columns.shape[1]] = columns
        parts.append(whitened(cells, rows))
        timed = [law for law in laws if depends_on_time(law[0])]
        if within and timed and len(cells.visited) > len(means):
            by_law = placed_columns(model, cells.visited, [law[0] for law in timed])
            shown = cells.in_time(np.hstack([by_law[law] for law in timed]))
            more = np.zeros((len(shown), rows.shape[1]))
            more[:, 0] = shown[:, 0]
            index = [1 + width + starts[law] + k for law in timed for k in range(widths[law])]
            more[:, index] = shown[:, 1:]
            timed_parts.append(more)
    rows = np.vstack([*parts, *timed_parts])

    def base_of(values: Sequence[Sequence[float] | FloatArray]) -> FloatArray:
        return np.array([*values[0][3:], *(v for each in values for v in each[:3])])

    return Rows(
        rows[:, 0],
        rows[:, 1 : 1 + width],
        rows[:, 1 + width :],
        sum(map(len, parts)),
        base_of([model.parameters_mm for model in models]),
        base_of([cells.case.model.parameters_mm for cells in sessions]),
        base_of([cells.case.tolerance_mm for cells in sessions]),
        len(rows) - sum(set_up_unknowns(cells.means) + 3 for cells in sessions),
        sum(cells.freedom for cells in sessions),
    )
