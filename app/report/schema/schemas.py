"""JSON Schemas of all documents: ``python -m app.report.schema.schemas FOLDER`` writes them."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaMode

from app.report.schema.diagnosis import AliasReport, DiagnosisReport
from app.report.schema.hexaslide import (
    CalibrationReport,
    HexaSlideIdentifiabilityReport,
    HexaSlidePosturesReport,
)
from app.report.schema.plan import PlanReport
from app.report.schema.planning import IdentifiabilityReport, PosturesReport
from app.report.schema.readings import FaultReport, PortsReport, ReadingReport, ReplayReport
from app.report.schema.solution import ComparisonReport, OffsetsReport, SolutionReport
from protocols.events import Event
from protocols.hexaslide_machine import HexaSlideMachine
from protocols.hexaslide_postures import HexaSlideMeasurements, HexaSlideTruth
from protocols.machine import Machine
from protocols.model_file import ModelFile
from protocols.procedure import Procedure

WRITTEN: dict[str, Any] = {
    "aliases": AliasReport,
    "comparison": ComparisonReport,
    "diagnosis": DiagnosisReport,
    "hexaslide-calibration": CalibrationReport,
    "identifiability": IdentifiabilityReport | HexaSlideIdentifiabilityReport,
    "offsets": OffsetsReport,
    "plan": PlanReport,
    "ports": PortsReport,
    "postures": PosturesReport | HexaSlidePosturesReport,
    "reading": ReadingReport | FaultReport,
    "replay": ReplayReport,
    "solution": SolutionReport,
}
"""By the name in their id, ``glidecal.NAME/1``."""

READ: dict[str, Any] = {
    "hexaslide": HexaSlideMachine,
    "hexaslide-measurements": HexaSlideMeasurements,
    "hexaslide-truth": HexaSlideTruth,
    "machine": Machine,
    "model": ModelFile,
    "procedure": Procedure,
    "session": Event,  # one line of the record
}
"""Files that are read again, some of them TOML."""


class _Untitled(GenerateJsonSchema):
    """Titles would only repeat the keys."""

    def field_title_should_be_set(self, schema: Any) -> bool:  # noqa: ANN401, ARG002 (pydantic's)
        return False


def schemas() -> dict[str, str]:
    """The text of each schema by its file name."""
    written = {f"{name}-1.json": _text(name, it, "serialization") for name, it in WRITTEN.items()}
    return written | {f"{name}-1.json": _text(name, it, "validation") for name, it in READ.items()}


def _text(name: str, kind: Any, mode: JsonSchemaMode) -> str:  # noqa: ANN401 (class or union)
    found = TypeAdapter(kind).json_schema(mode=mode, schema_generator=_Untitled)
    head = {"$schema": _Untitled.schema_dialect, "title": f"glidecal.{name}/1"}
    return json.dumps(head | (found | head), indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    for file, text in schemas().items():
        Path(sys.argv[1], file).write_text(text, encoding="utf-8", newline="\n")
