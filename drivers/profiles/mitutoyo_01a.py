"""Mitutoyo's ``01A`` frames: USB input tool in VCP mode, IT-007R, multiplexer format.

Reply: ``0``, channel, ``A``, sign, 8 or 9 characters with a floating point, CR. Status: ``9``,
channel, code, CR. The frame names no unit. Layout from a vendor's document; status codes and
retry times from open-source readers (docs/indicators.md).
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

VALUE = re.compile(r"0(?P<channel>\d)A(?P<number>[+-](?=[\d.]{8,9}$)\d+\.\d+)", re.ASCII)
STATUS = re.compile(r"9(?P<channel>\d)(?P<code>\d)", re.ASCII)

STATUS_WORDS = {
    "1": "no data from the indicator: switched off, unplugged or battery empty",
    "2": "the indicator sent data in a wrong format",
    "8": "the interface is busy",
    "9": "system error of the interface",
}


def parse(text: str, asked: Asked) -> Outcome | None:
    """A whole reply without CR as a reading or a fault; never a number from a status."""
    found = VALUE.fullmatch(text) or STATUS.fullmatch(text)
    if not found:
        return not_understood(text)
    if found["channel"] != str(asked.channel):
        return wrong_channel(text, found["channel"], asked)
    if found.re is VALUE:
        return reading(text, found["number"], asked)
    code = found["code"]
    words = STATUS_WORDS.get(code, f"unknown status {code}")
    return Fault(FaultKind.BUSY if code == "8" else FaultKind.DEVICE_FAULT, text, words)


def twin(spindle: Spindle) -> Twin:
    """Answers the channel's digit with a frame of 13 bytes."""

    def frame(request: bytes) -> bytes:
        if request != str(spindle.channel).encode():
            return b""
        sign, number = spindle.text()[0], spindle.text(max(1, spindle.decimals))[1:]
        return f"0{spindle.channel}A{sign}{number.zfill(8)}\r".encode()

    return Answering(frame)


MITUTOYO_01A = Profile(
    name="mitutoyo-01a",
    title="Mitutoyo USB input tool in VCP mode",
    verified=Verified.CODE,
    source="frame: QM-Height manual 99MAF600B; request and status codes: open-source readers",
    line=LineSettings(baud=9600),
    request=lambda asked: f"{asked.channel}\r".encode(),
    parse=parse,
    make_twin=twin,
    timeout_s=5.0,
    bad_replies={
        "no-data": BadReply(b"911\r", FaultKind.DEVICE_FAULT),
        "format": BadReply(b"912\r", FaultKind.DEVICE_FAULT),
        "busy": BadReply(b"918\r", FaultKind.BUSY),
        "wrong-channel": BadReply(b"02A+0000.123\r", FaultKind.WRONG_CHANNEL),
        "footswitch": BadReply(b"0001,FOOTSWITCH, ,01\r\n", FaultKind.NOT_UNDERSTOOD),
    },
    busy_retries=5,
    button=True,
    hint="Without the VCP driver the tool is a keyboard and has no port (USB 0FE7:4001).",
)

MITUTOYO_IT007R = replace(
    MITUTOYO_01A,
    name="mitutoyo-it007r",
    title="Mitutoyo IT-007R, RS-232C input tool",
    source="frame: vendor document; request, speed and interval: open-source reader",
    line=LineSettings(baud=2400),
    request=lambda asked: f"{asked.channel}".encode(),
    make_twin=lambda spindle: Answering(
        lambda request: twin(spindle).receive(request + b"\r"), end=b""
    ),
    timeout_s=2.0,
    interval_s=1.0,
    hint="It lives on the control lines DTR and RTS; faster than once a second gives errors.",
)

MITUTOYO_MUX = replace(
    MITUTOYO_01A,
    name="mitutoyo-mux",
    title="Mitutoyo multiplexer MUX-10F",
    verified=Verified.UNVERIFIED,
    source="reply: vendor document; request and line settings: from memory only",
    request=lambda asked: f"{asked.channel}".encode(),
    make_twin=MITUTOYO_IT007R.make_twin,
    timeout_s=2.0,
    button=False,
    hint="Speed is set by DIP switches; the frame's second character is the channel.",
)
