"""What the model leaves of the readings, cell by cell, before and after adopting what was named."""

from __future__ import annotations

import numpy as np

from calib.diagnosis.problem import Problem
from calib.diagnosis.results import Cell, Residuals
from calib.observations import LEG_NAMES, TOOL, TOUCHED_NAMES, FloatArray, numbered, rows_of


def residuals(problem: Problem, after: FloatArray | None) -> Residuals:
    """Those of a problem, and of ``after`` ``(n,)``, whitened, where something was adopted."""
    mean = _cells(problem, after)
    later = [cell.after_mm for cell in mean if cell.after_mm is not None]
    return Residuals(
        mean,
        _rms([cell.before_mm for cell in mean]),
        _rms(later) if later else None,
        _rms([cell.noise_mm for cell in mean]),
    )


def _cells(problem: Problem, after: FloatArray | None) -> tuple[Cell, ...]:
    before_mm = problem.y / problem.root_weight
    after_mm = None if after is None else after / problem.root_weight
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


def _rms(values_mm: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values_mm)))) if values_mm else 0.0
