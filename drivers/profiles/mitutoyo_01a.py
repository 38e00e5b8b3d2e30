"""Mitutoyo's ``01A`` frames: USB input tool in VCP mode, IT-007R, multiplexer format.

Reply: ``0``, channel, ``A``, sign, 8 or 9 characters with a floating point, CR. Status: ``9``,
channel, code, CR. The frame names no unit. Layout from a vendor's document; status codes and
retry times from open-source readers (docs/indicators.md).
"""

from __future__ import annotations

import re
from decimal import Decimal

from drivers.outcome import Fault, FaultKind, Outcome, Reading
from drivers.profile import LineSettings, Profile
from drivers.profiles.mitutoyo_01a_twin import MitutoyoTwin

CHANNEL = "1"

VALUE = re.compile(r"0(?P<channel>\d)A(?P<number>[+-](?=[\d.]{8,9}$)\d+\.\d+)", re.ASCII)
STATUS = re.compile(r"9(?P<channel>\d)(?P<code>\d)", re.ASCII)

STATUS_WORDS = {
    "1": "no data from the indicator: switched off, unplugged or battery empty",
    "2": "the indicator sent data in a wrong format",
    "8": "the interface is busy",
    "9": "system error of the interface",
}


def parse(reply: bytes) -> Outcome:
    """A whole reply without CR as a reading or a fault; never a number from a status."""
    text = reply.decode("latin-1")
    if found := VALUE.fullmatch(text):
        if found["channel"] != CHANNEL:
            return Fault(
                FaultKind.WRONG_CHANNEL,
                text,
                f"answer of channel {found['channel']} where channel {CHANNEL} was asked",
            )
        number = Decimal(found["number"])
        exponent = int(number.as_tuple().exponent)
        return Reading(text, float(number), 10.0**exponent, unit_assumed=True)
    if found := STATUS.fullmatch(text):
        words = STATUS_WORDS.get(found["code"], f"unknown status {found['code']}")
        kind = FaultKind.BUSY if found["code"] == "8" else FaultKind.DEVICE_FAULT
        return Fault(kind, text, words)
    return Fault(FaultKind.NOT_UNDERSTOOD, text, "not a frame of this profile")


MITUTOYO_01A = Profile(
    name="mitutoyo-01a",
    title="Mitutoyo 01A frames: USB input tool (VCP), IT-007R, multiplexer format",
    verified="frame: vendor document; request and status codes: open-source code",
    line=LineSettings(baud=9600),
    request=b"1\r",
    timeout_s=5.0,
    interval_s=0.2,
    parse=parse,
    make_twin=MitutoyoTwin,
    busy_retries=5,
)
