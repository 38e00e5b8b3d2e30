"""Shared habits of every document that is read or written: strict, frozen, explicit errors."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from datetime import date
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import ErrorDetails

from calib.errors import RecordError
from calib.printable import printable
from protocols.files import open_to_read, unreadable

Name = Annotated[str, AfterValidator(printable)]
"""One line: line breaks and other hidden characters are shown, nothing is obeyed."""

MOST_LETTERS = 200
Words = Annotated[str, Field(max_length=MOST_LETTERS), AfterValidator(printable)]
"""A line that a person types into a form."""

Day = Annotated[date, Field(ge=date(1950, 1, 1), le=date(2100, 1, 1))]

LARGEST_MM = 100_000.0
"""No machine of these kinds is larger."""

LengthMm = Annotated[float, Field(ge=-LARGEST_MM, le=LARGEST_MM)]
Triple = tuple[LengthMm, LengthMm, LengthMm]
ZERO: Triple = (0.0, 0.0, 0.0)


T = TypeVar("T")


def triple(values: Iterable[T]) -> tuple[T, T, T]:
    """Three values, of drives x, y, z or of a place, as documents have them."""
    x, y, z = values
    return x, y, z


LEAST_FIGURE_MM = 1e-9
"""Smaller figures of an indicator are none: the squares of readings over them have no room."""


def _is_figure(value_mm: float) -> float:
    if 0.0 < value_mm < LEAST_FIGURE_MM:
        raise ValueError(f"0, or {LEAST_FIGURE_MM:g} mm at least")
    return value_mm


FigureMm = Annotated[float, Field(ge=0.0, le=100.0), AfterValidator(_is_figure)]
"""What is stated of an indicator; one that shows whole inches resolves 25.4 mm."""

Tolerance = Annotated[float, Field(ge=1e-9, le=100.0)]
LONGEST_S = 1e9
Seconds = Annotated[float, Field(ge=-LONGEST_S, le=LONGEST_S)]
Celsius = Annotated[float, Field(ge=-300.0, le=2000.0)]
LARGEST_COUNT = 1_000_000
Count = Annotated[int, Field(ge=1, le=LARGEST_COUNT)]
Seed = Annotated[int, Field(ge=0)]
Origin = Literal["measured", "simulated", "imported"]
"""Of the readings of a session."""


class Document(BaseModel):
    """Strict and frozen: no coercion of text to numbers, no unknown keys, no NaN."""

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        strict=True,
        allow_inf_nan=False,
        serialize_by_alias=True,
        defer_build=True,  # most are parts of others: built alone they took 0.04 s of every start
    )


MOST_FAULTS, MOST_KEYS = 3, 20
"""That a message names."""

MOST_BYTES = 16_000_000
MOST_EDITED_BYTES = 1_000_000
"""Of a file that a person writes."""

D = TypeVar("D", bound=BaseModel)


def read_toml(path: Path, kind: type[D], subject: str, next_step: str = "") -> D:
    """The document in a TOML file. Raises RecordError naming the file, the key and the value.

    ``next_step`` is for a text of another kind.
    """
    text = read_text(path, subject, MOST_EDITED_BYTES)
    if is_deep(text):
        raise RecordError(f"{subject} {path}", "a key of very many parts", "TOML text")
    try:
        # strict validation takes lists for tuples only from JSON, and TOML has no tuples
        content = json.dumps(tomllib.loads(text), default=str)
    except (ValueError, RecursionError) as problem:
        raise RecordError(
            f"{subject} {path}", str(problem), "TOML text", _comma(text, problem) or next_step
        ) from problem
    try:
        return kind.model_validate_json(content)
    except ValidationError as problem:
        raise RecordError(
            f"{subject} {path}", reason=describe(problem, text), next_step=_keys_for(problem, kind)
        ) from problem


def _comma(text: str, problem: Exception) -> str:
    """What to do where the line that the message names has a decimal comma."""
    place = re.search(r"at line (\d+)", str(problem))
    line = text.splitlines()[int(place[1]) - 1] if place else ""
    return "Write decimals with a point." if re.search(r"=\s*[+-]?\d+,\d+\s*(#|$)", line) else ""


def _keys_for(problem: ValidationError, kind: type[BaseModel]) -> str:
    """Which keys there are, for faults of unknown ones: those most like them, else all of few."""
    unknown = [
        str(fault["loc"][0])
        for fault in problem.errors()
        if fault["type"] == "extra_forbidden" and len(fault["loc"]) == 1
    ][:MOST_FAULTS]
    if not unknown:
        return ""
    keys = [field.alias or name for name, field in kind.model_fields.items()]
    matches = dict.fromkeys(match for key in unknown for match in get_close_matches(key, keys, 2))
    if matches:
        return f"Keys like these: {', '.join(matches)}"
    if len(keys) <= MOST_KEYS:
        return f"Keys: {', '.join(keys)}"
    schema = get_args(kind.model_fields["schema_id"].annotation)[-1].removeprefix("glidecal.")
    return f"docs/schemas/{schema.replace('/', '-')}.json lists the {len(keys)} keys"


def toml_text(content: Mapping[str, Any], comments: Iterable[str]) -> str:
    """A TOML file below ``comments``, a line each: its keys, then its tables, in their order."""
    lines = [f"# {line}".rstrip() for line in comments]
    tables: list[tuple[str, dict[str, Any]]] = []
    for key, value in content.items():
        if isinstance(value, dict):
            tables.append((f"[{key}]", value))
        elif isinstance(value, list) and isinstance(value[0], dict):
            tables += [(f"[[{key}]]", entry) for entry in value]
        else:
            lines.append(f"{key} = {json.dumps(value)}")
    for heading, table in tables:
        lines += ["", heading, *(f"{key} = {json.dumps(value)}" for key, value in table.items())]
    return "\n".join(lines) + "\n"


def read_json(
    path: Path,
    kind: type[D],
    subject: str,
    requirement: str,
    next_step: str = "",
    renewed: Callable[[str], str] = str,
) -> D:
    """The document in a JSON file, its text first ``renewed`` to what the program writes today.

    Raises RecordError naming the file, the place and the value.
    """
    try:
        return kind.model_validate_json(renewed(read_text(path, subject)))
    except ValidationError as problem:
        fault = describe(problem)
        raise RecordError(
            f"{subject} {path}", reason=fault, allowed=requirement, next_step=next_step
        ) from problem


def refuse_empty(document: Document, subject: str, requirement: str, next_step: str) -> None:
    """Raises RecordError for a file that states nothing, or nothing but its schema.

    A forgotten or cut file would pass for the machine of the papers.
    """
    if not document.model_fields_set - {"schema_id"}:
        raise RecordError(subject, "no key but schema", requirement, next_step)


def read_remembered(path: Path, kind: type[D], subject: str) -> D:
    """What the program remembers in a JSON file of its own; ``kind()`` where there is none yet.

    Raises as `read_json`.
    """
    if not path.exists():
        return kind()
    requirement, next_step = ("what the program wrote", "Remove the file: it is written again")
    return read_json(path, kind, subject, requirement, next_step)


def read_text(path: Path, subject: str, most_bytes: int = MOST_BYTES) -> str:
    """The text of a file as UTF-8, line breaks as ``\\n``. Raises as `read_bytes`."""
    try:
        text = read_bytes(path, subject, most_bytes).decode("utf-8-sig")
    except UnicodeDecodeError as problem:
        next_step = "Save it as UTF-8; editors and spreadsheets offer that where they save."
        raise RecordError(
            f"{subject} {path}", next_step=next_step, reason="not UTF-8 text"
        ) from problem
    return text.replace("\r\n", "\n").replace("\r", "\n")


def read_bytes(path: Path, subject: str, most_bytes: int = MOST_BYTES) -> bytes:
    """The content of a file: the one door for files of a user.

    Raises RecordError where it cannot be read, is no ordinary file or larger than ``most_bytes``.
    """
    try:
        with open_to_read(path) as file:
            content = file.read(most_bytes + 1)
    except OSError as problem:
        raise unreadable(f"{subject} {path}", problem) from problem
    if len(content) > most_bytes:
        size, requirement = f"more than {most_bytes:,} bytes", f"a file up to {most_bytes:,} bytes"
        raise RecordError(f"{subject} {path}", size, requirement)
    return content


def with_serial_number(name: str, serial_number: str | None) -> str:
    """The name of a machine, with its serial number where one is stated."""
    return f"{name}, no. {serial_number}" if serial_number else name


def describe(problem: ValidationError, text: str | None = None) -> str:
    """The first faults of a document in one line: where, what is wrong, the value found.

    With the TOML ``text`` of the document each fault names its line. What a validator of ours says
    of the document as a whole is a sentence of its own and stays whole.
    """
    errors = problem.errors(include_url=False)
    faults = []
    for fault in errors[:MOST_FAULTS]:
        # of a choice of several kinds pydantic names the kind that was tried, too
        parts = [str(part) for part in fault["loc"] if str(part) not in KINDS]
        place = ".".join(part for part in parts if "[" not in part)[:60]
        line = line_of(text, fault["loc"]) if text else None
        place = f"line {line}, {place}" if line else place
        message = fault_words(fault)
        nested = isinstance(fault["input"], dict) or "{" in repr(fault["input"])[:2]
        value = "" if nested or fault["type"] == "missing" else f" (found {fault['input']!r:.40})"
        faults.append(f"{place}: {message}{value}" if place else message)
    further_count = len(errors) - len(faults)
    return "; ".join(faults) + (f"; and {further_count} more" if further_count > 0 else "")


ALLOWED = {
    "missing": "missing",
    "extra_forbidden": "no such key",
    "string_type": "must be a text",
    "string_too_short": "must have at least {min_length} letters",
    "string_too_long": "must have at most {max_length} letters",
    "string_pattern_mismatch": "must be a text of the form {pattern}",
    "float_type": "must be a number",
    "float_parsing": "must be a number",
    "int_type": "must be a whole number",
    "int_parsing": "must be a whole number",
    "int_from_float": "must be a whole number",
    "finite_number": "must be a finite number",
    "greater_than_equal": "must be at least {ge}",
    "greater_than": "must be more than {gt}",
    "less_than_equal": "must be at most {le}",
    "less_than": "must be less than {lt}",
    "bool_type": "must be true or false",
    "bool_parsing": "must be true or false",
    "literal_error": "must be {expected}",
    "enum": "must be {expected}",
    "model_type": "must be a table of keys",
    "dict_type": "must be a table of keys",
    "tuple_type": "must be a list",
    "list_type": "must be a list",
    "too_short": "must have {min_length} or more entries",
    "too_long": "must have {max_length} or fewer entries",
    "date_type": "must be a date as 2026-01-31",
    "date_parsing": "must be a date as 2026-01-31",
    "date_from_datetime_parsing": "must be a date as 2026-01-31",
    "date_from_datetime_inexact": "must be a date as 2026-01-31",
    "datetime_type": "must be a time as 2026-01-31T12:00:00Z",
    "datetime_from_date_parsing": "must be a time as 2026-01-31T12:00:00Z",
    "datetime_parsing": "must be a time as 2026-01-31T12:00:00Z",
    "timezone_aware": "must be a time as 2026-01-31T12:00:00Z",
    "none_required": "must be left out",
    "union_tag_invalid": "unknown {discriminator}: {tag}",
    "json_invalid": "no JSON text: {error}",
}
"""By the kind of a fault, what is allowed; pydantic's own words are for programmers."""

