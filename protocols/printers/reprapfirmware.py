"""RepRapFirmware: ``config.g``, places ``G30 P…`` of a macro or ``bed.g``, and what G32 answers.

A switch trips at H + M666. The heights of an answer stand in the order of P; each is where the
plate is met beside z = 0, with the trigger height of G31 taken off.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from calib.errors import RecordError
from calib.tripod.geometry import USUAL_ANGLES_DEG
from protocols.printers.gcode import CodeLine, Texts, commands, lines, steps_held
from protocols.printers.tower_printer import Contact, Held, TowerPrinter

NAME = "reprapfirmware"
FAR_MM = -9999.0
"""From this Z on down ``G30 P`` probes; above it a person states the height."""

ANSWER = re.compile(r"G32 bed probe heights:(.*?)(?:, mean .*)?$")
HELD = re.compile(
    r"Diagonals? ([\d.:]+), \w+ radius ([\d.]+), homed height ([\d.]+), bed radius ([\d.]+)"
    r", X (-?[\d.]+)\W+Y (-?[\d.]+)\W+Z (-?[\d.]+)"
)
ADJUSTED = re.compile(r"Endstop adjustments X(-?[\d.]+) Y(-?[\d.]+) Z(-?[\d.]+)")
MINE = re.compile(
    r"^\s*(?:M665\s*(?=[A-Z][^;\n]*)(?=[^;\n]*L)(?![^;\n]*S\d)|G30\s*P\d)",
    re.MULTILINE | re.IGNORECASE,
)
ENTRY = re.compile(r"not set|probing failed|-?\d+\.\d+")
TOWERS = "XYZ"


def is_mine(text: str) -> bool:
    """Whether a text has a line that only this firmware has."""
    if ANSWER.search(text) or HELD.search(text):
        return True
    return MINE.search(text) is not None


def held(texts: Texts) -> Held:
    """Geometry and contacts of these files together. Raises RecordError."""
    odd: list[str] = []
    printer = _printer(texts, odd)
    offset = dict.fromkeys("XYZ", 0.0)
    for line in commands(texts, "G31"):
        offset |= {letter: line.value(letter, offset[letter]) for letter in "XYZ"}
    contacts = [
        Contact(
            (x - offset["X"], y - offset["Y"], height + offset["Z"]),
            f"{height:.3f} of {where}",
            offset["Z"],
            0.001,
        )
        for x, y, height, where in _heights(texts, odd)
    ]
    beside_mm = offset["X"], offset["Y"]
    return Held(printer, tuple(contacts), tuple(odd), beside_mm=beside_mm)


def _printer(texts: Texts, odd: list[str]) -> TowerPrinter | None:
    """What the lines and answers hold in their order; of a letter the last one counts."""
    words: dict[str, tuple[float, ...]] = {}
    adjusted = dict.fromkeys(TOWERS, 0.0)
    first = ""
    for line in commands(texts, "M665", "M666"):
        if line.command == "M665":
            words |= {k: v if k == "L" else (line.value(k),) for k, v in line.words.items()}
            first = first or line.where
        else:
            adjusted |= {tower: line.value(tower, adjusted[tower]) for tower in TOWERS}
            if line.value("A") or line.value("B"):
                odd.append(f"{line.where}: {line.text!r}: the tilt A B of the bed")
    for where, text in lines(texts):
        if answer := HELD.search(text):
            lengths, *figures = answer.groups()
            words |= {"L": tuple(map(float, lengths.strip(":").split(":")))}
            words |= {letter: (float(v),) for letter, v in zip("RHBXYZ", figures, strict=True)}
            first = first or where
        elif answer := ADJUSTED.search(text):
            adjusted = dict(zip(TOWERS, map(float, answer.groups()), strict=True))
    if not first:
        return None
    missing = [letter for letter in "LRH" if not words.get(letter)]
    if missing:
        raise RecordError(
            f"file of a printer, {first}",
            f"M665 without {', '.join(missing)}",
            "L, R and H: lengths of the bars, radius, height as homed",
            "Name config.g, too, or the answer of M665.",
        )
    if len(words["L"]) > len(TOWERS):
        raise RecordError(
            f"file of a printer, {first}",
            f"M665 with {len(words['L'])} lengths of bars",
            "three towers, or one length for all",
            "Other printers are not calibrated here.",
        )
    # of towers without a length of their own the firmware takes the first one's
    lengths = (*words["L"], *words["L"][:1] * 3)
    (radius, *_), (height, *_) = words["R"], words["H"]
    turned = [words.get(tower, (0.0,))[0] for tower in TOWERS]
    a, b, c = (usual + turn for usual, turn in zip(USUAL_ANGLES_DEG, turned, strict=True))
    x, y, z = (height + adjusted[tower] for tower in TOWERS)
    return TowerPrinter(
        f"file of a printer, {first}",
        texts[0][0].stem,
        (lengths[0], lengths[1], lengths[2]),
        (radius, radius, radius),
        (x, y, z),
        (a, b, c),
        words["B"][0] if words.get("B") else None,
        steps_per_mm=steps_held(texts),
    )


def _heights(texts: Texts, odd: list[str]) -> Iterator[tuple[float, float, float, str]]:
    """Place of the probe, height, and where that was answered, for each that was measured."""
    groups = _groups(texts, odd)
    answers = [(where, m[1]) for where, text in lines(texts) if (m := ANSWER.search(text))]
    if not answers:
        return
    if not groups or len(answers) % len(groups):
        raise RecordError(
            f"file of a printer, {answers[0][0]}",
            f"{len(answers)} answers of G32 to {len(groups)} lists of places G30 P",
            "the macro or bed.g whose places were probed, once or several times",
            "Name that file, too.",
        )
    calibrates = any(group[-1].value("S", -1.0) > 0.0 for group in groups)
    for number, (where, text) in enumerate(answers):
        if calibrates and number:  # the first one changed what is held
            odd.append(f"{where}: measured after a calibration (S of G30 P above 0)")
            continue
        group, entries = groups[number % len(groups)], ENTRY.findall(text)
        if len(entries) != len(group):
            raise RecordError(
                f"file of a printer, {where}",
                f"{len(entries)} heights for {len(group)} places",
                "as many heights as places G30 P",
                "Is this the macro that was run?",
            )
        for line, entry in zip(group, entries, strict=True):
            if entry in ("not set", "probing failed"):
                odd.append(f"{where}: place {line.text!r}: {entry}")
            else:
                yield line.value("X"), line.value("Y"), float(entry), where


def _groups(texts: Texts, odd: list[str]) -> list[list[CodeLine]]:
    """Places that are reported together: each P once, S ends a group."""
    groups: list[list[CodeLine]] = []
    now: list[CodeLine] = []
    for line in commands(texts, "G30"):
        if "P" not in line.words:
            continue
        if not {"X", "Y"} <= line.words.keys() or line.value("Z", FAR_MM) > FAR_MM:
            odd.append(f"{line.where}: {line.text!r}: no place that is probed")
            continue
        if line.value("H"):
            odd.append(f"{line.where}: {line.text!r}: the correction H of a height")
        now.append(line)
        if "S" in line.words:
            groups.append(now)
            now = []
    if now:
        groups.append(now)
    return groups
