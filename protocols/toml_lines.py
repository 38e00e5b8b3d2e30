"""Where in a TOML text a value stands, and what tomllib should not be given.

tomllib tells values, not lines, and its time grows with the square of the parts of a key.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

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
    headers = [k for k, line in enumerate(lines) if _is_header(line, tables[0])]
    if headers:
        start = headers[min(numbers[0] if numbers else 0, len(headers) - 1)]
        inside = _key_line(lines, start + 1, tables[1]) if len(tables) > 1 else None
        return (start if inside is None else inside) + 1
    at = _key_line(lines, 0, tables[0])
    if at is None:
        return None
    return at + 1 + (_entry_offset(lines[at:], numbers[0]) if numbers else 0)


def is_deep(text: str) -> bool:
    """Whether a key has so many parts that reading it would take very long."""
    return DEEP_KEY.search(TEXTS.sub(_key_or_nothing, text)) is not None


def _key_or_nothing(found: re.Match[str]) -> str:
    """A string that could be a part of a key in short; without what it says, and no comment."""
    return '""' if found[0][0] != "#" else ""


def _shortened(found: re.Match[str]) -> str:
    """A string of several lines without what it says, which may look like a key or a header."""
    text = found[0]
    return '""' + "\n" * text.count("\n") if text[:3] in {'"""', "'''"} else text


def _is_header(line: str, name: str) -> bool:
    found = HEADER.match(line)
    return found is not None and found[1] == name


def _key_line(lines: Sequence[str], start: int, key: str) -> int | None:
    """The line ``key = …`` from here to the next header."""
    wanted = re.compile(rf"""^\s*["']?{re.escape(key)}["']?\s*=""")
    for k in range(start, len(lines)):
        if wanted.match(lines[k]):
            return k
        if HEADER.match(lines[k]) and "=" not in lines[k]:
            return None
    return None


def _entry_offset(lines: Sequence[str], wanted: int) -> int:
    """How many lines below its key entry number ``wanted`` of an array begins."""
    for entry, offset in _entries("\n".join(lines).split("=", 1)[1]):
        if entry == wanted:
            return offset
    return 0


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
