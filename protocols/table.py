"""Tables of readings, contacts and distances (CSV, XLSX, Parquet): a header, and a row for each.

Readings stand in the order taken.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Container, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import ValidationError

from calib.arrays import LEG_NAMES
from calib.errors import RecordError
from calib.printable import counted
from calib.tripod.geometry import Geometry
from protocols.data_table import (
    COMMA,
    NUMBER,
    PARQUET,
    WORKBOOK,
    check_separators,
    csv_text,
    lines_of,
    unprotected,
    workbook,
)
from protocols.documents import LARGEST_COUNT, Triple, describe, triple
from protocols.machine import Instrument, Machine
from protocols.procedure import (
    ALL_AXES,
    SLIDING,
    Leg,
    Procedure,
    default_mount,
    leg_within,
    off_bar,
)
from protocols.session import (
    LARGEST_READING_MM,
    MOVED,
    MOVED_MM,
    Distance,
    Event,
    Moved,
    Opened,
    Reading,
    Restored,
    Superseded,
)

REQUIRED = ("leg", "axis", "displacement_mm", "value_mm")
OPTIONAL = (
    *("cycle", "time_s", "mount", "station", "temperature_c", "averaged", "seq", "plane"),
    *("device_text", "counts", "counts_reason", "resolution_mm", "unit_assumed"),
)

POSITION = ("x_mm", "y_mm", "z_mm")
OF_TOOL = (*POSITION, "value_mm")
"""Columns of a table of readings of the tool, as against a plate."""
OF_CONTACT = (*POSITION, "height_mm")
"""Columns of a table of contacts: where the tool was sent to, and its height over a plate there."""
FROM, TO = (tuple(f"{end}_{axis}_mm" for axis in "xyz") for end in ("from", "to"))
OF_DISTANCE = (*FROM, *TO, "distance_mm")
"""Columns of a table of distances: between two places that the tool was sent to."""
OPTIONAL_OF_TOOL = (
    "axis",
    "lift_mm",
    *(name for name in OPTIONAL if name not in ("station", "plane")),
)

NUMBERS = (
    *("displacement_mm", "value_mm", "time_s", "station", "temperature_c", "lift_mm"),
    *("resolution_mm", "height_mm", "deviation_mm"),
    *OF_DISTANCE,
    *POSITION,
    *MOVED_MM,
    "feed_mm_min",
)

MOST_ROWS = 100_000
LARGEST_NUMBER = 1e9

T = TypeVar("T")

INTEGER = re.compile(r"\+?\d+", re.ASCII)


class Row:
    """One row of a table, with its line number for messages, and the table's decimal mark."""

    def __init__(self, path: Path, line: int, fields: dict[str, str], mark: str = ".") -> None:
        self.path = path
        self.line = line
        self.fields = fields
        self.mark = mark

    def fault(self, column: str, requirement: str, next_step: str = "") -> RecordError:
        """The error that this column's value deserves."""
        subject = f"table {self.path}, line {self.line}, column {column}"
        return RecordError(subject, repr(self.fields.get(column, "")), requirement, next_step)

    def letter(self, column: str) -> Leg:
        """x, y or z."""
        for axis in ALL_AXES:
            if self.fields[column].lower() == axis:
                return axis
        raise self.fault(column, "x, y or z")

    def with_point(self, column: str) -> str:
        """A finite number as it is written, with a decimal point."""
        text = self.fields[column]
        # beside decimal commas a point is one of thousands: no number with it is taken
        plain = text if self.mark == "." else text.replace(".", " ").replace(",", ".", 1)
        if not NUMBER.fullmatch(plain):
            word = "point" if self.mark == "." else "comma, as in other rows"
            next_step = "" if text else "Leave out the row of a reading that was not taken."
            if COMMA.fullmatch(text) and self.mark == ".":
                next_step = (
                    "Replace the decimal comma by a point, or the commas between columns by ;"
                )
            if "−" in text:  # of a word processor; it looks like a hyphen
                next_step = "Write minus as -, as on a keyboard."
            raise self.fault(column, f"a finite number with a decimal {word}", next_step)
        return plain

    def number(self, column: str, largest: float = LARGEST_NUMBER) -> float:
        """A finite number."""
        text = self.with_point(column)
        value = float(text)
        if abs(value) > largest:
            unit = " mm" if column.endswith("_mm") else ""
            raise self.fault(column, f"a number of sensible size, up to {largest:g}{unit}")
        return value

    def whole(self, column: str, least: int) -> int:
        """A whole number not below ``least``."""
        text = self.fields[column]
        # int() raises ValueError for thousands of digits
        if not INTEGER.fullmatch(text) or len(text) > 9 or not least <= int(text) <= LARGEST_COUNT:
            raise self.fault(column, f"a whole number, {least} … {LARGEST_COUNT}")
        return int(text)

    def optional(self, column: str, parse: Callable[[str], T], default: T) -> T:
        """``read(column)``, or the default where the field is empty or missing."""
        return parse(column) if self.fields.get(column) else default


