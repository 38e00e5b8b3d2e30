"""Starrett IQ indicators, over USB or RS-232.

``R`` is answered by sign, number padded with blanks to 7 characters, comma, blank, ``IN`` or
``MM``, CR. Faults are words in capitals; a parameter of the indicator can silence them.
"""

from drivers.profile import BadReply, Evidence, FaultKind, Grammar, LineSettings, Profile

GRAMMAR = Grammar(
    value=r"(?P<number>[+-](?=[ \d.]{7,8},) *(?:\d+\.\d+|\.\d+)), (?P<unit>IN|MM)",
    fault="(?P<code>NOT FOUND|NO ACCESS|OUT OF BOUNDS|NON NUMERIC)",
    passed_over="R|SUCCESS",
    words={
        "NOT FOUND": "the indicator does not know this command",
        "NO ACCESS": "the indicator does not allow this command now",
        "OUT OF BOUNDS": "a parameter of the indicator is set outside its limits",
        "NON NUMERIC": "the indicator expected a number in the command",
    },
)

STARRETT_IQ = Profile(
    name="starrett-iq",
    title="Starrett IQ",
    verified=Evidence.VENDOR,
    source="Starrett IQ manual p. 17",
    line=LineSettings(baud=9600),
    request=lambda _: b"R\r",
    parse=GRAMMAR.parse,
    reply=lambda spindle: f"{spindle.text(7, ' ')}, MM\r",
    otherwise=lambda _request, _spindle: "NOT FOUND\r",
    bad_replies={
        "bad-command": BadReply(b"NOT FOUND\r", FaultKind.DEVICE_FAULT),
        "no-access": BadReply(b"NO ACCESS\r", FaultKind.DEVICE_FAULT),
        "wrong-unit": BadReply(b"- 0.0050, IN\r", FaultKind.WRONG_UNIT),
    },
    hint="Parameter P013 must be 2 for mm; P063 = 1 turns faults into silence.",
)
