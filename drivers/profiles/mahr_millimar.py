"""Mahr Millimar column amplifiers: OPTORSD of C1208, C1216 and 1240, and the C1202.

OPTORSD: ``?`` gives the number as displayed and the unit. C1202: ``M1?`` gives the feature's digit,
a signed number, the unit and up to two marks of tolerance. The unit is often µm.
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

INCHES = {"inch": Unit.INCH, "in": Unit.INCH}
UNITS = INCHES | {"mm": Unit.MM, "um": Unit.MICROMETRE, "\xb5m": Unit.MICROMETRE}
LENGTH = "|".join(UNITS)

OPTORSD = re.compile(rf"(?P<number>[+\- ]?\d{{1,6}}\.\d{{1,7}}) ?(?P<unit>{LENGTH}) ?", re.ASCII)
OPTORSD_PASSED_OVER = re.compile(r"\?|MAHR GMBH,[\w ]+", re.ASCII)

C1202 = re.compile(
    rf"(?P<channel>\d) ((?P<number>[+-]\d{{1,6}}\.\d{{1,7}}) (?P<unit>{LENGTH})"
    r"|[+-](\d+\.\d+ (deg|rad)|\d+:\d\d:\d\d dms))( ?[<=>]){0,2} ?",
    re.ASCII,
)
C1202_FAULT = re.compile(r"((?P<channel>\d) )?ERR(?P<code>\d{1,2})", re.ASCII)
C1202_ECHO = re.compile(r"M(?P<channel>\d)\?", re.ASCII)


def parse_optorsd(text: str, asked: Asked) -> Outcome | None:
    """A line without its end; None for echo and identification."""
    if found := OPTORSD.fullmatch(text):
        return reading(text, found["number"], asked, UNITS[found["unit"]])
    return None if OPTORSD_PASSED_OVER.fullmatch(text) else not_understood(text)


def parse_c1202(text: str, asked: Asked) -> Outcome | None:
    """The line of one feature without CR; None for an echo."""
    value = C1202.fullmatch(text)
    if not (found := value or C1202_FAULT.fullmatch(text)):
        return None if C1202_ECHO.fullmatch(text) else not_understood(text)
    if found["channel"] not in {None, str(asked.channel)}:
        return wrong_channel(text, found["channel"], asked)
    if not value:
        words = f"error {found['code']}; 6 means that this feature is not active"
        return Fault(FaultKind.DEVICE_FAULT, text, words)
    if value["unit"] is None:
        words = f"the feature reads an angle, {asked.unit} is expected: choose a length"
        return Fault(FaultKind.WRONG_UNIT, text, words)
    return reading(text, value["number"], asked, UNITS[value["unit"]])


def optorsd_twin(spindle: Spindle) -> Twin:
    """Answers ``?`` as the display shows it, without a plus sign."""

    def answer(request: bytes) -> bytes:
        text = spindle.text(max(1, spindle.decimals)).removeprefix("+")
        return f"{text}mm\r\n".encode() if request == b"?" else b""

    return Answering(answer)


def c1202_twin(spindle: Spindle) -> Twin:
    """Answers for its own feature; any other is inactive."""

    def answer(request: bytes) -> bytes:
        if not (found := C1202_ECHO.fullmatch(request.decode("latin-1"))):
            return b""
        if found["channel"] != str(spindle.channel):
            return f"{found['channel']} ERR6\r".encode()
        places = max(1, spindle.decimals)
        text = spindle.text(places)
        return f"{spindle.channel} {text[0]}{text[1:].zfill(4 + places)} mm\r".encode()

    return Answering(answer)


MAHR_OPTORSD = Profile(
    name="mahr-optorsd",
    title="Mahr Millimar C1208, C1216, 1240 (OPTORSD)",
    verified=Verified.VENDOR,
    source="Millimar C1216 and 1240 manuals p. 67-70; speed and parity here are an assumption",
    line=LineSettings(9600, 7, "E", 2),
    request=lambda _: b"?\r",
    parse=parse_optorsd,
    make_twin=optorsd_twin,
    bad_replies={"wrong-unit": BadReply(b"12.345um\r\n", FaultKind.WRONG_UNIT)},
    hint="It is silent in a menu or while mastering; choose OPTORSD, speed and parity on the unit.",
)

MAHR_C1202 = Profile(
    name="mahr-c1202",
    title="Mahr Millimar C1202",
    verified=Verified.VENDOR,
    source="Millimar C1202 manual p. 82",
    line=LineSettings(9600, 7, "E", 2),
    request=lambda asked: f"M{asked.channel}?\r".encode(),
    parse=parse_c1202,
    make_twin=c1202_twin,
    bad_replies={
        "inactive": BadReply(b"1 ERR6\r", FaultKind.DEVICE_FAULT),
        "wrong-channel": BadReply(b"2 +012.345 mm\r", FaultKind.WRONG_CHANNEL),
        "wrong-unit": BadReply(b"1 +012.34 um =\r", FaultKind.WRONG_UNIT),
        "angle": BadReply(b"1 +012:34:56 dms\r", FaultKind.WRONG_UNIT),
    },
    hint="It often shows µm: set the same unit here and on the amplifier.",
)
