"""Mitutoyo U-WAVE-R, a radio receiver that streams what its transmitters send.

Data: ``DT1``, group, channel, sign, digits with a point, unit letter (``0``: none), CR. Status:
``ST1``, group, channel (``FF``: the receiver), ten characters of identity, code, CR.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from drivers.profile import (
    Asked,
    BadReply,
    Fault,
    FaultKind,
    LineSettings,
    Outcome,
    Profile,
    Spindle,
    Unit,
    Verified,
    not_understood,
    reading,
    wrong_channel,
)

VALUE = re.compile(
    r"DT1\d\d(?P<channel>\d\d)(?P<number>[+-]\d{1,8}\.\d{1,7})(?P<unit>[MI0])", re.ASCII
)
STATUS = re.compile(r"ST1\d\d(?P<channel>\d\d|FF)[0-9A-Z]{10}(?P<code>\d\d)", re.ASCII)

UNITS = {"M": Unit.MM, "I": Unit.INCH, "0": None}

STATUS_WORDS = {
    "00": "the battery of the transmitter is low: replace it",
    "01": "the indicator does not answer its transmitter: switch it on",
    "02": "this transmitter is not registered with the receiver",
    "03": "data were lost on the radio link",
    "04": "the transmitter is out of reach or switched off",
    "05": "the indicator gave no data to its transmitter",
    "50": "the receiver did not accept a request",
    "51": "the receiver ended its search",
    "99": "the operator cancelled the value",
}


def parse(text: str, asked: Asked) -> Outcome | None:
    """A frame without CR as a reading or a fault."""
    value = VALUE.fullmatch(text)
    status = STATUS.fullmatch(text)
    found = value or status
    if not found:
        return not_understood(text)
    channel = found["channel"]
    if channel != "FF" and int(channel) != asked.channel:
        return wrong_channel(text, channel, asked)
    if value:
        return reading(text, value["number"], asked, UNITS[value["unit"]])
    code = found["code"]
    kind = FaultKind.LOW_BATTERY if code == "00" else FaultKind.DEVICE_FAULT
    return Fault(kind, text, STATUS_WORDS.get(code, f"unknown status {code}"))


@dataclass(frozen=True)
class UWaveTwin:
    """Sends a frame of its own accord and answers nothing."""

    spindle: Spindle

    def receive(self, request: bytes) -> bytes:
        """The next frame when nothing was sent to it."""
        if request:
            return b""
        places = max(1, self.spindle.decimals)
        text = self.spindle.text(places)
        number = f"{text[0]}{text[1:].zfill(9 + places)}"
        return f"DT100{self.spindle.channel:02d}{number}M\r".encode()


U_WAVE = Profile(
    name="u-wave",
    title="Mitutoyo U-WAVE-R radio receiver",
    verified=Verified.CODE,
    source="frames, status codes and speed: two open-source readers that cite manual 99MAL216A",
    line=LineSettings(baud=57600),
    request=None,
    parse=parse,
    make_twin=UWaveTwin,
    stream_s=0.2,
    bad_replies={
        "battery-low": BadReply(b"ST10001FFFFFFFFFF00\r", FaultKind.LOW_BATTERY),
        "no-data": BadReply(b"ST10001FFFFFFFFFF05\r", FaultKind.DEVICE_FAULT),
        "request-error": BadReply(b"ST100FFFFFFFFFFFF50\r", FaultKind.DEVICE_FAULT),
        "wrong-channel": BadReply(b"DT10005+00000020.06M\r", FaultKind.WRONG_CHANNEL),
        "wrong-unit": BadReply(b"DT10001+0000.12345I\r", FaultKind.WRONG_UNIT),
    },
    hint=(
        "It cannot be asked: set the transmitter to send on change, or press its button, and give "
        "the transmitter's channel."
    ),
)
