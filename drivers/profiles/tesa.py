"""TESA electronic units TT20, TT80 and TT90 on a bi-directional cable.

Reply: sign, six digits with a floating point, CR LF. Six decimals with nothing in front of the
point are inches; otherwise nothing tells the unit.
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
)
from drivers.twins import Answering

VALUE = re.compile(r"[+-](?=[\d.]{7}$)\d{1,5}\.\d{1,5}", re.ASCII)
INCHES = re.compile(r"[+-]\.\d{6}", re.ASCII)
FAULT = re.compile(r"ERR(?P<code>\d{1,2})", re.ASCII)


def parse(text: str, asked: Asked) -> Outcome | None:
    """A line without its end; None for an echo."""
    if text == "?":
        return None
    if VALUE.fullmatch(text):
        return reading(text, text, asked)
    if INCHES.fullmatch(text):
        return reading(text, text, asked, Unit.INCH)
    if found := FAULT.fullmatch(text):
        words = f"error {found['code']}: see the manual of the instrument"
        return Fault(FaultKind.DEVICE_FAULT, text, words)
    return not_understood(text)


def twin(spindle: Spindle) -> Twin:
    """Answers ``?`` with six digits."""

    def answer(request: bytes) -> bytes:
        if request != b"?":
            return b""
        text = spindle.text(max(1, spindle.decimals))
        return f"{text[0]}{text[1:].zfill(7)}\r\n".encode()

    return Answering(answer)


TESA = Profile(
    name="tesa",
    title="TESA TT20, TT80, TT90",
    verified=Verified.VENDOR,
    source="TT80 manual p. 94-95 and TT20 manual p. 54; DIGICO and TLC: nothing found",
    line=LineSettings(4800, 7, "E", 2),
    request=lambda _: b"?\r",
    parse=parse,
    make_twin=twin,
    bad_replies={
        "error": BadReply(b"ERR23\r\n", FaultKind.DEVICE_FAULT),
        "wrong-unit": BadReply(b"-.001250\r\n", FaultKind.WRONG_UNIT),
    },
    hint="The reply does not tell mm, µm and mil apart: set the unit on the instrument itself.",
)
