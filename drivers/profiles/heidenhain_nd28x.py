"""Heidenhain display units ND 280 and ND 281, asked by the single byte STX.

Reply: sign, ten columns of a number whose leading zeros are blanks, then a blank and the columns
unit (blank mm, ``"`` inch, ``?`` fault), sorting and series, CR LF. The vendor's example has one
blank more than his table, so both widths pass.
"""

from __future__ import annotations

import re

from drivers.profile import (
    BadReply,
    Evidence,
    Fault,
    FaultKind,
    LineSettings,
    Outcome,
    Profile,
    Query,
    Unit,
    not_understood,
    reading,
)

VALUE = re.compile(
    r"[\x02\x06]*"
    r"(?P<number>[+-](?=[ \d.]{9}\d ) *(\d+\.\d+|\.\d+))"
    r"(?= .{3,4}$) {1,2}(?P<unit>[ \"?]) ?(?P<sorting>[<=>? ])[SAGD ]",
    re.ASCII,
)
REFUSED = re.compile(r"[\x02\x06]*(\x15|\?|[A-Z]+\.ERR\.)", re.ASCII)
PASSED_OVER = re.compile(r"[\x02\x06]+", re.ASCII)


def parse(text: str, asked: Query) -> Outcome | None:
    """A line without its end; None for an echo and for the acknowledgement of a key."""
    if PASSED_OVER.fullmatch(text):
        return None
    if REFUSED.fullmatch(text):
        words = "the display unit refuses the request or reports an error: see its display"
        return Fault(FaultKind.DEVICE_FAULT, text, words)
    found = VALUE.fullmatch(text)
    if not found:
        return not_understood(text)
    if "?" in (found["unit"], found["sorting"]):
        words = "the display unit marks this value as faulty: check the encoder and clear the error"
        return Fault(FaultKind.DEVICE_FAULT, text, words)
    return reading(text, found["number"], asked, Unit.INCH if found["unit"] == '"' else Unit.MM)


HEIDENHAIN_ND28X = Profile(
    name="heidenhain-nd28x",
    title="Heidenhain ND 280, ND 281",
    verified=Evidence.VENDOR,
    source="ND 280/281B/221B manual p. 39 and 47",
    line=LineSettings(9600, 7, "E", 2),
    request=lambda _: b"\x02",
    parse=parse,
    reply=lambda spindle: f"{spindle.text(10, ' ')}    \r\n",
    bad_replies={
        "fault": BadReply(b"+   12.3456 ?  \r\n", FaultKind.DEVICE_FAULT),
        "refused": BadReply(b"\x15\r\n", FaultKind.DEVICE_FAULT),
        "format-error": BadReply(b"\x02FORMAT.ERR.\r\n", FaultKind.DEVICE_FAULT),
        "wrong-unit": BadReply(b'+   0.50000 "  \r\n', FaultKind.WRONG_UNIT),
    },
    hint="Speed, parity and the blank lines after a value are set in the unit's menu.",
)
