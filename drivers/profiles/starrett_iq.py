"""Starrett IQ indicators, over USB or RS-232.

``R`` is answered by sign, number padded with blanks to 7 characters, comma, blank, ``IN`` or
``MM``, CR. Faults are words in capitals; a parameter of the indicator can silence them.
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
from drivers.profiles.cdi import UNITS
from drivers.twins import Answering

VALUE = re.compile(
    r"(?P<number>[+-](?=[ \d.]{7,8},) *(?:\d+\.\d+|\.\d+)), (?P<unit>IN|MM)", re.ASCII
)
PASSED_OVER = ("R", "SUCCESS")

FAULT_WORDS = {
    "NOT FOUND": "the indicator does not know this command",
    "NO ACCESS": "the indicator does not allow this command now",
    "OUT OF BOUNDS": "a parameter of the indicator is set outside its limits",
    "NON NUMERIC": "the indicator expected a number in the command",
}


def parse(text: str, asked: Asked) -> Outcome | None:
    """A line without CR; None for the echo and the receipt of a setting."""
    if text in PASSED_OVER:
        return None
    if found := VALUE.fullmatch(text):
        return reading(text, found["number"], asked, UNITS[found["unit"]])
    if text in FAULT_WORDS:
        return Fault(FaultKind.DEVICE_FAULT, text, FAULT_WORDS[text])
    return not_understood(text)


def twin(spindle: Spindle) -> Twin:
    """Answers ``R`` in mm."""

    def answer(request: bytes) -> bytes:
        if request != b"R":
            return b"NOT FOUND\r"
        text = spindle.text(max(1, spindle.decimals))
        return f"{text[0]}{text[1:]:>7}, MM\r".encode()

    return Answering(answer)


STARRETT_IQ = Profile(
    name="starrett-iq",
    title="Starrett IQ",
    verified=Verified.VENDOR,
    source="Starrett IQ manual p. 17",
    line=LineSettings(baud=9600),
    request=lambda _: b"R\r",
    parse=parse,
    make_twin=twin,
    bad_replies={
        "bad-command": BadReply(b"NOT FOUND\r", FaultKind.DEVICE_FAULT),
        "no-access": BadReply(b"NO ACCESS\r", FaultKind.DEVICE_FAULT),
        "wrong-unit": BadReply(b"- 0.0050, IN\r", FaultKind.WRONG_UNIT),
    },
    hint="Parameter P013 must be 2 for mm; P063 = 1 turns faults into silence.",
)
