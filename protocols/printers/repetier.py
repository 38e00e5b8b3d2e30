"""Repetier: lines of its EEPROM (M205), and ``Z-probe:`` lines of G29, G33 or G30.

A tower goes down by its offset once its switch has tripped; only then the tool is at the homed
height (``Printer::homeZAxis``): a switch trips by the offset above it. What a probe line states is
how far the tool went down from one height: it met the plate at that height less this way, and the
height is the same for all.
"""

from __future__ import annotations

import re

from calib.errors import RecordError
from calib.tripod.geometry import USUAL_ANGLES_DEG
from protocols.documents import triple
from protocols.printers.gcode import NUMBER, NUMBER_END, Texts, lines
from protocols.printers.tower_printer import Contact, FileContent, Pair, TowerPrinter

EEPROM_LINE = re.compile(rf"EPR:\d+ (\d+) ({NUMBER}) ")
ANSWER = re.compile(rf"Z-probe: ?({NUMBER}) X: ?({NUMBER}) Y: ?({NUMBER}){NUMBER_END}")

STEPS, HEIGHT, ROD, RADIUS, PRINTABLE = 11, 153, 881, 885, 925
OFFSETS, ANGLES = (893, 895, 897), (901, 905, 909)
RADII_MORE, RODS_MORE = (913, 917, 921), (933, 937, 941)
PROBE_OFFSETS = (800, 804)
REQUIRED = {
    **{STEPS: "Steps per mm", HEIGHT: "Z max length", ROD: "Diagonal rod length"},
    **{RADIUS: "Horizontal rod radius at 0,0"},
}
"""Places of the EEPROM that must be there, as they are named beside their values."""


def recognises(text: str) -> bool:
    """Whether a text has a line that only this firmware has."""
    return re.search(r"\bEPR:\d+ \d+ |Z-probe: ?[-\d]", text) is not None


def content(texts: Texts, beside_mm: Pair = (0.0, 0.0)) -> FileContent:
    """Geometry and contacts of these files together. Raises RecordError."""
    x_beside, y_beside = beside_mm
    stored: dict[int, float] = {}
    oddities: list[str] = []
    contacts, first = [], ""
    for source, text in lines(texts):
        if match := EEPROM_LINE.search(text):
            first = first or source
            stored[int(match[1])] = float(match[2])
        elif match := ANSWER.search(text):
            down, x, y = (float(part) for part in match.groups())
            contacts.append(Contact((x - x_beside, y - y_beside, 0.0 - down), match[0], 0.0, 0.001))
        elif "Z-probe:" in text:
            oddities.append(f"{source}: {text!r}: no place of a probe")
    if any(stored.get(place) for place in PROBE_OFFSETS) and not any(beside_mm):
        oddities.append("the probe's offset in X and Y: places are taken as the tool's")
    return FileContent(
        _printer(texts, stored, first), tuple(contacts), tuple(oddities), beside_mm=beside_mm
    )


def _printer(texts: Texts, stored: dict[int, float], first: str) -> TowerPrinter | None:
    if ROD not in stored and RADIUS not in stored and not stored:
        return None
    missing = [name for place, name in REQUIRED.items() if place not in stored]
    if missing or not stored[STEPS] > 0.0:
        raise RecordError(
            f"file of a printer, {first}",
            f"an EEPROM without {', '.join(missing) or 'steps per mm above 0'}",
            "the EEPROM of a printer with three upright towers",
            "Save all that M205 shows.",
        )
    rods = [stored[ROD] + stored.get(place, 0.0) for place in RODS_MORE]
    radii = [stored[RADIUS] + stored.get(place, 0.0) for place in RADII_MORE]
    usual = zip(ANGLES, USUAL_ANGLES_DEG, strict=True)
    angles = [stored.get(place, angle) for place, angle in usual]
    stops = [stored[HEIGHT] + stored.get(place, 0.0) / stored[STEPS] for place in OFFSETS]
    return TowerPrinter(
        f"file of a printer, {first}",
        texts[0][0].stem,
        triple(rods),
        triple(radii),
        triple(stops),
        triple(angles),
        stored.get(PRINTABLE),
    )
