"""IBR-type interfaces: MUX 2 and MUX 4, and DMX boxes.

Reply: channel, ``MW`` (measured) or ``TO`` (the gauge did not answer in time), signed number with
leading zeros, unit, CR LF; blanks before the sign and behind the unit come and go. Setting the list
of channels is answered by that list, four digits that are no value.
"""

from dataclasses import replace

from drivers.profile import BadReply, Evidence, FaultKind, Grammar, LineSettings, Profile

GRAMMAR = Grammar(
    value=(
        r"(?P<channel>[1-8]) MW ?(?P<number>[+-](?=[\d.]{7,8} )\d+\.\d+) "
        r"(?P<unit>mm|inch|in|um|µm) *"
    ),
    fault=r"(?P<channel>[1-8]) TO ?[+\- ]?[\d.]{1,9} [a-zµ]{0,6} *",
    passed_over=r"[1-4]{1,4}|C[1-8]|MUX\d V\d+\.\d+",
    other_words="the gauge on channel {channel} did not answer: is it on and plugged in?",
)

MUX = Profile(
    name="mux",
    title="MUX 2 and MUX 4 (IBR type)",
    verified=Evidence.VENDOR,
    source="supplier's note on MUX 2 & 4 (adeptscience.co.uk, 68CE)",
    line=LineSettings(baud=9600),
    request=lambda query: str(query.channel).encode(),
    parse=GRAMMAR.parse,
    reply=lambda spindle: f"{spindle.channel} MW{spindle.text(8)} mm\r\n",
    bad_replies={
        "time-out": BadReply(b"1 TO 999999.99 mm\r\n", FaultKind.DEVICE_FAULT),
        "wrong-unit": BadReply(b"1 MW+003.4665 inch\r\n", FaultKind.WRONG_UNIT),
        "wrong-channel": BadReply(b"2 MW-00088.29 mm\r\n", FaultKind.WRONG_CHANNEL),
    },
    hint="The control lines of the port power it; TO 999999.99 means that its gauge is silent.",
)

DMX = replace(
    MUX,
    name="dmx",
    title="DMX-2 and DMX-8 boxes",
    verified=Evidence.CODE,
    source="open-source DMX-8 reader with a captured reply",
    request=lambda query: f"C{query.channel}\r\n".encode(),
    reply=lambda spindle: f"{spindle.channel} MW {spindle.text(7)} mm    \r\n",
    hint="Send GR once if it streams; TO 999999.99 means that its gauge is silent.",
)
