"""Sylvac opto-RS and its clones (Bowers, Käfer, Trimos, Helios-Preisser), duplex and simplex.

Reply: sign (``+``, ``-`` or blank), number, an optional tolerance flag, CR; no unit. ``ERRn`` is a
fault, ``SY…`` an identification at power-up, and older units echo the request.
"""

from dataclasses import replace

from drivers.profile import BadReply, Evidence, FaultKind, Grammar, LineSettings, Profile

GRAMMAR = Grammar(
    value=r"(?P<number>[+\- ]\d+\.\d+)[<=>]?",
    fault=r"ERR(?P<code>\d)",
    passed_over=r"SY\d{3}(\.\w+)*|\?|PRI",
    words={
        "0": "the sensor was moved too fast: set zero again",
        "1": "the indicator does not know this command",
        "2": "parity error: check 7 data bits, even parity, 2 stop bits",
        "3": "outside the measuring range",
    },
    kinds={"3": FaultKind.OVER_RANGE},
)

SYLVAC = Profile(
    name="sylvac",
    title="Sylvac opto-RS duplex and clones",
    verified=Evidence.VENDOR,
    source="Bowers/Sylvac Opto manual p. 12-13, Power manual p. 15",
    line=LineSettings(4800, 7, "E", 2, dtr=True, rts=False),
    request=lambda _: b"?\r",
    parse=GRAMMAR.parse,
    reply=lambda spindle: f"{spindle.text(4 + spindle.decimals)}\r",
    otherwise=lambda _request, _spindle: "ERR1\r",
    bad_replies={
        "speed": BadReply(b"ERR0\r", FaultKind.DEVICE_FAULT),
        "bad-command": BadReply(b"ERR1\r", FaultKind.DEVICE_FAULT),
        "over-range": BadReply(b"ERR3\r", FaultKind.OVER_RANGE),
    },
    button=True,
    hint="The duplex cable takes its power from DTR; RTS must be low.",
)

SYLVAC_SIMPLEX = replace(
    SYLVAC,
    name="sylvac-simplex",
    title="Sylvac opto-RS simplex",
    line=LineSettings(4800, 7, "E", 2, dtr=True, rts=True, dtr_pulse_s=0.15),
    interval_s=0.5,
    hint="Asked by a pulse on DTR of at least 110 ms; after that the display freezes its value.",
)

# No command table of Mahr was found; that its gauges work on opto-RS duplex inputs is known.
MAHR_MARCATOR = replace(
    SYLVAC,
    name="mahr-marcator",
    title="Mahr MarCator 1075R, 1086, 1087 (opto RS-232)",
    verified=Evidence.UNVERIFIED,
    source="from memory, assumed to be like Sylvac opto-RS duplex; no vendor document found",
    button=False,
    hint="Unverified: compare some readings with the display, in mm, before you trust it.",
)
