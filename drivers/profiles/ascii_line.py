"""Home-made bridges that print one number a line, read with a pattern of the user's own.

The pattern must match the whole line. Its group ``number`` is the value, a group ``unit`` (if there
is one) the unit. No number is ever searched for inside a line: time stamps are numbers too. The
pattern is read by RE2, whose time grows with the length of the line only, whatever the pattern.
"""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import product

import re2

from calib.errors import IndicatorError
from drivers.profile import (
    UNITS,
    BadReply,
    Evidence,
    FaultKind,
    LineSettings,
    Outcome,
    Profile,
    Query,
    not_understood,
    reading,
)

PATTERN = r"(?P<number>[+-]?0{0,4}\d{0,4}\.\d{1,6})(?: ?(?P<unit>mm|inches|inch|in|um|µm))?"
NUMBER = re.compile(r"[+\- ]? *(?:\d{1,9}\.?\d{0,9}|\.\d{1,9})", re.ASCII)
PIECE = re.compile(r"\\.|\[\^?\]?(?:\\.|[^\]\\])*\]|.", re.DOTALL)
EXAMPLE = r"(?P<number>[+-]?\d+\.\d+)"


def checked(pattern: str) -> re2._Regexp:
    """The compiled pattern. Raises IndicatorError if it cannot give a number."""
    requirement = (
        f"a regular expression with a group named number, such as {EXAMPLE}, "
        "without look-around and back-references"
    )
    quiet = re2.Options()
    quiet.log_errors = False
    try:
        compiled = re2.compile(pattern, quiet)
        number = re2.compile(source_of_number(pattern), quiet)
    except (re2.error, UnicodeError) as problem:
        reason = problem.args[0]
        why = reason.decode("utf-8", "replace") if isinstance(reason, bytes) else str(problem)
        fault = f"{pattern!r} ({why})"
        raise IndicatorError("pattern of ascii-line", fault, requirement) from problem
    if "number" not in compiled.groupindex:
        raise IndicatorError(
            "pattern of ascii-line", f"{pattern!r} without that group", requirement
        )
    if not any(number.fullmatch(sample) for sample in samples()):
        requirement = f"a group number that alone matches decimal numbers, such as {EXAMPLE}"
        raise IndicatorError("pattern of ascii-line", f"{pattern!r}, no number fits", requirement)
    return compiled


def source_of_number(pattern: str) -> str:
    """What stands between the parentheses of the group ``number``; empty if there is none."""
    inside = pattern.partition("(?P<number>")[2]
    depth = 1
    for piece in PIECE.finditer(inside):
        depth += {"(": 1, ")": -1}.get(piece[0], 0)
        if not depth:
            return inside[: piece.start()]
    return ""


def samples() -> list[str]:
    """Decimal numbers of all lengths, signs and paddings."""
    shapes = product(("", "+", "-", " ", "+  "), range(10), ("", "."), range(10), "01")
    samples = (f"{sign}{d * integer}{point}{d * part}" for sign, integer, point, part, d in shapes)
    return [sample for sample in samples if NUMBER.fullmatch(sample)]


def ascii_line(pattern: str, *, request: bytes = b"") -> Profile:
    """A profile for this pattern; without a request the device streams. Raises IndicatorError."""
    compiled = checked(pattern)

    def parse(text: str, query: Query) -> Outcome | None:
        match = compiled.fullmatch(text)
        groups = match.groupdict() if match else {}
        number, unit = groups.get("number") or "", groups.get("unit")
        if not NUMBER.fullmatch(number) or (unit and unit not in UNITS):
            return not_understood(text)
        return reading(text, number, query, UNITS[unit] if unit else None)

    return Profile(
        name="ascii-line",
        title="Bridge that prints one number a line",
        verified=Evidence.CODE,
        source="open-source Arduino bridges; a pattern of your own is yours to verify",
        line=LineSettings(baud=9600),
        request=(lambda _: request) if request else None,
        parse=parse,
        reply=lambda spindle: f"{spindle.text().removeprefix('+')}\r\n",
        stream_s=0.0 if request else 0.1,
        hint="An Arduino restarts when its port is opened: wait 2 s; most print no unit.",
    )


BAD_REPLIES = {
    "comment": BadReply(b"# Error reading from instrument: -1\r\n", FaultKind.NOT_UNDERSTOOD),
    "time-stamp": BadReply(b"15052 ms 1.47 mm\r\n", FaultKind.NOT_UNDERSTOOD),
    "wrong-unit": BadReply(b"0.0390 inches\r\n", FaultKind.WRONG_UNIT),
}
ASCII_LINE = replace(ascii_line(PATTERN), bad_replies=BAD_REPLIES)
