"""A calibrated Hexa Slide as a JSON document: docs/commands.md describes it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from app.hexaslide_calibration import AgainstTruth, Calibrated, HeldOut
from calib.hexaslide.frames import PAIRS, FramesApart, inner_lengths
from calib.hexaslide.parameters import unit_of
from calib.hexaslide.residuals import ANGLES, Left
from calib.observations import FloatArray

UNITS = "metres and radians, columns not scaled"
NO_EFFECTS = (
    "The catalogue of effects is for the Orthoglide; for a Hexa Slide nothing is looked for by "
    "name."
)
INNER_NAMES = (
    *(f"B{i + 1}-B{j + 1}" for i, j in PAIRS),
    *(f"A1-A{chain}" for chain in range(2, 7)),
    *(f"l{chain}" for chain in range(1, 7)),
)


def calibration_document(solved: Calibrated) -> dict[str, Any]:
    """Schema ``glidecal.hexaslide-calibration/1``."""
    source, found = solved.source, solved.found
    return {
        "schema": "glidecal.hexaslide-calibration/1",
        "measurements": solved.name,
        "origin": source.origin,
        "seed": source.seed,
        "machine": source.machine.name,
        "machine_file": source.machine_file,
        "procedure": source.procedure.value,
        "measured": list(source.measured),
        "postures": {
            "count": len(source.postures),
            "fitted": len(solved.numbers),
            "held_out": list(solved.held_out.numbers) if solved.held_out else [],
            "fewest": solved.fewest,
        },
        "rank": found.rank,
        "parameter_count": len(found.names),
        "steps": found.steps,
        "converged": found.converged,
        "rms_before": _rms(found.before),
        "rms_after": _rms(found.after),
        "noise": _noise(solved),
        "lack_of_fit": {
            "statistic": None if solved.p_value is None else _ratio(solved),
            "p_value": solved.p_value,
        },
        "condition_number": found.condition_number,
        "units": UNITS,
        "parameters": _parameters(solved),
        "individually_known": list(found.known),
        "lost_motions": list(found.lost),
        "lost_count": found.lost_count,
        "inner_lengths": _inner(solved),
        "residuals": {
            "by_component": _by_component(solved),
            "by_posture": [
                {"posture": number, "share": float(share)}
                for number, share in zip(solved.numbers, solved.by_posture, strict=True)
            ],
            "effects": [],
            "remark": NO_EFFECTS,
        },
        "held_out": _held_out(solved.held_out),
        "truth": _truth(solved.truth),
    }


def _rms(left: Left) -> dict[str, float | None]:
    """Lengths in mm, angles in mrad."""
    length, angle = left.rms(angles=False), left.rms(angles=True)
    return {
        "length_mm": None if length is None else 1000.0 * length,
        "angle_mrad": None if angle is None else 1000.0 * angle,
    }


def _ratio(solved: Calibrated) -> float:
    """Variance that is left by the stated one."""
    return (solved.found.square_sum or 0.0) / solved.found.free_values


def _noise(solved: Calibrated) -> dict[str, Any]:
    found = solved.found
    stated = math.isinf(found.degrees_of_freedom)
    length = None if found.noise_m is None else 1000.0 * found.noise_m
    own = solved.source.noise
    angles = any(name in ANGLES for name in solved.source.measured)
    ratio = own.angle_mrad / own.length_mm if stated else 1.0
    return {
        "length_mm": length,
        "angle_mrad": length * ratio if angles and length is not None else None,
        "source": "stated" if stated else "residuals",
        "degrees_of_freedom": None if stated else found.degrees_of_freedom,
    }


def _parameters(solved: Calibrated) -> dict[str, dict[str, Any]]:
    """Uncertainties of those only that are known one by one; of others they mean nothing."""
    found, u = solved.found, solved.uncertainty
    rows = {}
    for k, name in enumerate(found.names):
        own = u[k] if u is not None and name in found.known else None
        factor = None if own is None else solved.factor
        rows[name] = {
            "value": float(found.parameters[k]),
            "nominal": float(solved.start[k]),
            "unit": unit_of(name),
            "individually_known": name in found.known,
            "standard_uncertainty": None if own is None else float(own),
            "expanded_uncertainty": None if own is None else float(own * (factor or 0.0)),
            "coverage_factor": factor,
        }
    return rows


def _inner(solved: Calibrated) -> dict[str, dict[str, float | None]]:
    lengths, u = inner_lengths(solved.found.machine.geometry), solved.inner_uncertainty_m
    return {
        name: {
            "value_m": float(lengths[k]),
            "standard_uncertainty_m": None if u is None else float(u[k]),
        }
        for k, name in enumerate(INNER_NAMES)
    }


def _by_component(solved: Calibrated) -> list[dict[str, Any]]:
    left = solved.found.after
    size = np.sqrt((left.values**2).mean(axis=0))
    return [
        {
            "component": name,
            "rms": float(1000.0 * size[k]),
            "unit": "mrad" if left.angular[k] else "mm",
            "share": float(solved.by_column[k]),
        }
        for k, name in enumerate(left.names)
    ]


def _held_out(held: HeldOut | None) -> dict[str, Any] | None:
    if held is None:
        return None
    return {"rms_before": _rms(held.before), "rms_after": _rms(held.after)}


def _truth(truth: AgainstTruth | None) -> dict[str, Any] | None:
    if truth is None:
        return None
    return {
        "postures": "held out" if truth.kept_out else "all",
        "before": _apart(truth.before),
        "after": _apart(truth.after),
        "individually_known_within_95_percent": truth.held,
        "individually_known_count": len(truth.misses),
        "individually_known_worst": float(np.abs(truth.misses).max(initial=0.0)),
        "inner_lengths_worst_mm": float(1000.0 * np.abs(truth.inner_m).max()),
    }


def _apart(apart: FramesApart) -> dict[str, float]:
    return {
        "position_rms_mm": 1000.0 * rms(apart.places_m),
        "position_worst_mm": float(1000.0 * apart.places_m.max()),
        "angle_rms_mrad": 1000.0 * rms(apart.angles_rad),
        "platform_frame_turned_mrad": 1000.0 * apart.turned_rad,
        "platform_frame_shifted_mm": 1000.0 * apart.shifted_m,
        "base_turned_mrad": 1000.0 * apart.base_turned_rad,
    }


def rms(values: FloatArray) -> float:
    """Root of the mean square."""
    return float(np.sqrt((values**2).mean()))
