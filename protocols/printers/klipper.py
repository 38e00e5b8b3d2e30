"""Klipper: ``printer.cfg`` with what SAVE_CONFIG wrote below it, and what PROBE answers.

A stable position is three numbers of steps below the switches of a, b and c, so it tells the
heights of the carriages whatever geometry was held then (klippy/extras/delta_calibrate.py):
position_endstop + sqrt(arm_length^2 - delta_radius^2) - steps x length of a step.
"""

from __future__ import annotations

import configparser
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calib.errors import RecordError, UnreachablePosture
from calib.tripod import UPRIGHT_TOWERS
from calib.tripod.geometry import USUAL_ANGLES_DEG
from protocols.documents import MOST_EDITED_BYTES, Triple, triple
from protocols.printers.gcode import NUMBER_END, Texts, read_printed
from protocols.printers.tower_printer import OFF_PLATE_MM, Contact, FileContent, Pair, TowerPrinter
from protocols.table import MeasuredDistance

SAVED = "#*#"
SAVED_HEADER = "#*# <---------------------- SAVE_CONFIG ---------------------->"
STEPPERS = ("stepper_a", "stepper_b", "stepper_c")
CALIBRATION = "delta_calibrate"
RADIUS = "delta_radius"
PROBES = ("probe", "bltouch", "smart_effector", "probe_eddy_current", "load_cell_probe")
"""Sections of Klipper's probes; some have a name behind."""

MOST_HEIGHTS = 999
MOST_INCLUDES = 200
DECIMALS = 9
"""Decimals of a place in mm, so that one that is at 0 is shown there."""

NUMBER = r"([+-]?\d+(?:\.\d+)?)"
PROBED = re.compile(
    rf"probe: at {NUMBER},{NUMBER} bed will contact at z={NUMBER}{NUMBER_END}", re.ASCII
)
PROBED_BEFORE = re.compile(rf"probe at {NUMBER},{NUMBER} is z={NUMBER}{NUMBER_END}", re.ASCII)
"""Of programs from before 2025: the place of the tool, and its height as the probe tripped."""

ANSWER = re.compile(r"\bprobe:? at ")
SAVE_COMMAND = re.compile(r"(?:[\W\d]|[AP]M\b|Send:)*SAVE_CONFIG\s*$")
"""The command, as hosts repeat it."""
OF_CALIBRATION = re.compile(r"(manual_height|height|distance)(\d+)(_pos[12]?)?$")
SETTING_KEYS = {"radius", "horizontal_move_z", "speed", "points"}
"""Keys of ``[delta_calibrate]`` that are no measurement."""


def is_config(text: str) -> bool:
    """Whether a text has the section of a ``printer.cfg`` that tells the kinematics."""
    return re.search(r"^\[printer\]", text, re.MULTILINE) is not None


def recognises(text: str) -> bool:
    """Whether a text is a ``printer.cfg``, or has answers of the command PROBE."""
    return is_config(text) or ANSWER.search(text) is not None


