"""The machine files that come with the program: the one registry of machines by name.

Light, for the command line asks it for names before anything else is imported.
"""

from __future__ import annotations

import re
from contextlib import suppress
from functools import cache
from pathlib import Path

from protocols.files import open_to_read

SCHEMA = "glidecal.machine/1"
USUAL_MACHINE = "orthoglide"
SCHEMA_LINE = re.compile(r'^schema[ \t]*=[ \t]*"([^"\n]{1,60})"', re.MULTILINE)
BEGINNING_BYTES = 400
FORM_OF_SESSION = re.compile(rb'"schema":"glidecal\.([a-z]+)-session/')
"""In the first line of a record that is none of indicators on legs."""

FORM_OF_MODEL = re.compile(rb'"schema"\s*:\s*"glidecal\.([a-z]+)-model/')
"""Near the beginning of a model file of another kind of machine."""

MACHINES = Path(__file__).with_name("machines")


@cache
def machine_names() -> tuple[str, ...]:
    """Names of the machines with three linear drives."""
    texts = {name: path.read_text(encoding="utf-8") for name, path in machine_files().items()}
    return tuple(name for name, text in texts.items() if schema_of(text) == SCHEMA)


@cache
def machine_files() -> dict[str, Path]:
    """All of them by name, in the order of names."""
    return {path.stem: path for path in sorted(MACHINES.glob("*.toml"))}


def schema_of(text: str) -> str:
    """The schema that a TOML text names on a line of its own, empty if none.

    Not by tomllib: a stranger's text may take it for ever.
    """
    match = SCHEMA_LINE.search(text)
    return match[1] if match else ""


def model_form(path: Path) -> str:
    """What the kind of machine of a model file is called, empty: with three linear drives."""
    match = FORM_OF_MODEL.search(beginning_of(path))
    return match[1].decode() if match else ""


def form_name(path: Path) -> str:
    """What the form of a record is called, empty: of indicators on legs, or no record."""
    match = FORM_OF_SESSION.search(beginning_of(path))
    return match[1].decode() if match else ""


def beginning_of(path: Path) -> bytes:
    """The first bytes of a file, empty where it cannot be read."""
    with suppress(OSError), open_to_read(path) as file:
        return bytes(file.read(BEGINNING_BYTES))
    return b""
