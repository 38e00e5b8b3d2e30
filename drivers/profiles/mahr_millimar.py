"""Mahr Millimar column amplifiers: OPTORSD of C1208, C1216 and 1240, and the C1202.

OPTORSD: ``?`` gives the number as displayed and the unit. C1202: ``M1?`` gives the feature's digit,
a signed number, the unit and up to two marks of tolerance. The unit is often µm.
"""

from __future__ import annotations

import re

from drivers.profile import BadReply, Evidence, FaultKind, Grammar, LineSettings, Profile, Spindle

OPTORSD = Grammar(
    value=r"(?P<number>[+\- ]?\d{1,6}\.\d{1,7}) ?(?P<unit>inch|in|mm|um|\xb5m) ?",
    passed_over=r"\?|MAHR GMBH,[\w ]+",
)
C1202 = Grammar(
    value=(
        r"(?P<channel>\d) (?P<number>[+-]\d{1,6}\.\d{1,7}) (?P<unit>inch|in|mm|um|\xb5m)"
        r"( ?[<=>]){0,2} ?"
    ),
    fault=(
        r"((?P<channel>\d) )?(ERR(?P<code>\d{1,2})"
        r"|(?<= )[+-](\d+\.\d+ (deg|rad)|\d+:\d\d:\d\d dms)( ?[<=>]){0,2} ?)"
    ),
    passed_over=r"M\d\?",
    words={"": "the feature reads an angle, {query.unit} is expected: choose a length"},
    other_words="error {code}; 6 means that this feature is not active",
    kinds={"": FaultKind.WRONG_UNIT},
)


def other_feature(request: str, _: Spindle) -> str:
    """Any feature but the twin's own is inactive."""
    match = re.fullmatch(r"M(\d)\?", request, re.ASCII)
    return f"{match[1]} ERR6\r" if match else ""


MAHR_OPTORSD = Profile(
    name="mahr-optorsd",
    title="Mahr Millimar C1208, C1216, 1240 (OPTORSD)",
    verified=Evidence.VENDOR,
    source="Millimar C1216 and 1240 manuals p. 67-70; speed and parity here are an assumption",
    line=LineSettings(9600, 7, "E", 2),
    request=lambda _: b"?\r",
    parse=OPTORSD.parse,
    reply=lambda spindle: f"{spindle.text().removeprefix('+')}mm\r\n",
    bad_replies={"wrong-unit": BadReply(b"12.345um\r\n", FaultKind.WRONG_UNIT)},
    hint="It is silent in a menu or while mastering; choose OPTORSD, speed and parity on the unit.",
)

MAHR_C1202 = Profile(
    name="mahr-c1202",
    title="Mahr Millimar C1202",
    verified=Evidence.VENDOR,
    source="Millimar C1202 manual p. 82",
    line=LineSettings(9600, 7, "E", 2),
    request=lambda query: f"M{query.channel}?\r".encode(),
    parse=C1202.parse,
    reply=lambda spindle: f"{spindle.channel} {spindle.text(4 + spindle.decimals)} mm\r",
    otherwise=other_feature,
    bad_replies={
        "inactive": BadReply(b"1 ERR6\r", FaultKind.DEVICE_FAULT),
        "wrong-channel": BadReply(b"2 +012.345 mm\r", FaultKind.WRONG_CHANNEL),
        "wrong-unit": BadReply(b"1 +012.34 um =\r", FaultKind.WRONG_UNIT),
        "angle": BadReply(b"1 +012:34:56 dms\r", FaultKind.WRONG_UNIT),
    },
    hint="It often shows µm: set the same unit here and on the amplifier.",
)
