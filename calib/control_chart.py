"""A quantity over months: individuals and moving range, changes beyond their uncertainty, drift."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.arrays import FloatArray
from calib.stats import coverage_factor

TO_LIMITS = 2.66
"""Mean moving range to three standard deviations, 3 / 1.128 (ISO 7870-2; Montgomery, 6.4)."""

TO_LIMITS_BY_MEDIAN = 3.145
"""The same of the median moving range, which a jump does not move: 3 / 0.954."""

TO_THREE_SIGMA = 1.5
"""The same of an expanded uncertainty (95 %, about two standard deviations)."""


FEWEST = 3
"""Values that a drift is told from."""

LEAST_DAYS = 7.0
"""So far apart they are at least: warming up and the weather of a day are not what months bring."""


RULES = (
    (1, 1, 3.0, "one beyond 3 σ"),
    (3, 2, 2.0, "two of three beyond 2 σ on one side"),
    (5, 4, 1.0, "four of five beyond 1 σ on one side"),
    (8, 8, 0.0, "eight in a row on one side"),
)
"""Western Electric rules 1 to 4 (Statistical Quality Control Handbook, 1956): of so many values in
a row so many are farther from the centre than so many standard deviations.
"""


@dataclass(frozen=True, eq=False)
class ControlChart:
    """A chart of values ``(n,)`` in their order; a new phase begins with each change.

    ``centre`` and ``limit`` ``(n,)`` are mean and distance of the limits of the value's phase, NaN
    where a phase has one value alone. ``signals`` has for each value the numbers, from 1, of the
    `RULES` that it completes within its phase.
    """

    changed: NDArray[np.bool_]
    centre: FloatArray
    limit: FloatArray
    signals: tuple[tuple[int, ...], ...]


def control_chart(
    values: FloatArray, expanded: FloatArray, begins: NDArray[np.bool_]
) -> ControlChart:
    """Individuals and moving range of values ``(n,)`` with expanded uncertainties (95 %) ``(n,)``.

    ``begins`` ``(n,)`` says where something is known to have changed. A value is a change of itself
    where it is farther from the mean of its phase so far than three standard deviations, both of
    what the other moving ranges show and of what the uncertainties say.
    """
    changed = np.zeros(len(values), dtype=np.bool_)
    phase = np.zeros(len(values), dtype=np.intp)
    phase_number = np.cumsum(begins)
    first = 0
    for k in range(1, len(values)):
        earlier = slice(first, k)
        mean = float(values[earlier].mean())
        mean_u = float(np.sqrt((expanded[earlier] ** 2).sum()) / (k - first))
        scatter = _scatter(
            values[phase_number == phase_number[k]],
            k - int(np.argmax(phase_number == phase_number[k])),
        )
        scatter *= np.sqrt(1.0 + 1.0 / (k - first))  # the mean so far scatters, too
        allowed = max(scatter, TO_THREE_SIGMA * float(np.hypot(expanded[k], mean_u)))
        changed[k] = not begins[k] and abs(values[k] - mean) > allowed
        if begins[k] or changed[k]:
            first = k
        phase[k] = first
    phases = [values[phase == first] for first in phase]
    centre = np.array([values_of_phase.mean() for values_of_phase in phases])
    ranges = [np.abs(np.diff(values_of_phase)) for values_of_phase in phases]
    limit = np.array(
        [
            TO_LIMITS * float(values_of_phase.mean()) if len(values_of_phase) else np.nan
            for values_of_phase in ranges
        ]
    )
    return ControlChart(changed, centre, limit, _signals(values, expanded, phase, centre, limit))


def _signals(
    values: FloatArray,
    expanded: FloatArray,
    phase: NDArray[np.intp],
    centre: FloatArray,
    limit: FloatArray,
) -> tuple[tuple[int, ...], ...]:
    """Rules that each value completes; a standard deviation is at least the stated uncertainty's.

    A few moving ranges may be small by chance, and no rule is to accuse what measuring explains.
    """
    sigma = np.fmax(limit, TO_THREE_SIGMA * expanded) / 3.0
    sigma[sigma == 0.0] = np.inf
    away = np.where(np.isnan(limit), 0.0, (values - centre) / sigma)
    signals = []
    for k in range(len(values)):
        row = []
        for number, (run, count, least, _) in enumerate(RULES, start=1):
            last = away[max(phase[k], k - run + 1) : k + 1]
            side = np.sign(away[k])
            if side * away[k] > least and (side * last > least).sum() >= count:
                row.append(number)
        signals.append(tuple(row))
    return tuple(signals)


def _scatter(values: FloatArray, k: int) -> float:
    """Three standard deviations by the moving ranges that value ``k`` is no part of."""
    ranges = np.delete(
        np.abs(np.diff(values)), [change for change in (k - 1, k) if 0 <= change < len(values) - 1]
    )
    return TO_LIMITS_BY_MEDIAN * float(np.median(ranges)) if len(ranges) else 0.0


@dataclass(frozen=True)
class Drift:
    """mm per day with its expanded uncertainty (95 %); ``shown`` where it is beyond that."""

    per_day: float
    expanded: float
    shown: bool


def drift(days: FloatArray, values: FloatArray, expanded: FloatArray) -> Drift | None:
    """A straight line through values ``(n,)``, weighted by their uncertainties (95 %).

    Its uncertainty grows with what the line leaves. None for fewer than three values, for values
    without uncertainty, and where all are within a day.
    """
    if len(values) < FEWEST or not (expanded > 0.0).all() or np.ptp(days) < LEAST_DAYS:
        return None
    weight = (2.0 / expanded) ** 2
    away = days - np.average(days, weights=weight)
    moment = float((weight * away**2).sum())
    mean = np.average(values, weights=weight)
    slope = float((weight * away * (values - mean)).sum()) / moment
    residual = values - mean - slope * away
    freedom = len(values) - 2
    spread = max(1.0, float((weight * residual**2).sum()) / freedom)
    expanded_slope = coverage_factor(freedom) * float(np.sqrt(spread / moment))
    return Drift(slope, expanded_slope, abs(slope) > expanded_slope)


@dataclass(frozen=True, eq=False)
class WatchedQuantity:
    """One quantity over days: ``change`` ``(n,)`` from the first value, its chart, its drift.

    The drift is since the last time that something is known to have changed, or jumped and was
    measured often enough since.
    """

    change: FloatArray
    chart: ControlChart
    drift: Drift | None


def watch(
    days: Sequence[float],
    values: Sequence[float],
    expanded: Sequence[float],
    begins: Sequence[bool],
) -> WatchedQuantity:
    """What values ``(n,)`` of these days, with expanded uncertainties (95 %), tell together."""
    t, x, u = (np.array(column, dtype=np.float64) for column in (days, values, expanded))
    new = np.array(begins, dtype=np.bool_)
    chart = control_chart(x, u, new)
    jumps = np.flatnonzero(chart.changed[: max(0, len(x) - FEWEST + 1)])
    last = max(np.flatnonzero(new).max(initial=0), jumps.max(initial=0))
    return WatchedQuantity(x - x[0], chart, drift(t[last:], x[last:], u[last:]))
