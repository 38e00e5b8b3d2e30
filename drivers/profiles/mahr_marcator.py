"""Mahr MarCator indicators on an Opto-RS232 or USB cable, read as Sylvac's duplex protocol.

No command table of the maker was found; that the gauges work on opto-RS duplex inputs is known.
"""

from __future__ import annotations

from dataclasses import replace

from drivers.profile import Verified
from drivers.profiles.sylvac import SYLVAC

MAHR_MARCATOR = replace(
    SYLVAC,
    name="mahr-marcator",
    title="Mahr MarCator 1075R, 1086, 1087 (opto RS-232)",
    verified=Verified.UNVERIFIED,
    source="from memory, supposed to be alike Sylvac opto-RS duplex; no vendor document found",
    button=False,
    hint="Unverified: compare some readings with the display, in mm, before you trust it.",
)
