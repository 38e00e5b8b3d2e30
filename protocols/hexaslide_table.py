"""Measured postures of a Hexa Slide as a table (CSV): a header, a row of units, a row a posture.

Columns are ``posture``, ``slider1`` … ``slider6``, and what the procedure measures. The second row
has the unit of each: without it nobody can tell inches from millimetres.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from itertools import zip_longest
from math import degrees
from pathlib import Path
from typing import cast

from calib.errors import RecordError
from calib.hexaslide.geometry import CHAINS
from calib.hexaslide.procedures import ANGLES, MEASURABLE
from protocols.data_table import COMMA, NUMBER, check_separators, csv_text, lines_of
from protocols.hexaslide import MOST_POSTURES, HexaSlideMachine
from protocols.hexaslide_session import (
    FIRST_APPROACH,
    LARGEST,
    PostureCommands,
    PostureProcedure,
    PostureReading,
    SixMm,
    Values,
)

SLIDERS = tuple(f"slider{chain}" for chain in range(1, CHAINS + 1))
NUMBERED = re.compile(r"slider\d+", re.ASCII)
LENGTHS = {"mm": 1.0, "m": 1000.0}
ANGLE_UNITS = {"deg": 1.0, "rad": degrees(1.0), "mrad": degrees(1e-3)}
MOST_NAMED = 8
"""Lines in one remark."""

UNIT_ROW = "Below the header comes a row of units; import --template writes both."


def empty_table(planned: PostureCommands) -> str:
    """The table of a procedure, to be filled in: what is measured, and with a rigid link the
    sliders; else these stand where they are sent to.
    """
    procedure = planned.procedure.whole()
    names = procedure.measured
    units = ["", *["mm"] * CHAINS, *("deg" if name in ANGLES else "mm" for name in names)]
    rows = [[f"# {FIRST_APPROACH}"], ["posture", *SLIDERS, *names], units]
    for number in range(1, len(planned.procedure.postures) + 1):
        cells = (
            [""] * CHAINS
            if procedure.has_rigid_link
            else [f"{slider_mm:.4f}" for slider_mm in planned.of(number)]
        )
        rows.append([str(number), *cells, *[""] * len(names)])
    return csv_text(rows)


def readings_of_table(
    path: Path, machine: HexaSlideMachine, procedure: PostureProcedure
) -> tuple[dict[int, PostureReading], tuple[str, ...]]:
    """Readings of a table by its lines, in millimetres and degrees, and what was not used.

    A row without any value is left out. Raises RecordError with the line and the column.
    """
    lines, semicolons = lines_of(path, MOST_POSTURES + 2)
    rows = [(line, [cell.strip() for cell in row]) for line, row in lines if any(row)]
    rows = [(line, row) for line, row in rows if not row[0].startswith("#")]
    if rows:
        check_separators(f"table {path}, line {rows[0][0]}", rows[0][1])
    if len(rows) < 3:
        raise RecordError(f"table {path}", f"{len(rows)} rows", "a header, units, and postures")
    if len(rows) - 2 > MOST_POSTURES:
        raise RecordError(f"table {path}", f"{len(rows) - 2} postures", f"{MOST_POSTURES} at most")
    measured = procedure.whole().measured
    (header_line, header), (unit_line, units), *postures = rows
    _check_header(f"table {path}, line {header_line}", header, measured)
    factors = _factors(f"table {path}, line {unit_line}", header, units)
    readings: dict[int, PostureReading] = {}
    for line, row in postures:
        place = f"table {path}, line {line}"
        if len(row) > len(header):
            raise RecordError(place, f"{len(row)} cells", f"{len(header)}, one a column")
        cells = dict(zip_longest(header, row, fillvalue=""))
        if not any(cells[name] for name in measured or SLIDERS):
            continue
        values = {
            name: _number(place, name, cells[name], factor, semicolons)
            for name, factor in factors.items()
        }
        _check_travel(place, values, machine)
        readings[line] = PostureReading(
            reading=len(readings) + 1,
            posture=_posture(place, cells.get("posture", ""), len(readings) + 1),
            sliders_mm=cast("SixMm", tuple(values[name] for name in SLIDERS)),
            values=tuple(values[name] for name in measured),
            text=",".join(row)[:1000],
        )
    if not readings:
        raise RecordError(f"table {path}", "no row with values", "a posture at least")
    unused = [name for name in header if name not in factors and name != "posture"]
    remarks = [f"columns that are not used: {', '.join(unused)}"] if unused else []
    if empty_count := len(postures) - len(readings):
        remarks.append(f"rows without values, left out: {empty_count}")
    first_lines: dict[tuple[SixMm, Values], int] = {}
    copies = [
        f"{line}"
        for line, reading in readings.items()
        if first_lines.setdefault((reading.sliders_mm, reading.values), line) != line
    ]
    if copies:
        remarks.append(
            f"lines with all numbers of an earlier one: {', '.join(copies[:MOST_NAMED])}"
            f"{' …' if len(copies) > MOST_NAMED else ''}; each is used as a reading of its own"
        )
    return readings, tuple(remarks)


def _fault(
    place: str, column: str, value: str, requirement: str, next_step: str = ""
) -> RecordError:
    return RecordError(f"{place}, column {column}", value, requirement, next_step)


def _check_header(place: str, names: list[str], measured: Sequence[str]) -> None:
    """Raises RecordError for a column that is missing, doubled, or of a seventh joint."""
    columns = ", ".join((*SLIDERS, *measured))
    for name in names:
        if NUMBERED.fullmatch(name) and name not in SLIDERS:
            fault = f"a joint more than the {CHAINS} of the machine"
            raise _fault(place, name, fault, columns)
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise _fault(place, twice[0] or "(no name)", "twice", "each once")
    missing = [name for name in (*SLIDERS, *measured) if name not in names]
    if missing:
        fault = f"no such column among {', '.join(names)}"
        raise _fault(place, missing[0], fault, columns)


def _factors(place: str, header: list[str], cells: list[str]) -> dict[str, float]:
    """What makes millimetres and degrees of the numbers, by column. Raises RecordError."""
    factors = {}
    for name, unit in zip(header, [*cells, *[""] * len(header)], strict=False):
        if name not in (*SLIDERS, *MEASURABLE, "length"):
            continue
        units = ANGLE_UNITS if name in ANGLES else LENGTHS
        if unit not in units:
            fault = f"{unit}, where the unit is expected" if NUMBER.fullmatch(unit) else unit
            raise _fault(place, name, fault or "no unit", " or ".join(units), UNIT_ROW)
        factors[name] = units[unit]
    return factors


def _number(place: str, name: str, cell: str, factor: float, semicolons: bool) -> float:
    """A number in millimetres or degrees. Raises RecordError."""
    if semicolons and COMMA.fullmatch(cell):
        cell = cell.replace(",", ".")
    if not NUMBER.fullmatch(cell):
        next_step = "Write decimals with a point." if "," in cell else ""
        raise _fault(place, name, cell or "an empty cell", "a number", next_step)
    value = factor * float(cell)
    if abs(value) > LARGEST:
        raise _fault(place, name, cell, f"up to {LARGEST:g} mm or degrees")
    return value


def _posture(place: str, cell: str, usual: int) -> int:
    posture = cell or str(usual)
    if not posture.isdecimal() or not 1 <= int(posture) <= MOST_POSTURES:
        raise _fault(place, "posture", posture, f"its number, 1 … {MOST_POSTURES}")
    return int(posture)


def _check_travel(place: str, values: dict[str, float], machine: HexaSlideMachine) -> None:
    """Raises RecordError for a slider beyond the ends of its rail."""
    for name, chain in zip(SLIDERS, machine.chain, strict=True):
        least, greatest = chain.travel_mm or (-LARGEST, LARGEST)
        if not least - 1e-3 <= values[name] <= greatest + 1e-3:
            requirement = f"{least:g} to {greatest:g} mm, its travel_mm in the machine file"
            raise _fault(place, name, f"{values[name]:g} mm", requirement)
