"""Files of a printer's firmware as one session: its machine file, and its contacts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Protocol

import numpy as np

from calib.arrays import FloatArray
from calib.errors import RecordError, UsageError
from protocols.machine import Instrument, Machine, machine_text
from protocols.observations import BY_HAND, SAME_PLACE_MM
from protocols.printers import klipper, marlin, repetier, reprapfirmware
from protocols.printers.gcode import Texts, read_printed
from protocols.printers.tower_printer import LARGEST, OFF_PLATE_MM, Contact, FileContent, Pair
from protocols.procedure import default_mount
from protocols.session import Opened, Reading
from protocols.table import MeasuredDistance, is_table

SUBJECT = "file of a printer"
STEEPEST = 0.1
"""Of a plate as contacts show it: over one that is steeper no nozzle printed."""

BESIDE_MM = 5.0
"""So near each other contacts differ by the probe's errors, not by slopes."""

MOST_CONTACTS = 100_000
"""A record of more would be beyond its size: a contact takes about half a kilobyte."""

MOST_REMARKS = 20
LETTERS = 80
"""Letters of a line that a message repeats."""


@dataclass(frozen=True)
class ImportedPrinter:
    """A session to write: its first line, its contacts, the machine file, and what is not used.

    ``machine_file`` is TOML; None where the machine was stated, not read. A configuration alone has
    no contacts yet.
    """

    opened: Opened
    contacts: tuple[Reading, ...]
    machine_file: str | None
    oddities: tuple[str, ...]
    distances: tuple[MeasuredDistance, ...] = ()


class Dialect(Protocol):
    """A module that reads files of one firmware."""

    def recognises(self, text: str) -> bool:
        """Whether a text has a line that only this firmware has."""

    def content(self, texts: Texts, beside_mm: Pair = (0.0, 0.0)) -> FileContent:
        """Geometry and contacts of these files together. Raises RecordError.

        The probe is ``beside_mm`` the tool, in x and y, where no file tells.
        """


DIALECTS: tuple[Dialect, ...] = (klipper, repetier, marlin, reprapfirmware)
"""Each knows its own texts, and reads several of them together."""


def are_of_printer(paths: Sequence[Path]) -> bool:
    """Whether these are files of a firmware and no table, by ending or first line.

    Raises RecordError for no such file.
    """
    if len(paths) > 1:
        return True
    if is_table(paths[0]):
        return False
    text = read_printed(paths[0], SUBJECT)
    has_columns = "_mm" in text.partition("\n")[0]
    return not has_columns or any(dialect.recognises(text) for dialect in DIALECTS)


def imported_printer(
    paths: Sequence[Path],
    program: str,
    *,
    machine: Machine | None = None,
    resolution_mm: float | None = None,
    repeatability_mm: float | None = None,
    remarks: tuple[str, ...] = (),
    geometry_alone: bool = False,
) -> ImportedPrinter:
    """A session of what these files hold, the geometry of one of them or the ``machine``'s.

    ``resolution_mm`` and ``repeatability_mm`` are stated of the probe; with ``geometry_alone``
    contacts may be missing. Raises RecordError for files without geometry or contacts, or contacts
    that are none of this machine, UsageError for a machine that is stated and read.
    """
    content = _content(paths, (machine and machine.probe_offset_mm) or (0.0, 0.0))
    if content.printer is not None and machine is not None:
        raise UsageError(
            "--machine",
            f"{machine.name}, beside the geometry in {paths[0]}",
            "one of both",
            "Leave it out: the machine file is made of the printer's own numbers.",
        )
    if not content.contacts and not geometry_alone:
        raise RecordError(
            f"{SUBJECT} {paths[0]}",
            "no contact with the plate"
            + "".join(f". Not used: {oddity}" for oddity in content.oddities[:1]),
            "heights that the firmware saved, or a log of its probe beside it",
            "Write the machine file now (--machine-file-out), with it the places to probe "
            "(glidecal plan --macro), run them, and name their log here, too.",
        )
    if len(content.contacts) > MOST_CONTACTS:
        raise RecordError(
            f"{SUBJECT} {paths[-1]}",
            f"{len(content.contacts):,} contacts",
            f"up to {MOST_CONTACTS:,} in a session",
            "Import the log of one run of the places, not that of weeks.",
        )
    text = None
    if content.printer is not None:
        machine = content.printer.machine(content.contacts, content.beside_mm)
        names = ", ".join(path.name for path in paths)
        text = machine_text(
            machine, (f"Made by glidecal import from {names}. Lengths in mm.", *NOTE)
        )
    if machine is None:
        raise RecordError(
            f"{SUBJECT} {paths[0]}",
            "contacts, and no geometry",
            "the printer's configuration beside it, or --machine",
        )
    _check(", ".join(map(str, paths)), content.contacts, machine)
    instrument = Instrument(
        profile="probe",
        port=paths[0].name,
        axes="z",
        resolution_mm=resolution_mm,
        repeatability_mm=repeatability_mm,
    )
    unused = tuple(f"not used: {remark}" for remark in content.oddities[:MOST_REMARKS])
    opened = Opened(
        program=program,
        origin="imported",
        machine=machine,
        instruments=(instrument,),
        remarks=(*remarks, *unused),
    )
    return ImportedPrinter(
        opened, _readings(content.contacts), text, content.oddities, content.distances
    )


