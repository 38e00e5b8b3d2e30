"""Marlin: what M503 shows, what ``G30 X Y`` answers, and the table of ``G33 V0``.

A carriage is taken to be at H once it stands M666 from its switch, which trips at H - M666. The
answer names the place of the probe; the tool stands at the height answered less the Z of M851,
which is below 0 where the probe trips before the tool touches.

G33 sends the tool, not the probe, to its places (gcode/calibrate/G33.cpp): at the radius that it
shows, in the directions of the towers and opposite to them. With P1 and P2 each height is of one
place. With P3 the middle alone is a mean, of three places at a tenth of the radius: it differs by a
hundredth of what the plate is bowed at the radius. From P4 on every height is a mean of far places.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from operator import add, itemgetter

from calib.errors import RecordError
from calib.tripod.geometry import USUAL_ANGLES_DEG
from protocols.documents import Triple, triple
from protocols.printers.gcode import NUMBER, NUMBER_END, PREFIX, Texts, commands, lines, motor_steps
from protocols.printers.tower_printer import Contact, FileContent, Pair, TowerPrinter

ANSWER = re.compile(rf"Bed X: ({NUMBER}) Y: ({NUMBER}) Z: ({NUMBER}){NUMBER_END}")
TOWERS, TRIMS = "XYZ", "ABC"

SIGNS = re.compile(
    r"Bed X: |Checking\.\.\. AC|M665 (?=.*L)(?=.*\bS\d)"
    r"|M665 (?=[^;\n]*\bC-?\d)(?![^;\n]*\b[DE]-?\d)"
)
"""S are segments, C a trim of a bar; of Smoothieware, which has D and E, it is a radius."""

G33_COMMAND = re.compile(r"\bG33\b(?! Auto)([^;*]*)")
"""The command G33, as hosts repeat it."""
TABLE_START = re.compile(rf"Checking\.\.\. AC(?: at radius: ?({NUMBER}))?(.*)")
HEIGHTS = re.compile(r"\. +(?:c|x|yz): ?[+-]?\d")
HEIGHT = re.compile(rf"\b(c|x|y|z|yz|zx|xy): ?({NUMBER})")
MIDDLE = "c"
AT_DEG = {"x": 210.0, "y": 330.0, "z": 90.0, "yz": 30.0, "zx": 150.0, "xy": 270.0}
"""Where G33 measures the heights of its table, from x anticlockwise: towers as they should be."""
SINGLE_PLACES = {
    frozenset({MIDDLE}): "1",
    frozenset({MIDDLE, "x", "y", "z"}): "2",
    frozenset({MIDDLE, "yz", "zx", "xy"}): "2",
    frozenset({MIDDLE, *AT_DEG}): "3",
}
"""The P for which a table with these heights has them of one place each."""
REPEAT_ADVICE = "send G33 P3 V0 and save what was sent and answered"


def recognises(text: str) -> bool:
    """Whether a text has a line that only this firmware has."""
    return SIGNS.search(text) is not None


def content(texts: Texts, beside_mm: Pair = (0.0, 0.0)) -> FileContent:
    """Geometry and contacts of these files together. Raises RecordError."""
    for line in commands(texts, "G20"):
        next_step = "Send G21, then M503 and the places again."
        raise line.fault("lengths in mm", next_step, meaning=": lengths in inches")
    oddities: list[str] = []
    printer = _printer(texts, oddities)
    offset = dict(zip(TOWERS, (*beside_mm, 0.0), strict=True))
    letters: set[str] = set()
    for line in commands(texts, "M851"):
        offset |= {letter: line.value(letter, offset[letter]) for letter in TOWERS}
        letters |= line.words.keys()
    has_offset = {"X", "Y"} <= letters or any(beside_mm)
    if not has_offset and any(ANSWER.search(text) for _, text in texts):
        oddities.append(
            "the probe's offset in X and Y, which no M851 shows here: places of G30 are taken as "
            "the tool's, add a line M851 X Y if the probe is beside it"
        )
    contacts = _contacts(texts, (offset["X"], offset["Y"], offset["Z"]), oddities)
    beside_mm = offset["X"], offset["Y"]
    return FileContent(printer, tuple(contacts), tuple(oddities), beside_mm=beside_mm)


@dataclass
class HeightTable:
    """What one run of G33 shows: where, after which command, at which radius, heights by name."""

    source: str
    command: str | None
    radius_mm: float | None
    calibrates: bool
    heights_mm: dict[str, float] = field(default_factory=dict)

    def why_not(self) -> str | None:
        """Why these heights are no contacts, and what to do; None: they are."""
        single_p = SINGLE_PLACES.get(frozenset(self.heights_mm))
        places = re.search(r"P\s*(\d+)", self.command or "")
        if self.calibrates:
            return f"it changes what is held while it measures; {REPEAT_ADVICE}"
        if single_p is None:
            return f"heights are missing; {REPEAT_ADVICE}"
        if self.radius_mm is None:
            return "this version does not show its radius; probe places: glidecal plan --macro"
        if places is None and single_p == "3":
            return f"sent with which P? From P4 on heights are means of far places; {REPEAT_ADVICE}"
        if places is not None and places[1] != single_p:
            return f"with P{places[1]} heights are means of far places; {REPEAT_ADVICE}"
        return None

    def contacts(self, beside_mm: Triple) -> Iterator[Contact]:
        """The heights as contacts, of a probe beside the tool; with O that goes to the places."""
        x_beside, y_beside, z_beside = beside_mm
        if "O" not in (self.command or ""):
            x_beside = y_beside = 0.0
        for name, height_mm in self.heights_mm.items():
            radius_mm = 0.0 if name == MIDDLE else self.radius_mm or 0.0
            angle = math.radians(AT_DEG.get(name, 0.0))
            place_mm = (
                round(radius_mm * math.cos(angle), 4) - x_beside,
                round(radius_mm * math.sin(angle), 4) - y_beside,
                height_mm - z_beside,
            )
            yield Contact(
                place_mm, f"{name}:{height_mm:+.2f} of {self.source}", 0.0 - z_beside, 0.01
            )


Lines = list[tuple[str, str]]
"""Where each stands, and its text without what a host writes before it."""


def _contacts(texts: Texts, beside_mm: Triple, oddities: list[str]) -> list[Contact]:
    """Contacts with the values that are read: once G33 has calibrated, others are held.

    ``beside_mm`` is where the probe trips from the tool. What is not used goes to ``oddities``.
    """
    all_lines = [(source, PREFIX.sub("", text, count=1)) for source, text in lines(texts)]
    contacts = list(_of_g30(all_lines, beside_mm, oddities))
    tables = _tables(all_lines)
    for number, table in tables:
        if reason := table.why_not():
            oddities.append(f"{table.source}: heights of G33: {reason}")
        else:
            contacts += [(number, contact) for contact in table.contacts(beside_mm)]
    contacts.sort(key=itemgetter(0))
    geometry_line = max(
        (n for n, (_, text) in enumerate(all_lines) if re.match(r"M665\b.*L", text)), default=0
    )
    calibrated = [number for number, table in tables if table.calibrates]
    calibrations = [
        [n for n in calibrated if (n < at) != (n < geometry_line)] for at, _ in contacts
    ]
    if earlier_count := sum(map(bool, calibrations)):
        oddities.append(
            f"{earlier_count} contacts: G33 calibrated between them and the M665 that is read"
        )
    return [contact for (_, contact), runs in zip(contacts, calibrations, strict=True) if not runs]


def _of_g30(
    all_lines: Lines, beside_mm: Triple, oddities: list[str]
) -> Iterator[tuple[int, Contact]]:
    """Number of the line and contact of each answer."""
    x_beside, y_beside, z_beside = beside_mm
    for number, (source, text) in enumerate(all_lines):
        if match := ANSWER.search(text):
            x, y, z = (float(part) for part in match.groups())
            decimals = len(match[3].partition(".")[2])
            place_mm = (x - x_beside, y - y_beside, z - z_beside)
            yield number, Contact(place_mm, match[0], 0.0 - z_beside, 10.0**-decimals)
        elif "Bed X" in text:
            oddities.append(f"{source}: {text!r}: no place of G30")


def _tables(all_lines: Lines) -> list[tuple[int, HeightTable]]:
    """Number of the line and table of each run of G33."""
    command: str | None = None
    tables: list[tuple[int, HeightTable]] = []
    for number, (source, text) in enumerate(all_lines):
        if match := TABLE_START.search(text):
            radius_mm = float(match[1]) if match[1] else None
            tables.append(
                (number, HeightTable(source, command, radius_mm, "DRY-RUN" not in match[2]))
            )
            command = None
        elif match := G33_COMMAND.search(text):
            command = match[1]
        elif tables and HEIGHTS.match(text):
            heights_mm = {name: float(height) for name, height in HEIGHT.findall(text)}
            tables[-1][1].heights_mm.update(heights_mm)
    return tables


def _printer(texts: Texts, oddities: list[str]) -> TowerPrinter | None:
    parameters: dict[str, float] = {}
    adjusted = dict.fromkeys(TOWERS, 0.0)
    first = ""
    for line in commands(texts, "M665", "M666"):
        if line.command == "M665":
            parameters |= {letter: line.value(letter) for letter in line.words}
            first = first or line.source
        else:
            adjusted |= {tower: line.value(tower, adjusted[tower]) for tower in TOWERS}
    for line in commands(texts, "M206"):
        if line.value("Z"):
            oddities.append(f"{line.source}: {line.text!r}: an offset that M206 adds")
    if not first:
        return None
    missing = [letter for letter in "LRH" if letter not in parameters]
    if missing:
        raise RecordError(
            f"file of a printer, {first}",
            f"M665 without {', '.join(missing)}",
            "L, R and H: length of the bars, radius, height",
            "Save all that M503 shows. Older programs do not show H: home, send M114, and add the "
            "Z of its answer to that line, as H and a number.",
        )
    trimmed = {"A", "C"} <= parameters.keys()  # older programs show another value as B
    arms = [parameters["L"] + (parameters.get(trim, 0.0) if trimmed else 0.0) for trim in TRIMS]
    turned = (parameters.get(tower, 0.0) for tower in TOWERS)
    return TowerPrinter(
        f"file of a printer, {first}",
        texts[0][0].stem,
        triple(arms),
        (parameters["R"],) * 3,
        triple(parameters["H"] - adjusted[tower] for tower in TOWERS),
        triple(map(add, USUAL_ANGLES_DEG, turned)),
        steps_per_mm=motor_steps(texts),
    )
