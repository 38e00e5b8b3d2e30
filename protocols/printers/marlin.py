"""Marlin: what M503 shows, and what ``G30 X Y`` answers.

A carriage is taken to be at H once it stands M666 from its switch, which trips at H - M666. The
answer names the place of the probe; the tool stands at the height answered less the Z of M851,
which is below 0 where the probe trips before the tool touches.
"""

from __future__ import annotations

import re

from calib.errors import RecordError
from protocols.printers.gcode import NUMBER, Texts, commands, lines
from protocols.printers.tower_printer import USUAL_ANGLES_DEG, Contact, Held, TowerPrinter

NAME = "marlin"
ANSWER = re.compile(rf"Bed X: ({NUMBER}) Y: ({NUMBER}) Z: ({NUMBER})")
OF_G33 = re.compile(r"^\.?(?:Height:|c:[+-]| +x:[+-]| +yz:[+-])|G33 Auto Calibrate|std dev:")
TOWERS, TRIMS = "XYZ", "ABC"


def is_mine(text: str) -> bool:
    """Whether a text has a line that only this firmware has."""
    return re.search(r"Bed X: |M665 (?=.*L)(?=.*\bS\d)", text) is not None


def held(texts: Texts) -> Held:
    """Geometry and contacts of these files together. Raises RecordError."""
    for line in commands(texts, "G20"):
        raise RecordError(
            f"file of a printer {line.where}",
            f"{line.text!r}: lengths in inches",
            "lengths in mm",
            "Send G21, then M503 and the places again.",
        )
    odd: list[str] = []
    printer = _printer(texts, odd)
    offset = dict.fromkeys(TOWERS, 0.0)
    for line in commands(texts, "M851"):
        offset |= {letter: line.value(letter, offset[letter]) for letter in TOWERS}
    contacts = []
    for where, text in lines(texts):
        if match := ANSWER.search(text):
            x, y, z = (float(part) for part in match.groups())
            decimals = len(match[3].partition(".")[2])
            place = (x - offset["X"], y - offset["Y"], z - offset["Z"])
            contacts.append(Contact(place, match[0], 0.0 - offset["Z"], 10.0**-decimals))
        elif "Bed X" in text:
            odd.append(f"{where}: {text!r}: no place of G30")
        elif OF_G33.search(text):
            odd.append(f"{where}: {text!r}: G33 shows means over places that it does not name")
    return Held(printer, tuple(contacts), tuple(odd))


def _printer(texts: Texts, odd: list[str]) -> TowerPrinter | None:
    words: dict[str, float] = {}
    adjusted = dict.fromkeys(TOWERS, 0.0)
    first = ""
    for line in commands(texts, "M665", "M666"):
        if line.command == "M665":
            words |= {letter: line.value(letter) for letter in line.words}
            first = first or line.where
        else:
            adjusted |= {tower: line.value(tower, adjusted[tower]) for tower in TOWERS}
    for line in commands(texts, "M206"):
        if line.value("Z"):
            odd.append(f"{line.where}: {line.text!r}: an offset that M206 adds")
    if not first:
        return None
    missing = [letter for letter in "LRH" if letter not in words]
    if missing:
        raise RecordError(
            f"file of a printer, {first}",
            f"M665 without {', '.join(missing)}",
            "L, R and H: length of the bars, radius, height",
            "Save all that M503 shows.",
        )
    trimmed = {"A", "C"} <= words.keys()  # older programs show another value as B
    arms = [words["L"] + (words.get(trim, 0.0) if trimmed else 0.0) for trim in TRIMS]
    turned = (words.get(tower, 0.0) for tower in TOWERS)
    a, b, c = (usual + more for usual, more in zip(USUAL_ANGLES_DEG, turned, strict=True))
    x, y, z = (words["H"] - adjusted[tower] for tower in TOWERS)
    return TowerPrinter(
        f"file of a printer, {first}",
        texts[0][0].stem,
        (arms[0], arms[1], arms[2]),
        (words["R"],) * 3,
        (x, y, z),
        (a, b, c),
    )
