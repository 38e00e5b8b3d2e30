"""JSON Schemas of all documents: ``python -m app.report.schema.schemas FOLDER`` writes them.

Beside the folder it writes what columns of tables are into ``glossary.md``.

That of a line of the record stays as it is, for records are kept: a changed event gets a number of
its own (docs/decisions/0003-record.md).
"""

from __future__ import annotations

import ast
import json
import re
import sys
from collections.abc import Iterator
from dataclasses import is_dataclass
from functools import reduce
from importlib import import_module
from inspect import getsource
from itertools import pairwise
from operator import or_
from pathlib import Path
from pkgutil import iter_modules, walk_packages
from typing import Any, get_args

from pydantic import TypeAdapter
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaMode

import app.evaluating
import app.planning
import app.report.schema
import calib
import protocols
from app.report.schema.document import Report
from calib.quantity import quantities
from protocols.documents import Document
from protocols.files import write_files
from protocols.record import RecordForm
from protocols.session import Line

ROOMS = (app.report.schema, protocols)
"""Where all documents stand that are written, or read again; some of the latter are TOML."""


RESULTS = (calib, app.evaluating, app.planning)
"""Where results are made."""

ID = re.compile(r"glidecal\.(.+)")


class FrozenSchema(Exception):
    """What would have been written over is the schema of records that exist."""


class _Untitled(GenerateJsonSchema):
    """Titles would only repeat the keys."""

    def field_title_should_be_set(self, schema: Any) -> bool:  # noqa: ANN401, ARG002 (pydantic's)
        return False

    def model_schema(self, schema: Any) -> dict[str, Any]:  # noqa: ANN401 (pydantic's)
        """The schema with the docstrings below the fields of a report as their descriptions.

        pydantic can do so, too, but at each start of the program: a tenth of a second.
        """
        json_schema = super().model_schema(schema)
        for kind in schema["cls"].__mro__:
            fields = ast.parse(getsource(kind)).body[0] if issubclass(kind, Report) else None
            for field, words in pairwise(getattr(fields, "body", ())):
                match field, words:
                    case ast.AnnAssign(ast.Name(name)), ast.Expr(ast.Constant(str(text))):
                        json_schema["properties"][name]["description"] = " ".join(text.split())
        return json_schema


def schemas() -> dict[str, str]:
    """The text of each schema by its file name; what several machines write is one of theirs."""
    forms = record_forms()
    by_name: dict[str, list[type[Document]]] = {}
    for kind in _documents(Document):
        (schema_id,) = get_args(kind.model_fields["schema_id"].annotation)
        by_name.setdefault(ID.sub(r"\1", schema_id), []).append(kind)
    texts = {
        f"{name.replace('/', '-')}.json": _text(
            name, reduce(or_, kinds), is_output=issubclass(kinds[0], Report)
        )
        for name, kinds in by_name.items()
    }
    # the first line of a record has the id, a schema is for each of its lines
    return texts | {
        name: _text(ID.sub(r"\1", form.schema), form.lines, is_output=False)
        for name, form in forms.items()
    }


def record_forms() -> dict[str, RecordForm]:
    """Forms of records by the names of their schema files; imports all modules that define
    documents.
    """
    forms: dict[str, RecordForm] = {}
    for room in ROOMS:
        for module in iter_modules(room.__path__, f"{room.__name__}."):
            for value in vars(import_module(module.name)).values():
                if isinstance(value, RecordForm):
                    name = ID.sub(r"\1", value.schema).replace("/", "-")
                    forms[f"{name}.json"] = value
    return forms


def meaning(schema: str) -> object:
    """What a schema asks of a document: all but its descriptions."""
    return _without_descriptions(json.loads(schema))


def _without_descriptions(part: Any) -> Any:  # noqa: ANN401 (JSON)
    if isinstance(part, list):
        return [_without_descriptions(entry) for entry in part]
    if not isinstance(part, dict):
        return part
    # a key of this name is a schema, a description a text
    parts = {key: _without_descriptions(value) for key, value in part.items()}
    return {key: v for key, v in parts.items() if key != "description" or not isinstance(v, str)}


def write_schemas(folder: Path) -> None:
    """Write all of them. Raises FrozenSchema where a line of the record changed."""
    texts = schemas()
    for name, form in record_forms().items():
        former = folder / name
        if former.exists() and meaning(former.read_text("utf-8")) != meaning(texts[name]):
            raise FrozenSchema(
                f"{former}: a line of the record changed. Add {form.name}/{form.number + 1} where "
                "its lines are defined in protocols, then make schemas, make records."
            )
    write_files(folder, texts, replace=True)


COLUMNS = "## Columns of tables\n"
PLAIN = frozenset(
    {
        *("after", "before", "cycles", "effect", "joint offset", "legs", "minutes", "parameter"),
        *("remaining", "size", "standard uncertainty", "station", "tolerance", "unit", "value"),
        "where",
    }
)
"""Labels that name what is below them, or words of the glossary."""


def with_columns(glossary: str) -> str:
    """The glossary with the columns of result tables that need a word, below this heading.

    The schemas describe every column.
    """
    parts = [glossary.partition(COLUMNS)[0], COLUMNS]
    for kind in result_rows():
        labelled = [
            f"- **{quantity.label}**{quantity.unit and f', {quantity.unit}'}: {quantity.words}\n"
            for quantity in quantities(kind).values()
            if quantity.label and quantity.label not in PLAIN
        ]
        if labelled:
            sentence = f"{kind.__doc__}".partition("\n")[0]
            parts += [f"\n{sentence}\n\n", *labelled]
    return "".join(parts)


def result_rows() -> list[type]:
    """Data classes of results that tables are made of, by name."""
    kinds = set()
    for room in RESULTS:
        for module in walk_packages(room.__path__, f"{room.__name__}."):
            kinds |= {kind for kind in vars(import_module(module.name)).values() if _is_row(kind)}
    return sorted(kinds, key=lambda kind: kind.__name__)


def _is_row(kind: object) -> bool:
    """Whether fields have labels; of a class and those that only narrow it the first is enough."""
    if not (isinstance(kind, type) and is_dataclass(kind) and kind.__base__ is object):
        return False
    has_quantity = any("Quantity(" in str(hint) for hint in kind.__annotations__.values())
    return has_quantity and any(q.label is not None for q in quantities(kind).values())


def _documents(above: type[Document]) -> Iterator[type[Document]]:
    """Classes with an id in the order in which they are defined, no lines of a record.

    Where several machines share one, those of the machines.
    """
    for kind in above.__subclasses__():
        below = list(_documents(kind))
        if "schema_id" in kind.model_fields and not issubclass(kind, Line) and not below:
            yield kind
        yield from below


def _text(name: str, kind: Any, *, is_output: bool) -> str:  # noqa: ANN401 (class or union)
    mode: JsonSchemaMode = "serialization" if is_output else "validation"
    adapter = kind if isinstance(kind, TypeAdapter) else TypeAdapter(kind)
    schema = adapter.json_schema(mode=mode, schema_generator=_Untitled)
    head = {"$schema": _Untitled.schema_dialect, "title": f"glidecal.{name}"}
    return json.dumps(head | (schema | head), indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    try:
        folder = Path(sys.argv[1])
        write_schemas(folder)
        glossary = folder.with_name("glossary.md")
        write_files(glossary, {"": with_columns(glossary.read_text("utf-8"))}, replace=True)
    except FrozenSchema as problem:
        sys.exit(str(problem))
