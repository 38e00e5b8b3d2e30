"""Offsets as JSON, as CSV and as a model."""

from __future__ import annotations

from collections.abc import Sequence

from app.report.offsets import Offsets
from app.report.schema.document import to_json
from app.report.schema.solution import OffsetsReport
from calib.tripod.geometry import PARAMETER_NAMES
from calib.tripod.pipeline import Model
from protocols.files import Written
from protocols.model_file import model_file
from protocols.table import csv_text


def as_json(offsets: Offsets) -> Written:
    """Schema ``glidecal.offsets/1``."""
    return {"": to_json(OffsetsReport.of(offsets=offsets)) + "\n"}


def as_model(offsets: Offsets) -> Written:
    """Schema ``glidecal.model/1``: for ``glidecal simulate --model``."""
    known = offsets.parameters
    values = tuple(known[name].value if name in known else 0.0 for name in PARAMETER_NAMES)
    model = Model(offsets.machine.geometry(), values)
    return {"": model_file(model, offsets.machine, offsets.cautions).text()}


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
    for name, one in offsets.parameters.items():
        known = (
            one.value,
            one.standard_uncertainty,
            one.expanded_uncertainty,
            one.expanded_with_lack_of_fit,
        )
        rows.append((name, *("" if mm is None else f"{mm:.6f}" for mm in known)))
    return {"": csv_text(rows, offsets.cautions)}
