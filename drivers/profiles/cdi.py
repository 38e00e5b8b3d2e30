"""CDI Logic and Plus indicators (Chicago Dial Indicator).

``R`` is answered by sign, number padded with blanks, comma, blank, ``IN`` or ``MM``, CR LF. The
vendor counts 8 characters of number and prints 9, so both are read.
"""

from drivers.profile import BadReply, Evidence, FaultKind, Grammar, LineSettings, Profile

GRAMMAR = Grammar(
    value=r"(?P<number>[+-](?=[ \d.]{8,9},) *(?:\d+\.\d+|\.\d+)), (?P<unit>IN|MM)", passed_over="R"
)

CDI = Profile(
    name="cdi",
    title="CDI Logic and Plus",
    verified=Evidence.VENDOR,
    source="technical support page of dialindicator.com",
    line=LineSettings(baud=9600),
    request=lambda _: b"R\r",
    parse=GRAMMAR.parse,
    reply=lambda spindle: f"{spindle.text(9, ' ')}, MM\r\n",
    bad_replies={"wrong-unit": BadReply(b"-   0.0050, IN\r\n", FaultKind.WRONG_UNIT)},
    hint="The reply names the unit of the display: switch it to mm; HOLD freezes the value.",
)
