"""Mitutoyo U-WAVE-R, a radio receiver that streams what its transmitters send.

Data: ``DT1``, group, channel, sign, digits with a point, unit letter (``0``: none), CR. Status:
``ST1``, group, channel (``FF``: the receiver), ten characters of identity, code, CR.
"""

from drivers.profile import BadReply, Evidence, FaultKind, Grammar, LineSettings, Profile

GRAMMAR = Grammar(
    value=r"DT1\d\d(?P<channel>\d\d)(?P<number>[+-]\d{1,8}\.\d{1,7})(?:(?P<unit>[MI])|0)",
    fault=r"ST1\d\d(?:(?P<channel>\d\d)|FF)[0-9A-Z]{10}(?P<code>\d\d)",
    words={
        "00": "the battery of the transmitter is low: replace it",
        "01": "the indicator does not answer its transmitter: switch it on",
        "02": "this transmitter is not registered with the receiver",
        "03": "data were lost on the radio link",
        "04": "the transmitter is out of reach or switched off",
        "05": "the indicator gave no data to its transmitter",
        "50": "the receiver did not accept a request",
        "51": "the receiver ended its search",
        "99": "the operator cancelled the value",
    },
    other_words="unknown status {code}",
    kinds={"00": FaultKind.LOW_BATTERY},
)

U_WAVE = Profile(
    name="u-wave",
    title="Mitutoyo U-WAVE-R radio receiver",
    verified=Evidence.CODE,
    source="frames, status codes and speed: two open-source readers that cite manual 99MAL216A",
    line=LineSettings(baud=57600),
    request=None,
    parse=GRAMMAR.parse,
    reply=lambda spindle: f"DT100{spindle.channel:02d}{spindle.text(9 + spindle.decimals)}M\r",
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