def _readings(rows: list[Row], unknown: tuple[str, ...], geometry: Geometry) -> tuple[Reading, ...]:
    readings = tuple(
        _reading(row, number, unknown, geometry) for number, row in enumerate(rows, start=1)
    )
    _check_sequence(rows)
    _check_mounts(rows, readings)
    return readings


def _counting(rows: Sequence[Row]) -> list[Superseded | Restored]:
    """What makes readings not count, or count again, a row each; rows are numbered from 1."""
    events: list[Superseded | Restored] = []
    for number, row in enumerate(rows, start=1):
        counts = row.fields.get("counts") or "yes"
        if counts not in ("yes", "no", "again"):
            raise row.fault("counts", "yes, no or again, in column counts_reason why")
        why = row.fields.get("counts_reason", "")
        if counts != "yes":
            events.append(Superseded(readings=(number,), reason=why))
        if counts == "again":
            events.append(Restored(readings=(number,), reason=why))
    return events


def is_table(path: Path) -> bool:
    """Whether a path is that of a table, by its ending."""
    return path.suffix.lower() in (".csv", WORKBOOK, PARQUET)


def opened_table(
    path: Path,
    machine: Machine,
    program: str,
    *,
    resolution_mm: float | None = None,
    repeatability_mm: float | None = None,
    remarks: tuple[str, ...] = (),
) -> tuple[Opened, tuple[Event, ...], tuple[str, ...]]:
    """First line and events of a session of a table, and the columns that are kept but not used.

    A table with positions of the tool holds readings of the tool, else they are readings of legs.
    ``resolution_mm`` and ``repeatability_mm`` are stated of the indicators. Raises RecordError
    naming the line, the column and the value.
    """
    rows, unknown = rows_of_table(path)
    if "distance_mm" in rows[0].fields:
        raise RecordError(
            f"table {path}",
            "distances between marks, and no reading",
            "a table of readings or contacts",
            "Take them beside these: glidecal import CONTACTS --distances THIS -o SESSION.",
        )
    events = (*_readings(rows, unknown, machine.geometry()), *_counting(rows))
    instrument = Instrument(
        profile="probe" if _is_of_contact(rows[0].fields) else "table",
        port=path.name,
        resolution_mm=resolution_mm,
        repeatability_mm=repeatability_mm,
    )
    opened = Opened(
        program=program,
        origin="imported",
        machine=machine,
        instruments=(instrument,),
        remarks=remarks,
    )
    return opened, events, unknown


def outside_limits(readings: Sequence[Reading], geometry: Geometry) -> int:
    """How many readings are in postures that the joint limits do not allow."""
    places = [r.position_mm for r in readings if r.position_mm is not None]
    of_tool = int((~geometry.stands(np.array(places))).sum()) if places else 0
    of_legs = (r for r in readings if r.position_mm is None)
    return of_tool + sum(not leg_within(r.leg, r.displacement_mm, geometry) for r in of_legs)


