"""Texts for people are plain technical English: private idioms are counted, and only become fewer.

Read *report* for told, *is* for stands, *is used* for counts, *contains* for holds, *available* for
to be had. Ids, code and quoted texts of the program in pages are not looked at; of docstrings only
that each can be read without the name below which it stands.
"""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from tests.conftest import ROOT

ROOMS = ("app", "calib", "drivers", "protocols", "glidecal")

IDIOM = re.compile(
    r"\b(told|tells|said|stands|stood|counts|counted|makes|holds|anew|nobody|whoever"
    r"|(?:is|are|be) had|known (?:is|are)|by (?:itself|themselves)|(?<!such )as (?:it is|they are)"
    r"|(?<!there )(?:is|are) no(?! (?:longer|more)))\b",
    re.IGNORECASE,
)

RIGHT = (
    "holds the platform",  # bars do
    "papers/001 counts",  # parameters
    "no place stands out",
    "nobody at the machine",  # before it moves
    "Nobody at the machine",
    "Nobody is at the machine",
    "{measure.hold} holds",  # what the key does
    "it stands still",
    "said TEXT",  # a column of a table
    "digest, said",
    "SELECT said",
)
"""Where a word is the right one, or no text for people."""

LEFT = {
    # written by programs
    "docs/benchmarks.md": 2,
}
"""Places that are not clean yet, with the idioms that each may have at most: only lower them.

All other places have none.
"""

IGNORED = (
    re.compile(r"^```.*?^```", re.DOTALL | re.MULTILINE),
    re.compile(r"`[^`]*`|!\[[^]]*\]|\]\([^)]*\)|<[^>]*>|\{\{.*?\}\}|\{%.*?%\}"),
    re.compile(r"\"[^\"]{1,80}\""),
)
"""What a page quotes: code, links, pictures, texts of the program."""


def constants(tree: ast.AST) -> Iterator[str]:
    """Texts of a module that are neither docstrings nor ids."""
    bare = set()
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            bare |= {id(part.value) for part in body if isinstance(part, ast.Expr)}
    for node in ast.walk(tree):
        text = node.value if isinstance(node, ast.Constant) and id(node) not in bare else None
        if isinstance(text, str) and " " in text:
            yield text


def idioms(text: str) -> list[str]:
    for right in RIGHT:
        text = text.replace(right, "")
    return [match[1].lower() for match in IDIOM.finditer(" ".join(text.split()))]


def idioms_of(path: Path) -> list[str]:
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        return [idiom for part in constants(ast.parse(text)) for idiom in idioms(part)]
    for pattern in IGNORED:
        text = pattern.sub(" ", text)
    return idioms(text)


def place_of(path: Path) -> str:
    """The file, or the folder of `LEFT` that it is in."""
    name = path.relative_to(ROOT).as_posix()
    return next((place for place in LEFT if name == place or name.startswith(f"{place}/")), name)


def found() -> dict[str, Counter[str]]:
    pages = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")]
    templates = (ROOT / "app").rglob("*.html")
    modules = (path for room in ROOMS for path in (ROOT / room).rglob("*.py"))
    places: dict[str, Counter[str]] = {}
    for path in (*pages, *templates, *modules):
        places.setdefault(place_of(path), Counter()).update(idioms_of(path))
    return places


def test_no_idiom_comes_back() -> None:
    places = found()
    over = {
        place: dict(words) for place, words in places.items() if words.total() > LEFT.get(place, 0)
    }
    assert not over, f"say it in plain English, see tests/test_idioms.py: {over}"


def test_what_is_an_idiom() -> None:
    assert idioms("The file holds it as it is; nobody is told.") == [
        "holds", "as it is", "nobody", "told",
    ]  # fmt: skip
    assert idioms("There is no reading. A bar holds the platform; it is no longer used.") == []
    assert idioms("It is no play, and is not to be had.") == ["is no", "be had"]
    source = 'def f():\n    """Told."""\n    g("it stands", "stands")\n'
    assert list(constants(ast.parse(source))) == ["it stands"]


TORN = re.compile(
    r"(Of|That|Those|The same|Its|Their|They|As|Also|By(?! how much)|With|Without|From|In(?! which)"
    r"|To|For(?! each)|At|On(?! which)|After|Before|It|Until) "
)
"""Docstrings that begin so need their object's name to be read: "Of the sessions."."""


def test_a_docstring_can_be_read_alone() -> None:
    torn = [
        f"{path.relative_to(ROOT)}:{node.lineno} {node.name}"
        for room in ROOMS
        for path in sorted((ROOT / room).rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)
        and TORN.match(ast.get_docstring(node) or "")
    ]
    assert not torn
