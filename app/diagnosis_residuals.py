"""What the model leaves of the readings at each place, before and after adopting what was named."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.diagnosing import Diagnosed, cases
from calib.diagnosis.cleaning import Case, cleaned
from calib.diagnosis.problem import Problem, Sitting
from calib.errors import NotIdentifiable
from calib.observations import LEG_NAMES, TOOL, TOUCHED_NAMES, FloatArray, numbered, rows_of
from calib.orthoglide.effects.law import Placed

SEEN = 2.0
"""Standard deviations of a mean beyond which it is more than noise."""


@dataclass(frozen=True)
class Cell:
    """The mean residual of one leg, axis, station, displacement and side of approach, in mm.

    One of the tool has a ``position_mm`` and no displacement or side.
    ``after_mm`` is None where nothing was named that could be adopted. ``noise_mm`` is the
    standard deviation of the mean.
    """

    leg: str
    axis: str
    station: float
    displacement_mm: float
    approach: int
    before_mm: float
    after_mm: float | None
    noise_mm: float
    position_mm: tuple[float, ...] | None = None

    @property
    def strength(self) -> float:
        """The residual before, in standard deviations of its mean."""
        return self.before_mm / self.noise_mm


def residual_cells(diagnosed: Diagnosed) -> tuple[Cell, ...]:
    """Mean residuals of the readings as they were diagnosed, offsets, lengths and zeros fitted.

    Mistakes that the diagnosis found are corrected or left out, as it did. Raises NotIdentifiable.
    """
    effects = tuple(effect for one in diagnosed.diagnosis.effects for effect in one.effects)
    some = cleaned(cases(diagnosed.sessions, diagnosed.model))
    sittings = [Sitting.of(c.model, c.observed, c.indicator, c.tolerance_mm) for c in some]
    before = Problem.of(sittings)
    after = None
    if effects:
        after = _left_with(some, effects, sittings)
    return _cells(before, after)


def _left_with(
    cases: Sequence[Case], effects: tuple[Placed, ...], sittings: Sequence[Sitting]
) -> FloatArray | None:
    """Residuals ``(n,)`` in mm with more effects; None where the legs cannot meet."""
    models = [case.model.with_effects((*case.model.effects, *effects)) for case in cases]
    try:
        fitted = [
            one.again(model, case.tolerance_mm)
            for case, model, one in zip(cases, models, sittings, strict=True)
        ]
    except NotIdentifiable:
        return None
    problem = Problem.of(fitted)
    return np.asarray(problem.y / problem.root_weight)


def _cells(problem: Problem, after_mm: FloatArray | None) -> tuple[Cell, ...]:
    before_mm = problem.y / problem.root_weight
    names = ("leg", "axis", "station", "displacement_mm", "approach")
    positions = problem.conditions("position_mm")
    columns = [*(problem.conditions(name) for name in names), *positions.T]
    keys = [column.astype(np.float64).round(4) for column in columns]
    found = []
    for rows in rows_of(numbered(*keys)):
        leg, axis, station, displacement, approach, *position = (float(k[rows[0]]) for k in keys)
        found.append(
            Cell(
                leg=TOUCHED_NAMES[int(leg)],
                axis=LEG_NAMES[int(axis)],
                station=station,
                displacement_mm=displacement,
                approach=int(approach),
                before_mm=float(before_mm[rows].mean()),
                after_mm=None if after_mm is None else float(after_mm[rows].mean()),
                noise_mm=float(np.sqrt((problem.root_weight[rows] ** -2.0).sum()) / len(rows)),
                position_mm=tuple(position) if leg == TOOL else None,
            )
        )
    return tuple(found)


def explained_share(before_rms_mm: float, after_rms_mm: float) -> float:
    """The part of the gap's square that is gone, between 0 and 1."""
    if before_rms_mm <= 0.0:
        return 0.0
    return min(max(1.0 - (after_rms_mm / before_rms_mm) ** 2, 0.0), 1.0)


def rms_um(cells: tuple[Cell, ...]) -> tuple[float, float | None, float]:
    """R.m.s. over the cells, in µm: before, after (None without it), and the noise of a mean."""
    before = np.array([cell.before_mm for cell in cells])
    after = [cell.after_mm for cell in cells if cell.after_mm is not None]
    noise = np.array([cell.noise_mm for cell in cells])
    later = _rms_um(np.array(after)) if after else None
    return _rms_um(before), later, _rms_um(noise)


def _rms_um(values_mm: FloatArray) -> float:
    return float(1000.0 * np.sqrt((values_mm**2).mean())) if len(values_mm) else 0.0
