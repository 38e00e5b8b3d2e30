"""RepRapFirmware: ``config.g``, places ``G30 P…`` of a macro or ``bed.g``, and what G32 answers.

A switch trips at H + M666. The heights of an answer stand in the order of P; each is where the
plate is met beside z = 0, with the trigger height of G31 taken off. Where M666 has a tilt, the
carriages are higher by A % of x and B % of y (LinearDeltaKinematics.cpp), and so is the tool.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from operator import add

from calib.errors import RecordError
from calib.tripod.geometry import USUAL_ANGLES_DEG
from protocols.documents import triple
from protocols.printers.gcode import NUMBER, CodeLine, Texts, commands, lines, motor_steps
from protocols.printers.tower_printer import Contact, FileContent, Pair, TowerPrinter

FAR_MM = -9999.0
"""From this Z on down ``G30 P`` probes; above it a person states the height. Without a Z it is that
where the tool is (GCodes.cpp, ``ExecuteG30``). The answer has stated heights, too."""

ANSWER = re.compile(r"G32 bed probe heights:(.*?)(?:, mean .*)?$", re.MULTILINE)
GEOMETRY = re.compile(
    r"Diagonals? ([\d.:]+), \w+ radius (\d+(?:\.\d+)?), homed height (\d+(?:\.\d+)?)"
    r", bed radius (\d+(?:\.\d+)?)"
    r", X (-?\d+(?:\.\d+)?)[^XYZ]+Y (-?\d+(?:\.\d+)?)[^XYZ]+Z (-?\d+(?:\.\d+)?)"
)
ADJUSTED = re.compile(
    r"Endstop adjustments X(-?\d+(?:\.\d+)?) Y(-?\d+(?:\.\d+)?) Z(-?\d+(?:\.\d+)?)"
    r"(?:, tilt X(-?\d+(?:\.\d+)?)% Y(-?\d+(?:\.\d+)?)%)?"
)
SAVED = "generated in response to M500"
"""Of the first line of ``config-override.g``."""
PROBES = re.compile(r"^[ \t]*G30[ \t]*P\d", re.MULTILINE | re.IGNORECASE)
SET_GLOBAL = re.compile(
    rf"^[ \t]*(?:global[ \t]+|set[ \t]+global\.)(\w+)[ \t]*=[ \t]*(?:({NUMBER})[ \t]*(?:;.*)?$|)",
    re.MULTILINE,
)
"""A variable, and its value if that is a number."""
GLOBAL = re.compile(r"\{\s*global\.(\w+)\s*\}")
TIME = re.compile(r"\b(\d{1,2}):(\d\d):(\d\d)(?:\s?([AP])M\b)?")
SIGNS = re.compile(
    r"^[ \t]*(?:M665[ \t]*[A-Z][ \t]*[-\d.{](?![^;\n]*[SC][ \t]*-?\d)|G30[ \t]*P\d)",
    re.MULTILINE | re.IGNORECASE,
)
ENTRY = re.compile(r"not set|probing failed|-?\d+\.\d+")
TOWERS = "XYZ"
LETTERS = "LRHBXYZ"
"""Of M665."""

Answers = list[tuple[str, str]]
"""Where each line stands, and its text."""


def recognises(text: str) -> bool:
    """Whether a text has a line that only this firmware has."""
    if ANSWER.search(text) or GEOMETRY.search(text):
        return True
    return SIGNS.search(text) is not None


def content(texts: Texts, beside_mm: Pair = (0.0, 0.0)) -> FileContent:
    """Geometry and contacts of these files together. Raises RecordError."""
    oddities: list[str] = []
    texts = _as_started(_with_numbers(_in_order(texts)), oddities)
    answers = list(_answers(texts))
    printer = _printer(texts, answers)
    offset = dict(zip("XYZ", (*beside_mm, 0.0), strict=True))
    tilt = dict.fromkeys("AB", 0.0)
    for line in commands(texts, "G31"):
        offset |= {letter: line.value(letter, offset[letter]) for letter in "XYZ"}
    for line in commands(texts, "M666"):
        tilt |= {letter: line.value(letter, tilt[letter]) for letter in "AB"}
    for _, text in answers:
        if (answer := ADJUSTED.search(text)) and answer[4]:
            tilt = {"A": float(answer[4]), "B": float(answer[5])}
    contacts = []
    for probe_x, probe_y, height, source in _heights(texts, answers, oddities):
        x, y = probe_x - offset["X"], probe_y - offset["Y"]
        raised = (tilt["A"] * x + tilt["B"] * y) / 100.0
        place = (x, y, height + offset["Z"] + raised)
        contacts.append(Contact(place, f"{height:.3f} of {source}", offset["Z"], 0.001))
    beside_mm = (offset["X"], offset["Y"])
    return FileContent(printer, tuple(contacts), tuple(oddities), beside_mm=beside_mm)


def _in_order(texts: Texts) -> Texts:
    """Files as the firmware runs them, in whatever order they are named.

    What M500 saved comes after the configuration, a macro that probes after both.
    """

    def turn(text: str) -> int:
        return 1 if SAVED in text else 2 * bool(PROBES.search(text))

    return sorted(texts, key=lambda file: turn(file[1]))


def _as_started(texts: Texts, oddities: list[str]) -> Texts:
    """Files without what M500 saved where the configuration has no M501, which reads it."""
    configured = [file for file in texts if SAVED not in file[1]]
    if not any(commands(configured, "M665")) or any(commands(configured, "M501")):
        return texts
    oddities += [
        f"{path.name}: the configuration has no M501, so the firmware does not read it when it "
        "starts"
        for path, text in texts
        if SAVED in text
    ]
    return configured


def _with_numbers(texts: Texts) -> Texts:
    """Variables of expressions replaced by their number, where they never have another one."""
    values: dict[str, set[str]] = {}
    for _, text in texts:
        for name, number in SET_GLOBAL.findall(text):
            values.setdefault(name, set()).add(number)

    def number_of(match: re.Match[str]) -> str:
        (number, *further) = values.get(match[1], {""})
        return match[0] if further or not number else number

    return [(path, GLOBAL.sub(number_of, text)) for path, text in texts]


def _answers(texts: Texts) -> Iterator[tuple[str, str]]:
    """Every line as `lines`, the oldest first: the console of the web interface has it last."""
    for file in texts:
        listed = list(lines([file]))
        times = [
            (int(hour) % (12 if half else 24) + 12 * (half == "P"), int(minute), int(second))
            for _, text in listed
            for hour, minute, second, half in TIME.findall(text)[:1]
        ]
        is_newest_first = len(times) > 1 and times == sorted(times, reverse=True) != times[::-1]
        yield from reversed(listed) if is_newest_first else listed


def _printer(texts: Texts, answers: Answers) -> TowerPrinter | None:
    """What the lines and answers hold in their order; of a letter the last one counts."""
    parameters: dict[str, tuple[float, ...]] = {}
    adjusted = dict.fromkeys(TOWERS, 0.0)
    first = ""
    for line in commands(texts, "M665", "M666"):
        if line.command == "M665":
            if not line.words.keys() <= set(LETTERS):
                raise line.fault(
                    f"M665 of RepRapFirmware, with {', '.join(LETTERS)}",
                    "Other firmware means other values by M665. Is this file of this printer?",
                )
            parameters |= {k: v if k == "L" else (line.value(k),) for k, v in line.words.items()}
            first = first or line.source
        else:
            adjusted |= {tower: line.value(tower, adjusted[tower]) for tower in TOWERS}
    for source, text in answers:
        if answer := GEOMETRY.search(text):
            lengths, *figures = answer.groups()
            parameters |= {"L": tuple(map(float, lengths.strip(":").split(":")))}
            parameters |= {letter: (float(v),) for letter, v in zip("RHBXYZ", figures, strict=True)}
            first = first or source
        elif answer := ADJUSTED.search(text):
            adjusted = dict(zip(TOWERS, map(float, answer.groups()[:3]), strict=True))
    if not first:
        return None
    missing = [letter for letter in "LRH" if not parameters.get(letter)]
    if missing:
        raise RecordError(
            f"file of a printer, {first}",
            f"M665 without {', '.join(missing)}",
            "L, R and H: lengths of the bars, radius, height as homed",
            "Name config.g, too, or the answer of M665.",
        )
    if len(parameters["L"]) > len(TOWERS):
        raise RecordError(
            f"file of a printer, {first}",
            f"M665 with {len(parameters['L'])} lengths of bars",
            "three towers, or one length for all",
            "Other printers are not calibrated here.",
        )
    # of towers without a length of their own the firmware takes the first one's
    lengths = (*parameters["L"], *parameters["L"][:1] * 3)[:3]
    (radius, *_), (height, *_) = parameters["R"], parameters["H"]
    turned = [parameters.get(tower, (0.0,))[0] for tower in TOWERS]
    return TowerPrinter(
        f"file of a printer, {first}",
        texts[0][0].stem,
        triple(lengths),
        (radius, radius, radius),
        triple(height + adjusted[tower] for tower in TOWERS),
        triple(map(add, USUAL_ANGLES_DEG, turned)),
        parameters["B"][0] if parameters.get("B") else None,
        steps_per_mm=motor_steps(texts),
    )


def _heights(
    texts: Texts, all_answers: Answers, oddities: list[str]
) -> Iterator[tuple[float, float, float, str]]:
    """Place of the probe, height, and where that was answered, for each that was measured."""
    groups = _groups(texts)
    oddities += _unlike_contacts(groups)
    answers = [(source, m[1]) for source, text in all_answers if (m := ANSWER.search(text))]
    if not answers:
        return
    if not groups or len(answers) % len(groups):
        raise RecordError(
            f"file of a printer, {answers[0][0]}",
            f"{len(answers)} answers of G32 to {len(groups)} lists of places G30 P",
            "the macro or bed.g whose places were probed, once or several times",
            "Name that file, too, and no other.",
        )
    calibrates = any(list(group.values())[-1].value("S", -1.0) > 0.0 for group in groups)
    for number, (source, text) in enumerate(answers):
        if calibrates and number:  # the first one changed what is held
            oddities.append(f"{source}: measured after a calibration (S of G30 P above 0)")
            continue
        group, entries = groups[number % len(groups)], ENTRY.findall(text)
        if len(entries) != len(group):
            raise RecordError(
                f"file of a printer, {source}",
                f"{len(entries)} heights for {len(group)} places",
                "as many heights as places G30 P",
                "Is this the macro that was run?",
            )
        for point, entry in zip(sorted(group), entries, strict=True):
            line = group[point]
            if _is_probed(line) and entry in ("not set", "probing failed"):
                oddities.append(f"{source}: place {line.text!r}: {entry}")
            elif _is_probed(line):
                yield line.value("X"), line.value("Y"), float(entry), source


def _unlike_contacts(groups: Sequence[dict[float, CodeLine]]) -> Iterator[str]:
    """Places that are not probed, and what is added to a height."""
    for line in (line for group in groups for line in group.values()):
        if not _is_probed(line):
            yield f"{line.source}: {line.text!r}: no place that is probed"
        elif line.value("H"):
            yield f"{line.source}: {line.text!r}: the correction H of a height"


def _is_probed(line: CodeLine) -> bool:
    """Whether its height is measured, at a place that it states."""
    return {"X", "Y"} <= line.words.keys() and line.value("Z", 0.0) <= FAR_MM


def _groups(texts: Texts) -> list[dict[float, CodeLine]]:
    """Places that are reported together, each by its P; a place probed again is where it was last.

    S ends a group. One that calibrates (S from 0 on) is answered without heights: it counts only
    where no other one is there.
    """
    groups: list[dict[float, CodeLine]] = []
    group_places: dict[float, CodeLine] = {}
    for line in commands(texts, "G30"):
        if "P" not in line.words:
            continue
        group_places[line.value("P")] = line
        if "S" in line.words:
            groups.append(group_places)
            group_places = {}
    if group_places:
        groups.append(group_places)
    reported_groups = [
        group for group in groups if all(line.value("S", -1.0) < 0.0 for line in group.values())
    ]
    return reported_groups or groups
