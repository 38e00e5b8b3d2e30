"""Mitutoyo instruments with the GA/GN commands: ID-H, counters EH and EV, Litematic VL-50.

Request: ``GA``, two digits of the identity, CR LF. Reply: ``GN``, identity, comma, sign, number
with a floating point; no unit. The second letter follows the display: X, M and W are the maximum,
the minimum and their difference, which are no positions.
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
    wrong_channel,
)
from drivers.twins import Answering

VALUE = re.compile(r"G(?P<mode>[NXMW])(?P<channel>\d\d),(?P<number>[+-]\d{1,7}\.\d{1,7})", re.ASCII)
FAULT = re.compile(r"ER(?P<channel>\d\d)(,(?P<code>\d{1,2}))?", re.ASCII)
PASSED_OVER = re.compile(r"(CH|GA)\d\d|CS", re.ASCII)

MODES = {"X": "the maximum", "M": "the minimum", "W": "the difference of maximum and minimum"}


def parse(text: str, asked: Asked) -> Outcome | None:
    """A line without its end; None for an echo and for ``CH``, which acknowledges a command."""
    if PASSED_OVER.fullmatch(text):
        return None
    value = VALUE.fullmatch(text)
    fault = FAULT.fullmatch(text)
    found = value or fault
    if not found:
        return not_understood(text)
    if int(found["channel"]) != asked.channel:
        return wrong_channel(text, found["channel"], asked)
    if not value:
        words = f"error {found['code'] or 'without a code'}: see the display of the instrument"
        return Fault(FaultKind.DEVICE_FAULT, text, words)
    if value["mode"] in MODES:
        words = f"the display holds {MODES[value['mode']]}: switch it to the current value"
        return Fault(FaultKind.DEVICE_FAULT, text, words)
    return reading(text, value["number"], asked)


def twin(spindle: Spindle) -> Twin:
    """Answers ``GA`` for its own number and for 00, which calls every unit on the chain."""
    own = f"{spindle.channel:02d}"

    def answer(request: bytes) -> bytes:
        if request == b"CS":
            return f"CH{own}\r\n".encode()
        if request not in {f"GA{own}".encode(), b"GA00"}:
            return b""
        text = spindle.text(max(1, spindle.decimals))
        return f"GN{own},{text[0]}{text[1:].zfill(9)}\r\n".encode()

    return Answering(answer)


MITUTOYO_COUNTER = Profile(
    name="mitutoyo-counter",
    title="Mitutoyo ID-H and counters EH, EV (GA/GN)",
    verified=Verified.CODE,
    source=(
        "commands and replies: ID-H manual 99MAH016B p. 4-5; several channels and line settings: "
        "open-source readers; form of the error reply: from memory"
    ),
    line=LineSettings(baud=9600),
    request=lambda asked: f"GA{asked.channel:02d}\r\n".encode(),
    parse=parse,
    make_twin=twin,
    bad_replies={
        "maximum": BadReply(b"GX01,+0016.2345\r\n", FaultKind.DEVICE_FAULT),
        "minimum": BadReply(b"GM01,-0016.2345\r\n", FaultKind.DEVICE_FAULT),
        "difference": BadReply(b"GW01,+0016.2345\r\n", FaultKind.DEVICE_FAULT),
        "wrong-channel": BadReply(b"GN02,+0016.2345\r\n", FaultKind.WRONG_CHANNEL),
        "preset": BadReply(b"DH01,+0016.2345\r\n", FaultKind.NOT_UNDERSTOOD),
    },
    hint=(
        "The display must show the current value, not MAX, MIN or TIR; speed and parity are set on "
        "the unit (7E2 is as usual as 8N1)."
    ),
)

MITUTOYO_VL50 = replace(
    MITUTOYO_COUNTER,
    name="mitutoyo-vl50",
    title="Mitutoyo Litematic VL-50",
    source="request, line settings and pace: an open-source reader; replies: ID-H manual 99MAH016B",
    line=LineSettings(9600, 7, "E", 2),
    interval_s=0.3,
    hint="It needs 7E2 with RTS and DTR on; an error shown by the unit must be cleared first.",
)