KINDS = ("float", "int", "str", "constrained-float", "constrained-int", "constrained-str")


def fault_words(fault: ErrorDetails) -> str:
    """What is wrong with a value, or would be right; the value is not in it."""
    context = fault.get("ctx", {})
    if fault["type"] == "value_error":
        return str(context["error"])
    values = {key: f"{v:g}" if isinstance(v, float) else f"{v}" for key, v in context.items()}
    sentence = ALLOWED.get(fault["type"])
    return fault["msg"][:120] if sentence is None else sentence.format(**values)


STRING = r'"(?:\\.|[^"\\\n])*"|\'[^\'\n]*\''
LONG_STRING = r'"""(?:\\.|[^\\])*?"{3,5}|\'\'\'.*?\'{3,5}'
COMMENT = r"#[^\n]*"
TOKEN = re.compile(rf"""{STRING}|{COMMENT}|[\[\]{{}},]|\n|[^\s"'#\[\]{{}},]+""")
TEXTS = re.compile(rf"{LONG_STRING}|{STRING}|{COMMENT}", re.DOTALL)
DEEP_KEY = re.compile(r"""(?<![\w-])(?:(?:"[^"\n]*"|'[^'\n]*'|[\w-]++)[ \t]*+\.[ \t]*+){32}""")
HEADER = re.compile(r"^\s*\[\[?\s*([^\]]+?)\s*\]\]?\s*(#.*)?$")


