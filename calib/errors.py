"""What can go wrong, as one tree; every room raises its own leaves.

GlidecalError
├── CalibrationError           what mathematics meets
│   ├── UnreachablePosture
│   ├── NotIdentifiable
│   └── ImpossibleRequest
├── RecordError                what a file or record meets
├── UsageError                 what a command line meets
├── IndicatorError             what a port meets
└── MotionError                what the controller of the machine meets

An error says four things: the thing, the value found (or the reason), what is allowed, and what to
do next.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from numbers import Integral, Real
from typing import get_args

from calib.printable import printable

LONGEST_FOUND = 300


class GlidecalError(Exception):
    """Base of every error that is meant for a person.

    ``thing`` names what is wrong, ``found`` the value met, ``allowed`` what would be right and
    ``next_step`` what to do. Where no value was met ``reason`` says what the matter is. Empty parts
    are left out of the paragraph.
    """

    def __init__(
        self,
        thing: str,
        found: str = "",
        allowed: str = "",
        next_step: str = "",
        *,
        reason: str = "",
    ) -> None:
        self.thing = thing
        self.found = found
        self.reason = reason
        self.allowed = allowed
        self.next_step = next_step
        super().__init__(self.paragraph())

    def paragraph(self) -> str:
        """One short paragraph in the order thing, found, allowed, next step."""
        fault = f"found {_short(self.found)}" if self.found else _short(self.reason)
        parts = [
            f"{self.thing}: {fault}" if fault else self.thing,
            f"Allowed: {self.allowed}" if self.allowed else "",
            self.next_step,
        ]
        return printable(" ".join(sentence(part) for part in parts if part))


def sentence(text: str) -> str:
    """The text with a mark at its end."""
    return text if text.endswith(("?", "!", "…")) else text.rstrip(".") + "."


def _short(text: str) -> str:
    """The text on one line, its end left out where it is long."""
    line = " ".join(text.split())
    return line if len(line) <= LONGEST_FOUND else line[:LONGEST_FOUND] + " …"


class CalibrationError(GlidecalError):
    """The mathematics cannot go on with what it was given."""


class UnreachablePosture(CalibrationError):
    """No tool position satisfies the leg lengths for these carriages, or the reverse."""


class NotIdentifiable(CalibrationError):
    """The readings do not determine what was asked for."""


class ImpossibleRequest(CalibrationError):
    """What is asked for does not exist or cannot be had."""


class RecordError(GlidecalError):
    """A file or record that cannot be used."""


class UsageError(GlidecalError):
    """A name or option that does not exist or does not fit."""


def check_choice(option: str, word: str | None, choices: object) -> None:
    """Raises UsageError for a word that is none of a Literal."""
    if word is not None and word not in get_args(choices):
        raise UsageError(option, repr(word), ", ".join(get_args(choices)))


def check_number(
    thing: str, value: object, least: float, most: float, unit: str = "", allowed: str = ""
) -> None:
    """Raises UsageError for what is no number from ``least`` to ``most``, both finite.

    ``allowed`` says so in other words. Where ``least`` is an integer, so must the value be.
    """
    kind = Integral if isinstance(least, int) else Real
    is_number = isinstance(value, kind) and not isinstance(value, bool)
    if not is_number or not least <= value <= most:  # type: ignore[operator]  # nor NaN
        kind_words = "a whole number" if kind is Integral else "a number"
        text = allowed or f"{kind_words} from {least:g} to {most:g} {unit}".rstrip()
        value_words = f"{value:g} {unit}".rstrip() if isinstance(value, float) else f"{value!r}"
        raise UsageError(thing, value_words, text)


class IndicatorError(GlidecalError):
    """An indicator or port that cannot be used."""


class MotionError(GlidecalError):
    """A controller that does not move the machine, or not where it was told to."""


@contextmanager
def extra(thing: str, name: str, otherwise: str = "") -> Iterator[None]:
    """Guard imports of what the extra ``name`` installs. Raises UsageError about the ``thing``."""
    try:
        yield
    except ImportError as problem:
        raise UsageError(
            thing,
            f"no package {problem.name or problem}",
            f"an installation with the extra {name}",
            f"Install it with: {install_command(name)}{otherwise}",
        ) from problem


def install_command(name: str) -> str:
    """The command that installs the packages of an extra into this Python.

    It names the packages, for that is right in a clone as from a wheel: the program itself need be
    in no index.
    """
    from importlib import metadata  # 0.02 s to import: only where an extra is missing

    try:
        requirements = metadata.requires("glidecal") or []
    except metadata.PackageNotFoundError:  # never installed: run from its folder
        requirements = []
    marker = re.compile(rf"""extra == ['"]{re.escape(name)}['"]""")
    pairs = (requirement.partition(";") for requirement in requirements)
    packages = [package.strip() for package, _, extras in pairs if marker.search(extras)]
    arguments = " ".join(f'"{package}"' for package in packages) or f'"glidecal[{name}]"'
    python = f'"{sys.executable}"' if " " in sys.executable else sys.executable or "python"
    return f"{python} -m pip install {arguments}"