def off_plate_words(readings: Sequence[Reading], machine: Machine) -> str:
    """By how much a plate is off where the controller expects it, at all places alike.

    The median of where the tool was sent less its height, against twice the tolerance of offsets;
    empty within that.
    """
    off_mm = [
        reading.position_mm[LEG_NAMES.index(reading.axis)] - reading.value_mm
        for reading in readings
        if reading.contact and reading.position_mm is not None
    ]
    common_mm = float(np.median(off_mm)) if off_mm else 0.0
    # of offsets, beyond which contacts that are off alike are worth a word: 95 of 100 are within
    limit_mm = 2.0 * machine.offset_tolerance_mm
    if abs(common_mm) <= limit_mm:
        return ""
    side = "higher" if common_mm > 0.0 else "lower"
    return (
        f"the plate is {abs(common_mm):.3g} mm {side} than the controller expects, at all places "
        f"alike. Allowed: up to {limit_mm:g} mm (offset_tolerance_mm, k = 2). Look at z_offset of "
        "the probe, or touch the plate again; the values of solve hardly depend on this height"
    )


def off_bar_words(readings: Sequence[Reading], geometry: Geometry) -> str:
    """How many readings touch a leg off the usable part of its bar; empty where none does."""
    of_legs = (r for r in readings if r.leg != "tool")
    visits = Counter(
        (r.leg, r.station, 0.0 if r.over_plane else r.displacement_mm) for r in of_legs
    )
    faults = off_bar([*visits], geometry)
    times = [*visits.values()]
    count = sum(times[number] for number, _ in faults)
    return f"readings off the bars: {count}, the first at {faults[0][1]}" if faults else ""


def rows_of_table(path: Path) -> tuple[list[Row], tuple[str, ...]]:
    """Rows of a table, and its columns that nobody knows. Raises RecordError naming the place."""
    lines, semicolons = lines_of(path, MOST_ROWS + 2)
    names = [unprotected(name.strip()) for name in lines[0][1]] if lines else []
    header = [name or f"column {number}" for number, name in enumerate(names, start=1)]
    _check_header(path, header)
    filled = [(line, values) for line, values in lines[1:] if any(v.strip() for v in values)]
    fields = [(line, _fields(path, line, header, values)) for line, values in filled]
    commas = (COMMA.fullmatch(cells.get(name, "")) for _, cells in fields for name in NUMBERS)
    mark = "," if semicolons and any(commas) else "."
    rows = [Row(path, line, cells, mark) for line, cells in fields]
    if not 1 <= len(rows) <= MOST_ROWS:
        count = f"{len(rows):,} rows" if rows else "no row of readings"
        raise RecordError(f"table {path}", count, f"a row for each reading, up to {MOST_ROWS:,}")
    required, optional = _columns(header)
    return rows, tuple(name for name in header if name not in required + optional + MOVED)


def _check_header(path: Path, header: list[str]) -> None:
    subject = f"table {path}, header"
    required, optional = _columns(header)
    missing = [name for name in required if name not in header]
    check_separators(subject, header)
    if missing:
        raise RecordError(
            subject,
            ", ".join(header) or "nothing",
            "columns " + ", ".join(required + optional),
            f"Missing: {', '.join(missing)}",
        )
    if "height_mm" in required and "value_mm" in header:
        raise RecordError(
            subject,
            "height_mm and value_mm",
            "height_mm of contacts, or value_mm of an indicator, not both",
        )
    doubled = [name for name, count in Counter(header).items() if count > 1]
    if doubled:
        raise RecordError(subject, f"{doubled[0]!r} twice", "each column once")


def _fields(path: Path, line: int, header: list[str], values: list[str]) -> dict[str, str]:
    if len(values) != len(header):
        raise RecordError(
            f"table {path}, line {line}",
            counted(len(values), "field"),
            f"{len(header)} fields as in the header",
            "With decimal commas put semicolons between columns.",
        )
    return dict(zip(header, (unprotected(value.strip()) for value in values), strict=True))


