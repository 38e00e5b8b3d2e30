"""Mitutoyo instruments with the GA/GN commands: ID-H, counters EH and EV, Litematic VL-50.

Request: ``GA``, two digits of the identity, CR LF. Reply: ``GN``, identity, comma, sign, number
with a floating point; no unit. The second letter follows the display: X, M and W are the maximum,
the minimum and their difference, which are no positions.
"""

from __future__ import annotations

from dataclasses import replace

from drivers.profile import (
    BadReply,
    Evidence,
    Fault,
    FaultKind,
    Grammar,
    IndicatorReading,
    LineSettings,
    Outcome,
    Profile,
    Query,
    Spindle,
)

GRAMMAR = Grammar(
    value=r"G[NXMW](?P<channel>\d\d),(?P<number>[+-]\d{1,7}\.\d{1,7})",
    fault=r"ER(?P<channel>\d\d)(,(?P<code>\d{1,2}))?",
    passed_over=r"(CH|GA)\d\d|CS",
    words={"": "error without a code: see the display of the instrument"},
    other_words="error {code}: see the display of the instrument",
)
MODES = {"X": "the maximum", "M": "the minimum", "W": "the difference of maximum and minimum"}


def parse(text: str, query: Query) -> Outcome | None:
    """A line without its end; None for an echo and for ``CH``, which acknowledges a command."""
    outcome = GRAMMAR.parse(text, query)
    if isinstance(outcome, IndicatorReading) and text[1] in MODES:
        message = f"the display shows {MODES[text[1]]}: switch it to the current value"
        return Fault(FaultKind.DEVICE_FAULT, text, message)
    return outcome


def reply(spindle: Spindle) -> str:
    """The position under the twin's own number."""
    return f"GN{spindle.channel:02d},{spindle.text(9)}\r\n"


def otherwise(request: str, spindle: Spindle) -> str:
    """00 calls every unit on the chain; ``CS`` is acknowledged."""
    replies = {"GA00": reply(spindle), "CS": f"CH{spindle.channel:02d}\r\n"}
    return replies.get(request, "")


MITUTOYO_COUNTER = Profile(
    name="mitutoyo-counter",
    title="Mitutoyo ID-H, counters EH, EV (GA/GN)",
    verified=Evidence.CODE,
    source=(
        "commands and replies: ID-H manual 99MAH016B p. 4-5; several channels and line settings: "
        "open-source readers; form of the error reply: from memory"
    ),
    line=LineSettings(baud=9600),
    request=lambda query: f"GA{query.channel:02d}\r\n".encode(),
    parse=parse,
    reply=reply,
    otherwise=otherwise,
    bad_replies={
        "maximum": BadReply(b"GX01,+0016.2345\r\n", FaultKind.DEVICE_FAULT),
        "minimum": BadReply(b"GM01,-0016.2345\r\n", FaultKind.DEVICE_FAULT),
        "difference": BadReply(b"GW01,+0016.2345\r\n", FaultKind.DEVICE_FAULT),
        "wrong-channel": BadReply(b"GN02,+0016.2345\r\n", FaultKind.WRONG_CHANNEL),
        "preset": BadReply(b"DH01,+0016.2345\r\n", FaultKind.NOT_UNDERSTOOD),
    },
    hint=(
        "The display must show the current value, not MAX, MIN or TIR; speed and parity are set on "
        "the unit (7E2 is as usual as 8N1)."
    ),
)

MITUTOYO_VL50 = replace(
    MITUTOYO_COUNTER,
    name="mitutoyo-vl50",
    title="Mitutoyo Litematic VL-50",
    source="request, line settings and pace: an open-source reader; replies: ID-H manual 99MAH016B",
    line=LineSettings(9600, 7, "E", 2),
    interval_s=0.3,
    hint="It needs 7E2 with RTS and DTR on; an error shown by the unit must be cleared first.",
)
