"""Keyence DL-RS1A, the RS-232C unit beside GT2 amplifiers.

``M0`` is answered by ``M0`` and one field for each amplifier, sign, 3 digits, point, 4 digits;
``ER``, command and code is a fault. No unit. The channel asked for picks the field.
"""

from __future__ import annotations

import re

from drivers.profile import (
    NO_LINE,
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
    reading,
)

VALUES = re.compile(r"M0(?P<fields>(?:,[+-]\d{3}\.\d{4})+)", re.ASCII)
BEYOND = "999.9999"
NO_VALUES = Grammar(
    value=NO_LINE,
    fault=r"ER,(?:M0|MS|SR|SW),(?P<code>\d\d)",
    passed_over="M0",
    words={
        "00": "the unit does not know this command",
        "02": "an amplifier did not answer in time",
        "20": "the command has a wrong length",
        "21": "the command has a wrong number of parameters",
        "22": "a parameter is out of its range",
        "29": "no communication with an amplifier: check their connection",
        "65": "there is no amplifier of this number",
    },
    other_words="fault {code} of the unit",
)


def parse(text: str, query: Query) -> Outcome | None:
    """A line without CR LF; None for the echo."""
    match = VALUES.fullmatch(text)
    if not match:
        return NO_VALUES.parse(text, query)
    fields = match["fields"].split(",")[1:]
    if not 1 <= query.channel <= len(fields):
        message = f"{len(fields)} amplifiers answered, number {query.channel} was asked"
        return Fault(FaultKind.WRONG_CHANNEL, text, message)
    field = fields[query.channel - 1]
    if field[1:] == BEYOND:
        return Fault(FaultKind.OVER_RANGE, text, "outside the range of the head: move it closer")
    return reading(text, field, query)


def reply(spindle: Spindle) -> str:
    """The reply of as many amplifiers as the channel says; the last one is the spindle's."""
    text = spindle.text(8, decimals=4)
    field = text if len(text) == 9 else text[0] + BEYOND
    return f"M0{',+000.0000' * (spindle.channel - 1)},{field}\r\n"


KEYENCE_DL_RS1A = Profile(
    name="keyence-dl-rs1a",
    title="Keyence DL-RS1A with GT2 amplifiers",
    verified=Evidence.VENDOR,
    source="DL-RS1A manual; its line settings are chosen on the unit, ±999.9999 is from memory",
    line=LineSettings(baud=9600),
    request=lambda _: b"M0\r\n",
    parse=parse,
    reply=reply,
    otherwise=lambda request, _: f"ER,{request[:2]},00\r\n",
    bad_replies={
        "over-range": BadReply(b"M0,-999.9999\r\n", FaultKind.OVER_RANGE),
        "time-out": BadReply(b"ER,M0,02\r\n", FaultKind.DEVICE_FAULT),
        "communication": BadReply(b"ER,M0,29\r\n", FaultKind.DEVICE_FAULT),
    },
    hint="Speed and parity are set on the unit; the channel is the amplifier's place in the reply.",
)
