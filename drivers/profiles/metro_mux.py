"""Metro MUX4 and MUX8 interfaces.

Reply: ``V``, channel, colon, unit (4 columns), tolerance (3 columns), sign, 5 digits, point,
6 digits, CR LF; unit and tolerance may be blank. The manual's example has one blank more before the
sign than its layout, so both are read. ``Nxy:En`` is a fault.
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
    Unit,
    Verified,
    not_understood,
    reading,
    wrong_channel,
)
from drivers.twins import Answering

VALUE = re.compile(
    r"V(?P<channel>[1-8]): (?P<unit>[ a-zµ]{4}) [ <=>A-Za-z]{3} {1,2}"
    r"(?P<number>[+\- ]\d{5}\.\d{6})",
    re.ASCII,
)
FAULT = re.compile(r"N\d{1,2}:E(?P<code>\d)", re.ASCII)

UNITS = {
    "": None,
    "mm": Unit.MM,
    "in": Unit.INCH,
    "inch": Unit.INCH,
    "um": Unit.MICROMETRE,
    "µm": Unit.MICROMETRE,
}
FAULT_WORDS = {
    "1": "the interface cannot talk to its gauge: switched off, unplugged or wrong type",
    "3": "the gauge sent no valid reading",
}


def parse(text: str, asked: Asked) -> Outcome | None:
    """A line without CR LF; None for the echo."""
    if text == str(asked.channel):
        return None
    if found := FAULT.fullmatch(text):
        words = FAULT_WORDS.get(found["code"], f"fault {found['code']} of the interface")
        return Fault(FaultKind.DEVICE_FAULT, text, words)
    found = VALUE.fullmatch(text)
    if not found or found["unit"].strip() not in UNITS:
        return not_understood(text)
    if found["channel"] != str(asked.channel):
        return wrong_channel(text, found["channel"], asked)
    return reading(text, found["number"], asked, UNITS[found["unit"].strip()])


def twin(spindle: Spindle) -> Twin:
    """Answers the channel's digit alone, spaced as in the manual's example."""

    def answer(request: bytes) -> bytes:
        if request != str(spindle.channel).encode():
            return b""
        text = spindle.text(6)
        return f"V{spindle.channel}: mm        {text[0]}{text[1:].zfill(12)}\r\n".encode()

    return Answering(answer, end=b"")


METRO_MUX = Profile(
    name="metro-mux",
    title="Metro MUX4 and MUX8",
    verified=Verified.VENDOR,
    source="Metro MUX2/4/8 manuals",
    line=LineSettings(baud=9600),
    request=lambda asked: str(asked.channel).encode(),
    parse=parse,
    make_twin=twin,
    bad_replies={
        "communication": BadReply(b"N01:E1\r\n", FaultKind.DEVICE_FAULT),
        "reading": BadReply(b"N01:E3\r\n", FaultKind.DEVICE_FAULT),
        "wrong-channel": BadReply(b"V2: mm        -00001.250000\r\n", FaultKind.WRONG_CHANNEL),
        "wrong-unit": BadReply(b"V1: in        +00000.049213\r\n", FaultKind.WRONG_UNIT),
    },
    hint="It pads to six decimals whatever the gauge resolves; a blank unit is taken as mm.",
)
