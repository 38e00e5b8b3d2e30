"""Metro MUX4 and MUX8 interfaces.

Reply: ``V``, channel, colon, unit (4 columns), tolerance (3 columns), sign, 5 digits, point,
6 digits, CR LF; unit and tolerance may be blank. The manual's example has one blank more before the
sign than its layout, so both are read. ``Nxy:En`` is a fault.
"""

from drivers.profile import BadReply, Evidence, FaultKind, Grammar, LineSettings, Profile

GRAMMAR = Grammar(
    value=(
        r"V(?P<channel>[1-8]): (?P<unit>[ a-zµ]{4}) [ <=>A-Za-z]{3} {1,2}"
        r"(?P<number>[+\- ]\d{5}\.\d{6})"
    ),
    fault=r"N\d{1,2}:E(?P<code>\d)",
    passed_over="[1-8]",
    words={
        "1": "the interface cannot talk to its gauge: switched off, unplugged or wrong type",
        "3": "the gauge sent no valid reading",
    },
    other_words="fault {code} of the interface",
)

METRO_MUX = Profile(
    name="metro-mux",
    title="Metro MUX4 and MUX8",
    verified=Evidence.VENDOR,
    source="Metro MUX2/4/8 manuals",
    line=LineSettings(baud=9600),
    request=lambda query: str(query.channel).encode(),
    parse=GRAMMAR.parse,
    reply=lambda spindle: f"V{spindle.channel}: mm        {spindle.text(12, decimals=6)}\r\n",
    bad_replies={
        "communication": BadReply(b"N01:E1\r\n", FaultKind.DEVICE_FAULT),
        "reading": BadReply(b"N01:E3\r\n", FaultKind.DEVICE_FAULT),
        "wrong-channel": BadReply(b"V2: mm        -00001.250000\r\n", FaultKind.WRONG_CHANNEL),
        "wrong-unit": BadReply(b"V1: in        +00000.049213\r\n", FaultKind.WRONG_UNIT),
    },
    hint="It pads to six decimals whatever the gauge resolves; a blank unit is taken as mm.",
)
