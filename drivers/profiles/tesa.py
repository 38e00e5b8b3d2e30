"""TESA electronic units TT20, TT80 and TT90 on a bi-directional cable.

Reply: sign, six digits with a floating point, CR LF. Six decimals with nothing in front of the
point are inches; otherwise nothing tells the unit.
"""

from drivers.profile import BadReply, Evidence, FaultKind, Grammar, LineSettings, Profile

GRAMMAR = Grammar(
    value=r"(?P<number>[+-](?=[\d.]{7}$)(?:\d{1,5}\.\d{1,5}|(?P<inch>\.\d{6})))",
    fault=r"ERR(?P<code>\d{1,2})",
    passed_over=r"\?",
    other_words="error {code}: see the manual of the instrument",
)

TESA = Profile(
    name="tesa",
    title="TESA TT20, TT80, TT90",
    verified=Evidence.VENDOR,
    source="TT80 manual p. 94-95 and TT20 manual p. 54; DIGICO and TLC: nothing found",
    line=LineSettings(4800, 7, "E", 2),
    request=lambda _: b"?\r",
    parse=GRAMMAR.parse,
    reply=lambda spindle: f"{spindle.text(7)}\r\n",
    bad_replies={
        "error": BadReply(b"ERR23\r\n", FaultKind.DEVICE_FAULT),
        "wrong-unit": BadReply(b"-.001250\r\n", FaultKind.WRONG_UNIT),
    },
    hint="The reply does not distinguish mm, µm and mil: set the unit on the instrument itself.",
)
