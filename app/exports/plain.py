"""Offsets as JSON, as CSV and as a model."""

from __future__ import annotations

import csv
from io import StringIO

from app.documents import to_json
from app.exports.offsets import Offsets, Written
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
        "parameters": {
            name: {"value": value, "standard_uncertainty": offsets.standard_uncertainty_mm[name]}
            for name, value in offsets.values_mm.items()
        },
        "remarks": list(offsets.remarks),
    }
    return {"": to_json(document) + "\n"}


def as_model(offsets: Offsets) -> Written:
    """Schema ``glidecal.model/1``: for ``glidecal simulate --model``."""
    values = tuple(offsets.values_mm.get(name, 0.0) for name in PARAMETER_NAMES)
    return {"": model_to_json(Model(offsets.machine.geometry(), values), offsets.machine)}


def as_csv(offsets: Offsets) -> Written:
    """One row a parameter; point as decimal mark; an unknown uncertainty stays empty."""
    out = StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["parameter", "value_mm", "standard_uncertainty_mm"])
    for name, value in offsets.values_mm.items():
        u = offsets.standard_uncertainty_mm[name]
        writer.writerow([name, f"{value:.6f}", "" if u is None else f"{u:.6f}"])
    return {"": out.getvalue()}
