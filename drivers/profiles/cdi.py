"""CDI Logic and Plus indicators (Chicago Dial Indicator).

``R`` is answered by sign, number padded with blanks, comma, blank, ``IN`` or ``MM``, CR LF. The
vendor counts 8 characters of number and prints 9, so both are read.
"""

from __future__ import annotations

import re

from drivers.profile import (
    Asked,
    BadReply,
    FaultKind,
    LineSettings,
    Outcome,
    Profile,
    Spindle,
    Twin,
    Unit,
    Verified,
    not_understood,
    reading,
)
from drivers.twins import Answering

VALUE = re.compile(
    r"(?P<number>[+-](?=[ \d.]{8,9},) *(?:\d+\.\d+|\.\d+)), (?P<unit>IN|MM)", re.ASCII
)
UNITS = {"IN": Unit.INCH, "MM": Unit.MM}


def parse(text: str, asked: Asked) -> Outcome | None:
    """A line without CR LF; None for the echo."""
    if text == "R":
        return None
    if found := VALUE.fullmatch(text):
        return reading(text, found["number"], asked, UNITS[found["unit"]])
    return not_understood(text)


def twin(spindle: Spindle) -> Twin:
    """Answers ``R`` in mm, as the vendor prints it."""

    def answer(request: bytes) -> bytes:
        if request != b"R":
            return b""
        text = spindle.text(max(1, spindle.decimals))
        return f"{text[0]}{text[1:]:>9}, MM\r\n".encode()

    return Answering(answer)


CDI = Profile(
    name="cdi",
    title="CDI Logic and Plus",
    verified=Verified.VENDOR,
    source="technical support page of dialindicator.com",
    line=LineSettings(baud=9600),
    request=lambda _: b"R\r",
    parse=parse,
    make_twin=twin,
    bad_replies={
        "wrong-unit": BadReply(b"-   0.0050, IN\r\n", FaultKind.WRONG_UNIT),
    },
    hint="The reply names the unit of the display: switch it to mm; a held value freezes.",
)
