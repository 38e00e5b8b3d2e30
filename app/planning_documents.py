"""What a procedure sees and optimum postures as JSON documents."""

from __future__ import annotations

from typing import Any

import numpy as np

from app.optimum_postures import Chosen
from app.planning import Combination, SeenBy


def identifiability_document(seen: SeenBy) -> dict[str, Any]:
    """Schema ``glidecal.identifiability/1``."""
    condition = seen.found.condition_number
    return {
        "schema": "glidecal.identifiability/1",
        "machine": seen.machine,
        "procedure": seen.examined.procedure,
        "measured": list(seen.examined.measured),
        "postures": {"count": seen.examined.posture_count, "source": seen.examined.source},
        "parameters": list(seen.found.names),
        "rank": seen.found.rank,
        "parameter_count": len(seen.found.names),
        "row_count": seen.found.row_count,
        "independent_row_count": seen.examined.independent_count,
        "limited_by": seen.limited_by,
        "fewest_postures": seen.examined.fewest_postures,
        "published_rank": seen.examined.published_rank,
        "remark": seen.examined.remark,
        "individually_identifiable": list(seen.found.individually_known),
        "lost_directions": [_combination(one) for one in seen.lost],
        "weak_directions": [_combination(one) for one in seen.weak],
        "condition_number": condition if np.isfinite(condition) else None,
        "units": seen.examined.units,
        "noise": seen.examined.noise_words,
        "classical_qr": {"tolerance": seen.qr.tolerance, "flagged": list(seen.qr.flagged)},
    }


def _combination(one: Combination) -> dict[str, Any]:
    return {
        "name": one.name,
        "combination": one.shares,
        "standard_uncertainty_mm": one.standard_uncertainty,
        "tool_mm": one.tool_mm,
        "cure": one.cure
        and {
            "posture": one.cure.where,
            "standard_uncertainty_mm": one.cure.standard_uncertainty,
        },
    }


def postures_document(chosen: Chosen) -> dict[str, Any]:
    """Schema ``glidecal.postures/1``."""
    return {
        "schema": "glidecal.postures/1",
        "machine": chosen.machine,
        "procedure": chosen.procedure,
        "count": chosen.after.count,
        "criterion": chosen.criterion.value,
        "value": chosen.after.value,
        "procedure_value": chosen.before.value,
        "grid_value": chosen.grid_value,
        "condition_number": chosen.after.condition_number,
        "start_condition_number": chosen.start_condition_number,
        "procedure_condition_number": chosen.before.condition_number,
        "tool_mm": chosen.after.tool_mm,
        "minutes": chosen.after.minutes,
        "postures": list(chosen.postures),
        "coordinates_on_bound": chosen.coordinates_on_bound,
        "exchanges": chosen.exchanges,
        "seconds": chosen.seconds,
        "starts": chosen.starts,
        "seed": chosen.seed,
    }
