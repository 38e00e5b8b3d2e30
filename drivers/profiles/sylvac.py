"""Sylvac opto-RS and its clones (Bowers, Käfer, Trimos, Helios-Preisser), duplex and simplex.

Reply: sign (``+``, ``-`` or blank), number, an optional tolerance flag, CR; no unit. ``ERRn`` is a
fault, ``SY…`` an identification at power-up, and older units echo the request.
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
    Verified,
    not_understood,
    reading,
)
from drivers.twins import Answering

VALUE = re.compile(r"(?P<number>[+\- ]\d+\.\d+)[<=>]?", re.ASCII)
FAULT = re.compile(r"ERR(?P<code>\d)", re.ASCII)
PASSED_OVER = re.compile(r"SY\d{3}(\.\w+)*|\?|PRI", re.ASCII)

FAULT_WORDS = {
    "0": "the sensor was moved too fast: set zero again",
    "1": "the indicator does not know this command",
    "2": "parity error: check 7 data bits, even parity, 2 stop bits",
    "3": "outside the measuring range",
}


def parse(text: str, asked: Asked) -> Outcome | None:
    """A line without CR; None for echo and identification."""
    if PASSED_OVER.fullmatch(text):
        return None
    if found := VALUE.fullmatch(text):
        return reading(text, found["number"], asked)
    if found := FAULT.fullmatch(text):
        kind = FaultKind.OVER_RANGE if found["code"] == "3" else FaultKind.DEVICE_FAULT
        return Fault(kind, text, FAULT_WORDS.get(found["code"], f"fault {found['code']}"))
    return not_understood(text)


def twin(spindle: Spindle) -> Twin:
    """Answers ``?`` with the position."""

    def answer(request: bytes) -> bytes:
        if request != b"?":
            return b"ERR1\r"
        text = spindle.text()
        return f"{text[0]}{text[1:].zfill(4 + spindle.decimals)}\r".encode()

    return Answering(answer)


SYLVAC = Profile(
    name="sylvac",
    title="Sylvac opto-RS duplex and clones",
    verified=Verified.VENDOR,
    source="Bowers/Sylvac Opto manual p. 12-13, Power manual p. 15",
    line=LineSettings(4800, 7, "E", 2, dtr=True, rts=False),
    request=lambda _: b"?\r",
    parse=parse,
    make_twin=twin,
    bad_replies={
        "speed": BadReply(b"ERR0\r", FaultKind.DEVICE_FAULT),
        "bad-command": BadReply(b"ERR1\r", FaultKind.DEVICE_FAULT),
        "over-range": BadReply(b"ERR3\r", FaultKind.OVER_RANGE),
    },
    button=True,
    hint="The duplex cable takes its power from DTR; RTS must be low.",
)

SYLVAC_SIMPLEX = replace(
    SYLVAC,
    name="sylvac-simplex",
    title="Sylvac opto-RS simplex",
    line=LineSettings(4800, 7, "E", 2, dtr=True, rts=True, dtr_pulse_s=0.15),
    interval_s=0.5,
    hint="Asked by a pulse on DTR of at least 110 ms; after that the display holds its value.",
)