def _columns(header: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Columns that a table with this header must have, and those that it may have."""
    if "distance_mm" in header:
        return OF_DISTANCE, ("deviation_mm",)
    if not _is_of_tool(header):
        return REQUIRED, OPTIONAL
    return OF_CONTACT if "height_mm" in header else OF_TOOL, OPTIONAL_OF_TOOL


def _is_of_tool(names: Container[str]) -> bool:
    return any(name in names for name in POSITION) and "leg" not in names


def _is_of_contact(names: Container[str]) -> bool:
    return _is_of_tool(names) and "height_mm" in names


def _tool_reading(row: Row, number: int, unknown: tuple[str, ...], geometry: Geometry) -> Reading:
    axis = row.letter("axis") if row.fields.get("axis") else "z"
    place = x, y, z = triple(row.number(name) for name in POSITION)
    if not (geometry.reach_mm2(np.array(place)) > 0.0).all():
        raise row.fault(
            "z_mm",
            f"with x and y a place that the bars reach, not ({x:g}, {y:g}, {z:g}) mm",
            "No such posture exists; is the unit mm, and is this the machine?",
        )
    lift = row.optional("lift_mm", row.number, 0.0)
    if lift < 0.0:
        raise row.fault("lift_mm", "0 or more: how far the tool lifted off before")
    return Reading(
        reading=number,
        leg="tool",
        axis=axis,
        displacement_mm=0.0,
        position_mm=place,
        lift_mm=lift or None,
        mount=row.fields.get("mount") or default_mount("tool", axis, 0.0),
        station=0.0,
        contact=_is_of_contact(row.fields) or None,
        **_of_any(row, unknown, f"{axis}_mm" if _is_of_contact(row.fields) else "value_mm"),
    )


def _reading(row: Row, number: int, unknown: tuple[str, ...], geometry: Geometry) -> Reading:
    parse = _tool_reading if _is_of_tool(row.fields) else _leg_reading
    try:
        return parse(row, number, unknown, geometry)
    except ValidationError as problem:
        raise RecordError(
            f"table {row.path}, line {row.line}",
            reason=describe(problem),
            allowed="readings of sensible size",
        ) from problem


def _leg_reading(row: Row, number: int, unknown: tuple[str, ...], geometry: Geometry) -> Reading:
    if not geometry.reads_legs:
        raise RecordError(
            f"table {row.path}, header",
            "readings of legs, for a machine whose bars are nowhere along their drives",
            "readings of the tool: columns " + ", ".join(OF_TOOL),
        )
    leg, axis = row.letter("leg"), row.letter("axis")
    if leg == axis:
        raise row.fault("axis", f"an axis across the leg, not {leg} itself")
    displacement = row.number("displacement_mm")
    shortest = min(geometry.leg_length_mm)
    if abs(displacement) >= shortest:
        raise row.fault(
            "displacement_mm",
            f"less than the leg length {shortest:g} mm",
            "No such posture exists; is the unit mm?",
        )
    station = row.optional("station", row.number, 0.5)
    if not 0.0 <= station <= 1.0:
        raise row.fault("station", "a fraction of the leg, 0 … 1")
    over_plane = row.optional("plane", lambda name: row.whole(name, 0), 0)
    if over_plane > 1:
        raise row.fault("plane", "1 where the stand slides on a reference plane, else 0")
    return Reading(
        reading=number,
        leg=leg,
        axis=axis,
        displacement_mm=displacement,
        mount=row.fields.get("mount")
        or default_mount(leg, axis, SLIDING if over_plane else station),
        station=station,
        over_plane=True if over_plane else None,
        **_of_any(row, unknown),
    )


ABSOLUTE_ZERO_C = -273.15


def _temperature(row: Row, column: str) -> float:
    """Raises RecordError below absolute zero, which records of older programs may hold."""
    temperature_c = row.number(column)
    if temperature_c < ABSOLUTE_ZERO_C:
        raise row.fault(column, f"{ABSOLUTE_ZERO_C:g} °C, absolute zero, or more")
    return temperature_c


def _of_any(row: Row, unknown: tuple[str, ...], text_column: str = "value_mm") -> dict[str, Any]:
    """What readings of legs and of the tool have in common; the text is that of what was found."""
    column = "height_mm" if _is_of_contact(row.fields) else "value_mm"
    return {
        "value_mm": row.number(column, LARGEST_READING_MM),
        "text": row.fields.get("device_text") or row.with_point(text_column),
        "resolution_mm": row.optional("resolution_mm", row.number, None),
        "unit_assumed": bool(row.optional("unit_assumed", lambda name: row.whole(name, 0), 0)),
        "cycle": row.optional("cycle", lambda name: row.whole(name, 1), 1),
        "time_s": row.optional("time_s", row.number, None),
        "temperature_c": row.optional("temperature_c", partial(_temperature, row), None),
        "averaged": row.optional("averaged", lambda name: row.whole(name, 1), 1),
        "moved": _moved(row),
        "extra": {name: row.fields[name] for name in unknown},
    }


def _moved(row: Row) -> Moved | None:
    """How a controller moved the machine there: all of its columns, or none of them."""
    missing = [name for name in MOVED if not row.fields.get(name)]
    if len(missing) == len(MOVED):
        return None
    if missing:
        raise row.fault(missing[0], f"filled in as the others from {MOVED[0]} to {MOVED[-1]}")
    if row.fields["moved_in"] not in ("tool", "joint"):
        raise row.fault("moved_in", "tool or joint: the coordinates that the controller takes")
    places = iter([row.number(name) for name in MOVED_MM])
    triples = zip(places, places, places, strict=True)
    return Moved.model_validate(
        {
            "driver": row.fields["moved_by"],
            "coordinates": row.fields["moved_in"],
            **dict(zip(("from_mm", "commanded_mm", "read_back_mm"), triples, strict=True)),
            "feed_mm_min": row.number("feed_mm_min"),
        }
    )


def _check_sequence(rows: list[Row]) -> None:
    """Row numbers, where given, must count up by one from 0 or 1."""
    if not any(row.fields.get("seq") for row in rows):
        return
    first = rows[0].whole("seq", 0)
    for expected, row in enumerate(rows, start=first):
        if first > 1 or row.whole("seq", 0) != expected:
            raise row.fault(
                "seq",
                f"{1 if first > 1 else expected}, counting rows from 1",
                "A row is missing, doubled or out of order.",
            )


def _check_mounts(rows: list[Row], readings: tuple[Reading, ...]) -> None:
    """One mounting is one stand in one place: same leg, axis and station throughout."""
    places: dict[str, tuple[str, str, float]] = {}
    for row, reading in zip(rows, readings, strict=True):
        place = reading.set_up
        if places.setdefault(reading.mount, place) != place:
            leg, axis, station = places[reading.mount]
            station_words = "over a plane" if station == SLIDING else f"station {station:g}"
            place_words = f"leg {leg}, axis {axis}, {station_words}"
            raise row.fault("mount", f"a new name: {reading.mount!r:.80} already is {place_words}")


OFF_MM = 5.0
"""So far what was measured may be from what was commanded: a machine that is off by more was of no
use, and the distance is of other marks, or in another unit."""

LEAST_MM = 1e-4
"""Nothing is marked and measured better."""


@dataclass(frozen=True)
class MeasuredDistance:
    """A distance between two places of the tool, and where that stands, for messages."""

    from_mm: Triple
    to_mm: Triple
    value_mm: float
    text: str
    source: str
    deviation_mm: float | None = None


def distances_of_table(path: Path) -> tuple[MeasuredDistance, ...]:
    """The distances of a table. Raises RecordError naming line, column and value."""
    return tuple(_measured_distance(row) for row in rows_of_table(path)[0])


def _measured_distance(row: Row) -> MeasuredDistance:
    if "distance_mm" not in row.fields:
        raise RecordError(
            f"table {row.path}, header",
            ", ".join(row.fields),
            "columns " + ", ".join((*FROM, *TO, "distance_mm")),
            "Missing: distance_mm",
        )
    return MeasuredDistance(
        triple(map(row.number, FROM)),
        triple(map(row.number, TO)),
        row.number("distance_mm"),
        row.with_point("distance_mm"),
        f"table {row.path}, line {row.line}",
        row.optional("deviation_mm", row.number, None),
    )


def checked_distances(
    measured: Sequence[MeasuredDistance], geometry: Geometry, deviation_mm: float | None = None
) -> tuple[Distance, ...]:
    """Lines of the record, numbered from 1; ``deviation_mm`` of those that state none.

    Raises RecordError for marks that the bars do not reach, two marks at one place, a distance that
    is none, or far from what was commanded.
    """
    # standard deviation of marking and measuring with a caliper, if nobody states another
    usual_mm = 0.05 if deviation_mm is None else deviation_mm
    return tuple(
        _checked_distance(number, entry, geometry, usual_mm)
        for number, entry in enumerate(measured, start=1)
    )


def _checked_distance(
    number: int, entry: MeasuredDistance, geometry: Geometry, usual_mm: float
) -> Distance:
    for place in (entry.from_mm, entry.to_mm):
        if not (geometry.reach_mm2(np.array(place)) > 0.0).all():
            at = ", ".join(f"{value:g}" for value in place)
            raise RecordError(entry.source, f"a mark at ({at}) mm", "places that the bars reach")
    apart_mm = math.dist(entry.from_mm, entry.to_mm)
    if not (apart_mm > 0.0 < entry.value_mm and abs(entry.value_mm - apart_mm) <= OFF_MM):
        raise RecordError(
            entry.source,
            f"{entry.value_mm:g} mm between marks that were commanded {apart_mm:.6g} mm apart",
            f"two marks, and a distance within {OFF_MM:g} mm of that",
            "Is it in mm, and of these two marks? Measure it again, or take it out.",
        )
    deviation_mm = usual_mm if entry.deviation_mm is None else entry.deviation_mm
    if not LEAST_MM <= deviation_mm <= OFF_MM:
        raise RecordError(
            entry.source,
            f"a standard deviation of {deviation_mm:g} mm",
            f"{LEAST_MM:g} … {OFF_MM:g} mm, that of marking and measuring together",
        )
    return Distance(
        distance=number,
        from_mm=entry.from_mm,
        to_mm=entry.to_mm,
        value_mm=entry.value_mm,
        deviation_mm=deviation_mm,
        text=entry.text,
    )


def empty_table(procedure: Procedure, geometry: Geometry, path: Path) -> str | bytes:
    """A table with a row for each reading of a procedure, its value left to be filled in."""
    rows: list[Sequence[str | float]]
    if procedure.plate is not None:
        lift_mm = procedure.plate.lift_mm
        rows = [("cycle", *POSITION, "axis", "lift_mm", "value_mm")]
        for step in procedure.steps(geometry):
            rows.append((step.cycle, *(step.position_mm or ()), step.axes[0], lift_mm, ""))
    else:
        over = ("plane",) if procedure.plane else ()
        rows = [("cycle", "leg", "axis", "station", "displacement_mm", *over, "value_mm")]
        for step in procedure.steps(geometry):
            slides = (int(step.over_plane),) if over else ()
            place = (step.station, step.displacement_mm, *slides, "")
            rows += [(step.cycle, step.leg, axis, *place) for axis in step.axes]
    if path.suffix.lower() == WORKBOOK:
        return workbook(rows, f"table {path}")
    return csv_text([c if isinstance(c, str) else f"{c:.12g}" for c in row] for row in rows)
