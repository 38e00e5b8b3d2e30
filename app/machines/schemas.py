"""JSON Schemas of all documents: ``python -m app.machines.schemas FOLDER`` writes them."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaMode

from app.machines.registry import FAMILIES
from app.report.schema.readings import FaultReport, PortsReport, ReadingReport

OF_INDICATORS: dict[str, Any] = {"ports": PortsReport, "reading": ReadingReport | FaultReport}
"""By the name in their id, ``glidecal.NAME/1``; the others come from the machines."""


class _Untitled(GenerateJsonSchema):
    """Titles would only repeat the keys."""

    def field_title_should_be_set(self, schema: Any) -> bool:  # noqa: ANN401, ARG002 (pydantic's)
        return False


def schemas() -> dict[str, str]:
    """The text of each schema by its file name. What several machines write is one of theirs."""
    written, read = dict(OF_INDICATORS), dict[str, Any]()
    for found in (family.documents() for family in FAMILIES):
        read |= found.read
        for name, kind in found.written.items():
            written[name] = written[name] | kind if name in written else kind
    texts = {f"{name}-1.json": _text(name, kind, "serialization") for name, kind in written.items()}
    return texts | {
        f"{name}-1.json": _text(name, kind, "validation") for name, kind in read.items()
    }


def _text(name: str, kind: Any, mode: JsonSchemaMode) -> str:  # noqa: ANN401 (class or union)
    found = TypeAdapter(kind).json_schema(mode=mode, schema_generator=_Untitled)
    head = {"$schema": _Untitled.schema_dialect, "title": f"glidecal.{name}/1"}
    return json.dumps(head | (found | head), indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    for file, text in schemas().items():
        Path(sys.argv[1], file).write_text(text, encoding="utf-8", newline="\n")
