"""JSON Schemas of all documents: ``python -m app.report.schema.schemas FOLDER`` writes them."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator
from functools import reduce
from importlib import import_module
from operator import or_
from pathlib import Path
from pkgutil import iter_modules
from typing import Any, get_args

from pydantic import TypeAdapter
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaMode

import app.report.schema
import protocols
from app.report.schema.document import Report
from protocols.documents import Document
from protocols.files import write_files
from protocols.session import Event

ROOMS = (app.report.schema, protocols)
"""Where all documents stand that are written, or read again; some of the latter are TOML."""


ID = re.compile(r"glidecal\.(.+)/1")


class _Untitled(GenerateJsonSchema):
    """Titles would only repeat the keys."""

    def field_title_should_be_set(self, schema: Any) -> bool:  # noqa: ANN401, ARG002 (pydantic's)
        return False


def schemas() -> dict[str, str]:
    """The text of each schema by its file name; what several machines write is one of theirs."""
    for room in ROOMS:
        for module in iter_modules(room.__path__, f"{room.__name__}."):
            import_module(module.name)
    by_name: dict[str, list[type[Document]]] = {}
    for kind in _documents(Document):
        (schema_id,) = get_args(kind.model_fields["schema_id"].annotation)
        by_name.setdefault(ID.sub(r"\1", schema_id), []).append(kind)
    # the first line of a record has the id, a schema is for each of its lines
    every = {name: reduce(or_, kinds) for name, kinds in by_name.items()} | {"session": Event}
    return {
        f"{name}-1.json": _text(name, kind, written=issubclass(by_name[name][0], Report))
        for name, kind in every.items()
    }


def _documents(above: type[Document]) -> Iterator[type[Document]]:
    """Classes with an id, in the order in which they are defined."""
    for kind in above.__subclasses__():
        if "schema_id" in kind.model_fields:
            yield kind
        yield from _documents(kind)


def _text(name: str, kind: Any, *, written: bool) -> str:  # noqa: ANN401 (class or union)
    mode: JsonSchemaMode = "serialization" if written else "validation"
    found = TypeAdapter(kind).json_schema(mode=mode, schema_generator=_Untitled)
    head = {"$schema": _Untitled.schema_dialect, "title": f"glidecal.{name}/1"}
    return json.dumps(head | (found | head), indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    write_files(Path(sys.argv[1]), schemas(), replace=True)
