"""Sessions as one linear problem of few rows: means of cells, and what their readings do in time.

What depends on time differs within a cell; a QR decomposition keeps of that exactly what such
columns can show. The cost of everything after goes with cells.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from calib.arrays import FloatArray, set_up_unknowns
from calib.identify.fit import design_of
from calib.posterior.cells import BASE, Cells
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
    effects. The first ``cells`` rows are means of cells; up to ``exact`` follow distances between
    marks; the others are what readings do within cells.
    ``value`` ``(b,)`` is where the models have the base parameters, ``prior`` ``(b,)`` where they
    are expected, within ``spread`` ``(b,)``; ``whitening`` ``(b, b)`` makes what is expected of
    them, in these standard deviations, independent. ``free`` directions are left to readings beside
    zeros and joint offsets; ``freedom`` belongs to the noise. ``excess`` is the square sum of
    repeats that disagree, ``log_constant`` what evidences of other labels differ by as well.
    """

    residual: FloatArray
    base: FloatArray
    columns: FloatArray
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
    for number, (cells, model, laws) in enumerate(zip(sessions, models, placed_laws, strict=True)):
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
        parts.append(cells.whitened(rows))
        timed = [law for law in laws if depends_on_time(law[0])]
        if within and timed and len(cells.visits) > len(means):
            effects = list(dict.fromkeys(effect for effect, _ in timed))
            by_law = placed_columns(model, cells.visits, effects, timed)
            left_mm = cells.visits.value_mm - model.readings(cells.visits)
            timed_columns = cells.in_time(np.hstack([by_law[law] for law in timed]), left_mm)
            padded = np.zeros((len(timed_columns), rows.shape[1]))
            padded[:, 0] = timed_columns[:, 0]
            index = [1 + width + starts[law] + k for law in timed for k in range(widths[law])]
            padded[:, index] = timed_columns[:, 1:]
            timed_parts.append(padded)
    measured = []
    for number, (cells, model) in enumerate(zip(sessions, models, strict=True)):
        distances = cells.case.distances
        rows = np.zeros((len(distances), 1 + width + total))
        if len(distances):
            by_base = distances.by_base(model)
            rows[:, 0] = distances.residual(model)
            rows[:, 1 : 1 + LENGTHS] = by_base[:, 3:]
            first = 1 + LENGTHS + 3 * number
            rows[:, first : first + 3] = by_base[:, :3]
            for law, columns in distances.by_laws(model, widths).items():
                at = 1 + width + starts[law]
                rows[:, at : at + columns.shape[1]] = columns
        measured.append(rows)
    rows = np.vstack([*parts, *measured, *timed_parts])

    def base_of(values: Sequence[Sequence[float] | FloatArray]) -> FloatArray:
        return np.array(
            [*values[0][3:], *(v for values_of_session in values for v in values_of_session[:3])]
        )

    free = len(rows) + sum(len(cells.apart) for cells in sessions)
    free += sum(map(len, measured))
    free -= sum(set_up_unknowns(cells.means) + 3 for cells in sessions)
    freedom = sum(cells.freedom for cells in sessions)
    return Rows(
        rows[:, 0],
        rows[:, 1 : 1 + width],
        rows[:, 1 + width :],
        sum(map(len, parts)),
        sum(map(len, [*parts, *measured])),
        base_of([model.parameters_mm for model in models]),
        base_of(_expected_mm(sessions)),
        base_of([cells.case.spread_mm for cells in sessions]),
        _whitening(sessions),
        free,
        freedom,
        sum(cells.excess for cells in sessions),
        sum(cells.log_constant for cells in sessions) + log_of_student(freedom, free),
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
