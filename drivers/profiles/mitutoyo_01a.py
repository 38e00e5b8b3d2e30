"""Mitutoyo's ``01A`` frames: USB input tool in VCP mode, IT-007R, multiplexer format.

Reply: ``0``, channel, ``A``, sign, 8 or 9 characters with a floating point, CR. Status: ``9``,
channel, code, CR. The frame names no unit. Layout from a vendor's document; status codes and
retry times from open-source readers (docs/indicators.md).
"""

from dataclasses import replace

from drivers.profile import BadReply, Evidence, FaultKind, Grammar, LineSettings, Profile

GRAMMAR = Grammar(
    value=r"0(?P<channel>\d)A(?P<number>[+-](?=[\d.]{8,9}$)\d+\.\d+)",
    fault=r"9(?P<channel>\d)(?P<code>\d)",
    words={
        "1": "no data from the indicator: switched off, unplugged or battery empty",
        "2": "the indicator sent data in a wrong format",
        "8": "the interface is busy",
        "9": "system error of the interface",
    },
    other_words="unknown status {code}",
    kinds={"8": FaultKind.BUSY},
)

MITUTOYO_01A = Profile(
    name="mitutoyo-01a",
    title="Mitutoyo USB input tool in VCP mode",
    verified=Evidence.CODE,
    source="frame: QM-Height manual 99MAF600B; request and status codes: open-source readers",
    line=LineSettings(baud=9600),
    request=lambda query: f"{query.channel}\r".encode(),
    parse=GRAMMAR.parse,
    reply=lambda spindle: f"0{spindle.channel}A{spindle.text(8)}\r",
    # 5 s, and 918 asked again up to five times: as the reader that cites the maker's manual does
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
    request=lambda query: f"{query.channel}".encode(),
    timeout_s=2.0,
    interval_s=1.0,
    hint="The control lines DTR and RTS power it; faster than once a second gives errors.",
)

MITUTOYO_MUX = replace(
    MITUTOYO_01A,
    name="mitutoyo-mux",
    title="Mitutoyo multiplexer MUX-10F",
    verified=Evidence.UNVERIFIED,
    source="reply: vendor document; request and line settings: from memory only",
    request=lambda query: f"{query.channel}".encode(),
    timeout_s=2.0,
    button=False,
    hint="Speed is set by DIP switches; the frame's second character is the channel.",
)
