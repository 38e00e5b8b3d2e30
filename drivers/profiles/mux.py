"""IBR-type interfaces: MUX 2 and MUX 4, and DMX boxes.

Reply: channel, ``MW`` (measured) or ``TO`` (the gauge did not answer in time), signed number with
leading zeros, unit, CR LF; blanks before the sign and behind the unit come and go. Setting the list
of channels is answered by that list, four digits that are no value.
"""

from __future__ import annotations

import re
from dataclasses import replace

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
    r"(?P<channel>[1-8]) MW ?(?P<number>[+-](?=[\d.]{7,8} )\d+\.\d+) (?P<unit>mm|inch|in|um|µm) *",
    re.ASCII,
)
TIME_OUT = re.compile(r"(?P<channel>[1-8]) TO ?[+\- ]?[\d.]{1,9} [a-zµ]{0,6} *", re.ASCII)
PASSED_OVER = re.compile(r"[1-4]{1,4}|C[1-8]|MUX\d V\d+\.\d+", re.ASCII)

UNITS = {
    "mm": Unit.MM,
    "inch": Unit.INCH,
    "in": Unit.INCH,
    "um": Unit.MICROMETRE,
    "µm": Unit.MICROMETRE,
}


def parse(text: str, asked: Asked) -> Outcome | None:
    """A line without CR LF; None for echo, identification and the list of channels."""
    if PASSED_OVER.fullmatch(text):
        return None
    value = VALUE.fullmatch(text)
    found = value or TIME_OUT.fullmatch(text)
    if not found:
        return not_understood(text)
    if found["channel"] != str(asked.channel):
        return wrong_channel(text, found["channel"], asked)
    if value:
        return reading(text, value["number"], asked, UNITS[value["unit"]])
    words = f"the gauge on channel {asked.channel} did not answer: is it on and plugged in?"
    return Fault(FaultKind.DEVICE_FAULT, text, words)


def twin(spindle: Spindle) -> Twin:
    """Answers the channel's digit alone."""

    def answer(request: bytes) -> bytes:
        if request != str(spindle.channel).encode():
            return b""
        text = spindle.text(max(1, spindle.decimals))
        return f"{spindle.channel} MW{text[0]}{text[1:].zfill(8)} mm\r\n".encode()

    return Answering(answer, end=b"")


def dmx_twin(spindle: Spindle) -> Twin:
    """Answers ``C``, channel, CR LF, with a blank before the sign and the unit padded."""

    def answer(request: bytes) -> bytes:
        if request != f"C{spindle.channel}".encode():
            return b""
        text = spindle.text(max(1, spindle.decimals))
        return f"{spindle.channel} MW {text[0]}{text[1:].zfill(7)} mm    \r\n".encode()

    return Answering(answer, end=b"\n")


MUX = Profile(
    name="mux",
    title="MUX 2 and MUX 4 (IBR type)",
    verified=Verified.VENDOR,
    source="supplier's note on MUX 2 & 4 (adeptscience.co.uk, 68CE)",
    line=LineSettings(baud=9600),
    request=lambda asked: str(asked.channel).encode(),
    parse=parse,
    make_twin=twin,
    bad_replies={
        "time-out": BadReply(b"1 TO 999999.99 mm\r\n", FaultKind.DEVICE_FAULT),
        "wrong-unit": BadReply(b"1 MW+003.4665 inch\r\n", FaultKind.WRONG_UNIT),
        "wrong-channel": BadReply(b"2 MW-00088.29 mm\r\n", FaultKind.WRONG_CHANNEL),
    },
    hint="It lives on the control lines of the port; TO 999999.99 means that its gauge is silent.",
)

DMX = replace(
    MUX,
    name="dmx",
    title="DMX-2 and DMX-8 boxes",
    verified=Verified.CODE,
    source="open-source DMX-8 reader with a captured reply",
    request=lambda asked: f"C{asked.channel}\r\n".encode(),
    make_twin=dmx_twin,
    hint="Send GR once if it streams; TO 999999.99 means that its gauge is silent.",
)