class Config:
    """Sections of a ``printer.cfg`` with its includes; of a key that is there twice the last.

    The saved block has no say on keys that stand above it (klippy/configfile.py). Raises
    RecordError naming the file and what cannot be read of it.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.parser = configparser.RawConfigParser(strict=False, inline_comment_prefixes=(";", "#"))
        self.oddities: list[str] = []
        self.included = 0
        plain, _, saved = read_printed(path, SUBJECT, MOST_EDITED_BYTES).partition(SAVED_HEADER)
        lines = saved.splitlines()
        strangers = [line for line in lines if line.strip() and not line.startswith(SAVED)]
        if strangers:
            raise RecordError(
                f"{SUBJECT} {path}, below the SAVE_CONFIG line",
                repr(strangers[0]),
                "lines that begin with #*#, as Klipper wrote them",
                "Klipper does not read this block either: remove the line.",
            )
        block = "\n" * plain.count("\n")  # so that messages name the line of the file
        block += "\n".join(line.removeprefix(SAVED).removeprefix(" ") for line in lines)
        # first: what stands above, or is included there, wins
        self._parse(path, re.sub(r"^DO NOT EDIT.*$", "", block, flags=re.MULTILINE))
        self._add(path, plain, [path.resolve()])

    def _add(self, path: Path, text: str, inside: list[Path]) -> None:
        """A text and, in their places, the files that it includes."""
        buffered: list[str] = []
        for number, whole_line in enumerate(text.splitlines(), start=1):
            line = whole_line.partition("#")[0]  # here Klipper ends a line, spaces before or not
            include = re.match(r"\[include\s+([^\]]+)\]", line)
            if include is None:
                buffered.append(line)
                continue
            self._parse(path, "\n".join(buffered))
            buffered = [""] * number  # so that messages name the line of the file
            self._include(path, include[1].strip(), inside)
        self._parse(path, "\n".join(buffered))

    def _include(self, path: Path, name: str, inside: list[Path]) -> None:
        try:
            targets = sorted(path.parent.glob(name))
        except (ValueError, NotImplementedError):  # nothing, or from the root of the disk
            targets = []
        if not targets:
            self.oddities.append(f"[include {name}] of {path.name}: there is no such file")
        for target in targets:
            resolved = target.resolve()
            self.included += 1
            if resolved in inside or self.included > MOST_INCLUDES:
                requirement = f"no file inside itself, {MOST_INCLUDES} files together"
                raise RecordError(f"{SUBJECT} {path}", f"[include {name}]", requirement)
            self._add(target, read_printed(target, SUBJECT, MOST_EDITED_BYTES), [*inside, resolved])

    def _parse(self, path: Path, text: str) -> None:
        try:
            self.parser.read_string(text, str(path))
        except configparser.Error as problem:
            line = (
                getattr(problem, "lineno", None)
                or (getattr(problem, "errors", None) or [[0]])[0][0]
            )
            place = f", near line {line}" if line else ""
            raise RecordError(
                f"{SUBJECT} {path}{place}",
                reason="no section or key, as Klipper has them",
                next_step="Give the printer.cfg that the printer starts with.",
            ) from problem

    def number(
        self, section: str, key: str, usual: float | None = None, *, above: float | None = None
    ) -> float:
        """A finite number. Raises RecordError where it is missing, no number, or not above."""
        text = self.text(section, key)
        if text is None:
            if usual is None:
                next_step = "Add it as the printer has it."
                raise self.fault(section, key, "nothing", "a number", next_step)
            return usual
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value) or (above is not None and value <= above):
            limit = "" if above is None else f" above {above:g}"
            raise self.fault(section, key, repr(text), f"a finite number{limit}")
        return value

    def fault(
        self, section: str, key: str, value: str, requirement: str, next_step: str = ""
    ) -> RecordError:
        """The error that the value of a key deserves."""
        subject = f"{SUBJECT} {self.path}, [{section}] {key}"
        return RecordError(subject, value, requirement, next_step)

    def text(self, section: str, key: str) -> str | None:
        """What stands there; None: nothing."""
        return self.parser.get(section, key, fallback=None)

    def keys(self, section: str) -> Mapping[str, str]:
        """All keys of a section; none where there is no such section."""
        return dict(self.parser.items(section)) if self.parser.has_section(section) else {}


SUBJECT = "printer configuration"


def content(texts: Texts, beside_mm: Pair = (0.0, 0.0)) -> FileContent:
    """Geometry and contacts of one ``printer.cfg`` and logs of PROBE. Raises RecordError."""
    paths = [path for path, text in texts if is_config(text)]
    if len(paths) > 1:
        names = ", ".join(map(str, paths))
        raise RecordError(SUBJECT, names, "one printer.cfg; it includes the others")
    config = Config(paths[0]) if paths else None
    of_config = _content_of_config(config) if config else FileContent(None, ())
    contacts, oddities = [*of_config.contacts], [*of_config.oddities]
    for path, text in texts:
        if path not in paths:
            offset_mm = _probe_offset_mm(config) if config else (*beside_mm, 0.0)
            log_contacts, log_oddities = _probed(text, offset_mm, path.name)
            contacts += log_contacts
            oddities += log_oddities
    return replace(of_config, contacts=tuple(contacts), oddities=tuple(oddities))


def _content_of_config(config: Config) -> FileContent:
    """What a ``printer.cfg`` holds. Raises RecordError for a machine without upright towers."""
    kinematics = config.text("printer", "kinematics") or "nothing"
    if kinematics != UPRIGHT_TOWERS:
        requirement = f"{UPRIGHT_TOWERS}: three upright towers"
        next_step = "Other printers are not calibrated here."
        raise config.fault("printer", "kinematics", kinematics, requirement, next_step)
    saved = SavedPlaces(config, *_printer(config))
    contacts, distances = saved.measured()
    x_offset, y_offset, _ = _probe_offset_mm(config)
    oddities = tuple(config.oddities)
    return FileContent(saved.printer, contacts, oddities, distances, (x_offset, y_offset))


def _printer(config: Config) -> tuple[TowerPrinter, Triple]:
    """The geometry, and the travel for one step of each tower, mm."""
    radius = config.number("printer", RADIUS, above=0.0)
    first_arm = config.number(STEPPERS[0], "arm_length", above=radius)
    first_stop = config.number(STEPPERS[0], "position_endstop")
    arms = [config.number(name, "arm_length", first_arm, above=radius) for name in STEPPERS]
    stops = [config.number(name, "position_endstop", first_stop) for name in STEPPERS]
    angles = [
        config.number(name, "angle", usual)
        for name, usual in zip(STEPPERS, USUAL_ANGLES_DEG, strict=True)
    ]
    turns = [_turn_mm(config, name) for name in STEPPERS]
    microsteps = [
        config.number(name, "full_steps_per_rotation", 200, above=0.0)
        * config.number(name, "microsteps", above=0.0)
        for name in STEPPERS
    ]
    steps = [turn / count for turn, count in zip(turns, microsteps, strict=True)]
    distances = (config.number(name, "rotation_distance", above=0.0) for name in STEPPERS)
    has_radius = config.text("printer", "print_radius") is not None
    printable = config.number("printer", "print_radius", above=0.0) if has_radius else None
    printer = TowerPrinter(
        f"{SUBJECT} {config.path}",
        config.path.stem,
        triple(arms),
        (radius, radius, radius),
        triple(stops),
        triple(angles),
        printable,
        turns[0] if len(set(turns)) == 1 else None,
        triple(distances),
        triple(1.0 / step for step in steps),
    )
    return printer, triple(steps)


def _turn_mm(config: Config, stepper: str) -> float:
    """Travel of a carriage for one turn of its motor: behind a gear it is less."""
    if config.text(stepper, "rotation_distance") is None:
        old = config.text(stepper, "step_distance")
        raise config.fault(
            stepper,
            "rotation_distance",
            "nothing" if old is None else f"step_distance: {old}, as Klipper had it before 2021",
            "the travel for one turn, in mm: without it steps have no length",
            "Give the printer.cfg that the printer starts with today.",
        )
    return config.number(stepper, "rotation_distance", above=0.0) / _gearing(config, stepper)


def _gearing(config: Config, stepper: str) -> float:
    ratio, text = 1.0, config.text(stepper, "gear_ratio") or ""
    for pair in filter(None, (part.strip() for part in text.split(","))):
        match = re.fullmatch(rf"{NUMBER}\s*:\s*{NUMBER}", pair)
        if match is None or not float(match[1]) > 0.0 or not float(match[2]) > 0.0:
            raise config.fault(stepper, "gear_ratio", repr(text), "such as 80:16")
        ratio *= float(match[1]) / float(match[2])
    return ratio


@dataclass(frozen=True)
class SavedPlaces:
    """What DELTA_CALIBRATE saved: heights and distances at numbers of steps of ``step_mm`` each."""

    config: Config
    printer: TowerPrinter
    step_mm: Triple

    def measured(self) -> tuple[tuple[Contact, ...], tuple[MeasuredDistance, ...]]:
        """Contacts and distances; what is not used goes to the oddities of the configuration."""
        keys_of_places = set(SETTING_KEYS)
        contacts, distances = [], []
        for name in ("height", "manual_height"):
            for key in self._numbered(name, ("_pos",)):
                keys_of_places |= {key, f"{key}_pos"}
                contacts.append(self._contact(key))
        for key in self._numbered("distance", ("_pos1", "_pos2")):
            keys_of_places |= {key, f"{key}_pos1", f"{key}_pos2"}
            distances.append(self._distance(key))
        for key in self.config.keys(CALIBRATION):
            if key not in keys_of_places:
                match = OF_CALIBRATION.match(key)
                reason = "a number before it is missing" if match else "not known"
                self.config.oddities.append(f"[{CALIBRATION}] {key}: {reason}")
        return tuple(contacts), tuple(distances)

    def _numbered(self, name: str, endings: Sequence[str]) -> Iterator[str]:
        """Keys of that name from 0 up to the first that is missing, where Klipper stops, too.

        Raises RecordError where one has no steps ``endings`` beside it.
        """
        keys = self.config.keys(CALIBRATION)
        for key in (f"{name}{number}" for number in range(MOST_HEIGHTS)):
            if key not in keys:
                break
            for end in endings:
                if key + end not in keys:
                    requirement = f"three numbers of steps beside {key}"
                    raise self.config.fault(CALIBRATION, key + end, "nothing", requirement)
            yield key

    def _contact(self, key: str) -> Contact:
        height_mm = self.config.number(CALIBRATION, key)
        return Contact(
            self._place(f"{key}_pos", height_mm),
            f"{key}: {height_mm:g}, {self._steps_words(f'{key}_pos')}",
            height_mm,
            max(self.step_mm),
            "hand" if key.startswith("manual") else "probe",
        )

    def _distance(self, key: str) -> MeasuredDistance:
        """Between places on the plate; the steps count from the switches, as those of heights."""
        value_mm = self.config.number(CALIBRATION, key, above=0.0)
        ends = [f"{key}_pos{end}" for end in (1, 2)]
        first, second = (self._place(end, 0.0) for end in ends)
        text = f"{key}: {value_mm:g}, {', '.join(map(self._steps_words, ends))}"
        source = f"{SUBJECT} {self.config.path}, [{CALIBRATION}] {key}"
        return MeasuredDistance(first, second, value_mm, text, source)

    def _steps_words(self, key: str) -> str:
        return f"{key}: {self.config.text(CALIBRATION, key)}"

    def _place(self, key: str, height_mm: float) -> Triple:
        """Where these steps lead to. Raises RecordError further than so much from the height."""
        text = self.config.text(CALIBRATION, key) or ""
        try:
            steps = np.array([float(part) for part in text.split(",")])
        except ValueError:
            steps = np.array([math.nan])
        if steps.shape != (3,) or not np.isfinite(steps).all():
            requirement = "three numbers of steps, of a, b and c"
            raise self.config.fault(CALIBRATION, key, repr(text), requirement)
        try:
            place = self.printer.tool_mm(self.printer.switches_mm - steps * np.array(self.step_mm))
        except UnreachablePosture as problem:
            raise self._elsewhere(key, "the bars do not meet there") from problem
        x, y, z = (round(value, DECIMALS) + 0.0 for value in place)
        if abs(z - height_mm) > OFF_PLATE_MM:
            raise self._elsewhere(key, f"the tool at ({x:z.1f}, {y:z.1f}, {z:z.1f}) mm")
        return x, y, z

    def _elsewhere(self, key: str, reason: str) -> RecordError:
        return self.config.fault(
            CALIBRATION,
            key,
            f"{self.config.text(CALIBRATION, key)}: {reason}",
            f"a place within {OFF_PLATE_MM:g} mm of the plate",
            "These contacts are of another geometry: endstops, arms or steps changed since. Run "
            "DELTA_CALIBRATE again, save, and import that.",
        )


def _probe_offset_mm(config: Config) -> Triple:
    """Where the probe trips from the tool, as the section of the probe that there is has it."""
    sections = (name for name in config.parser.sections() if name.split()[0] in PROBES)
    section = next(sections, PROBES[0])
    return triple(config.number(section, f"{axis}_offset", 0.0) for axis in "xyz")


def _probed(text: str, offset_mm: Triple, name: str) -> tuple[list[Contact], list[str]]:
    """Contacts of a log of PROBE, and lines of it that are like answers and cannot be read.

    The place that is answered is the probe's, beside the tool; the tool stands its z_offset higher.
    With SAVE_CONFIG other values may begin to hold: contacts before it are not used.
    """
    x_offset, y_offset, z_offset = offset_mm
    contacts: list[Contact] = []
    oddities: list[str] = []
    for number, line in enumerate(text.splitlines(), start=1):
        if SAVE_COMMAND.match(line):
            if contacts:
                oddities.append(
                    f"{len(contacts)} contacts before SAVE_CONFIG in line {number} of {name}: they "
                    "may be of other values"
                )
            contacts = []
        elif match := PROBED.search(line):
            x, y, z = (float(part) for part in match.groups())
            place = (x - x_offset, y - y_offset, z + z_offset)
            contacts.append(Contact(place, match[0], z_offset))
        elif match := PROBED_BEFORE.search(line):
            x, y, z = (float(part) for part in match.groups())
            contacts.append(Contact((x, y, z), match[0], z_offset))
        elif ANSWER.search(line):
            oddities.append(f"{name}, line {number}: {line.strip()!r}: no place of PROBE")
    return contacts, oddities
