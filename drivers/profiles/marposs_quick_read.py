"""Marposs Quick Read displays.

``M?`` is answered by sign and 7 characters with a floating point, without a unit; a tolerance flag
may follow. A single letter tells why there is no value, ``ERRn`` refuses a command.
"""

from __future__ import annotations

from drivers.profile import BadReply, Evidence, FaultKind, Grammar, LineSettings, Profile, Spindle

GRAMMAR = Grammar(
    value=r"(?P<number>[+-](?=[\d.]{7}[<>@X]?$)\d+\.\d+)[<>@X]?",
    fault=r"(?P<code>[ONI])|ERR(?P<refused>\d{1,2})",
    passed_over=r"M\?",
    words={
        "O": "outside the measuring range: move the head closer to its zero",
        "N": "the display is not zeroed: set zero on the master",
        "I": "the display cannot send now: leave its menu",
    },
    other_words="the display refuses the command (fault {refused})",
    kinds={"O": FaultKind.OVER_RANGE},
)


def reply(spindle: Spindle) -> str:
    """A number too long for the display is over range."""
    text = spindle.text(7)
    return f"{text}\r" if len(text) == 8 else "O\r"


MARPOSS_QUICK_READ = Profile(
    name="marposs-quick-read",
    title="Marposs Quick Read",
    verified=Evidence.VENDOR,
    source="Quick Read manual p. 195-202; line settings are chosen on the unit",
    line=LineSettings(baud=9600),
    request=lambda _: b"M?\r",
    parse=GRAMMAR.parse,
    reply=reply,
    otherwise=lambda _request, _spindle: "ERR3\r",
    bad_replies={
        "over-range": BadReply(b"O\r", FaultKind.OVER_RANGE),
        "not-zeroed": BadReply(b"N\r", FaultKind.DEVICE_FAULT),
        "cannot-send": BadReply(b"I\r", FaultKind.DEVICE_FAULT),
        "bad-command": BadReply(b"ERR3\r", FaultKind.DEVICE_FAULT),
    },
    hint="N means that the display was not zeroed on its master; speed is set on the unit.",
)
