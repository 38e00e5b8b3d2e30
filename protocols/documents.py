"""Shared habits of every document that is read or written: strict, frozen, explicit errors."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Annotated, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from calib.printable import printable
from protocols.errors import RecordError
from protocols.own_files import open_to_read
from protocols.toml_lines import is_deep, line_of

Name = Annotated[str, AfterValidator(printable)]
"""One line: line breaks and other hidden characters are shown, nothing is obeyed."""

LengthMm = Annotated[float, Field(ge=-100_000.0, le=100_000.0)]
LEAST_FIGURE_MM = 1e-9
"""Smaller figures of an indicator are none: the squares of readings over them have no room."""


def _is_figure(value_mm: float) -> float:
    if 0.0 < value_mm < LEAST_FIGURE_MM:
        raise ValueError(f"0, or {LEAST_FIGURE_MM:g} mm at least")
    return value_mm


FigureMm = Annotated[float, Field(ge=0.0, le=100.0), AfterValidator(_is_figure)]
"""What is stated of an indicator; one that shows whole inches resolves 25.4 mm."""

Tolerance = Annotated[float, Field(ge=1e-9, le=100.0)]
Seconds = Annotated[float, Field(ge=-1e9, le=1e9)]
Celsius = Annotated[float, Field(ge=-300.0, le=2000.0)]
Count = Annotated[int, Field(ge=1, le=1_000_000)]
Seed = Annotated[int, Field(ge=0)]


class Document(BaseModel):
    """Strict and frozen: no coercion of text to numbers, no unknown keys, no NaN."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, allow_inf_nan=False, serialize_by_alias=True
    )


MOST_FAULTS = 3
MOST_BYTES = 16_000_000
MOST_WRITTEN_BYTES = 1_000_000
"""Of a file that a person writes."""

D = TypeVar("D", bound=BaseModel)


def read_toml(path: Path, kind: type[D], what: str) -> D:
    """The document in a TOML file. Raises RecordError naming the file, the key and the value."""
    text = read_text(path, what, MOST_WRITTEN_BYTES)
    if is_deep(text):
        raise RecordError(f"{what} {path}", "a key of very many parts", "TOML text")
    try:
        # strict validation takes lists for tuples only from JSON, and TOML has no tuples
        content = json.dumps(tomllib.loads(text), default=str)
    except (ValueError, RecursionError) as problem:
        raise RecordError(f"{what} {path}", str(problem), "TOML text") from problem
    try:
        return kind.model_validate_json(content)
    except ValidationError as problem:
        raise RecordError(
            f"{what} {path}", describe(problem, text), next_step=_keys(kind)
        ) from problem


def read_text(path: Path, what: str, most_bytes: int = MOST_BYTES) -> str:
    """The text of a file as UTF-8, line breaks as ``\\n``.

    The one door for files of a user. Raises RecordError where it cannot be read, is no ordinary
    file or larger than ``most_bytes``.
    """
    try:
        with open_to_read(path) as file:
            content = file.read(most_bytes + 1)
        if len(content) <= most_bytes:
            text = content.decode("utf-8-sig")
            return text.replace("\r\n", "\n").replace("\r", "\n")
        reason = f"more than {most_bytes:,} bytes"
        allowed = f"a file up to {most_bytes:,} bytes"
    except OSError as problem:
        reason, allowed = problem.strerror or str(problem), "a readable UTF-8 file"
    except ValueError:  # also a name with a zero byte
        reason, allowed = "not UTF-8 text", "a readable UTF-8 file"
    raise RecordError(f"{what} {path}", reason, allowed)


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