NOTE = (
    "What no firmware knows has usual values of printers here: tolerances (standard",
    "deviations of what is off before calibration), and the box that errors of the tool are",
    "judged over. Change them as you know better.",
)


def _content(paths: Sequence[Path], beside_mm: Pair) -> FileContent:
    """What all files hold together, in the first dialect that knows them all.

    Raises RecordError naming the file that the dialect of the first one does not know.
    """
    texts = [(path, read_printed(path, SUBJECT)) for path in paths]
    _refuse_twice(texts)
    dialect = max(DIALECTS, key=lambda dialect: sum(dialect.recognises(text) for _, text in texts))
    strangers = [path for path, text in texts if not dialect.recognises(text)]
    if strangers:
        raise RecordError(
            f"{SUBJECT} {strangers[0]}",
            "no geometry and no answer of a probe",
            "files of one printer: its configuration, a log of its probe",
            "They are printer.cfg and the answers of PROBE (Klipper), config.g and those of G32 "
            "(RepRapFirmware), M503 with G30 or G33 (Marlin), M205 with G29 (Repetier).",
        )
    return dialect.content(texts, beside_mm)


def _refuse_twice(texts: Texts) -> None:
    """Raises RecordError for a text that is in another file, too: its contacts would count twice.

    As of a log that was saved, went on, and was saved again.
    """
    for k, (path, text) in reversed([*enumerate(texts)]):
        for other_path, longer in [*texts[:k], *texts[k + 1 :]]:
            if text.strip() and text.strip() in longer:
                see = f"the same text as in {other_path}"
                raise RecordError(f"{SUBJECT} {path}", see, "each file once", "Leave it out.")


def _check(files: str, contacts: Sequence[Contact], machine: Machine) -> None:
    """Raises RecordError for the first contact that is none of this machine's, with its text."""
    geometry, requirement = machine.geometry(), "contacts with one plate, of this machine"
    off_mm = np.array([contact.place_mm[2] - contact.height_mm for contact in contacts])
    usual_mm = float(np.median(off_mm)) if len(contacts) else 0.0
    places_mm = np.array([contact.place_mm for contact in contacts]).reshape(-1, 3)
    is_near = np.abs(places_mm).sum(axis=1) <= LARGEST
    is_reached = (geometry.reach_mm2(np.where(is_near[:, None], places_mm, 0.0)) > 0.0).all(axis=1)
    reachable = (is_near & is_reached).tolist()
    for contact, off, reached in zip(contacts, off_mm.tolist(), reachable, strict=True):
        x, y, z = contact.place_mm
        if not reached or abs(off - usual_mm) > OFF_PLATE_MM:
            reason = f"{abs(off - usual_mm):.3g} mm off the others" if reached else "not reached"
            raise RecordError(
                f"{SUBJECT} {files}",
                f"{contact.text[:LETTERS]}: the tool at ({x:.6g}, {y:.6g}, {z:.6g}) mm, {reason}",
                requirement,
                "Are these contacts of another geometry, or in another unit? Take out a place that "
                "failed.",
            )
    _check_neighbours(files, contacts, off_mm)


