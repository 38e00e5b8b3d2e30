"""Offsets as JSON and as CSV."""

from __future__ import annotations

import csv
from io import StringIO

from app.documents import to_json
from app.exports.offsets import Offsets, Written


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


def as_csv(offsets: Offsets) -> Written:
    """One row a parameter; point as decimal mark; an unknown uncertainty stays empty."""
    out = StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["parameter", "value_mm", "standard_uncertainty_mm"])
    for name, value in offsets.values_mm.items():
        u = offsets.standard_uncertainty_mm[name]
        writer.writerow([name, f"{value:.6f}", "" if u is None else f"{u:.6f}"])
    return {"": out.getvalue()}
