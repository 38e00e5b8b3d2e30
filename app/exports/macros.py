"""Planned places of a plate as G-code: the firmware's own probe measures them, its owner runs it.

Klipper reports `probe: at X,Y bed will contact at z=Z` for each place, RepRapFirmware `G32 bed
probe heights:` for each cycle, Marlin `Bed X: Y: Z:` for each place.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import groupby
from typing import Literal, get_args

from app.exports.linuxcnc import short_lines
from calib.errors import UsageError
from calib.tripod.towers import Towers
from protocols.machine import Machine
from protocols.procedure import Plate, Procedure, position_words

Dialect = Literal["klipper", "reprapfirmware", "marlin"]
DIALECTS: tuple[Dialect, ...] = get_args(Dialect)

CLEAR_MM = 10.0
"""The nozzle rises to this height, at least, before it goes to the next place."""

MOST_POINTS = 24
"""Of one answer of RepRapFirmware: it has 256 characters at most."""

Place = tuple[float, float]
"""X and Y from the middle of the plate, mm."""


def macro(
    dialect: Dialect, procedure: Procedure, machine: Machine, printable_mm: float | None = None
) -> str:
    """G-code that probes every place of a procedure in its order, cycle after cycle.

    ``printable_mm`` is the radius that the firmware allows; None: that of the machine file, else
    what towers and bars allow.
    Raises UsageError for readings of legs, places off the plate and places outside this circle,
    ImpossibleRequest for a machine without upright towers.
    """
    plate = _probed(procedure)
    printable_mm = printable_mm or machine.printable_radius_mm
    if printable_mm is None:
        towers = Towers.of(machine.geometry())
        radius_mm = float(towers.radius_mm.min())
        printable_mm = min(radius_mm, float(towers.length_mm.min()) - radius_mm)
    cycles = _cycles(procedure, machine, printable_mm)
    places = [place for cycle in cycles for place in cycle]
    furthest_mm = max(math.hypot(*place) for place in places)
    above = [
        f"glidecal: {len(places)} places of procedure {procedure.name} on machine {machine.name}, "
        f"up to {furthest_mm:.1f} mm from the middle of the plate",
        NOTES[dialect],
        *_beside(dialect, places, machine),
        "Run it with a clean nozzle or probe, at the temperature that you print at. Save all that "
        "the firmware answers, and give that log to glidecal import",
    ]
    code = CODE[dialect](cycles, max(plate.lift_mm, CLEAR_MM))
    lines = [f"; {line}" for text in above for line in short_lines(text)]
    return "\n".join([*lines, *code]) + "\n"


def _beside(dialect: Dialect, places: Sequence[Place], machine: Machine) -> Iterator[str]:
    """How far a probe that hangs beside the nozzle goes out, or the nozzle beside the probe."""
    x_beside, y_beside, _ = machine.beside_mm
    if not (x_beside or y_beside):
        return
    tool, sign = ("probe", 1.0) if dialect == "klipper" else ("nozzle", -1.0)
    far_mm = max(math.hypot(x + sign * x_beside, y + sign * y_beside) for x, y in places)
    needs = "the plate has to reach that far" if dialect == "klipper" else "it has to reach there"
    yield f"The {tool} goes up to {far_mm:.1f} mm from the middle: {needs}"


def _probed(procedure: Procedure) -> Plate:
    """The plate of a procedure that a probe can measure."""
    thing, next_step = f"a macro of procedure {procedure.name}", "plate-rings is one."
    plate = procedure.plate
    if plate is None:
        raise UsageError(thing, "readings of legs", "a procedure with [plate]", next_step)
    off = [place for place in plate.places_mm() if place[2] != 0.0]
    if plate.axis != "z" or off:
        across = plate.axis != "z"
        place_words = (
            f"a plate across {plate.axis}" if across else f"position {position_words(off[0])}"
        )
        raise UsageError(
            thing, place_words, "positions on a plate at z = 0: there a probe meets it"
        )
    return plate


def _cycles(procedure: Procedure, machine: Machine, printable_mm: float) -> list[list[Place]]:
    """The places of each cycle. Raises UsageError for the first outside the printable circle."""
    cycles: list[list[Place]] = []
    for _, steps in groupby(procedure.steps(machine.geometry()), key=lambda step: step.cycle):
        positions = [step.position_mm for step in steps if step.position_mm is not None]
        for position in positions:
            if (away_mm := math.hypot(*position[:2])) > printable_mm:
                raise UsageError(
                    f"a macro of procedure {procedure.name}",
                    f"position {position_words(position)}, {away_mm:.1f} mm from the middle",
                    f"positions in the printable circle, up to {printable_mm:.1f} mm",
                    "State printable_radius_mm in the machine file, which rings of plate-rings "
                    "follow, or use smaller radii in a procedure of your own.",
                )
        cycles.append([(x, y) for x, y, _ in positions])
    return cycles


def _klipper(cycles: Sequence[Sequence[Place]], lift_mm: float) -> Iterator[str]:
    yield from ("G28", "G90")
    for x, y in (place for cycle in cycles for place in cycle):
        yield from (f"G1 Z{lift_mm:.3f} F600", f"G1 X{x:.3f} Y{y:.3f} F3000", "PROBE")
    yield from (f"G1 Z{lift_mm:.3f} F600", "G28")


def _reprapfirmware(cycles: Sequence[Sequence[Place]], _lift_mm: float) -> Iterator[str]:
    yield from ("M665", "M666", "M561", "G28")
    for cycle in cycles:
        for start in range(0, len(cycle), MOST_POINTS):
            points = cycle[start : start + MOST_POINTS]
            for number, (x, y) in enumerate(points):
                report = " S-1" if number == len(points) - 1 else ""
                yield f"G30 P{number} X{x:.3f} Y{y:.3f} Z-99999{report}"
    yield "G28"


def _marlin(cycles: Sequence[Sequence[Place]], _lift_mm: float) -> Iterator[str]:
    """Lines for Marlin, places on hundredths as its answers are: the log then has the place
    commanded.
    """
    yield from ("M503", "G28", "M420 S0")
    yield from (f"G30 X{x + 0.0:z.2f} Y{y + 0.0:z.2f}" for cycle in cycles for x, y in cycle)
    yield "G28"


CODE: dict[Dialect, Callable[[Sequence[Sequence[Place]], float], Iterator[str]]] = {
    "klipper": _klipper,
    "reprapfirmware": _reprapfirmware,
    "marlin": _marlin,
}

NOTES: dict[Dialect, str] = {
    "klipper": "Klipper: needs a section [probe], and print_radius at least that far. The nozzle "
    "goes to each place; the answer states the place of the probe",
    "reprapfirmware": "RepRapFirmware: needs a Z probe (M558), and M665 B at least that far. The "
    "probe goes to each place; the heights of a cycle are in one answer, in the order of P, and "
    "nothing is calibrated by it (S-1)",
    "marlin": "Marlin: needs a probe, and DELTA_PRINTABLE_RADIUS at least that far. The probe goes "
    "to each place",
}
