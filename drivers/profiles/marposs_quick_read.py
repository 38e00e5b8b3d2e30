"""Marposs Quick Read displays.

``M?`` is answered by sign and 7 characters with a floating point, without a unit; a tolerance flag
may follow. A single letter tells why there is no value, ``ERRn`` refuses a command.
"""

from __future__ import annotations

import re

from drivers.profile import (
    Asked,
    BadReply,
    Fault,
    FaultKind,
    LineSettings,
    Outcome,
    Profile,
    Spindle,
    Twin,
    Verified,
    not_understood,
    reading,
)
from drivers.twins import Answering

VALUE = re.compile(r"(?P<number>[+-](?=[\d.]{7}[<>@X]?$)\d+\.\d+)[<>@X]?", re.ASCII)
FAULT = re.compile(r"ERR(?P<code>\d{1,2})", re.ASCII)

LETTERS = {
    "O": (FaultKind.OVER_RANGE, "outside the measuring range: move the head closer to its zero"),
    "N": (FaultKind.DEVICE_FAULT, "the display is not zeroed: set zero on the master"),
    "I": (FaultKind.DEVICE_FAULT, "the display cannot send now: leave its menu"),
}


def parse(text: str, asked: Asked) -> Outcome | None:
    """A line without its end; None for the echo."""
    if text == "M?":
        return None
    if found := VALUE.fullmatch(text):
        return reading(text, found["number"], asked)
    if text in LETTERS:
        kind, words = LETTERS[text]
        return Fault(kind, text, words)
    if found := FAULT.fullmatch(text):
        words = f"the display refuses the command (fault {found['code']})"
        return Fault(FaultKind.DEVICE_FAULT, text, words)
    return not_understood(text)


def twin(spindle: Spindle) -> Twin:
    """Answers ``M?``; a number too long for the display is over range."""

    def answer(request: bytes) -> bytes:
        if request != b"M?":
            return b"ERR3\r"
        text = spindle.text(max(1, spindle.decimals))
        number = text[1:].zfill(7)
        return f"{text[0]}{number}\r".encode() if len(number) == 7 else b"O\r"

    return Answering(answer)


MARPOSS_QUICK_READ = Profile(
    name="marposs-quick-read",
    title="Marposs Quick Read",
    verified=Verified.VENDOR,
    source="Quick Read manual p. 195-202; line settings are chosen on the unit",
    line=LineSettings(baud=9600),
    request=lambda _: b"M?\r",
    parse=parse,
    make_twin=twin,
    bad_replies={
        "over-range": BadReply(b"O\r", FaultKind.OVER_RANGE),
        "not-zeroed": BadReply(b"N\r", FaultKind.DEVICE_FAULT),
        "cannot-send": BadReply(b"I\r", FaultKind.DEVICE_FAULT),
        "bad-command": BadReply(b"ERR3\r", FaultKind.DEVICE_FAULT),
    },
    hint="N means that the display was not zeroed on its master; speed is set on the unit.",
)
