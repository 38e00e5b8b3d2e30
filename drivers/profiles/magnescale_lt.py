"""Magnescale LT displays: LT30, and the replies of LT10A and LT20A.

Reply: channel letter, in long mode also mode, unit and comparator letters, sign (blank for plus),
7 characters with a floating point, CR LF; channel B may follow on the same line. An ``F`` among the
digits is an overflow, ``E`` behind the letter an alarm.
"""

from __future__ import annotations

import re
from dataclasses import replace

from drivers.profile import (
    BadReply,
    Evidence,
    Fault,
    FaultKind,
    Grammar,
    LineSettings,
    Outcome,
    Profile,
    Query,
    Spindle,
    not_understood,
)

MODE = r"(?:[NPIA](?P<unit>[MI])[UGLE]?)?"
FIELD = Grammar(
    value=MODE + r"(?P<number>[+\- ](?=[\d.]{7}$)\d+\.\d+)",
    fault=MODE + r'(?=.*(?P<code>F))[+\- ]?[\dF.]{6,8}|E[FO]?|[NPIA][MI]E?"? *Error *"?',
    words={"F": "the display overflows: reset it nearer to here"},
    other_words=(
        "alarm of the display: moved too fast or the cable is off; reset it, set zero again"
    ),
    kinds={"F": FaultKind.OVER_RANGE},
)
LINE = re.compile(r"(?:A(?P<A>[^B]+?))?(?:[ ,;]?B(?P<B>[^B]+))?", re.ASCII)


def parse(text: str, query: Query) -> Outcome | None:
    """A line without CR LF; None for the echo."""
    if text == "*r":
        return None
    match = LINE.fullmatch(text)
    fields = {name: field for name, field in match.groupdict().items() if field} if match else {}
    if not fields or any(
        not_understood(field) == FIELD.parse(field, Query()) for field in fields.values()
    ):
        return not_understood(text)
    letter = chr(ord("A") + query.channel - 1)
    if letter not in fields:
        message = f"answer of channel {'/'.join(fields)} where channel {letter} was asked"
        return Fault(FaultKind.WRONG_CHANNEL, text, message)
    outcome = FIELD.parse(fields[letter], query)
    return replace(outcome, text=text) if outcome else None


def reply(spindle: Spindle) -> str:
    """The reply in short form; a number too long for the display overflows."""
    text = spindle.text(7)
    if len(text) > 8:
        text = f"{text[0]}F{text[-6:]}"
    return f"{'A' if spindle.channel == 1 else 'A+00.0000 B'}{text}\r\n"


MAGNESCALE_LT = Profile(
    name="magnescale-lt",
    title="Magnescale LT30, LT20A, LT10A displays",
    verified=Evidence.CODE,
    source="reply: manuals of LT20A (p. 100) and LT10A (p. 16); request: open-source LT30 reader",
    line=LineSettings(baud=9600),
    request=lambda _: b"*r\r\n",
    parse=parse,
    reply=reply,
    bad_replies={
        "over-range": BadReply(b"A+F2.3456\r\n", FaultKind.OVER_RANGE),
        "alarm": BadReply(b"AE\r\n", FaultKind.DEVICE_FAULT),
        "alarm-long": BadReply(b'ANME"  Error "\r\n', FaultKind.DEVICE_FAULT),
        "wrong-unit": BadReply(b"ANI+0.12345\r\n", FaultKind.WRONG_UNIT),
    },
    hint="After an alarm (AE) the position is lost: reset the display and set zero again.",
)
