"""JSON documents that other programs read: docs/commands.md describes them."""

from __future__ import annotations

import json
import math
from typing import Any

from app.solving import Solved
from calib.accuracy import ToolError
from calib.noise import Noise
from calib.solution import Solution
from drivers.outcome import Fault, Outcome
from protocols.session import Session


def to_json(document: dict[str, Any]) -> str:
    """One JSON document; a value that is not finite is a defect and raises ValueError."""
    return json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False)


def solution_document(solved: Solved) -> dict[str, Any]:
    """Schema ``glidecal.solution/1``."""
    solution = solved.solution
    fit = solution.lack_of_fit
    return {
        "schema": "glidecal.solution/1",
        "sessions": list(solved.names),
        "method": solution.method,
        "weights": solution.weights,
        "subset": solution.subset,
        "parameters": parameters(solution),
        "covariance": {
            "names": list(solution.names),
            "matrix": solution.covariance_mm2.tolist(),
            "unit": "mm²",
        },
        "differences": _differences(solution),
        "rms_before_mm": solution.rms_before_mm,
        "rms_after_mm": solution.rms_after_mm,
        "degrees_of_freedom": solution.degrees_of_freedom,
        "noise": _noise(solution.noise),
        "suspect_readings": [
            {
                "session": suspect.session,
                "reading": suspect.reading.reading,
                "studentised": suspect.studentised,
            }
            for suspect in solved.suspects
        ],
        "lost_readings": [
            {"session": alone.session, "readings": [r.reading for r in alone.readings]}
            for alone in solved.alone
        ],
        "tool_error": {
            "before": _tool_error(solved.tool_before),
            "after": _tool_error(solved.tool_after),
            "coverage_factor": solved.tool_factor,
        },
        "enlarged_by_lack_of_fit": solved.enlarged,
        "expanded_with_lack_of_fit_mm": dict(
            zip(solution.names, solution.enlarged_expanded_mm.tolist(), strict=True)
        ),
        "lack_of_fit": {
            "statistic": fit.statistic if fit else None,
            "p_value": fit.p_value if fit else None,
        },
        "condition_number": solution.condition_number,
        "weak_directions": [
            {
                "combination": direction.combination,
                "standard_uncertainty_mm": direction.standard_uncertainty_mm,
                "tool_mm": direction.tool_mm,
            }
            for direction in solution.weak_directions
        ],
        "recommended_subset": solved.choice.recommended,
        "reasons": list(solved.choice.reasons),
    }


def parameters(solution: Solution) -> dict[str, dict[str, float | str]]:
    """Value and uncertainty of each identified parameter."""
    return {
        name: {
            "value": float(value),
            "standard_uncertainty": float(u),
            "expanded_uncertainty": float(u * factor),
            "coverage_factor": float(factor),
            "unit": "mm",
        }
        for name, value, u, factor in zip(
            solution.names,
            solution.values_mm,
            solution.uncertainty_mm,
            solution.coverage_factors,
            strict=True,
        )
    }


def _differences(solution: Solution) -> dict[str, dict[str, float]]:
    measured = solution.differences
    return {
        measured.names[k]: {
            "value": float(measured.value_mm[k]),
            "standard_uncertainty": float(solution.difference_uncertainty_mm[k]),
            "predicted": float(solution.predicted_mm[k]),
            "residual": float(measured.value_mm[k] - solution.predicted_mm[k]),
        }
        for k in measured.published_rows
    }


def _noise(noise: Noise) -> dict[str, Any]:
    known = math.isinf(noise.degrees_of_freedom)
    return {
        "standard_deviation_mm": noise.standard_deviation_mm,
        "degrees_of_freedom": None if known else noise.degrees_of_freedom,
        "source": noise.source,
        "pooled": noise.pooled,
        "repeats_show": noise.repeated,
        "wander_mm": noise.wander_mm,
        "indicators": [
            {
                "standard_deviation_mm": math.sqrt(one.variance_mm2),
                "rounding_shared_by_repeats_mm": math.sqrt(one.locked_mm2),
            }
            for one in noise.indicators
        ],
    }


def _tool_error(error: ToolError) -> dict[str, float]:
    return {
        "rms_mm": error.rms_mm,
        "standard_uncertainty_mm": error.standard_uncertainty_mm,
        "worst_mm": error.worst_mm,
    }


def replay_document(name: str, session: Session, end: str) -> dict[str, Any]:
    """Schema ``glidecal.replay/1``: every reading, and the averages of those that count."""
    averages: dict[tuple[str, str, float, float], list[tuple[float, int]]] = {}
    for r in session.readings:
        key = (r.leg, r.axis, r.station, r.displacement_mm)
        averages.setdefault(key, []).append((r.value_mm, r.averaged))
    return {
        "schema": "glidecal.replay/1",
        "session": name,
        "end": end,
        "remarks": list(session.opened.remarks),
        "readings": [
            {
                "reading": r.reading,
                "leg": r.leg,
                "axis": r.axis,
                "displacement_mm": r.displacement_mm,
                "value_mm": r.value_mm,
                "text": r.text,
                "cycle": r.cycle,
                "mount": r.mount,
                "station": r.station,
                "time_s": r.time_s,
                "temperature_c": r.temperature_c,
                "averaged": r.averaged,
                "superseded": session.superseded.get(r.reading),
                "extra": r.extra,
            }
            for r in session.all_readings
        ],
        "averages": [
            {
                "leg": leg,
                "axis": axis,
                "station": station,
                "displacement_mm": displacement,
                "mean_mm": sum(v * n for v, n in values) / sum(n for _, n in values),
                "readings": sum(n for _, n in values),
            }
            for (leg, axis, station, displacement), values in averages.items()
        ],
    }


def reading_document(profile: str, outcome: Outcome) -> dict[str, Any]:
    """Schema ``glidecal.reading/1``: one outcome; a fault has no ``value_mm``."""
    document: dict[str, Any] = {
        "schema": "glidecal.reading/1",
        "profile": profile,
        "text": outcome.text,
    }
    if isinstance(outcome, Fault):
        return document | {"status": outcome.kind.value, "words": outcome.words}
    return document | {
        "value_mm": outcome.value_mm,
        "unit": outcome.unit.value,
        "unit_assumed": outcome.unit_assumed,
        "resolution_mm": outcome.resolution_mm,
        "status": "value",
        "warning": outcome.warning or None,
    }
