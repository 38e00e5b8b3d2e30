"""What a value of each profile may look like, written down apart from the profiles.

Group 1 is the number. Every shape is taken from the reply layouts in the makers' papers and is
looser than the profile; a value from a text outside it is a defect.
"""

from __future__ import annotations

import re

N = r"([+\- ]? *\d*\.?\d+)"
LENGTH = r"(?:mm|in|inch|um|µm)"

SHAPES: dict[str, re.Pattern[str]] = {
    name: re.compile(shape, re.ASCII)
    for name, shape in {
        "ascii-line": rf"{N}(?: ?(?:{LENGTH}|\"))?",
        "cdi": rf"{N}, (?:IN|MM)",
        "dmx": rf"1 MW ?{N} {LENGTH} *",
        "heidenhain-nd28x": rf"[\x02\x06]*{N} {{1,2}}[ \"].{{1,4}}",
        "keyence-dl-rs1a": rf"M0,{N}(?:,[+-]\d+\.\d+)*",
        "magnescale-lt": rf"A(?:[NPIA][MI][UGLE]?)?[UGLE]?{N}[UGLE]?(?:[ ,;]?B.*)?",
        "mahr-c1202": rf"1 {N} {LENGTH}(?: ?[<=>])* ?(?:;.*)?",
        "mahr-marcator": rf"{N}[<=>]?",
        "mahr-optorsd": rf"{N} ?{LENGTH} ?",
        "marposs-quick-read": rf"{N}[<>@X]?",
        "metro-mux": rf"V1: [ a-zµ]{{4}} .{{3}} +{N}",
        "mitutoyo-01a": rf"01A{N}",
        "mitutoyo-counter": rf"GN01,{N}",
        "mitutoyo-it007r": rf"01A{N}",
        "mitutoyo-mux": rf"01A{N}",
        "mitutoyo-vl50": rf"GN01,{N}",
        "mux": rf"1 MW ?{N} {LENGTH} *",
        "starrett-iq": rf"{N}, (?:IN|MM)",
        "sylvac": rf"{N}[<=>]?",
        "sylvac-simplex": rf"{N}[<=>]?",
        "tesa": rf"{N}",
        "u-wave": rf"DT1\d\d01{N}[MI0]",
    }.items()
}
