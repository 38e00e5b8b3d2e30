"""The cheapest added measurement that separates two explanations (T-optimal)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from calib.diagnosis.problem import Problem
from calib.observations import LEG_NAMES, Conditions, FloatArray, conditions
from calib.orthoglide.geometry import Geometry
from calib.orthoglide.pipeline import derivatives

STATIONS = (0.5, 0.3, 0.7)
LEVELS = (0.25, 0.55, 0.85, 1.0)
REPEATS = 3
ENOUGH = 25.0
"""Expected separation in noise variances that settles a pair."""

Columns = Callable[[Conditions], FloatArray]
"""Columns ``(n, r)`` in mm of one explanation for any conditions."""


@dataclass(frozen=True)
class Added:
    """An added measurement: one leg, one station, some displacements, from one or both sides."""

    leg: str
    station: float
    levels_mm: tuple[float, ...]

    @property
    def words(self) -> str:
        """In short."""
        levels = ", ".join(f"{level:+g}" for level in self.levels_mm)
        return f"leg {self.leg.upper()}, {self.station:.0%} from the tool end: Zero, {levels} mm"


@dataclass(frozen=True, eq=False)
class Rival:
    """One explanation: its columns for any conditions, and its values found so far ``(r,)``."""

    columns: Columns
    values: FloatArray


def best_addition(
    problem: Problem, geometry: Geometry, first: Rival, second: Rival
) -> tuple[Added, float]:
    """The added measurement with the largest expected separation of two explanations.

    Each explanation in turn is taken for true; what the other cannot imitate of it, with base
    parameters and zeros free, in noise variances; the smaller of both counts (Atkinson and
    Fedorov's T-criterion).
    """
    noise_mm = float(np.sqrt(np.mean(problem.root_weight**-2.0)))
    now = [_measured(problem, rival) for rival in (first, second)]
    best, most = Added("x", 0.5, (0.0,)), -1.0
    for option in options(geometry):
        taken = _conditions(option)
        extra = [rival.columns(taken) / noise_mm for rival in (first, second)]
        base = _extra_base(problem, taken, geometry, noise_mm)
        separation = min(
            _left_over(problem, now[0], now[1], extra[0], extra[1], base, first.values),
            _left_over(problem, now[1], now[0], extra[1], extra[0], base, second.values),
        )
        if separation > most:
            best, most = option, separation
    return best, most


def options(geometry: Geometry) -> Iterator[Added]:
    """Every measurement that is considered: uneven levels, both sides, three stations."""
    low, high = geometry.travel_min_mm, geometry.travel_max_mm
    sets = [
        tuple(round(high * s) for s in LEVELS),
        tuple(round(low * s) for s in LEVELS),
        tuple(round(v) for v in (0.4 * high, high, 0.4 * high, 0.4 * low, low, 0.4 * low)),
    ]
    for leg in LEG_NAMES:
        for station in STATIONS:
            for levels in sets:
                yield Added(leg, station, tuple(float(v) for v in levels))


def _conditions(option: Added) -> Conditions:
    """The readings of an added measurement: a new mounting, Zero first, both axes, repeats."""
    leg = LEG_NAMES.index(option.leg)
    cycle = [0.0, *option.levels_mm]
    path = cycle * REPEATS + [0.0]
    rows = [(axis, level, k) for axis in range(3) if axis != leg for k, level in enumerate(path)]
    count = len(rows)
    made = conditions(
        [leg] * count,
        [axis for axis, _, _ in rows],
        [v for _, v, _ in rows],
        station=option.station,
    )
    moves = np.sign(np.diff(path, prepend=np.nan))
    approach = np.array([0.0 if np.isnan(moves[k]) else moves[k] for _, _, k in rows])
    arrays = vars(made) | {
        "approach": approach,
        "time_s": np.array([20.0 * k for _, _, k in rows]),
        "cycle": np.array([k // len(cycle) + 1 for _, _, k in rows]),
    }
    return Conditions(**arrays)


def _measured(problem: Problem, rival: Rival) -> FloatArray:
    """Whitened columns of an explanation on what was measured so far ``(n, r)``."""
    parts = [rival.columns(one.observed) for one in problem.sittings]
    return np.asarray(problem.root_weight[:, None] * np.vstack(parts))


def _extra_base(
    problem: Problem, taken: Conditions, geometry: Geometry, noise_mm: float
) -> FloatArray:
    model = problem.sittings[-1].model
    base = derivatives(geometry, model.parameters_mm, taken, model.effects)
    zeros = np.eye(taken.mount_count)[taken.mount]
    return np.hstack([base, zeros]) / noise_mm


def _left_over(
    problem: Problem,
    true_now: FloatArray,
    other_now: FloatArray,
    true_extra: FloatArray,
    other_extra: FloatArray,
    base_extra: FloatArray,
    values: FloatArray,
) -> float:
    """What the other explanation leaves of the true one on old and new readings together."""
    n, m = len(true_now), len(true_extra)
    zeros = base_extra[:, 6:]
    old = problem.nuisance_columns()
    design = np.zeros((n + m, old.shape[1] + zeros.shape[1] + other_now.shape[1]))
    design[:n, : old.shape[1]] = old
    at = old.shape[1] - 6
    design[n:, at : at + 6] = base_extra[:, :6]
    design[n:, old.shape[1] : old.shape[1] + zeros.shape[1]] = zeros
    design[:n, -other_now.shape[1] :] = other_now
    design[n:, -other_now.shape[1] :] = other_extra
    target = np.concatenate([true_now @ values, true_extra @ values])
    size = np.maximum(np.sqrt((design**2).sum(axis=0)), 1e-300)
    left, singular, _ = np.linalg.svd(design / size, full_matrices=False)
    basis = left[:, singular > 1e-9 * singular[0]]
    rest = target - basis @ (basis.T @ target)
    return float((rest**2).sum())