def _check_neighbours(files: str, contacts: Sequence[Contact], off_mm: FloatArray) -> None:
    """Raises RecordError for a contact that is on no smooth plate with those beside it."""
    if not contacts:
        return
    across_mm = np.array([contact.place_mm[:2] for contact in contacts])
    farthest_mm = np.maximum(off_mm - off_mm.min(), off_mm.max() - off_mm)
    for number in np.flatnonzero(farthest_mm > STEEPEST * BESIDE_MM).tolist():  # others cannot be
        apart_mm = np.hypot(*(across_mm - across_mm[number]).T)
        step_mm = np.abs(off_mm - off_mm[number])
        steep = step_mm / np.maximum(apart_mm, BESIDE_MM)
        worst = int(steep.argmax())
        if steep[worst] > STEEPEST:
            pair = sorted((number, worst), key=lambda k: -abs(off_mm[k] - float(np.median(off_mm))))
            text, neighbour = (contacts[k].text[:LETTERS] for k in pair)
            raise RecordError(
                f"{SUBJECT} {files}",
                f"{text}: {step_mm[worst]:.3g} mm off a contact that is "
                f"{apart_mm[worst]:.3g} mm beside it, {neighbour}",
                "contacts with one plate, with the values that the configuration has now",
                "Were values changed between these contacts? Probe again, or take out the line of "
                "a contact that is wrong.",
            )


@dataclass
class Place:
    """Where the tool met the plate, as it did first, and how often."""

    x_mm: float
    y_mm: float
    visits: int = 0


def _place(
    places: dict[tuple[int, int, float], list[Place]], x_mm: float, y_mm: float, height_mm: float
) -> Place:
    """The place that is the same as this one, or a new one; squares of its size keep them."""
    column, row = round(x_mm / SAME_PLACE_MM), round(y_mm / SAME_PLACE_MM)
    for near in product((column - 1, column, column + 1), (row - 1, row, row + 1), (height_mm,)):
        for place in places.get(near, ()):
            if max(abs(place.x_mm - x_mm), abs(place.y_mm - y_mm)) <= SAME_PLACE_MM:
                return place
    place = Place(x_mm, y_mm)
    places.setdefault((column, row, height_mm), []).append(place)
    return place


def _readings(contacts: Sequence[Contact]) -> tuple[Reading, ...]:
    """Contacts in their order; the same place once more is the next cycle.

    By hand, or at another trigger height than the last contact's, the plate has a zero of its own.
    """
    places: dict[tuple[int, int, float], list[Place]] = {}
    readings: list[Reading] = []
    by_probe = default_mount("tool", "z", 0.0)
    trigger_mm = next((c.height_mm for c in reversed(contacts) if c.by == "probe"), 0.0)
    for number, contact in enumerate(contacts, start=1):
        x, y, z = contact.place_mm
        place = _place(places, x, y, contact.height_mm)
        place.visits += 1
        mount = BY_HAND if contact.by == "hand" else by_probe
        if mount == by_probe and contact.height_mm != trigger_mm:
            mount = f"{by_probe}, trigger at {contact.height_mm:g} mm"
        readings.append(
            Reading(
                reading=number,
                leg="tool",
                axis="z",
                displacement_mm=0.0,
                position_mm=(x, y, z),
                value_mm=contact.height_mm,
                text=contact.text,
                cycle=place.visits,
                mount=mount,
                station=0.0,
                resolution_mm=contact.resolution_mm,
                contact=True,
            )
        )
    return tuple(readings)