def line_of(text: str, location: Sequence[str | int]) -> int | None:
    """Line of a key, of an entry of its array, or of an entry of ``[[key]]``; None if not there.

    ``location`` is what a validator gives: ``("levels", 3)`` or ``("indicator", 0, "port")``.
    """
    tables = [str(part) for part in location if isinstance(part, str)]
    numbers = [part for part in location if isinstance(part, int)]
    if not tables:
        return None
    lines = TEXTS.sub(_shortened, text).split("\n")
    matches = ((k, HEADER.match(line)) for k, line in enumerate(lines))
    headers = [k for k, header in matches if header and header[1] == tables[0]]
    if headers:
        start = headers[min(numbers[0] if numbers else 0, len(headers) - 1)]
        inside = _key_line(lines, start + 1, tables[1]) if len(tables) > 1 else None
        return (start if inside is None else inside) + 1
    at = _key_line(lines, 0, tables[0])
    if at is None:
        return None
    entries = _entries("\n".join(lines[at:]).split("=", 1)[1]) if numbers else ()
    return at + 1 + next((offset for entry, offset in entries if entry == numbers[0]), 0)


def is_deep(text: str) -> bool:
    """Whether a key has so many parts that reading it would take very long."""
    # a string may be a part of a key, whatever it says; a comment is none
    keys = TEXTS.sub(lambda match: "" if match[0][0] == "#" else '""', text)
    return DEEP_KEY.search(keys) is not None


def _shortened(match: re.Match[str]) -> str:
    """A string of several lines without what it says, which may look like a key or a header."""
    text = match[0]
    return '""' + "\n" * text.count("\n") if text[:3] in {'"""', "'''"} else text


def _key_line(lines: Sequence[str], start: int, key: str) -> int | None:
    """The line ``key = …`` from here to the next header."""
    assignment = re.compile(rf"""^\s*["']?{re.escape(key)}["']?\s*=""")
    for k in range(start, len(lines)):
        if assignment.match(lines[k]):
            return k
        if HEADER.match(lines[k]) and "=" not in lines[k]:
            return None
    return None


def _entries(text: str) -> Iterator[tuple[int, int]]:
    """Number and line offset of each entry of the array that the text begins with."""
    depth = entry = line = 0
    fresh = False
    for token in TOKEN.findall(text):
        if token == "\n":
            line += 1
        elif token[0] == "#":
            continue
        elif token == "," and depth == 1:
            entry, fresh = entry + 1, True
        elif token in "]}":
            depth -= 1
            if depth == 0:
                return
        else:
            if fresh:
                yield entry, line
                fresh = False
            if token in "[{":
                depth += 1
                fresh = fresh or depth == 1
