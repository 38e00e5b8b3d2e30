"""Heidenhain display units ND 280 and ND 281, asked by the single byte STX.

Reply: sign, ten columns of a number whose leading zeros are blanks, then a blank and the columns
unit (blank mm, ``"`` inch, ``?`` fault), sorting and series, CR LF. The vendor's example has one
blank more than his table, so both widths pass.
"""

from drivers.profile import BadReply, Evidence, FaultKind, Grammar, LineSettings, Profile

NUMBER = r"[+-](?=[ \d.]{9}\d ) *(?:\d+\.\d+|\.\d+)"
# STX and ACK, of requests and of keys, may stand before anything
GRAMMAR = Grammar(
    value=(
        rf"[\x02\x06]*(?P<number>{NUMBER})(?= .{{3,4}}$) {{1,2}}"
        r"(?:(?P<inch>\")|(?P<mm> )) ?[<=> ][SAGD ]"
    ),
    fault=(
        r"[\x02\x06]*(?:\x15|\?|[A-Z]+\.ERR\."
        rf"|{NUMBER}(?= .{{3,4}}$)(?=.*(?P<code>\?)) {{1,2}}[ \"?] ?[<=>? ][SAGD ])"
    ),
    passed_over=r"[\x02\x06]+",
    words={
        "?": "the display unit marks this value as faulty: check the encoder and clear the error"
    },
    other_words="the display unit refuses the request or reports an error: see its display",
)

HEIDENHAIN_ND28X = Profile(
    name="heidenhain-nd28x",
    title="Heidenhain ND 280, ND 281",
    verified=Evidence.VENDOR,
    source="ND 280/281B/221B manual p. 39 and 47",
    line=LineSettings(9600, 7, "E", 2),
    request=lambda _: b"\x02",
    parse=GRAMMAR.parse,
    reply=lambda spindle: f"{spindle.text(10, ' ')}    \r\n",
    bad_replies={
        "fault": BadReply(b"+   12.3456 ?  \r\n", FaultKind.DEVICE_FAULT),
        "refused": BadReply(b"\x15\r\n", FaultKind.DEVICE_FAULT),
        "format-error": BadReply(b"\x02FORMAT.ERR.\r\n", FaultKind.DEVICE_FAULT),
        "wrong-unit": BadReply(b'+   0.50000 "  \r\n', FaultKind.WRONG_UNIT),
    },
    hint="Speed, parity and the blank lines after a value are set in the unit's menu.",
)
