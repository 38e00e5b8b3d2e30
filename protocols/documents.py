"""Shared habits of every document that is read or written: strict, frozen, explicit errors."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from protocols.errors import RecordError
from protocols.toml_lines import line_of


class Document(BaseModel):
    """Strict and frozen: no coercion of text to numbers, no unknown keys, no NaN."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, allow_inf_nan=False, serialize_by_alias=True
    )


MOST_FAULTS = 3

D = TypeVar("D", bound=BaseModel)


def read_toml(path: Path, kind: type[D], what: str) -> D:
    """The document in a TOML file. Raises RecordError naming the file, the key and the value."""
    text = read_text(path, what)
    try:
        content = tomllib.loads(text)
    except (ValueError, RecursionError) as problem:
        raise RecordError(f"{what} {path}", str(problem), "TOML text") from problem
    try:
        # strict validation takes lists for tuples only from JSON, and TOML has no tuples
        return kind.model_validate_json(json.dumps(content, default=str))
    except ValidationError as problem:
        raise RecordError(
            f"{what} {path}", describe(problem, text), next_step=_keys(kind)
        ) from problem


def read_text(path: Path, what: str) -> str:
    """The text of a file as UTF-8. Raises RecordError where it cannot be read."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as problem:
        reason = problem.strerror if isinstance(problem, OSError) else "not UTF-8 text"
        raise RecordError(f"{what} {path}", str(reason), "a readable UTF-8 file") from problem


def describe(problem: ValidationError, text: str | None = None) -> str:
    """The first faults of a document in one line: where, what is wrong, the value found.

    With the TOML ``text`` of the document each fault names its line.
    """
    errors = problem.errors(include_url=False)
    faults = []
    for fault in errors[:MOST_FAULTS]:
        where = ".".join(str(part) for part in fault["loc"])[:60] or "document"
        line = line_of(text, fault["loc"]) if text else None
        where = f"line {line}, {where}" if line else where
        nested = isinstance(fault["input"], dict) or "{" in repr(fault["input"])[:2]
        found = "" if nested else f" (found {fault['input']!r:.40})"
        faults.append(f"{where}: {fault['msg'][:120]}{found}")
    more = len(errors) - len(faults)
    return "; ".join(faults) + (f"; and {more} more" if more > 0 else "")


def _keys(kind: type[BaseModel]) -> str:
    return "Keys: " + ", ".join(field.alias or name for name, field in kind.model_fields.items())
