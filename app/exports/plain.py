"""Offsets as JSON, as CSV and as a model."""

from __future__ import annotations

from collections.abc import Sequence

from app.documents import to_json
from app.exports.offsets import Offsets, Uncertainty, Written
from app.exports.table import csv_text
from calib.orthoglide.geometry import PARAMETER_NAMES
from calib.orthoglide.model import Model
from protocols.model_file import model_to_json


def as_json(offsets: Offsets) -> Written:
    """Schema ``glidecal.offsets/1``."""
    document = {
        "schema": "glidecal.offsets/1",
        "source": offsets.source,
        "machine": offsets.machine.name,
        "convention": "true position = believed position + d_rho; true length = nominal + d_L",
        "unit": "mm",
        "cautions": list(offsets.cautions),
        "parameters": {
            name: {"value": value, **_known(offsets.uncertainty.get(name))}
            for name, value in offsets.values_mm.items()
        },
        "remarks": list(offsets.remarks),
    }
    return {"": to_json(document) + "\n"}


def _known(u: Uncertainty | None) -> dict[str, float | None]:
    """The keys of ``solve --json``, and the half width with what the model leaves."""
    return {
        "standard_uncertainty": None if u is None else u.standard_mm,
        "expanded_uncertainty": None if u is None else u.expanded_mm,
        "coverage_factor": None if u is None else u.coverage_factor,
        "expanded_with_lack_of_fit": None if u is None else u.enlarged_mm,
    }


def as_model(offsets: Offsets) -> Written:
    """Schema ``glidecal.model/1``: for ``glidecal simulate --model``."""
    values = tuple(offsets.values_mm.get(name, 0.0) for name in PARAMETER_NAMES)
    model = Model(offsets.machine.geometry(), values)
    return {"": model_to_json(model, offsets.machine, offsets.cautions)}


def as_csv(offsets: Offsets) -> Written:
    """One row a parameter, below the cautions as ``#`` lines; point as decimal mark.

    An unknown uncertainty stays empty.
    """
    rows: list[Sequence[str]] = [
        (
            "parameter",
            "value_mm",
            "standard_uncertainty_mm",
            "expanded_uncertainty_mm",
            "expanded_with_lack_of_fit_mm",
        )
    ]
    for name, value in offsets.values_mm.items():
        u = offsets.uncertainty.get(name)
        known = (u.standard_mm, u.expanded_mm, u.enlarged_mm) if u else ()
        shown = [f"{mm:.6f}" for mm in known] or ["", "", ""]
        rows.append((name, f"{value:.6f}", *shown))
    return {"": csv_text(rows, offsets.cautions)}
